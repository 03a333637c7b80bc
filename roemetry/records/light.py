"""A matrix of dots: where dots are seen in an image, and the rays of light that make them.

A ray is a line in the belt frame, X = x₀ + sₓ·Z and Y = y₀ + s_y·Z: light comes from above the belt. A dot in
the image and the sight ray through it have two numbers, the height on a known ray is one: the place along the
ray whose image lies nearest the dot, by the dot's covariance, is the point, and how far off it is remains as
a check (Hartley and Zisserman 2004, chapter 12, with one ray known).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from roemetry.records.arrays import Checker, Flags, Floats, Labels
from roemetry.records.display import Shown
from roemetry.records.view import View

ROUNDS = 3
"""Gauss–Newton steps along a ray: each divides the error by its image's bend, some hundred."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Dots(Shown):
    """What is known of peaks that are dots, beside their x; arrays in the shape of that x."""

    y_px: Floats
    """(…) position down the rows, px: within half a pixel of the peak's row; NaN where x is."""
    covariance_px2: Floats
    """(…, 2, 2) of x and y, px²; NaN where it is not modelled."""
    line: Labels
    """(…) which dot of its stripe it is, counted from 0 down the image; −1 where that is not known."""

    def __post_init__(self) -> None:
        check = Checker(self)
        shape = np.shape(self.y_px)
        check.array("y_px", np.float64, shape)
        check.array("covariance_px2", np.float64, (*shape, 2, 2))
        check.array("line", np.int16, shape)
        check.finish()


class Met(NamedTuple):
    """Where dots meet their rays."""

    z_mm: Floats
    """(n,) height; NaN where the ray is not seen."""
    px_per_mm: Floats
    """(n, 2) how the image moves with the height."""
    z_by_px: Floats
    """(n, 2) how the height moves with the dot's x and y."""
    z_std_mm: Floats
    """(n,) standard uncertainty of the height by the dot and by the ray's own error."""
    misfit: Floats
    """(n,) distance of the dot from the ray's image, standard deviations."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Rays(Shown):
    """The rays of a matrix of dots in the belt frame; stripes are its columns, left to right on the belt."""

    lines: Floats
    """(stripe, line, 4) x₀, y₀ (mm) and sₓ, s_y of X = x₀ + sₓ·Z, Y = y₀ + s_y·Z."""
    covariance: Floats
    """(stripe, line, 4, 4) of each ray's own error, which it shares with no other."""
    by_parameter: Floats
    """(stripe, line, 4, n) how rays follow the calibration's n parameters, which carry what they share: a
    ray is found through the camera, and errs with it."""
    parameters: Floats
    """(n,) the calibration's parameters, flattened, for which the lines are."""

    def __post_init__(self) -> None:
        check = Checker(self)
        shape = check.array("lines", np.float64, (None, None, 4)).shape
        count = check.array("parameters", np.float64, (None,)).size
        check.array("covariance", np.float64, (*shape, 4))
        check.array("by_parameter", np.float64, (*shape, count))
        check.finish()

    @property
    def stripe_count(self) -> int:
        """Number of columns of dots."""
        return int(self.lines.shape[0])

    @property
    def line_count(self) -> int:
        """Number of dots in a column."""
        return int(self.lines.shape[1])

    def moved(self, parameters: Mapping[str, Floats]) -> Floats:
        """Give (stripe, line, 4) the lines for other parameters of the calibration."""
        step = np.concatenate([np.ravel(one) for one in parameters.values()]) - self.parameters
        return self.lines if not step.any() else self.lines + self.by_parameter @ step

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as they stand in a file."""
        return {one: getattr(self, one).tolist() for one in _FIELDS}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Rays:
        """Read what `to_dict` wrote; KeyError, TypeError, ValueError or RecordError where it is damaged."""
        return cls(*(np.array(data[one], np.float64) for one in _FIELDS))


_FIELDS = ("lines", "covariance", "by_parameter", "parameters")


def at_height(lines: Floats, z_mm: Any) -> Floats:
    """Give (n, 3) the points of rays (n, 4) at heights (n,) or one height, belt frame, mm."""
    z = np.broadcast_to(np.asarray(z_mm, np.float64), lines.shape[:1])
    return np.column_stack([lines[:, :2] + lines[:, 2:] * z[:, None], z])


def meet(
    view: View, lines: Floats, xy_px: Floats, covariance_px2: Floats, ray_covariance: Floats | None = None
) -> Met:
    """Give where dots (n, 2) in the image meet rays (n, 4).

    Parameters
    ----------
    view
        The camera.
    lines, xy_px, covariance_px2
        (n, 4), (n, 2), (n, 2, 2): each dot with its ray. A covariance that is NaN counts as 1 px².
    ray_covariance
        (n, 4, 4) of the rays' own errors; None: they are exact.
    """
    unknown: Flags = np.asarray(~np.isfinite(covariance_px2).all(axis=(1, 2)))
    noise = np.where(unknown[:, None, None], np.eye(2), covariance_px2)
    noise_xx, noise_yy = noise[:, 0, 0], noise[:, 1, 1]
    noise_xy = 0.5 * (noise[:, 0, 1] + noise[:, 1, 0])
    x_px, y_px = xy_px.T
    z = _nearest(view, lines, xy_px)
    for _ in range(ROUNDS):
        at, by_place = view.project_slopes(at_height(lines, z))
        slope_x, slope_y = (by[0] * lines[:, 2] + by[1] * lines[:, 3] + by[2] for by in by_place)
        xx, xy, yy = noise_xx, noise_xy, noise_yy
        if ray_covariance is not None:
            own_xx, own_xy, own_yy = _seen(by_place[:, :2], z, ray_covariance)
            xx, xy, yy = xx + own_xx, xy + own_xy, yy + own_yy
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = xx * yy - xy * xy
            pull_x = (yy * slope_x - xy * slope_y) / determinant
            pull_y = (xx * slope_y - xy * slope_x) / determinant
            strength = pull_x * slope_x + pull_y * slope_y
            off_x, off_y = x_px - at[:, 0], y_px - at[:, 1]
            step = (pull_x * off_x + pull_y * off_y) / strength
            z = z + step
    off_x, off_y = off_x - slope_x * step, off_y - slope_y * step
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (yy * off_x**2 - 2.0 * xy * off_x * off_y + xx * off_y**2) / determinant
        misfit = np.sqrt(np.maximum(squared, 0.0))
        std = np.where(unknown, np.nan, 1.0 / np.sqrt(strength))
        by_px = np.column_stack([pull_x, pull_y]) / strength[:, None]
    return Met(z, np.column_stack([slope_x, slope_y]), by_px, std, misfit)


def _nearest(view: View, lines: Floats, xy_px: Floats) -> Floats:
    """Height on each ray that passes nearest to the dot's sight ray."""
    start, way = view.rays(xy_px)
    ray = np.column_stack([lines[:, 2:], np.ones(len(lines))])
    across = ray - (ray * way).sum(axis=1)[:, None] * way
    apart = start - np.column_stack([lines[:, :2], np.zeros(len(lines))])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((apart * across).sum(axis=1) / (across * ray).sum(axis=1))


def _seen(by_xy: Floats, z_mm: Floats, covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Give xx, xy and yy, (n,) each, of what the rays' own errors do to their dots in the image, px².

    `by_xy` (2, 2, n) says how the image moves with X and Y; X of a ray moves with x₀ and Z·sₓ, Y alike.
    """
    at_z = covariance[:, :2, :2] + z_mm[:, None, None] * (covariance[:, :2, 2:] + covariance[:, 2:, :2])
    at_z += (z_mm**2)[:, None, None] * covariance[:, 2:, 2:]
    along, across, both = at_z[:, 0, 0], at_z[:, 1, 1], 0.5 * (at_z[:, 0, 1] + at_z[:, 1, 0])
    (a, b), (c, d) = by_xy
    return (
        a * a * along + 2.0 * a * b * both + b * b * across,
        a * c * along + (a * d + b * c) * both + b * d * across,
        c * c * along + 2.0 * c * d * both + d * d * across,
    )
