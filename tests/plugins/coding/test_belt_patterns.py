"""Over dots and grids a camera that has moved is corrected, and its uncertainty is what it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from roemetry import Recipe
from roemetry.errors import StageError
from roemetry.records import Peaks
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner
from roemetry.testing.patterns import DotRig, moved_dots
from roemetry.testing.scenes import GridRig, moved_grid
from roemetry_coding.belt_dots import BeltDots
from roemetry_coding.belt_grid import BeltGrid

NOTHING = np.zeros((4, 4))
Seen = Callable[[np.ndarray, np.random.Generator], Peaks]


def dots_after(motion: np.ndarray, rng: np.random.Generator) -> Peaks:
    """Dots on a bare belt, each 0.1 px off, of a camera that has moved."""
    rig = DotRig()
    view = moved_dots(rig.dot_calibration(), Alignment(motion, NOTHING)).view
    assert view is not None
    places = view.project(rig.points_mm(rig.level()))
    return rig.dots(places + rng.normal(0.0, 0.1, places.shape), scatter_px=0.0)


def grid_after(motion: np.ndarray, rng: np.random.Generator) -> Peaks:
    """Both families on a bare belt, each peak 0.1 px off, of a camera that has moved."""
    rig = GridRig()
    moved, found = moved_grid(rig.grid_calibration(), Alignment(motion, NOTHING)), []
    for family, made in ((rig, moved), (rig.across, moved.across)):
        assert made is not None
        rest = made.rest_line_px(np.arange(family.rows, dtype=np.float64))
        found.append(family.peaks(rest + rng.normal(0.0, 0.1, rest.shape)).peaks)
    return replace(found[0], across=found[1])


CASES = [
    (BeltDots(), dots_after, DotRig().dot_calibration(), moved_dots),
    (BeltGrid(), grid_after, GridRig().grid_calibration(), moved_grid),
]


@pytest.mark.parametrize(("aligner", "seen", "calibration", "moved"), CASES, ids=["dots", "grid"])
def test_the_covariance_of_a_motion_is_what_it_scatters_by(
    aligner: Aligner[Any], seen: Seen, calibration: Calibration, moved: Any, rng: np.random.Generator
) -> None:
    true = np.array([0.9, 3e-3, -2e-3, 6e-4])
    off, stated = [], []
    for _ in range(40):
        found = aligner.align(seen(true, rng), calibration, moved)
        off.append(found.motion - true)
        stated.append(np.diag(found.covariance))
    ratio = np.sqrt(np.mean(stated, axis=0)) / np.std(off, axis=0)
    assert (ratio > 0.7).all(), ratio
    # white noise counts twice, as errors of columns and of lines; of the zoom it is not known what has moved
    assert (ratio[[0, 1, 3]] < 2.5).all(), ratio


def test_families_that_have_moved_differently_are_refused(rng: np.random.Generator) -> None:
    """Stripes grown by 2 %, and lines across at rest: no camera does that."""
    grown, at_rest = (grid_after(np.array([0.0, 0.0, zoom, 0.0]), rng) for zoom in (0.02, 0.0))
    with pytest.raises(StageError, match="two families of a grid's lines have moved differently"):
        BeltGrid().align(replace(grown, across=at_rest.across), GridRig().grid_calibration(), moved_grid)


def test_a_cross_hair_is_not_compared(rng: np.random.Generator) -> None:
    rig = GridRig(stripes=1, lines=1)
    for _ in range(20):
        peaks = rig.grid_peaks(rig.hill(0.0), scatter_px=0.1)
        found = BeltGrid().align(peaks, rig.grid_calibration(), moved_grid)
        assert not found.moved
        assert [reason.code for reason in found.reasons] == ["belt-not-seen"]


def test_errors_that_lines_and_columns_share_are_in_the_covariance(rng: np.random.Generator) -> None:
    """Each line and each column lies 0.1 px off as a whole, as calibrated rays do."""
    rig, off, stated = DotRig(), [], []
    for _ in range(60):
        places = rig.places_px(rig.level())
        places = places + rng.normal(0.0, 0.1, (rig.stripes, 1, 2)) + rng.normal(0.0, 0.1, (1, rig.lines, 2))
        found = BeltDots().align(rig.dots(places, scatter_px=0.02), rig.dot_calibration(), moved_dots)
        off.append(found.motion if found.moved else np.zeros(4))
        stated.append(np.diag(found.covariance))
    ratio = np.sqrt(np.mean(stated, axis=0))[[0, 3]] / np.sqrt(np.mean(np.square(off), axis=0))[[0, 3]]
    assert (ratio > 0.8).all(), ratio


@pytest.mark.parametrize(("aligner", "seen", "calibration", "moved"), CASES, ids=["dots", "grid"])
def test_a_pattern_shifted_by_a_whole_spacing_is_refused(
    aligner: Aligner[Any], seen: Seen, calibration: Calibration, moved: Any, rng: np.random.Generator
) -> None:
    """It lies on its neighbours' places, but for the outermost; what is beyond them is another's."""
    for far in ([7.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 7e-3]):
        with pytest.raises(StageError, match="camera, laser or belt have moved far|too far"):
            aligner.align(seen(np.array(far), rng), calibration, moved)


@pytest.mark.parametrize(("name", "aligner"), [("potato_dots", "belt-dots"), ("potato_grid", "belt-grid")])
def test_recipes_of_patterns_get_their_aligner(name: str, aligner: str) -> None:
    recipe = Recipe.load(f"recipes/{name}")
    assert recipe.stages["aligner"].registered.entry.name == aligner
