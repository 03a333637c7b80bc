"""One acquisition, measured by one variant, beside its truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.records import Measurement, ProductTruth, Reason, StripeTruth, Trace, Truth
from roemetry.run.rows import measurements_of
from roemetry.run.stage_cache import StageCache
from roemetry_tools.compare.stripes import (
    CentreScore,
    CodingScore,
    by_place,
    score_centres,
    score_coding,
    truth_in,
)


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """A product as measured (without provenance) and as it is; either may be missing.

    Products are numbered from left to right; 0 stands where there is none at all.
    """

    product: int
    measured: Measurement | None
    true: ProductTruth | None
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Scored:
    """What one variant made of one acquisition (`item` is its id)."""

    variant: int
    item: str
    pairs: tuple[Pair, ...]
    refused: Reason | None
    """Why it was not measured, or not all of it; None where it was."""
    centres: CentreScore | None = None
    centres_on_product: CentreScore | None = None
    coding: CodingScore | None = None
    """centres, centres_on_product, coding: extractor and coder against the true stripes; where None,
    `without` says why."""
    without: Mapping[str, Reason] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    """By step, the time it took where it was done, s."""


def score(
    variant: int,
    trace: Trace,
    recipe: Recipe,
    truth: Truth | None,
    *,
    memory: tuple[Mapping[str, str], StageCache],
    seconds: Mapping[str, float],
    turn_deg: int = 0,
) -> Scored:
    """Judge what a variant did with an acquisition; `truth` is None where nothing is known.

    Scores are shared like steps: `memory` holds them, under the keys of the variant's steps. The truth of the
    stripes is given for the image turned by the data set's `turn_deg`.
    """
    keys, shared = memory
    rows = measurements_of(trace, recipe, {})
    without: dict[str, Reason] = {}
    centres: CentreScore | None = None
    on_product: CentreScore | None = None
    coding: CodingScore | None = None
    stripes = _stripes(trace, truth, without, turn_deg)
    pairs = _pairs(rows, trace, truth, stripes, turn_deg)
    if stripes is not None and trace.peaks is not None:
        peaks = trace.peaks
        key = ("centres", keys["extractor"])
        centres, on_product = shared.recall(key, lambda: score_centres(peaks, stripes))[0]
        coded = trace.stripes
        if coded is not None and coded.stripe_count != stripes.x_px.shape[0]:
            without["coding"] = Reason(
                "other-stripes",
                f"{coded.stripe_count} stripes are labelled, the truth counts {stripes.x_px.shape[0]}",
            )
        elif coded is not None:
            key = ("coding", keys["coder"])
            coding = shared.recall(key, lambda: score_coding(coded, peaks, stripes))[0]
    return Scored(
        variant,
        trace.acquisition_id,
        pairs,
        _refused(rows, pairs, truth),
        centres,
        on_product,
        coding,
        without,
        seconds,
    )


def unreadable(variant: int, item: str, why: Reason, truth: Truth | None) -> Scored:
    """Judge an acquisition that could not be read."""
    products = () if truth is None else truth.products
    pairs = tuple(Pair(number, None, true, (why,)) for number, true in enumerate(products, start=1))
    return Scored(variant, item, pairs or (Pair(0, None, None, (why,)),), why)


def _stripes(
    trace: Trace, truth: Truth | None, without: dict[str, Reason], turn_deg: int
) -> StripeTruth | None:
    if truth is None or trace.frame is None:
        return None
    if truth.stripes is None:
        without["stripes"] = Reason("no-true-stripes", "the data set does not say where the stripes are")
        return None
    found = truth_in(trace.frame, truth.stripes, turn_deg)
    if isinstance(found, Reason):
        without["stripes"] = found
        return None
    return found


def _pairs(
    rows: Sequence[Measurement],
    trace: Trace,
    truth: Truth | None,
    stripes: StripeTruth | None,
    turn_deg: int,
) -> tuple[Pair, ...]:
    """Put measured and true products together: by place, else from left to right if there are as many."""
    found = _left_to_right([row for row in rows if row.product > 0], trace, turn_deg)
    if truth is None:
        return tuple(Pair(row.product, row, None, row.all_reasons) for row in found or rows)
    matched = _matched(found, trace, truth, stripes)
    if not found:
        why = rows[0].all_reasons
        missed = tuple(Pair(n, None, product, why) for n, product in enumerate(truth.products, start=1))
        return missed or (Pair(0, rows[0], None, why),)
    why = (_differ(len(found), len(truth.products)),)
    measured = {number: row for row in found if (number := matched.get(row.product)) is not None}
    pairs = []
    for number, true in enumerate(truth.products, start=1):
        row = measured.get(number)
        pairs.append(Pair(number, row, true, why if row is None else row.all_reasons))
    left = [row for row in found if row.product not in matched]
    return (*pairs, *(Pair(row.product, row, None, (*why, *row.all_reasons)) for row in left))


def _matched(
    found: Sequence[Measurement], trace: Trace, truth: Truth, stripes: StripeTruth | None
) -> dict[int, int]:
    """Give the true product's number for each measured one's, as far as that is known."""
    several = len(found) > 1 or len(truth.products) > 1
    if several and stripes is not None and trace.stripes is not None:
        placed = by_place(trace.stripes, stripes)
        if placed:
            return placed
    if len(found) == len(truth.products):
        return {row.product: number for number, row in enumerate(found, start=1)}
    return {}


def _left_to_right(found: list[Measurement], trace: Trace, turn_deg: int) -> list[Measurement]:
    """Order by the place in the image that the truth is given for."""
    if len(found) < 2 or trace.frame is None:
        return found
    half_turned = (trace.frame.turn_deg - turn_deg) % 360 == 180
    place = {
        product.product.number: float(np.nanmean(product.product.profiles.x_px))
        for product in trace.products
        if np.isfinite(product.product.profiles.x_px).any()
    }
    return sorted(found, key=lambda row: place.get(row.product, math.inf) * (-1 if half_turned else 1))


def _refused(rows: Sequence[Measurement], pairs: Sequence[Pair], truth: Truth | None) -> Reason | None:
    for row in rows:
        if row.status == "failed":
            faults = tuple(row.absent.values()) or row.reasons
            return next((why for why in row.reasons if why in faults), faults[0])
        if row.status == "empty" and truth is not None and truth.products:
            return row.reasons[0]
    return next((why for pair in pairs for why in pair.reasons if why.code == "products-differ"), None)


def _differ(found: int, true: int) -> Reason:
    if found == true:
        return Reason("products-differ", "a product was found where there is none, and one was missed")
    return Reason(
        "products-differ",
        f"{found} products were found, {true} are there"
        if true
        else f"{found} products were found where there is none",
    )
