"""Shape features against bodies of known shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.testing.solids import (
    BOX,
    HALF_CYLINDER,
    HALF_ELLIPSOID,
    SPHERICAL_CAP,
    product_from,
    product_of,
)
from roemetry_shape.features import features_of, shape_features
from roemetry_shape.product_frame import SAMPLES, Sections, sections_of
from roemetry_shape.regions import hollow_depth, hollows_of, local_quadrics, surface_shape


@settings(deadline=None)  # the first example may compile a kernel
@given(st.lists(st.floats(-5, 5), min_size=3, max_size=30))
def test_the_hull_lies_over_the_curve_and_is_concave(heights: list[float]) -> None:
    across = np.arange(len(heights), dtype=float)[None]
    height = np.array(heights)[None]
    hull = (height + hollow_depth(across, height))[0]
    assert (hull >= height[0] - 1e-9).all()
    assert (np.diff(hull, 2) <= 1e-9).all()
    assert hull[0] == height[0, 0]
    assert hull[-1] == height[0, -1]


def test_a_half_ellipsoid_is_what_it_is() -> None:
    features = shape_features(product_of(HALF_ELLIPSOID), 0)
    assert features["thickness_mm"] == pytest.approx(HALF_ELLIPSOID.height_mm, rel=0.02)
    assert features["fullness_median"] == pytest.approx(np.pi / 4, abs=0.02)
    for name in ("dents", "dent_depth_mm", "bend_mm", "twist_deg", "kink_deg", "cup_depth_mm"):
        assert features[name] == pytest.approx(0.0, abs=0.05), name


@pytest.mark.thorough
def test_a_kink_is_found_with_its_angle() -> None:
    """A prism of 201 sections whose middles turn by 10 degrees half way."""
    count = 201
    along = np.linspace(0.0, 80.0, count)
    off = np.tan(np.radians(10.0)) * np.maximum(along - 40.0, 0.0)
    across = np.linspace(-8.0, 8.0, SAMPLES) * np.ones((count, 1))
    height = 10.0 * np.sqrt(1.0 - np.linspace(-0.99, 0.99, SAMPLES) ** 2) * np.ones((count, 1))
    middle = np.column_stack([along, off])
    x = np.broadcast_to(along[:, None], height.shape)
    found = features_of(Sections(np.arange(count), along, middle, np.full(count, 8.0), height, across, x))
    assert found["kink_deg"] == pytest.approx(10.0, abs=0.5)
    assert found["edge_kink_deg"] == pytest.approx(10.0, abs=0.5)
    assert found["kink_rest_mm"] < 0.05
    assert found["twist_deg"] == pytest.approx(0.0, abs=0.5)


def test_a_product_cut_off_lacks_the_stripes_that_it_should_meet() -> None:
    """A half-ellipsoid ends within a stripe's pitch; cut in the middle, it goes on at its full height."""
    product = product_of(HALF_ELLIPSOID)
    whole = shape_features(product, 0)
    label = product.profiles.product.copy()
    label[: label.shape[0] // 2] = 0
    cut = shape_features(replace(product, profiles=replace(product.profiles, product=label)), 0)
    for name in ("stripes_missing_by_area", "stripes_missing_by_width"):
        assert whole[name] < 1.5  # a chord of the parabola is flatter than its end
        assert cut[name] > 2.0


def test_an_outer_sliver_is_no_section() -> None:
    """Whether the light at a thin end is just seen or just missed must not change the features."""
    product = product_of(BOX)
    whole = sections_of(product, 0)
    xyz = product.profiles.xyz_mm.copy()
    first = int(np.flatnonzero(product.profiles.stripe == whole.stripe[0])[0])
    xyz[first, :, 2] *= 0.1
    thin = replace(product, profiles=replace(product.profiles, xyz_mm=xyz))
    assert sections_of(thin, 0).stripe.tolist() == whole.stripe[1:].tolist()
    label = product.profiles.product.copy()
    label[first] = 0
    gone = replace(product, profiles=replace(product.profiles, product=label))
    assert shape_features(thin, 0) == pytest.approx(shape_features(gone, 0), nan_ok=True)


def test_a_spheres_curvatures_are_its_radius_and_its_normals_point_away_from_its_centre() -> None:
    found = surface_shape(sections_of(product_of(SPHERICAL_CAP), 0))
    middle = found.shape_index.shape[0] // 2, found.shape_index.shape[1] // 2
    foot, height = SPHERICAL_CAP.length_mm / 2, SPHERICAL_CAP.height_mm
    radius = (foot**2 + height**2) / (2 * height)
    assert found.curvature_max[middle] == pytest.approx(-1 / radius, rel=0.15)  # 1/mm
    assert found.curvature_min[middle] == pytest.approx(-1 / radius, rel=0.15)  # 1/mm
    assert found.shape_index[middle] == pytest.approx(-1.0, abs=0.1)
    near = np.hypot(found.x_mm, found.y_mm) < 0.6 * foot
    assert near.sum() > 20
    np.testing.assert_allclose(found.normal_x[near], found.x_mm[near] / radius, atol=0.05)
    np.testing.assert_allclose(found.normal_y[near], found.y_mm[near] / radius, atol=0.05)
    tilt = np.degrees(np.arcsin(np.hypot(found.normal_x, found.normal_y)))
    np.testing.assert_allclose(tilt, found.slope_deg, atol=1e-9)


def test_a_quadric_is_fitted_by_itself(rng: np.random.Generator) -> None:
    f, d, e, a, b, c = wanted = rng.normal(size=6) * np.array([5.0, 0.3, 0.3, 0.05, 0.05, 0.05])
    x = np.repeat(np.array([0.0, 8.0, 17.0])[:, None], 65, axis=1)
    y = np.linspace(-15.0, 15.0, 65) + np.array([0.0, 0.4, -0.3])[:, None]
    middle = x[1, 20], y[1, 20]
    u, v = x - middle[0], y - middle[1]
    z = f + d * u + e * v + 0.5 * (a * u**2 + 2 * b * u * v + c * v**2)
    fit = local_quadrics(x, y, z, 20, 21, 2, 6)
    np.testing.assert_allclose(fit[0, 0], wanted, atol=1e-6)  # mm, 1, 1/mm


def test_a_cylinder_is_bent_one_way_only() -> None:
    found = surface_shape(sections_of(product_of(HALF_CYLINDER), 0))
    middle = found.shape_index.shape[0] // 2, found.shape_index.shape[1] // 2
    assert abs(found.curvature_max[middle]) < 0.005  # 1/mm
    assert found.shape_index[middle] == pytest.approx(-0.5, abs=0.1)


def dented(depth_mm: float):
    """A half ellipsoid with a round dent of 8 mm on its ridge, on two slices."""
    product = product_of(HALF_ELLIPSOID)
    xyz = product.profiles.xyz_mm.copy()
    slices = np.flatnonzero(np.isfinite(xyz[:, :, 2]).sum(axis=1) > 40)
    at = slices[len(slices) // 2 : len(slices) // 2 + 2]
    y = xyz[at, :, 1]
    xyz[at, :, 2] -= depth_mm * np.clip(1 - (y / 4.0) ** 2, 0, None) ** 2
    return replace(product, profiles=replace(product.profiles, xyz_mm=xyz))


def test_a_dent_is_found_with_its_depth_and_place() -> None:
    _, hollows = hollows_of(sections_of(dented(2.0), 0))
    assert len(hollows) == 1
    y = np.linspace(-15, 15, 3001)
    z = 12.0 * np.sqrt(1 - (y / 15.0) ** 2) - 2.0 * np.clip(1 - (y / 4.0) ** 2, 0, None) ** 2
    chord = max((z[n] + z[-1 - n]) / 2 for n in range(1500))  # by symmetry the hull over y = 0 is level
    assert hollows[0].depth_mm == pytest.approx(chord - z[1500], abs=0.1)  # mm
    assert hollows[0].stripes == 2
    assert abs(hollows[0].y_mm) < 1.0  # mm
    assert hollows_of(sections_of(dented(0.2), 0))[1] == ()


@pytest.mark.parametrize("signs", [(1, -1, 1), (-1, -1, 1), (-1, 1, 1)], ids=["mirrored", "turned", "both"])
def test_features_do_not_know_left_from_right(signs: tuple[int, int, int]) -> None:
    product = dented(2.0)
    other = replace(product, profiles=replace(product.profiles, xyz_mm=product.profiles.xyz_mm * signs))
    assert shape_features(other, 3.0) == pytest.approx(shape_features(product, 3.0), abs=1e-6, nan_ok=True)


def test_a_box_is_full_and_nothing_has_no_shape() -> None:
    features = shape_features(product_of(BOX), 0)
    assert features["fullness_median"] > 0.9
    assert features["hollow_depth_mm"] < 1e-6
    assert sections_of(product_of(BOX), 0).height_mm.shape[1] == SAMPLES
    assert shape_features(product_from(np.full((61, 240), np.nan)), 3.0) == {}


@pytest.mark.parametrize(("missing", "fewer"), [(0.5, 0), (0.8, 1)])
def test_two_slivers_at_the_foot_are_no_section(missing: float, fewer: int) -> None:
    """A hole is bridged up to two thirds of the width; what is left of more is no cross-section."""
    product = product_of(HALF_ELLIPSOID)
    sections = sections_of(product, 0)
    torn = int(sections.stripe[len(sections.stripe) // 2])
    profiles = product.profiles
    off_mm = np.abs(profiles.xyz_mm[torn, :, 1] - sections.middle_mm[len(sections.stripe) // 2, 1])
    whose = profiles.product.copy()
    whose[torn, off_mm < missing * sections.half_width_mm[len(sections.stripe) // 2]] = 0
    holed = replace(product, profiles=replace(profiles, product=whose))
    assert len(sections_of(holed, 0).stripe) == len(sections.stripe) - fewer
