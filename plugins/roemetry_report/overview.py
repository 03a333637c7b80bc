"""The overview of a run: which products are shown, a table row for each, what to trust.

Of a long run: how quantities are distributed and move, what stands out, why rows failed. Of each row a few
numbers are kept, so a million rows take a hundred megabytes; of the page they take nothing.
"""

from __future__ import annotations

import heapq
import math
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.html import plots as svg
from roemetry.html.plots import Axis, plain
from roemetry.records import (
    AMBIGUOUS,
    BELT,
    Decision,
    Estimate,
    Grade,
    Measurement,
    Reason,
    Shares,
    StripeMap,
)
from roemetry.records.arrays import Flags, Floats
from roemetry.records.units import MM3_PER_CM3, NOT_STATED
from roemetry.stages import Run
from roemetry_report.charts import share_bar
from roemetry_report.words import budget, counted, interval, percent, uncertainty, value

ROWS_MAX = 500
"""Rows of the summary table; a page with more is no help to anyone."""
_EXAMPLES = 2
"""Acquisitions shown of each kind of row in a long run."""

_SUSPECTS_PER_PLACE = 64
"""Rows remembered for each place among the worst: an acquisition may have many."""


@dataclass(frozen=True, slots=True)
class Shown:
    """An acquisition that gets a section, with all its rows of the record."""

    acquisition: str
    rows: tuple[Measurement, ...]
    why: str = ""
    """Why it is shown; nothing for one of the first."""


@dataclass(frozen=True, slots=True)
class Overview:
    """A run at a glance: `rows` are the first ones, for the table; `shown` acquisitions get a section.

    `common` reasons stand on every measured row and are said once. `calibrated`: a number is in mm or g.
    """

    total: int
    statuses: Mapping[str, int]
    grades: Mapping[str, int]
    decisions: Mapping[str, int]
    rows: tuple[Measurement, ...]
    common: tuple[Reason, ...]
    shown: tuple[Shown, ...]
    calibrated: bool
    quantities: tuple[Quantity, ...] = ()
    causes: tuple[Cause, ...] = ()
    """quantities, causes: of a long run."""


def overview(run: Run, products_max: int, worst_max: int) -> Overview:
    """Look through the record, once; show the first `products_max` rows, and so many of the worst others.

    Of a long run, examples of each kind of row take the places of the last among the first.
    """
    statuses: Counter[str] = Counter()
    grades: Counter[str] = Counter()
    decisions: Counter[str] = Counter()
    rows: list[Measurement] = []
    first: list[Shown] = []
    suspects: list[tuple[float, int, Shown]] = []
    examples: dict[str, list[Shown]] = {}
    seen = Distributions()
    common: tuple[Reason, ...] | None = None
    finite = False
    index = 0
    for acquisition, found in groupby(run.measurements(), attrgetter("acquisition")):
        together = Shown(acquisition, tuple(found))
        for row in together.rows:
            statuses[row.status] += 1
            if row.grade is not None:
                grades[row.grade.label] += 1
            if row.decision is not None:
                decisions[row.decision.label] += 1
            if len(rows) < ROWS_MAX:
                rows.append(row)
            finite |= row.volume is not None or math.isfinite(row.height_max_mm.value)
            if row.status == "measured":
                common = (
                    row.all_reasons if common is None else tuple(r for r in common if r in row.all_reasons)
                )
            seen.add(row)
            for kind in kinds_of(row):
                if len(of_kind := examples.setdefault(kind, [])) < _EXAMPLES:
                    of_kind.append(replace(together, why=f"an example of {kind}"))
        if index < products_max:
            first.append(together)
        elif worst_max and (bad := max(map(severity, together.rows))) > 0:
            suspects.append((-bad, index, replace(together, why=FAULTY)))
            if len(suspects) > _SUSPECTS_PER_PLACE * worst_max:
                suspects = sorted(suspects)[: len(suspects) // 2]
        index += len(together.rows)
    long = index >= SHOWN_FROM
    shown = {one.acquisition: one for one in first}
    if long and index > products_max:
        chosen = {one.acquisition: one for of_kind in examples.values() for one in of_kind}
        chosen = {one.acquisition: one for one in first} | chosen
        by_kind = sorted(chosen.values(), key=lambda one: not one.why)
        shown = {one.acquisition: one for one in by_kind[:products_max]}
    worst = [one for _, _, one in sorted(suspects) if one.acquisition not in shown]
    return Overview(
        total=index,
        statuses=statuses,
        grades=grades,
        decisions=decisions,
        rows=tuple(rows),
        common=common if common and statuses["measured"] > 1 else (),
        shown=(*shown.values(), *worst[:worst_max]),
        calibrated=finite
        or any(run.provenance.get(key) is not None for key in ("calibration_sha256", "calibration")),
        quantities=seen.quantities() if long else (),
        causes=seen.causes() if long else (),
    )


FAULTY = "shown for its faults"


def severity(row: Measurement) -> float:
    """How much a row wants looking at: failed most, then the larger of ambiguous and not seen shares."""
    if row.status == "failed":
        return 2.0
    if row.status == "empty":
        return 0.0
    coding = row.coding
    ambiguous = coding.ambiguous / coding.peaks if coding is not None and coding.peaks else 0.0
    if row.volume is not None and math.isfinite(row.volume.shares.seen):
        unseen = 1.0 - row.volume.shares.seen
    elif coding is not None and coding.rows_seen + coding.rows_interpolated:
        unseen = coding.rows_interpolated / (coding.rows_seen + coding.rows_interpolated)
    else:
        unseen = 0.0
    return max(ambiguous, unseen)


_FULL_REASONS = 3
"""Sentences in a cell of the table before it is higher than its picture."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A number with its uncertainty in words; `sort` is the number itself, for sorting."""

    text: str
    std: str
    sort: float | None
    interval: str = ""
    budget: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Pill:
    """A verdict: words, a sign and a tone, so that colour is never alone."""

    words: str
    sign: str
    tone: str


def row_of(measurement: Measurement, common: Collection[Reason] = ()) -> dict[str, Any]:
    """Write a measurement for people; reasons in `common` are said elsewhere.

    The shares are `shares_of` the volume, or without one of the points. `main` reasons matter most: why the
    row failed, was sorted so, or has its grade; of the `further` ones a code is enough.
    """
    coding, volume = measurement.coding, measurement.volume
    shares, shares_of = _shares(measurement)
    reasons = [reason for reason in _by_weight(measurement) if reason not in common]
    full = _FULL_REASONS if measurement.status == "failed" else 1
    rest = [r for r in reasons[full:] if r.code not in {one.code for one in reasons[:full]}]
    known = shares is not None and math.isfinite(shares.seen + shares.interpolated + shares.assumed)
    return {
        "id": measurement.id,
        "status": status_pill(measurement.status),
        "grade": None if measurement.grade is None else grade_pill(measurement.grade.label),
        "probability": probability_of(measurement.grade),
        "decision": None if measurement.decision is None else decision_pill(measurement.decision),
        "lane": "" if measurement.decision is None else measurement.decision.lane,
        "weight": _NONE if measurement.weight is None else _figure(measurement.weight.mass_g, digits=1),
        "volume": _NONE if volume is None else _figure(volume.visible_mm3, MM3_PER_CM3),
        "true_volume": None
        if volume is None or volume.true_mm3 is None
        else _figure(volume.true_mm3, MM3_PER_CM3),
        "height": _figure(measurement.height_max_mm, digits=1),
        "displacement": _NONE
        if coding is None
        else Figure(
            plain(coding.displacement_max_px, 1), NOT_STATED, _sortable(abs(coding.displacement_max_px))
        ),
        "share_bar": None if shares is None else share_bar(shares),
        "share_words": (percent(shares.seen), percent(shares.interpolated), percent(shares.assumed))
        if shares is not None and known
        else None,
        "share_sort": _sortable(shares.seen) if shares is not None else None,
        "shares_of": shares_of,
        "stripes": "–" if coding is None else f"{coding.stripes_seen} of {coding.stripes}",
        "stripes_sort": None if coding is None else coding.stripes_seen,
        "ambiguous": "–" if coding is None else str(coding.ambiguous),
        "ambiguous_sort": None if coding is None else coding.ambiguous,
        "main": tuple(reasons[:full]),
        "further": tuple({reason.code: reason for reason in rest}.values()),
    }


def _figure(estimate: Estimate, per: float = 1.0, digits: int = 2) -> Figure:
    written = value(estimate, per, digits), uncertainty(estimate, per, digits)
    return Figure(*written, _sortable(estimate.value), interval(estimate, per), budget(estimate, per))


def probability_of(grade: Grade | None) -> str:
    """Write the probability of a grade in per cent; nothing where none is stated."""
    return "" if grade is None or math.isnan(grade.probability) else percent(grade.probability)


def status_pill(status: str) -> Pill:
    """Give the sign and tone of a status."""
    sign, tone = {"measured": ("●", "plain"), "empty": ("○", "quiet"), "failed": ("✕", "bad")}.get(
        status, ("?", "quiet")
    )
    return Pill(status, sign, tone)


def grade_pill(label: str) -> Pill:
    """Give the sign and tone of a grade; a label that is not known to be good is one to look at."""
    if label == "unknown":
        return Pill(label, "?", "quiet")
    return Pill(label, "✓", "good") if label.lower() in _GOOD else Pill(label, "!", "warn")


def lane_pill(label: str) -> Pill:
    """Give the sign and tone of a class of the buyer's, or of what was left undecided."""
    return Pill(label, "?", "warn") if label == "undecided" else Pill(label, "▸", "plain")


def decision_pill(decision: Decision) -> Pill:
    """Give the sign and tone of a decision: a class is a class; one that is left open is to look at."""
    if decision.label == "undecided":
        possible = " or ".join(decision.possible) or "fits no class"
        return Pill(f"undecided: {possible}", "?", "warn")
    return lane_pill(decision.label)


_GOOD = frozenset({"good", "ok", "pass", "accept", "accepted", "normal"})
_NONE = Figure("–", "", None)


def _by_weight(measurement: Measurement) -> tuple[Reason, ...]:
    """Give the reasons: what is missing, why it is sorted so, those of its grade, the rest; each once."""
    grade = () if measurement.grade is None else measurement.grade.reasons
    failed = tuple(r for r in measurement.reasons if r in measurement.absent.values())
    if measurement.status == "failed" and not failed:
        failed = tuple(measurement.absent.values())
    return tuple(dict.fromkeys((*failed, *_deciding(measurement), *grade, *measurement.all_reasons)))


def _deciding(measurement: Measurement) -> tuple[Reason, ...]:
    """Give what a decision says of its first possible class; where it is silent, of the last asked about."""
    decision = measurement.decision
    if decision is None or not decision.possible:
        return ()
    own = [reason for reason in decision.reasons if reason.text.startswith(f"{decision.possible[0]}: ")]
    return tuple(own[:1]) or decision.reasons[-1:]


def _shares(measurement: Measurement) -> tuple[Shares | None, str]:
    if measurement.volume is not None:
        return measurement.volume.shares, "of the visible volume"
    coding = measurement.coding
    if coding is None or not coding.rows_seen + coding.rows_interpolated or measurement.product == 0:
        return None, ""
    seen = coding.rows_seen / (coding.rows_seen + coding.rows_interpolated)
    return Shares(seen, 1 - seen, 0.0), "of the points"


def _sortable(number: float) -> float | None:
    return number if math.isfinite(number) else None


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
"""Height of a band of the strip, in units of its view."""
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
                svg.path(f"t-{_KINDS[which]}", data, title=_told(which, begin, end, margin[begin:end]))
            )
        else:
            quiet.setdefault(_KINDS[which], []).append(data)
    body = [svg.path(f"t-{name}", "".join(data)) for name, data in quiet.items()]
    name = "Least margin of any stripe on the product" if stripe is None else f"Margin of stripe {stripe}"
    return svg.view([*body, *told], (0, 0, kind.size, _TALL), f"{name}, row by row", "strip", stretch=True)


def _told(which: int, begin: int, end: int, margin: Floats) -> str:
    where = f"row {begin}" if end == begin + 1 else f"rows {begin} to {end - 1}"
    if which == _REFUSED:
        return f"{where}: refused as ambiguous"
    if which == _NOT_STATED:
        return f"{where}: margin not stated"
    return f"{where}: margin from {plain(float(np.nanmin(margin)), 2)}"


def _notes(stripes: StripeMap) -> tuple[str, ...]:
    refused = int(np.count_nonzero(stripes.peak_stripe == AMBIGUOUS))
    peaks = "peak" if refused == 1 else "peaks"
    said = [f"{refused} {peaks} of the image refused as ambiguous"] if refused else []
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


SHOWN_FROM = 100
"""Rows from which a run is long: fewer are seen in the table."""
_BINS = 40  # of a histogram
_PARTS = 120
"""Parts of a run, one after another, whose medians a trend shows."""
_STANDING_OUT = 3
"""Products named at either end of a distribution."""
_FAR = 4.5
"""Robust standard deviations from the median beyond which a product stands out: of normal ones 7 in 10⁶."""
_MAD_TO_STD = 1.4826  # of a normal distribution
_HEIGHT, _LEFT, _FLOOR = 176.0, 52.0, 140.0  # of a drawing, px: all of it, its axis, its base line


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is drawn of one quantity."""

    name: str
    unit: str
    words: str
    histogram: Markup
    trend: Markup
    outliers: tuple[tuple[str, str], ...]
    """Id and value of products that stand out, the farthest first."""
    outlier_count: int


@dataclass(frozen=True, slots=True)
class Cause:
    """A reason that rows carry."""

    code: str
    text: str
    """As the first row says it."""
    rows: int
    failed: int
    """Of these rows, those that failed for it."""
    example: str
    """Id of the first row."""


class Distributions:
    """Takes rows one by one; `kinds_of` a row are what it can be an example of."""

    def __init__(self) -> None:
        self._values = {name: array("d") for name in _QUANTITIES}
        self._ends: dict[tuple[str, int], list[tuple[float, int, str]]] = {}
        self._rows: Counter[str] = Counter()
        self._failed: Counter[str] = Counter()
        self._first: dict[str, tuple[str, str]] = {}

    def add(self, row: Measurement) -> None:
        """Take a row."""
        for name, (_, read) in _QUANTITIES.items():
            value = read(row) if row.status == "measured" else math.nan
            values = self._values[name]
            values.append(value)
            if math.isfinite(value):
                for sign in (1, -1):
                    ends = self._ends.setdefault((name, sign), [])
                    one = (sign * value, -len(values), row.id)
                    if len(ends) < _STANDING_OUT:
                        heapq.heappush(ends, one)
                    elif one > ends[0]:
                        heapq.heapreplace(ends, one)
        reasons = row.all_reasons
        for code in dict.fromkeys(reason.code for reason in reasons):
            self._rows[code] += 1
        for reason in reasons:
            self._first.setdefault(reason.code, (reason.text, row.id))
        if row.status == "failed" and reasons:
            self._failed[reasons[0].code] += 1

    def quantities(self) -> tuple[Quantity, ...]:
        """Draw each quantity of which there are values that differ."""
        drawn = (self._quantity(name, np.array(values)) for name, values in self._values.items())
        return tuple(one for one in drawn if one is not None)

    def causes(self) -> tuple[Cause, ...]:
        """Give the reasons, those for which most rows failed first."""
        found = [Cause(code, *self._told(code), example=self._first[code][1]) for code in self._rows]
        return tuple(sorted(found, key=lambda cause: (-cause.failed, -cause.rows, cause.code)))

    def _told(self, code: str) -> tuple[str, int, int]:
        return self._first[code][0], self._rows[code], self._failed[code]

    def _quantity(self, name: str, values: Floats) -> Quantity | None:
        known = values[np.isfinite(values)]
        if len(known) < SHOWN_FROM // 2 or np.ptp(known) == 0.0:
            return None
        unit = _QUANTITIES[name][0]
        low, lower, middle, upper, high = np.quantile(known, (0.001, 0.05, 0.5, 0.95, 0.999))
        std = _MAD_TO_STD * float(np.median(np.abs(known - middle)))
        far = _FAR * std if std > 0.0 else math.inf
        ends = [(sign * value, row) for sign in (1, -1) for value, _, row in self._ends[name, sign]]
        named = sorted(
            {one for one in ends if abs(one[0] - middle) > far}, key=lambda one: -abs(one[0] - middle)
        )
        return Quantity(
            name=name,
            unit=unit,
            words=f"median {_rounded(middle)}, 5 to 95 %: {_rounded(lower)} to {_rounded(upper)} {unit}; "
            f"{counted(len(known), 'product')}",
            histogram=_histogram(known, float(low), float(high), name, unit),
            trend=_trend(values, name),
            outliers=tuple((row, _rounded(value)) for value, row in named),
            outlier_count=int(np.count_nonzero(np.abs(known - middle) > far)),
        )


def kinds_of(row: Measurement) -> tuple[str, ...]:
    """Give what a row is an example of: its verdicts, and what is said of it."""
    if row.status == "failed":
        return tuple(f"failed: {reason.code}" for reason in row.all_reasons[:1]) or ("failed",)
    if row.status == "empty":
        return ("empty",)
    kinds = [] if row.grade is None else [f"grade {row.grade.label}"]
    kinds += [] if row.decision is None else [f"decision {row.decision.label}"]
    return (*kinds, *dict.fromkeys(f"reason {reason.code}" for reason in row.all_reasons))


def _volume(row: Measurement) -> float:
    if row.volume is None:
        return math.nan
    found = row.volume.true_mm3 or row.volume.visible_mm3
    return found.value / MM3_PER_CM3


_QUANTITIES: Mapping[str, tuple[str, Callable[[Measurement], float]]] = {
    "volume": ("cm³", _volume),
    "weight": ("g", lambda row: math.nan if row.weight is None else row.weight.mass_g.value),
    "largest height": ("mm", lambda row: row.height_max_mm.value),
    "volume seen": ("%", lambda row: math.nan if row.volume is None else 100.0 * row.volume.shares.seen),
    "largest displacement": (
        "px",
        lambda row: math.nan if row.coding is None else abs(row.coding.displacement_max_px),
    ),
    "ambiguous peaks": ("", lambda row: math.nan if row.coding is None else float(row.coding.ambiguous)),
}


def _rounded(value: float) -> str:
    return plain(value, max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0)


def _histogram(known: Floats, low: float, high: float, name: str, unit: str) -> Markup:
    """Draw how many products lie where; what lies beyond the ends stands in the last bars."""
    across = Axis.over(low, high, _LEFT, svg.WIDTH - 8.0)
    counts, edges = np.histogram(np.clip(known, across.low, across.high), _BINS, (across.low, across.high))
    up = Axis(0.0, float(counts.max()), _FLOOR, 12.0)
    body = [*up.level(_LEFT, svg.WIDTH - 8.0, 3), *across.upright(12.0, _FLOOR, f"{name} {unit}".strip())]
    for count, begin, end in zip(counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        left, right, top = across(begin), across(end), up(count)
        if count:
            title = f"{_rounded(begin)} to {_rounded(end)} {unit}: {counted(count, 'product')}"
            body.append(svg.box(left + 0.5, top, right - left - 1.0, _FLOOR - top, "bar", title, "#2f6f9f"))
    return svg.picture(body, _HEIGHT, f"Histogram of {name}")


def _trend(values: Floats, name: str) -> Markup:
    """Draw the median and the middle 90 % of each part of the run, in its order."""
    parts = [part[np.isfinite(part)] for part in np.array_split(values, min(_PARTS, len(values) // 10))]
    width = len(values) / len(parts)
    told = [((n + 0.5) * width, np.quantile(p, (0.05, 0.5, 0.95))) for n, p in enumerate(parts) if len(p)]
    x, bands = np.array([at for at, _ in told]), np.array([band for _, band in told])
    across = Axis.over(0.0, float(len(values)), _LEFT, svg.WIDTH - 8.0)
    up = Axis.over(float(bands.min()), float(bands.max()), _FLOOR, 12.0)
    at = [across(one) for one in x.tolist()]
    lower, middle, upper = (np.array([up(one) for one in ends]) for ends in bands.T.tolist())
    around = [*zip(at, lower.tolist(), strict=True), *zip(at[::-1], upper[::-1].tolist(), strict=True)]
    body = [
        *up.level(_LEFT, svg.WIDTH - 8.0, 4),
        *across.upright(12.0, _FLOOR, "row of the run"),
        svg.shape(around, "", "#2f6f9f33"),
        svg.path("", svg.polyline(np.array(at), middle), fill="none", stroke="#174a70"),
    ]
    return svg.picture(
        body, _HEIGHT, f"Trend of {name}: median and middle 90 % of {len(parts)} parts of the run"
    )
