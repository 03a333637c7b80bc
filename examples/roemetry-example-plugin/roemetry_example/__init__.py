"""Centre of gravity of each run of pixels above a grey level: a plugin for roemetry."""

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stage; its class is imported only when a recipe uses it."""
    yield StageEntry(
        kind="extractor",
        name="run-centroid",
        target="roemetry_example.extractor:RunCentroid",
        summary="Centre of gravity of each run of pixels above a grey level",
        reference="our own",
    )
