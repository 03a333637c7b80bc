"""The paper's Figure 16: body curves, and arrows to the centres of their arcs."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from roemetry.records import Marks, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg
from roemetry_report.curves import curves
from roemetry_report.panels import Panel
from roemetry_report.svg import Box
from roemetry_report.words import counted

_FAR_HEIGHTS = 1.5
"""An arrow longer than so many image heights is not drawn: the curve is as good as straight there."""


def arc_panel(
    marks: Marks, stripes: StripeMap, product: int, size: tuple[int, int], key: str
) -> Panel | None:
    """Draw a product's evidence over its curves, zoomed to the product; None where there is nothing to draw.

    Parameters
    ----------
    marks
        The classifier's evidence.
    stripes
        What the coder gave.
    product
        The product's number.
    size
        Rows and columns of the image.
    key
        What the ids of the section's drawings begin with: the dimmed picture lies below.
    """
    box = _zoom(marks, stripes, product, size)
    if box is None:
        return None
    length = np.hypot(*(marks.to_px - marks.from_px).T)
    known = np.isfinite(length)
    drawn = known & (length <= _FAR_HEIGHTS * size[0])
    leaving = drawn & ~_inside(marks.to_px, box)
    body = [
        Markup('<use class="dim" href="#{}-image"/>').format(key),
        curves(stripes, product=product),
        _arrows(marks, drawn & ~marks.flagged, flagged=False),
        _arrows(marks, drawn & marks.flagged, flagged=True),
    ]
    flagged = int(marks.flagged.sum())
    notes = [f"{counted(len(length), 'arrow')}, {flagged or 'none'} flagged"]
    if drawn.sum() < known.sum():
        far = int(known.sum() - drawn.sum())
        notes.append(
            f"{far} not drawn: farther away than {_FAR_HEIGHTS} image heights (almost straight there)"
        )
    if (~known).any():
        notes.append(f"{int((~known).sum())} without a place: straight there")
    if leaving.any():
        notes.append(f"{int(leaving.sum())} {'lead' if leaving.sum() > 1 else 'leads'} out of the picture")
    title = f"Body curves, an arrow to each {marks.kind}"
    label = f"Body curves of product {product} with arrows ({marks.kind}); {'; '.join(notes)}"
    return Panel("g", title, svg.picture(body, box=box, label=label, kind="screen zoomed"), tuple(notes))


def _zoom(marks: Marks, stripes: StripeMap, product: int, size: tuple[int, int]) -> Box | None:
    """Give the view: the product, and the flagged centres as far as they lie in the image, with a margin."""
    stripe, row = np.nonzero(stripes.product == product)
    if not row.size:
        return None
    points = [np.column_stack([stripes.x_px[stripe, row], row.astype(np.float64)])]
    whole = (-0.5, -0.5, float(size[1]), float(size[0]))
    points.append(marks.to_px[marks.flagged & _inside(marks.to_px, whole)])
    every = np.concatenate(points)
    margin = 0.06 * max(size)
    low = np.maximum(every.min(axis=0) - margin, -0.5)
    high = np.minimum(every.max(axis=0) + margin, (size[1] - 0.5, size[0] - 0.5))
    width, height = (high - low).tolist()
    return (float(low[0]), float(low[1]), width, height)


def _inside(points: Floats, box: Box) -> Flags:
    x, y, width, height = box
    within: Flags = (points >= (x, y)) & (points <= (x + width, y + height))
    return within[:, 0] & within[:, 1]


def _arrows(marks: Marks, which: Flags, *, flagged: bool) -> Markup:
    if not which.any():
        return Markup("")
    kind, colour = ("flagged", palette.AMBIGUOUS) if flagged else ("mark", palette.MARK)
    ends = np.stack([marks.from_px[which], marks.to_px[which]], axis=1)
    # An arrow head stands at the last point of a path only, so each arrow is a path of its own.
    paths = (Markup('<path class="c" d="{}"/>').format(svg.line(end[:, 0], end[:, 1])) for end in ends)
    return Markup('<g class="{}" stroke="{}">{}</g>').format(kind, colour, Markup("").join(paths))
