"""Upright ends from slices: what leaning light counts too much or too little there, and where the edge is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Product
from roemetry.testing import LinearRig
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry_volume.slice_ends import cap_of
from roemetry_volume.slice_estimators import SlicePchip
from roemetry_volume.slice_table import slices_of

RIG = LinearRig(rows=600, columns=640, stripes=13, first_px=120.0, spacing_px=40.0, px_per_mm=1.5, fan=0.0)
SPACING_MM = 8.0
HALF_WIDTH_MM = 12.0
LENGTH_MM = 60.0
ROW_MM = 0.1


@pytest.mark.parametrize("rise", [0.0, 0.2], ids=["box", "wedge"])
@pytest.mark.parametrize("turn", [0.0, 0.12])
def test_an_edge_anywhere_between_two_stripes_is_right_on_average(rise: float, turn: float) -> None:
    """A wedge that falls to nothing shows that light's triangle at the high end is counted as it is."""
    errors, ratios = [], []
    for begin in SPACING_MM * (np.arange(12) + 0.5) / 12.0 - 30.0:
        product, true_mm3 = body(begin, turn=turn, rise=rise)
        found = SlicePchip().estimate(product).visible_mm3
        errors.append(found.value / true_mm3 - 1.0)
        ratios.append((found.value - true_mm3) / found.std)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.015)
    assert np.abs(ratios).max() < 1.96


def test_an_edge_that_the_outer_slice_runs_over_is_known_better() -> None:
    for begin in (-25.0, -23.7):
        cut, true_mm3 = body(begin, turn=0.12)
        slices = slices_of(cut)
        assert min(slices.width_mm[0], slices.width_mm[-1]) < 0.85 * 2.0 * HALF_WIDTH_MM
        end = 0 if slices.width_mm[0] < slices.width_mm[-1] else 1
        known = cap_of(cut, slices, end, "taper")
        blunt = slices.reach_mm[end] * slices.area_mm2[3] / np.sqrt(12.0)
        assert known.std_mm3 < 0.8 * blunt
        assert known.area_mm2 == pytest.approx(slices.area_mm2[3], rel=0.02)
        assert SlicePchip().estimate(cut).visible_mm3.value == pytest.approx(true_mm3, rel=0.06)


def test_an_end_that_the_camera_sees_lit_is_not_counted_twice() -> None:
    product, _ = body(-30.0)
    assert product.view is not None
    slices = slices_of(product)
    lit = int(slices.lean[1] > 0.0)  # the end over which the planes lean outwards: light meets it
    out = 1.0 if lit else -1.0
    place = product.view.T_belt_camera.copy()
    place[0, 3] = out * 200.0
    beyond = replace(product.view, T_belt_camera=place, telecentric=False)
    seen = replace(product, view=beyond)
    hidden = cap_of(product, slices, lit, "taper").shadow_mm3 - cap_of(seen, slices, lit, "taper").shadow_mm3
    height = slices.table[3, 7]
    triangle = 0.5 * slices.lean[lit] * height**2 * 2.0 * HALF_WIDTH_MM
    assert hidden == pytest.approx(triangle, rel=0.03)
    unknown = cap_of(replace(product, view=None), slices, lit, "taper")
    assert unknown.std_mm3 > 0.5 * triangle


def test_a_rounded_end_is_no_upright_one() -> None:
    product = product_of(HALF_ELLIPSOID, RIG)
    slices = slices_of(product)
    assert [cap_of(product, slices, end, "taper").shadow_mm3 <= 0.0 for end in (0, 1)] == [True, True]
    assert [cap_of(product, slices, end, "taper").area_mm2 for end in (0, 1)] == [
        slices.area_mm2[0],
        slices.area_mm2[-1],
    ]


def body(begin_mm: float, *, turn: float = 0.0, rise: float = 0.0) -> tuple[Product, float]:
    """Return a box (or a wedge that rises along X), lit by a fan and seen from straight above; its volume."""
    t = SPACING_MM * np.arange(-6, 7)
    lean = 0.25 + 0.01 * t
    y = np.broadcast_to(30.0 - ROW_MM * np.arange(600), (t.size, 600))
    # along and across the turned body; z from x = t + lean·z and z = h + rise·u, u along it
    cos, sin = np.cos(turn), np.sin(turn)
    high = 10.0 if rise == 0.0 else 0.0
    first = t[:, None] * cos + y * sin - begin_mm
    z = (high + rise * first) / (1.0 - rise * lean[:, None] * cos)
    x = t[:, None] + lean[:, None] * z
    u, v = x * cos + y * sin - begin_mm, -x * sin + y * cos
    lit = (u >= 0.0) & (u <= LENGTH_MM) & (np.abs(v) <= HALF_WIDTH_MM) & (z > 0.0)
    like = product_of(HALF_ELLIPSOID, RIG)
    row_px = np.broadcast_to(np.arange(600.0), lit.shape)
    plane = np.column_stack([np.ones(t.size), np.zeros(t.size), -lean, t])
    profiles = replace(
        like.profiles,
        xyz_mm=np.where(lit[..., None], np.stack([x, y, z], axis=-1), np.nan),
        product=np.where(lit, 1, -1).astype(np.int16),
        seen=lit,
        x_px=np.where(lit, 0.0, np.nan),
        row_px=np.where(lit, row_px, np.nan),
        height_std_mm=np.full(lit.shape, np.nan),
        plane=plane / np.linalg.norm(plane[:, :3], axis=1)[:, None],
    )
    volume = (high + 0.5 * rise * LENGTH_MM) * LENGTH_MM * 2.0 * HALF_WIDTH_MM
    return replace(like, profiles=profiles, view=like.calibration.view), volume
