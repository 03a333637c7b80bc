"""Ends beyond the outer slices: quadrics against closed forms, and walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Product
from roemetry.records.arrays import Floats
from roemetry.testing import LinearRig
from roemetry.testing.solids import HALF_ELLIPSOID, Solid, product_of
from roemetry_volume import quadric_ends as ends
from roemetry_volume import slice_table
from roemetry_volume.slice_estimators import SlicePchip
from roemetry_volume.slice_rules import between_slices, by_areas, cap_of, within_mm
from roemetry_volume.slice_table import slices_of
from roemetry_volume.surface_fit import Knots, plate_through

RIG = LinearRig(rows=200, columns=640, stripes=11, first_px=120.0, spacing_px=40.0, px_per_mm=1.5, fan=0.0)
HALF_LENGTH, HALF_WIDTH, HEIGHT = 31.0, 20.0, 16.0
SPACING_MM = 8.0


@pytest.mark.parametrize(("rim", "shift_mm"), [(0.0, 0.0), (7.0, 2.1), (0.0, 5.3), (7.0, 5.3)])
def test_an_ellipsoids_cap_is_exact_under_upright_light(rim: float, shift_mm: float) -> None:
    product = ellipsoid(rim=rim, lean=0.0, shift_mm=shift_mm)
    slices = slices_of(product)
    for end in (0, 1):
        from_mm = abs(slices.t_mm[-end]) / HALF_LENGTH
        found = quadric(product, end)
        # ∫ 2·b·r·√(1 − x²) + π/2·b·c·(1 − x²) dx from the outer slice to the end
        arc = 0.5 * (np.arccos(from_mm) - from_mm * np.sqrt(1.0 - from_mm**2))
        disc = 2.0 / 3.0 - from_mm + from_mm**3 / 3.0
        volume = HALF_LENGTH * HALF_WIDTH * (2.0 * rim * arc + 0.5 * np.pi * HEIGHT * disc)
        assert found[ends.VOLUME] == pytest.approx(volume, rel=2e-3)
        assert found[ends.LENGTH] == pytest.approx((1.0 - from_mm) * HALF_LENGTH, abs=0.01)
        assert found[ends.RIM_MM] == pytest.approx(rim, abs=1e-3)
        assert found[ends.SHADOW] == 0.0
        assert found[ends.RESIDUAL_MM] < 1e-3


@pytest.mark.parametrize("rim", [0.0, 7.0])
@pytest.mark.parametrize("lean", [-0.6, 0.6])
def test_steep_light_and_high_rims_leave_ellipsoids_within_one_per_cent(rim: float, lean: float) -> None:
    """Without an outline; the shadow behind the far end is up to some per cent of the volume."""
    true = np.pi * HALF_LENGTH * HALF_WIDTH * (rim + 2.0 / 3.0 * HEIGHT)
    for shift_mm in (0.0, 2.1, 5.3):
        product = ellipsoid(rim=rim, lean=lean, shift_mm=shift_mm)
        found = SlicePchip().estimate(product).visible_mm3
        assert found.value == pytest.approx(true, rel=1e-2)
        assert abs(found.value - true) < 1.96 * found.std
        shadows = [cap_of(product, slices_of(product), end).shadow_mm3 for end in (0, 1)]
        assert min(shadows) < -2e-3 * true


@pytest.mark.parametrize("shift_mm", [0.0, 2.1, 4.0, 5.3, 7.0])
@pytest.mark.parametrize("lean", [-0.9, -0.6, 0.6, 0.9])
def test_the_shadow_of_an_end_beyond_all_stripes_is_not_continued(lean: float, shift_mm: float) -> None:
    """Half an ellipsoid whose far end no quadric tells: the taper in rest X alone is up to 2.6 % off."""
    product = ellipsoid(rim=0.0, lean=lean, shift_mm=shift_mm)
    slices = slices_of(product)
    far = 0 if slices.lean[0] < 0.0 else 1
    near = cap_of(product, slices, 1 - far)
    slices = slices._replace(limited=(False, False))
    found = by_areas(slices, far, within_mm(slices, far))
    volume = between_slices(slices.t_mm, slices.area_mm2) + near.volume_mm3 + near.shadow_mm3
    volume += found.volume_mm3 + found.shadow_mm3
    true = 2.0 / 3.0 * np.pi * HALF_LENGTH * HALF_WIDTH * HEIGHT
    assert volume == pytest.approx(true, rel=0.011)
    assert abs(volume - true) < 2.5 * found.std_mm3
    # the taper alone reaches up to 6.4 mm too far
    beyond_mm = max(HALF_LENGTH - abs(slices.t_mm[-far]), 0.0)
    assert found.length_mm == pytest.approx(beyond_mm, abs=2.7)


def test_no_quadric_closes_a_flat_end() -> None:
    product = ellipsoid(rim=0.0, lean=0.3, shift_mm=0.0)
    xyz = product.profiles.xyz_mm.copy()
    xyz[..., 2] = np.where(np.isfinite(xyz[..., 2]), 9.0, np.nan)
    level = replace(product, profiles=replace(product.profiles, xyz_mm=xyz))
    assert all(np.isnan(quadric(level, 1)))


@pytest.mark.parametrize(("column", "factor"), [(slice_table.TOP, 0.6), (slice_table.WIDTH, 0.3)])
def test_a_quadric_larger_than_the_product_is_not_taken(column: int, factor: float) -> None:
    product = ellipsoid(rim=7.0, lean=0.3, shift_mm=0.0)
    slices = slices_of(product)
    table = slices.table.copy()
    table[:, column] *= factor
    assert all(np.isnan(quadric(product, 1, table)))
    assert all(np.isfinite(quadric(product, 1)))


def quadric(product: Product, end: int, table: np.ndarray | None = None) -> tuple[float, ...]:
    slices = slices_of(product)
    profiles = slices.profiles
    table = slices.table if table is None else table
    return tuple(
        ends.quadric_end(
            profiles.xyz_mm, profiles.product, profiles.seen, profiles.row_px, profiles.plane, 1,
            table, slices.place, end, slices.reach_mm[end], slices.limited[end],
        )
    )  # fmt: skip


def ellipsoid(*, rim: float, lean: float, shift_mm: float) -> Product:
    """Half an ellipsoid on a wall, lit by leaning planes as a camera straight above sees it."""
    t = SPACING_MM * np.arange(-6, 7) + shift_mm
    count, rows = t.size, RIG.rows
    y = np.broadcast_to(30.0 - 0.3 * np.arange(rows), (count, rows))
    # x = t + lean·z into ((z − rim)/c)² + (x/a)² + (y/b)² = 1, the upper of two places
    k = (HEIGHT / HALF_LENGTH) ** 2
    a = 1.0 + k * lean**2
    b = rim - k * lean * t[:, None]
    c = rim**2 - HEIGHT**2 * (1.0 - (y / HALF_WIDTH) ** 2) + k * t[:, None] ** 2
    inside = b**2 - a * c
    z = (b + np.sqrt(np.maximum(inside, 0.0))) / a
    lit = (inside > 0.0) & (z > rim)
    xyz = np.stack([t[:, None] + lean * z, y, z], axis=-1)
    plane = np.column_stack([np.ones(count), np.zeros(count), np.full(count, -lean), t])
    like = product_of(HALF_ELLIPSOID, replace(RIG, stripes=count))
    row_px = np.broadcast_to(np.arange(float(rows)), (count, rows))
    profiles = replace(
        like.profiles,
        xyz_mm=np.where(lit[..., None], xyz, np.nan),
        product=np.where(lit, 1, -1).astype(np.int16),
        seen=lit,
        row_px=np.where(lit, row_px, np.nan),
        plane=plane / np.linalg.norm(plane[:, :3], axis=1)[:, None],
    )
    return replace(like, profiles=profiles)


def test_between_few_stripes_the_plate_goes_as_a_quadric_does() -> None:
    number = np.repeat(np.arange(4), 9)
    s, v = 6.0 * number.astype(np.float64) - 9.0, np.tile(np.linspace(-6.0, 6.0, 9), 4)
    knots = Knots(s, v, dome(s, v), np.full(s.size, 5.0), number)
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    plate = plate_through(knots, 12.0 * np.cos(angle), 15.0 * np.sin(angle))
    between = np.array([-11.0, -6.0, 0.0, 5.0, 10.5])
    at = np.zeros_like(between)
    np.testing.assert_allclose(plate.at(between, at), dome(between, at), atol=0.05)


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
    assert ends.shadow_of(quadric, m, 0.0, fanning) == pytest.approx(off, rel=0.02)


def dome(s: Floats, v: Floats) -> Floats:
    return 100.0 * (1.0 - (s / 12.0) ** 2 - (v / 15.0) ** 2)


@pytest.mark.parametrize("rows", [1, 3])
def test_rows_that_a_slice_lacks_at_a_rim_are_made_up_for(rows: int) -> None:
    whole = product_of(Solid("half-ellipsoid", 75.0, 40.0, 14.0), RIG)
    short = without_outer_rows(whole, rows)
    lost = [slices_of(p).area_mm2 @ slices_of(p).held_mm for p in (short, whole)]
    gained = [sum(cap_of(p, slices_of(p), end).shadow_mm3 for end in (0, 1)) for p in (short, whole)]
    assert gained[0] - gained[1] == pytest.approx(lost[1] - lost[0], rel=0.25)


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
