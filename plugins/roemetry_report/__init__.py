"""The report: one HTML file that shows every step."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the report sink."""
    yield StageEntry(
        kind="sink",
        name="report",
        target="roemetry_report.sink:Report",
        summary="report.html: one file, opens offline, shows every step for each product",
        reference="our own; the four panels are those of Lee et al. (2000), Figures 17–22",
    )
