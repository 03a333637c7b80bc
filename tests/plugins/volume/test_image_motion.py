"""The belt's texture lays the plain image over the laser image, and tells images of two scenes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from roemetry_volume.image_motion import image_motion

ROWS, COLUMNS = 480, 640


def images(rng: np.random.Generator, ambient_grey: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """A belt of 4 % texture with stripes in dim light, and in plain light."""
    belt = 1.0 + 0.04 * cv2.GaussianBlur(rng.normal(0.0, 1.0, (ROWS, COLUMNS)), (0, 0), 2.0) * 7.0
    stripes = 150.0 * np.exp(-0.5 * (((np.arange(COLUMNS) + 20) % 40 - 20) / 2.0) ** 2)
    noise = rng.normal(0.0, 1.0, (2, ROWS, COLUMNS))
    return tuple(
        np.clip(np.rint(one), 0, 255).astype(np.uint8)
        for one in (ambient_grey * belt + stripes + noise[0], 90.0 * belt + noise[1])
    )  # type: ignore[return-value]


def moved(image: np.ndarray, motion: tuple[float, float, float, float]) -> np.ndarray:
    right, down, turn, growth = motion
    matrix = cv2.getRotationMatrix2D(((COLUMNS - 1) / 2, (ROWS - 1) / 2), -np.degrees(turn), 1.0 + growth)
    matrix[:, 2] += right, down
    return cv2.warpAffine(
        image, matrix, (COLUMNS, ROWS), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


NOWHERE = np.zeros((ROWS, COLUMNS), np.bool_)


@pytest.mark.parametrize(
    "motion",
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.4, -0.3, 0.0, -0.005),
        (5.0, 4.0, 0.01, 0.01),
        (0.0, 0.0, 0.0, 0.002),
        (-35.0, 18.0, 0.003, 0.0),
    ],
)
def test_motion_is_found_as_surely_as_is_said(
    motion: tuple[float, float, float, float], rng: np.random.Generator
) -> None:
    laser, plain = images(rng)
    found = image_motion(laser, moved(plain, motion), NOWHERE)
    assert found is not None and found.missed is None
    off = found.motion - motion
    assert off @ np.linalg.solve(found.covariance, off) < 25.0
    std = np.sqrt(np.diag(found.covariance))
    assert (std < [0.15, 0.15, 1e-3, 1e-3]).all()
    assert found.significant(5.0) == any(motion)


@pytest.mark.parametrize(("axis", "lost"), [(0, 12), (1, 12), (0, 200)], ids=["rows", "columns", "half"])
def test_a_laser_image_that_lost_lines_is_seen(axis: int, lost: int, rng: np.random.Generator) -> None:
    laser, plain = images(rng)
    middle = laser.shape[axis] // 2
    kept = np.delete(laser, np.s_[middle : middle + lost], axis)
    torn = np.concatenate([kept, np.take(images(rng)[0], range(lost), axis)], axis)
    found = image_motion(torn, plain, NOWHERE)
    assert found is not None and found.missed is not None
    assert found.missed[2 * axis + 1] == laser.shape[axis] - 1
    assert abs(found.missed[2 * axis] - middle) <= laser.shape[axis] // 4


def test_the_rim_of_a_shadow_in_plain_light_is_no_texture_of_the_belt(rng: np.random.Generator) -> None:
    """Rings around a product that are up to 10 % darker or brighter, in plain light alone."""
    laser, plain = images(rng, ambient_grey=7.0)
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    away_px = np.hypot(row - 200.0, column - 320.0)
    rings = 1.0 - 0.1 * np.cos(0.28 * away_px) * (away_px < 130.0)
    shadowed = np.clip(np.rint(plain * rings), 0, 255).astype(np.uint8)
    found = image_motion(laser, shadowed, NOWHERE)
    assert found is not None and found.missed is None


def test_without_ambient_light_nothing_is_said(rng: np.random.Generator) -> None:
    laser, plain = images(rng, ambient_grey=0.0)
    assert image_motion(laser, plain, NOWHERE) is None


@pytest.mark.parametrize("period_px", [9, 12, 16, 24])
def test_a_weave_that_fits_by_any_period_says_nothing(period_px: int, rng: np.random.Generator) -> None:
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    threads = np.sin(2.0 * np.pi * column / period_px) * np.sin(2.0 * np.pi * row / period_px)
    belt = 1.0 + 0.04 * threads
    stripes = 150.0 * np.exp(-0.5 * (((np.arange(COLUMNS) + 20) % 40 - 20) / 2.0) ** 2)
    noise = rng.normal(0.0, 1.0, (2, ROWS, COLUMNS))
    laser, plain = (
        np.clip(np.rint(one), 0, 255).astype(np.uint8)
        for one in (12.0 * belt + stripes + noise[0], 90.0 * belt + noise[1])
    )
    assert image_motion(laser, moved(plain, (8.0, 3.0, 0.0, 0.0)), NOWHERE) is None
