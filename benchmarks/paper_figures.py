"""Make the paper's Figures 7 and 9 again, from any image.

``python -m benchmarks.paper_figures IMAGE --row R --out DIR`` writes

- ``figure_7.svg``: the grey levels along one image row, what three fixed thresholds A, B and C make of
  them, and what the dominant peak makes of them (Lee et al. 2000, Figure 7);
- ``figure_9.png``: the image, its dominant peaks, and the runs above a high and a low threshold, side by
  side (Figure 9). Pixels above the threshold are grey, the middles of runs white.

The paper does not print its three levels; ``--levels`` sets them, as grey levels of an 8-bit scale. A is
the high one, C the low one, and these two also make Figure 9.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import Frame, Peaks
from roemetry_paper.dominant_peak import (
    BinaryThreshold,
    BinaryThresholdOptions,
    DominantPeak,
    DominantPeakOptions,
)

LEVELS = (200.0, 120.0, 40.0)
_PLOT_WIDTH, _PLOT_HEIGHT, _LEFT, _TOP, _GAP = 520, 150, 56, 34, 62
_CAPTION_PX, _BORDER_PX = 34, 8


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the image, write both figures, and print what was found on the row."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.paper_figures",
        description="Make the paper's Figures 7 and 9 again, from any image.",
    )
    parser.add_argument("image", type=Path, help="8- or 16-bit image; colours are made grey")
    parser.add_argument("--row", type=int, required=True, help="image row for Figure 7, counted from 0")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to; made if absent")
    parser.add_argument(
        "--levels",
        type=float,
        nargs=3,
        default=LEVELS,
        metavar=("A", "B", "C"),
        help="three fixed thresholds, grey levels of 0…255, high to low (default: %(default)s)",
    )
    parser.add_argument(
        "--threshold",
        type=float,
        default=DominantPeakOptions().threshold,
        help="threshold of the dominant peak, grey levels of 0…255 (default: %(default)s)",
    )
    given = parser.parse_args(arguments)
    frame = read(given.image)
    rows = frame.size[0]
    if not 1 <= given.row <= rows - 2:
        parser.error(f"--row is {given.row}, expected 1…{rows - 2} (the first and last are not searched)")
    given.out.mkdir(parents=True, exist_ok=True)
    svg, found = figure_7(frame, given.row, given.levels, given.threshold)
    (given.out / "figure_7.svg").write_text(svg, encoding="utf-8")
    picture = figure_9(frame, given.levels[0], given.levels[-1], given.threshold)
    cv2.imwrite(str(given.out / "figure_9.png"), picture)
    for method, x_px in found.items():
        print(f"{method:<24} {len(x_px):>3}: {', '.join(f'{x:g}' for x in x_px)}")
    print(f"written: {given.out / 'figure_7.svg'}, {given.out / 'figure_9.png'}")


def read(path: Path) -> Frame:
    """Read an image as one grey channel."""
    pixels = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise DataError(f"{path}: cannot be read as an image")
    return Frame(pixels, name=path.name, bit_depth=8 * pixels.dtype.itemsize)


def dominant(frame: Frame, threshold: float) -> Peaks:
    """Find peaks by the paper's method."""
    return DominantPeak(DominantPeakOptions(threshold=threshold)).extract(frame)


def above(frame: Frame, level: float) -> Peaks:
    """Find peaks by a fixed threshold."""
    return BinaryThreshold(BinaryThresholdOptions(threshold=level)).extract(frame)


def figure_7(
    frame: Frame, row: int, levels: Sequence[float], threshold: float
) -> tuple[str, dict[str, list[float]]]:
    """Draw one row's grey levels and what each method finds on it.

    Returns
    -------
    str
        The figure as SVG.
    dict
        By method, the positions found on the row, px.
    """
    signal = frame.pixels[row] * (255.0 / frame.white)
    found = {}
    for name, level in zip("ABC", levels, strict=True):
        found[f"threshold {name} ({level:g})"] = _on_row(above(frame, level), row)
    cut = [np.where(signal > level, 255.0, 0.0) for level in levels]
    found[f"dominant peak (by {threshold:g})"] = _on_row(dominant(frame, threshold), row)
    panels = [_panel(0, f"a  row {row} of {frame.name}", signal, [], dict(zip("ABC", levels, strict=True)))]
    for place, ((method, x_px), shown) in enumerate(zip(found.items(), [*cut, signal], strict=True), start=1):
        panels.append(_panel(place, f"{'abcde'[place]}  {method}: {len(x_px)} found", shown, x_px, {}))
    width, height = 2 * (_PLOT_WIDTH + _LEFT) + 24, 3 * (_PLOT_HEIGHT + _GAP) + 8
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">\n'
        f'<rect width="{width}" height="{height}" fill="white"/>\n' + "\n".join(panels) + "\n</svg>\n"
    )
    return svg, found


def figure_9(frame: Frame, high: float, low: float, threshold: float) -> NDArray[np.uint8]:
    """Draw the image, its dominant peaks, and its runs above a high and a low level, side by side."""
    grey = (frame.pixels.astype(np.float64) * 255.0 / frame.white).round().astype(np.uint8)
    black = np.zeros_like(grey)
    pictures = [
        (f"a  {frame.name}", grey),
        (f"b  dominant peak, by {threshold:g}", _dotted(black, dominant(frame, threshold))),
        (f"c  high threshold, {high:g}", _dotted(np.where(grey > high, 110, 0), above(frame, high))),
        (f"d  low threshold, {low:g}", _dotted(np.where(grey > low, 110, 0), above(frame, low))),
    ]
    return np.hstack([_captioned(picture, caption) for caption, picture in pictures])


def _on_row(peaks: Peaks, row: int) -> list[float]:
    found: list[float] = peaks.x_px[peaks.row_start[row] : peaks.row_start[row + 1]].tolist()
    return found


def _dotted(picture: NDArray[Any], peaks: Peaks) -> NDArray[np.uint8]:
    dotted = picture.astype(np.uint8)
    dotted[peaks.row, np.floor(peaks.x_px + 0.5).astype(np.int64)] = 255
    return dotted


def _captioned(picture: NDArray[np.uint8], caption: str) -> NDArray[np.uint8]:
    framed = cv2.copyMakeBorder(
        picture, _BORDER_PX, _CAPTION_PX, _BORDER_PX, _BORDER_PX, cv2.BORDER_CONSTANT, value=255
    )
    # OpenCV's own letters are ASCII only.
    text = caption.encode("ascii", "replace").decode()
    place = (_BORDER_PX, framed.shape[0] - 11)
    cv2.putText(framed, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 0, 1, cv2.LINE_AA)
    return np.asarray(framed, np.uint8)


def _panel(
    place: int,
    caption: str,
    signal: NDArray[np.float64],
    found: Sequence[float],
    lines: Mapping[str, float],
) -> str:
    """Draw one plot; `found` are marked by red lines, `lines` are levels with their names."""
    across, up = _PLOT_WIDTH / max(signal.size - 1, 1), _PLOT_HEIGHT / 255.0

    def at(x: float, level: float) -> tuple[float, float]:
        return round(x * across, 2), round(_PLOT_HEIGHT - level * up, 2)

    left = _LEFT + (place % 2) * (_PLOT_WIDTH + _LEFT)
    top = _TOP + (place // 2) * (_PLOT_HEIGHT + _GAP)
    parts = [
        f'<g transform="translate({left},{top})">',
        f'<text y="-10" font-size="14">{escape(caption)}</text>',
        f'<rect width="{_PLOT_WIDTH}" height="{_PLOT_HEIGHT}" fill="none" stroke="#555"/>',
    ]
    for grey in (0, 100, 200):
        parts.append(_text(-6, at(0, grey)[1] + 4, str(grey), "end"))
    for column in range(0, signal.size, 100 if signal.size < 1500 else 500):
        parts.append(_text(at(column, 0)[0], _PLOT_HEIGHT + 15, str(column), "middle"))
        parts.append(f'<path d="M{at(column, 0)[0]},{_PLOT_HEIGHT}v-4" stroke="#555"/>')
    parts.append(_text(_PLOT_WIDTH, _PLOT_HEIGHT + 29, "x (px), grey levels of 0…255", "end"))
    for x in found:
        parts.append(f'<path d="M{at(x, 0)[0]},0v{_PLOT_HEIGHT}" stroke="#d22" stroke-width="1.2"/>')
    for name, level in lines.items():
        parts.append(f'<path d="M0,{at(0, level)[1]}h{_PLOT_WIDTH}" stroke="#06c" stroke-dasharray="5 3"/>')
        parts.append(_text(_PLOT_WIDTH + 5, at(0, level)[1] + 4, name, "start"))
    points = " ".join("{},{}".format(*at(x, level)) for x, level in enumerate(signal.tolist()))
    parts.append(f'<polyline points="{points}" fill="none" stroke="black"/>')
    return "\n".join([*parts, "</g>"])


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="#555">{escape(text)}</text>'


if __name__ == "__main__":
    main()
