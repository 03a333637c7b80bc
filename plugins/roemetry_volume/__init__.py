"""Volume from slices and from the outline, outlines, and models of what cannot be seen from above."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages: outline, volume from slices or a surface, weight."""
    yield StageEntry(
        kind="outliner",
        name="edge-contour",
        target="roemetry_volume.edge_contour:EdgeContour",
        summary="The kink in brightness around each product, by closed-contour dynamic programming",
        reference="Geiger et al. (1995), dynamic programming for deformable contours; the edge model is ours",
    )
    for name, target, summary in (
        ("slice-pchip", "SlicePchip", "Monotone cubics between tilted slices, ends by their taper"),
        ("slice-trapezoid", "SliceTrapezoid", "Trapezoids between tilted slices, ends by their taper"),
    ):
        yield StageEntry(
            kind="volume",
            name=name,
            target=f"roemetry_volume.slice_estimators:{target}",
            summary=summary,
            reference="Fritsch and Butland (1984) for the cubics; caps and tilted planes are ours",
        )
    yield StageEntry(
        kind="volume",
        name="outline-surface",
        target="roemetry_volume.outline_surface:OutlineSurface",
        summary="A surface through stripes and outline; the default where there is a plain-light image",
        reference="Duchon (1977), splines minimizing rotation-invariant semi-norms; the rim is ours",
    )
    yield StageEntry(
        kind="weigher",
        name="fitted",
        target="roemetry_volume.fitted_weight:FittedWeight",
        summary="Visible volume times a ratio that weighed samples have taught, with a prediction interval",
        reference="Hoerl and Kennard (1970), ridge regression; the features are ours",
    )
