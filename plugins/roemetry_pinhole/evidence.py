"""What speaks for a calibration: residuals, views it did not know, stripes that agree, and a verdict."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.records import Evidence, EvidenceFigure, Residuals
from roemetry_pinhole.holding_out import HeldOut, held_out, stripe_offsets
from roemetry_pinhole.joining import Joint

_WORSE_MAX = 1.5
_BIAS_SHARE_MAX = 1.0
_COVERAGE_MIN = 0.7


def evidence_of(joined: Joint, calibration: Calibration) -> Evidence:
    """Show what speaks for a calibration, and judge it in words."""
    held = held_out(joined.measured, joined.adjusted.geometry)
    figures = _figures(joined, held, calibration)
    return Evidence(_verdict(figures, held, calibration), tuple(figures.values()), _residuals(joined, held))


def _residuals(joined: Joint, held: HeldOut) -> tuple[Residuals, ...]:
    adjusted, measured = joined.adjusted, joined.measured
    marks, used = measured.corners, adjusted.corner_used
    points, seen = measured.points, adjusted.stripe_used
    at = np.column_stack([points.x_px, points.row_px])
    offset, middle, surface = stripe_offsets(adjusted.geometry, points)
    axes = ("x", "y")
    shown = [
        Residuals(
            f"marks, {axis}",
            "px",
            marks.xy_px[used],
            -adjusted.corner_px[used, number],
            marks.pose[used],
            f"Marks of the boards, {axis} in the image; group: the view.",
        )
        for number, axis in enumerate(axes)
    ]
    shown += [
        Residuals(
            f"marks of other views, {axis}",
            "px",
            held.mark_at_px,
            held.mark_px[:, number],
            held.mark_pose,
            "Each fifth view was left out in turn; the board's pose is its own, the camera that of the rest.",
            held_out=True,
        )
        for number, axis in enumerate(axes)
    ]
    shown += [
        Residuals(
            "stripe peaks",
            "px",
            at[seen],
            adjusted.stripe_px[seen],
            points.stripe[seen],
            "Means over a few rows, along the row, on boards and belt; group: the stripe.",
        ),
        Residuals(
            "heights on other views",
            "mm",
            held.height_at_px,
            held.height_mm,
            held.height_stripe,
            "Stripe points on boards that were left out, against the place their marks give; group: the "
            "stripe.",
            held_out=True,
        ),
        Residuals(
            "stripes against each other",
            "mm",
            middle,
            offset,
            np.maximum(surface, 0),
            "Mean distance of each stripe's points from the plane through those of all stripes on the same "
            "board or belt; group: the view.",
        ),
    ]
    return tuple(one for one in shown if len(one.error))


def _figures(joined: Joint, held: HeldOut, calibration: Calibration) -> dict[str, EvidenceFigure]:
    adjusted, residuals = joined.adjusted, calibration.residuals
    found = {}
    if "marks_coverage" in residuals:
        found["coverage"] = EvidenceFigure(
            "part of the image without marks",
            1.0 - residuals["marks_coverage"],
            "1",
            "6 × 6 cells",
            1.0 - _COVERAGE_MIN,
        )
    if held.mark_px.size:
        rms = _rms(adjusted.corner_px[adjusted.corner_used])
        found["marks"] = EvidenceFigure(
            "marks of other views over those used, rms",
            _robust_rms(held.mark_px) / max(rms, 1e-12),
            "1",
            "cross-validation, every fifth view left out in turn",
            _WORSE_MAX,
        )
    if held.height_mm.size:
        means = _means(held.height_mm, held.height_pose)
        low, high = calibration.height_range_mm
        found["heights"] = EvidenceFigure(
            "heights on other views, single points, rms",
            _robust_rms(held.height_mm),
            "mm",
            "means over a few rows, random part included",
        )
        found["bias"] = EvidenceFigure(
            "heights on other views, mean of a board, rms",
            _rms(means),
            "mm",
            f"{means.size} boards; at most a thousandth of the height range",
            1e-3 * _BIAS_SHARE_MAX * (high - low),
        )
    offset = stripe_offsets(adjusted.geometry, joined.measured.points)[0]
    if offset.size:
        found["agree"] = EvidenceFigure(
            "stripes against each other on one surface, rms",
            _rms(offset),
            "mm",
            f"{offset.size} stripes on boards and belt; at most a thousandth of the height range",
            1e-3 * (calibration.height_range_mm[1] - calibration.height_range_mm[0]),
        )
    return found


def _verdict(figures: dict[str, EvidenceFigure], held: HeldOut, calibration: Calibration) -> tuple[str, ...]:
    low, high = calibration.height_range_mm
    over = [key for key, one in figures.items() if one.value > one.limit]
    words = [
        f"Usable from {low:g} to {high:.1f} mm: "
        + (f"{len(over)} of {len(figures)} tests failed, see below." if over else "it stood all tests.")
    ]
    if "bias" in figures:
        words.append(
            f"On boards it did not know, heights are {1e3 * figures['heights'].value:.0f} µm off (rms of "
            f"single points) and {1e3 * figures['bias'].value:.1f} µm in the mean of a board."
        )
    else:
        words.append("No view can be spared: it was not tested on views it did not know. Take more poses.")
    if "marks" in over:
        words.append(
            f"Views it did not know fit {figures['marks'].value:.1f} times worse than those it knew: too few "
            "poses for this lens model, or poses too much alike."
        )
    if "bias" in over:
        words.append("Boards it did not know lie at wrong heights: a bent board, or too few poses.")
    if "agree" in over:
        words.append(
            f"Stripes contradict each other by {1e3 * figures['agree'].value:.0f} µm on one surface: steps "
            "between stripes of that size are the calibration's, not the product's."
        )
    if "coverage" in over:
        words.append(
            f"Marks cover {1.0 - figures['coverage'].value:.0%} of the image: elsewhere the lens is "
            "extrapolated, and heights there are not proven."
        )
    if held.skipped:
        words.append(f"{held.skipped} views could not be left out: the rest determines no calibration.")
    return tuple(words)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _robust_rms(values: Floats) -> float:
    """Rms without what is beyond six times the median: strays are left out of the adjustment as well."""
    size = np.abs(values)
    return _rms(values[size <= 6.0 * max(float(np.median(size)), 1e-12)])


def _means(values: Floats, group: np.ndarray) -> Floats:
    return np.array([values[group == one].mean() for one in np.unique(group)])
