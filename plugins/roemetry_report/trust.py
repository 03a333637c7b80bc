"""Where trust ends: the margin of every label as a heat strip, a band for each stripe, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.records import AMBIGUOUS, BELT, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry_report import svg
from roemetry_report.words import percent, plain

CLASSES = (
    ("sure", 0.9, "from 0.9"),
    ("fair", 0.7, "0.7 to 0.9"),
    ("weak", 0.5, "0.5 to 0.7"),
    ("poor", 0.3, "0.3 to 0.5"),
    ("least", 0.0, "below 0.3"),
)
"""Classes of margin from the surest on: CSS class, least margin, words."""

_NOT_STATED, _REFUSED, _EMPTY = len(CLASSES), len(CLASSES) + 1, len(CLASSES) + 2
_KINDS = (*(name for name, _, _ in CLASSES), "unstated", "refused")
_TALL = 10.0
_TOLD_FROM = 2
"""Runs of this class and below say what they are when they are pointed at."""


@dataclass(frozen=True, slots=True)
class Strip:
    """A band: its name and its drawing."""

    name: str
    drawing: Markup


@dataclass(frozen=True, slots=True)
class Trust:
    """The strips of an acquisition, and what they come to in words."""

    strips: tuple[Strip, ...]
    rows: int
    notes: tuple[str, ...]


def trust(stripes: StripeMap) -> Trust | None:
    """Draw the margins; None where the coder states none and refuses nothing.

    A band's points on the product are as high as the band, those on the belt half as high. What was bridged
    has no margin of its own and is left out, like what was not seen.
    """
    if not (np.isfinite(stripes.margin) & stripes.seen).any() and not stripes.ambiguous.any():
        return None
    kind = classes_of(stripes)
    on_product = stripes.product > BELT
    bands = [
        Strip(str(index + 1), _band(kind[index], on_product[index], stripes.margin[index], index + 1))
        for index in range(stripes.stripe_count)
    ]
    matters = on_product | stripes.ambiguous
    worst = np.where(matters & (kind != _EMPTY), kind, -1).max(axis=0, initial=-1)
    all_of = np.where(worst < 0, _EMPTY, worst)
    least = np.fmin.reduce(np.where(on_product & stripes.seen, stripes.margin, np.nan), axis=0)
    bands.insert(0, Strip("least", _band(all_of, np.ones_like(all_of, np.bool_), least, None)))
    return Trust(tuple(bands), stripes.rows, _notes(stripes))


def classes_of(stripes: StripeMap) -> NDArray[np.int64]:
    """(stripe, row) class of each point: an index into `CLASSES`, not stated, refused, or empty."""
    floors = np.array([floor for _, floor, _ in CLASSES])
    stated = np.isfinite(stripes.margin)
    kind = np.full(stripes.margin.shape, _EMPTY, np.int64)
    kind[stripes.seen & ~stated] = _NOT_STATED
    at = stripes.seen & stated
    kind[at] = np.searchsorted(-floors, -np.maximum(stripes.margin[at], 0.0))
    # A refused peak where the stripe has another, certain one is no doubt about the stripe.
    kind[stripes.ambiguous & ~stripes.seen] = _REFUSED
    return kind


def _band(kind: NDArray[np.int64], tall: Flags, margin: Floats, stripe: int | None) -> Markup:
    """Draw runs of one class and height as rectangles, one path for each class."""
    edges = np.flatnonzero((np.diff(kind) != 0) | (np.diff(tall.astype(np.int8)) != 0)) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [kind.size]])
    quiet: dict[str, list[str]] = {}
    told = []
    for begin, end in zip(starts.tolist(), ends.tolist(), strict=True):
        which = int(kind[begin])
        if which == _EMPTY:
            continue
        high = _TALL if tall[begin] or which == _REFUSED else 0.5 * _TALL
        data = f"M{begin} {svg.number(0.5 * (_TALL - high))}h{end - begin}v{svg.number(high)}h-{end - begin}z"
        if which >= _TOLD_FROM:
            told.append(
                Markup('<path class="t-{}" d="{}"><title>{}</title></path>').format(
                    _KINDS[which], data, _told(which, begin, end, margin[begin:end])
                )
            )
        else:
            quiet.setdefault(_KINDS[which], []).append(data)
    body = [Markup('<path class="t-{}" d="{}"/>').format(name, "".join(d)) for name, d in quiet.items()]
    name = "Least margin of any stripe on the product" if stripe is None else f"Margin of stripe {stripe}"
    return svg.picture(
        [*body, *told], box=(0, 0, kind.size, _TALL), label=f"{name}, row by row", kind="strip", stretch=True
    )


def _told(which: int, begin: int, end: int, margin: Floats) -> str:
    where = f"row {begin}" if end == begin + 1 else f"rows {begin} to {end - 1}"
    if which == _REFUSED:
        return f"{where}: refused as ambiguous"
    if which == _NOT_STATED:
        return f"{where}: margin not stated"
    return f"{where}: margin from {plain(float(np.nanmin(margin)), 2)}"


def _notes(stripes: StripeMap) -> tuple[str, ...]:
    refused = int(np.count_nonzero(stripes.peak_stripe == AMBIGUOUS))
    said = [f"{refused} {'peak' if refused == 1 else 'peaks'} refused as ambiguous"] if refused else []
    mine = (stripes.product > BELT) & stripes.seen & np.isfinite(stripes.margin)
    if mine.any():
        margin = np.where(mine, stripes.margin, np.inf)
        stripe, row = np.unravel_index(int(margin.argmin()), margin.shape)
        share = float((stripes.margin[mine] >= CLASSES[0][1]).mean())
        said.insert(
            0,
            f"least on a product: {plain(float(margin[stripe, row]), 2)}, stripe {stripe + 1}, row {row}; "
            f"{percent(share)} of its points are at {CLASSES[0][1]} or above",
        )
    return tuple(said)
