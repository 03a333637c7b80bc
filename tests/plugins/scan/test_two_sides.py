"""Two heads: balls lay one head on the other, and sections of top and bottom close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import CalibrationError, StageError
from roemetry.records import Profiles, ScanFigures
from roemetry_scan.closed import CAUSES, Registration, closed_volume, registered
from roemetry_scan.commands import register_heads, two_sides
from roemetry_scan.formats import write
from roemetry_scan.formats.points import Measured, profiles_of

FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
LIFTED = FLIPPED.copy()
LIFTED[2, 3] = 20.0


def seen(height: Callable[[np.ndarray, np.ndarray], np.ndarray], least_mm: float = 0.5) -> Profiles:
    """Slices of a body on a belt at Z = 0; what lies lower than `least_mm` is not seen."""
    x, y = np.meshgrid(np.arange(-30, 30, 0.5), np.arange(25, -25, -0.25), indexing="ij")
    z = height(x, y)
    found = profiles_of(Measured(np.stack([x, y, np.where(z > least_mm, z, 0.0)], axis=-1)), None, "body")
    label = (found.xyz_mm[..., 2] > 0).astype(np.int16)
    return Profiles(
        found.xyz_mm, label, found.seen, found.x_px, found.row_px, found.height_std_mm, found.stripe,
        found.frame, found.plane,
    )  # fmt: skip


def ellipsoid(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Upper half of one with the axes 24, 16 and 10 mm, whose middle lies 10 mm over the belt."""
    inside = 1.0 - (x / 24.0) ** 2 - (y / 16.0) ** 2
    return np.where(inside > 0, 10.0 + 10.0 * np.sqrt(np.maximum(inside, 0.0)), 0.0)


TRUE = 4.0 / 3.0 * np.pi * 24.0 * 16.0 * 10.0


@pytest.mark.parametrize("least_mm", [10.01, 12.0])
def test_what_neither_head_sees_of_an_ellipsoid_is_followed(least_mm: float) -> None:
    side = seen(ellipsoid, least_mm)
    found = closed_volume(side, side, Registration(LIFTED, 0.005, 9))
    assert found.value == pytest.approx(TRUE, rel=0.01)
    assert found.interval[0] < TRUE < found.interval[1]
    assert tuple(found.budget) == CAUSES


def test_a_registration_that_is_off_is_in_the_budget_and_the_volume() -> None:
    side = seen(ellipsoid, 12.0)
    footprint = np.pi * 24.0 * 16.0
    raised = LIFTED.copy()
    raised[2, 3] = 20.1
    lower = closed_volume(side, side, Registration(LIFTED, 0.3, 11))
    higher = closed_volume(side, side, Registration(raised, 0.3, 11))
    assert lower.value - higher.value == pytest.approx(0.1 * footprint, rel=0.15)
    assert higher.budget["registration"] == pytest.approx(0.1 * footprint, rel=0.15)


def begun_at(count: float, mm_per_count: float = 0.02) -> Profiles:
    """Give the half ellipsoid in a scan that begins at a count; its middle is at X = 0 for 100."""
    side = seen(ellipsoid, 12.0)
    xyz_mm = side.xyz_mm + np.array([(count - 100.0) * mm_per_count, 0.0, 0.0])
    figures = ScanFigures(120, 120, first_count=count, mm_per_count=(mm_per_count, 0.0, 0.0))
    return replace(side, xyz_mm=xyz_mm, scan=figures)


def test_a_flank_that_was_followed_to_the_belt_is_none_of_the_closed_body() -> None:
    """As where nothing tells the upper head how high the rim lies, and its flanks are drawn on."""
    side = seen(ellipsoid, 10.01)
    x, y = side.xyz_mm[..., 0], side.xyz_mm[..., 1]
    beside = (side.product == 0) & ((x / 27.0) ** 2 + (y / 19.0) ** 2 < 1.0) & (x > 0.0)
    xyz_mm = side.xyz_mm.copy()
    xyz_mm[beside, 2] = 2.0
    label = np.where(beside, np.int16(1), side.product)
    upper = replace(side, xyz_mm=xyz_mm, product=label, seen=side.seen & ~beside)
    assert closed_volume(upper, side, Registration(LIFTED, 0.005, 9)).value == pytest.approx(TRUE, rel=0.01)


@pytest.mark.parametrize(("upper", "lower"), [(100.0, 500.0), (760.0, 130.0), (4000.0, 4000.0)])
def test_heads_that_begin_at_other_counts_are_placed_by_them(upper: float, lower: float) -> None:
    pose = LIFTED.copy()
    pose[0, 3] = 0.02 * (40.0 - 70.0)  # the plate's scans began at 40 and at 70
    told = Registration(pose, 0.005, 9, (40.0, 70.0))
    found = closed_volume(begun_at(upper), begun_at(lower), told)
    assert found.value == pytest.approx(TRUE, rel=0.01)


def test_heads_that_cannot_be_put_together_are_refused() -> None:
    """Nothing seen, the product's end alone seen, a first count that is not known."""
    side, counted = seen(ellipsoid, 12.0), begun_at(100.0)
    assert counted.scan is not None
    begun = replace(counted, scan=replace(counted.scan, lines=61))  # its last line lies amid the product
    half = replace(side, product=np.where(side.xyz_mm[..., 0] < 3.0, side.product, np.int16(-1)))
    for upper, lower, counts, says in (
        (side, seen(lambda x, y: 0.0 * x), (), "one head only"),
        (side, half, (), "one head sees"),
        (begun, counted, (100.0, 100.0), "begins or ends within"),
        (counted, counted, (), "not of the plate"),
        (side, side, (0.0, 0.0), "the plate's scans only"),
        (counted, side, (0.0, 0.0), "both have to be known"),
    ):
        with pytest.raises(StageError, match=says):
            closed_volume(upper, lower, Registration(LIFTED, 0.005, 9, *([counts] if counts else [])))


CENTRES = np.array([[18.0 * i - 18.0, 18.0 * j - 9.0, 5.0] for i in range(3) for j in range(2)])


def test_heads_are_laid_on_one_another_by_their_balls(rng: np.random.Generator) -> None:
    plate = CENTRES + np.array([[0.7, -0.4, 0.0]]) * np.arange(6)[:, None] * 0.3  # no mirror image of itself
    lower = (plate - [3.0, 1.0, 20.0]) @ FLIPPED[:3, :3].T + 0.002 * rng.standard_normal((6, 3))
    found = registered(plate, lower)
    assert found.balls == 6
    carried = lower @ found.T_top_bottom[:3, :3].T + found.T_top_bottom[:3, 3]
    assert np.abs(carried - plate).max() < 0.01
    with pytest.raises(CalibrationError, match="three"):
        registered(CENTRES, CENTRES[:2])
    with pytest.raises(CalibrationError, match="do not share"):
        registered(CENTRES, CENTRES * [1.0, 1.6, 1.0] + [0.0, 0.0, 4.0])


def head(folder: Path, name: str, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Path:
    """Write what a head saw as a cloud, and the recipe that reads it."""
    write(folder / f"{name}.ply", Measured(seen(height).xyz_mm))
    path = folder / f"{name}.yaml"
    path.write_text(
        f"roemetry: 1\nproduct: {name}\nsource: {{use: height-files, path: {name}.ply}}\n"
        "stages: {volume: dense-slices}\n"
    )
    return path


def test_two_recipes_and_a_plate_give_the_true_volume(tmp_path: Path) -> None:
    """As the commands do it: a plate's balls halfway up are seen from both sides, then a product is."""
    middles = CENTRES[:, :2] + [0.7, -0.4] * np.arange(6)[:, None]  # no mirror image of itself

    def balls(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        away = np.min([(x - cx) ** 2 + (y - cy) ** 2 for cx, cy in middles], axis=0)
        return np.where(away < 24.0, 10.0 + np.sqrt(np.maximum(25.0 - away, 0.0)), 0.0)

    target, told = tmp_path / "target.yaml", tmp_path / "registration.yaml"
    plates = head(tmp_path, "plate_top", balls), head(tmp_path, "plate_bottom", lambda x, y: balls(x, -y))
    described = (
        "kind: sphere-plate\nname: plate\ncolumns: 3\nrows: 2\npitch_mm: {}\ndiameter_mm: 10\n"
        "centre_height_mm: 10\ntolerance_mm: 0.005\n"
    )
    target.write_text(described.format(18))
    with pytest.raises(CalibrationError, match=r"17\.6\d mm from .* file says 18 mm"):
        register_heads(*plates, target, told)
    assert not told.exists()
    target.write_text(described.format(17.614))  # as they lie, one 0.7 mm and -0.4 mm beside the other
    register_heads(*plates, target, told)
    table = tmp_path / "true.csv"
    two_sides(head(tmp_path, "top", ellipsoid), head(tmp_path, "bottom", ellipsoid), told, table)
    cm3, std, low, high, *_, reason = table.read_text().splitlines()[1].split(",")[1:]
    assert float(cm3) == pytest.approx(TRUE / 1000.0, rel=5e-3)
    assert float(low) < TRUE / 1000.0 < float(high)
    assert float(std) < 0.02 * TRUE / 1000.0
    assert not reason


def test_the_shipped_potatoes_have_their_true_volumes(tmp_path: Path) -> None:
    home = Path(__file__).resolve().parents[3] / "recipes" / "two_heads"
    table = tmp_path / "true.csv"
    two_sides(home / "heads" / "top.yaml", home / "heads" / "bottom.yaml", home / "registration.yaml", table)
    for line, true in zip(table.read_text().splitlines()[1:], (35.452, 37.550), strict=True):
        cm3, _, low, high = (float(value) for value in line.split(",")[1:5])
        assert cm3 == pytest.approx(true, rel=5e-3)
        assert low < true < high
