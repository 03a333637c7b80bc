"""A matrix of dots on a rig whose rays, places and heights are known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.records import BELT, NOTHING, Dots, Peaks, Rays, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.light import at_height
from roemetry.testing.scenes import SEED, LinearRig, moved_camera

_TURN = np.radians(14.0)  # keeps the ways of neighbouring dots apart


@dataclass(frozen=True, slots=True)
class DotRig(LinearRig):
    """The linear rig with a matrix of dots: `stripes` columns of `lines`, of light that comes from a point.

    Heights and places are (stripe, line, …); columns count from the left, dots in a column from the top.
    """

    stripes: int = 15
    lines: int = 11
    pitch_mm: float = 3.0
    """Distance of neighbouring dots on the belt."""
    projector_mm: tuple[float, float, float] = (200.0, 4.0, 400.0)

    def rays(self) -> Floats:
        """(stripe, line, 4) the rays, as `Rays` holds them."""
        across = (np.arange(self.stripes) - 0.5 * (self.stripes - 1)) * self.pitch_mm
        down = -(np.arange(self.lines) - 0.5 * (self.lines - 1)) * self.pitch_mm
        x, y = across[:, None], down[None, :]
        foot = np.stack(np.broadcast_arrays(x - np.tan(_TURN) * y, y + np.tan(_TURN) * x), axis=2)
        foot = foot - [8.0, 0.0]
        slope = (np.array(self.projector_mm[:2]) - foot) / self.projector_mm[2]
        return np.concatenate([foot, slope], axis=2)

    def level(self) -> Floats:
        """(stripe, line) heights of the bare belt: 0 mm."""
        return np.zeros((self.stripes, self.lines))

    def hill(self, height_mm: float = 10.0) -> Floats:
        """(stripe, line) heights, mm, of a dome over all but the outer dots."""
        across = np.sin(np.pi * np.arange(self.stripes) / (self.stripes - 1))
        down = np.sin(np.pi * np.arange(self.lines) / (self.lines - 1))
        return np.asarray(height_mm * across[:, None] * down[None, :])

    def points_mm(self, height_mm: Floats) -> Floats:
        """(stripe, line, 3) points at these heights; NaN heights give none."""
        return at_height(self.rays().reshape(-1, 4), height_mm.ravel()).reshape(*height_mm.shape, 3)

    def places_px(self, height_mm: Floats) -> Floats:
        """(stripe, line, 2) where dots at these heights are seen."""
        return self.view().project(self.points_mm(height_mm))

    def spots(self, places_px: Floats, amplitude: float | Floats = 160.0) -> Floats:
        """Give (row, column) grey levels of dots at places (…, 2); NaN draws nothing."""
        y, x = np.mgrid[: self.rows, : self.columns].astype(np.float64)
        light = np.full((self.rows, self.columns), self.background)
        flat = places_px.reshape(-1, 2)
        for place, height in zip(flat, np.broadcast_to(np.ravel(amplitude), len(flat)), strict=True):
            if np.isfinite(place).all():
                off = (x - place[0]) ** 2 + (y - place[1]) ** 2
                light += height * np.exp(-0.5 * off / self.sigma_px**2)
        return light

    def dots(self, places_px: Floats, scatter_px: float = 0.05) -> Peaks:
        """Give the peaks of a perfect extractor, with noise of std `scatter_px`; NaN gives none."""
        flat = places_px.reshape(-1, 2)
        flat = flat + np.random.default_rng(SEED).normal(0.0, scatter_px, flat.shape)
        limits = np.array([self.columns - 1.0, self.rows - 1.0])
        flat = flat[np.isfinite(flat).all(axis=1) & ((flat >= 0.0) & (flat <= limits)).all(axis=1)]
        row = np.rint(flat[:, 1]).astype(np.int64)
        order = np.lexsort((flat[:, 0], row))
        flat, row, many = flat[order], row[order], len(flat)
        covariance = np.tile(max(scatter_px, 0.01) ** 2 * np.eye(2), (many, 1, 1))
        return Peaks(
            image_size=(self.rows, self.columns),
            row=row,
            x_px=flat[:, 0],
            x_std_px=np.sqrt(covariance[:, 0, 0]),
            amplitude=np.full(many, 160.0),
            background=np.full(many, self.background),
            width_px=np.full(many, 2.355 * self.sigma_px),
            flags=np.zeros(many, np.uint8),
            dots=Dots(flat[:, 1], covariance, np.full(many, -1, np.int16)),
        )

    def dot_map(self, height_mm: Floats) -> StripeMap:
        """Give the true map of (stripe, line) heights, mm; NaN is not seen, 0 is belt, else product 1."""
        places = self.places_px(height_mm)
        stripe, line = np.nonzero(np.isfinite(height_mm))
        row = np.rint(places[stripe, line, 1]).astype(np.int64)
        shape = self.stripes, self.rows
        x, y = np.full(shape, np.nan), np.full(shape, np.nan)
        covariance, number = np.full((*shape, 2, 2), np.nan), np.full(shape, -1, np.int16)
        product = np.full(shape, NOTHING, np.int16)
        x[stripe, row], y[stripe, row] = places[stripe, line].T
        covariance[stripe, row], number[stripe, row] = 0.01 * np.eye(2), line
        product[stripe, row] = np.where(height_mm[stripe, line] > 0.0, 1, BELT)
        seen = np.isfinite(x)
        return StripeMap(
            x_px=x,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=product,
            seen=seen,
            margin=np.where(seen, 1.0, np.nan),
            ambiguous=np.zeros(shape, np.bool_),
            rest_px=self.rest_px(),
            peak_stripe=np.zeros(0, np.int16),
            dots=Dots(y, covariance, number),
        )

    def dot_calibration(self) -> Calibration:
        """Give the true calibration, whose rays have no error."""
        plain = LinearRig.calibration(self)
        parameters = np.concatenate([np.ravel(one) for one in plain.parameters.values()])
        return replace(plain, rays=exact_rays(self.rays(), parameters), height_range_mm=(0.0, 25.0))


def moved_dots(calibration: Calibration, alignment: Alignment) -> Calibration:
    """Give a dot rig's calibration after a small motion of its camera."""
    return moved_camera(calibration, alignment, _FOCAL_PX)


_FOCAL_PX = 1000.0  # what a tilt moves the image by, px a radian: the rig's own camera is far away


def exact_rays(lines: Floats, parameters: Floats) -> Rays:
    """Give rays without error that do not follow the parameters."""
    none = np.zeros((*lines.shape, 4))
    return Rays(lines, none, np.zeros((*lines.shape, parameters.size)), parameters)
