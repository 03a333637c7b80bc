"""The page: everything brought together by a template."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from roemetry.io.yaml_source import dump
from roemetry.stages import Run
from roemetry_report.rows import grade_pill, row_of
from roemetry_report.section import section
from roemetry_report.selection import ROWS_MAX, overview
from roemetry_report.trust import CLASSES
from roemetry_report.words import breakable, clause, counted, milliseconds, when


def page(run: Run, products_max: int, worst_max: int) -> str:
    """Write the whole page as one text.

    Parameters
    ----------
    run
        What was measured.
    products_max
        So many products, from the first on, are shown with pictures.
    worst_max
        So many acquisitions are shown besides, the worst ones.
    """
    seen = overview(run, products_max, worst_max)
    sections = [section(shown, run.replay, f"a{i + 1}") for i, shown in enumerate(seen.shown)]
    anchors = {p.row.id: (s, p.key) for s in sections for p in s.products}
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
    return environment.get_template("report.html.j2").render(
        title=run.title,
        overview=seen,
        rows=[row_of(row, seen.common) for row in seen.rows],
        rows_max=ROWS_MAX,
        decided=any(row.decision is not None for row in seen.rows),
        sections=sections,
        anchors=anchors,
        grades=[(grade_pill(label), count) for label, count in sorted(seen.grades.items())],
        facts=_facts(run.provenance),
        date=when(run.provenance.get("finished") or run.provenance.get("started")),
        recipe=_recipe(run.provenance),
        plugins=_mapping(run.provenance, "plugins"),
        median_ms=[
            (stage, milliseconds(s)) for stage, s in _mapping(run.provenance, "seconds_median").items()
        ],
        counted=counted,
        trust_classes=CLASSES,
    )


def _facts(provenance: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Where the numbers come from: what, name, hash."""
    facts = [("roemetry", str(provenance.get("roemetry_version") or "version not recorded"), "")]
    facts.append(
        ("recipe", str(provenance.get("recipe") or "not recorded"), _hash(provenance, "recipe_sha256"))
    )
    calibration = provenance.get("calibration")
    if calibration or provenance.get("calibration_sha256"):
        facts.append(("calibration", str(calibration or ""), _hash(provenance, "calibration_sha256")))
    else:
        facts.append(("calibration", "none", ""))
    if provenance.get("started"):
        facts.append(("started", when(provenance["started"]), ""))
    if provenance.get("finished"):
        facts.append(("finished", when(provenance["finished"]), ""))
    return facts


def _hash(provenance: Mapping[str, Any], key: str) -> str:
    return str(provenance.get(key) or "")


def _recipe(provenance: Mapping[str, Any]) -> str:
    recipe = provenance.get("resolved_recipe")
    return dump(recipe) if isinstance(recipe, Mapping) and recipe else ""


def _mapping(provenance: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    given = provenance.get(key)
    return given if isinstance(given, Mapping) else {}
