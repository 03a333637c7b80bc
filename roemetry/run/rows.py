"""From a trace to rows of the record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.records import (
    AMBIGUOUS,
    BELT,
    NOTHING,
    SATURATED,
    UNLABELLED,
    Coding,
    Estimate,
    Measurement,
    Peaks,
    ProductTrace,
    Reason,
    Status,
    StripeMap,
    Trace,
)
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.run.open_parts import open_parts
from roemetry.run.pipeline import UNCALIBRATED

_STAGES_BEFORE_PRODUCTS = (
    "source", "extractor", "aligner", "coder", "smoother", "triangulator", "assembler"
)  # fmt: skip


def measurements_of(
    trace: Trace, recipe: Recipe, provenance: Mapping[str, str], doubts: tuple[Reason, ...] = ()
) -> tuple[Measurement, ...]:
    """Write the rows of one acquisition: one for each product, or one that says why there is none.

    `provenance` (hashes) and `doubts` about the calibration stand on every row.
    """
    given = dict(provenance)
    warnings = (*_warnings(recipe), *doubts)
    if trace.stripes is None and trace.profiles is None:
        return (_without_product(trace, recipe, warnings, given),)
    if trace.profiles is None and trace.stripes is not None and (trace.stripes.product > 0).any():
        return _in_pixels(trace, trace.stripes, warnings, given)
    if not trace.products:
        return (_without_product(trace, recipe, warnings, given),)
    return tuple(_calibrated(trace, product, warnings, given) for product in trace.products)


def seen_of(trace: Trace, rows: Sequence[Measurement]) -> list[Floats | None]:
    """Give each row's points that were seen, mm, (slice, point, 3); None for rows without a product."""
    if len(rows) != len(trace.products):
        return [None] * len(rows)
    return [one.product.profiles.xyz_mm for one in trace.products]


def failed(acquisition_id: str, kind: str, why: Reason, provenance: Mapping[str, str]) -> Measurement:
    """Write the row of an acquisition that could not even be read."""
    return Measurement(
        id=f"{acquisition_id}#0",
        acquisition=acquisition_id,
        product=0,
        status="failed",
        absent={kind: why},
        reasons=(why,),
        provenance=dict(provenance),
    )


def _row(
    trace: Trace, number: int, of: int, status: Status, reasons: list[Reason], hashes: Mapping[str, str],
    **found: Any,
) -> Measurement:  # fmt: skip
    coding = _coding(trace, number)
    return Measurement(
        id=f"{trace.acquisition_id}#{number}",
        acquisition=trace.acquisition_id,
        product=number,
        products=of,
        status=status,
        coding=coding,
        reasons=_once([*reasons, *(_saturation(coding) if number else [])]),
        provenance=hashes,
        **found,
    )


def _calibrated(
    trace: Trace, found: ProductTrace, warnings: tuple[Reason, ...], hashes: Mapping[str, str]
) -> Measurement:
    product = found.product
    heights = np.ascontiguousarray(product.profiles.xyz_mm[:, :, 2])
    height_max = found.height_max_mm or Estimate(product.height_max_mm)
    low, high = product.calibration.height_range_mm
    reasons = [*found.absent.values(), *warnings, *product.reasons]
    height_min = float(np.fmin.reduce(heights, axis=None, initial=math.nan))
    for reached in (height_max.value, height_min):
        if reached > high + _HEIGHT_SLACK_MM or reached < low - _HEIGHT_SLACK_MM:
            reasons.append(
                Reason(
                    "out-of-calibrated-range",
                    f"heights reach {reached:.1f} mm; the calibration is meant for {low:.1f} to {high:.1f}",
                )
            )
    status: Status = "failed" if found.absent else "measured"
    return _row(
        trace, product.number, len(trace.products), status, reasons, hashes,
        height_max_mm=height_max, volume=found.volume, weight=found.weight, grade=found.grade,
        decision=found.decision, absent={**trace.absent, **found.absent},
    )  # fmt: skip


def _in_pixels(
    trace: Trace, stripes: StripeMap, warnings: tuple[Reason, ...], hashes: Mapping[str, str]
) -> tuple[Measurement, ...]:
    """Rows of a trace with products that was labelled and not triangulated."""
    numbers = [int(number) for number in np.unique(stripes.product) if number > 0]
    fault = trace.absent.get("triangulator")
    faults = [] if fault is None or fault == UNCALIBRATED else [fault]
    return tuple(
        _row(
            trace, number, len(numbers), "failed" if faults else "measured",
            [*warnings, *stripes.reasons, *faults], hashes, absent=dict(trace.absent),
        )
        for number in numbers
    )  # fmt: skip


def _without_product(
    trace: Trace, recipe: Recipe, warnings: tuple[Reason, ...], provenance: Mapping[str, str]
) -> Measurement:
    faults = [
        trace.absent[kind]
        for kind in _STAGES_BEFORE_PRODUCTS
        if kind in trace.absent and trace.absent[kind] != UNCALIBRATED
    ]
    reasons = list(trace.stripes.reasons) if trace.stripes is not None else []
    only_peaks_wanted = "coder" not in recipe.stages and trace.peaks is not None
    coding = _coding(trace, 0)
    if not faults and not only_peaks_wanted:
        faults += [reason for reason in reasons if reason.code in _BELT_IN_DOUBT]
        if coding is not None and coding.ambiguous > _EMPTY_REFUSED_SHARE_MAX * coding.peaks:
            faults.append(
                Reason("undecided", f"{coding.ambiguous} peaks were refused, and the others show no product")
            )
        if not faults:
            reasons.insert(0, Reason("no-product", "every stripe lies on the belt: there is no product"))
    status: Status = "failed" if faults else "measured" if only_peaks_wanted else "empty"
    said = [*faults, *reasons, *warnings]
    return _row(trace, 0, 1, status, said, provenance, absent=dict(trace.absent))


def _open_points(trace: Trace, peaks: Peaks, stripes: StripeMap, number: int) -> int:
    part = open_parts(peaks, stripes, trace.outlines).get(number)
    return part.points if part is not None else 0


def _coding(trace: Trace, number: int) -> Coding | None:
    peaks, stripes = trace.peaks, trace.stripes
    if peaks is None:
        return None
    motion_px = () if trace.alignment is None else trace.alignment.edge_px
    if stripes is None:
        return Coding(0, 0, len(peaks), 0, 0, len(peaks), 0, 0, motion_px=motion_px)
    verdicts = np.bincount(stripes.peak_stripe - AMBIGUOUS, minlength=-AMBIGUOUS)
    of_stripe = verdicts[-AMBIGUOUS:]
    mine = stripes.product == number if number else (stripes.product != BELT) & (stripes.product != NOTHING)
    rows, seen = np.count_nonzero(mine), np.count_nonzero(mine & stripes.seen)
    return Coding(
        stripes=stripes.stripe_count,
        stripes_seen=int(np.count_nonzero(of_stripe)),
        peaks=len(peaks),
        labelled=int(of_stripe.sum()),
        ambiguous=_open_points(trace, peaks, stripes, number) if number else int(verdicts[0]),
        unlabelled=int(verdicts[UNLABELLED - AMBIGUOUS]),
        rows_seen=int(seen),
        rows_interpolated=int(rows - seen),
        saturated_share=_saturated_share(peaks, stripes),
        displacement_max_px=_displacement_max(stripes, mine),
        motion_px=motion_px,
    )


def _displacement_max(stripes: StripeMap, mine: np.ndarray) -> float:
    displacement = stripes.x_px[mine] - stripes.rest_px[mine]
    known = displacement[np.isfinite(displacement)]
    return float(known[np.abs(known).argmax()]) if known.size else math.nan


def _saturated_share(peaks: Peaks, stripes: StripeMap) -> float:
    labelled = stripes.peak_stripe >= 0
    many = np.count_nonzero(labelled)
    return np.count_nonzero((peaks.flags & SATURATED > 0) & labelled) / many if many else math.nan


def _saturation(coding: Coding | None) -> list[Reason]:
    share = math.nan if coding is None else coding.saturated_share
    if not share > _SATURATED_SHARE_MAX:
        return []
    return [Reason("saturated", f"{share:.0%} of the stripe points are saturated: lower the exposure")]


_HEIGHT_SLACK_MM = 1.0
"""So much beyond the calibrated range is noise about the belt, not a product."""
_BELT_IN_DOUBT = ("belt-not-seen", "stripe-moved", "stripe-missing")
"""What makes a belt without a product doubtful: its stripes do not all lie where they should."""
_EMPTY_REFUSED_SHARE_MAX = 0.01
"""An image with more refused peaks than this is not believed to be empty."""
_SATURATED_SHARE_MAX = 0.2
"""Above this share of saturated points the reader is told: their centres depend on how the plateau is cut."""


def _warnings(recipe: Recipe) -> tuple[Reason, ...]:
    """What must be said of every number of this recipe."""
    calibration = recipe.calibration
    if calibration is None:
        return (UNCALIBRATED,) if "extractor" in recipe.stages else ()  # slices of a sensor are in mm
    light = recipe.penetration
    if light is not None and light.calibration_sha256 != calibration.sha256:
        return (
            Reason(
                "penetration-other-calibration",
                f"the penetration offset of {light.offset_mm:.3f} mm was measured with another calibration",
            ),
            *_other_extractor(recipe, calibration),
        )
    return _other_extractor(recipe, calibration)


def _other_extractor(recipe: Recipe, calibration: Calibration) -> tuple[Reason, ...]:
    made_with, now = calibration.extractor, recipe.stages["extractor"].described()
    if not made_with or all(made_with.get(key) == now[key] for key in ("use", "options")):
        return ()
    return (
        Reason(
            "other-extractor",
            f"calibrated with the extractor {_in_words(made_with, now)}, measured with "
            f"{_in_words(now, made_with)}: their peaks may differ by a part of a pixel",
        ),
    )


def _in_words(extractor: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Name an extractor; of the same one with other options, those that differ."""
    name = f"`{extractor.get('use')}`"
    if extractor.get("use") != other.get("use"):
        return name
    others = other.get("options", {})
    options = extractor.get("options", {}).items()
    differ = [f"{key}: {value}" for key, value in options if key not in others or others[key] != value]
    return f"{name} with {', '.join(differ)}" if differ else name


def _once(reasons: list[Reason]) -> tuple[Reason, ...]:
    return tuple(dict.fromkeys(reasons))
