"""Scans from frames to volumes: the belt, the motion, products, parts, and what is bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.scans import (
    PYRAMID,
    drawn_calibration,
    lines_of,
    measured,
    recipe_of,
    scene,
    stripes_of,
    true_calibration,
)
from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError
from roemetry.records import Measurement, ScanLines, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.records.scan import Motion
from roemetry.run import scan
from roemetry.run.open_parts import split_products
from roemetry_pinhole.pinhole_plane import PinholePlane
from roemetry_scan.dense import DenseSlices
from roemetry_scan.placing import BeltMotion
from roemetry_simulate.moving_belt import MovingBelt

FRUSTUM = {"length_mm": 40, "width_mm": 30, "top_share": 0.5, "height_mm": 12}
TRUE_MM3 = 40 * 30 * 12 * (1 + 0.5 + 0.25) / 3


def frustum(**changes: object) -> MovingBelt:
    given = {"family": "truncated-pyramid", "product": FRUSTUM, "counts_per_line": 50} | changes
    return scene(160, 160, **given)  # type: ignore[arg-type]


def volume(sim: MovingBelt, calibration: Calibration | None = None) -> float:
    calibration = calibration or true_calibration(sim)
    stripes, lines = stripes_of(sim, 1, 0.02)
    assembler = BeltMotion()
    profiles = assembler.label(assembler.place(stripes, lines, calibration, PinholePlane()))
    (product,) = split_products(profiles, (), calibration, "scan")
    return DenseSlices().estimate(product).visible_mm3.value


def test_the_volume_of_a_frustum_is_its_own() -> None:
    assert volume(frustum()) == pytest.approx(TRUE_MM3, rel=2e-3)


def test_a_stray_peak_that_was_left_out_stays_out_where_a_flank_is_followed() -> None:
    """Of what is placed again with a moved calibration: its height was taken for that of the product."""
    sim = frustum()
    calibration, assembler, triangulator = true_calibration(sim), BeltMotion(), PinholePlane()
    stripes, lines = stripes_of(sim, 1, 0.02)
    profiles = assembler.label(assembler.place(stripes, lines, calibration, triangulator))
    line, row = np.argwhere(profiles.seen & (profiles.product > 0))[500]
    seen = profiles.seen.copy()
    seen[line, row] = False
    kept, _ = scan.placed_only(stripes, lines, replace(profiles, seen=seen), 0)
    assert np.isnan(kept.x_px[line, row])
    assert np.array_equal(np.isfinite(kept.x_px), seen)


def test_one_per_cent_of_the_motion_is_one_per_cent_of_the_volume() -> None:
    sim = frustum()
    calibration = true_calibration(sim)
    assert calibration.motion is not None
    longer = replace(calibration.motion, mm_per_count=1.01 * calibration.motion.mm_per_count)
    ratio = volume(sim, replace(calibration, motion=longer)) / volume(sim, calibration)
    assert ratio == pytest.approx(1.01, abs=1e-4)


def test_a_belt_that_climbs_costs_nothing() -> None:
    """Zero leans by 0.5° against the way the belt runs: the belt is fitted where it moves."""
    sim = frustum()
    calibration = true_calibration(sim)
    assert calibration.motion is not None
    lean = np.radians(0.5)
    size = calibration.motion.mm_per_count[0]
    climbing = replace(calibration.motion, mm_per_count=size * np.array([np.cos(lean), 0.0, np.sin(lean)]))
    found = volume(sim, replace(calibration, motion=climbing))
    assert found == pytest.approx(volume(sim, calibration), rel=2e-3)


@pytest.mark.parametrize("mm_per_count", [(0.02, 0.0), (0.021, 0.0005), (-0.019, -0.0003)])
def test_one_pass_of_a_frustum_tells_the_motion(mm_per_count: tuple[float, float]) -> None:
    sim = scene(
        360, 260, family="truncated-pyramid", mm_per_count=mm_per_count, counts_per_line=40,
        product={"length_mm": 70, "width_mm": 70, "top_share": 0.4, "height_mm": 20, "turn_range_deg": 15},
    )  # fmt: skip
    stripes, lines = stripes_of(sim, 3, 0.05)
    without = replace(true_calibration(sim), motion=None)
    right = mm_per_count[0] > 0
    found, _ = BeltMotion().motion(stripes, lines, without, PinholePlane(), PYRAMID, right=right)
    true = np.array([*mm_per_count, 0.0])
    assert np.abs(found.mm_per_count - true).max() < 5e-4 * np.abs(true).max()
    std = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.mm_per_count - true) < 5 * std).all()


def test_a_counter_that_counts_down_shows_no_mirror_image() -> None:
    sim = frustum()
    up, triangulator = true_calibration(sim), PinholePlane()
    stripes, lines = stripes_of(sim, 1, 0.02)
    assert up.motion is not None
    down = replace(up, motion=replace(up.motion, mm_per_count=-up.motion.mm_per_count))
    found = BeltMotion().place(stripes, lines, up, triangulator)
    again = BeltMotion().place(stripes, replace(lines, count=-lines.count), down, triangulator)
    assert np.allclose(again.xyz_mm, found.xyz_mm, equal_nan=True, atol=1e-9)


def test_a_motion_moves_with_the_calibration_it_was_found_with() -> None:
    """A scale that is wrong makes belt's way and products larger together: no root of squares holds that."""
    sim = scene(
        240, 200, family="truncated-pyramid", counts_per_line=60,
        product={"length_mm": 70, "width_mm": 70, "top_share": 0.4, "height_mm": 20, "turn_range_deg": 15},
    )  # fmt: skip
    stripes, lines = stripes_of(sim, 3, 0.02)
    calibration = drawn_calibration(sim, np.random.default_rng(5))

    def motion_by(one: Calibration) -> Motion:
        return BeltMotion().motion(stripes, lines, one, PinholePlane(), PYRAMID)[0]

    step = max(
        calibration.independent_steps(), key=lambda one: float(np.abs(one[:2]).max())
    )  # of a focal length
    found = motion_by(calibration)
    again = motion_by(calibration.shifted(step, PinholePlane().view))
    moved = replace(calibration, motion=found).shifted(step, PinholePlane().view).motion
    assert moved is not None
    change = (again.mm_per_count - found.mm_per_count)[0]
    assert abs(change) > 5e-5 * 0.02
    assert (moved.mm_per_count - found.mm_per_count)[0] == pytest.approx(change, rel=0.1)


def test_another_body_than_the_one_described_is_refused() -> None:
    stripes, lines = stripes_of(frustum(), 1, 0.02)
    without = replace(true_calibration(frustum()), motion=None)
    with pytest.raises(CalibrationError):
        BeltMotion().motion(stripes, lines, without, PinholePlane(), PYRAMID)


def test_a_calibration_keeps_its_motion(tmp_path: Path) -> None:
    calibration = true_calibration(frustum())
    motion = Motion(
        np.array([0.02, 0.0, 1e-5]), np.eye(3), np.arange(3.0 * len(calibration.covariance)).reshape(3, -1)
    )
    calibration = replace(calibration, motion=motion)
    calibration.save(tmp_path / "with.yaml")
    again = Calibration.load(tmp_path / "with.yaml")
    assert again.motion is not None
    assert np.array_equal(again.motion.mm_per_count, motion.mm_per_count)
    assert np.array_equal(again.motion.per_parameter, motion.per_parameter)
    replace(calibration, motion=None).save(tmp_path / "without.yaml")
    assert "motion" not in (tmp_path / "without.yaml").read_text()
    assert Calibration.load(tmp_path / "without.yaml").motion is None


def written(folder: Path, sim: MovingBelt, name: str = "scan", many: int | None = None) -> int:
    """Write a scan as a tall image with its counts."""
    made = sim.simulate(0, 1)
    assert made.counts is not None
    cv2.imwrite(str(folder / f"{name}.png"), made.frames[0].pixels)
    told = "".join(f"{count},{k}\n" for k, count in enumerate(made.counts[:many]))
    (folder / f"{name}.csv").write_text(f"encoder_count,frame_number\n{told}")
    return len(made.counts)


def rows(folder: Path, sim: MovingBelt, **changes: object) -> list[Measurement]:
    recipe = recipe_of(true_calibration(sim), folder, **changes)
    from roemetry.run.api import Recipe as Running

    return list(Running(**recipe.__dict__).run())


def test_files_become_a_row_with_a_volume_and_its_interval(tmp_path: Path) -> None:
    sim = frustum()
    written(tmp_path, sim)
    (row,) = rows(tmp_path, sim, uncertainty="linear")
    assert row.status == "measured"
    assert row.volume is not None
    low, high = row.volume.visible_mm3.interval
    assert low < TRUE_MM3 < high
    assert high - low < 0.02 * TRUE_MM3
    assert {"motion", "encoder quantum", "belt jitter"} <= set(row.volume.visible_mm3.budget)


def test_parts_measure_what_the_whole_does(tmp_path: Path) -> None:
    sim = frustum()
    written(tmp_path, sim)
    (whole,) = rows(tmp_path, sim)
    options = {"part_lines": 15, "longest_product_lines": 60}
    source = {"use": "belt-scan", "path": ".", "options": options}
    parts = [row for row in rows(tmp_path, sim, source=source) if row.product]
    assert len(parts) == 1
    assert parts[0].volume is not None
    assert whole.volume is not None
    assert parts[0].volume.visible_mm3.value == pytest.approx(whole.volume.visible_mm3.value, rel=1e-3)


def test_a_folder_of_frames_with_counts_in_their_names_is_the_same_scan(tmp_path: Path) -> None:
    sim = frustum()
    tall = tmp_path / "tall"
    tall.mkdir()
    many = written(tall, sim)
    image = cv2.imread(str(tall / "scan.png"), cv2.IMREAD_UNCHANGED)
    (tmp_path / "frames").mkdir()
    for k, frame in enumerate(np.split(image, many)):
        cv2.imwrite(str(tmp_path / "frames" / f"f{k:04d}_c{50 * k}.png"), frame)
    (one,) = rows(tall, sim)
    (other,) = rows(tmp_path, sim, source={"use": "belt-scan", "path": "frames"})
    assert one.volume is not None
    assert other.volume is not None
    assert one.volume.visible_mm3.value == other.volume.visible_mm3.value


@pytest.mark.parametrize(
    ("extractor", "apart_stds"),
    [pytest.param("log-parabola", 1e-9, marks=pytest.mark.thorough), ("gaussian", 0.1)],
)
def test_frames_followed_at_once_are_what_each_is_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extractor: str, apart_stds: float
) -> None:
    """One frame is dark, and one of another size: they are empty, and spoil none of the others."""
    sim = frustum()
    lines = lines_of(sim, 1)
    frames = [lines.frame(k) for k in range(20)]
    frames[5] = replace(frames[5], pixels=np.full_like(frames[5].pixels, 9))
    frames[9] = replace(frames[9], pixels=frames[9].pixels[:80])
    some = ScanLines(frames.__getitem__, lines.count[:20], lines.number[:20], (0, 20))
    calibration = true_calibration(sim)
    recipe = recipe_of(calibration, tmp_path, stages={
        "extractor": extractor, "coder": "single", "triangulator": "pinhole-plane",
    })  # fmt: skip
    stages = {kind: one.make() for kind, one in recipe.stages.items()}

    def followed() -> StripeMap:
        return scan.gather(some, lambda one: one.frames[0], stages, calibration)

    whole = followed()
    monkeypatch.setattr(scan, "_PIXELS_AT_ONCE", 1)
    alone = followed()
    assert np.array_equal(np.isnan(whole.x_px), np.isnan(alone.x_px))
    assert np.isnan(whole.x_px[[5, 9]]).all()
    assert np.nanmedian(np.abs(whole.x_px - alone.x_px) / alone.x_std_px) <= apart_stds
    # what a frame alone estimates of its noise scatters
    assert 0.75 < np.nanmedian(whole.x_std_px / alone.x_std_px) < 1.33


def test_a_scan_that_ends_within_a_product_states_no_number(tmp_path: Path) -> None:
    sim = frustum()
    many = written(tmp_path, sim)
    image = cv2.imread(str(tmp_path / "scan.png"), cv2.IMREAD_UNCHANGED)
    half = many // 2
    cv2.imwrite(str(tmp_path / "scan.png"), image[: half * 160])
    lines = (tmp_path / "scan.csv").read_text().splitlines()[: half + 1]
    (tmp_path / "scan.csv").write_text("\n".join(lines) + "\n")
    (row,) = rows(tmp_path, sim)
    assert row.status == "failed"
    assert row.volume is None
    assert any(reason.code == "cut-by-scan" for reason in row.reasons)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda text: text.replace("encoder_count", "position"), "encoder_count"),
        (lambda text: "\n".join(["encoder_count"] + ["7"] * (text.count("\n") - 1)), "stands still"),
        (lambda text: text.replace("50,1", "fifty,1"), "expected a number"),
    ],
)
def test_counts_that_are_none_are_a_reason(tmp_path: Path, spoil: object, why: str) -> None:
    sim = frustum()
    written(tmp_path, sim)
    path = tmp_path / "scan.csv"
    path.write_text(spoil(path.read_text()))  # type: ignore[operator]
    try:
        found = " ".join(reason.text for row in rows(tmp_path, sim) for reason in row.reasons)
    except Exception as error:
        found = str(error)
    assert why in found


def test_frames_of_another_size_in_the_middle_are_not_seen(tmp_path: Path) -> None:
    sim = frustum()
    written(tmp_path, sim)
    image = cv2.imread(str(tmp_path / "scan.png"), cv2.IMREAD_UNCHANGED)
    frames = np.split(image, image.shape[0] // 160)
    folder = tmp_path / "frames"
    folder.mkdir()
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"f{k:04d}_c{50 * k}.png"), frame if k != 20 else frame[:80])
    (row,) = rows(tmp_path, sim, source={"use": "belt-scan", "path": "frames"})
    assert {"lines-unreadable"} <= {reason.code for reason in row.reasons}
    assert row.volume is not None
    assert row.volume.visible_mm3.value == pytest.approx(TRUE_MM3, rel=0.01)


def test_slip_is_told_by_three_lines_and_only_where_there_is_some() -> None:
    for slip in (0.0, 0.03):
        sim = scene(160, 240, planes=3, family="bread-roll", counts_per_line=50, slip_share=slip)
        stripes, lines = stripes_of(sim, 2, 0.03)
        profiles = BeltMotion().place(stripes, lines, true_calibration(sim), PinholePlane())
        assert ("slip" in {reason.code for reason in profiles.reasons}) == (slip > 0)
        assert profiles.scan is not None
        assert profiles.scan.slip_rel < (0.004 if slip == 0 else 0.08)


def test_a_calibration_without_motion_is_refused_with_what_to_do(tmp_path: Path) -> None:
    sim = frustum()
    recipe = recipe_of(replace(true_calibration(sim), motion=None), tmp_path)
    frame = sim.simulate(0, 1).frames[0]
    lines = ScanLines(lambda k: replace(frame, pixels=frame.pixels[160 * k : 160 * k + 160]),
                      50.0 * np.arange(20), np.arange(20), (0, 20))  # fmt: skip
    trace = measured(recipe, lines, 0)
    assert "how the belt runs" in trace.absent["assembler"].text
    assert not trace.products


def test_a_recipe_of_slices_needs_no_extractor() -> None:
    recipe = Recipe.of({"roemetry": 1, "product": "x", "source": {"use": "height-files", "path": "."},
                        "stages": {"volume": "dense-slices"}})  # fmt: skip
    assert list(recipe.stages) == ["volume", "assembler"]
