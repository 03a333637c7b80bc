"""When an outline is not to be believed, or not to be used."""

from __future__ import annotations

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Reason
from roemetry_volume.fusing import Fused
from roemetry_volume.slice_table import Slices

_EDGE_PX = 1.0
_SOME = 0.1  # of the usual width: less of a slice is no outer one
_OUTSIDE_MM = 1.0
_OUTSIDE_SHARE = 0.03
_SHORT_MM = (
    1.0  # the nearer half of the ends lies within 0.4 mm of a true outline, on skeins and on other bodies
)


def outline_fault(product: Product, slices: Slices, fused: Fused | None = None) -> Reason | None:
    """Say why a product's volume has to do without its outline; None where it need not.

    Parameters
    ----------
    product, slices
        The product and its slices.
    fused
        What came of the outline; without it only what can be said beforehand is.

    Raises
    ------
    StageError
        The outline reaches the image's edge.
    """
    from roemetry_kernels.volume.slice_areas import HOLE

    outline, view = product.outline, product.view
    if outline is None:
        return Reason("no-outline", "no outline was found: the volume is that of the slices alone")
    if view is None:
        return Reason(
            "no-view",
            "the calibration does not say where the camera stands, so the outline cannot be placed on the "
            "belt: the volume is that of the slices alone",
        )
    rows, columns = product.calibration.image_size
    xy = outline.xy_px
    edge = (xy < _EDGE_PX - 0.5) | (xy > np.array([columns, rows]) - 0.5 - _EDGE_PX)
    if edge.any():
        raise StageError(
            "the product's outline reaches the image's edge: a part is not seen",
            hint="place it within the image",
        )
    # outer slices may cut an end wall, of which only the two edges are seen
    some = np.flatnonzero(slices.width_mm > _SOME * float(np.median(slices.width_mm)))
    if (slices.table[some[0] + 1 : some[-1], HOLE] > 0.0).any():
        return Reason(
            "outline-not-used",
            "slices have a hole that an outline does not show: the volume is that of the slices alone",
        )
    return None if fused is None else _disagreement(fused)


def _disagreement(fused: Fused) -> Reason | None:
    """Compare the stripes' points and ends with the border."""
    from roemetry_kernels.volume.footprint import inside_by

    inside = inside_by(fused.contour[::4], fused.place[::3])
    outside = float((inside < -_OUTSIDE_MM).mean())
    ends = np.concatenate([fused.points.first[:-1], fused.points.first[1:] - 1])
    # the farther half may lie in the shadow
    nearer = np.sort(inside_by(fused.contour[::4], fused.place[ends]))[: (ends.size + 1) // 2]
    short = float(np.median(nearer))
    if outside <= _OUTSIDE_SHARE and short <= _SHORT_MM:
        return None
    what = (
        f"{outside:.0%} of the stripes' points lie outside it"
        if outside > _OUTSIDE_SHARE
        else f"the stripes end {short:.1f} mm inside it"
    )
    return Reason(
        "outline-disagrees",
        f"the outline is not that of what the stripes show: {what}; the volume is that of the slices alone",
    )
