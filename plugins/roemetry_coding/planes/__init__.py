"""Stripe coding by the planes of light: labels that make a surface which this camera would see like this.

Model. Each peak, taken for each stripe, is a point in space: its line of sight meets the plane of light.
Labels are chosen so that heights are possible, the surface goes on from stripe to stripe and along the
stripes, stripes keep their order on every epipolar line, and every stripe that is not seen is hidden by
something. In the order in which a frame passes through:

    lines    the image sorted along epipolar lines, and the traces of peaks that cross them
    pieces   where traces lie on rest lines, and where they are cut
    graph    what each peak may be, and what labels and neighbours cost: the energy
    solve    the cheapest labels, exact on every line, made to agree along the traces
    shifts   whole groups of runs moved by one stripe: to lower the energy, and to ask how sure a label is
    whole_bodies   the same of whole bodies, by up to three stripes
    vetoes   what is refused although the energy prefers it
    decide   verdicts and margins

What is in doubt is refused. Source: our own; parts are cited in the files. Worth of each rule:
docs/measurements/coding-ablation.md; what the coder is good for: docs/explanation/coding.md.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Peaks, Reason, StripeMap
from roemetry.records.arrays import Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_coding.planes.decide import decided, margin_of, stripes_of, verdicts_of
from roemetry_coding.planes.lines import epipolar_lines
from roemetry_coding.planes.solve import OUTER_SHARE, build_problem, cheapest_labels, reaching
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.consistency import refuse_bare_lines, refuse_uncodable, required_calibration
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.rest_lines import RestLines, calibrated_rest_lines, missing_stripes, reasons_of

__all__ = ["Planes", "PlanesOptions", "coded_by_planes", "epipolar_lines", "margin_of"]

_REACH = (2.0, 4.0, 8.0)
"""Heights are looked for up to so many times the highest that the calibration is meant for: only so is a
product that is too high seen as that, and not taken for a lower one a stripe or more off. Twice is enough
where the next higher label was looked at, too; else the next bound is taken. It costs time on every frame."""
_AT_BOUND_SHARE_MAX = 0.02
"""So many body points may lie next to the bound before it is raised: false peaks do."""
_LIVE_PEAKS_MIN = 15
"""A stripe with fewer labels is named as missing: bodies cross its rest line in as many rows."""
_LABELLED_SHARE_MIN = 0.4
"""With fewer peaks on any possible surface, image and calibration do not belong together."""
_ON_BELT_MIN = 0.3
"""So many of the peaks there must lie on rest lines: a product may cover two stripes in three."""


class PlanesOptions(BridgingOptions):
    """How sure a label must be, and gaps and sizes as in other coders."""

    margin_min: float = Field(
        default=0.985, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


class Planes(Coder[PlanesOptions]):
    """Solves for all labels of a frame at once, on the lines where sight and light meet."""

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame; see `coded_by_planes`."""
        return coded_by_planes(peaks, calibration, self.options)


def coded_by_planes(
    peaks: Peaks, calibration: Calibration | None, options: PlanesOptions, *, lines_apart: int = 1
) -> StripeMap:
    """Code the peaks of one frame.

    Parameters
    ----------
    peaks
        From any extractor.
    calibration
        Its view gives camera and planes; without a view, image rows and displacements are used.
    options
        See `PlanesOptions`.
    lines_apart
        Image rows from one epipolar line to the next. Time falls nearly with it. Wider than a row is for
        coders that check the labels in another way, too.

    Raises
    ------
    StageError
        No calibration; no peak at all; peaks of another image size than the calibration's; rest lines that
        cross, or with (nearly) nothing on them; the belt's stripes more than a pixel beside them; fewer than
        two peaks in five on any possible surface.
    """
    refuse_uncodable(peaks, calibration)
    calibration = required_calibration(calibration, "planes", "without planes a peak has no height")
    rest = calibrated_rest_lines(peaks, calibration)
    reaches = _reaches(calibration, rest)
    problem = build_problem(peaks, calibration, rest, reaches[0], lines_apart)
    refuse_bare_lines(bool(problem.candidates.many.any()), rest.x_px.shape[0])
    solved = cheapest_labels(problem)
    # raised only where bodies stand at the bound: more labels cost time on every line
    for bound, reach in pairwise(reaches):
        if not _bounded(peaks, stripes_of(problem, solved), calibration, rest, bound):
            break
        problem = reaching(problem, calibration, rest, reach)
        solved = cheapest_labels(problem)
    verdicts = verdicts_of(problem, solved, peaks.row)
    # stripes that are named: with light on their rest line, or at least given often enough
    given = np.bincount(verdicts.stripe[verdicts.stripe >= 0], minlength=problem.there.size)
    live = np.flatnonzero((problem.there > 0.0) & (given >= _LIVE_PEAKS_MIN))
    refuse_bare_lines(live.size > 0 and _belt_fits(peaks, rest), rest.x_px.shape[0])
    stripe, margin, gaps = decided(
        problem,
        verdicts,
        peaks,
        calibration,
        rest,
        options.margin_min,
        options.longest_gap_rows,
    )
    # peaks refused for doubt count here as well: such a frame is of no use
    labelled = (stripe >= 0).mean()
    if labelled < _LABELLED_SHARE_MIN:
        raise StageError(
            f"only {labelled:.0%} of the peaks can lie on a surface: either they are noise, or "
            "calibration and image do not belong together",
            hint="look at the image; was it turned, or the camera moved?",
        )
    return bridged(
        peaks,
        stripe,
        margin,
        rest,
        longest_gap_rows=options.longest_gap_rows,
        smallest_product_points=options.smallest_product_points,
        reasons=reasons_of(rest)
        + missing_stripes(live, rest.x_px.shape[0])
        + gaps
        + _approximate(calibration),
    )


def _reaches(calibration: Calibration, rest: RestLines) -> tuple[float, ...]:
    """Give how high is looked for, first and after, in times the highest that the calibration is meant for.

    At first so far that the next higher label of the highest product is among what is looked at, or no
    product of that height would be coded at the first try. Where that is more than `_REACH` says, stripes
    stand so far apart that it adds few labels.
    """
    high_mm = calibration.height_range_mm[1]
    if rest.x_px.shape[0] < 2 or high_mm <= 0.0:
        return _REACH
    label_mm = _spacing_px(rest) / float(np.abs(calibration.displacement_px_per_mm).min())
    first = min(max(_REACH[0], 1.0 + label_mm / high_mm), _REACH[1])
    return first, *(reach for reach in _REACH if reach > first)


def _spacing_px(rest: RestLines) -> float:
    """Distance of neighbouring stripes on the belt."""
    return median_of(np.diff(rest.x_px, axis=0).ravel())


def _bounded(peaks: Peaks, stripe: Integers, calibration: Calibration, rest: RestLines, bound: float) -> bool:
    """Say whether bodies might be one stripe spacing higher, had heights above the bound been looked at."""
    if rest.x_px.shape[0] < 2:
        return False
    # off its own rest line: body
    body = np.flatnonzero((stripe >= 0) & (stripe != rest.line))
    per_mm = calibration.displacement_px_per_mm[stripe[body]]
    # to first order: only asked whether one label more would have passed the bound
    height_mm = (peaks.x_px[body] - rest.x_px[stripe[body], peaks.row[body]]) / per_mm
    label_mm = _spacing_px(rest) / np.abs(per_mm)
    at_bound = np.count_nonzero(height_mm + label_mm > bound * calibration.height_range_mm[1])
    return bool(at_bound > _AT_BOUND_SHARE_MAX * body.size)


def _belt_fits(peaks: Peaks, rest: RestLines) -> bool:
    """Say whether the peaks at the image's top and bottom lie on rest lines, at least three in ten."""
    rows = peaks.image_size[0]
    outer = (peaks.row < OUTER_SHARE * rows) | (peaks.row >= (1.0 - OUTER_SHARE) * rows)
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
            "the calibration has no camera and planes, so image rows were used as epipolar lines: this is "
            "right for a distant camera; under perspective more peaks are refused or wrong",
        )
    ]
