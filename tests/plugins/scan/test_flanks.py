"""Flanks that are followed: what a conic must never do beyond the last point that is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from roemetry_scan.dense import end_held
from roemetry_scan.flanks import conic, doubt_of, followed_to, rims_of

INWARDS_MM = np.linspace(0.0, 6.0, 20)


@pytest.mark.parametrize("rim_mm", [0.0, 6.0, math.nan])
def test_a_flank_never_rises_again_where_its_curve_is_hollow(rim_mm: float) -> None:
    """An egg's outermost rows were followed 50 mm beyond it, upwards: 3 % of its volume too much."""
    square = 64.0 + 4.0 * INWARDS_MM + 1.5 * INWARDS_MM**2  # (z − 6)²: a hyperbola without a root
    height_mm = 6.0 + np.sqrt(square)
    r, a, b, c, length = conic(INWARDS_MM, height_mm, INWARDS_MM.size, 50.0, rim_mm)
    out = np.linspace(0.0, length, 50)
    followed = r + np.sqrt(np.maximum(a + b * out + c * out**2, 0.0))
    assert 0.0 < length < 50.0
    assert (np.diff(followed) < 0.0).all()


def test_an_ellipse_is_followed_to_where_it_ends() -> None:
    """Of the half-axes 20 and 10 mm over a rim at 3 mm, seen up to 15 mm from its middle."""
    height_mm = 3.0 + 10.0 * np.sqrt(1.0 - ((15.0 - INWARDS_MM) / 20.0) ** 2)
    length = conic(INWARDS_MM, height_mm, INWARDS_MM.size, 50.0, 3.0)[4]
    assert length == pytest.approx(5.0, abs=1e-3)


def test_a_rim_is_found_beside_points_that_are_too_dim_and_one_that_is_lifted(
    rng: np.random.Generator,
) -> None:
    """Light grazes a ball beside its rim: each row loses one or two points, and the last is too high."""
    rim_mm, radius_mm, step_mm, dim_mm = 19.0, 20.0, 0.65, 0.9
    lines, rows = 110, 400
    x_mm = step_mm * np.arange(lines)[:, None] + rng.uniform(0.0, step_mm, rows)
    off_mm = np.abs(x_mm - 0.5 * step_mm * lines)
    on = off_mm < radius_mm
    height_mm = np.where(on, rim_mm + np.sqrt(np.maximum(radius_mm**2 - off_mm**2, 0.0)), 0.0)
    label = np.where(on, 1, 0).astype(np.int16)
    label[on & (radius_mm - off_mm < dim_mm)] = -1
    last = (label == 1) & (np.roll(label, -1, axis=0) == -1)
    height_mm[last] += 0.3
    label[:30] = -1  # in the shadow
    xyz_mm = np.stack([x_mm, np.zeros_like(x_mm), np.where(label < 0, np.nan, height_mm)], axis=-1)
    none = np.zeros(label.shape, np.bool_)
    rims, _ = rims_of(xyz_mm, label, none, 1)
    assert rims[1] == pytest.approx(rim_mm, abs=0.15)
    # what lifts the last point says how far off the rim may be
    outer, _ = rims_of(xyz_mm, label, none, 1, 0)
    assert 0.5 < outer[1] - rims[1] < 2.0


def half_cylinder(shadow_mm: float, inside_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Slices of one of 20 mm radius over a rim at 5 mm; unseen from X = 12 mm on, for so long.

    Lines are 1 mm apart and lie anywhere to the edges; belt is seen up to `inside_mm` inside one of them.
    """
    x_mm = np.arange(-40.0, 60.0)[:, None] + np.arange(400) * 0.618034 % 1.0
    label = (np.abs(x_mm) < 20.0).astype(np.int16)
    z_mm = np.where(label > 0, 5.0 + np.sqrt(np.maximum(20.0**2 - x_mm**2, 0.0)), 0.0)
    label[x_mm < -20.0 + inside_mm] = 0
    label[(x_mm > 12.0) & (x_mm < 12.0 + shadow_mm)] = -1
    return np.stack([x_mm, np.zeros_like(x_mm), np.where(label < 0, np.nan, z_mm)], axis=-1), label


@pytest.mark.parametrize("shadow_mm", [11.0, 30.0])
def test_the_shadow_of_a_product_is_no_edge(shadow_mm: float) -> None:
    """Also where it is short: belt three lines beyond an edge is as belt beside points that are too dim."""
    xyz_mm, label = half_cylinder(shadow_mm)
    rims, by_row = rims_of(xyz_mm, label, np.zeros(label.shape, np.bool_), 1)
    assert rims[1] == pytest.approx(5.0, abs=0.15)
    np.testing.assert_allclose(by_row[1], 5.0, atol=0.2)


@pytest.mark.parametrize("flat_rows", [(171, 228), (350, 400), (100, 300)])
def test_flat_rows_tell_no_rim(flat_rows: tuple[int, int]) -> None:
    """All rows of a group, some at one end, the middle half: rims came out 4 to 11 mm too high."""
    xyz_mm, label = half_cylinder(30.0)
    flat = slice(*flat_rows)
    xyz_mm[:, flat, 2] = np.where(label[:, flat] == 1, 20.0, xyz_mm[:, flat, 2])
    rims, by_row = rims_of(xyz_mm, label, np.zeros(label.shape, np.bool_), 1)
    # rows beside flat ones are pooled with them, and tell rims that are a little too high
    assert rims[1] == pytest.approx(5.0, abs=0.3)
    np.testing.assert_allclose(by_row[1], 5.0, atol=0.3)


def test_fewer_rows_that_bend_than_a_rim_needs_tell_none() -> None:
    """Nine bend by themselves; the three beside them only where they are pooled with these."""
    xyz_mm, label = half_cylinder(30.0)
    xyz_mm[:, 9:, 2] = np.where(label[:, 9:] == 1, 20.0, xyz_mm[:, 9:, 2])
    rims, by_row = rims_of(xyz_mm, label, np.zeros(label.shape, np.bool_), 1)
    assert np.isnan(rims[1])
    assert np.isnan(by_row[1]).all()


def test_light_beside_a_product_lies_where_its_line_of_sight_meets_the_belt() -> None:
    """The product holds back the middle of a sheet, up to 0.3 mm inside; the rest lies 0.3 mm outwards."""
    xyz_mm, label = half_cylinder(18.0, 0.3)
    none = np.zeros(label.shape, np.bool_)
    high_mm = xyz_mm[(label == 1) & (np.roll(label, -1, axis=0) == -1), 2].mean()
    first = (label == 0) & (np.roll(label, -1, axis=0) == 1)
    xyz_mm[first, 2] = -0.3 / (19.0 / high_mm)  # the shadow's lines and one more, on the mean
    rims, _ = rims_of(xyz_mm, label, none, 1)
    assert rims[1] == pytest.approx(5.0, abs=0.15)
    xyz_mm[first, 2] = 0.0
    assert rims_of(xyz_mm, label, none, 1)[0][1] > 6.0


def test_where_there_is_no_shadow_nothing_tells_where_such_light_lies() -> None:
    """The distance to the belt is a spacing there, however steeply the camera looks down."""
    xyz_mm, label = half_cylinder(0.0)
    none = np.zeros(label.shape, np.bool_)
    rims, by_row = rims_of(xyz_mm, label, none, 1)
    for beside in (np.roll(label, -1, axis=0), np.roll(label, 1, axis=0)):
        xyz_mm[(label == 0) & (beside == 1), 2] = -0.3
    lower_rims, lower_by_row = rims_of(xyz_mm, label, none, 1)
    np.testing.assert_array_equal(lower_rims, rims)
    np.testing.assert_array_equal(lower_by_row, by_row)


@pytest.mark.parametrize(
    ("stretched_rows", "longer", "expected"),
    [(0, 1.0, 0.0), (70, 1.5, 0.5), (70, 0.7, 0.3), (30, 1.5, 0.5 * (3 / 7) ** 0.5)],
)
def test_flanks_are_doubted_by_what_conics_miss_on_the_side_that_is_seen(
    stretched_rows: int, longer: float, expected: float
) -> None:
    half_mm, high_mm, lost_mm = 20.0, 16.0, 10.0
    rows = 70
    step_mm = 0.25
    # edges lie anywhere between lines
    x_mm = np.arange(-45.0, 45.0, step_mm)[:, None] + np.arange(rows) * 0.618 * step_mm % step_mm
    # where the section is as high as the row is lost at behind; beyond, the side that is seen is stretched
    there_mm = half_mm * np.sqrt(1.0 - (lost_mm / high_mm) ** 2)
    times = np.where(np.arange(rows) < stretched_rows, longer, 1.0)
    along_mm = np.where(x_mm < -there_mm, -there_mm + (x_mm + there_mm) / times, x_mm)
    z_mm = high_mm * np.sqrt(np.maximum(1.0 - (along_mm / half_mm) ** 2, 0.0))
    label = (z_mm > 0.0).astype(np.int16)
    label[(x_mm > there_mm) & (x_mm < 30.0)] = -1
    y_mm = np.broadcast_to(np.arange(rows) * 0.25, x_mm.shape)
    xyz_mm = np.stack([x_mm, y_mm, np.where(label < 0, np.nan, z_mm)], axis=-1)
    by_row = np.zeros((2, rows))
    doubt = doubt_of(xyz_mm, label, np.zeros(label.shape, np.bool_), by_row, np.ones(by_row.shape))
    assert doubt[1] == pytest.approx(expected, abs=0.04)


def test_too_few_rows_tell_nothing_of_flanks() -> None:
    label = np.zeros((9, 9), np.int16)
    none = np.zeros(label.shape, np.bool_)
    assert np.isnan(doubt_of(np.zeros((9, 9, 3)), label, none, np.zeros((2, 9)), np.ones((2, 9)))[1])


def half_ellipsoid(lines_mm: np.ndarray, shadow_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slices of one over a rim at 10 mm, half-axes 20, 16 and 12 mm; unseen from X = `shadow_mm` on."""
    x_mm, y_mm = np.meshgrid(lines_mm, np.arange(-20.0, 20.1, 0.25), indexing="ij")
    inside = 1.0 - (x_mm / 20.0) ** 2 - (y_mm / 16.0) ** 2
    label = (inside > 0.0).astype(np.int16)
    label[(x_mm > shadow_mm) & (x_mm < 30.0)] = -1
    z_mm = np.where(label > 0, 10.0 + 12.0 * np.sqrt(np.maximum(inside, 0.0)), 0.0)
    plane = np.column_stack([np.ones(lines_mm.size), np.zeros((lines_mm.size, 2)), lines_mm])
    return np.stack([x_mm, y_mm, z_mm], axis=-1), label, plane


@pytest.mark.parametrize("first_mm", np.linspace(0.0, 1.0, 8, endpoint=False))
def test_a_rim_does_not_depend_on_where_the_outermost_line_lies(first_mm: float) -> None:
    """All rows that end under one line share its distance from the edge.

    With half a spacing for all of them, rims were up to 0.37 mm off, and those of rows up to 1.06 mm.
    """
    xyz_mm, label, _ = half_ellipsoid(first_mm + np.arange(-25.0, 35.0), 12.0)
    rims, by_row = rims_of(xyz_mm, label, np.zeros(label.shape, np.bool_), 1)
    assert rims[1] == pytest.approx(10.0, abs=0.2)
    np.testing.assert_allclose(by_row[1], 10.0, atol=0.5)


def test_rows_under_the_outermost_line_tell_a_rim_where_no_others_do() -> None:
    """All other rows are flat up to where they end; formerly there was no rim then."""
    xyz_mm, label, _ = half_ellipsoid(0.5 + np.arange(-25.0, 35.0), 12.0)
    flat = np.abs(xyz_mm[..., 1]) > 6.0
    xyz_mm[flat & (label == 1), 2] = 20.0
    rims, by_row = rims_of(xyz_mm, label, np.zeros(label.shape, np.bool_), 1)
    assert rims[1] == pytest.approx(10.0, abs=1.1)  # what half a spacing is worth
    np.testing.assert_allclose(by_row[1], rims[1], atol=1.1)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_row_that_does_not_bend_or_hardly_ends_where_those_beside_it_do(way: float) -> None:
    """Whichever way X runs from line to line: rows were followed to the belt, 10 mm beyond their product."""
    xyz_mm, label, plane = half_ellipsoid(way * np.arange(-25.0, 35.0), 12.0)
    middle = label.shape[1] // 2
    flat, long = middle, middle + 6
    xyz_mm[label[:, flat] == 1, flat, 2] = 20.0
    # falls by 0.04 mm for each mm: its conic goes on for tens of millimetres
    xyz_mm[label[:, long] == 1, long, 2] = (20.0 - 0.04 * xyz_mm[:, long, 0])[label[:, long] == 1]
    rims = np.array([0.0, 10.0])
    by_row = np.repeat(rims[:, None], label.shape[1], axis=1)
    points, found, added = followed_to(xyz_mm, label, plane, rims, by_row, np.ones(by_row.shape))
    for row in (flat, long):
        ends_mm = points[added[:, row] & (found[:, row] == 1), row, 0].max()
        assert ends_mm == pytest.approx(20.0, abs=1.5)  # points beside a row are pooled with its own
    assert (np.diff(points[added[:, flat], flat, 2]) * way < 0.0).all()


@pytest.mark.parametrize(("wall_mm", "dome_mm"), [(10.0, 0.0), (0.0, 20.0), (20.0, 20.0)])
def test_ends_between_lines_cost_nothing_on_the_mean(wall_mm: float, dome_mm: float) -> None:
    """A cylinder of 40 mm, a half ball, and one on the other, 2 mm apart: ends anywhere between two lines.

    A quarter of a spacing at each end, formerly, made the cylinder 0.94 % too small; taken for walls, with
    trapezoids farther in, the half ball was 0.27 % and both together 0.35 % too small.
    """
    radius_mm, spacing_mm = 20.0, 2.0
    volume_mm3 = np.pi * radius_mm**2 * (wall_mm + 2.0 / 3.0 * dome_mm)
    off = []
    for first in np.linspace(0.0, spacing_mm, 40, endpoint=False):
        at_mm = np.arange(-radius_mm + first, radius_mm, spacing_mm)
        half_mm = np.sqrt(np.maximum(radius_mm**2 - at_mm**2, 0.0))
        wall_mm2 = 2.0 * wall_mm * half_mm
        area_mm2 = wall_mm2 + 0.5 * np.pi * half_mm**2 * dome_mm / radius_mm
        held_mm = np.full(at_mm.size, spacing_mm)
        held_mm[[0, -1]] = 0.5 * spacing_mm
        for end, inner in ((0, 1), (-1, -2)):
            share = float(wall_mm2[inner] / area_mm2[inner])
            outer_held, inner_held = end_held(float(area_mm2[end]), float(area_mm2[inner]), share)
            held_mm[end] += outer_held * spacing_mm
            held_mm[inner] += inner_held * spacing_mm
        off.append(area_mm2 @ held_mm / volume_mm3 - 1.0)
    assert np.mean(off) == pytest.approx(0.0, abs=1.5e-3)
    assert np.max(np.abs(off)) < 4e-3
    # a wall: half a spacing on the mean
    assert end_held(5.0, 5.0) == (0.5, 0.0)


@pytest.mark.parametrize("wall_share", [0.0, 0.3, 1.0])
def test_what_lies_beyond_an_end_changes_smoothly_from_round_ends_to_blunt_ones(wall_share: float) -> None:
    """Formerly it jumped by 0.08 of the inner area where the end of a dome is a spacing away."""
    ratio = np.linspace(0.01, 1.0, 2000)
    beyond = np.array([np.dot(end_held(one, 1.0, wall_share), (one, 1.0)) for one in ratio])
    assert np.abs(np.diff(beyond)).max() < 3e-3  # by slope 0.002 at most
