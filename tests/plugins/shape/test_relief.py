"""Humps of known height, what is shown of a surface, and grades that do not depend on the rig's place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from roemetry.records import Outline, Product
from roemetry.records.view import View
from roemetry.testing.solids import BOX, DENSE, DENTED, HALF_ELLIPSOID, Solid, product_from, product_of
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_report.relief import relief_panels
from roemetry_shape.features import shape_features, shape_of
from roemetry_shape.fuzzy_rules import FuzzyRules, FuzzyRulesOptions
from roemetry_shape.learned import Learned, learned_options
from roemetry_shape.product_frame import sections_of
from roemetry_shape.regions import humps_of
from roemetry_shape.shape_limits import ShapeLimits, ShapeLimitsOptions


def bumped(height_mm: float, x_mm: float = 6.0, y_mm: float = 3.0) -> Product:
    """A half-ellipsoid with a round bump (standard deviation 2.5 mm)."""
    product = product_of(HALF_ELLIPSOID)
    xyz = product.profiles.xyz_mm.copy()
    away = np.hypot(xyz[..., 0] - x_mm, xyz[..., 1] - y_mm)
    xyz[..., 2] += height_mm * np.exp(-0.5 * (away / 2.5) ** 2)
    return replace(product, profiles=replace(product.profiles, xyz_mm=xyz))


def test_a_hump_is_found_with_its_height_and_place() -> None:
    _, humps = humps_of(sections_of(bumped(3.0), 0))
    assert len(humps) == 1
    assert humps[0].depth_mm == pytest.approx(3.0, abs=0.5)  # mm: what the fit of the body takes of it
    assert (humps[0].x_mm, humps[0].y_mm) == pytest.approx((6.0, 3.0), abs=1.6)  # mm: a stripe's spacing
    above = 2.0 * np.pi * 2.5**2 * np.log(3.0 / 0.8)
    assert humps[0].area_mm2 == pytest.approx(above, rel=0.3)
    features = shape_features(bumped(3.0), 0)
    assert features["hump_height_mm"] == humps[0].depth_mm
    assert features["humps"] == 1.0


def test_a_smooth_body_has_no_humps() -> None:
    mirrored = product_of(HALF_ELLIPSOID.mirrored(), DENSE.mirrored())
    for product in (product_of(HALF_ELLIPSOID), product_of(HALF_ELLIPSOID.scaled(1.5)), mirrored):
        assert shape_features(product, 0)["humps"] == 0.0


def test_what_is_shown_is_what_was_found() -> None:
    features, relief = shape_of(bumped(3.0), 0)
    (hump,) = [region for region in relief.regions if region.kind == "hump"]
    at = relief.xy_mm[tuple(hump.cells.T)]
    assert np.hypot(*(at - hump.xy_mm).T).max() < 7.0  # mm
    shown = {one.title: one for one in relief.maps}
    assert len(shown) == 5
    assert np.nanmax(shown["Dents (−) and humps (+)"].values) == pytest.approx(hump.depth_mm, abs=0.05)
    index = shown["Shape index: −1 cap, 0 saddle, 1 cup"].values
    assert np.nanmin(index) >= -1.0
    assert np.nanmax(index) <= 1.0
    assert relief.figures["length_seen_mm"] == features["length_seen_mm"]


def test_the_drawing_names_what_stands_out() -> None:
    _, relief = shape_of(bumped(3.0), 0)
    assert relief is not None
    plan, *maps = relief_panels(relief)
    assert len(maps) == 5
    assert "1 hump" in plan.notes
    assert any(": hump of " in note for note in plan.notes)
    assert "plan-hump" in plan.drawing
    assert all(panel.drawing.startswith("<svg") for panel in maps)
    assert ["map-arrows" in panel.drawing for panel in maps] == [False, True, False, False, False]
    assert shape_of(product_from(np.full((61, 240), np.nan)), 3.0).relief is None


LIMITS = [
    {"feature": "dent_depth_mm", "at_most": 1.0, "label": "dent"},
    {"feature": "hump_height_mm", "at_most": 1.5, "label": "hump"},
    {"feature": "fullness_median", "at_most": 0.9, "label": "box"},
]
RULES = {
    "terms": {
        "hollow": {"feature": "hollow_depth_mm", "points": [[0.5, 0.0], [2.0, 1.0]]},
        "full": {"feature": "fullness_median", "points": [[0.8, 0.0], [0.9, 1.0]]},
    },
    "rules": [
        {"when": ["hollow"], "label": "dent"},
        {"when": ["full", "not hollow"], "label": "box"},
        {"when": ["not full", "not hollow"], "label": "good"},
    ],
}
IN_MM = {"space": "mm", "smoothing_rows": 15, "radius_min_mm": 0.0, "radius_max_mm": 8.0}
CLASSIFIERS: dict[str, Any] = {
    "limits": ShapeLimits(ShapeLimitsOptions.model_validate({"limits": LIMITS})),
    "rules": FuzzyRules(FuzzyRulesOptions.model_validate(RULES)),
    "learned": Learned(learned_options()),
    "arcs in mm": ArcCurvature(ArcCurvatureOptions.model_validate(IN_MM)),
}


def turned(product: Product) -> Product:
    """The product as a rig sees it that is turned by 180° about the vertical."""
    profiles = product.profiles
    rows, columns = product.calibration.image_size
    calibration = replace(
        product.calibration, displacement_px_per_mm=-product.calibration.displacement_px_per_mm
    )
    moved = replace(
        profiles,
        xyz_mm=profiles.xyz_mm * np.array([-1.0, -1.0, 1.0]),
        x_px=columns - 1 - profiles.x_px,
        row_px=rows - 1 - profiles.row_px,
        plane=profiles.plane * np.array([-1.0, -1.0, 1.0, 1.0]),
    )
    return replace(product, profiles=moved, calibration=calibration)


@pytest.mark.parametrize("name", CLASSIFIERS)
@pytest.mark.parametrize("solid", [HALF_ELLIPSOID, DENTED, BOX], ids=["smooth", "dented", "box"])
def test_mirrored_turned_and_rescaled_rigs_give_the_same_grade(name: str, solid: Solid) -> None:
    classifier = CLASSIFIERS[name]
    label = classifier.classify(product_of(solid)).label
    assert classifier.classify(product_of(solid.mirrored(), DENSE.mirrored())).label == label
    assert classifier.classify(turned(product_of(solid))).label == label
    for factor in (0.8, 1.4):
        assert classifier.classify(product_of(solid, DENSE.scaled(factor))).label == label


def test_the_outline_gives_the_size_whichever_way_the_product_lies() -> None:
    """A rectangle of 60 by 30 mm seen from 500 mm above, at the height of the box's ends."""
    view = View(
        image_size=(400, 400),
        camera_matrix=np.array([[1000.0, 0, 199.5], [0, 1000.0, 199.5], [0, 0, 1]]),
        T_belt_camera=np.array([[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, 500.0], [0, 0, 0, 1]]),
        planes=np.array([[1.0, 0.0, 0.0, 0.0]]),
    )
    top_mm = float(np.median(sections_of(product_of(BOX), 0).height_mm[:, [0, -1]]))
    for turn in (0.0, 0.4, 1.2):
        c, s = np.cos(turn), np.sin(turn)
        corners = np.array([[30.0, 15], [30, -15], [-30, -15], [-30, 15]]) @ np.array([[c, s], [-s, c]])
        sides = zip(corners, np.roll(corners, -1, 0), strict=True)
        ring = np.concatenate([np.linspace(a, b, 20, False) for a, b in sides])
        xy = view.project(np.column_stack([ring, np.full(len(ring), top_mm)]))
        product = replace(product_of(BOX), outline=Outline(1, xy), view=view)
        features = shape_features(product, 0)
        assert features["length_mm"] == pytest.approx(60.0, abs=0.01)  # mm
        assert features["across_mm"] == pytest.approx(30.0, abs=0.01)  # mm
        assert features["footprint_mm2"] == pytest.approx(1800.0, abs=1.0)  # mm²
    assert "length_mm" not in shape_features(product_of(BOX), 0)
