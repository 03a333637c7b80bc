"""How sure the rim is: by the ends that say something, not by how many there are."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records.arrays import Floats
from roemetry_volume.rim import fitted_rim, rim_heights

DOME_MM, WALL_MM = np.linspace(0.0, 3.0, 30), np.linspace(5.0, 5.2, 30)
"""Distances inside the outline of an end that is seen to its rim, and of one that any rim would fit."""
OFF_MM = 6.0


def level(slices: int) -> Floats:
    """(end,) heights that differ from slice to slice, so that neighbours of a side err apart."""
    return np.repeat(10.0 + OFF_MM * (-1.0) ** np.arange(slices), 2)


def ends(good: int, poor: int) -> tuple[Floats, Floats, Floats]:
    """Give (end, point) heights and distances inside, and (end, 2) places, of so many slices each."""
    seen = level(good)[:, None] + np.sqrt(20.0 * DOME_MM)
    flat = 2.0 * level(poor)[:, None] + np.zeros(WALL_MM.size)  # any rim up to there: its mean is half of it
    inside = np.repeat([DOME_MM, WALL_MM], [2 * good, 2 * poor], axis=0)
    along = np.concatenate([np.linspace(-30.0, 30.0, count) for count in (good, poor)])
    place = np.column_stack([np.repeat(along, 2), np.tile([-10.0, 10.0], good + poor)])
    return np.vstack([seen, flat]), inside, place


def std_mm(good: int, poor: int) -> float:
    z_mm, inside_mm, place = ends(good, poor)
    count, points = z_mm.shape
    index = np.repeat(np.arange(count), points)
    first, size = points * np.arange(count), np.full(count, points)
    return fitted_rim(z_mm.ravel(), place, index, first, size, inside_mm.ravel())[2]


def test_ends_that_say_next_to_nothing_do_not_make_the_rim_surer() -> None:
    z_mm, inside_mm, _ = ends(6, 30)
    count, points = z_mm.shape
    first, size = points * np.arange(count), np.full(count, points)
    rim, spread, _ = rim_heights(inside_mm.ravel(), z_mm.ravel(), first, size, 0.1)
    assert rim == pytest.approx(np.concatenate([level(6), level(30)]), abs=0.5)
    assert spread[12:].min() > 5.0 * spread[:12].max(), "or they would say something"
    assert std_mm(12, 0) == pytest.approx(std_mm(6, 0) / np.sqrt(2.0), rel=0.1), "more of the good ones do"
    assert std_mm(6, 30) > 0.9 * std_mm(6, 0)
