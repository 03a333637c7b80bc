"""The sink `report`: the pictures of each acquisition once, then each of its products, as one page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import Field

from roemetry.errors import RoemetryError
from roemetry.html.plots import number, plain, when
from roemetry.io.files import write_whole
from roemetry.io.yaml_source import dump
from roemetry.records import BELT, Frame, Grade, Measurement, ProductTrace, StripeMap, Trace, Volume
from roemetry.records.units import MM3_PER_CM3
from roemetry.stages import Run, Sink, StageOptions
from roemetry_report.charts import SmallChart, displacement_charts, height_charts, slice_chart
from roemetry_report.overview import (
    CLASSES,
    FAULTY,
    ROWS_MAX,
    Overview,
    Pill,
    Shown,
    grade_pill,
    lane_pill,
    overview,
    row_of,
    trust,
)
from roemetry_report.panels import Panel, arc_panel, height_panels, panels, picture_of
from roemetry_report.relief import relief_panels
from roemetry_report.solid import solid
from roemetry_report.words import breakable, clause, counted, feature, marked, milliseconds, percent


class ReportOptions(StageOptions):
    """Options of the report."""

    products_max: int = Field(
        50, ge=0, le=500, description="Products shown with pictures, from the first on (number)."
    )
    worst_max: int = Field(
        10,
        ge=0,
        le=500,
        description="Acquisitions shown besides: failed, most ambiguous or least seen ones (number).",
    )


class Report(Sink[ReportOptions]):
    """Writes ``report.html``: one file that opens offline and shows every step for each product.

    The panels of a product are those of Lee et al. (2000), Figures 16 to 22. Figures come from the run's
    record, pictures from replaying the acquisition; where that is not possible the section says why.
    """

    @property
    def replays_first(self) -> int:
        """As many acquisitions as products: most show one."""
        return self.options.products_max

    def write(self, run: Run) -> Sequence[Path]:
        """Write the page and give its path.

        Raises
        ------
        OutputError
            The folder cannot be written or the disk is full.
        """
        path = run.folder / "report.html"
        write_whole(path, page(run, self.options.products_max, self.options.worst_max))
        return (path,)


def page(run: Run, products_max: int, worst_max: int) -> str:
    """Write the whole page as one text, options as of `ReportOptions`."""
    seen = overview(run, products_max, worst_max)
    sections = [section(shown, run.replay, f"a{i + 1}") for i, shown in enumerate(seen.shown)]
    while len(text := _rendered(run, seen, sections)) > _PAGE_MAX and sections:
        # the mean overestimates a section, so what is too much may take another round
        too_many = math.ceil((len(text) - _PAGE_MAX) / (len(text) / len(sections)))
        plain_ones = [one for one in sections if not one["why"]]
        gone = [*plain_ones[::-1], *[one for one in sections[::-1] if one["why"]]][:too_many]
        sections = [one for one in sections if not any(one is other for other in gone)]
    return text


_PAGE_MAX = 14_000_000
"""Letters of a page: 15 MB are still sent by mail, and opened on a telephone."""


def _rendered(run: Run, seen: Overview, sections: list[dict[str, Any]]) -> str:
    anchors = {p["row"]["id"]: (s, p["key"]) for s in sections for p in s["products"]}
    # Not autoescape=select_autoescape(): the template's name ends in j2, and everything here is HTML.
    environment = Environment(
        loader=PackageLoader("roemetry_report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = breakable
    environment.filters["clause"] = clause
    environment.filters["marked"] = marked
    rows = [row_of(row, seen.common) for row in seen.rows]
    return environment.get_template("report.html.j2").render(
        title=run.title,
        overview=seen,
        rows=rows,
        rows_max=ROWS_MAX,
        # a column that no row fills is left out
        pictured=any(s["thumbnail"] for s, _ in anchors.values()),
        decided=any(row.decision is not None for row in seen.rows),
        graded=bool(seen.grades),
        weighed=any(row.weight is not None for row in seen.rows),
        coded=any(row.coding is not None for row in seen.rows),
        reasoned=any(row["main"] for row in rows),
        sections=sections,
        anchors=anchors,
        verdicts=_verdicts(seen),
        counts=_counts(seen),
        drift=run.provenance.get("drift") or "",
        facts=_facts(run.provenance),
        date=when(run.provenance.get("finished") or run.provenance.get("started")),
        recipe=_recipe(run.provenance),
        plugins=_mapping(run.provenance, "plugins"),
        median_ms=[
            (stage, milliseconds(s)) for stage, s in _mapping(run.provenance, "seconds_median").items()
        ],
        counted=counted,
        trust_classes=CLASSES,
        faulty=FAULTY,
        folder=run.folder.name,
    )


def _verdicts(seen: Overview) -> list[tuple[Pill, int]]:
    """Give the decisions, or where nothing was decided the grades, each with its number, good ones first."""
    labels = seen.decisions or seen.grades
    pill = lane_pill if seen.decisions else grade_pill
    order = {"good": 0, "plain": 1, "warn": 2, "quiet": 3}
    found = [(pill(label), count) for label, count in labels.items()]
    return sorted(found, key=lambda one: (order[one[0].tone], -one[1], one[0].words))


def _counts(seen: Overview) -> str:
    """Say how the run went, in one line."""
    counts = seen.statuses
    said = [f"{counts.get('measured', 0)} measured"]
    said += [f"{counts['failed']} failed"] if counts.get("failed") else []
    said += [f"{counts['empty']} empty (no product)"] if counts.get("empty") else []
    return ", ".join(said) + ("; calibrated" if seen.calibrated else "; uncalibrated: results are in pixels")


def _facts(provenance: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Where the numbers come from: what, name, hash."""

    def given(key: str, otherwise: str = "") -> str:
        return str(provenance.get(key) or otherwise)

    hashed = given("calibration_sha256")
    return [
        ("roemetry", given("roemetry_version", "version not recorded"), ""),
        ("recipe", given("recipe", "not recorded"), given("recipe_sha256")),
        ("calibration", given("calibration", "" if hashed else "none"), hashed),
        *((name, when(provenance[name]), "") for name in ("started", "finished") if provenance.get(name)),
    ]


def _recipe(provenance: Mapping[str, Any]) -> str:
    recipe = provenance.get("resolved_recipe")
    return dump(recipe) if isinstance(recipe, Mapping) and recipe else ""


def _mapping(provenance: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    given = provenance.get(key)
    return given if isinstance(given, Mapping) else {}


_DIFFERS = 1e-6
"""A replay whose volume differs by more than this share does not show what was measured."""


def section(shown: Shown, replay: Callable[[str], Trace], key: str) -> dict[str, Any]:
    """Gather what the template says of an acquisition, from its rows and its trace made again.

    All ids in the section begin with `key`. `thumbnail` is the view box of the picture in the table.
    """
    trace: Trace | None = None
    no_pictures = ""
    try:
        trace = replay(shown.acquisition)
    except RoemetryError as error:
        no_pictures = str(error)
    drawn = () if trace is None else panels(trace, key)
    is_scan = trace is not None and trace.frame is None and trace.profiles is not None
    if is_scan and trace is not None and trace.profiles is not None:
        drawn = height_panels(trace.profiles, key)
    if trace is not None and not drawn:
        why = next(iter(trace.absent.values()), None)
        no_pictures = why.text if why is not None else "there is no laser image"
    seconds = {} if trace is None else {k: v for k, v in trace.seconds.items() if k != "uncertainty"}
    margins = None if trace is None or trace.stripes is None else trust(trace.stripes)
    body = None
    if trace is not None and trace.profiles is not None:
        body = solid(trace.profiles, trace.products, picture_of(trace))
    letters = _lettered(ascii_lowercase[len(drawn) :], solid=body, trust=margins)
    first = len(drawn) + len(letters)
    return {
        "key": key,
        "acquisition": shown.acquisition,
        "why": shown.why,
        "is_first": key == "a1" and shown.why != FAULTY,
        "panels": drawn,
        "is_scan": is_scan,
        "no_pictures": no_pictures,
        "letters": letters,
        "products": tuple(
            _product(row, trace, f"{key}-p{row.product}", key, ascii_lowercase[first:]) for row in shown.rows
        ),
        "coding": _coding(shown.rows[0]) if shown.rows else (),
        "seconds": tuple((stage, milliseconds(value)) for stage, value in seconds.items()),
        "seconds_total": milliseconds(sum(seconds.values())) if seconds else "",
        "thumbnail": "" if trace is None or trace.frame is None else _thumbnail(trace.frame, trace.stripes),
        "view_box": "" if trace is None or trace.frame is None else _whole(trace.frame),
        "has_curves": any(panel.letter == "d" for panel in drawn),
        "trust": margins,
        "solid": body,
    }


def _lettered(letters: str, **pictures: object) -> dict[str, str]:
    """Give the next letter to each picture that there is, so that no reader looks for one that is missing."""
    return dict(zip((name for name, picture in pictures.items() if picture), letters, strict=False))


def _product(row: Measurement, trace: Trace | None, key: str, section_key: str, free: str) -> dict[str, Any]:
    """Gather what the template says of a product; its pictures have the letters that are `free`."""
    traced = _traced(row, trace)
    grade = row.grade
    arcs: Panel | None = None
    relief: tuple[Panel, ...] = ()
    profiles: tuple[SmallChart, ...] = ()
    words = ""
    if trace is not None and trace.stripes is not None and trace.frame is not None:
        if traced is not None and traced.grade is not None and traced.grade.arrows is not None:
            arcs = arc_panel(traced.grade.arrows, trace.stripes, row.product, trace.frame.size, section_key)
        if traced is not None and traced.grade is not None and traced.grade.relief is not None:
            relief = relief_panels(traced.grade.relief)
        if traced is not None:
            profiles = height_charts(traced.product.profiles, row.product)
            words = "Height Z along each slice that carries the product, mm"
        elif row.product > 0:
            profiles = displacement_charts(trace.stripes, row.product)
            words = "Displacement from the rest line over the image row, px, for each stripe on the product"
    bars = None
    if row.volume is not None:
        bars = slice_chart(row.volume, "stripe" if trace is None or trace.frame is not None else "line")
    letters = _lettered(free, arcs=arcs, slices=bars, profiles=profiles)
    arcs = None if arcs is None else replace(arcs, letter=letters["arcs"])
    last = free[len(letters) :][: len(relief)]
    relief = tuple(replace(panel, letter=letter) for panel, letter in zip(relief, last, strict=True))
    decided = () if row.decision is None else row.decision.reasons
    said = {*row.absent.values(), *(() if grade is None else grade.reasons), *decided}
    return {
        "key": key,
        "number": row.product,
        "row": row_of(row),
        "grade_reasons": () if grade is None else grade.reasons,
        "decision_reasons": decided,
        "features": () if grade is None else _features(grade),
        "reasons": tuple(r for r in row.all_reasons if r not in said),
        "absent": row.absent,
        "slices": () if row.volume is None else _slices(row.volume),
        "letters": letters,
        "slice_chart": bars,
        "arcs": arcs,
        "relief": relief,
        "profiles": profiles,
        "profile_words": words,
        "changed": _changed(row, traced),
    }


def _traced(row: Measurement, trace: Trace | None) -> ProductTrace | None:
    products = () if trace is None else trace.products
    return next((found for found in products if found.product.number == row.product), None)


def _changed(row: Measurement, traced: ProductTrace | None) -> bool:
    if row.volume is None or traced is None or traced.volume is None:
        return False
    then, now = row.volume.visible_mm3.value, traced.volume.visible_mm3.value
    return math.isfinite(then + now) and abs(now - then) > _DIFFERS * max(abs(then), abs(now))


def _slices(volume: Volume) -> tuple[dict[str, Any], ...]:
    columns = (volume.slice_stripe, volume.slice_area_mm2, volume.slice_spacing_mm)
    return tuple(
        {
            "stripe": stripe + 1,
            "area": plain(a, 1),
            "spacing": plain(s, 2),
            "contribution": plain(a * s / MM3_PER_CM3, 2),
        }
        for stripe, a, s in sorted(zip(*(column.tolist() for column in columns), strict=True))
    )


def _coding(row: Measurement) -> tuple[tuple[str, str], ...]:
    coding = row.coding
    if coding is None:
        return ()
    return (
        ("stripes seen", f"{coding.stripes_seen} of {coding.stripes}"),
        ("peaks", str(coding.peaks)),
        ("labelled", _of(coding.labelled, coding.peaks)),
        ("ambiguous, on the product" if row.product else "ambiguous", _of(coding.ambiguous, coding.peaks)),
        ("unlabelled (noise)", _of(coding.unlabelled, coding.peaks)),
        ("saturated", percent(coding.saturated_share) + (" of the labelled" if coding.labelled else "")),
    )


def _of(part: int, whole: int) -> str:
    return f"{part} ({percent(part / whole)})" if whole else str(part)


def _whole(frame: Frame) -> str:
    rows, columns = frame.size
    return f"-.5 -.5 {columns} {rows}"


def _thumbnail(frame: Frame, stripes: StripeMap | None) -> str:
    """View box of 4 : 3 about the products; of the whole image where there are none."""
    if stripes is None or not (stripes.product > BELT).any():
        return _whole(frame)
    rows, _ = frame.size
    stripe, row = np.nonzero(stripes.product > BELT)
    x = stripes.x_px[stripe, row]
    height = max(float(np.ptp(row)), 0.75 * float(np.ptp(x)), 0.1 * rows) * 1.15
    left = (float(x.min() + x.max()) - height * 4 / 3) / 2
    top = (float(row.min() + row.max()) - height) / 2
    return " ".join(number(value) for value in (left, top, height * 4 / 3, height))


def _features(grade: Grade) -> tuple[tuple[str, str], ...]:
    std = grade.features_std
    return tuple(feature(name, figure, std.get(name, math.nan)) for name, figure in grade.features.items())
