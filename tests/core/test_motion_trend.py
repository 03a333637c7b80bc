"""A rig that moves in the course of a run is told, from the image on with which it began."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.run.record import MotionTrend


def told(motion_px: np.ndarray) -> str:
    trend = MotionTrend()
    for number, motion in enumerate(motion_px):
        trend.add(f"image_{number:03d}", tuple(motion.tolist()))
        trend.add(f"image_{number:03d}", tuple(motion.tolist()))  # a second product's row
    return "" if trend.reason is None else trend.reason.text


def test_a_rig_that_stands_still_is_not_told(rng: np.random.Generator) -> None:
    assert all(told(rng.normal(0.3, 0.03, (400, 4))) == "" for _ in range(20))


@pytest.mark.parametrize(("part", "said"), [(0, "shifts along x"), (1, "turns"), (2, "grows"), (3, "tilts")])
def test_a_rig_that_creeps_is_told_from_its_beginning(part: int, said: str, rng: np.random.Generator) -> None:
    motion_px = rng.normal(0.0, 0.03, (120, 4))
    motion_px[60:, part] -= 0.01 * np.arange(60)
    text = told(motion_px)
    since = int(text.split("image_")[1][:3])
    assert said in text and " -0." in text
    assert 55 <= since <= 75


def test_few_images_say_nothing(rng: np.random.Generator) -> None:
    assert told(np.linspace(0.0, 3.0, 8)[:, None] * np.ones(4)) == ""
