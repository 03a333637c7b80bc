"""The paper's four pictures of a sample (Figures 17–22): image, peaks, coded peaks on the image, curves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.records import AMBIGUOUS, UNCODED, Outline, Peaks, StripeMap, Trace
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg
from roemetry_report.base_image import BaseImage, base_image
from roemetry_report.curves import curves, row_step

_DOTS_MAX = 7500
_MARKS_MAX = 1500


@dataclass(frozen=True, slots=True)
class Panel:
    """A picture with its letter, what it shows, and what a reader must know about the drawing of it."""

    letter: str
    title: str
    drawing: Markup
    notes: tuple[str, ...] = ()


def panels(trace: Trace, key: str) -> tuple[Panel, ...]:
    """Draw what there is of a trace.

    Parameters
    ----------
    trace
        An acquisition's way through the stages.
    key
        What the ids of the drawings begin with; unique in the page. The picture is ``<key>-image``: it
        stands in the page once and is used wherever it is needed.
    """
    base = base_image(trace)
    if base is None:
        return ()
    given = [_original(base, key)]
    if trace.peaks is not None:
        given.append(_dominant(base, trace.peaks, key))
        given.append(_superimposed(base, trace, key))
    if trace.peaks is not None and trace.stripes is not None:
        given.append(_connected(base, trace.peaks, trace.stripes, trace.outlines, key))
    return tuple(given)


def view(rows: int, columns: int) -> svg.Box:
    """View of a whole image: its pixels' centres are whole numbers."""
    return (-0.5, -0.5, float(columns), float(rows))


def _original(base: BaseImage, key: str) -> Panel:
    image = Markup(
        '<image id="{}-image" href="{}" x="-.5" y="-.5" width="{}" height="{}" preserveAspectRatio="none"/>'
    ).format(key, base.uri, base.columns, base.rows)
    label = f"Camera image, {base.columns} by {base.rows} pixels"
    return Panel("a", "Original image", _screen(base, [image], label), base.notes)


def _dominant(base: BaseImage, peaks: Peaks, key: str) -> Panel:
    step = max(1, -(-len(peaks) // _DOTS_MAX))
    drawn = peaks.row % step == 0
    order = np.lexsort((peaks.row[drawn], _column_of(peaks)[drawn]))
    x, y = peaks.x_px[drawn][order], peaks.row[drawn][order].astype(np.float64)
    body = Markup('<path id="{}-peaks" class="c c-dot" stroke="{}" d="{}"/>').format(
        key, palette.PEAK, svg.dots(x, y)
    )
    label = f"{len(peaks)} peaks as dots on black"
    return Panel("b", "Peaks", _screen(base, [body], label), (f"{len(peaks)} peaks", *_thinned(step)))


def _superimposed(base: BaseImage, trace: Trace, key: str) -> Panel:
    over = "peaks" if trace.stripes is None else "curves"
    body = [
        Markup('<use href="#{}-image"/>').format(key),
        Markup('<g class="over"><use href="#{}-{}"/></g>').format(key, over),
    ]
    title = "Coded peaks on the image" if trace.stripes is not None else "Peaks on the image"
    return Panel("c", title, _screen(base, body, title))


def _connected(
    base: BaseImage, peaks: Peaks, stripes: StripeMap, outlines: tuple[Outline, ...], key: str
) -> Panel:
    ambiguous, uncoded = stripes.peak_stripe == AMBIGUOUS, stripes.peak_stripe == UNCODED
    arm = max(base.columns, base.rows) / 220
    body = [
        Markup('<g id="{}-curves">{}</g>').format(key, curves(stripes)),
        *_outlines(outlines),
        *_marks(peaks, uncoded, "uncoded", svg.crosses, arm),
        *_marks(peaks, ambiguous, "ambiguous", svg.diamonds, 1.4 * arm),
        *_numbers(stripes, base),
        *_product_numbers(stripes, base),
    ]
    label = (
        f"Curves of {stripes.stripe_count} stripes after connection; {int(ambiguous.sum())} ambiguous and "
        f"{int(uncoded.sum())} uncoded peaks"
    )
    notes = _thinned(row_step(stripes))
    if max(ambiguous.sum(), uncoded.sum()) > _MARKS_MAX:
        notes = (*notes, "not every ambiguous or uncoded peak is drawn: they are too many")
    return Panel("d", "Curves after connection", _screen(base, body, label), notes)


def _screen(base: BaseImage, body: Iterable[Markup], label: str) -> Markup:
    return svg.picture(body, box=view(base.rows, base.columns), label=label, kind="screen")


def _marks(peaks: Peaks, which: Flags, kind: str, shape: object, arm: float) -> list[Markup]:
    chosen = np.flatnonzero(which)
    if not chosen.size or not callable(shape):
        return []
    chosen = chosen[:: -(-chosen.size // _MARKS_MAX)]
    data = shape(peaks.x_px[chosen], peaks.row[chosen].astype(np.float64), arm)
    colour = palette.AMBIGUOUS if kind == "ambiguous" else palette.UNCODED
    return [Markup('<path class="c c-{}" stroke="{}" d="{}"/>').format(kind, colour, data)]


def _outlines(outlines: Iterable[Outline]) -> list[Markup]:
    return [
        Markup('<path class="c c-outline" stroke="{}" d="{}z"/>').format(
            palette.OUTLINE, svg.line(outline.xy_px[:, 0], outline.xy_px[:, 1])
        )
        for outline in outlines
        if len(outline.xy_px) > 2
    ]


def _numbers(stripes: StripeMap, base: BaseImage) -> list[Markup]:
    """Write each stripe's number (from 1) at its top; where they would touch, only every n-th."""
    size = max(base.columns, base.rows) / 40
    tops = [_top(stripes.x_px[i]) for i in range(stripes.stripe_count)]
    where = np.array([x for x, _ in filter(None, tops)])
    apart = float(np.median(np.abs(np.diff(where)))) if where.size > 1 else np.inf
    step = max(1, int(np.ceil(1.3 * size / max(apart, 1e-3)))) if where.size > 1 else 1
    return [
        Markup('<text class="number" x="{}" y="{}" font-size="{}" fill="{}">{}</text>').format(
            svg.number(min(max(top[0], size * 0.7), base.columns - size * 0.7)),
            svg.number(min(max(top[1], 0) + size, base.rows - 2.0)),
            svg.number(size),
            palette.stripe_colour(index),
            index + 1,
        )
        for index, top in enumerate(tops)
        if top is not None and index % step == 0
    ]


def _product_numbers(stripes: StripeMap, base: BaseImage) -> list[Markup]:
    """Where there are several products, say which is which."""
    found = [int(n) for n in np.unique(stripes.product) if n > 0]
    if len(found) < 2:
        return []
    size = max(base.columns, base.rows) / 26
    parts = []
    for product in found:
        mine = stripes.product == product
        x, y = float(np.median(stripes.x_px[mine])), float(np.median(np.nonzero(mine)[1]))
        parts.append(
            Markup('<text class="product" x="{}" y="{}" font-size="{}">{}</text>').format(
                svg.number(x), svg.number(y + size / 3), svg.number(size), product
            )
        )
    return parts


def _top(x: Floats) -> tuple[float, float] | None:
    rows = np.flatnonzero(np.isfinite(x))
    return (float(x[rows[0]]), float(rows[0])) if rows.size else None


def _column_of(peaks: Peaks) -> Floats:
    """Rank of each peak in its row: draws dots down the stripes, which makes the path short."""
    return np.arange(len(peaks), dtype=np.float64) - peaks.row_start[peaks.row]


def _thinned(step: int) -> tuple[str, ...]:
    return (f"every {step}{_ORDINAL.get(step, 'th')} row is drawn",) if step > 1 else ()


_ORDINAL = {2: "nd", 3: "rd"}
