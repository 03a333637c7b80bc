"""One stripe, and a solid that is carried through it: several images of it make a plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import shown
from roemetry_pinhole.from_solids import from_solids
from roemetry_pinhole.geometry import CAMERA
from roemetry_pinhole.solids import shape_of
from tests.plugins.pinhole.solids_seen import crossings, on_belt, seen_as, set_of
from tests.plugins.pinhole.test_ball_plate import boards_of, height_errors
from tests.plugins.pinhole.test_solids import RIGS, SIZE, solid, wide


@pytest.mark.parametrize(("name", "kind"), [("gentle", "block"), ("tilted", "staircase")])
def test_a_scan_through_one_stripe_gives_its_plane(name: str, kind: str, rng) -> None:
    """The belt is known from a board that lies on it; the solid in five places."""
    rig, width = replace(RIGS[name], stripes=1), wide(RIGS[name])
    exact, known = shown(rig, rng), solid(kind, wide(RIGS[name]))
    true = exact.geometry
    seen = [seen_as("belt", crossings(true, None, SIZE), SIZE, rng, 0.1)]
    for place in range(5):
        lying = on_belt(true, 0.1 * (place - 2) * width, 0.005 * place * width, 3.0)
        seen.append(seen_as(kind, crossings(lying, shape_of(known), SIZE), SIZE, rng, 0.1))
    observed = set_of(seen, 1, **{kind: known})
    found = from_solids(observed, boards_of(exact), np.zeros(CAMERA, bool), true.belt)
    off, std = height_errors(found.adjusted, true, np.array([0.0, 0.06, 0.12]) * width)
    assert np.abs(off).max() < 0.02, "mm"
    assert np.sqrt(np.mean((off / std) ** 2)) < 2.0, "the stated uncertainty holds"
