"""Volume from slices and from the outline, outlines, and models of what cannot be seen from above."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl

_SLICES = "Davis and Rabinowitz (1984), Methods of Numerical Integration; caps and tilted planes are ours"


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages: outline, slice estimators from the plainest on, surface."""
    yield StageEntry(
        kind="outliner",
        name="edge-contour",
        target="roemetry_volume.edge_contour:EdgeContour",
        summary="The kink in brightness around each product, by closed-contour dynamic programming",
        reference="Geiger et al. (1995), dynamic programming for deformable contours; the edge model is ours",
    )
    for name, target, summary in (
        (
            "slice-sum",
            "SliceSum",
            "Spacing times area over tilted slices, each held half the way to the next",
        ),
        ("slice-trapezoid", "SliceTrapezoid", "Trapezoids between tilted slices, ends by their taper"),
        ("slice-simpson", "SliceSimpson", "Simpson's rule over tilted slices, ends by their taper"),
        ("slice-pchip", "SlicePchip", "Monotone cubics between tilted slices, ends by their taper"),
        ("slice-spline", "SliceSpline", "A cubic spline through tilted slices, ends by their taper"),
    ):
        yield StageEntry(
            kind="volume",
            name=name,
            target=f"roemetry_volume.slice_estimators:{target}",
            summary=summary,
            reference=_SLICES,
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
