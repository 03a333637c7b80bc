"""Stripe coding by the planes of light: which labels make a surface that this camera would see like this.

Each peak, taken for each stripe, is a point in space: the line of sight meets the plane of light. Labels are
chosen so that heights are possible, the surface goes on from stripe to stripe and along the stripes, and
every stripe that is not seen is hidden by something. What is in doubt is refused.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydantic import Field

from roemetry.arrays import Flags, Floats, Integers
from roemetry.calibration import Calibration
from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, Reason, StripeMap
from roemetry.stages import Coder
from roemetry_coding.margins import margin_of
from roemetry_coding.plane_solver import Solved, solve_planes
from roemetry_kernels.coding.bridging import BridgingOptions, bridged
from roemetry_kernels.coding.consistency import HIDING_SPACINGS, refuse_unexplained_gaps
from roemetry_kernels.coding.label_doubts import left_over
from roemetry_kernels.coding.label_verdicts import out_of_order
from roemetry_kernels.coding.refusing import refuse_bare_lines, refuse_uncodable, required_calibration
from roemetry_kernels.coding.rest_lines import RestLines, calibrated_rest_lines, missing_stripes, reasons_of


class PlanesOptions(BridgingOptions):
    """How sure a label must be, and gaps and sizes as in other coders."""

    margin_min: float = Field(
        default=0.985, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


_BEYOND = (2.0, 4.0, 8.0)
"""Heights are looked for up to so many times the highest that the calibration is meant for: only so is a
product that is too high seen as that, and not taken for a lower one a stripe or more off. Twice is enough
where the next higher label was looked at, too; else the next bound is taken. It costs time on every frame."""
_AT_BOUND_SHARE_MAX = 0.02
"""So many body points may lie next to the bound before it is raised: false peaks do."""
_LIVE_PEAKS_MIN = 15
_CODED_SHARE_MIN = 0.4
_OUTER_SHARE = 0.1
_ON_BELT_MIN = 0.3
_SURVIVE_SHARE = 0.5
_BODY_SURVIVE_SHARE = 0.75
_CONTESTED_PEAKS = 4
_REMNANT_SHARE = 0.1


class Planes(Coder[PlanesOptions]):
    """Solves for all labels of a frame at once, on the lines where sight and light meet."""

    Options = PlanesOptions

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Its view gives camera and planes; without a view, image rows and displacements are used.

        Raises
        ------
        StageError
            No calibration; no peak at all; peaks of another image size than the calibration's; rest lines
            that cross, or with (nearly) nothing on them; the belt's stripes more than a pixel beside them;
            fewer than two peaks in five on any possible surface.
        """
        refuse_uncodable(peaks, calibration)
        calibration = required_calibration(calibration, "planes", "without planes a peak has no height")
        rest = calibrated_rest_lines(peaks, calibration)
        solved = solve_planes(peaks, calibration, rest, _BEYOND[0])
        for bound, beyond in pairwise(_BEYOND):
            if not _bounded(peaks, solved.stripe, calibration, rest, bound):
                break
            solved = solve_planes(peaks, calibration, rest, beyond)
        given = np.bincount(solved.stripe[solved.stripe >= 0], minlength=solved.there.size)
        live = np.flatnonzero((solved.there > 0.0) & (given >= _LIVE_PEAKS_MIN))
        refuse_bare_lines(live.size > 0 and _belt_fits(peaks, rest), rest.x_px.shape[0])
        stripe, margin, gaps = self._decided(peaks, calibration, rest, solved)
        coded = (stripe >= 0).mean()
        if coded < _CODED_SHARE_MIN:
            raise StageError(
                f"only {coded:.0%} of the peaks lie on a surface that can be: either they are noise, or "
                "calibration and image do not belong together",
                hint="look at the image; was it turned, or the camera moved?",
            )
        return bridged(
            peaks,
            stripe,
            margin,
            rest,
            longest_gap_rows=self.options.longest_gap_rows,
            smallest_product_points=self.options.smallest_product_points,
            reasons=reasons_of(rest)
            + missing_stripes(live, rest.x_px.shape[0])
            + gaps
            + _approximate(calibration),
        )

    def _decided(
        self, peaks: Peaks, calibration: Calibration, rest: RestLines, solved: Solved
    ) -> tuple[Integers, Floats, list[Reason]]:
        """Refuse doubt and disorder; give (peak,) stripe or verdict, margin, and what to say."""
        margin = margin_of(solved.dearer, solved.evidence)
        stripe = solved.stripe.copy()
        sure = solved.whole & (margin >= self.options.margin_min)
        stripe[(stripe >= 0) & ~sure] = AMBIGUOUS
        entries = solved.entries
        line = rest.line
        wrong = out_of_order(entries.start, entries.peak, peaks.row, line, stripe, solved.there.size)
        stripe[wrong] = AMBIGUOUS
        wrong = out_of_order(entries.start, entries.peak, peaks.row, line, solved.claimed, solved.there.size)
        # at a body's edge its stripe may be seen twice for a row or two
        often = np.bincount(solved.piece[wrong], minlength=solved.piece.max() + 1) >= _CONTESTED_PEAKS
        stripe[wrong & often[solved.piece] & (stripe >= 0)] = AMBIGUOUS
        stripe[left_over(solved.piece, solved.stripe, stripe, _SURVIVE_SHARE)] = AMBIGUOUS

        stripe, gaps = refuse_unexplained_gaps(
            peaks,
            stripe,
            line,
            rest.x_px,
            calibration.displacement_px_per_mm,
            self.options.longest_gap_rows,
            on_bodies_too=True,
        )
        if gaps:
            # what a body is on some rows it is on the others
            partly = left_over(solved.piece, solved.stripe, stripe, _BODY_SURVIVE_SHARE)
            stripe[partly & (line != solved.stripe)] = AMBIGUOUS
            level = ~solved.anchored & _nearly_belt(peaks, solved.stripe, rest)
            for along in (solved.stripe, solved.trace):
                goes_on = _goes_on(peaks.row, along, level, stripe < 0, self.options.longest_gap_rows)
                stripe[goes_on] = AMBIGUOUS
        stripe[left_over(solved.piece, solved.stripe, stripe, _SURVIVE_SHARE)] = AMBIGUOUS
        stripe[_remnants(line, stripe)] = AMBIGUOUS
        return stripe, margin, gaps


def _nearly_belt(peaks: Peaks, stripe: Integers, rest: RestLines) -> Flags:
    """Mark (peak,) what lies so near its stripe's rest line that it could hide nothing."""
    spacing_px = np.median(np.diff(rest.x_px, axis=0)) if rest.x_px.shape[0] > 1 else np.inf
    away_px = np.abs(peaks.x_px - rest.x_px[np.maximum(stripe, 0), peaks.row])
    return np.asarray((stripe >= 0) & (away_px < HIDING_SPACINGS * spacing_px))


def _goes_on(row: Integers, along: Integers, asked: Flags, doubted: Flags, gap_rows: int) -> Flags:
    """Mark (peak,) those asked that go on, along a stripe or a trace, from one in doubt."""
    which = np.flatnonzero(asked)
    which = which[np.lexsort((row[which], along[which]))]
    apart = (np.diff(along[which], prepend=-1) != 0) | (np.diff(row[which], prepend=0) > gap_rows + 1)
    group = np.cumsum(apart)
    found = np.zeros(row.size, np.bool_)
    found[which] = np.bincount(group, weights=doubted[which])[group] > 0.0
    return found


def _bounded(peaks: Peaks, stripe: Integers, calibration: Calibration, rest: RestLines, bound: float) -> bool:
    """Say whether bodies might be one stripe spacing higher, had heights above the bound been looked at."""
    if rest.x_px.shape[0] < 2:
        return False
    body = np.flatnonzero((stripe >= 0) & (stripe != rest.line))
    per_mm = calibration.displacement_px_per_mm[stripe[body]]
    height_mm = (peaks.x_px[body] - rest.x_px[stripe[body], peaks.row[body]]) / per_mm
    label_mm = np.median(np.diff(rest.x_px, axis=0)) / np.abs(per_mm)
    at_bound = np.count_nonzero(height_mm + label_mm > bound * calibration.height_range_mm[1])
    return bool(at_bound > _AT_BOUND_SHARE_MAX * body.size)


def _remnants(line: Integers, stripe: Integers) -> Flags:
    """Mark (peak,) what is left on bodies of which nearly all was refused: nothing bears it out any more."""
    left = (stripe >= 0) & (stripe != line)
    refused = np.count_nonzero((stripe == AMBIGUOUS) & (line < 0))
    few = np.count_nonzero(left) < _REMNANT_SHARE * (np.count_nonzero(left) + refused)
    return np.asarray(left & few)


def _belt_fits(peaks: Peaks, rest: RestLines) -> bool:
    """Say whether the peaks at the image's top and bottom lie on rest lines, at least three in ten."""
    rows = peaks.image_size[0]
    outer = (peaks.row < _OUTER_SHARE * rows) | (peaks.row >= (1.0 - _OUTER_SHARE) * rows)
    if not outer.any():
        return True
    return bool((rest.line[outer] >= 0).mean() >= _ON_BELT_MIN)


def _approximate(calibration: Calibration) -> list[Reason]:
    """Say that there were no planes, only displacements."""
    view = calibration.view
    if view is not None and not view.telecentric:
        return []
    return [
        Reason(
            "no-planes",
            "the calibration has no camera and planes, so image rows stood for the lines of sight and light: "
            "right for a distant camera, more is refused or wrong under perspective",
        )
    ]
