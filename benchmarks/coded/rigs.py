"""Rigs for coding: an easy one and a dense one, nominal or drawn, with their exact calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.volume_scenes import view_of
from roemetry.records.calibration import Calibration
from roemetry_simulate.optics import Camera, LaserFan, fan_through, looking_down

Floats = NDArray[np.float64]

TALLEST_MM = 20.0
"""Height of the tallest skeins: `displacement` counts the shift of a point at this height in spacings."""
_REACH_MM = 55.0


@dataclass(frozen=True, eq=False)
class CodingRig:
    """A camera and a fan of light planes, and what is needed to draw peaks."""

    name: str
    """Its kind: ``easy`` or ``dense``."""
    camera: Camera
    laser: LaserFan
    """camera, laser: the true ones."""
    noise_px: float
    """Standard deviation of a peak's centre where the stripe has its usual width, px."""
    height_range_mm: tuple[float, float]
    """Heights that the calibration says it is meant for, mm."""

    @property
    def rows(self) -> int:
        """Image rows."""
        return self.camera.height_px

    def line_px(self, height_mm: float) -> Floats:
        """(stripe, row) where the planes meet a level height in the image, px."""
        y_mm = np.linspace(-250.0, 250.0, 2001)
        x_mm = self.laser.x_mm(y_mm, np.full_like(y_mm, height_mm))
        rows = np.arange(self.rows, dtype=np.float64)
        lines = []
        for stripe in range(self.laser.count):
            points = np.column_stack([x_mm[:, stripe], y_mm, np.full_like(y_mm, height_mm)])
            image = self.camera.project(points)
            order = np.argsort(image[:, 1])
            lines.append(np.interp(rows, image[order, 1], image[order, 0]))
        return np.array(lines)

    def displacement_spacings(self, height_mm: float = TALLEST_MM) -> float:
        """Shift of a point at a height, over the mean spacing of the rest lines, in the middle row."""
        middle = self.rows // 2
        rest, lifted = self.line_px(0.0)[:, middle], self.line_px(height_mm)[:, middle]
        return float(np.abs(lifted - rest).mean() / np.diff(rest).mean())

    def calibration(self) -> Calibration:
        """Give the exact calibration, with what the paper's triangulation needs of it."""
        rest = self.line_px(0.0)
        from_middle = np.arange(self.rows) - 0.5 * (self.rows - 1)
        rest_px = np.polynomial.polynomial.polyfit(from_middle, rest.T, 3).T
        per_mm = (self.line_px(1.0) - self.line_px(-1.0))[:, self.rows // 2] / 2.0
        scale = float(self.camera.centre_mm[2] / self.camera.focal_length_px)
        return Calibration(
            method="block-linear",
            image_size=(self.camera.height_px, self.camera.width_px),
            turn_deg=0,
            rest_px=rest_px,
            displacement_px_per_mm=per_mm,
            height_range_mm=self.height_range_mm,
            parameters={"omega_mm_per_px": 1.0 / per_mm, "mm_per_px": np.array([scale])},
            covariance=np.zeros((per_mm.size + 1, per_mm.size + 1)),
            extractor={"use": "exact"},
            view=view_of(self),
        )


def easy_rig(seed: int | None = None, displacement: float = 1.3, *, planes: int = 11) -> CodingRig:
    """Give the easy rig: 640 × 480, 11 stripes, little perspective.

    Parameters
    ----------
    seed
        None gives the nominal rig; a number draws one: laser on either side, all poses and spacings a little
        different.
    displacement
        Shift of a point 20 mm high, in spacings: by the spacing of the stripes.
    planes
        Number of stripes.
    """
    rng = None if seed is None else np.random.default_rng([seed, 101])
    vary = _varied(rng)
    side = 1.0 if rng is None or rng.random() < 0.5 else -1.0
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0 * vary(1.0, 0.06),
        tilt_x_deg=vary(1.0, 2.0), tilt_y_deg=vary(-0.4, 2.0),
    )  # fmt: skip
    projector = (side * 160.0 * vary(1.0, 0.15), vary(-4.0, 12.0), 300.0 * vary(1.0, 0.08))
    rig = _rig("easy", camera, projector, 8.75, planes, vary, sigma_mm=0.31, noise_px=0.08)
    return _spaced(rig, displacement, vary)


def dense_rig(seed: int | None = None, displacement: float = 2.5, *, planes: int = 21) -> CodingRig:
    """Give the dense rig: 21 stripes, wide angle, camera and projector near, speckle.

    Parameters are as those of `easy_rig`.
    """
    rng = None if seed is None else np.random.default_rng([seed, 202])
    vary = _varied(rng)
    side = 1.0 if rng is None or rng.random() < 0.5 else -1.0
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=8.0, distance_mm=160.0 * vary(1.0, 0.06),
        tilt_x_deg=vary(2.0, 3.0), tilt_y_deg=vary(-1.0, 3.0),
    )  # fmt: skip
    projector = (side * 110.0 * vary(1.0, 0.15), vary(-5.0, 15.0), 190.0 * vary(1.0, 0.1))
    rig = _rig("dense", camera, projector, 5.0, planes, vary, sigma_mm=0.22, noise_px=0.25)
    return _spaced(rig, displacement, vary)


class _Vary:
    """Draws about a middle, or gives the middle."""

    def __init__(self, rng: np.random.Generator | None) -> None:
        self.rng = rng

    def __call__(self, middle: float, reach: float) -> float:
        return middle if self.rng is None else float(middle + reach * self.rng.uniform(-1.0, 1.0))


def _varied(rng: np.random.Generator | None) -> _Vary:
    return _Vary(rng)


def _rig(
    name: str, camera: Camera, projector: tuple[float, float, float], spacing_mm: float, planes: int,
    vary: _Vary, *, sigma_mm: float, noise_px: float,
) -> CodingRig:  # fmt: skip
    power = np.array([vary(1.0, 0.1) for _ in range(planes)])
    laser = _fan(projector, spacing_mm, planes, vary(0.6, 2.0), vary(0.3, 1.0), sigma_mm, power)
    return CodingRig(name, camera, laser, noise_px, (-1.0, 26.0))


def _fan(
    projector: tuple[float, float, float], spacing_mm: float, planes: int, yaw_deg: float, pitch_deg: float,
    sigma_mm: float, power: Floats,
) -> LaserFan:  # fmt: skip
    feet = spacing_mm * (np.arange(planes) - 0.5 * (planes - 1))
    # lifted points go away from the projector: the fan's middle leaves room for that
    feet -= 3.0 * np.sign(projector[0])
    return fan_through(
        projector, feet, yaw_deg=yaw_deg, pitch_deg=pitch_deg, sigma_mm=sigma_mm, peak_grey=370.0 * power
    )


def _spaced(rig: CodingRig, displacement: float, vary: _Vary) -> CodingRig:
    """Space the planes so that the wanted displacement comes out, each spacing a little different."""
    laser, planes = rig.laser, rig.laser.count
    feet = laser.x_mm(0.0, 0.0)
    spacing = float(np.diff(feet).mean()) * rig.displacement_spacings() / displacement
    steps = np.array([spacing * vary(1.0, 0.02) for _ in range(planes - 1)])
    placed = np.concatenate([[0.0], np.cumsum(steps)])
    placed += feet.mean() - placed.mean()
    axis = laser.line_axis
    yaw = float(np.rad2deg(np.arctan2(-axis[0], axis[1])))
    pitch = float(np.rad2deg(np.arcsin(axis[2])))
    fan = fan_through(
        laser.projector_mm, placed, yaw_deg=yaw, pitch_deg=pitch, sigma_mm=laser.sigma_mm,
        peak_grey=laser.peak_grey,
    )  # fmt: skip
    return replace(rig, laser=fan)
