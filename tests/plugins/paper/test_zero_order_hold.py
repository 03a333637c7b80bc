"""The paper's volume against bodies whose volume is known, and mass by its Table 1."""

import math
from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Profiles, Shares, Volume
from roemetry.records.calibration import Calibration
from roemetry_paper.density import Density, DensityOptions
from roemetry_paper.zero_order_hold import ZeroOrderHold

STRIPES, ROWS, MM_PER_ROW = 11, 480, 0.1
X_MM = 10.0 * np.arange(STRIPES)  # rest positions, mm
Y_MM = -MM_PER_ROW * (np.arange(ROWS) - (ROWS - 1) / 2)
ROW = np.arange(ROWS)


def product_of(height, x_mm=X_MM, lean=0.0, stripe=None, frame=None):
    """A product of the given height z(x, y), NaN outside, cut by planes that lean by `lean` mm per mm.

    The height must not depend on x within the planes' lean.
    """
    x_mm = np.asarray(x_mm, np.float64)
    slices = x_mm.size
    z = np.array([height(x, Y_MM) for x in x_mm], np.float64)
    on = ~np.isnan(z)
    normal = np.array([1.0, 0.0, -lean]) / math.hypot(1.0, lean)
    profiles = Profiles(
        xyz_mm=np.stack([x_mm[:, None] + lean * z, np.where(on, Y_MM, np.nan), z], axis=2),
        product=np.where(on, 1, -1),
        seen=on,
        x_px=np.where(on, 300.0, np.nan),
        row_px=np.where(on, ROW, np.nan),
        height_std_mm=np.full(z.shape, np.nan),
        stripe=np.arange(slices) if stripe is None else stripe,
        frame=np.zeros(slices, np.int64) if frame is None else frame,
        plane=np.column_stack([np.tile(normal, (slices, 1)), x_mm * normal[0]]),
    )
    rest, moved = np.zeros((STRIPES, 1)), np.full(STRIPES, -1.0)
    calibration = Calibration("test", (ROWS, 640), 0, rest, moved, (0.0, 100.0), {}, np.zeros((0, 0)))
    return Product(1, profiles, calibration, ("a",))


def box(x_from, x_to, height_mm=5.0, half_width_mm=10.0):
    """A block that lies along X from x_from to x_to; its sides fall between two rows."""
    return lambda x, y: np.where(
        (x_from < x) & (x < x_to) & (np.abs(y) < half_width_mm), height_mm, np.nan
    )  # fmt: skip


def half_cylinder(x, y):
    """From 15 to 75 mm along X, its radius 15 mm."""
    return np.where(
        (x > 15.0) & (x < 75.0) & (np.abs(y) < 15.0), np.sqrt(np.maximum(225.0 - y**2, 0)), np.nan
    )


BOX = product_of(box(25.0, 75.0))
"""Lit: stripes at 30 … 70 mm, the last held to 80: 5 · 10 mm, 200 rows of 0.1 mm, 5 mm high."""


def estimate(product):
    return ZeroOrderHold().estimate(product)


def value(product):
    return estimate(product).visible_mm3.value


def codes(product):
    return [reason.code for reason in estimate(product).reasons]


def with_profiles(made, /, **fields):
    return replace(made, profiles=replace(made.profiles, **fields))


def without(product, slices, rows=slice(None)):
    """The product with nothing seen on some slices (and rows)."""
    nothing = {"xyz_mm": np.nan, "product": -1, "seen": False, "x_px": np.nan, "row_px": np.nan}
    new = {name: getattr(product.profiles, name).copy() for name in nothing}
    for name, none in nothing.items():
        new[name][slices, rows] = none
    return with_profiles(product, **new)


def test_box_between_the_stripes_is_exact():
    volume = estimate(BOX)
    assert volume.visible_mm3.value == pytest.approx(5 * 10.0 * 20.0 * 5.0, abs=1e-6)  # mm³
    assert math.isnan(volume.visible_mm3.std)
    assert volume.true_mm3 is None
    assert volume.slice_stripe.tolist() == [3, 4, 5, 6, 7]
    np.testing.assert_allclose(volume.slice_area_mm2, 100.0, atol=1e-9)  # mm²
    np.testing.assert_allclose(volume.slice_spacing_mm, 10.0, atol=1e-12)  # mm
    assert (volume.shares.seen, volume.shares.interpolated, volume.shares.assumed) == (1.0, 0.0, 0.0)
    assert volume.reasons == ()


@pytest.mark.parametrize("lean", [0.0, 0.7, -1.5])
def test_half_cylinder_whatever_the_planes_lean(lean):
    exact = 0.5 * math.pi * 15.0**2 * 60.0
    assert value(product_of(half_cylinder, lean=lean)) == pytest.approx(
        exact, abs=10.0
    )  # mm³: rows of 0.1 mm


def test_it_is_the_papers_sum(rng):
    heights = rng.uniform(1.0, 20.0, (STRIPES, ROWS))
    heights[[0, -1]] = np.nan
    heights[:, :40] = heights[:, -40:] = np.nan
    x_mm = np.cumsum(rng.uniform(5.0, 15.0, STRIPES))
    product = product_of(lambda x, _: heights[np.argmin(np.abs(x_mm - x))], x_mm)
    paper = sum((x_mm[i + 1] - x_mm[i]) * np.nansum(heights[i]) * MM_PER_ROW for i in range(STRIPES - 1))
    assert value(product) == pytest.approx(paper, abs=1e-6)  # mm³


@pytest.mark.parametrize("how", ["nothing seen", "no slice"])
def test_a_dead_stripe_is_held_over_and_counted_as_assumed(how):
    kept = np.arange(STRIPES) != 5
    names = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm", "stripe", "frame", "plane")
    short = with_profiles(BOX, **{name: getattr(BOX.profiles, name)[kept] for name in names})
    volume = estimate(without(BOX, [5]) if how == "nothing seen" else short)
    assert volume.visible_mm3.value == pytest.approx(5000.0, abs=1e-6)  # mm³
    assert volume.slice_stripe.tolist() == [3, 4, 6, 7]
    np.testing.assert_allclose(volume.slice_spacing_mm, [10.0, 20.0, 10.0, 10.0], atol=1e-12)  # mm
    assert (volume.shares.seen, volume.shares.assumed) == pytest.approx((0.8, 0.2), abs=1e-12)
    assert [reason.code for reason in volume.reasons] == ["dead-stripe"]
    assert "1 stripe shows nothing (after stripe 5)" in volume.reasons[0].text
    two = estimate(without(BOX, [4, 5]))
    assert two.shares.assumed == pytest.approx(0.4, abs=1e-12)
    assert "2 stripes show nothing (after stripe 4)" in two.reasons[0].text


def test_belt_points_make_a_stripe_live_with_area_zero():
    # Two lumps under one number, with a stripe between that shows bare belt: nothing is held over it.
    product = without(BOX, [5])
    belt = {n: getattr(product.profiles, n).copy() for n in ("xyz_mm", "product", "seen", "x_px", "row_px")}
    belt["xyz_mm"][5] = np.column_stack([np.full(ROWS, 50.0), Y_MM, np.zeros(ROWS)])
    belt["product"][5], belt["seen"][5], belt["x_px"][5], belt["row_px"][5] = 0, True, 1.0, ROW
    volume = estimate(with_profiles(product, **belt))
    assert volume.visible_mm3.value == pytest.approx(4000.0, abs=1e-6)  # mm³
    assert volume.shares.assumed == 0.0


def test_bridged_points_count_and_are_shared_out():
    seen = BOX.profiles.seen.copy()
    seen[4, 190:240] = False  # 50 of 200 rows, on one of five slices
    volume = estimate(with_profiles(BOX, seen=seen))
    assert volume.visible_mm3.value == pytest.approx(5000.0, abs=1e-6)  # mm³
    assert (volume.shares.seen, volume.shares.interpolated) == pytest.approx((0.95, 0.05), abs=1e-12)


def test_rows_neither_seen_nor_bridged_count_nothing_and_are_told():
    volume = estimate(without(BOX, [4], slice(200, 240)))
    assert volume.visible_mm3.value == pytest.approx(5000.0 - 40 * 0.1 * 5.0 * 10.0, abs=1e-6)  # mm³
    assert [reason.code for reason in volume.reasons] == ["gap-in-slice"]
    assert volume.reasons[0].text.startswith("40 rows ")


def test_each_point_owns_half_the_way_to_its_neighbours():
    # Four rows at Y = 0, 1, 3 and 7 mm stand for 1, 1.5, 3 and 4 mm: at the ends as much outwards as inwards.
    product = product_of(lambda x, y: np.where((ROW < 204) & (ROW >= 200), x, np.nan))
    xyz_mm = product.profiles.xyz_mm.copy()
    xyz_mm[:, 200:204, 1] = [7.0, 3.0, 1.0, 0.0]
    xyz_mm[:, 200:204, 2] = [2.0, 3.0, 5.0, 7.0]
    area = estimate(with_profiles(product, xyz_mm=xyz_mm)).slice_area_mm2
    np.testing.assert_allclose(area, 4 * 2.0 + 3 * 3.0 + 1.5 * 5.0 + 1 * 7.0, atol=1e-9)  # mm²


def test_points_that_are_all_alone_take_the_scale_between_them():
    sparse = product_of(
        lambda x, _: np.where((ROW % 4 == 0) & (ROW >= 40) & (ROW < 400) & (25.0 < x < 75.0), 5.0, np.nan)
    )
    assert value(sparse) == pytest.approx(5 * 10.0 * 90 * 0.1 * 5.0, abs=1e-6)  # mm³
    with pytest.raises(StageError, match="single row"):
        estimate(without(sparse, slice(None), slice(41, 400)))


def test_the_spacing_is_taken_at_the_products_middle():
    # The second plane runs askew: 10 mm from the first at Y = 0, 1 mm further for every 10 mm of Y.
    product = product_of(box(-5.0, 15.0), [0.0, 10.0, 20.0])
    plane = product.profiles.plane.copy()
    plane[1] = np.array([1.0, -0.1, 0.0, 10.0]) / math.hypot(1.0, 0.1)
    for up_mm, spacing in ((0.0, [10.0, 10.0]), (10.0, [11.0, 9.0])):
        moved = with_profiles(
            product, plane=plane, xyz_mm=product.profiles.xyz_mm + np.array([0.0, up_mm, 0.0])
        )
        np.testing.assert_allclose(estimate(moved).slice_spacing_mm, spacing, atol=1e-9)  # mm


def test_slices_of_several_frames_make_one_product():
    # A scan: two stripes, the belt moves by 4 mm a frame, so the two stripes' slices lie between each other.
    x_mm = np.concatenate([[4.0 * frame, 4.0 * frame + 18.0] for frame in range(20)])
    scan = product_of(half_cylinder, x_mm, stripe=np.tile([0, 1], 20), frame=np.repeat(np.arange(20), 2))
    volume = estimate(scan)
    exact = 0.5 * math.pi * 15.0**2 * (x_mm[x_mm > 75.0].min() - x_mm[x_mm > 15.0].min())
    assert volume.visible_mm3.value == pytest.approx(exact, abs=10.0)  # mm³
    assert (volume.shares.assumed, volume.reasons) == (0.0, ())


def test_the_last_stripes_slice_is_not_counted_and_told():
    volume = estimate(product_of(box(75.0, 200.0)))
    assert volume.slice_stripe.tolist() == [8, 9, 10]
    assert volume.slice_spacing_mm.tolist() == [10.0, 10.0, 0.0]
    assert volume.visible_mm3.value == pytest.approx(2000.0, abs=1e-6)  # mm³
    assert [reason.code for reason in volume.reasons] == ["last-slice-not-counted", "beyond-outer-stripes"]
    assert volume.reasons[0].text == "the last lit stripe's slice is not counted (the paper's sum)"
    assert codes(product_of(box(-50.0, 25.0))) == ["beyond-outer-stripes"]


@pytest.mark.parametrize(
    ("first", "last", "cut"),
    [(0, 300, True), (1, 300, True), (200, 480, True), (200, 479, True), (2, 478, False)],
)
def test_a_product_cut_by_the_image_is_told(first, last, cut):
    body = product_of(lambda x, _: np.where((first <= ROW) & (last > ROW) & (25.0 < x < 75.0), 5.0, np.nan))
    assert codes(body) == (["cut-by-edge"] if cut else [])


def test_points_below_the_belt_keep_their_sign():
    volume = estimate(product_of(lambda x, y: box(25.0, 75.0)(x, y) * np.where(y > 0.0, 1.0, -0.2)))
    assert volume.visible_mm3.value == pytest.approx(5000.0 * (0.5 - 0.1), abs=1e-6)  # mm³
    assert volume.shares.seen == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (box(25.0, 75.0, height_mm=-5.0), r"-5000 mm³: .*below the belt"),
        (box(31.0, 39.0), "no stripe on the product"),
        (box(95.0, 105.0), "only the last stripe"),
    ],
)
def test_what_is_no_volume_is_an_error_in_words(body, says):
    with pytest.raises(StageError, match=says):
        estimate(product_of(body))


def test_a_plane_along_x_is_an_error_in_words():
    plane = BOX.profiles.plane.copy()
    plane[2] = [0.0, 1.0, 0.0, 3.0]
    with pytest.raises(StageError, match=r"stripe 3 .*along X"):
        estimate(with_profiles(BOX, plane=plane))


# Table 1: volume as printed (headed mm³, cm³ by its own arithmetic), estimated weight (g).
TABLE_1 = {
    "good": (20.64, 22.7),
    "henkei 1": (24.07, 26.5),
    "henkei 2": (34.13, 37.5),
    "henkei 3": (32.81, 36.2),
    "henkei 4": (25.96, 28.6),
}


@pytest.fixture
def product():
    nothing, no_slices = [np.empty((0, 0))] * 5, np.empty(0)
    profiles = Profiles(np.empty((0, 0, 3)), *nothing, no_slices, no_slices, np.empty((0, 4)))
    calibration = Calibration(
        "test", (480, 640), 0, np.empty((0, 1)), np.empty(0), (0.0, 30.0), {}, np.zeros((0, 0))
    )
    return Product(1, profiles, calibration, ("a",))


def volume_of(visible, true=None):
    return Volume(visible, true, Shares(1.0, 0.0, 0.0))


def weigh(product, volume, rng=None, **options):
    return Density(DensityOptions(**options)).weigh(product, volume, rng=rng)


@pytest.mark.parametrize("sample", TABLE_1)
def test_table_1(product, sample):
    """The print rounds to 0.1 g. Henkei 3 is a slip of the print: 32.81 · 1.1 = 36.09, not 36.2."""
    printed, weight_g = TABLE_1[sample]
    mass_g = weigh(product, volume_of(Estimate(printed * 1000.0))).mass_g.value
    assert round(mass_g, 1) == (36.1 if sample == "henkei 3" else weight_g)


def test_the_true_volume_is_taken_or_the_visible_one_and_that_is_told(product):
    visible = weigh(product, volume_of(Estimate(20_000.0)))
    assert visible.mass_g.value == pytest.approx(22.0, abs=1e-12)  # g
    assert [reason.code for reason in visible.reasons] == ["visible-taken-for-true"]
    true = weigh(product, volume_of(Estimate(20_000.0), Estimate(18_000.0)), density_g_per_cm3=1.0)
    assert true.mass_g.value == pytest.approx(18.0, abs=1e-12)  # g
    assert true.reasons == ()


def test_uncertainties_are_combined_by_cause(product):
    """1.1 · 0.6 = 0.66 g from the volume, or of its own causes, 20 · 0.02 = 0.4 g from the density."""
    mass_g = weigh(product, volume_of(Estimate(20_000.0, 600.0)), density_std_g_per_cm3=0.02).mass_g
    assert mass_g.budget == pytest.approx({"volume": 0.66, "density": 0.4}, abs=1e-12)  # g
    assert mass_g.std == pytest.approx(math.hypot(0.66, 0.4), abs=1e-12)  # g
    volume = volume_of(Estimate(20_000.0, 500.0, {"peaks": 300.0, "calibration": 400.0}))
    budget = weigh(product, volume, density_std_g_per_cm3=0.02).mass_g.budget
    assert budget == pytest.approx({"peaks": 0.33, "calibration": 0.44, "density": 0.4}, abs=1e-12)  # g


def test_what_is_not_known_is_not_stated(product):
    for std, density_std in ((math.nan, 0.02), (600.0, None), (math.nan, None)):
        mass_g = weigh(product, volume_of(Estimate(20_000.0, std)), density_std_g_per_cm3=density_std).mass_g
        assert math.isnan(mass_g.std)
        assert mass_g.budget == {}


def test_draws_scatter_by_the_densitys_uncertainty(product):
    rng = np.random.default_rng(7)
    volume = volume_of(Estimate(20_000.0))
    draws = [weigh(product, volume, rng, density_std_g_per_cm3=0.02).mass_g.value for _ in range(4000)]
    assert np.mean(draws) == pytest.approx(22.0, abs=0.03)  # g: 4.7 standard errors
    assert np.std(draws) == pytest.approx(0.4, abs=0.02)  # g
    still = [weigh(product, volume, rng).mass_g.value for _ in range(3)]
    assert still == pytest.approx([22.0] * 3, abs=1e-12)  # g
