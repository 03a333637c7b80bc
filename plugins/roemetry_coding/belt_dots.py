"""Alignment by the belt's dots: how far the camera has moved since the calibration, from one frame.

Model. The calibration says where each ray's dot lies on the bare belt. A camera that has been moved a little
shows it at u + Σ_k θ_k b_k, where θ are shift, roll, zoom and tilt (`roemetry.records.calibration`) and b_k
is how its place (x, y) answers to θ_k: the difference of the places of two calibrations that the triangulator
has moved by ± a step. Each place is compared with the dot nearest to it. θ is the robust least-squares fit
(Tukey's biweight of the distance, its width narrowed in steps to four standard deviations: Huber & Ronchetti,
Robust Statistics, 2nd ed., chapter 7). Its covariance is White's sandwich, clustered by the pattern's columns
and by its lines, the two added: calibrated rays err with their neighbours.

Assumes that belt is seen at the ends of the image, and that nothing has moved by more than a few pixels. It
fails, and says so, where the belt is hidden or where dots that fit no small motion are seen.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.light import at_height
from roemetry.stages import Aligner, Capabilities
from roemetry_coding.alignment import (
    LAST_ROUNDS,
    OUTER_SHARE,
    SEARCH_PX,
    SEARCH_SPACING,
    SETTLED_PX,
    SIGMA_MIN_PX,
    SIGMAS,
    STEPS,
    WIDTHS,
    AlignerOptions,
    FittedMotion,
    Light,
    alignment_of,
    focal_px_of,
    not_compared,
    refuse_far,
)

_DOTS_MIN = 20
"""Belt dots that must fit: five for each number that is found."""
_ON_PLACE_PX = 1.0
"""What lies nearer to its moved place is the belt's: of dots that lie anywhere one in a hundred does."""
_LIGHT = Light("dots", "their calibrated places", "pattern's sides")


class BeltDots(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to the dots on the belt."""

    capabilities = Capabilities(pattern="dots")

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration.

        Raises
        ------
        StageError
            Peaks or calibration are not of dots; dots have moved by more than `refuse_from_px`, or too few
            fit any small motion.
        """
        if peaks.dots is None or calibration.rays is None:
            what = "peaks are of lines" if peaks.dots is None else "calibration has no rays"
            raise StageError(
                f"the {what}, not of dots", hint="set `extractor: dots` and calibrate with pinhole-dots"
            )
        if calibration.view is None:
            raise StageError("the calibration has no camera", hint="calibrate with pinhole-dots")
        model = _model_of(calibration, moved)
        xy_px = np.column_stack([peaks.x_px, peaks.dots.y_px])
        search_px = min(SEARCH_PX, SEARCH_SPACING * model.spacing_px)
        # places farther off than the search are no belt
        near, which = model.nearest.query(xy_px, distance_upper_bound=search_px)
        seen = np.flatnonzero(np.isfinite(near))
        first, last = model.place_px.min(axis=0), model.place_px.max(axis=0)
        end_px = OUTER_SHARE * (last - first)
        # the outer tenth on all four sides of the pattern
        outer = ((xy_px < first + end_px) | (xy_px >= last - end_px)).any(axis=1)
        which = which[seen]
        off_px, answer = xy_px[seen] - model.place_px[which], model.answer[which]
        motion, weight, width_px = _fitted(off_px, answer, search_px)
        # what is left after the motion: belt lies on its place
        left_px = off_px - answer @ motion
        fit = np.hypot(*left_px.T) < _ON_PLACE_PX
        if outer.sum() >= _DOTS_MIN:
            refuse_far(int(outer.sum()), int((fit & outer[seen]).sum()), _LIGHT)
        if fit.sum() < _DOTS_MIN:
            return not_compared()
        covariance = _sandwich(left_px, answer, weight, width_px, model.column[which], model.line[which])
        found = FittedMotion(motion, covariance, model.answer.reshape(-1, 4), model.scale)
        return alignment_of(found, self.options, focal_px_of(calibration), _LIGHT, 2)


class _Model(NamedTuple):
    """What a calibration says of the dots on the belt; `answer` and `scale` are those of `belt-lines`."""

    place_px: Floats
    """(dot, 2)"""
    answer: Floats
    """(dot, 2, 4)"""
    scale: Floats
    column: Integers
    line: Integers
    spacing_px: float
    nearest: Any
    """scipy's tree of the places."""


@lru_cache(maxsize=8)
def _model_of(calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]) -> _Model:
    """Move the calibration to and fro by each parameter; done once for all frames of a calibration."""
    from scipy.spatial import cKDTree

    place_px = _places_px(calibration)
    none = np.zeros((4, 4))
    answer = np.empty((*place_px.shape, 4))
    for k, step in enumerate(STEPS):
        there, back = (
            _places_px(moved(calibration, Alignment(np.eye(4)[k] * sign * step, none)))
            for sign in (1.0, -1.0)
        )
        answer[..., k] = (there - back) / (2.0 * step)
    rows, columns = calibration.image_size
    with np.errstate(invalid="ignore"):
        # seen at all, and with a derivative at both steps
        inside = ((place_px >= 0.0) & (place_px < np.array([columns, rows]))).all(axis=2)
    inside &= np.isfinite(answer).all(axis=(2, 3))
    if inside.sum() < _DOTS_MIN:
        raise StageError("the calibration's rays meet the belt outside the image", hint="calibrate again")
    # each parameter in the unit in which it moves some place by 1 px
    largest = np.abs(answer[inside]).max(axis=(0, 1))
    scale = np.where(largest > 0.0, 1.0 / np.maximum(largest, 1e-12), 0.0)
    column, line = np.nonzero(inside)
    places = cKDTree(place_px[inside])
    spacing = float(places.query(place_px[inside], 2)[0][:, 1].min())
    return _Model(place_px[inside], answer[inside] * scale, scale, column, line, spacing, places)


def _places_px(calibration: Calibration) -> Floats:
    """Give (column, line, 2) where the calibration has each ray's dot on the bare belt."""
    assert calibration.rays is not None and calibration.view is not None
    lines = calibration.rays.moved(calibration.parameters)
    return calibration.view.project(at_height(lines.reshape(-1, 4), 0.0)).reshape(*lines.shape[:2], 2)


def _fitted(off_px: Floats, answer: Floats, search_px: float) -> tuple[Floats, Floats, float]:
    """Fit the motion to (dot, 2) offsets; gives it, (dot,) weights, and the biweight's width, px."""
    theta, sigma = np.zeros(4), search_px
    for turn in range(len(WIDTHS) + LAST_ROUNDS):
        # first the fixed widths, then one that follows the scatter
        width = WIDTHS[turn] * search_px if turn < len(WIDTHS) else SIGMAS * sigma
        left = off_px - answer @ theta
        square = (left**2).sum(axis=1)
        weight = np.maximum(1.0 - square / width**2, 0.0) ** 2
        normal = np.einsum("n,nia,nib->ab", weight, answer, answer)
        right = np.einsum("n,nia,ni->a", weight, answer, off_px)
        # a motion that no dot shows stays nothing
        before, theta = theta, np.linalg.solve(normal + 1e-6 * (1.0 + len(off_px)) * np.eye(4), right)
        # of one coordinate: squares are of two
        sigma = max(SIGMA_MIN_PX, float(np.sqrt(0.5 * weight @ square / max(weight.sum(), 1.0))))
        if turn >= len(WIDTHS) and np.abs(theta - before).max() < SETTLED_PX:
            break
    return theta, weight, width


def _sandwich(left_px: Floats, answer: Floats, weight: Floats, width_px: float, *groups: Integers) -> Floats:
    """Give the motion's covariance (4, 4), by what each group of dots pulls it by; groups are added.

    The bread is the change of the pull by the motion: of a weight w(r)·r that is less than the weight's.
    """
    along = np.einsum("nia,ni->na", answer, left_px)
    change = np.einsum("n,nia,nib->ab", weight, answer, answer)
    # derivative of the biweight's pull w(r)·r: w less what the weight itself changes
    change -= np.einsum("n,na,nb->ab", 4.0 * np.sqrt(weight) / width_px**2, along, along)
    bread = np.linalg.pinv(change, hermitian=True)
    pull = (weight[:, None] * along) @ bread
    found = np.zeros((4, 4))
    for group in groups:
        together = np.zeros((int(group.max(initial=0)) + 1, 4))
        np.add.at(together, group, pull)
        many = np.unique(group[weight > 0.0]).size
        # of few groups the scatter about what was fitted to them is too small: as of n numbers by n − 4
        found += together.T @ together * many / max(many - 4, 1)
    return found
