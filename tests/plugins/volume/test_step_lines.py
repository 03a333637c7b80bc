"""Steps' lines on stairs whose every point is known."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_volume import slice_table
from roemetry_volume.rim import StripePoints
from roemetry_volume.step_lines import steps_at, steps_of

SPACING_MM, ROW_MM, WIDTH_MM = 8.0, 0.2, 30.0


def stairs(
    edges: list[float], turn: float, rise: float = 4.0, lean: float = 0.0, shift: float = 0.0
) -> tuple[StripePoints, np.ndarray]:
    """Slices x = t + lean·z over steps whose edges run along s = edge + turn·v, lit from the high side."""
    parts = []
    for t in np.arange(-28.0 + shift, 30.0, SPACING_MM):
        v = np.arange(-0.5 * WIDTH_MM, 0.5 * WIDTH_MM, ROW_MM)
        z, s = np.zeros_like(v), np.full_like(v, t)
        for level in range(len(edges) + 1, 0, -1):
            height = rise * level
            at = t + lean * height
            on = (z == 0.0) & ((at >= edges[level - 2] + turn * v) if level > 1 else True)
            z[on], s[on] = height, at
        parts.append(np.column_stack([s, v, z]))
    xyz = np.concatenate(parts)
    number = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    first = np.append(np.flatnonzero(np.diff(number, prepend=-1)), number.size)
    return StripePoints(xyz, number, first), xyz[:, :2]


@pytest.mark.parametrize(("lean", "edges"), [(0.0, [-10.0, 9.0]), (0.4, [-6.8, 5.0])])
def test_a_step_that_two_slices_cross_is_where_it_is(lean: float, edges: list[float]) -> None:
    points, place = stairs(edges, 0.45, lean=lean)
    steps = steps_of(points, place, None)
    assert sorted(step.at_mm for step in steps) == pytest.approx(edges, abs=0.1)
    for step in steps:
        assert (step.rise_mm, step.uphill) == (4.0, 1.0)
        assert step.slope == pytest.approx(0.45, abs=0.01)
        assert step.std_mm3 == 0.0
    rest = points.xyz_mm[:, 2] - steps_at(steps, place[:, 0], place[:, 1])
    assert (np.abs(rest - 4.0) > 1e-9).mean() < 0.01


def test_of_one_crossing_the_line_is_square_to_the_product_and_in_doubt() -> None:
    points, place = stairs([-11.0], 0.06, shift=0.2)
    (step,) = steps_of(points, place, None)
    crossing = (-11.8 + 11.0) / 0.06
    assert step.at_mm + step.slope * crossing == pytest.approx(-11.8, abs=0.05)
    wrong = 4.0 * WIDTH_MM * (step.at_mm + 11.0)
    assert 0.0 < abs(wrong) < 1.96 * step.std_mm3


@pytest.mark.parametrize("lean", [0.0, 0.5])
def test_a_step_that_none_crosses_is_halfway_between_what_light_allows(lean: float) -> None:
    points, place = stairs([-8.0], 0.0, lean=lean, shift=1.0)
    (step,) = steps_of(points, place, np.tile([lean, 0.0], (len(place), 1)))
    below = place[points.xyz_mm[:, 2] == 4.0, 0].max() + 4.0 * lean
    above = place[points.xyz_mm[:, 2] == 8.0, 0].min()
    assert below < -8.0 < above
    assert step.at_mm == pytest.approx(0.5 * (below + above), abs=1e-6)
    assert step.std_mm3 == pytest.approx(
        4.0 * (WIDTH_MM - ROW_MM) * (above - below) / np.sqrt(12.0), rel=1e-6
    )


def test_slopes_and_domes_have_no_steps() -> None:
    points, place = stairs([], 0.0)
    s, v = place.T
    for z in (12.0 + 0.3 * s, 9.0 - 0.3 * v, 15.0 - s * s / 100.0 - v * v / 60.0):
        xyz = np.column_stack([place, z])
        assert steps_of(points._replace(xyz_mm=xyz), place, None) == ()


def test_noise_of_a_tenth_of_a_millimetre_moves_a_line_by_less_than_a_row(rng: np.random.Generator) -> None:
    points, place = stairs([-10.0, 9.0], 0.45)
    noisy = points.xyz_mm + np.array([0.0, 0.0, 0.1]) * rng.normal(size=points.xyz_mm.shape)
    steps = steps_of(points._replace(xyz_mm=noisy), place, None)
    assert sorted(step.at_mm for step in steps) == pytest.approx([-10.0, 9.0], abs=0.2)


@pytest.mark.parametrize(("other_mm", "hole"), [(12.0, 0.0), (16.0, 20.0)])
def test_a_wide_gap_between_two_levels_is_a_hidden_wall_and_else_a_hole(other_mm: float, hole: float) -> None:
    rows = np.concatenate([np.arange(0.0, 50.0), np.arange(150.0, 200.0)])
    z = np.where(rows < 100.0, 16.0, other_mm)
    xyz = np.stack([np.zeros_like(rows), 0.2 * rows, z], axis=-1)[None].repeat(3, axis=0)
    shape = xyz.shape[:2]
    plane = np.array([[1.0, 0.0, 0.0, t] for t in (0.0, 8.0, 16.0)])
    table, _ = slice_table.slice_areas(
        xyz, np.ones(shape, np.int16), np.ones(shape, np.bool_), np.broadcast_to(rows, shape).copy(),
        plane, np.zeros(3, np.int64), 1,
    )  # fmt: skip
    assert table[:, slice_table.HOLE] == pytest.approx(np.full(3, hole), abs=0.5)
    assert table[:, slice_table.AREA] == pytest.approx(
        np.full(3, 10.0 * (16.0 + other_mm) + (0.0 if hole else 280.0)), rel=0.01
    )
