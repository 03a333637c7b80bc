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

_STEP_MM = 0.05
"""Of differences along a ray: its image bends by less than 1e-5 px on it."""
_ROUNDS = 3
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
    z = _nearest(view, lines, xy_px)
    for _ in range(_ROUNDS):
        at, slope = _image(view, lines, z)
        weight = _inverse(noise if ray_covariance is None else noise + _seen(view, lines, z, ray_covariance))
        pull = np.einsum("nij,nj->ni", weight, slope)
        strength = (pull * slope).sum(axis=1)
        off = xy_px - at
        with np.errstate(divide="ignore", invalid="ignore"):
            by_px = pull / strength[:, None]
        step = (by_px * off).sum(axis=1)
        z = z + step
    off = off - slope * step[:, None]
    misfit = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", off, weight, off), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.where(unknown, np.nan, 1.0 / np.sqrt(strength))
    return Met(z, slope, by_px, std, misfit)


def _nearest(view: View, lines: Floats, xy_px: Floats) -> Floats:
    """Height on each ray that passes nearest to the dot's sight ray."""
    start, way = view.rays(xy_px)
    ray = np.column_stack([lines[:, 2:], np.ones(len(lines))])
    across = ray - (ray * way).sum(axis=1)[:, None] * way
    apart = start - np.column_stack([lines[:, :2], np.zeros(len(lines))])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((apart * across).sum(axis=1) / (across * ray).sum(axis=1))


def _image(view: View, lines: Floats, z_mm: Floats) -> tuple[Floats, Floats]:
    """Give (n, 2) where rays are seen at heights, and how that moves with the height."""
    at = view.project(at_height(lines, z_mm))
    return at, (view.project(at_height(lines, z_mm + _STEP_MM)) - at) / _STEP_MM


def _seen(view: View, lines: Floats, z_mm: Floats, covariance: Floats) -> Floats:
    """Give (n, 2, 2) what the rays' own errors do to their dots in the image, px²."""
    at = at_height(lines, z_mm)
    here = view.project(at)
    moved = [(view.project(at + step) - here) / _STEP_MM for step in _STEP_MM * np.eye(3)[:2]]
    by_place = np.stack(moved, axis=2)
    by_line = np.concatenate([by_place, by_place * z_mm[:, None, None]], axis=2)
    return np.asarray(np.einsum("nij,njk,nlk->nil", by_line, covariance, by_line))


def _inverse(matrix: Floats) -> Floats:
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    turned = np.stack([d, -b, -c, a], axis=1) / (a * d - b * c)[:, None]
    return np.asarray(turned.reshape(-1, 2, 2))
