"""Coders that say how sure they are, and aligners, which see whether the camera has moved."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the coders, from the fastest to the most careful."""
    yield StageEntry(
        kind="aligner",
        name="belt-lines",
        target="roemetry_coding.belt_lines:BeltLines",
        summary="Fits shift, roll, zoom and tilt of the camera to the belt's stripes, and corrects them",
        reference="our own; robust regression: Huber & Ronchetti 2009, chapter 7",
    )
    yield StageEntry(
        kind="aligner",
        name="belt-grid",
        target="roemetry_coding.belt_grid:BeltGrid",
        summary="The same by both families of a grid's lines",
        reference="our own",
    )
    yield StageEntry(
        kind="aligner",
        name="belt-dots",
        target="roemetry_coding.belt_dots:BeltDots",
        summary="The same by dots on the belt",
        reference="our own",
    )
    yield StageEntry(
        kind="aligner",
        name="belt-circles",
        target="roemetry_coding.belt_circles:BeltCircles",
        summary="The same by circles on the belt",
        reference="our own",
    )
    yield StageEntry(
        kind="coder",
        name="ordered",
        target="roemetry_coding.ordered:Ordered",
        summary="Each row's peaks in order, with stripes missing and peaks too many allowed for",
        reference="our own",
    )
    yield StageEntry(
        kind="coder",
        name="planes",
        target="roemetry_coding.planes:Planes",
        summary="The labels that make a surface this camera would see like this; refuses doubt",
        reference="our own",
    )
    yield StageEntry(
        kind="coder",
        name="single",
        target="roemetry_coding.single:Single",
        summary="One line, followed through all rows, on a belt or without one",
        reference="our own; dynamic programming: Bellman 1957",
    )
    yield StageEntry(
        kind="coder",
        name="pieces",
        target="roemetry_coding.pieces:Pieces",
        summary="Without a calibration: joins broken stripes and counts them where order and direction agree",
        reference="our own",
    )
    yield StageEntry(
        kind="coder",
        name="two-families",
        target="roemetry_coding.two_families:TwoFamilies",
        summary="Lines of two colours, each family by its planes, both by the surface they share",
        reference="our own",
    )
    yield StageEntry(
        kind="coder",
        name="circle-order",
        target="roemetry_coding.circles:CircleOrder",
        summary="Halves of circles by their cones, their order and the surface's continuity",
        reference="Kschischang, Frey, Loeliger (2001), IEEE Trans. Inf. Theory 47:498; costs are ours",
    )
    yield StageEntry(
        kind="coder",
        name="grid-planes",
        target="roemetry_coding.grid:GridPlanes",
        summary="Both families of a grid by their planes, confirmed or refused by heights where they cross",
        reference="Salvi, Pagès, Batlle (2004), Pattern Recognition 37:827; ours",
    )
