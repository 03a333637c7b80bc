"""Scans from frames to volumes: the belt, the motion, products, parts, and what is bad input."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from benchmarks.scans import (
    PYRAMID,
    drawn_calibration,
    measured,
    recipe_of,
    scene,
    stripes_of,
    true_calibration,
)
from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError, DataError, StageError
from roemetry.records import Frame, Measurement, Profiles, ScanLines, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.records.scan import Motion
from roemetry.run import scan
from roemetry.run.api import Recipe as Running
from roemetry.run.open_parts import split_products
from roemetry_pinhole.pinhole_plane import PinholePlane
from roemetry_scan.belt import BeltOptions, products_on
from roemetry_scan.dense import DenseSlices
from roemetry_scan.line_ends import line_ends
from roemetry_scan.placing import BeltMotion
from roemetry_scan.scan_source import BeltScan
from roemetry_scan.torn_lines import torn_lines

FRUSTUM = {"length_mm": 40, "width_mm": 30, "top_share": 0.5, "height_mm": 12}
TRUE_MM3 = 40 * 30 * 12 * (1 + 0.5 + 0.25) / 3
SIM = scene(160, 160, family="truncated-pyramid", product=FRUSTUM, counts_per_line=50)
RIG = true_calibration(SIM)
assert RIG.motion is not None
MOTION = RIG.motion
Scan = tuple[StripeMap, ScanLines]


@pytest.fixture(scope="module")
def seen() -> Scan:
    """Stripes and lines of the frustum's scan."""
    return stripes_of(SIM, 1, 0.02)


@pytest.fixture(scope="module")
def frames() -> list[np.ndarray]:
    """The frustum's frames; their counts are 50 apart."""
    image = SIM.simulate(0, 1).frames[0].pixels
    return np.split(image, len(image) // 160)


def volume(seen: Scan, calibration: Calibration = RIG) -> float:
    stripes, lines = seen
    assembler = BeltMotion()
    profiles = assembler.label(assembler.place(stripes, lines, calibration, PinholePlane()))
    (product,) = split_products(profiles, (), calibration, "scan")
    return DenseSlices().estimate(product).visible_mm3.value


def test_the_volume_of_a_frustum_is_its_own_also_where_the_belt_climbs(seen: Scan) -> None:
    found = volume(seen)
    assert found == pytest.approx(TRUE_MM3, rel=2e-3)
    longer = replace(MOTION, mm_per_count=1.01 * MOTION.mm_per_count)
    assert volume(seen, replace(RIG, motion=longer)) / found == pytest.approx(1.01, abs=1e-4)
    # zero leans by 0.5° against the way the belt runs: the belt is fitted where it moves
    lean = np.radians(0.5)
    way = MOTION.mm_per_count[0] * np.array([np.cos(lean), 0.0, np.sin(lean)])
    climbing = replace(RIG, motion=replace(MOTION, mm_per_count=way))
    assert volume(seen, climbing) == pytest.approx(found, rel=2e-3)


def placed(stripes: StripeMap, lines: ScanLines, calibration: Calibration = RIG) -> Profiles:
    assembler = BeltMotion()
    return assembler.label(assembler.place(stripes, lines, calibration, PinholePlane()))


def test_a_belt_beside_its_calibrated_place_widens_the_interval_by_what_a_moved_camera_does(
    seen: Scan,
) -> None:
    stripes, lines = seen
    moved = replace(stripes, x_px=stripes.x_px + 4.0)
    figures = [placed(one, lines).scan for one in (stripes, moved)]
    assert figures[0] is not None and figures[1] is not None
    assert figures[0].belt_off_rel_std < 1e-4
    error = volume((moved, lines)) / volume(seen) - 1.0
    # uniform up to the greatest error: half as much again as that of the moved camera
    assert figures[1].belt_off_rel_std == pytest.approx(1.5 * abs(error) / np.sqrt(3.0), rel=0.25)
    assert "belt-off-zero" in [reason.code for reason in placed(moved, lines).reasons]


def test_a_belt_that_climbs_lies_where_it_was_calibrated(seen: Scan) -> None:
    way = MOTION.mm_per_count * [1.0, 1.0, 0.0] + 0.01 * MOTION.mm_per_count[0] * np.eye(3)[2]
    figures = placed(*seen, replace(RIG, motion=replace(MOTION, mm_per_count=way))).scan
    assert figures is not None
    assert figures.belt_off_rel_std < 1e-4


def ending(stripes: StripeMap, first: float, last: float) -> StripeMap:
    """Give the stripes of a line of light that ends at these rows, under a lens that blurs by 0.7 px."""
    row = np.arange(stripes.rows)
    light = ndtr((row - first) / 0.7) * ndtr((last - row) / 0.7)
    faded = replace(stripes, x_std_px=np.broadcast_to(0.02 / np.maximum(light, 0.1), stripes.x_px.shape))
    return showing(faded, np.where(light > 0.15, stripes.x_px, np.nan))


def showing(stripes: StripeMap, x_px: np.ndarray) -> StripeMap:
    """Give the stripes at other places; NaN where none are seen."""
    unseen = np.isnan(x_px)
    return replace(
        stripes,
        x_px=x_px,
        x_std_px=np.where(unseen, np.nan, stripes.x_std_px),
        product=np.where(unseen, np.int16(-1), np.int16(1)),
        seen=~unseen,
    )


@pytest.mark.parametrize("first", [9.0, 9.3, 9.6])
def test_a_line_ends_where_half_of_its_light_is_left(seen: Scan, first: float) -> None:
    found = ending(seen[0], first, 150.0 - first)
    ends = line_ends(found.x_px, found.x_std_px)
    assert np.allclose(ends, [first, 150.0 - first], atol=0.25)
    whole = line_ends(seen[0].x_px, np.full_like(seen[0].x_px, 0.02))
    assert np.isnan(whole).all()  # it reaches the image's sides


@pytest.mark.parametrize("longer", [0.0, 0.008, -0.008, 0.02])
def test_a_line_that_is_longer_than_at_calibration_widens_the_interval_or_refuses(
    seen: Scan, longer: float
) -> None:
    stripes, lines = seen
    calibrated = ending(stripes, 10.0, 150.0)
    ends = line_ends(calibrated.x_px, calibrated.x_std_px)
    rig = replace(RIG, motion=replace(MOTION, line_ends_rows=ends))
    other = ending(stripes, 10.0 - 70.0 * longer, 150.0 + 70.0 * longer)
    if longer > 0.01:
        with pytest.raises(StageError, match=r"the line of light on the belt is [12].\d% longer"):
            placed(other, lines, rig)
        return
    profiles = placed(other, lines, rig)
    assert profiles.scan is not None
    # areas change by twice as much, and the more, the likelier; ends are known to a tenth of a row
    expected = 2.0 * np.hypot(longer / np.sqrt(2.0), 0.1 * np.sqrt(2.0) / 140.0)
    assert profiles.scan.line_length_rel_std == pytest.approx(expected, abs=0.004)  # ends to 0.2 rows
    assert ("line-length" in [reason.code for reason in profiles.reasons]) == (longer != 0.0)
    (product,) = split_products(profiles, (), rig, "scan")
    budget = DenseSlices().estimate(product).visible_mm3.budget
    assert budget["length of the line"] == pytest.approx(
        profiles.scan.line_length_rel_std * volume((other, lines), rig), rel=1e-3
    )


def test_a_line_without_ends_says_nothing_of_its_length(seen: Scan) -> None:
    figures = placed(*seen).scan
    assert figures is not None and np.isnan(figures.line_length_rel_std)


@pytest.mark.parametrize("together", [1, 2])
def test_a_line_of_which_a_part_is_another_frames_is_not_used_and_more_of_them_are_refused(
    seen: Scan, together: int
) -> None:
    stripes, lines = seen
    x_px = stripes.x_px.copy()
    whole = placed(stripes, lines)
    on = whole.frame[(whole.product[:, 70:90] > 0).all(axis=1) & (whole.xyz_mm[:, 80, 2] > 8.0)]
    torn = on[4] + np.arange(together)
    x_px[torn, 70:90] = stripes.x_px[0, 70:90]  # the bare belt's
    broken = replace(stripes, x_px=x_px)
    if together > 1:
        with pytest.raises(StageError, match=f"2 of {len(lines.count)} lines do not continue"):
            placed(broken, lines)
        return
    profiles = placed(broken, lines)
    assert sorted(set(whole.frame.tolist()) - set(profiles.frame.tolist())) == torn.tolist()
    assert "lines-torn" in [reason.code for reason in profiles.reasons]
    assert volume((broken, lines)) == pytest.approx(volume(seen), rel=2e-3)


@pytest.mark.parametrize("lost_rows", [2, 6])
def test_a_line_that_lost_rows_ends_elsewhere_than_its_neighbours(seen: Scan, lost_rows: int) -> None:
    stripes, lines = seen
    found = ending(stripes, 10.0, 150.0)
    whole = placed(found, lines)
    assert whole.scan is not None and whole.scan.damaged == 0
    x_px, torn = found.x_px.copy(), 20
    x_px[torn, 80:-lost_rows] = found.x_px[torn, 80 + lost_rows :]
    profiles = placed(showing(found, x_px), lines)
    assert profiles.scan is not None and profiles.scan.damaged == 1
    assert torn not in profiles.frame
    (product,) = split_products(profiles, (), RIG, "scan")
    estimate = DenseSlices().estimate(product).visible_mm3
    assert estimate.budget["damaged lines"] == pytest.approx(3.0 / len(lines.count) * estimate.value)


@pytest.mark.parametrize("turned", [False, True], ids=["first-rows", "last-rows"])
@pytest.mark.parametrize("rows", [120, 400])
def test_a_line_whose_last_rows_are_cut_off_by_a_shadow_is_used(turned: bool, rows: int) -> None:
    """The plate of `recipes/two_heads`: beside its balls 18 rows were left, fewer than tell a line's end.

    In 400 rows both ends lie in one half of the image.
    """
    height_mm = np.full((41, rows), np.nan)
    seen = height_mm[:, :120][:, ::-1] if turned else height_mm[:, :120]
    seen[:, 10:110] = 0.0
    seen[20, 28:36] = np.nan
    assert not torn_lines(height_mm, 2).any()
    seen[20, 10:28] = np.nan  # nothing is seen out there: the line ends elsewhere
    assert np.flatnonzero(torn_lines(height_mm, 2)).tolist() == [20]
    seen[20, :110] = 0.0  # it reaches farther than its neighbours
    assert np.flatnonzero(torn_lines(height_mm, 2)).tolist() == [20]


def test_a_line_that_shows_nothing_where_its_neighbours_do_is_not_used(seen: Scan) -> None:
    stripes, lines = seen
    x_px, whole = stripes.x_px.copy(), placed(stripes, lines)
    on = whole.frame[(whole.product[:, 60:100] > 0).all(axis=1) & (whole.xyz_mm[:, 80, 2] > 8.0)]
    x_px[on[4], 65:95] = np.nan
    dark = showing(stripes, x_px)
    profiles = placed(dark, lines)
    assert on[4] not in profiles.frame
    assert volume((dark, lines)) == pytest.approx(volume(seen), rel=2e-3)


def test_frames_that_cannot_be_used_are_left_out_and_more_of_them_are_refused(
    tmp_path: Path, frames: list[np.ndarray]
) -> None:
    spoiled = [frame.copy() for frame in frames]
    for line, damaged in ((20, 1), (30, 2)):
        spoiled[line][:, 60:] = np.roll(spoiled[line], 40, axis=1)[:, 60:]  # broken off at a column
        spoiled[line][60:, :60] = 200
        written(tmp_path, spoiled)
        row = rows(tmp_path, uncertainty="linear")[0]
        if damaged == 1:
            assert row.volume is not None
            assert row.volume.visible_mm3.budget["damaged lines"] > 0.0
        else:
            told = " ".join(reason.text for reason in (*row.absent.values(), *row.reasons))
            assert f"2 of {len(frames)} frames cannot be used" in told


def test_a_slice_that_ends_before_the_product_does_may_be_larger_by_what_is_not_seen(seen: Scan) -> None:
    stripes, lines = seen
    whole = placed(stripes, lines)
    assert whole.unseen_margin_mm3[1] < 2e-3 * TRUE_MM3
    cut = np.isin(np.arange(stripes.rows), np.arange(100, 145))[None, :]
    dim = showing(stripes, np.where(cut, np.nan, stripes.x_px))
    lost = volume(seen) - volume((dim, lines))
    assert lost > 0.1 * TRUE_MM3
    assert lost < placed(dim, lines).unseen_margin_mm3[1] < 2.0 * lost


def test_what_is_dark_between_two_products_or_up_to_the_image_s_side_belongs_to_one_slice(seen: Scan) -> None:
    """A gap in the middle of a product: each half may reach the other, and not the belt beyond it."""
    stripes, lines = seen
    for dark, most in ((np.arange(60, 100), 1.0), (np.arange(100, 160), 2.0)):
        cut = np.isin(np.arange(stripes.rows), dark)[None, :]
        dim = showing(stripes, np.where(cut, np.nan, stripes.x_px))
        whole, parts = placed(stripes, lines), placed(dim, lines)
        lost = np.nansum(np.where(whole.product > 0, whole.xyz_mm[..., 2], 0.0)[:, dark]) * _cell_mm2(whole)
        for number in range(1, parts.product.max() + 1):
            assert 0.7 * lost < parts.unseen_margin_mm3[number] < (0.7 + most) * lost


def _cell_mm2(profiles: Profiles) -> float:
    """Give what a point stands for, mm²."""
    assert profiles.scan is not None
    return profiles.scan.pitch_mm * float(np.nanmedian(np.abs(np.diff(profiles.xyz_mm[..., 1], axis=1))))


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 45.0])
def test_ridges_and_oblique_edges_are_not_torn(turn_deg: float) -> None:
    """A box, and a roof over it whose ridge runs across the belt or obliquely, at coarse and fine lines."""
    angle = np.radians(turn_deg)
    for pitch, row in ((2.0, 0.1), (2.0, 0.25), (0.5, 0.25)):
        x, y = np.meshgrid(np.arange(-30.0, 30.0, pitch), np.arange(-30.0, 30.0, row), indexing="ij")
        u, v = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        on = (np.abs(u) < 15.0) & (np.abs(v) < 15.0)
        for height in (np.full_like(u, 10.0), 10.0 - 0.6 * np.abs(u)):
            assert not torn_lines(np.where(on, height, 0.0), int(np.ceil(2.0 * pitch / row))).any()


def test_a_sound_scan_has_no_torn_line(seen: Scan) -> None:
    assert "lines-torn" not in [reason.code for reason in placed(*seen).reasons]


def test_a_stray_peak_that_was_left_out_stays_out_where_a_flank_is_followed(seen: Scan) -> None:
    """Of what is placed again with a moved calibration: its height was taken for that of the product."""
    stripes, lines = seen
    assembler = BeltMotion()
    profiles = assembler.label(assembler.place(stripes, lines, RIG, PinholePlane()))
    line, row = np.argwhere(profiles.seen & (profiles.product > 0))[500]
    left = profiles.seen.copy()
    left[line, row] = False
    kept, _ = scan.placed_only(stripes, lines, replace(profiles, seen=left), 0)
    assert np.isnan(kept.x_px[line, row])
    assert np.array_equal(np.isfinite(kept.x_px), left)


LARGE = {"length_mm": 70, "width_mm": 70, "top_share": 0.4, "height_mm": 20, "turn_range_deg": 15}


@pytest.mark.parametrize("mm_per_count", [(0.021, 0.0005), (-0.019, -0.0003)])
def test_one_pass_of_a_frustum_tells_the_motion(mm_per_count: tuple[float, float]) -> None:
    sim = scene(
        360, 260, family="truncated-pyramid", mm_per_count=mm_per_count, counts_per_line=40, product=LARGE
    )
    stripes, lines = stripes_of(sim, 3, 0.05)
    without = replace(true_calibration(sim), motion=None)
    right = mm_per_count[0] > 0
    found, _ = BeltMotion().motion(stripes, lines, without, PinholePlane(), PYRAMID, right=right)
    true = np.array([*mm_per_count, 0.0])
    assert np.abs(found.mm_per_count - true).max() < 5e-4 * np.abs(true).max()
    assert (np.abs(found.mm_per_count - true) < 5 * np.sqrt(np.diag(found.covariance))).all()


def test_a_counter_that_counts_down_shows_no_mirror_image(seen: Scan) -> None:
    stripes, lines = seen
    down = replace(RIG, motion=replace(MOTION, mm_per_count=-MOTION.mm_per_count))
    found = BeltMotion().place(stripes, lines, RIG, PinholePlane())
    again = BeltMotion().place(stripes, replace(lines, count=-lines.count), down, PinholePlane())
    assert np.allclose(again.xyz_mm, found.xyz_mm, equal_nan=True, atol=1e-9)


def test_a_motion_moves_with_the_calibration_it_was_found_with() -> None:
    """A scale that is wrong makes belt's way and products larger together: no root of squares holds that."""
    sim = scene(240, 200, family="truncated-pyramid", counts_per_line=60, product=LARGE)
    stripes, lines = stripes_of(sim, 3, 0.02)
    calibration, view = drawn_calibration(sim, np.random.default_rng(5)), PinholePlane().view

    def motion_by(one: Calibration) -> Motion:
        return BeltMotion().motion(stripes, lines, one, PinholePlane(), PYRAMID)[0]

    # of a focal length
    step = max(calibration.independent_steps(), key=lambda one: float(np.abs(one[:2]).max()))
    found, again = motion_by(calibration), motion_by(calibration.shifted(step, view))
    moved = replace(calibration, motion=found).shifted(step, view).motion
    assert moved is not None
    change = (again.mm_per_count - found.mm_per_count)[0]
    assert abs(change) > 5e-5 * 0.02
    assert (moved.mm_per_count - found.mm_per_count)[0] == pytest.approx(change, rel=0.1)


def test_another_body_than_the_one_described_is_refused(seen: Scan) -> None:
    with pytest.raises(CalibrationError):
        BeltMotion().motion(*seen, replace(RIG, motion=None), PinholePlane(), PYRAMID)


def test_a_calibration_keeps_its_motion(tmp_path: Path) -> None:
    per_parameter = np.arange(3.0 * len(RIG.covariance)).reshape(3, -1)
    motion = Motion(np.array([0.02, 0.0, 1e-5]), np.eye(3), per_parameter, np.array([5.25, 223.5]))
    replace(RIG, motion=motion).save(tmp_path / "with.yaml")
    again = Calibration.load(tmp_path / "with.yaml").motion
    assert again is not None
    assert np.array_equal(again.mm_per_count, motion.mm_per_count)
    assert np.array_equal(again.per_parameter, motion.per_parameter)
    assert np.array_equal(again.line_ends_rows, motion.line_ends_rows)
    replace(RIG, motion=None).save(tmp_path / "without.yaml")
    assert Calibration.load(tmp_path / "without.yaml").motion is None


def written(folder: Path, frames: list[np.ndarray]) -> Path:
    """Write a scan as a tall image, and its table of counts, whose path is given."""
    cv2.imwrite(str(folder / "scan.png"), np.concatenate(frames))
    told = "".join(f"{50 * k},{k}\n" for k in range(len(frames)))
    (folder / "scan.csv").write_text(f"encoder_count,frame_number\n{told}")
    return folder / "scan.csv"


def rows(folder: Path, **changes: object) -> list[Measurement]:
    return list(Running(**recipe_of(RIG, folder, **changes).__dict__).run())


def value(row: Measurement) -> float:
    assert row.volume is not None
    return row.volume.visible_mm3.value


def test_files_become_a_row_with_a_volume_and_its_interval(tmp_path: Path, frames) -> None:
    written(tmp_path, frames)
    (row,) = rows(tmp_path, uncertainty="linear")
    assert row.status == "measured"
    assert row.volume is not None
    low, high = row.volume.visible_mm3.interval
    assert low < TRUE_MM3 < high
    assert high - low < 0.02 * TRUE_MM3
    assert {"motion", "encoder quantum", "belt jitter"} <= set(row.volume.visible_mm3.budget)


def test_parts_and_single_frames_measure_what_the_whole_does(tmp_path: Path, frames) -> None:
    """Frames have their counts in their names; one of another size is not seen."""
    written(tmp_path, frames)
    (whole,) = rows(tmp_path, uncertainty="none")
    options = {"part_lines": 15, "longest_product_lines": 60}
    source = {"use": "belt-scan", "path": ".", "options": options}
    (parts,) = (row for row in rows(tmp_path, source=source, uncertainty="none") if row.product)
    assert value(parts) == pytest.approx(value(whole), rel=1e-3)
    folder = tmp_path / "frames"
    folder.mkdir()
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"f{k:04d}_c{50 * k}.png"), frame)
    source = {"use": "belt-scan", "path": "frames"}
    (single,) = rows(tmp_path, source=source, uncertainty="none")
    assert value(single) == value(whole)
    cv2.imwrite(str(folder / "f0020_c1000.png"), frames[20][:80])
    (row,) = rows(tmp_path, source=source, uncertainty="none")
    (unread,) = (reason.text for reason in row.reasons if reason.code == "lines-unreadable")
    assert "frame 20 is" in unread
    assert "80 pixels" in unread
    assert value(row) == pytest.approx(TRUE_MM3, rel=0.01)


def test_frames_that_the_table_of_counts_leaves_out_are_named(tmp_path: Path, frames) -> None:
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), frames[k])
    table = "file,encoder_count\n" + "".join(f"f{k}.png,{50 * k}\n" for k in (0, 1, 3))
    (tmp_path / "counts.csv").write_text(table)
    with pytest.raises(DataError, match=r"1 frames of the folder have no line in it, f2\.png first"):
        BeltScan().references(tmp_path)
    (tmp_path / "counts.csv").write_text(table + "f2.png,\n")
    assert len(BeltScan().references(tmp_path)) == 1


def test_frames_decoded_ahead_are_those_of_their_lines_in_any_order(tmp_path: Path, frames) -> None:
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"c{50 * k}.png"), frame)
    (tmp_path / "c1000.png").write_bytes(b"damaged")
    source = BeltScan()
    (reference,) = source.references(tmp_path)
    lines = source.read(reference).lines
    assert lines is not None
    with pytest.raises(DataError, match="c1000"):
        lines.frame(20)
    lines.frame(0)
    again = pickle.loads(pickle.dumps(lines.frame))  # while the next ones are decoded
    for read in (lines.frame, again):
        for k in (*range(19), 3, 21, *range(17, 20), len(frames) - 1, *range(21, len(frames))):
            assert np.array_equal(read(k).pixels, frames[k])


def test_frames_decoded_ahead_and_not_asked_for_are_dropped(tmp_path: Path, frames) -> None:
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"c{50 * k}.png"), frame)
    source = BeltScan()
    (reference,) = source.references(tmp_path)
    lines = source.read(reference).lines
    assert lines is not None
    for k in range(len(frames)):
        if k % 3:
            lines.frame(k)
            assert len(lines.frame._ahead) <= 5


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_decodes_with_threads_of_its_own(tmp_path: Path, frames) -> None:
    for k, frame in enumerate(frames[:10]):
        cv2.imwrite(str(tmp_path / f"c{50 * k}.png"), frame)
    code = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from roemetry_scan.scan_source import BeltScan\n"
        "source = BeltScan()\n"
        "(reference,) = source.references(Path(sys.argv[1]))\n"
        "lines = source.read(reference).lines\n"
        "lines.frame(0)\n"
        "child = os.fork()\n"
        "if not child:\n"
        "    signal.alarm(30)\n"
        "    for k in range(1, 10):\n"
        "        lines.frame(k)\n"
        "    os._exit(7)\n"
        "sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)]).returncode == 7


@pytest.mark.parametrize(
    ("extractor", "apart_stds"),
    [pytest.param("log-parabola", 1e-9, marks=pytest.mark.thorough), ("gaussian", 0.1)],
)
def test_frames_followed_at_once_are_what_each_is_alone(
    tmp_path: Path, frames, monkeypatch: pytest.MonkeyPatch, extractor: str, apart_stds: float
) -> None:
    """One frame is dark, and one of another size: they are empty, and spoil none of the others."""
    given = [Frame(pixels, sensor=SIM.sensor()) for pixels in frames[:20]]
    given[5] = replace(given[5], pixels=np.full_like(given[5].pixels, 9))
    given[9] = replace(given[9], pixels=given[9].pixels[:80])
    some = ScanLines(given.__getitem__, 50.0 * np.arange(20), np.arange(20), (0, 20))
    told = {"extractor": extractor, "coder": "single", "triangulator": "pinhole-plane"}
    stages = {kind: one.make() for kind, one in recipe_of(RIG, tmp_path, stages=told).stages.items()}

    def followed() -> StripeMap:
        return scan.gather(some, lambda one: one.frames[0], stages, RIG)

    whole = followed()
    monkeypatch.setattr(scan, "_PIXELS_AT_ONCE", 1)
    alone = followed()
    assert np.array_equal(np.isnan(whole.x_px), np.isnan(alone.x_px))
    assert np.isnan(whole.x_px[[5, 9]]).all()
    assert np.nanmedian(np.abs(whole.x_px - alone.x_px) / alone.x_std_px) <= apart_stds
    # what a frame alone estimates of its noise scatters
    assert 0.75 < np.nanmedian(whole.x_std_px / alone.x_std_px) < 1.33


def test_a_scan_that_ends_within_a_product_states_no_number(tmp_path: Path, frames) -> None:
    written(tmp_path, frames[: len(frames) // 2])
    (row,) = rows(tmp_path, uncertainty="none")
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
def test_counts_that_are_none_are_a_reason(
    tmp_path: Path, frames, spoil: Callable[[str], str], why: str
) -> None:
    path = written(tmp_path, frames)
    path.write_text(spoil(path.read_text()))
    try:
        found = " ".join(reason.text for row in rows(tmp_path) for reason in row.reasons)
    except Exception as error:
        found = str(error)
    assert why in found


def test_slip_is_told_by_three_lines_and_only_where_there_is_some() -> None:
    for slip in (0.0, 0.03):
        sim = scene(160, 240, planes=3, family="bread-roll", counts_per_line=50, slip_share=slip)
        stripes, lines = stripes_of(sim, 2, 0.03)
        profiles = BeltMotion().place(stripes, lines, true_calibration(sim), PinholePlane())
        assert ("slip" in {reason.code for reason in profiles.reasons}) == (slip > 0)
        assert profiles.scan is not None
        assert profiles.scan.slip_rel < (0.004 if slip == 0 else 0.08)


def test_a_calibration_without_motion_is_refused_with_what_to_do(tmp_path: Path, frames) -> None:
    recipe = recipe_of(replace(RIG, motion=None), tmp_path)
    lines = ScanLines(lambda k: Frame(frames[k]), 50.0 * np.arange(20), np.arange(20), (0, 20))
    trace = measured(recipe, lines, 0)
    assert "how the belt runs" in trace.absent["assembler"].text
    assert not trace.products


def test_a_recipe_of_slices_needs_no_extractor() -> None:
    told = {"source": {"use": "height-files", "path": "."}, "stages": {"volume": "dense-slices"}}
    recipe = Recipe.of({"roemetry": 1, "product": "x", **told})
    assert list(recipe.stages) == ["volume", "assembler"]


def test_single_points_that_faint_light_leaves_out_are_no_torn_line(
    seen: Scan, rng: np.random.Generator
) -> None:
    """As on a face that falls away from the light: half of each line's points are missing, in no order."""
    stripes, lines = seen
    whole = placed(stripes, lines)
    high = (whole.product > 0) & (whole.xyz_mm[..., 2] > 1.0)
    on = np.flatnonzero(high.sum(axis=1) > 40)[:8]
    x_px = stripes.x_px.copy()
    for k in on:
        x_px[whole.frame[k], high[k] & (rng.random(x_px.shape[1]) < 0.5)] = np.nan
    assert not set(whole.frame) - set(placed(showing(stripes, x_px), lines).frame)


@pytest.mark.parametrize("second", [False, True])
def test_a_line_that_lost_rows_is_torn_beside_another_product_too(
    second: bool, rng: np.random.Generator
) -> None:
    height_mm = rng.normal(0.0, 0.02, (41, 400))
    height_mm[:, 100:180] += 10.0
    height_mm[:, 240:320] += 10.0 * second
    height_mm[20, 110:160] = np.nan
    assert np.flatnonzero(torn_lines(height_mm, 2)).tolist() == [20]


def test_belt_at_the_far_edge_of_a_shadow_is_no_product() -> None:
    """A dome, its shadow beside it, and behind that two points which the cut-off line has lifted."""
    x, y = np.meshgrid(np.arange(40.0), 0.25 * np.arange(200.0), indexing="ij")
    inside = 1.0 - ((x - 20.0) / 12.0) ** 2 - ((y - 25.0) / 10.0) ** 2
    height_mm = np.where(inside > 0.0, 6.0 + 6.0 * np.sqrt(np.maximum(inside, 0.0)), 0.0)
    shadow = (inside <= 0.0) & (y > 25.0) & (y < 36.0) & (np.abs(x - 20.0) < 10.0)
    height_mm[shadow] = np.nan
    lifted = (y >= 36.0) & (y < 36.5) & (np.abs(x - 20.0) < 10.0)
    height_mm[lifted] = 0.25
    height_mm[(np.abs(x - 20.0) < 10.0) & (y == 35.5)] = 0.3  # dim light within the shadow
    number = products_on(height_mm, (1.0, 0.25), 0.0, BeltOptions(gap_mm=6.0))
    assert (number[inside > 0.0] == 1).all()
    assert not (number[inside <= 0.0] > 0).any()
