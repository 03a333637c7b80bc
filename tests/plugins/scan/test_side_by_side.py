"""Heads side by side: a plate lays one beside the other, and a product across both is measured as one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scans import MovingBelt, MovingBeltOptions, scene, stripes_of, true_calibration
from roemetry.errors import CalibrationError, DataError, StageError
from roemetry.records import Profiles, SpherePlate
from roemetry_pinhole.pinhole_plane import PinholePlane
from roemetry_scan.closed import Registration, ball_centres, first_counts
from roemetry_scan.commands import register_heads, side_by_side
from roemetry_scan.formats import write
from roemetry_scan.formats.points import measured_of
from roemetry_scan.placing import BeltMotion
from roemetry_scan.side_by_side import Joined, joined, register_side_by_side, volume_of, whole_ball_extent

PLATE = SpherePlate("plate", 3, 2, 18.0, 12.0, 20.0, 0.005)
APART_MM = 28.0
RIG = {"rows": 280, "columns": 300, "counts_per_line": 25, "lead_mm": 35.0}
BALLS = {
    "columns": 3, "rows": 2, "pitch_mm": 18, "ball_radius_mm": 6, "margin_mm": 2, "thickness_mm": 3,
    "height_mm": 20, "turn_range_deg": 3,
}  # fmt: skip


def head(side: float, family: str, product: dict[str, object], first_count: int = 0) -> Profiles:
    """Give what a head sees that stands so far to the side of the belt's middle, mm."""
    middle = scene(family=family, product=product, first_count=first_count, **RIG)
    pose = np.eye(4)
    pose[:3, :3] = middle.rig.camera.rotation
    pose[:3, 3] = middle.rig.camera.centre_mm + np.array([0.0, side, 0.0])
    told = middle.options.model_dump()
    told["camera"]["T_belt_camera"] = pose.tolist()
    sim = MovingBelt(MovingBeltOptions.model_validate(told))
    stripes, lines = stripes_of(sim, 5, 0.05)
    belt = BeltMotion()
    return belt.label(belt.place(stripes, lines, true_calibration(sim), PinholePlane()))


def both(family: str, product: dict[str, object], first_count: int = 0) -> list[Profiles]:
    return [head(side, family, product, first_count) for side in (0.5 * APART_MM, -0.5 * APART_MM)]


@pytest.fixture(scope="module")
def plates() -> list[Profiles]:
    return both("ball-plate", BALLS)


def registration_of(plates: list[Profiles], apart_mm: float | None = None) -> Registration:
    looked = whole_ball_extent(plates[0], 6.0), whole_ball_extent(plates[1], 6.0)
    found = register_side_by_side(
        ball_centres(plates[0], PLATE), ball_centres(plates[1], PLATE), looked, apart_mm
    )
    return found._replace(first_counts=first_counts(*plates))


def test_a_plate_lays_one_head_beside_the_other(plates: list[Profiles]) -> None:
    found = registration_of(plates)
    assert found.balls == 6
    np.testing.assert_allclose(found.T_top_bottom[:3, 3], [0.0, -APART_MM, 0.0], atol=0.02)
    np.testing.assert_allclose(found.T_top_bottom[:3, :3], np.eye(3), atol=1e-3)


@pytest.mark.parametrize("first_count", [0, 4000])
def test_a_product_across_two_heads_is_measured_as_one(plates: list[Profiles], first_count: int) -> None:
    """Neither sees all of the roll, which is 60 mm wide; counts begin elsewhere than the plate's did."""
    roll = {"kinds": {"healthy": 1}, "length_range_mm": [58, 60], "width_range_mm": [60, 62]}
    heads = both("bread-roll", roll, first_count)
    wide = joined(heads, [registration_of(plates)])
    assert abs(wide.level_mm[0]) < 0.02
    labelled = BeltMotion().label(wide.profiles)
    assert labelled.product.max() == 1
    volume = volume_of(wide, labelled, 1)
    drawn = scene(family="bread-roll", product=roll, **RIG).drawn(0, 5)
    assert drawn is not None
    true_mm3 = drawn.truth.visible_mm3
    assert volume.value == pytest.approx(true_mm3, rel=0.015)
    assert volume.interval[0] < true_mm3 < volume.interval[1]
    assert volume.budget["heads"] > 0.0


def test_heads_that_disagree_or_share_nothing_are_refused(plates: list[Profiles]) -> None:
    told = registration_of(plates)
    raised = told.T_top_bottom.copy()
    raised[2, 3] += 0.8
    with pytest.raises(StageError, match=r"heights differ by \+0.80 mm"):
        joined(plates, [told._replace(T_top_bottom=raised)])
    away = told.T_top_bottom.copy()
    away[1, 3] -= 60.0
    with pytest.raises(StageError, match="no strip"):
        joined(plates, [told._replace(T_top_bottom=away)])
    late = told.T_top_bottom.copy()
    late[0, 3] += 1000.0
    with pytest.raises(StageError, match="no part of the belt"):
        joined(plates, [told._replace(T_top_bottom=late)])


GRID = np.array([[18.0 * i, 18.0 * j, 20.0] for i in range(4) for j in range(2)])
WIDE = np.array([[-100.0, -100.0], [200.0, 200.0]])


def test_balls_that_tell_no_one_motion_are_refused() -> None:
    """Too few, in a line, of another plate, or a part of a grid that fits in two ways."""
    beside = GRID - [0.0, 28.0, 0.0]
    whole = register_side_by_side(GRID, beside, (WIDE, WIDE))
    assert whole.balls == 8
    np.testing.assert_allclose(whole.T_top_bottom[:3, 3], [0.0, 28.0, 0.0], atol=1e-9)
    with pytest.raises(CalibrationError, match="three that both see"):
        register_side_by_side(GRID[:2], beside, (WIDE, WIDE))
    with pytest.raises(CalibrationError, match="one line"):
        register_side_by_side(GRID[::2], beside[::2], (WIDE, WIDE))
    with pytest.raises(CalibrationError, match="do not share"):
        register_side_by_side(GRID, 1.2 * beside, (WIDE, WIDE))
    rows = np.array([[18.0 * i, 18.0 * j, 20.0] for i in range(2) for j in range(5)])
    left, right = rows[rows[:, 1] > 20.0], rows[rows[:, 1] < 60.0] - [0.0, 28.0, 0.0]
    ends = np.array([[-100.0, 20.0], [200.0, 200.0]]), np.array([[-100.0, -200.0], [200.0, 32.0]])
    with pytest.raises(CalibrationError, match="fit in"):
        register_side_by_side(left, right, ends)
    assert register_side_by_side(left, right, ends, 28.0).T_top_bottom[1, 3] == pytest.approx(28.0)


def test_the_commands_join_files_of_two_heads(tmp_path: Path, plates: list[Profiles]) -> None:
    (tmp_path / "plate.yaml").write_text(
        "kind: sphere-plate\nname: plate\ncolumns: 3\nrows: 2\npitch_mm: 18\ndiameter_mm: 12\n"
        "centre_height_mm: 20\ntolerance_mm: 0.005\n"
    )
    fillet = both("fillet", {"kinds": {"healthy": 1}})
    recipes = {}
    for name, profiles in zip(("plate_l", "plate_r", "l", "r"), [*plates, *fillet], strict=True):
        # files know no counts: their X goes on from the first line's
        write(tmp_path / f"{name}.ply", measured_of(replace(profiles, scan=None)))
        recipes[name] = tmp_path / f"{name}.yaml"
        recipes[name].write_text(
            f"roemetry: 1\nproduct: {name}\nsource: {{use: height-files, path: {name}.ply}}\n"
            "stages: {volume: dense-slices}\n"
        )
    told = tmp_path / "registration.yaml"
    register_heads(recipes["plate_l"], recipes["plate_r"], tmp_path / "plate.yaml", told, beside=True)
    out = tmp_path / "wide"
    side_by_side([recipes["l"], recipes["r"]], [told], out)
    table = (out / "side_by_side.csv").read_text().splitlines()
    assert len(table) == 2
    assert (out / "l.ply").exists()
    drawn = scene(family="fillet", product={"kinds": {"healthy": 1}}, **RIG).drawn(0, 5)
    assert drawn is not None
    assert float(table[1].split(",")[2]) * 1000.0 == pytest.approx(drawn.truth.visible_mm3, rel=0.01)
    with pytest.raises(DataError, match="one for each two neighbours"):
        side_by_side([recipes["l"], recipes["r"]], [told, told], out)
    two_sided = tmp_path / "other.yaml"
    two_sided.write_text(told.read_text().replace("T_left_right", "T_top_bottom"))
    with pytest.raises(CalibrationError, match="no registration"):
        side_by_side([recipes["l"], recipes["r"]], [two_sided], out)
    assert isinstance(joined(plates, [registration_of(plates)]), Joined)
