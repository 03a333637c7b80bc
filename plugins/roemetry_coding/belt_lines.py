"""Alignment by the belt's stripes: how far the camera has moved since the calibration, from one frame.

Model. The calibration says where each stripe lies on the bare belt: x = u_s(row). A camera that has been
moved a little shows the line at u_s(row) + Σ_k θ_k b_ks(row), where θ are shift, roll, zoom and tilt
(`roemetry.records.calibration`) and b_ks is how the line answers to θ_k: the difference of the rest lines of
two calibrations that the triangulator has moved by ± a step. So the model holds for any lens and any method
of calibration that can be moved.

Every few rows, each peak is compared with the rest line nearest to it. Most peaks lie on the belt; those of a
product lie anywhere. θ is the robust least-squares fit (Tukey's biweight, its width narrowed in steps to four
standard deviations: Huber & Ronchetti, Robust Statistics, 2nd ed., chapter 7). Its covariance is White's
sandwich, clustered by stripe and by eighths of the rows, the two added: each calibrated line has an error of
its own, and errors of neighbouring rows are alike. A shift may come from the camera, the laser or the belt;
at the height h they differ by the shift times h over their distance: that much of the zoom is not known, and
stands in its variance.

Assumes that belt is seen at the ends of the image, and that nothing has moved by more than a few pixels. It
fails, and says so, where the belt is hidden or where lines that fit no small motion are seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks, Reason
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner
from roemetry_coding.alignment import (
    LAST_ROUNDS,
    OUTER_SHARE,
    SEARCH_PX,
    SEARCH_SPACING,
    SETTLED_PX,
    SIGMA_MIN_PX,
    SIGMAS,
    SIGNIFICANT,
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
from roemetry_coding.tears import tear_of
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.robust_fit import solve

_ROWS_USED = 80
"""Rows compared: the fit is then known to some 0.01 px, and takes 0.03 ms."""
BLOCKS = 8
"""Blocks of rows taken as independent: no speckle or texture is correlated over so many rows."""
PEAKS_MIN = 30
"""Belt peaks that must fit: less are a few rows, which any noise could bring together."""
_STRIPE_MOVED_PX = 0.25
"""A light plane that has moved by less costs less than the paper's whole-pixel peaks do."""
_PLANE_DOUBT = 0.1
"""Of its motion: a plane that turned about its projector and one that was shifted differ at a height h by h
over the projector's height, a tenth for high products; and it may have turned along its line."""
_STRIPE_PEAKS_MIN = 15
"""A stripe's own distance is stated from so many peaks on the belt."""
_STRIPE_SPREAD_PX = 0.5
"""Peaks of a plane that has moved far lie so near to a new line in half of the rows, and at both ends of the
image; those of a product do not."""
_STRIPE_REFUSED_PX = 1.0
"""A light plane that has moved by more makes heights wrong by more than any interval says: no number then."""

_STEP_PX, _STEP_SIDE, _STEP_STRIPES_MIN = 0.5, 2, 6
"""Half of what one lost column shifts all stripes beyond by. Of so many on each side none is a plane that
moved alone; and of fewer in all, a slope and a step explain anything."""


class BeltLines(Aligner[AlignerOptions]):
    """Fits a small motion of the camera to the belt's stripes."""

    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Compare a frame's belt with the calibration.

        Parameters
        ----------
        peaks
            Of the whole frame.
        calibration
            As it was made.
        moved
            Gives the calibration of a camera that has moved.

        Raises
        ------
        StageError
            The lines have moved by more than `refuse_from_px`, or too little belt fits any small motion; or
            the frame is torn (`roemetry_coding.tears`).
        """
        model = model_of(calibration, moved)
        # first: a torn frame fits no motion, and its message would be of the wrong cause
        refuse_torn(peaks, model)
        fit = fitted(peaks, model)
        # too few belt peaks: nothing is said, which is not the same as nothing has moved
        if fit.used < PEAKS_MIN:
            return not_compared()
        # lines that fit no small motion are not the belt's
        refuse_far(fit.outer_peaks, fit.outer_fit, LIGHT)
        motion = FittedMotion(fit.motion, fit.covariance, model.edges, model.scale)
        found = alignment_of(motion, self.options, focal_px_of(calibration), LIGHT, 1)
        return with_planes(found, (fit.stripe_px, fit.sigma_px, LIGHT))


LIGHT = Light("stripes", "the calibrated rest lines", "image's top and bottom")


def refuse_torn(peaks: Peaks, model: Model) -> None:
    """Refuse a frame whose stripes jump at a row by a StageError."""
    tear = tear_of(peaks.row_start, peaks.x_px, peaks.amplitude, model.lines, model.spacing_px)
    if tear is not None:
        which = "on the belt are shifted" if tear.of_belt else "on the product jump at once"
        where = "at about row" if tear.of_belt else f"between the rows {tear.row} and"
        raise StageError(
            f"all stripes {which}, by {tear.jump_px:.{1 + tear.of_belt}f} px, {where} {tear.row + 1}: "
            "rows were lost there, or what is below is another frame's",
            hint="look at the image; take it again, and look at cable and frame grabber",
        )


def fitted(peaks: Peaks, model: Model) -> Fit:
    """Fit the motion that takes the calibrated lines to where the belt's peaks lie."""
    every = max(1, len(model.lines) // _ROWS_USED)
    return Fit(*_fitted(
        peaks.row_start, peaks.x_px, model.lines, model.answer, every,
        min(SEARCH_PX, SEARCH_SPACING * model.spacing_px), WIDTHS, LAST_ROUNDS, SIGMAS, SIGMA_MIN_PX, BLOCKS,
        OUTER_SHARE, SETTLED_PX, _STRIPE_PEAKS_MIN, _STRIPE_SPREAD_PX,
    ))  # fmt: skip


def with_planes(found: Alignment, *families: tuple[Floats, float, Light]) -> Alignment:
    """Add what single planes of light have moved against the others; StageError where that is too far.

    Of each family (stripe,) px that stripes lie beside where the motion takes them, their scatter, and words.
    """
    moved = [_stripes_that_moved(*family) for family in families]
    planes_px = np.concatenate([planes for planes, _ in moved])
    sigma_px = max(sigma for _, sigma, _ in families)
    return replace(
        found,
        stripe_px=np.concatenate([stripe_px for stripe_px, _, _ in families]),
        planes_px=planes_px,
        planes_std_px=math.hypot(
            sigma_px / math.sqrt(BLOCKS), _PLANE_DOUBT * max(map(abs, planes_px.tolist()))
        ),
        reasons=(*found.reasons, *(reason for _, said in moved for reason in said)),
    )


class Model(NamedTuple):
    """What a calibration says of the belt's lines.

    `lines` (row, stripe) px; `answer` (row, stripe, 4) their change for a motion that moves some place of the
    image by a pixel; `edges` (place, 4) the same at both ends of every line; `scale` (4,) that motion in the
    units of `PARAMETERS`; `spacing_px` the smallest distance of two lines.
    """

    lines: Floats
    answer: Floats
    edges: Floats
    scale: Floats
    spacing_px: float


class Fit(NamedTuple):
    """What `fitted` gives; the motion in the units of `Model.answer`.

    `stripe_px` (stripe,) is NaN where a stripe has too few peaks on the belt.
    """

    motion: Floats
    covariance: Floats
    used: int
    sigma_px: float
    stripe_px: Floats
    outer_peaks: int
    outer_fit: int


@lru_cache(maxsize=8)
def model_of(calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]) -> Model:
    """Move the calibration to and fro by each parameter; done once for all frames of a calibration."""
    rows = np.arange(calibration.image_size[0], dtype=np.float64)
    lines = calibration.rest_line_px(rows)
    none = np.zeros((4, 4))
    answer = np.empty((*lines.shape, 4))
    for k, step in enumerate(STEPS):
        there, back = (
            moved(calibration, Alignment(np.eye(4)[k] * sign * step, none)).rest_line_px(rows)
            for sign in (1.0, -1.0)
        )
        # central difference: second order in the step
        answer[..., k] = (there - back) / (2.0 * step)
    # only what is seen counts: far outside a polynomial of a line says nothing
    inside = (lines >= 0.0) & (lines < calibration.image_size[1])
    largest = np.array([np.nanmax(np.abs(answer[..., k][inside]), initial=0.0) for k in range(4)])
    scale = np.where(largest > 0.0, 1.0 / np.maximum(largest, 1e-12), 0.0)
    # each parameter in the unit in which it moves some place of the image by 1 px: equations of one scale
    answer = answer * scale
    # the ends of each line: no place in the image moves more
    ends = answer[:, [0, -1]].reshape(-1, 4)
    spacing = np.diff(lines, axis=0)
    return Model(
        lines=np.ascontiguousarray(lines.T),
        answer=np.ascontiguousarray(answer.transpose(1, 0, 2)),
        edges=ends[np.isfinite(ends).all(axis=1)],
        scale=scale,
        spacing_px=float(np.nanmin(spacing)) if spacing.size else math.inf,
    )


def _stripes_that_moved(stripe_px: Floats, sigma_px: float, light: Light) -> tuple[Floats, list[Reason]]:
    """Give how far single planes have moved against the others, 0 for those that have not, and name them."""
    # three standard errors of a stripe's mean, whose blocks of rows are independent
    limit = max(_STRIPE_MOVED_PX, SIGNIFICANT * sigma_px / math.sqrt(BLOCKS))
    moved_px = np.where(np.abs(stripe_px) > limit, stripe_px, 0.0)  # NaN has not
    if not moved_px.any():
        return moved_px, []
    _refuse_step(stripe_px, limit, light)
    far = np.flatnonzero(moved_px)
    which = ", ".join(f"{s + 1} ({stripe_px[s]:+.2f} px)" for s in far)
    # too far for a correction; where the noise is larger, its limit counts
    if np.abs(moved_px).max() > max(_STRIPE_REFUSED_PX, limit):
        raise StageError(
            f"{light.what} have moved against the others on the belt: {which}",
            hint="fasten the projector, and calibrate again",
        )
    text = f"{light.what} have moved against the others on the belt: {which}; corrected, with its uncertainty"
    return moved_px, [Reason("stripe-moved", f"{text}; calibrate again")]


def _refuse_step(stripe_px: Floats, limit_px: float, light: Light) -> None:
    """Refuse a frame where a step and a slope, which fits absorb in part, explain which stripes moved.

    Planes of one projector do not move so.
    """
    known = np.flatnonzero(np.isfinite(stripe_px))
    # with fewer stripes, or only one that moved, a step would always fit
    if known.size < _STEP_STRIPES_MIN or np.count_nonzero(np.abs(stripe_px[known]) > limit_px) < _STEP_SIDE:
        return  # a plane that moved alone, which a slope and a step among few stripes would explain
    step_px = max(_STEP_PX, limit_px)
    for first in known[_STEP_SIDE : 1 - _STEP_SIDE]:
        design = np.column_stack([np.ones(known.size), known, known >= first])
        # offset, slope and step by least squares; what is left must be noise
        found = np.linalg.lstsq(design, stripe_px[known], rcond=None)[0]
        left_px = np.abs(stripe_px[known] - design @ found).max()
        if abs(found[2]) > step_px and left_px <= limit_px:
            raise StageError(
                f"{light.what} from number {first + 1} on lie {found[2]:+.1f} px aside of those before, on "
                "the belt: columns of the image were lost or repeated there",
                hint="look at the image; take it again, and look at cable and frame grabber",
            )


@float_kernel
def _fitted(
    row_start: Integers, x_px: Floats, lines: Floats, answer: Floats, every: int, search_px: float,
    widths: tuple[float, ...], last_rounds: int, sigmas: float, sigma_min_px: float, blocks: int,
    outer_share: float, settled_px: float, stripe_peaks_min: int, stripe_spread_px: float,
) -> tuple[Floats, Floats, int, float, Floats, int, int]:  # fmt: skip
    """Fit the motion; see `Fit` and the model above. `lines` and `answer` as in `Model`."""
    rows, stripes = lines.shape
    count = 0
    most = 0
    for row in range(0, rows, every):
        most += row_start[row + 1] - row_start[row]
    off, weight = np.empty(most), np.empty(most)
    at = np.empty((most, 2), np.int64)
    answers = np.empty((4, most))  # by parameter: sums over them take several peaks at once
    # every so many rows, from the middle of the first stretch
    for row in range(every // 2, rows, every):
        nearest = 0
        for p in range(row_start[row], row_start[row + 1]):
            if count >= most:
                break
            # peaks and lines rise along the row: the nearest line only moves on
            while nearest < stripes - 1 and abs(x_px[p] - lines[row, nearest + 1]) < abs(
                x_px[p] - lines[row, nearest]
            ):
                nearest += 1
            distance = x_px[p] - lines[row, nearest]
            # farther away is no belt, or its number is open
            if abs(distance) <= search_px:
                off[count], at[count, 0], at[count, 1] = distance, row, nearest
                for k in range(4):
                    answers[k, count] = answer[row, nearest, k]
                count += 1
    of_0, of_1, of_2, of_3 = answers[0, :count], answers[1, :count], answers[2, :count], answers[3, :count]
    theta, before = np.zeros(4), np.zeros(4)
    normal, right = np.zeros((4, 4)), np.zeros(4)
    sigma = search_px
    for turn in range(len(widths) + last_rounds):
        # first the fixed widths, then one that follows the scatter
        width = widths[turn] * search_px if turn < len(widths) else sigmas * sigma
        total, sum_weight = 0.0, 0.0
        n00, n01, n02, n03, n11, n12, n13, n22, n23, n33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        r0, r1, r2, r3 = 0.0, 0.0, 0.0, 0.0
        t0, t1, t2, t3 = theta[0], theta[1], theta[2], theta[3]
        for i in range(np.uint64(count)):
            b0, b1, b2, b3 = of_0[i], of_1[i], of_2[i], of_3[i]
            left = off[i] - (t0 * b0 + t1 * b1 + t2 * b2 + t3 * b3)
            share = left / width
            # Tukey's biweight: (1 − (r/width)²)², 0 beyond
            w = max(1.0 - share * share, 0.0)
            w *= w
            weight[i] = w
            sum_weight += w
            total += w * left * left
            c0, c1, c2, c3 = w * b0, w * b1, w * b2, w * b3
            n00 += c0 * b0
            n01 += c0 * b1
            n02 += c0 * b2
            n03 += c0 * b3
            n11 += c1 * b1
            n12 += c1 * b2
            n13 += c1 * b3
            n22 += c2 * b2
            n23 += c2 * b3
            n33 += c3 * b3
            r0 += c0 * off[i]
            r1 += c1 * off[i]
            r2 += c2 * off[i]
            r3 += c3 * off[i]
        normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3] = n00, n01, n02, n03
        normal[1, 1], normal[1, 2], normal[1, 3] = n11, n12, n13
        normal[2, 2], normal[2, 3], normal[3, 3] = n22, n23, n33
        right[0], right[1], right[2], right[3] = r0, r1, r2, r3
        for k in range(4):
            normal[k, k] += 1e-6 * (1.0 + count)  # a motion that nothing shows stays nothing
            for j in range(k):
                normal[k, j] = normal[j, k]
        _solve(normal, right, theta, before)
        # weighted rms: products beyond the width are not in it
        sigma = max(sigma_min_px, math.sqrt(total / max(sum_weight, 1.0)))
        farthest = 0.0
        for k in range(4):
            farthest = max(farthest, abs(theta[k] - before[k]))
        if turn >= len(widths) and farthest < settled_px:
            break
    # what is left: of each block, of each stripe, of the image's ends
    slope = np.zeros((stripes + blocks, 4))
    stripe_sum, of_stripe = np.zeros(stripes), np.zeros(stripes, np.int64)
    used, outer, outer_fit = 0, 0, 0
    # at least 1 px: a narrow biweight must not make belt seen into belt missed
    width = max(sigmas * sigma, 1.0)
    for i in range(count):
        row, stripe = at[i, 0], at[i, 1]
        left = off[i]
        for k in range(4):
            left -= theta[k] * answers[k, i]
        # clusters: one for each stripe, and one for each eighth of the rows
        block = stripes + row * blocks // rows
        for k in range(4):
            # the pull of this peak on the motion, the score of the estimate
            pull = weight[i] * left * answers[k, i]
            slope[stripe, k] += pull
            slope[block, k] += pull
        if abs(left) < width:
            used += 1
            stripe_sum[stripe] += left
            of_stripe[stripe] += 1
            outer_fit += row < outer_share * rows or row >= (1.0 - outer_share) * rows
    for row in range(every // 2, rows, every):
        if row < outer_share * rows or row >= (1.0 - outer_share) * rows:
            outer += row_start[row + 1] - row_start[row]
    for s in range(stripes):  # a plane that has moved far: all its peaks agree on another place
        if of_stripe[s] < stripe_peaks_min:
            beside = 0
            for i in range(count):
                if at[i, 1] == s:
                    weight[beside] = off[i]
                    for k in range(4):
                        weight[beside] -= theta[k] * answers[k, i]
                    beside += 1
            middle = median_of(weight[:beside]) if beside else 0.0
            near, total, first, last = 0, 0.0, rows, 0
            beside = 0
            for i in range(count):
                if at[i, 1] == s:
                    if abs(weight[beside] - middle) < stripe_spread_px:
                        near += 1
                        total += weight[beside]
                        first, last = min(first, at[i, 0]), max(last, at[i, 0])
                    beside += 1
            at_ends = first < outer_share * rows and last >= (1.0 - outer_share) * rows
            # in half of the rows looked at, and at both ends: a product's light does not go from end to end
            if 2 * near * every > rows and at_ends:
                stripe_sum[s], of_stripe[s] = total, near
    for s in range(stripes):
        stripe_sum[s] = stripe_sum[s] / of_stripe[s] if of_stripe[s] >= stripe_peaks_min else np.nan
    # what each block and each stripe pulls the motion by: their squares are its covariance
    covariance, pulled, unused = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    # White's sandwich: each cluster's pull through the inverse normal matrix, squared
    for block in range(stripes + blocks):
        _solve(normal, slope[block], pulled, unused)
        for k in range(4):
            for j in range(4):
                covariance[k, j] += pulled[k] * pulled[j]
    return theta, covariance, used, sigma, stripe_sum, outer, outer_fit


@float_kernel
def _solve(matrix: Floats, right: Floats, answer: Floats, before: Floats) -> None:
    """Solve positive definite equations, and keep the last answer in `before`."""
    for k in range(right.size):
        before[k], answer[k] = answer[k], right[k]
    solve(matrix.copy(), answer)
