"""A measurement as people read it: what the summary table and a product's card say."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

from markupsafe import Markup

from roemetry.records import Decision, Estimate, Grade, Measurement, Reason, Shares
from roemetry.records.units import MM3_PER_CM3, NOT_STATED
from roemetry_report.charts import share_bar
from roemetry_report.words import budget, interval, percent, plain, uncertainty, value

_FULL_REASONS = 3


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


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement in words.

    Attributes
    ----------
    shares_of
        What the shares are shares of: the volume, or (without one) the points.
    main
        What matters most for this row: why it failed, or the first reason of its grade.
    further
        The other reasons, for which a code is enough.
    """

    id: str
    status: Pill
    grade: Pill | None
    probability: str
    decision: Pill | None
    lane: str
    weight: Figure
    volume: Figure
    true_volume: Figure | None
    height: Figure
    displacement: Figure
    share_bar: Markup | None
    share_words: tuple[str, str, str] | None
    share_sort: float | None
    shares_of: str
    stripes: str
    stripes_sort: int | None
    ambiguous: str
    ambiguous_sort: int | None
    main: tuple[Reason, ...]
    further: tuple[Reason, ...]


def row_of(measurement: Measurement, common: Collection[Reason] = ()) -> Row:
    """Write a measurement for people; reasons in `common` are said elsewhere."""
    coding, volume = measurement.coding, measurement.volume
    shares, shares_of = _shares(measurement)
    reasons = [reason for reason in _by_weight(measurement) if reason not in common]
    known = shares is not None and math.isfinite(shares.seen + shares.interpolated + shares.assumed)
    return Row(
        id=measurement.id,
        status=status_pill(measurement.status),
        grade=None if measurement.grade is None else grade_pill(measurement.grade.label),
        probability=probability_of(measurement.grade),
        decision=None if measurement.decision is None else decision_pill(measurement.decision),
        lane="" if measurement.decision is None else measurement.decision.lane,
        weight=_NONE if measurement.weight is None else _figure(measurement.weight.mass_g, digits=1),
        volume=_NONE if volume is None else _figure(volume.visible_mm3, MM3_PER_CM3),
        true_volume=None
        if volume is None or volume.true_mm3 is None
        else _figure(volume.true_mm3, MM3_PER_CM3),
        height=_figure(measurement.height_max_mm, digits=1),
        displacement=_NONE
        if coding is None
        else Figure(
            plain(coding.displacement_max_px, 1), NOT_STATED, _sortable(abs(coding.displacement_max_px))
        ),
        share_bar=None if shares is None else share_bar(shares),
        share_words=(percent(shares.seen), percent(shares.interpolated), percent(shares.assumed))
        if shares is not None and known
        else None,
        share_sort=_sortable(shares.seen) if shares is not None else None,
        shares_of=shares_of,
        stripes="–" if coding is None else f"{coding.stripes_seen} of {coding.stripes}",
        stripes_sort=None if coding is None else coding.stripes_seen,
        ambiguous="–" if coding is None else str(coding.ambiguous),
        ambiguous_sort=None if coding is None else coding.ambiguous,
        main=tuple(reasons[:1] if measurement.status != "failed" else reasons[:_FULL_REASONS]),
        further=tuple(reasons[1 if measurement.status != "failed" else _FULL_REASONS :]),
    )


def _figure(estimate: Estimate, per: float = 1.0, digits: int = 2) -> Figure:
    return Figure(
        value(estimate, per, digits),
        uncertainty(estimate, per, digits),
        _sortable(estimate.value),
        interval(estimate, per),
        budget(estimate, per),
    )


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


def decision_pill(decision: Decision) -> Pill:
    """Give the sign and tone of a decision: a class is a class; one that is left open is to look at."""
    if decision.label == "undecided":
        possible = " or ".join(decision.possible) or "fits no class"
        return Pill(f"undecided: {possible}", "?", "warn")
    return Pill(decision.label, "▸", "plain")


_GOOD = frozenset({"good", "ok", "pass", "accept", "accepted", "normal"})
_NONE = Figure("–", "", None)


def _by_weight(measurement: Measurement) -> tuple[Reason, ...]:
    """Give the reasons with what is missing first, then the grade's, then the rest; each once."""
    grade = () if measurement.grade is None else measurement.grade.reasons
    failed = tuple(r for r in measurement.reasons if r in measurement.absent.values())
    if measurement.status == "failed" and not failed:
        failed = tuple(measurement.absent.values())
    return tuple(dict.fromkeys((*failed, *grade, *measurement.all_reasons)))


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
