"""Make the paper's Figures 7 and 9 again, from any image.

``python -m benchmarks paper_figures IMAGE --row R --out DIR`` writes

- ``figure_7.svg``: the grey levels along one image row, what three fixed thresholds A, B and C make of
  them, and what the dominant peak makes of them (Lee et al. 2000, Figure 7);
- ``figure_9.png``: the image, its dominant peaks, and the runs above a high and a low threshold, side by
  side (Figure 9). Pixels above the threshold are grey, the middles of runs white.

The paper does not print its three levels; ``--levels`` sets them, as grey levels of an 8-bit scale. A is
the high one, C the low one, and these two also make Figure 9.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from benchmarks.command import parser_of
from benchmarks.pictures import svg_file
from roemetry.errors import DataError
from roemetry.html import plots as svg
from roemetry.records import Frame
from roemetry.records.arrays import Floats, Integers
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions

Places = tuple[Integers, Floats]
"""Row and place along it of each peak, px."""
LEVELS = (200.0, 120.0, 40.0)
_WIDE, _HIGH, _LEFT, _TOP, _GAP = 520.0, 150.0, 56.0, 34.0, 62.0
_STYLE = (
    "text{font:12px sans-serif;fill:#555;text-anchor:middle}.start{text-anchor:start}.end{text-anchor:end}"
    ".title{font-size:14px;fill:#000;text-anchor:start}.ground{fill:#fff}.frame{fill:none;stroke:#555}"
    ".peak{stroke:#d22;stroke-width:1.2}.level{stroke:#06c;stroke-dasharray:5 3}"
    ".signal{fill:none;stroke:#000}.tick{stroke:#555}"
)
_CAPTION_PX, _BORDER_PX = 34, 8


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the image, write both figures, and print what was found on the row."""
    parser = parser_of(__doc__)
    parser.add_argument("image", type=Path, help="8- or 16-bit image; colours are made grey")
    parser.add_argument("--row", type=int, required=True, help="image row for Figure 7, counted from 0")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to; made if absent")
    words = "three fixed thresholds, grey levels of 0…255, high to low (default: %(default)s)"
    parser.add_argument("--levels", type=float, nargs=3, default=LEVELS, metavar=("A", "B", "C"), help=words)
    words = "threshold of the dominant peak, grey levels of 0…255 (default: %(default)s)"
    parser.add_argument("--threshold", type=float, default=DominantPeakOptions().threshold, help=words)
    given = parser.parse_args(arguments)
    pixels = cv2.imread(str(given.image), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise DataError(f"{given.image}: cannot be read as an image")
    frame = Frame(pixels, name=given.image.name, bit_depth=8 * pixels.dtype.itemsize)
    rows = frame.size[0]
    if not 1 <= given.row <= rows - 2:
        parser.error(f"--row is {given.row}, expected 1…{rows - 2} (the first and last are not searched)")
    given.out.mkdir(parents=True, exist_ok=True)
    found = figure_7(given.out / "figure_7.svg", frame, given.row, given.levels, given.threshold)
    picture = figure_9(frame, given.levels[0], given.levels[-1], given.threshold)
    cv2.imwrite(str(given.out / "figure_9.png"), picture)
    for method, x_px in found.items():
        print(f"{method:<24} {len(x_px):>3}: {', '.join(f'{x:g}' for x in x_px)}")
    print(f"written: {given.out / 'figure_7.svg'}, {given.out / 'figure_9.png'}")


def dominant(frame: Frame, threshold: float) -> Places:
    """Find peaks by the paper's method."""
    peaks = DominantPeak(DominantPeakOptions(threshold=threshold)).extract(frame)
    return peaks.row, peaks.x_px


def above(frame: Frame, level: float) -> Places:
    """Find the middle of each run above a fixed level; the image's border is not searched."""
    bright = frame.pixels > int(level * frame.white / 255.0)
    bright[[0, -1]] = bright[:, [0, -1]] = False
    row, begin = np.nonzero(bright[:, 1:] & ~bright[:, :-1])
    end = np.nonzero(bright[:, :-1] & ~bright[:, 1:])[1]
    return row, 0.5 * (begin + 1 + end)


def figure_7(
    path: Path, frame: Frame, row: int, levels: Sequence[float], threshold: float
) -> dict[str, list[float]]:
    """Draw one row's grey levels and what each method finds on it; give the places, px, by method."""
    signal = frame.pixels[row] * (255.0 / frame.white)
    named = dict(zip("ABC", levels, strict=True))
    peaks = {f"threshold {name} ({level:g})": above(frame, level) for name, level in named.items()}
    peaks[f"dominant peak (by {threshold:g})"] = dominant(frame, threshold)
    found = {how: x_px[at == row].tolist() for how, (at, x_px) in peaks.items()}
    panels = [_panel(0, f"a  row {row} of {frame.name}", signal, [], named)]
    shown = [*(np.where(signal > level, 255.0, 0.0) for level in levels), signal]
    for place, ((how, x_px), line) in enumerate(zip(found.items(), shown, strict=True), start=1):
        panels.append(_panel(place, f"{'abcde'[place]}  {how}: {len(x_px)} found", line, x_px, {}))
    size = 2 * (_WIDE + _LEFT) + 24.0, 3 * (_HIGH + _GAP) + 8.0
    svg_file(path, panels, size, f"grey levels along row {row} of {frame.name}", _STYLE)
    return found


def _panel(
    place: int, caption: str, signal: Floats, found: Sequence[float], levels: Mapping[str, float]
) -> Markup:
    """Draw one plot; `found` are marked by red lines, `levels` are drawn with their names."""
    left, top = _LEFT + (place % 2) * (_WIDE + _LEFT), _TOP + (place // 2) * (_HIGH + _GAP)
    right, floor = left + _WIDE, top + _HIGH
    x = svg.Axis(0.0, max(signal.size - 1.0, 1.0), left, right)
    y = svg.Axis(0.0, 255.0, floor, top)
    parts = [svg.text(left, top - 10.0, caption, "title"), svg.box(left, top, _WIDE, _HIGH, "frame")]
    parts += [svg.text(left - 6.0, y(grey) + 4.0, f"{grey}", "end") for grey in (0, 100, 200)]
    for column in range(0, signal.size, 100 if signal.size < 1500 else 500):
        parts.append(svg.text(x(column), floor + 15.0, f"{column}"))
        parts.append(svg.line(x(column), floor, x(column), floor - 4.0, "tick"))
    parts.append(svg.text(right, floor + 29.0, "x (px), grey levels of 0…255", "end"))
    parts += [svg.line(x(at), top, x(at), floor, "peak") for at in found]
    for name, level in levels.items():
        parts.append(svg.line(left, y(level), right, y(level), "level"))
        parts.append(svg.text(right + 5.0, y(level) + 4.0, name, "start"))
    at = np.array([x(column) for column in range(signal.size)])
    up = np.array([y(level) for level in signal.tolist()])
    parts.append(svg.path("signal", svg.polyline(at, up)))
    return Markup("<g>{}</g>").format(Markup("").join(parts))


def figure_9(frame: Frame, high: float, low: float, threshold: float) -> NDArray[np.uint8]:
    """Draw the image, its dominant peaks, and its runs above a high and a low level, side by side."""
    grey = (frame.pixels.astype(np.float64) * 255.0 / frame.white).round().astype(np.uint8)
    pictures = {
        f"a  {frame.name}": grey,
        f"b  dominant peak, by {threshold:g}": _dotted(np.zeros_like(grey), dominant(frame, threshold)),
        f"c  high threshold, {high:g}": _dotted(np.where(grey > high, 110, 0), above(frame, high)),
        f"d  low threshold, {low:g}": _dotted(np.where(grey > low, 110, 0), above(frame, low)),
    }
    return np.hstack([_captioned(picture, caption) for caption, picture in pictures.items()])


def _dotted(picture: NDArray[Any], places: Places) -> NDArray[np.uint8]:
    dotted = picture.astype(np.uint8)
    row, x_px = places
    dotted[row, np.floor(x_px + 0.5).astype(np.int64)] = 255
    return dotted


def _captioned(picture: NDArray[np.uint8], caption: str) -> NDArray[np.uint8]:
    sides = _BORDER_PX, _CAPTION_PX, _BORDER_PX, _BORDER_PX
    framed = cv2.copyMakeBorder(picture, *sides, cv2.BORDER_CONSTANT, value=255)
    text = caption.encode("ascii", "replace").decode()  # OpenCV's own letters are ASCII only
    place = (_BORDER_PX, framed.shape[0] - 11)
    cv2.putText(framed, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 0, 1, cv2.LINE_AA)
    return np.asarray(framed, np.uint8)
