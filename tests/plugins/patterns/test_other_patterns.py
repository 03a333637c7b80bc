"""Images that are not of the pattern that was calibrated, and spoiled ones: refused, each with its reason."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from roemetry import Recipe
from roemetry.errors import StageError
from roemetry.records import Frame, Sensor, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.testing.patterns import DotRig
from roemetry_coding.grid import GridPlanes
from roemetry_patterns.dot_centres import DotCentres
from roemetry_patterns.dot_surface import DotSurface
from roemetry_patterns.epipolar_dots import EpipolarDots
from roemetry_peaks.grid_lines import GridLines

Pixels = NDArray[np.uint8]
_DARK = 2


@pytest.fixture(scope="module")
def grid() -> Pixels:
    """A potato under the grid."""
    return _read(Path("recipes/potato_grid/images/potato_02.png"))


@pytest.fixture(scope="module")
def dots() -> Pixels:
    """A potato under the dots."""
    return _read(min(Path("recipes/potato_dots/images").glob("*.png")))


def _read(path: Path) -> Pixels:
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return np.asarray(pixels, np.uint8)


def _on_its_side(pixels: Pixels) -> Pixels:
    """Rows and columns exchanged, with dark where the image is wider than high."""
    side = 0.5 * (pixels.shape[1] - pixels.shape[0])
    swapped = pixels.T[int(side) : int(side) + pixels.shape[0]]
    padded = np.pad(swapped, [(0, 0), (int(side), int(side))], constant_values=_DARK)
    return np.asarray(padded, np.uint8)


_calibration = lru_cache(Calibration.load)
"""Files of rays are large: each is read once."""


def _as_grid(pixels: Pixels) -> StripeMap:
    frame = Frame(np.ascontiguousarray(pixels), sensor=Sensor(0.0255, 0.2))
    return GridPlanes().code(GridLines().extract(frame), _calibration("recipes/potato_grid/calibration.yaml"))


def _as_dots(pixels: Pixels) -> StripeMap:
    frame = Frame(np.ascontiguousarray(pixels), sensor=Sensor(0.0255, 0.2))
    return EpipolarDots().code(
        DotCentres().extract(frame), _calibration("recipes/potato_dots/calibration.yaml")
    )


def test_what_is_not_the_pattern_that_was_calibrated_is_refused(grid: Pixels, dots: Pixels) -> None:
    # what is left where the image is as bright as its rows' neighbours: the lines that cross rows
    upright = cv2.erode(grid, np.ones((9, 1), np.uint8))
    for coded, pixels, says in (
        (_as_grid, _on_its_side(grid), "no stripe lies where the 15 rest lines are"),
        (_as_grid, dots, "no stripe lies where the 15 rest lines are"),
        (_as_grid, upright, "lines across"),
        (_as_grid, np.clip(4.0 * grid, 0, 255).astype(np.uint8), "of the peaks are saturated"),
        (_as_dots, _on_its_side(dots), "lie where a ray"),
        (_as_dots, grid, "another pattern"),
    ):
        with pytest.raises(StageError, match=says):
            coded(pixels)


def test_two_dots_that_have_merged_are_not_used_and_spoil_no_other(dots: Pixels) -> None:
    alone = _as_dots(dots)
    label, centre = cv2.connectedComponentsWithStats((dots > 20).astype(np.uint8))[1::2]
    near = (label == 150).astype(np.uint8)
    spot = np.where(cv2.dilate(near, np.ones((7, 7))) > 0, dots, 0)
    found = _as_dots(np.maximum(dots, np.roll(spot, 5, axis=1)))
    x, y = centre[150]
    assert alone.dots is not None and found.dots is not None
    beside = (np.abs(alone.x_px - x) < 12.0) & (np.abs(alone.dots.y_px - y) < 12.0)
    assert beside.sum() == 1
    assert not found.seen[beside].any()
    assert (found.dots.line == alone.dots.line)[~beside].all()


def test_a_dot_that_an_edge_has_cut_is_labelled_and_says_how_unsure_it_is() -> None:
    rig = DotRig()
    places = rig.places_px(rig.hill())
    places[7, 5, 1] += 0.6  # across its ray's curve by twelve times the other dots' uncertainty
    found = EpipolarDots().code(rig.dots(places), rig.dot_calibration())
    assert found.dots is not None
    row = round(float(places[7, 5, 1]))
    assert found.dots.line[7, row] == 5
    assert found.dots.covariance_px2[7, row, 1, 1] > 0.15
    others = found.dots.covariance_px2[np.isfinite(found.x_px)][:, 1, 1]
    assert (others > 0.1).sum() == 1


def test_an_outline_that_the_dots_contradict_is_refused() -> None:
    recipe = Path("recipes/potato_dots")
    laser, plain = (_read(recipe / folder / "potato_02.png") for folder in ("images", "images_plain"))
    # the whole potato, and what is left of its outline where another lies: half of it
    (whole,) = Recipe.load(recipe, sets=["uncertainty=none"]).trace(laser, plain=plain).products
    assert whole.volume is not None and whole.product.outline is not None
    outline = whole.product.outline
    middle = np.median(outline.xy_px[:, 0])
    half = np.minimum(outline.xy_px, [middle, np.inf])
    with pytest.raises(StageError, match="lie outside its outline"):
        DotSurface().estimate(replace(whole.product, outline=replace(outline, xy_px=half)))
