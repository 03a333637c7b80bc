"""Panels of slices that no image belongs to: the height map with its scale, profiles across and along."""

from __future__ import annotations

import base64

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.plots import Axis, plain
from roemetry.records import Profiles
from roemetry.records.arrays import Floats
from roemetry_report.panels import Panel

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
