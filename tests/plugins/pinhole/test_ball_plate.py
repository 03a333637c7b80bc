"""A sphere plate among stripes: found where it lies, with the size it has."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import SpherePlate
from roemetry_pinhole.ball_plate import find_plate
from roemetry_pinhole.frames import parameters_of, view_of
from roemetry_pinhole.simulated import shown
from tests.plugins.pinhole.solids_seen import crossings, over_balls, seen_as
from tests.plugins.pinhole.test_solids import RIGS, SIZE, wide


def plate_of(width: float) -> SpherePlate:
    return SpherePlate("p", 3, 2, 0.26 * width, 0.18 * width, 0.13 * width, 0.01)


@pytest.mark.parametrize("name", list(RIGS))
def test_place_and_size_are_found_within_what_is_stated(name: str, rng) -> None:
    """Twelve plates, anywhere and turned by up to 12°, up to 3 % larger or smaller than described."""
    geometry, width = shown(RIGS[name], rng).geometry, wide(RIGS[name])
    plate = plate_of(width)
    parameters = parameters_of(geometry, travel=False)
    belt, view = crossings(geometry, None, SIZE), view_of(parameters, SIZE)
    over = []
    for _ in range(12):
        x, y = rng.uniform(-0.06, 0.06, 2) * width
        true = np.array([x, y, np.radians(rng.uniform(-12.0, 12.0)), rng.uniform(0.97, 1.03)])
        seen = seen_as("sphere_plate", over_balls(view, plate, true, belt), SIZE, rng, 0.1)
        found = find_plate(parameters, seen.peaks, plate)
        assert found is not None
        assert found.balls >= 4, "two may lie beside the stripes"
        assert np.abs(found.pose[:2] - true[:2]).max() < 0.02, "mm"
        assert found.pose[2] == pytest.approx(true[2], abs=5e-4), "rad"
        assert found.random_std() < 2e-4
        over.append((np.log(found.pose[3]) - np.log(true[3])) / found.random_std())
    assert np.sqrt(np.mean(np.square(over))) < 1.8


def test_an_empty_belt_and_a_block_are_no_sphere_plate(rng) -> None:
    geometry, width = shown(RIGS["gentle"], rng).geometry, wide(RIGS["gentle"])
    parameters = parameters_of(geometry, travel=False)
    belt = crossings(geometry, None, SIZE)
    for x_px in (belt, np.full_like(belt, np.nan)):
        seen = seen_as("sphere_plate", x_px, SIZE, rng, 0.1)
        assert find_plate(parameters, seen.peaks, plate_of(width)) is None
