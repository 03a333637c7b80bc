"""Scans of a moving belt: lines placed by encoder counts, height maps of any sensor, two sides."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, VerbEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages."""
    for kind, name, target, summary, reference in (
        ("source", "belt-scan", "scan_source:BeltScan",
         "The lines of belt scans: folders of frames, tall images or videos, with encoder counts", "our own"),
        ("source", "height-files", "height_files:HeightMaps",
         "Height maps and point clouds of other sensors: TIFF, PNG, CSV, PLY, PCD, LAS, LAZ, X3P, Coord3D",
         "ISO 25178-72 (X3P), ASPRS LAS 1.4, GenICam SFNC"),
        ("assembler", "belt-motion", "placing:BeltMotion",
         "Places lines by encoder counts and the calibrated motion, fits the belt, numbers the products",
         "Fischler and Bolles (1981) for the belt; our own"),
        ("volume", "dense-slices", "dense:DenseSlices",
         "Areas of dense slices times the pitch perpendicular to the light, with motion in the budget",
         "our own"),
        ("sink", "slices", "height_files:SliceFiles",
         "slices/<acquisition>.<format>: PLY, PCD, LAS, CSV, TIFF, PNG, NPY or X3P of belt and products",
         "our own"),
    ):  # fmt: skip
        yield StageEntry(kind, name, f"roemetry_scan.{target}", summary, reference=reference)


@hookimpl
def roemetry_verbs() -> Iterable[VerbEntry]:
    """Name the commands."""
    for name, function, summary in (
        ("register-heads", "register_heads", "Register two heads to each other by a plate that both see."),
        ("two-sides", "two_sides", "Measure true volumes of products seen from above and below."),
        ("side-by-side", "side_by_side", "Join the scans of heads side by side over a wide belt."),
    ):
        yield VerbEntry(name, f"roemetry_scan.commands:{function}", summary)
