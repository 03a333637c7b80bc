"""The paper's sum of slices, against bodies whose volume is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Product, Profiles
from roemetry.records.calibration import Calibration
from roemetry_paper.zero_order_hold import ZeroOrderHold

STRIPES, ROWS, MM_PER_ROW = 11, 480, 0.1
X_MM = 10.0 * np.arange(STRIPES)  # rest positions, mm
Y_MM = -MM_PER_ROW * (np.arange(ROWS) - (ROWS - 1) / 2)


def product_of(height, x_mm=X_MM, lean=0.0, stripe=None, frame=None):
    """A product of the given height z(x, y), NaN outside, cut by planes that lean by `lean` mm per mm.

    The height must not depend on x within the planes' lean.
    """
    x_mm = np.asarray(x_mm, np.float64)
    slices = x_mm.size
    z = np.array([height(x, Y_MM) for x in x_mm], np.float64)
    on_product = ~np.isnan(z)
    x = x_mm[:, None] + lean * z
    row = np.broadcast_to(np.arange(float(ROWS)), z.shape)
    normal = np.array([1.0, 0.0, -lean]) / math.hypot(1.0, lean)
    profiles = Profiles(
        xyz_mm=np.stack([x, np.where(on_product, Y_MM, np.nan), z], axis=2),
        product=np.where(on_product, 1, -1),
        seen=on_product,
        x_px=np.where(on_product, 300.0, np.nan),
        row_px=np.where(on_product, row, np.nan),
        height_std_mm=np.full(z.shape, np.nan),
        stripe=np.arange(slices) if stripe is None else np.asarray(stripe),
        frame=np.zeros(slices, np.int64) if frame is None else np.asarray(frame),
        plane=np.column_stack([np.tile(normal, (slices, 1)), x_mm * normal[0]]),
    )
    calibration = Calibration(
        method="test",
        image_size=(ROWS, 640),
        turn_deg=0,
        rest_px=np.zeros((STRIPES, 1)),
        displacement_px_per_mm=np.full(STRIPES, -1.0),
        height_range_mm=(0.0, 100.0),
        parameters={},
        covariance=np.zeros((0, 0)),
    )
    return Product(1, profiles, calibration, ("a",))


def box(x_from, x_to, height_mm=5.0, half_width_mm=10.0):
    """A block that lies along X from x_from to x_to; its sides fall between two rows."""

    def height(x, y):
        inside = (x_from < x) & (x < x_to) & (np.abs(y) < half_width_mm)
        return np.where(inside, height_mm, np.nan)

    return height


def half_cylinder(x_from, x_to, radius_mm=15.0):
    def height(x, y):
        inside = (x_from < x) & (x < x_to) & (np.abs(y) < radius_mm)
        return np.where(inside, np.sqrt(np.clip(radius_mm**2 - y**2, 0.0, None)), np.nan)

    return height


def estimate(product):
    return ZeroOrderHold().estimate(product)


def codes(volume):
    return [reason.code for reason in volume.reasons]


def pick(product, slices):
    """The product with its slices chosen, or put in another order."""
    profiles = product.profiles
    names = (
        "xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm", "stripe", "frame", "plane"
    )  # fmt: skip
    return replace(product, profiles=replace(profiles, **{n: getattr(profiles, n)[slices] for n in names}))


def without(product, slices, rows=slice(None)):
    """The product with nothing seen on some slices (and rows)."""
    profiles = product.profiles
    nothing = {"xyz_mm": np.nan, "product": -1, "seen": False, "x_px": np.nan, "row_px": np.nan}
    new = {name: getattr(profiles, name).copy() for name in nothing}
    for name, value in nothing.items():
        new[name][slices, rows] = value
    return replace(product, profiles=replace(profiles, **new))


def test_box_between_the_stripes_is_exact():
    # Lit: stripes at 30 … 70 mm, the last held to 80: 5 · 10 mm, 200 rows of 0.1 mm, 5 mm high.
    volume = estimate(product_of(box(25.0, 75.0)))
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
    radius_mm, length_mm = 15.0, 60.0
    volume = estimate(product_of(half_cylinder(15.0, 75.0, radius_mm), lean=lean))
    exact = 0.5 * math.pi * radius_mm**2 * length_mm
    assert exact == pytest.approx(21206, abs=1)  # mm³
    assert volume.visible_mm3.value == pytest.approx(exact, abs=10.0)  # mm³: rows of 0.1 mm


def test_it_is_the_papers_sum():
    rng = np.random.default_rng(1)
    heights = rng.uniform(1.0, 20.0, (STRIPES, ROWS))
    heights[[0, -1]] = np.nan
    heights[:, :40] = heights[:, -40:] = np.nan
    spacings = rng.uniform(5.0, 15.0, STRIPES)
    x_mm = np.cumsum(spacings)
    product = product_of(lambda x, _: heights[np.argmin(np.abs(x_mm - x))], x_mm)
    paper = sum((x_mm[i + 1] - x_mm[i]) * np.nansum(heights[i]) * MM_PER_ROW for i in range(STRIPES - 1))
    assert estimate(product).visible_mm3.value == pytest.approx(paper, abs=1e-6)  # mm³


def test_slices_may_come_in_any_order():
    product = product_of(half_cylinder(15.0, 75.0))
    straight = estimate(product)
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(STRIPES)
        other = estimate(pick(product, order))
        assert other.visible_mm3.value == pytest.approx(straight.visible_mm3.value, abs=1e-9)
        assert other.slice_stripe.tolist() == straight.slice_stripe.tolist()
        assert other.shares == straight.shares


def test_points_may_come_in_any_order():
    product = product_of(half_cylinder(15.0, 75.0))
    profiles = product.profiles
    names = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm")
    turned = replace(profiles, **{n: getattr(profiles, n)[:, ::-1] for n in names})
    straight, other = estimate(product), estimate(replace(product, profiles=turned))
    assert other.visible_mm3.value == pytest.approx(straight.visible_mm3.value, abs=1e-9)


@pytest.mark.parametrize("k", [0.5, 2.0, 10.0])
def test_volume_grows_with_the_cube_of_size(k):
    product = product_of(half_cylinder(15.0, 75.0), lean=0.5)
    profiles = product.profiles
    larger = replace(profiles, xyz_mm=k * profiles.xyz_mm, plane=profiles.plane * [1.0, 1.0, 1.0, k])
    one, many = estimate(product), estimate(replace(product, profiles=larger))
    assert many.visible_mm3.value == pytest.approx(k**3 * one.visible_mm3.value, rel=1e-12)
    assert many.shares.seen == pytest.approx(one.shares.seen, abs=1e-12)


@pytest.mark.parametrize("how", ["nothing seen", "no slice"])
def test_a_dead_stripe_is_held_over_and_counted_as_assumed(how):
    product = product_of(box(25.0, 75.0))
    gone = without(product, [5]) if how == "nothing seen" else pick(product, [0, 1, 2, 3, 4, 6, 7, 8, 9, 10])
    volume = estimate(gone)
    assert volume.visible_mm3.value == pytest.approx(5000.0, abs=1e-6)  # mm³
    assert volume.slice_stripe.tolist() == [3, 4, 6, 7]
    np.testing.assert_allclose(volume.slice_spacing_mm, [10.0, 20.0, 10.0, 10.0], atol=1e-12)  # mm
    assert volume.shares.assumed == pytest.approx(0.2, abs=1e-12)
    assert volume.shares.seen == pytest.approx(0.8, abs=1e-12)
    assert codes(volume) == ["dead-stripe"]
    assert "1 stripe shows nothing (after stripe 5)" in volume.reasons[0].text


def test_two_dead_stripes_in_a_row():
    volume = estimate(without(product_of(box(25.0, 75.0)), [4, 5]))
    assert volume.shares.assumed == pytest.approx(0.4, abs=1e-12)
    assert "2 stripes show nothing (after stripe 4)" in volume.reasons[0].text


def test_bare_stripes_beyond_the_product_are_not_dead():
    volume = estimate(product_of(box(25.0, 35.0)))
    assert volume.slice_stripe.tolist() == [3]
    assert volume.visible_mm3.value == pytest.approx(1000.0, abs=1e-6)  # mm³
    assert volume.shares.assumed == 0.0
    assert volume.reasons == ()


def test_belt_points_make_a_stripe_live_with_area_zero():
    # Two lumps under one number, with a stripe between that shows bare belt: nothing is held over it.
    product = without(product_of(box(25.0, 75.0)), [5])
    belt = {n: getattr(product.profiles, n).copy() for n in ("xyz_mm", "product", "seen", "x_px", "row_px")}
    belt["xyz_mm"][5] = np.column_stack([np.full(ROWS, 50.0), Y_MM, np.zeros(ROWS)])
    belt["product"][5], belt["seen"][5], belt["x_px"][5], belt["row_px"][5] = 0, True, 1.0, np.arange(ROWS)
    volume = estimate(replace(product, profiles=replace(product.profiles, **belt)))
    assert volume.visible_mm3.value == pytest.approx(4000.0, abs=1e-6)  # mm³
    assert volume.shares.assumed == 0.0


def test_bridged_points_count_and_are_shared_out():
    product = product_of(box(25.0, 75.0))
    seen = product.profiles.seen.copy()
    seen[4, 190:240] = False  # 50 of 200 rows, on one of five slices
    volume = estimate(replace(product, profiles=replace(product.profiles, seen=seen)))
    assert volume.visible_mm3.value == pytest.approx(5000.0, abs=1e-6)  # mm³
    assert volume.shares.interpolated == pytest.approx(0.05, abs=1e-12)
    assert volume.shares.seen == pytest.approx(0.95, abs=1e-12)


def test_rows_neither_seen_nor_bridged_count_nothing_and_are_told():
    volume = estimate(without(product_of(box(25.0, 75.0)), [4], slice(200, 240)))
    assert volume.visible_mm3.value == pytest.approx(5000.0 - 40 * 0.1 * 5.0 * 10.0, abs=1e-6)  # mm³
    assert codes(volume) == ["gap-in-slice"]
    assert volume.reasons[0].text.startswith("40 rows ")


def test_a_point_alone_stands_for_one_row():
    product = without(product_of(box(25.0, 75.0)), [4], slice(200, 202))
    alone = without(product, [4], slice(203, 480))
    kept = 1000.0 * 4 + (60 + 1) * 0.1 * 5.0 * 10.0  # rows 140 … 199, and 202
    assert estimate(alone).visible_mm3.value == pytest.approx(kept, abs=1e-6)  # mm³


def test_each_point_owns_half_the_way_to_its_neighbours():
    # Four rows at Y = 0, 1, 3 and 7 mm stand for 1, 1.5, 3 and 4 mm: at the ends as much outwards as inwards.
    product = product_of(lambda x, y: np.where((np.arange(ROWS) < 204) & (np.arange(ROWS) >= 200), x, np.nan))
    xyz_mm = product.profiles.xyz_mm.copy()
    xyz_mm[:, 200:204, 1] = [7.0, 3.0, 1.0, 0.0]
    xyz_mm[:, 200:204, 2] = [2.0, 3.0, 5.0, 7.0]
    volume = estimate(replace(product, profiles=replace(product.profiles, xyz_mm=xyz_mm)))
    np.testing.assert_allclose(
        volume.slice_area_mm2, 4 * 2.0 + 3 * 3.0 + 1.5 * 5.0 + 1 * 7.0, atol=1e-9
    )  # mm²


def test_points_that_are_all_alone_take_the_scale_between_them():
    def height(x, _):
        return np.where((np.arange(ROWS) % 4 == 0) & (25.0 < x < 75.0), 5.0, np.nan)

    product = without(product_of(height), slice(None), slice(400, 480))
    volume = estimate(without(product, slice(None), slice(0, 40)))
    assert volume.visible_mm3.value == pytest.approx(5 * 10.0 * 90 * 0.1 * 5.0, abs=1e-6)  # mm³
    one_row = without(without(product, slice(None), slice(0, 40)), slice(None), slice(41, 400))
    with pytest.raises(StageError, match="single row"):
        estimate(one_row)


def test_the_spacing_is_taken_at_the_products_middle():
    # The second plane runs askew: 10 mm from the first at Y = 0, 1 mm further for every 10 mm of Y.
    x_mm = np.array([0.0, 10.0, 20.0])
    product = product_of(box(-5.0, 15.0), x_mm)
    plane = product.profiles.plane.copy()
    plane[1] = np.array([1.0, -0.1, 0.0, 10.0]) / math.hypot(1.0, 0.1)
    skew = replace(product, profiles=replace(product.profiles, plane=plane))
    np.testing.assert_allclose(estimate(skew).slice_spacing_mm, [10.0, 10.0], atol=1e-9)  # mm
    xyz_mm = skew.profiles.xyz_mm + np.array([0.0, 10.0, 0.0])
    moved = replace(skew, profiles=replace(skew.profiles, xyz_mm=xyz_mm))
    np.testing.assert_allclose(estimate(moved).slice_spacing_mm, [11.0, 9.0], atol=1e-9)  # mm


def test_slices_of_several_frames_make_one_product():
    # A scan: two stripes, the belt moves by 4 mm a frame, so the two stripes' slices lie between each other.
    x_mm = np.concatenate([[4.0 * frame, 4.0 * frame + 18.0] for frame in range(20)])
    product = product_of(
        half_cylinder(15.0, 75.0), x_mm, stripe=np.tile([0, 1], 20), frame=np.repeat(np.arange(20), 2)
    )
    volume = estimate(product)
    first, following = x_mm[x_mm > 15.0].min(), x_mm[x_mm > 75.0].min()
    exact = 0.5 * math.pi * 15.0**2 * (following - first)
    assert volume.visible_mm3.value == pytest.approx(exact, abs=10.0)  # mm³
    assert volume.shares.assumed == 0.0
    assert volume.reasons == ()


def test_the_last_stripes_slice_is_not_counted_and_told():
    volume = estimate(product_of(box(75.0, 200.0)))
    assert volume.slice_stripe.tolist() == [8, 9, 10]
    assert volume.slice_spacing_mm.tolist() == [10.0, 10.0, 0.0]
    assert volume.visible_mm3.value == pytest.approx(2000.0, abs=1e-6)  # mm³
    assert codes(volume) == ["last-slice-not-counted", "beyond-outer-stripes"]
    assert volume.reasons[0].text == "the last lit stripe's slice is not counted (the paper's sum)"


def test_a_product_beyond_the_first_stripe_is_told():
    assert codes(estimate(product_of(box(-50.0, 25.0)))) == ["beyond-outer-stripes"]


@pytest.mark.parametrize("rows", [slice(0, 300), slice(1, 300), slice(200, 480), slice(200, 479)])
def test_a_product_cut_by_the_image_is_told(rows):
    def height(x, _):
        z = np.full(ROWS, np.nan)
        z[rows] = 5.0 if 25.0 < x < 75.0 else np.nan
        return z

    assert codes(estimate(product_of(height))) == ["cut-by-edge"]


def test_one_row_from_being_cut():
    def height(x, _):
        return np.where((np.arange(ROWS) >= 2) & (25.0 < x < 75.0), 5.0, np.nan)

    assert codes(estimate(without(product_of(height), slice(None), slice(478, 480)))) == []


def test_points_below_the_belt_keep_their_sign():
    def height(x, y):
        z = box(25.0, 75.0)(x, y)
        return np.where(y > 0.0, z, -0.2 * z)

    volume = estimate(product_of(height))
    assert volume.visible_mm3.value == pytest.approx(5000.0 * (0.5 - 0.1), abs=1e-6)  # mm³
    assert volume.shares.seen == pytest.approx(1.0, abs=1e-12)


def test_what_is_no_volume_is_an_error_in_words():
    with pytest.raises(StageError, match=r"-5000 mm³: .*below the belt"):
        estimate(product_of(box(25.0, 75.0, height_mm=-5.0)))
    with pytest.raises(StageError, match="no stripe on the product"):
        estimate(product_of(box(31.0, 39.0)))
    with pytest.raises(StageError, match="only the last stripe"):
        estimate(product_of(box(95.0, 105.0)))


def test_a_plane_along_x_is_an_error_in_words():
    product = product_of(box(25.0, 75.0))
    plane = product.profiles.plane.copy()
    plane[2] = [0.0, 1.0, 0.0, 3.0]
    with pytest.raises(StageError, match=r"stripe 3 .*along X"):
        estimate(replace(product, profiles=replace(product.profiles, plane=plane)))
