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
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Peaks, Reason
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner, StageOptions
from roemetry_coding.tears import tear_of
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.robust_fit import solve

_STEPS = np.array([2.0, 5e-3, 5e-3, 2e-2])
"""Steps of the numerical derivatives, units of `PARAMETERS`: each moves a usual image's edge by one or two
pixels, far more than the 0.002 px to which rest lines are approximated, and far less than what bends."""
_SEARCH_PX = 6.0
"""Peaks farther from every line are no belt; twice what can be corrected."""
_SEARCH_SPACING = 0.3
"""The same as a share of the lines' smallest distance: beyond it the next line is as near."""
_WIDTHS = (1.0, 0.5, 0.25)
"""Widths of the biweight over the search, one a round: a product's peaks lie anywhere within the search, the
belt's crowd, so narrowing finds the crowd. Fewer rounds may stop at a product's edge."""
_LAST_ROUNDS = 4
_SETTLED_PX = 0.002
"""A round that moves no line by more is the last: far below the 0.01 px to which the fit is known."""
_SIGMAS = 4.0
"""Width of the biweight in the last rounds, standard deviations: 92 % efficient for normal noise."""
_SIGMA_MIN_PX = 0.05
"""Less scatter than this says more of rounding than of the belt."""
_ROWS_USED = 80
"""Rows compared: the fit is then known to some 0.01 px, and takes 0.03 ms."""
_BLOCKS = 8
"""Blocks of rows taken as independent: no speckle or texture is correlated over so many rows."""
_PEAKS_MIN = 30
"""Belt peaks that must fit: less are a few rows, which any noise could bring together."""
_CHECKED_STD_PX = 0.25
"""With lines less sure than this, motion that matters could not be seen."""
_QUANTUM_PX = 0.005
"""Steps to which the correction is rounded at the image's edge, so that frames of one state of the rig share
one corrected calibration. A tenth of the smallest correction."""
_SIGNIFICANT = 3.0
"""Standard deviations from which a motion is taken for real."""
_TOLD_SHARE = 0.15
"""A part of the motion that does less at the image's edge than this share of the largest is not told."""
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
_OUTER_SHARE = 0.1
_OUTER_FIT_MIN = 0.3
"""Of the peaks in the image's first and last tenth so many must lie on the moved lines: a product may cover
two stripes in three there; lines that fit by chance hold a seventh."""


class BeltLinesOptions(StageOptions):
    """From which motion on a frame is corrected, and from which it is refused."""

    correct_from_px: float = Field(
        default=0.05, gt=0, description="motion of a rest line from which the calibration is corrected, px"
    )
    refuse_from_px: float = Field(
        default=3.0, gt=0, description="motion of a rest line from which the frame is refused, px"
    )


class BeltLines(Aligner[BeltLinesOptions]):
    """Fits a small motion of the camera to the belt's stripes."""

    Options = BeltLinesOptions

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
        model = _model_of(calibration, moved)
        search_px = min(_SEARCH_PX, _SEARCH_SPACING * model.spacing_px)
        tear = tear_of(peaks.row_start, peaks.x_px, peaks.amplitude, model.lines, model.spacing_px)
        if tear is not None:
            which = "on the belt are shifted" if tear.of_belt else "on the product jump at once"
            where = "at about row" if tear.of_belt else f"between the rows {tear.row} and"
            raise StageError(
                f"all stripes {which}, by {tear.jump_px:.{1 + tear.of_belt}f} px, {where} {tear.row + 1}: "
                "rows were lost there, or what is below is another frame's",
                hint="look at the image; take it again, and look at cable and frame grabber",
            )
        every = max(1, calibration.image_size[0] // _ROWS_USED)
        fit = _Fit(*_fitted(
            peaks.row_start, peaks.x_px, model.lines, model.answer, every, search_px,
            _WIDTHS, _LAST_ROUNDS, _SIGMAS, _SIGMA_MIN_PX, _BLOCKS, _OUTER_SHARE, _SETTLED_PX,
            _STRIPE_PEAKS_MIN, _STRIPE_SPREAD_PX,
        ))  # fmt: skip
        if fit.used < _PEAKS_MIN:
            return Alignment(
                np.zeros(4),
                np.zeros((4, 4)),
                reasons=(
                    Reason(
                        "belt-not-seen",
                        "too little of the bare belt is seen to compare it with the calibration: whether "
                        "camera, laser or belt have moved is not known",
                    ),
                ),
            )
        largest, largest_std, natural, rounded, covariance = _at_the_edge(
            fit.motion, fit.covariance, model.edges, model.scale, _QUANTUM_PX
        )
        if fit.outer_peaks and fit.outer_fit < _OUTER_FIT_MIN * fit.outer_peaks:
            raise StageError(
                f"of the stripes at the image's top and bottom only {fit.outer_fit / fit.outer_peaks:.0%} "
                "lie within a pixel or so of the calibrated rest lines, however a camera is moved a little",
                hint="camera, laser or belt have moved far, or the calibration is of another rig: "
                "calibrate again",
            )
        if largest > self.options.refuse_from_px + 2.0 * largest_std:
            raise StageError(
                f"the belt's stripes lie up to {largest:.1f} px beside the calibrated rest lines "
                f"({_in_words(natural, fit.motion)}): too far to be corrected",
                hint="fasten camera and laser, and calibrate again",
            )
        reasons = []
        corrected = largest > max(self.options.correct_from_px, _SIGNIFICANT * largest_std)
        if corrected:
            reasons.append(
                Reason(
                    "moved",
                    f"the belt's stripes lie up to {largest:.2f} px beside the calibrated rest lines "
                    f"({_in_words(natural, fit.motion)}): corrected, with its uncertainty",
                )
            )
        elif largest_std > _CHECKED_STD_PX:
            reasons.append(
                Reason(
                    "belt-not-seen",
                    "too little of the bare belt is seen to say better than to "
                    f"{2 * largest_std:.1f} px whether camera, laser or belt have moved",
                )
            )
        planes_px, said = _stripes_that_moved(fit.stripe_px, fit.sigma_px)
        reasons += said
        covariance[2, 2] += (natural[0] / model.focal_px) ** 2  # what has moved is not known: see above
        return Alignment(
            motion=rounded if corrected else np.zeros(4),
            covariance=covariance,
            largest_px=largest,
            largest_std_px=largest_std,
            stripe_px=fit.stripe_px,
            planes_px=planes_px,
            planes_std_px=math.hypot(
                fit.sigma_px / math.sqrt(_BLOCKS), _PLANE_DOUBT * max(map(abs, planes_px.tolist()))
            ),
            reasons=tuple(reasons),
            edge_px=tuple(round(px, 4) for px in fit.motion.tolist()),
        )


class _Model(NamedTuple):
    """What a calibration says of the belt's lines.

    `lines` (row, stripe) px; `answer` (row, stripe, 4) their change for a motion that moves some place of the
    image by a pixel; `edges` (place, 4) the same at both ends of every line; `scale` (4,) that motion in the
    units of `PARAMETERS`; `spacing_px` the smallest distance of two lines; `focal_px` the focal length.
    """

    lines: Floats
    answer: Floats
    edges: Floats
    scale: Floats
    spacing_px: float
    focal_px: float


class _Fit(NamedTuple):
    """What `_fitted` gives; the motion in the units of `_Model.answer`.

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
def _model_of(calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]) -> _Model:
    """Move the calibration to and fro by each parameter; done once for all frames of a calibration."""
    rows = np.arange(calibration.image_size[0], dtype=np.float64)
    lines = calibration.rest_line_px(rows)
    none = np.zeros((4, 4))
    answer = np.empty((*lines.shape, 4))
    for k, step in enumerate(_STEPS):
        there, back = (
            moved(calibration, Alignment(np.eye(4)[k] * sign * step, none)).rest_line_px(rows)
            for sign in (1.0, -1.0)
        )
        answer[..., k] = (there - back) / (2.0 * step)
    inside = (lines >= 0.0) & (lines < calibration.image_size[1])
    largest = np.array([np.nanmax(np.abs(answer[..., k][inside]), initial=0.0) for k in range(4)])
    scale = np.where(largest > 0.0, 1.0 / np.maximum(largest, 1e-12), 0.0)
    answer = answer * scale
    ends = answer[:, [0, -1]].reshape(-1, 4)
    spacing = np.diff(lines, axis=0)
    return _Model(
        lines=np.ascontiguousarray(lines.T),
        answer=np.ascontiguousarray(answer.transpose(1, 0, 2)),
        edges=ends[np.isfinite(ends).all(axis=1)],
        scale=scale,
        spacing_px=float(np.nanmin(spacing)) if spacing.size else math.inf,
        focal_px=_focal_px(calibration),
    )


def _focal_px(calibration: Calibration) -> float:
    """Focal length, px; of a telecentric camera, or where none is known, as good as infinite."""
    view = calibration.view
    return math.inf if view is None or view.telecentric else float(view.camera_matrix[0, 0])


def _in_words(motion: Floats, edge_px: Floats) -> str:
    """Say in which way and by how much the image has moved; what moves its edge by little is left out.

    `motion` in the units of `PARAMETERS`, `edge_px` what each does at the image's edge.
    """
    pan, roll, zoom, tilt = motion
    turn = "clockwise" if roll > 0 else "counter-clockwise"
    words = (
        f"image shifted by {pan:+.2f} px along x",
        f"turned by {math.degrees(abs(roll)):.2f}° {turn}",
        f"grown by {zoom:+.2%}" if zoom > 0 else f"shrunk by {-zoom:.2%}",
        f"camera tilted by {math.degrees(tilt):+.2f}° about its x axis",
    )
    told = np.abs(edge_px) >= _TOLD_SHARE * np.abs(edge_px).max()
    return ", ".join(word for word, tell in zip(words, told, strict=True) if tell)


def _stripes_that_moved(stripe_px: Floats, sigma_px: float) -> tuple[Floats, list[Reason]]:
    """Give how far single planes have moved against the others, 0 for those that have not, and name them."""
    limit = max(_STRIPE_MOVED_PX, _SIGNIFICANT * sigma_px / math.sqrt(_BLOCKS))
    moved_px = np.where(np.abs(stripe_px) > limit, stripe_px, 0.0)  # NaN has not
    if not moved_px.any():
        return moved_px, []
    far = np.flatnonzero(moved_px)
    which = ", ".join(f"{s + 1} ({stripe_px[s]:+.2f} px)" for s in far)
    if np.abs(moved_px).max() > max(_STRIPE_REFUSED_PX, limit):
        raise StageError(
            f"stripes have moved against the others on the belt: {which}",
            hint="fasten the projector, and calibrate again",
        )
    text = f"stripes have moved against the others on the belt: {which}; corrected, with its uncertainty"
    return moved_px, [Reason("stripe-moved", f"{text}; calibrate again")]


@float_kernel
def _fitted(
    row_start: Integers, x_px: Floats, lines: Floats, answer: Floats, every: int, search_px: float,
    widths: tuple[float, ...], last_rounds: int, sigmas: float, sigma_min_px: float, blocks: int,
    outer_share: float, settled_px: float, stripe_peaks_min: int, stripe_spread_px: float,
) -> tuple[Floats, Floats, int, float, Floats, int, int]:  # fmt: skip
    """Fit the motion; see `_Fit` and the model above. `lines` and `answer` as in `_Model`."""
    rows, stripes = lines.shape
    count = 0
    most = 0
    for row in range(0, rows, every):
        most += row_start[row + 1] - row_start[row]
    off, weight = np.empty(most), np.empty(most)
    at = np.empty((most, 2), np.int64)
    answers = np.empty((4, most))  # by parameter: sums over them take several peaks at once
    for row in range(every // 2, rows, every):
        nearest = 0
        for p in range(row_start[row], row_start[row + 1]):
            if count >= most:
                break
            while nearest < stripes - 1 and abs(x_px[p] - lines[row, nearest + 1]) < abs(
                x_px[p] - lines[row, nearest]
            ):
                nearest += 1
            distance = x_px[p] - lines[row, nearest]
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
        width = widths[turn] * search_px if turn < len(widths) else sigmas * sigma
        total, sum_weight = 0.0, 0.0
        n00, n01, n02, n03, n11, n12, n13, n22, n23, n33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        r0, r1, r2, r3 = 0.0, 0.0, 0.0, 0.0
        t0, t1, t2, t3 = theta[0], theta[1], theta[2], theta[3]
        for i in range(np.uint64(count)):
            b0, b1, b2, b3 = of_0[i], of_1[i], of_2[i], of_3[i]
            left = off[i] - (t0 * b0 + t1 * b1 + t2 * b2 + t3 * b3)
            share = left / width
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
    width = max(sigmas * sigma, 1.0)
    for i in range(count):
        row, stripe = at[i, 0], at[i, 1]
        left = off[i]
        for k in range(4):
            left -= theta[k] * answers[k, i]
        block = stripes + row * blocks // rows
        for k in range(4):
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
            if 2 * near * every > rows and at_ends:
                stripe_sum[s], of_stripe[s] = total, near
    for s in range(stripes):
        stripe_sum[s] = stripe_sum[s] / of_stripe[s] if of_stripe[s] >= stripe_peaks_min else np.nan
    # what each block and each stripe pulls the motion by: their squares are its covariance
    covariance, pulled, unused = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    for block in range(stripes + blocks):
        _solve(normal, slope[block], pulled, unused)
        for k in range(4):
            for j in range(4):
                covariance[k, j] += pulled[k] * pulled[j]
    return theta, covariance, used, sigma, stripe_sum, outer, outer_fit


@float_kernel
def _at_the_edge(
    motion: Floats, covariance: Floats, edges: Floats, scale: Floats, quantum: float
) -> tuple[float, float, Floats, Floats, Floats]:
    """Say how far a motion moves the edge where it does most, px, its uncertainty, and what it is in nature.

    That is as found, rounded to `quantum` at the edge, and its covariance, in the units of `PARAMETERS`.
    """
    worst, largest, variance = 0, -1.0, 0.0
    for place in range(len(edges)):
        off = 0.0
        for k in range(4):
            off += edges[place, k] * motion[k]
        if not abs(off) <= largest:  # NaN stays: of no motion it is said that it is small
            worst, largest = place, abs(off)
    natural, rounded, scaled = np.empty(4), np.empty(4), np.empty((4, 4))
    for k in range(4):
        natural[k] = motion[k] * scale[k]
        rounded[k] = np.rint(motion[k] / quantum) * quantum * scale[k]
        for j in range(4):
            variance += edges[worst, k] * covariance[k, j] * edges[worst, j]
            scaled[k, j] = covariance[k, j] * scale[k] * scale[j]
    return largest, math.sqrt(max(variance, 0.0)), natural, rounded, scaled


@float_kernel
def _solve(matrix: Floats, right: Floats, answer: Floats, before: Floats) -> None:
    """Solve positive definite equations, and keep the last answer in `before`."""
    for k in range(right.size):
        before[k], answer[k] = answer[k], right[k]
    solve(matrix.copy(), answer)
