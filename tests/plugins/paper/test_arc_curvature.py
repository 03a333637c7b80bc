"""Henkei by arcs along the stripes, against circles whose centres are known."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from roemetry.records import Product, Profiles
from roemetry.records.calibration import Calibration
from roemetry_kernels.slices import body_curves, smoothed
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions

ROWS = 480
REST_PX = 300.0


def product_of(curves, displacement=-1.0, mm_per_row=1.0):
    """A product from (stripe, rows, x_px) curves on a rig whose stripes rest at x = 300 px.

    Heights are (x − 300) / displacement mm; Y falls by `mm_per_row` with each row.
    """
    stripes = max(stripe for stripe, _, _ in curves) + 1
    xyz_mm = np.full((stripes, ROWS, 3), np.nan)
    label = np.full((stripes, ROWS), -1, np.int16)
    x_px, row_px, unknown = np.full((3, stripes, ROWS), np.nan)
    for stripe, rows, x in curves:
        rows = np.asarray(rows)
        x_px[stripe, rows], row_px[stripe, rows], label[stripe, rows] = x, rows, 1
        xyz_mm[stripe, rows, 0], xyz_mm[stripe, rows, 1] = 0.0, -mm_per_row * rows
        xyz_mm[stripe, rows, 2] = (x_px[stripe, rows] - REST_PX) / displacement
    rest, moved = np.full((stripes, 1), REST_PX), np.full(stripes, displacement)
    calibration = Calibration("test", (ROWS, 640), 0, rest, moved, (0.0, 100.0), {}, np.zeros((0, 0)))
    plane = np.tile([1.0, 0.0, 0.0, 0.0], (stripes, 1))
    number, frame = np.arange(stripes), np.zeros(stripes, np.int64)
    profiles = Profiles(xyz_mm, label, label > 0, x_px, row_px, unknown, number, frame, plane)
    return Product(1, profiles, calibration, ("a",))


def circle(radius, bows, rows=None, middle_row=200.0, x=300.0):
    """Rows and x of an arc of a circle that bows to the left or right; `x` is where it bows farthest."""
    rows = np.arange(160, 241) if rows is None else rows
    across = radius - np.sqrt(radius**2 - (rows - middle_row) ** 2)
    return rows, x + (across if bows == "left" else -across)


def grade_of(*curves, displacement=-1.0, mm_per_row=1.0, **options):
    product = product_of(curves, displacement, mm_per_row)
    return ArcCurvature(ArcCurvatureOptions(**options)).classify(product)


def codes(grade):
    return [reason.code for reason in grade.reasons]


@pytest.mark.parametrize(
    ("bows", "radius", "label"),
    [("left", 45.0, "good"), ("left", 500.0, "good"), ("right", 45.0, "henkei"), ("right", 79.9, "henkei"),
     ("right", 80.1, "good")],
)  # fmt: skip
def test_an_arc_has_its_known_centre_and_is_concave_where_it_bows_right(bows, radius, label):
    grade = grade_of((0, *circle(radius, bows)))
    side = 1.0 if bows == "left" else -1.0
    assert grade.label == label
    np.testing.assert_allclose(grade.arrows.value, side * radius, atol=1e-6)  # px
    np.testing.assert_allclose(grade.arrows.to_px, [[300.0 + side * radius, 200.0]] * 4, atol=1e-6)  # px
    assert grade.features["arcs"] == 4
    assert grade.features["arcs_flagged"] == grade.arrows.flagged.sum() == (4 if label == "henkei" else 0)
    if bows == "left":
        assert math.isnan(grade.features["smallest_concave_radius_px"])
        assert codes(grade) == ["no-concave-arc"]
    else:
        assert grade.features["smallest_concave_radius_px"] == pytest.approx(radius, abs=1e-6)  # px


def test_only_the_stripe_with_the_dent_is_named_counted_from_one():
    curves = [(stripe, *circle(60.0, "left")) for stripe in range(5)]
    curves[3] = (3, *circle(50.0, "right"))
    grade = grade_of(*curves)
    assert grade.label == "henkei"
    text = grade.reasons[0].text
    assert text.startswith("4 of 20 arcs are concave with a radius between 4 and 80 px; ")
    assert "radius 50 px (a bow of 2.3 px), is on stripe 4 at x 297 px, row 216" in text
    assert set(grade.arrows.stripe[grade.arrows.flagged]) == {3}


@pytest.mark.parametrize("slope", [0.0, 0.5, -0.37])
def test_a_straight_line_is_infinitely_flat_and_not_drawn(slope):
    rows = np.arange(100, 200)
    grade = grade_of((0, rows, 300.0 + slope * (rows - 100)))
    assert grade.label == "good"
    assert (grade.features["arcs"], grade.features["arcs_concave"]) == (6, 0)
    assert grade.arrows.value.size == 0


@pytest.mark.parametrize("count", [1, 2, 14, 15, 28, 29, 42, 43, 57, 100])
@pytest.mark.parametrize("delta", [14, 3])
def test_n_points_give_as_many_centres_as_the_formula_says(count, delta):
    rows = np.arange(100, 100 + count)
    grade = grade_of((0, *circle(400.0, "left", rows, middle_row=150.0)), delta_samples=delta)
    expected = max(0, (count - 1) // delta - 1)
    assert grade.features["arcs"] == expected
    assert grade.label == ("good" if expected else "unknown")
    if expected:
        assert grade.arrows.from_px[:, 1].tolist() == [100.0 + delta * i for i in range(1, expected + 1)]
    else:
        assert codes(grade) == ["too-few-points"]
        assert f"{2 * delta + 1} points" in grade.reasons[0].text
        assert f"longest has {count}" in grade.reasons[0].text


def test_curves_are_cut_where_rows_are_missing():
    rows, x = circle(60.0, "right", np.arange(150, 251))
    kept = rows != 180
    grade = grade_of((0, rows[kept], x[kept]))
    # 30 points above the gap give one centre, 70 below it three.
    assert grade.features["arcs"] == 4
    np.testing.assert_allclose(grade.arrows.value, -60.0, atol=1e-6)  # px


@pytest.mark.parametrize(
    ("low", "high", "label"),
    [(4.0, 50.0, "good"), (4.0, 50.001, "henkei"), (50.0, 80.0, "good"), (49.999, 80.0, "henkei")],
)
def test_limits_are_exclusive(low, high, label):
    # Chord 28 px, bow 2 px: (14² + 2²) / (2 · 2) = 50 px, exactly.
    rows = np.arange(100, 129)
    x = np.where(rows == 114, 302.0, 300.0)
    grade = grade_of((0, rows, x), radius_min_px=low, radius_max_px=high)
    assert grade.arrows.value.tolist() == [-50.0]
    assert grade.label == label


def test_more_than_one_arc_can_be_asked_for():
    curve = (0, *circle(60.0, "right"))
    assert grade_of(curve, henkei_arcs_min=4).label == "henkei"
    few = grade_of(curve, henkei_arcs_min=5)
    assert few.label == "good"
    assert codes(few) == ["few-concave-arcs"]
    assert "fewer than the 5" in few.reasons[0].text


def circle_in_space(scale, **options):
    """The grade of the same concave circle of 60 mm, on a rig of `scale` px for each mm."""
    rows = np.arange(round(100 * scale), round(300 * scale) + 1)
    middle, radius = 200 * scale, 60.0 * scale
    x = REST_PX - (radius - np.sqrt(radius**2 - (0.25 * (rows - middle)) ** 2))
    return grade_of((0, rows, x), displacement=-scale, mm_per_row=1.0 / scale, **options)


@pytest.mark.parametrize("space", ["px", "mm"])
@pytest.mark.parametrize("scale", [0.5, 1.25, 1.5])
def test_lengths_in_pixels_are_those_of_the_scale_they_were_chosen_at(scale, space):
    """A flat ellipse: curvature and all lengths scale alike, so arcs and grade are the same."""
    given = {"radius_max_px": 990.0, "delta_samples": 20, "space": space}
    own, blind = circle_in_space(1.0, **given), circle_in_space(scale, **given)
    told = circle_in_space(scale, **given, tuned_at_mm_per_px=1.0)
    assert own.label == told.label == "henkei"
    assert told.features["arcs"] == own.features["arcs"] != blind.features["arcs"]
    assert told.features["arcs_flagged"] == own.features["arcs_flagged"]
    expected = own.arrows.value * (scale if space == "px" else 1.0)
    np.testing.assert_allclose(told.arrows.value, expected, rtol=1e-6)
    same = circle_in_space(1.0, **given, tuned_at_mm_per_px=1.0)
    np.testing.assert_array_equal(same.arrows.value, own.arrows.value)


@pytest.mark.parametrize("displacement", [-2.5, 2.5])
def test_millimetres_are_those_of_the_cross_section(displacement):
    # A circular dent of radius 20 mm in the cross-section, on a rig of 0.2 mm a row and ±2.5 px/mm.
    rows, radius_mm = np.arange(160, 241), 20.0
    z_mm = 20.0 - np.sqrt(radius_mm**2 - (0.2 * (rows - 200)) ** 2)
    rig = {"displacement": displacement, "mm_per_row": 0.2, "space": "mm", "radius_min_mm": 1.0}
    grade = grade_of((0, rows, REST_PX + displacement * z_mm), **rig, radius_max_mm=21.0)
    np.testing.assert_allclose(grade.arrows.value, -radius_mm, atol=1e-6)  # mm
    assert (grade.label, grade.arrows.unit) == ("henkei", "mm")
    assert grade.features["smallest_concave_radius_mm"] == pytest.approx(radius_mm, abs=1e-6)  # mm
    assert grade_of((0, rows, REST_PX + displacement * z_mm), **rig, radius_max_mm=19.9).label == "good"


def test_smoothing_is_the_local_quadratic(rng):
    """Also at the ends, where the window does not move on; curves too short for it stay."""
    rows = np.arange(100, 140)
    x = 300.0 + rng.normal(0, 1, rows.size)
    product = product_of([(0, rows, x), (1, rows[:4], 300.0), (2, [7], 300.0)])
    curves = body_curves(product.profiles, 1)
    assert curves.size.tolist() == [40, 4, 1]
    values = product.profiles.x_px[curves.slice, curves.point]
    smooth = smoothed(curves, values[:, None], 9)[:, 0]
    for i in range(rows.size):
        begin = min(max(i - 4, 0), rows.size - 9)
        window = slice(begin, begin + 9)
        quadratic = np.polyfit(rows[window] - 120.0, x[window], 2)
        assert smooth[i] == pytest.approx(np.polyval(quadratic, rows[i] - 120.0), abs=1e-8)  # px
    np.testing.assert_allclose(smooth[40:], 300.0, atol=1e-9)  # px


@pytest.mark.parametrize(
    "options", [{"smoothing_rows": 4}, {"radius_min_px": 80.0}, {"radius_min_mm": 5.0, "radius_max_mm": 5.0}]
)
def test_options_that_contradict_each_other_are_refused(options):
    with pytest.raises(ValidationError):
        ArcCurvatureOptions(**options)
