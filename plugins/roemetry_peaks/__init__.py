"""Sub-pixel extractors with an automatic threshold."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the extractors, the simplest first."""
    yield StageEntry(
        kind="extractor",
        name="centre-of-gravity",
        target="roemetry_peaks.centre_of_gravity:CentreOfGravity",
        summary="Centre of gravity of each stripe's profile above its background",
        reference="Fisher, Naidu (1996), A comparison of algorithms for subpixel peak detection",
    )
    yield StageEntry(
        kind="extractor",
        name="maximum-likelihood",
        target="roemetry_peaks.maximum_likelihood:MaximumLikelihood",
        summary="Gaussian fit by maximum likelihood; speckle contrast estimated from the image itself",
        reference="Fisher scoring; speckle in the weights after Dorsch, Häusler, Herrmann (1994); ours",
    )
