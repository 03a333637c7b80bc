"""Patterns of light that are no lines: dots, from their centres to a product's volume."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages, in the order of the chain."""
    yield StageEntry(
        kind="extractor",
        name="dots",
        target="roemetry_patterns.dot_centres:DotCentres",
        summary="Centres of dots by maximum likelihood, with their covariance",
        reference="Fisher scoring (Rao 1973); speckle in the covariance is ours",
    )
