"""The slice estimator against scipy and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.interpolate import CubicSpline, PchipInterpolator

from roemetry.errors import StageError
from roemetry.records import Product
from roemetry.testing import LinearRig
from roemetry.testing.solids import HALF_ELLIPSOID, Solid, product_of
from roemetry_volume import slice_rules, slice_table
from roemetry_volume.slice_estimators import SlicePchip, SliceTrapezoid, common_height_std_mm
from roemetry_volume.underside import UndersideOptions, fitted_share

ELEVEN = LinearRig(rows=480, columns=640, stripes=11, first_px=120.0, spacing_px=40.0, px_per_mm=1.5, fan=0.0)
NAN = np.full(2, np.nan)


@pytest.mark.parametrize("n", [3, 4, 5, 8, 11])
def test_cubics_are_those_of_scipy(n: int, rng: np.random.Generator) -> None:
    t, area = np.cumsum(rng.uniform(0.5, 2.0, n)), rng.uniform(1.0, 5.0, n)
    free, clamped = CubicSpline(t, area), CubicSpline(t, area, bc_type=((1, 1.0), (1, -2.0)))
    for found, theirs in (
        (slice_rules.between_slices(t, area), PchipInterpolator(t, area)),
        (slice_rules.by_spline(t, area, NAN), free),
        (slice_rules.by_spline(t, area, np.array([1.0, -2.0])), clamped),
    ):
        assert found == pytest.approx(theirs.integrate(t[0], t[-1]), abs=1e-12)


def test_a_parabolic_cap_is_exact_and_past_the_next_stripe_believed_ever_less() -> None:
    t = np.array([-3.0, -1.0, 2.0])
    area = 16.0 - t**2  # falls to zero at ±4
    for end, (length, volume) in enumerate([(1.0, 11.0 / 3.0), (2.0, 40.0 / 3.0)]):
        found = slice_rules.taper_of(t, area, end, 5.0, True)
        assert found[:3] == pytest.approx((volume, length, -2.0 * t[-end]), abs=1e-12)
        assert found[3] == pytest.approx(1.0, abs=1e-6)
        level = slice_rules.taper_of(t, np.full(3, 7.0), end, 3.0, end == 0)
        assert (level[0], level[1], level[3]) == (0.0, 0.0, 0.0), "what does not taper"
    trusts = [slice_rules.taper_of(t, area, 0, 1.0 / over, True)[3] for over in (1.0, 1.15, 1.3, 2.0)]
    assert trusts == pytest.approx([0.9, 0.5, 0.12, 0.0], abs=0.02)


def test_smooth_areas_are_even(rng: np.random.Generator) -> None:
    for n in (4, 5, 9):
        t = np.cumsum(rng.uniform(0.5, 2.0, n))
        assert slice_rules.unevenness(t, 3.0 + t - 0.1 * t**2) == pytest.approx(0.0, abs=1e-9)
    t = np.arange(9.0)
    area = np.ones(9)
    area[4] += 1.0
    assert slice_rules.unevenness(t, area) > 1.0


@pytest.mark.parametrize(
    ("shift_px", "size"),
    [
        (0.0, (75.0, 40.0, 14.0)),
        (9.0, (92.0, 30.0, 18.0)),
        (23.0, (50.0, 50.0, 20.0)),
        (9.0, (50.0, 50.0, 20.0)),
    ],
)
def test_half_ellipsoids_under_eleven_stripes(shift_px: float, size) -> None:
    """Within 0.5 % wherever the stripes fall, the planes leaning by 0.375 mm a millimetre."""
    solid = Solid("half-ellipsoid", *size)
    product = product_of(solid, replace(ELEVEN, first_px=ELEVEN.first_px + shift_px))
    volume = SlicePchip().estimate(product)
    assert volume.visible_mm3.value == pytest.approx(solid.volume_mm3, rel=5e-3)
    assert volume.shares.assumed > 0.0


@pytest.mark.parametrize("length", [62.0, 66.0, 69.0])
def test_a_box_between_stripes_is_within_its_interval(length: float) -> None:
    solid = Solid("box", length, 30.0, 10.0)
    product = product_of(solid, ELEVEN)
    for estimator in (SlicePchip(), SliceTrapezoid()):
        volume = estimator.estimate(product)
        assert abs(volume.visible_mm3.value - solid.volume_mm3) < 2.0 * volume.visible_mm3.std
        assert "blunt-end" in codes(volume)
        assert estimator.states_model_error


def test_trapezoids_are_short_of_a_convex_body_by_what_lies_above_them() -> None:
    product = product_of(HALF_ELLIPSOID, ELEVEN)
    cubic, straight = (one().estimate(product).visible_mm3.value for one in (SlicePchip, SliceTrapezoid))
    slices = slice_table.slices_of(product)
    t, area = slices.t_mm, slices.area_mm2
    above = PchipInterpolator(t, area).integrate(t[0], t[-1]) - np.trapezoid(area, t)
    assert cubic - straight == pytest.approx(above, rel=1e-9)
    assert above > 0.0


def test_trapezoids_need_no_numpy_2(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest numpy that the package allows has no `trapezoid`."""
    monkeypatch.delattr(np, "trapezoid", raising=False)
    found = SliceTrapezoid(UndersideOptions()).estimate(product_of(HALF_ELLIPSOID))
    assert found.visible_mm3.value > 0.0


def test_a_fan_of_planes_counts_each_height_where_it_is() -> None:
    """A box under planes from one point near by: at its top they are a tenth closer than on the belt."""
    height, projector = 12.0, 120.0
    t = np.linspace(-27.0, 27.0, 10)
    rows = np.arange(200.0)
    y = 50.0 - 0.5 * rows
    on = np.abs(y) < 20.0
    # X = t + r·z, r = −t/projector: the planes meet above the middle
    plane = np.column_stack([np.ones(10), np.zeros(10), t / projector, t])
    plane /= np.linalg.norm(plane[:, :3], axis=1)[:, None]
    top = product_of(HALF_ELLIPSOID, replace(ELEVEN, rows=200, stripes=10))
    xyz = np.full((10, 200, 3), np.nan)
    xyz[:, on, 0] = (t * (1.0 - height / projector))[:, None]
    xyz[:, on, 1] = y[on]
    xyz[:, on, 2] = height
    profiles = replace(
        top.profiles,
        xyz_mm=xyz,
        product=np.where(np.isfinite(xyz[..., 2]), 1, -1).astype(np.int16),
        seen=np.isfinite(xyz[..., 2]),
        plane=plane,
        row_px=np.where(np.isfinite(xyz[..., 2]), rows, np.nan),
    )
    slices = slice_table.slices_of(replace(top, profiles=profiles))
    covered = 54.0 * (1.0 - height / projector)
    between = slice_rules.between_slices(slices.t_mm, slices.area_mm2)
    assert between == pytest.approx(covered * 0.5 * on.sum() * height, rel=1e-9)


@pytest.mark.parametrize(
    ("slices", "says"), [([], "no stripe on the product"), ([4, 5], "only 2 stripes lie on the product")]
)
def test_too_few_slices_are_refused(slices: list[int], says: str) -> None:
    keep = np.isin(np.arange(11), slices)
    with pytest.raises(StageError, match=says):
        SlicePchip().estimate(without(product_of(HALF_ELLIPSOID, ELEVEN), ~keep, slice(None)))


def scaled(factor: float, slices: object, off_mm: float = 0.0) -> Product:
    product = product_of(HALF_ELLIPSOID, ELEVEN)
    xyz = product.profiles.xyz_mm.copy()
    xyz[slices, :, 2] = factor * xyz[slices, :, 2] + off_mm
    return replace(product, profiles=replace(product.profiles, xyz_mm=xyz))


def test_doubts_are_told() -> None:
    product = product_of(HALF_ELLIPSOID, ELEVEN)
    with pytest.raises(StageError, match="below the belt"):
        SlicePchip().estimate(scaled(-1.0, slice(None)))
    for doubtful, code in (
        (without(product, 5, slice(None)), "dead-stripe"),
        (without(product, 5, slice(235, 240)), "gap-in-slice"),
        (without(product, 5, slice(215, 265)), "hole"),
        (scaled(0.2, 5), "waist"),
        (scaled(1.0, 4, -5.0), "below-belt"),
        (product_of(Solid("half-ellipsoid", 140.0, 30.0, 12.0), ELEVEN), "beyond-outer-stripes"),
        (product_of(Solid("box", 66.0, 140.0, 12.0), ELEVEN), "cut-by-edge"),
    ):
        assert code in codes(SlicePchip().estimate(doubtful))


def test_draws_scatter_by_the_stated_uncertainty(rng: np.random.Generator) -> None:
    product = product_of(HALF_ELLIPSOID, ELEVEN)
    stated = SlicePchip().estimate(product).visible_mm3
    drawn = [SlicePchip().estimate(product, rng=rng).visible_mm3.value for _ in range(400)]
    assert np.std(drawn) == pytest.approx(stated.std, rel=0.15)
    assert np.mean(drawn) == pytest.approx(stated.value, abs=4.0 * stated.std / 20.0)


def without(product: Product, at: object, points: slice) -> Product:
    xyz = product.profiles.xyz_mm.copy()
    xyz[at, points] = np.nan
    gone = np.isnan(xyz[..., 2])
    profiles = replace(
        product.profiles,
        xyz_mm=xyz,
        product=np.where(gone, -1, product.profiles.product).astype(np.int16),
        seen=product.profiles.seen & ~gone,
    )
    return replace(product, profiles=profiles)


def codes(volume) -> set[str]:
    return {reason.code for reason in volume.reasons}


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


def stated(std_mm: float, noise_mm: float, rng: np.random.Generator) -> Product:
    one = product_of(HALF_ELLIPSOID, ELEVEN)
    xyz = one.profiles.xyz_mm.copy()
    xyz[..., 2] += noise_mm * rng.standard_normal(xyz.shape[:2])
    std = np.where(np.isfinite(xyz[..., 2]), std_mm, np.nan)
    return replace(one, profiles=replace(one.profiles, xyz_mm=xyz, height_std_mm=std))


def test_what_is_stated_and_does_not_scatter_is_common(rng: np.random.Generator) -> None:
    smooth = stated(0.06, 0.0, rng)
    assert common_height_std_mm(smooth) == pytest.approx(0.06 / np.sqrt(2.0), abs=0.002)
    found = SlicePchip().estimate(smooth).visible_mm3
    share = found.budget["common height"] / common_height_std_mm(smooth)
    assert share == pytest.approx(np.pi / 4.0 * 60.0 * 30.0, rel=0.05)  # the footprint, mm²


def test_noise_is_not_common(rng: np.random.Generator) -> None:
    assert common_height_std_mm(stated(0.06, 0.06, rng)) < 0.02
    assert common_height_std_mm(stated(0.10, 0.06, rng)) == pytest.approx(0.08 / np.sqrt(2.0), abs=0.015)
    assert common_height_std_mm(stated(np.nan, 0.06, rng)) == 0.0


def with_underside(**options):
    return SlicePchip(UndersideOptions(**options)).estimate(product_of(HALF_ELLIPSOID))


def test_what_is_known_of_the_underside_is_in_the_true_volume(rng: np.random.Generator) -> None:
    assert with_underside().true_mm3 is None
    volume = with_underside(underside="flat")
    assert volume.true_mm3.value == volume.visible_mm3.value
    assert volume.true_mm3.std == pytest.approx(volume.visible_mm3.std)
    volume = with_underside(underside="air-gap", gap_mm=1.0, gap_std_mm=0.2)
    foot = np.pi / 4.0 * 60.0 * 30.0
    assert volume.visible_mm3.value - volume.true_mm3.value == pytest.approx(foot, rel=0.02)  # mm³
    told = {"underside": "rounded", "true_share": 0.85, "true_share_std": 0.05}
    volume = with_underside(**told)
    assert volume.true_mm3.value == pytest.approx(0.85 * volume.visible_mm3.value)
    assert volume.true_mm3.budget["underside"] == pytest.approx(0.05 * volume.visible_mm3.value)
    estimator, product = SlicePchip(UndersideOptions(**told)), product_of(HALF_ELLIPSOID)
    drawn = [estimator.estimate(product, rng=rng).true_mm3.value for _ in range(200)]
    assert np.std(drawn) == pytest.approx(volume.true_mm3.std, rel=0.2)


@pytest.mark.parametrize(
    "options",
    [
        {"underside": "rounded"},
        {"underside": "rounded", "true_share": 0.9},
        {"underside": "air-gap", "true_share": 0.9},
        {"true_share": 0.9},
    ],
)
def test_a_model_has_its_own_numbers_and_no_others(options) -> None:
    with pytest.raises(ValidationError, match="needs|belongs to"):
        UndersideOptions(**options)


def test_the_share_is_fitted_to_weighed_samples(rng: np.random.Generator) -> None:
    visible = rng.uniform(1e4, 3e4, 400)
    share, std = fitted_share(visible, visible * rng.normal(0.86, 0.03, 400))
    assert share == pytest.approx(0.86, abs=0.006)
    assert std == pytest.approx(0.03, abs=0.004)
    with pytest.raises(ValueError, match="three samples"):
        fitted_share([1.0, 2.0], [1.0, 2.0])


def test_a_gap_under_some_products_widens_the_intervals_of_all(rng: np.random.Generator) -> None:
    """One product in fifteen stands on air: a standard deviation alone would leave those out."""
    gap = rng.random(2000) < 1.0 / 15.0
    true = np.where(gap, rng.normal(0.75, 0.02, 2000), rng.normal(0.92, 0.01, 2000))
    share, std = fitted_share(np.ones(1000), true[:1000])
    assert 0.92 < np.mean(np.abs(true[1000:] - share) < 1.96 * std) < 0.98


@pytest.mark.parametrize("hidden", [29, 30, 31])
def test_what_counts_as_loose_does_not_depend_on_how_many_points_are_bridged(hidden: int) -> None:
    """Thirty seen points after as many bridged ones were once taken for a slice without a seen point."""
    profiles = product_of(HALF_ELLIPSOID, ELEVEN).profiles
    place = int(profiles.seen.sum(axis=1).argmax())
    points = np.flatnonzero(profiles.seen[place])
    seen = np.zeros_like(profiles.seen)
    seen[place, points[hidden : hidden + 30]] = True
    table, _ = slice_table.slice_areas(
        profiles.xyz_mm, profiles.product, seen, profiles.row_px, profiles.plane, profiles.frame, 1
    )
    assert 0.0 < table[place, slice_table.LOOSE] < 0.7 * table[place, slice_table.AREA]
