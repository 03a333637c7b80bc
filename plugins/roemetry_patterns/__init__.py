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
    yield StageEntry(
        kind="coder",
        name="epipolar-dots",
        target="roemetry_patterns.epipolar_dots:EpipolarDots",
        summary="Dots by the epipolar lines of their rays, doubt resolved by the neighbours in the pattern",
        reference="Kschischang, Frey, Loeliger (2001), Factor graphs and the sum-product algorithm; ours",
    )
    yield StageEntry(
        kind="volume",
        name="dot-surface",
        target="roemetry_patterns.dot_surface:DotSurface",
        summary="A surface through scattered points and the outline, by kriging, with its own uncertainty",
        reference="Matheron (1963), Principles of geostatistics; the rim is ours",
    )
