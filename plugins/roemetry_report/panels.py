"""The panels of one acquisition: image, peaks, labelled curves, arcs; or its height map and profiles."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.html import plots as svg
from roemetry.html.plots import Axis, Box, plain
from roemetry.records import (
    AMBIGUOUS,
    BELT,
    UNLABELLED,
    Frame,
    ImageArrows,
    Outline,
    Peaks,
    Profiles,
    StripeMap,
    Trace,
)
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette
from roemetry_report.words import counted

_DOTS_MAX, _MARKS_MAX = 7500, 1500
"""Peaks drawn as dots, and as marks of one kind: a section stays below 250 kB with them."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A picture with its letter, what it shows, and what a reader must know about the drawing of it."""

    letter: str
    """Empty where its place on the page is not known yet."""
    title: str
    drawing: Markup
    notes: tuple[str, ...] = ()


def panels(trace: Trace, key: str) -> tuple[Panel, ...]:
    """Draw what there is of a trace; `key`, unique in the page, is what the ids of the drawings begin with.

    The picture is ``<key>-image``: it stands in the page once and is used wherever it is needed.
    """
    base = base_image(trace)
    if base is None:
        return ()
    given = [_original(base, key)]
    if trace.peaks is not None:
        given.append(_dominant(base, trace.peaks, key))
        given.append(_superimposed(base, trace, key))
    if trace.peaks is not None and trace.stripes is not None:
        drawn = _connected(base, trace.peaks, trace.stripes, trace.outlines, key)
        given.append(replace(drawn, notes=(*drawn.notes, *_not_drawn(trace))))
    return tuple(given)


def _not_drawn(trace: Trace) -> tuple[str, ...]:
    """Name the lines of a grid that run across: their stripes are numbered on, in an image of their own."""
    if trace.stripes is None or trace.profiles is None or not trace.profiles.slice_count:
        return ()
    first, last = trace.stripes.stripe_count + 1, int(trace.profiles.stripe.max()) + 1
    if last < first:
        return ()
    named = f"stripes {first} to {last}, which run across, are"
    return (f"{named if last > first else f'stripe {first}, which runs across, is'} not drawn",)


def _original(base: BaseImage, key: str) -> Panel:
    image = svg.image(base.uri, (-0.5, -0.5, float(base.columns), float(base.rows)), f"{key}-image")
    label = f"Camera image, {base.columns} by {base.rows} pixels"
    return Panel("a", "Original image", _screen(base, [image], label), base.notes)


def _dominant(base: BaseImage, peaks: Peaks, key: str) -> Panel:
    step = max(1, -(-len(peaks) // _DOTS_MAX))
    drawn = peaks.row % step == 0
    rank = (
        np.arange(len(peaks)) - peaks.row_start[peaks.row]
    )  # in its row: down the stripes the path is short
    order = np.lexsort((peaks.row[drawn], rank[drawn]))
    x, y = peaks.x_px[drawn][order], peaks.row[drawn][order].astype(np.float64)
    dots = svg.path("c c-dot", svg.dots(x, y), stroke=palette.PEAK)
    body = Markup('<g id="{}-peaks">{}</g>').format(key, dots)
    label = f"{len(peaks)} peaks as dots on black"
    return Panel("b", "Peaks", _screen(base, [body], label), (f"{len(peaks)} peaks", *_thinned(step)))


def _superimposed(base: BaseImage, trace: Trace, key: str) -> Panel:
    over = "peaks" if trace.stripes is None else "curves"
    body = Markup('<use href="#{0}-image"/><g class="over"><use href="#{0}-{1}"/></g>').format(key, over)
    title = "Labelled peaks on the image" if trace.stripes is not None else "Peaks on the image"
    return Panel("c", title, _screen(base, [body], title))


def _connected(
    base: BaseImage, peaks: Peaks, stripes: StripeMap, outlines: tuple[Outline, ...], key: str
) -> Panel:
    ambiguous, unlabelled = stripes.peak_stripe == AMBIGUOUS, stripes.peak_stripe == UNLABELLED
    arm = max(base.columns, base.rows) / 220
    body = [
        Markup('<g id="{}-curves">{}</g>').format(key, curves(stripes)),
        *(
            svg.path("c c-outline", svg.polyline(*outline.xy_px.T) + "z", stroke=palette.OUTLINE)
            for outline in outlines
            if len(outline.xy_px) > 2
        ),
        *_marks(peaks, unlabelled, "unlabelled", svg.crosses, arm),
        *_marks(peaks, ambiguous, "ambiguous", svg.diamonds, 1.4 * arm),
        *_numbers(stripes, base),
        *_product_numbers(stripes, base),
    ]
    label = (
        f"Curves of {stripes.stripe_count} stripes after connection; {int(ambiguous.sum())} ambiguous and "
        f"{int(unlabelled.sum())} unlabelled peaks"
    )
    notes = _thinned(row_step(stripes))
    if max(ambiguous.sum(), unlabelled.sum()) > _MARKS_MAX:
        notes = (*notes, "there are too many ambiguous or unlabelled peaks to draw all")
    return Panel("d", "Curves after connection", _screen(base, body, label), notes)


def _screen(base: BaseImage, body: Iterable[Markup], label: str) -> Markup:
    return svg.view(body, (-0.5, -0.5, float(base.columns), float(base.rows)), label, "screen")


def _marks(
    peaks: Peaks, which: Flags, kind: str, shape: Callable[[Floats, Floats, float], str], arm: float
) -> list[Markup]:
    chosen = np.flatnonzero(which)
    if not chosen.size:
        return []
    chosen = chosen[:: -(-chosen.size // _MARKS_MAX)]
    data = shape(peaks.x_px[chosen], peaks.row[chosen].astype(np.float64), arm)
    colour = palette.AMBIGUOUS if kind == "ambiguous" else palette.UNLABELLED
    return [svg.path(f"c c-{kind}", data, stroke=colour)]


def _numbers(stripes: StripeMap, base: BaseImage) -> list[Markup]:
    """Write each stripe's number (from 1) at its top; where they would touch, only every n-th."""
    size = max(base.columns, base.rows) / 40
    tops = [_top(stripes.x_px[i]) for i in range(stripes.stripe_count)]
    where = np.array([x for x, _ in filter(None, tops)])
    apart = float(np.median(np.abs(np.diff(where)))) if where.size > 1 else np.inf
    step = max(1, int(np.ceil(1.3 * size / max(apart, 1e-3)))) if where.size > 1 else 1
    return [
        svg.text(
            min(max(top[0], size * 0.7), base.columns - size * 0.7),
            min(max(top[1], 0) + size, base.rows - 2.0),
            str(index + 1),
            "number",
            size,
            palette.stripe_colour(index),
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
        parts.append(svg.text(x, y + size / 3, str(product), "product", size))
    return parts


def _top(x: Floats) -> tuple[float, float] | None:
    rows = np.flatnonzero(np.isfinite(x))
    return (float(x[rows[0]]), float(rows[0])) if rows.size else None


def _thinned(step: int) -> tuple[str, ...]:
    return (f"one row in {step} is drawn",) if step > 1 else ()


_BYTES_MAX = 60_000
"""Of a picture: fifty sections then make a page of 10 MB, which still opens at once."""
_TRIES = ((1280, 85), (1280, 70), (960, 70), (720, 65), (640, 50), (480, 40))
"""Longest side (px) and JPEG quality, from best to least."""


@dataclass(frozen=True, slots=True)
class BaseImage:
    """A picture to draw on, as a ``data:`` address, and what was done to it for display.

    Rows and columns are those of the frame that the overlays' coordinates belong to.
    """

    rows: int
    columns: int
    uri: str
    notes: tuple[str, ...]


def base_image(trace: Trace) -> BaseImage | None:
    """Make the picture of a trace's laser frame; in colour where it was taken in colour."""
    frame = trace.frame
    if frame is None:
        return None
    notes = []
    if frame.turn_deg:
        notes.append(f"turned by {frame.turn_deg}° (counter-clockwise) from how it was taken")
    shown, lifted = displayed(*as_taken(trace, frame))
    notes += lifted
    coded, scaled_to = _jpeg(shown)
    if scaled_to is not None:
        notes.append(f"scaled to {scaled_to[1]} × {scaled_to[0]} px for display")
    rows, columns = frame.size
    uri = "data:image/jpeg;base64," + base64.b64encode(coded).decode("ascii")
    return BaseImage(rows, columns, uri, tuple(notes))


def as_taken(trace: Trace, frame: Frame) -> tuple[NDArray[Any], int]:
    """Give the colour image, turned like the frame, where there is one; else the frame itself."""
    taken = None if trace.acquisition is None else trace.acquisition.frame("laser")
    if taken is not None and taken.pixels.ndim == 3:
        turned = np.rot90(taken.pixels, (frame.turn_deg - taken.turn_deg) // 90 % 4)
        if turned.shape[:2] == frame.size:
            return turned, taken.white
    return frame.pixels, frame.white


def picture_of(trace: Trace) -> NDArray[np.uint8] | None:
    """Give (row, column, 3) what the products look like: in plain light, or under the stripes."""
    if trace.frame is None:
        return None
    pixels, white = as_taken(trace, trace.frame)
    plain = None if trace.acquisition is None else trace.acquisition.frame("plain")
    if plain is not None:
        turned = np.rot90(plain.pixels, (trace.frame.turn_deg - plain.turn_deg) // 90 % 4)
        if turned.shape[:2] == trace.frame.size:
            pixels, white = turned, plain.white
    shown, _ = displayed(pixels, white)
    return shown if shown.ndim == 3 else np.repeat(shown[..., None], 3, axis=2)


_BRIGHT, _DIM = 0.35, 0.12
"""Shares of white. Brightest pixels below the first: all is brightened; median below the second: lifted."""
_LIFTED_TO, _GAMMA_MIN = 0.2, 0.45
"""What the middle pixel becomes, and the least exponent: beyond it sensor noise is all one sees."""


def displayed(pixels: NDArray[Any], white: int) -> tuple[NDArray[np.uint8], list[str]]:
    """Scale the sensor's range to 0…255 and lift what is too dark to see; say what was done."""
    brightest = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    sample = brightest[::2, ::2] / white
    top, notes = float(np.percentile(sample, 99.9)), []
    gain = min(8.0, 0.8 / top) if 0 < top < _BRIGHT else 1.0
    middle = gain * float(np.median(sample))
    gamma = 1.0
    if gain > 1.0:
        notes.append(f"brightened {gain:.1f} × for display")
    if middle < _DIM:
        gamma = max(_GAMMA_MIN, math.log(_LIFTED_TO) / math.log(max(middle, 1e-3)))
        notes.append(f"dark parts lifted for display (gamma {gamma:.2f})")
    if gain == gamma == 1.0 and white == 255 and pixels.dtype == np.uint8:
        return np.ascontiguousarray(pixels), notes
    levels = np.rint(255.0 * np.clip(np.arange(white + 1) * (gain / white), 0.0, 1.0) ** gamma)
    if pixels.ndim == 2:
        return levels.astype(np.uint8)[np.minimum(pixels, white)], notes
    # by the brightest colour of each pixel, so that hues stay
    times = levels / np.maximum(np.arange(white + 1), 1)
    shown = pixels * times[np.minimum(brightest, white)][..., None]
    return np.rint(shown).clip(0, 255).astype(np.uint8), notes


def _jpeg(pixels: NDArray[np.uint8]) -> tuple[bytes, tuple[int, int] | None]:
    """Code as JPEG, at the first setting that keeps within the size; the last one counts anyway."""
    import cv2

    coded, size = b"", None
    for side, quality in _TRIES:
        scale = side / max(pixels.shape[:2])
        image = pixels
        if scale < 1:
            columns, rows = (max(1, round(n * scale)) for n in (pixels.shape[1], pixels.shape[0]))
            image = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
        _, buffer = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        coded = buffer.tobytes()
        size = (int(image.shape[0]), int(image.shape[1])) if image is not pixels else None
        if len(coded) <= _BYTES_MAX:
            break
    return coded, size


_POINTS_MAX = 6000
"""More points than these make a section too large; then only every n-th row is drawn."""


def curves(stripes: StripeMap, *, product: int | None = None) -> Markup:
    """Draw every stripe: on the belt thin and grey, on a product thick and coloured, bridged dashed.

    With `product`, that product's points alone.
    """
    step = row_step(stripes)
    parts = []
    for index in range(stripes.stripe_count):
        x, label, seen = stripes.x_px[index], stripes.product[index], stripes.seen[index]
        colour = palette.stripe_colour(index)
        body = label > BELT if product is None else label == product
        if product is None:
            parts += _path(x, seen & (label == BELT), step, "c-belt", palette.BELT)
            parts += _path(x, ~seen & (label == BELT), step, "c-belt c-bridged", palette.BELT, join=True)
        parts += _path(x, seen & body, step, "c-body", colour)
        parts += _path(x, ~seen & body, step, "c-body c-bridged", colour, join=True)
    return Markup("").join(parts)


def row_step(stripes: StripeMap) -> int:
    """Every how many rows a point is drawn."""
    return max(1, -(-int(np.isfinite(stripes.x_px).sum()) // _POINTS_MAX))


def runs(mask: Flags) -> Iterator[tuple[int, int]]:
    """Give first and one-past-last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def broken_line(x: Floats, y: Floats, mask: Flags, step: int, *, join: bool = False) -> str:
    """Path data of all runs of a mask, every `step`-th point and both ends.

    With `join`, from the known point before to the one after each run.
    """
    known, data = np.isfinite(x + y), []
    for begin, end in runs(mask):
        first = begin - 1 if join and begin > 0 and known[begin - 1] else begin
        last = end if join and end < len(x) and known[end] else end - 1
        points = np.unique(np.append(np.arange(first, last + 1, step), last))
        data.append(svg.polyline(x[points], y[points]))
    return "".join(data)


def _path(x: Floats, mask: Flags, step: int, kind: str, colour: str, *, join: bool = False) -> list[Markup]:
    data = broken_line(x, np.arange(len(x), dtype=np.float64), mask, step, join=join)
    return [svg.path(f"c {kind}", data, stroke=colour)] if data else []


_FAR_HEIGHTS = 1.5
"""An arrow longer than so many image heights is not drawn: the curve is as good as straight there."""


def arc_panel(
    arrows: ImageArrows, stripes: StripeMap, product: int, size: tuple[int, int], key: str
) -> Panel | None:
    """Draw a product's evidence over its curves, zoomed to the product; None where there is nothing to draw.

    Below lies the dimmed picture ``<key>-image``, which has `size` rows and columns.
    """
    box = _zoom(arrows, stripes, product, size)
    if box is None:
        return None
    length = np.hypot(*(arrows.to_px - arrows.from_px).T)
    known = np.isfinite(length)
    drawn = known & (length <= _FAR_HEIGHTS * size[0])
    leaving = drawn & ~_inside(arrows.to_px, box)
    body = [
        Markup('<use class="dim" href="#{}-image"/>').format(key),
        curves(stripes, product=product),
        _arrows(arrows, drawn & ~arrows.flagged, flagged=False),
        _arrows(arrows, drawn & arrows.flagged, flagged=True),
    ]
    flagged = int(arrows.flagged.sum())
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
    title = f"Body curves, an arrow to each {arrows.kind}"
    label = f"Body curves of product {product} with arrows ({arrows.kind}); {'; '.join(notes)}"
    return Panel("", title, svg.view(body, box, label, "screen zoomed"), tuple(notes))


def _zoom(arrows: ImageArrows, stripes: StripeMap, product: int, size: tuple[int, int]) -> Box | None:
    """Give the view: the product, and the flagged centres as far as they lie in the image, with a margin."""
    stripe, row = np.nonzero(stripes.product == product)
    if not row.size:
        return None
    points = [np.column_stack([stripes.x_px[stripe, row], row.astype(np.float64)])]
    whole = (-0.5, -0.5, float(size[1]), float(size[0]))
    points.append(arrows.to_px[arrows.flagged & _inside(arrows.to_px, whole)])
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


def _arrows(arrows: ImageArrows, which: Flags, *, flagged: bool) -> Markup:
    if not which.any():
        return Markup("")
    kind, colour = ("flagged", palette.AMBIGUOUS) if flagged else ("mark", palette.MARK)
    ends = np.stack([arrows.from_px[which], arrows.to_px[which]], axis=1)
    # An arrow head stands at the last point of a path only, so each arrow is a path of its own.
    paths = (svg.path("c", svg.polyline(*end.T)) for end in ends)
    return Markup('<g class="{}" stroke="{}">{}</g>').format(kind, colour, Markup("").join(paths))


_PIXELS_MAX = 700
"""Of the map's longer side: a picture of 100 kB."""
_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float64)
"""Red, green, blue from low to high: even in lightness, and told apart by every eye."""
_LIGHT = np.array([-0.5, 0.5, 0.7071])
"""Where the light of the shading comes from."""
# of a section's picture and its margins, units of the SVG
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 520.0, 200.0, 46.0, 34.0, 26.0


def height_panels(profiles: Profiles, key: str) -> tuple[Panel, ...]:
    """Draw slices as a map and two profiles; none where nothing is known."""
    known = np.asarray(np.isfinite(profiles.xyz_mm).all(axis=2))
    if np.count_nonzero(known) < 3:
        return ()
    heights, step = _rastered(profiles, known)
    across, along = _profiles(profiles, known)
    scan = profiles.scan
    notes = ["white: not seen"]
    if scan is not None:
        notes.append(f"{scan.placed} of {scan.lines} lines placed, {scan.lost} lost")
    return (
        Panel("a", "Height map", _map(heights, step, key), tuple(notes)),
        Panel("b", "Across the belt, at the highest place", _profile(across, "Y (mm)")),
        Panel("c", "Along the belt, at the highest place", _profile(along, "X (mm)")),
    )


def _rastered(profiles: Profiles, known: np.ndarray) -> tuple[Floats, float]:
    """Give (row, column) heights, rows against Y, columns along X, and a pixel's side, mm."""
    points = profiles.xyz_mm[known]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    apart = [np.abs(np.diff(profiles.xyz_mm[..., k], axis=k)) for k in (0, 1)]
    usual = [float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else 0.0 for one in apart]
    step = max(float((high - low).max()) / _PIXELS_MAX, *usual, 1e-6)
    columns, rows = (int(size / step) + 1 for size in high - low)
    i = ((points[:, 0] - low[0]) / step).astype(np.int64)
    j = ((high[1] - points[:, 1]) / step).astype(np.int64)
    cell = j * columns + i
    many = np.bincount(cell, minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        found = np.bincount(cell, points[:, 2], minlength=rows * columns) / many
    heights = found.reshape(rows, columns)
    # a pixel that only the grid has missed takes the mean of those beside it
    padded = np.pad(heights, 1, constant_values=np.nan)
    beside = np.stack([padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]])
    there = np.isfinite(beside)
    mean = np.where(there, beside, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    return np.where(np.isnan(heights) & (there.sum(axis=0) >= 3), mean, heights), step


def _map(heights: Floats, step: float, key: str) -> Markup:
    """Draw colours by height, shaded by slope; white is not known. The scale stands below."""
    import cv2

    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    share = np.nan_to_num((heights - low) / max(high - low, 1e-9))
    places = np.linspace(0.0, 1.0, len(_COLOURS))
    colour = np.stack([np.interp(share, places, _COLOURS[:, k]) for k in range(3)], axis=-1)
    filled = np.where(np.isfinite(heights), heights, low)
    down, right = np.gradient(filled, step) if min(heights.shape) > 1 else (0 * filled, 0 * filled)
    normal = np.stack([-right, down, np.ones_like(filled)], axis=-1)
    normal /= np.sqrt((normal**2).sum(axis=2, keepdims=True))
    shade = 0.55 + 0.45 * np.clip(normal @ _LIGHT, 0.0, 1.0) / _LIGHT[2]
    shown = np.clip(colour * np.minimum(shade, 1.15)[..., None], 0, 255)
    shown[~np.isfinite(heights)] = 255
    image = shown[..., ::-1].astype(np.uint8)
    data = base64.b64encode(cv2.imencode(".png", image)[1].tobytes()).decode("ascii")
    rows, columns = heights.shape
    picture = svg.image(
        f"data:image/png;base64,{data}", (-0.5, -0.5, float(columns), float(rows)), f"{key}-image"
    )
    size = max(columns, rows) / 40
    stops = Markup("").join(
        Markup('<stop offset="{}" stop-color="rgb({},{},{})"/>').format(plain(float(p), 2), *map(int, c))
        for p, c in zip(places, _COLOURS, strict=True)
    )
    gradient = Markup('<linearGradient id="{}-scale">{}</linearGradient>').format(key, stops)
    bar_y = rows + 0.6 * size
    scale = Markup('<rect x="0" y="{}" width="{}" height="{}" fill="url(#{}-scale)"/>').format(
        plain(bar_y, 1), plain(columns * 0.5, 1), plain(0.8 * size, 1), key
    )
    words = [
        svg.text(0.0, bar_y + 2.0 * size, f"{plain(low, 1)} mm", "start", size),
        svg.text(columns * 0.5, bar_y + 2.0 * size, f"{plain(high, 1)} mm", "end", size),
        svg.text(
            columns - 1.0, bar_y + 2.0 * size, f"{plain(columns * step, 0)} × {plain(rows * step, 0)} mm",
            "end", size
        ),
    ]  # fmt: skip
    size_mm = f"{plain(columns * step, 0)} by {plain(rows * step, 0)} mm"
    label = f"Height map of {size_mm}, heights from {plain(low, 1)} to {plain(high, 1)} mm"
    box = (-0.5, -0.5, float(columns), rows + 3.0 * size)
    return svg.view([gradient, picture, scale, *words], box, label, "plot")


def _profiles(profiles: Profiles, known: np.ndarray) -> tuple[Floats, Floats]:
    """Give (n, 2) places and heights of the slice and of the column through the highest product point."""
    height = np.where(known & (profiles.product != 0), profiles.xyz_mm[..., 2], -np.inf)
    if not np.isfinite(height).any():
        height = np.where(known, profiles.xyz_mm[..., 2], -np.inf)
    i, k = np.unravel_index(int(np.argmax(height)), height.shape)
    return profiles.xyz_mm[i][:, [1, 2]], profiles.xyz_mm[:, k][:, [0, 2]]


def _profile(points: Floats, words: str) -> Markup:
    """Draw heights over a place; what is not known breaks the line."""
    known = points[np.isfinite(points[:, 0])]
    low, high = float(known[:, 0].min()), float(known[:, 0].max())
    floor, top = min(0.0, float(known[:, 1].min())), max(1.0, float(known[:, 1].max()))
    x = Axis(low, max(high, low + 1e-6), _LEFT, _WIDTH - 8.0)
    y = Axis(floor, top, _HEIGHT - _BOTTOM, _TOP)
    parts = []
    for value, written in y.ticks(4):
        parts += [
            svg.line(_LEFT, y(value), _WIDTH - 8.0, y(value), "rule"),
            svg.text(_LEFT - 6, y(value) + 4, written, "tick end"),
        ]
    for value, written in x.ticks():
        parts.append(svg.text(x(value), _HEIGHT - _BOTTOM + 15, written, "tick"))
    parts.append(svg.text(0.5 * _WIDTH, _HEIGHT - 4, words, "tick"))
    parts.append(svg.text(2.0, 9, "Z (mm)", "tick start"))
    breaks = np.flatnonzero(~np.isfinite(points[:, 0]))
    for part in np.split(points, breaks):
        part = part[np.isfinite(part[:, 0])]
        if len(part) > 1:
            part = part[:: max(1, len(part) // 600)]
            drawn = svg.polyline(
                np.array([x(value) for value in part[:, 0].tolist()]),
                np.array([y(value) for value in part[:, 1].tolist()]),
            )
            parts.append(svg.path("c", drawn, stroke="#1f5a8a"))
    return svg.view(parts, (0, 0, _WIDTH, _HEIGHT), f"Heights over {words}", "chart")
