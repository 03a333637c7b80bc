"""What the page says of one acquisition: pictures once, then each of its products."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.errors import RoemetryError
from roemetry.records import BELT, Frame, Grade, Measurement, ProductTrace, Reason, StripeMap, Trace, Volume
from roemetry.records.units import MM3_PER_CM3
from roemetry_report.arcs import arc_panel
from roemetry_report.charts import slice_chart
from roemetry_report.heights import SmallChart, displacement_charts, height_charts
from roemetry_report.panels import Panel, panels
from roemetry_report.relief import relief_panels
from roemetry_report.rows import Row, row_of
from roemetry_report.selection import Shown
from roemetry_report.solid import Solid, solid
from roemetry_report.svg import number
from roemetry_report.trust import Trust, trust
from roemetry_report.words import feature, milliseconds, percent, plain

_DIFFERS = 1e-6
"""A replay whose volume differs by more than this share does not show what was measured."""


@dataclass(frozen=True, slots=True)
class SliceRow:
    """A line of the table of slices."""

    stripe: int
    area: str
    spacing: str
    contribution: str


@dataclass(frozen=True, slots=True)
class ProductView:
    """One product's card and charts.

    Attributes
    ----------
    profile_words
        What the small charts show.
    changed
        True where the replay gives another volume than the record.
    """

    key: str
    number: int
    row: Row
    grade_reasons: tuple[Reason, ...]
    decision_reasons: tuple[Reason, ...]
    features: tuple[tuple[str, str], ...]
    reasons: tuple[Reason, ...]
    absent: Mapping[str, Reason]
    slices: tuple[SliceRow, ...]
    slice_chart: Markup | None
    arcs: Panel | None
    relief: tuple[Panel, ...]
    profiles: tuple[SmallChart, ...]
    profile_words: str
    changed: bool


@dataclass(frozen=True, slots=True)
class SectionView:
    """One acquisition.

    Attributes
    ----------
    key
        What all ids in the section begin with.
    no_pictures
        Why there are none; empty where there are.
    thumbnail
        View box of the picture as the table shows it, or empty.
    has_curves
        Whether there are curves to lay over the thumbnail.
    trust
        How sure the labels are; None where nothing is coded, or the coder does not say.
    solid
        The products in three dimensions; None without a calibration.
    """

    key: str
    acquisition: str
    worst: bool
    panels: tuple[Panel, ...]
    no_pictures: str
    products: tuple[ProductView, ...]
    coding: tuple[tuple[str, str], ...]
    seconds: tuple[tuple[str, str], ...]
    seconds_total: str
    thumbnail: str
    has_curves: bool
    trust: Trust | None
    solid: Solid | None


def section(shown: Shown, replay: Callable[[str], Trace], key: str) -> SectionView:
    """Make an acquisition's part of the page.

    Parameters
    ----------
    shown
        The acquisition and its rows of the record.
    replay
        Makes its trace again.
    key
        What the ids of the section begin with; unique in the page.
    """
    trace: Trace | None = None
    no_pictures = ""
    try:
        trace = replay(shown.acquisition)
    except RoemetryError as error:
        no_pictures = str(error)
    drawn = () if trace is None else panels(trace, key)
    if trace is not None and not drawn:
        why = next(iter(trace.absent.values()), None)
        no_pictures = why.text if why is not None else "there is no laser image"
    seconds = {} if trace is None else trace.seconds
    return SectionView(
        key=key,
        acquisition=shown.acquisition,
        worst=shown.worst,
        panels=drawn,
        no_pictures=no_pictures,
        products=tuple(_product(row, trace, f"{key}-p{row.product}", key) for row in shown.rows),
        coding=_coding(shown.rows[0]) if shown.rows else (),
        seconds=tuple((stage, milliseconds(value)) for stage, value in seconds.items()),
        seconds_total=milliseconds(sum(seconds.values())) if seconds else "",
        thumbnail="" if trace is None or trace.frame is None else _thumbnail(trace.frame, trace.stripes),
        has_curves=any(panel.letter == "d" for panel in drawn),
        trust=None if trace is None or trace.stripes is None else trust(trace.stripes),
        solid=None if trace is None or trace.profiles is None else solid(trace.profiles),
    )


def _product(row: Measurement, trace: Trace | None, key: str, section_key: str) -> ProductView:
    traced = _traced(row, trace)
    grade = row.grade
    arcs: Panel | None = None
    relief: tuple[Panel, ...] = ()
    profiles: tuple[SmallChart, ...] = ()
    words = ""
    if trace is not None and trace.stripes is not None and trace.frame is not None:
        if traced is not None and traced.grade is not None and traced.grade.marks is not None:
            arcs = arc_panel(traced.grade.marks, trace.stripes, row.product, trace.frame.size, section_key)
        if traced is not None and traced.grade is not None and traced.grade.relief is not None:
            relief = relief_panels(traced.grade.relief)
        if traced is not None:
            profiles = height_charts(traced.product.profiles, row.product)
            words = "Height Z over Y, mm, for each slice that carries the product"
        elif row.product > 0:
            profiles = displacement_charts(trace.stripes, row.product)
            words = "Displacement from the rest line over the image row, px, for each stripe on the product"
    decided = () if row.decision is None else row.decision.reasons
    said = {*row.absent.values(), *(() if grade is None else grade.reasons), *decided}
    return ProductView(
        key=key,
        number=row.product,
        row=row_of(row),
        grade_reasons=() if grade is None else grade.reasons,
        decision_reasons=decided,
        features=() if grade is None else _features(grade),
        reasons=tuple(r for r in row.all_reasons if r not in said),
        absent=row.absent,
        slices=() if row.volume is None else _slices(row.volume),
        slice_chart=None if row.volume is None else slice_chart(row.volume),
        arcs=arcs,
        relief=relief,
        profiles=profiles,
        profile_words=words,
        changed=_changed(row, traced),
    )


def _traced(row: Measurement, trace: Trace | None) -> ProductTrace | None:
    products = () if trace is None else trace.products
    return next((found for found in products if found.product.number == row.product), None)


def _changed(row: Measurement, traced: ProductTrace | None) -> bool:
    if row.volume is None or traced is None or traced.volume is None:
        return False
    then, now = row.volume.visible_mm3.value, traced.volume.visible_mm3.value
    return math.isfinite(then + now) and abs(now - then) > _DIFFERS * max(abs(then), abs(now))


def _slices(volume: Volume) -> tuple[SliceRow, ...]:
    return tuple(
        SliceRow(stripe + 1, plain(a, 1), plain(s, 2), plain(a * s / MM3_PER_CM3, 2))
        for stripe, a, s in sorted(
            zip(
                volume.slice_stripe.tolist(),
                volume.slice_area_mm2.tolist(),
                volume.slice_spacing_mm.tolist(),
                strict=True,
            )
        )
    )


def _coding(row: Measurement) -> tuple[tuple[str, str], ...]:
    coding = row.coding
    if coding is None:
        return ()
    return (
        ("stripes seen", f"{coding.stripes_seen} of {coding.stripes}"),
        ("peaks", str(coding.peaks)),
        ("coded", _of(coding.coded, coding.peaks)),
        ("ambiguous", _of(coding.ambiguous, coding.peaks)),
        ("uncoded (noise)", _of(coding.uncoded, coding.peaks)),
        ("saturated", percent(coding.saturated_share) + (" of the coded" if coding.coded else "")),
    )


def _of(part: int, whole: int) -> str:
    return f"{part} ({percent(part / whole)})" if whole else str(part)


def _thumbnail(frame: Frame, stripes: StripeMap | None) -> str:
    """View box of 4 : 3 about the products; of the whole image where there are none."""
    rows, columns = frame.size
    if stripes is None or not (stripes.product > BELT).any():
        return f"-.5 -.5 {columns} {rows}"
    stripe, row = np.nonzero(stripes.product > BELT)
    x = stripes.x_px[stripe, row]
    height = max(float(np.ptp(row)), 0.75 * float(np.ptp(x)), 0.1 * rows) * 1.15
    left = (float(x.min() + x.max()) - height * 4 / 3) / 2
    top = (float(row.min() + row.max()) - height) / 2
    return " ".join(number(value) for value in (left, top, height * 4 / 3, height))


def _features(grade: Grade) -> tuple[tuple[str, str], ...]:
    std = grade.features_std
    return tuple(feature(name, figure, std.get(name, math.nan)) for name, figure in grade.features.items())
