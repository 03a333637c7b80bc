"""Domes: a quadric under the plate, between the outer slices, at slices' own ends and in its shadow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Product
from roemetry.records.arrays import Floats
from roemetry.testing import LinearRig
from roemetry.testing.solids import Solid, product_of
from roemetry_volume.quadric_ends import shadow_of
from roemetry_volume.slice_ends import cap_of
from roemetry_volume.slice_rules import PCHIP, between_slices
from roemetry_volume.slice_table import slices_of
from roemetry_volume.surface_fit import Knots, plate_through

RIG = LinearRig(rows=200, columns=640, stripes=11, first_px=120.0, spacing_px=40.0, px_per_mm=1.5, fan=0.0)


def test_between_few_stripes_the_plate_goes_as_a_quadric_does() -> None:
    number = np.repeat(np.arange(4), 9)
    s, v = 6.0 * number.astype(np.float64) - 9.0, np.tile(np.linspace(-6.0, 6.0, 9), 4)
    knots = Knots(s, v, dome(s, v), np.full(s.size, 5.0), number)
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    plate = plate_through(knots, 12.0 * np.cos(angle), 15.0 * np.sin(angle), np.full(90, 6.0))
    between = np.array([-11.0, -6.0, 0.0, 5.0, 10.5])
    at = np.zeros_like(between)
    np.testing.assert_allclose(plate.at(between, at), dome(between, at), atol=0.05)


def test_where_both_ends_are_known_a_parabola_of_areas_is_summed_exactly() -> None:
    t = np.array([-20.0, -9.0, 1.0, 12.0, 21.0])
    area, slope = 600.0 - t * t, np.full(2, np.nan)
    whole = 600.0 * 41.0 - (21.0**3 + 20.0**3) / 3.0
    bulge = 11.0**3 / 6.0, 9.0**3 / 6.0
    assert between_slices(t, area, slope, PCHIP, bulge, (1.0, 1.0)) == pytest.approx(whole, rel=1e-12)
    assert abs(between_slices(t, area, slope, PCHIP) - whole) > 1e-4 * whole


@pytest.mark.parametrize("fanning", [0.0, 0.06])
@pytest.mark.parametrize("m", [-0.4, -0.9])
def test_a_shadow_under_planes_that_fan_out_is_that_of_its_lines(m: float, fanning: float) -> None:
    """Half an ellipsoid: what stands over a line, less what the planes' heights sum up to along it."""
    a, b, c = 2.5, 2.0, 1.8
    quadric = np.array([0.0, c * c, 0.0, 0.0, -((c / a) ** 2), 0.0, -((c / b) ** 2)])
    lines, rest = np.linspace(-b, b, 241)[1:-1], np.linspace(-4.0, 8.0, 40001)
    off = 0.0
    for y in lines:
        k, top = (c / a) ** 2, c * c * (1.0 - (y / b) ** 2)
        lean = m + fanning * rest
        # z² + k·(rest + lean·z)² = top, the upper of two places
        square, half = 1.0 + k * lean**2, k * rest * lean
        inside = half**2 - square * (k * rest**2 - top)
        z = np.where(inside > 0.0, (-half + np.sqrt(np.maximum(inside, 0.0))) / square, 0.0).clip(0.0)
        body = 0.5 * np.pi * top / np.sqrt(k)
        off += body - np.trapezoid(z + 0.5 * fanning * z * z, rest)
    off *= lines[1] - lines[0]
    assert shadow_of(quadric, m, 0.0, fanning) == pytest.approx(off, rel=0.02)


@pytest.mark.parametrize("rows", [1, 3])
def test_rows_that_a_slice_lacks_at_a_rim_are_made_up_for(rows: int) -> None:
    whole = product_of(Solid("half-ellipsoid", 75.0, 40.0, 14.0), RIG)
    short = without_outer_rows(whole, rows)
    lost = [slices_of(p).area_mm2 @ slices_of(p).held_mm for p in (short, whole)]
    gained = [sum(cap_of(p, slices_of(p), end, "taper").shadow_mm3 for end in (0, 1)) for p in (short, whole)]
    assert gained[0] - gained[1] == pytest.approx(lost[1] - lost[0], rel=0.25)


def dome(s: Floats, v: Floats) -> Floats:
    return 100.0 * (1.0 - (s / 12.0) ** 2 - (v / 15.0) ** 2)


def without_outer_rows(product: Product, rows: int) -> Product:
    profiles = product.profiles
    mine = profiles.product == product.number
    keep = np.zeros_like(mine)
    for i, row in enumerate(mine):
        if (places := np.flatnonzero(row)).size:
            keep[i, places[rows : places.size - rows]] = True
    gone = mine & ~keep
    xyz = np.where(gone[..., None], np.nan, profiles.xyz_mm)
    labels = np.where(gone, -1, profiles.product).astype(np.int16)
    return replace(product, profiles=replace(profiles, xyz_mm=xyz, product=labels, seen=profiles.seen & keep))
