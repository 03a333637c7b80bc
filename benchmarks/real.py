"""Everything usable among the real camera images, against what is known there, with overlays to look at.

``python -m benchmarks real [--extractors WORD …] [--out FOLDER] [--page]``

The images are not part of the project: the environment variable ROEMETRY_REAL_DATA names their folder
(default ``../shared/real``); what is not there is skipped with the reason.

*Turntable*: a saturated green line with halos on wall, toy, foam and card. Known is a run of at least three
pixels of the laser's channel at 250 or more, alone in its row: its middle is where a person puts the line.
*Repeated*: the wall's rows do not move from frame to frame, so a centre's scatter over the frames is the
extractor's; what a frame moves as a whole is taken off. *Boards*: a red line on twelve printed boards in room
light, less the laser-off image as in a calibration, and by contrast alone; known is `line_on_board`.
*Weld*: one line in a V groove, with reflections beside it; known is `line_of`. *Wheel set*: some twenty
stripes on a curved part, against marks made by hand (`benchmarks.real_images.wheelset`).
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import parser_of
from benchmarks.extraction.methods import there
from benchmarks.real_images import folder_of, prepared
from benchmarks.real_images.wheelset import wheelset
from benchmarks.tables import Table, number, put_tables
from roemetry.errors import RoemetryError
from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor
from roemetry_coding.single import Single

LINE = ((2.0, 390.0), (518.0, 385.0), (735.0, 585.0)), ((818.0, 583.0), (1042.0, 389.0), (1278.0, 400.0))
"""(x, y) of the line's corners in the image as it is, px: left flank, right flank."""
_AROUND_PX, _CORNER_PX = 14, 6  # of the marks: where light is the line's; where two parts meet
_ABOVE = 15.0  # grey levels above the column's median, that are light


def line_of(image: NDArray[Any]) -> Floats:
    """Give the line's y for each column of the weld's image, NaN where it has no light of its own.

    The line was marked by hand: six points, straight between them; the bottom of the groove has no light of
    its own. Speckle moves the middle of a single row's light by 0.4 to 0.7 px, so known is a parabola through
    those middles along each straight part, looked at over the image eight times as large.
    """
    light = image.max(axis=2).astype(np.float64)
    light = np.clip(light - np.median(light, axis=0) - _ABOVE, 0.0, None)
    line = np.full(light.shape[1], np.nan)
    for part in LINE:
        for (begin, y_begin), (end, y_end) in itertools.pairwise(part):
            columns = np.arange(int(begin), int(end) + 1)
            marked = np.rint(np.interp(columns, (begin, end), (y_begin, y_end))).astype(np.int64)
            rows = marked + np.arange(-_AROUND_PX, _AROUND_PX + 1)[:, None]
            here = light[rows, columns]
            middle = (here * rows).sum(axis=0) / np.maximum(here.sum(axis=0), 1.0)
            kept = (here.sum(axis=0) > 0) & (columns > begin + _CORNER_PX) & (columns < end - _CORNER_PX)
            for _ in range(5):
                path = np.polyval(np.polyfit(columns[kept], middle[kept], 2), columns)
                off = np.abs(middle - path)
                kept &= off <= 3.0 * 1.4826 * float(np.median(off[kept]))
            line[columns] = path
    return line


POSES = 12
_PLATE = (-1.5, 7.5)


def line_on_board(dark: NDArray[Any], lit: NDArray[Any]) -> Floats:
    """Give the line's y for each column on the board, NaN beside it.

    The board's width is known from its circles: the plate ends 1.5 pitches beyond the outer ones. The line's
    place is a parabola through the brightest pixel of each column of the difference of all colours, fitted
    without outliers: it comes from no extractor.
    """
    corner = circles(dark)
    grid = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    to_image, _ = cv2.findHomography(grid, corner)
    to_board = np.linalg.inv(to_image)
    light = np.clip(lit.astype(int) - dark, 0, 255).sum(axis=2).astype(np.float32)
    light = cv2.GaussianBlur(light, (1, 9), 0)
    columns = np.arange(lit.shape[1])
    brightest = light.argmax(axis=0).astype(np.float64)
    ends = cv2.perspectiveTransform(np.array([[[_PLATE[0], 3.0], [_PLATE[1], 3.0]]]), to_image)[0, :, 0]
    inside = (columns > ends[0]) & (columns < ends[1])
    kept = inside.copy()
    for _ in range(6):
        path = np.polyval(np.polyfit(columns[kept], brightest[kept], 2), columns)
        off = np.abs(brightest - path)
        kept = inside & (off <= max(3.0, 2.0 * float(np.median(off[inside]))))
    board = cv2.perspectiveTransform(np.stack([columns, path], axis=1)[None], to_board)[0]
    on_board = (board[:, 0] >= _PLATE[0]) & (board[:, 0] <= _PLATE[1])
    return np.where(on_board, path, np.nan)


def circles(dark: NDArray[Any]) -> NDArray[np.float32]:
    """Find the 7 × 7 circles, row by row."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.minArea, settings.maxArea = 200.0, 8000.0
    grey, blobs = cv2.cvtColor(dark, cv2.COLOR_BGR2GRAY), cv2.SimpleBlobDetector_create(settings)
    how = {"flags": cv2.CALIB_CB_SYMMETRIC_GRID, "blobDetector": blobs}
    found, centres = cv2.findCirclesGrid(grey, (7, 7), **how)
    if not found:
        raise SystemExit("the circles of a board were not found")
    return np.asarray(centres).reshape(-1, 2)


_CORE, _CORE_PX = 250, 3  # grey level and pixels of a saturated core
_FAR_PX = 3.0  # beside the core's middle: another line
_WALL_ROWS, _WALL_COLUMNS = 150, (243, 273)  # where the line lies still on the wall
_ZOOM = 2


class Known(NamedTuple):
    """One image, and where its line is: (row,) column, NaN where it is not known."""

    name: str
    frame: Frame
    line_px: Floats
    picture: Any


def main() -> None:
    """Print the tables; write overlays where a folder is given."""
    parser = parser_of(__doc__)
    parser.add_argument("--extractors", nargs="*", default=[], help="only those whose name holds a word")
    parser.add_argument("--out", type=Path, help="folder for overlays: peaks drawn over the images")
    parser.add_argument("--page", action="store_true", help="put the tables into the documentation")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    stages = dict(there(given.extractors))
    tables, follows = [], []
    for title, images in SETS.items():
        known = list(images())
        if not known:
            print(f"skipped: {title}: not there; set ROEMETRY_REAL_DATA", file=sys.stderr)
            continue
        rows = []
        for name, stage in stages.items():
            found = [_extracted(stage, image.frame) for image in known]
            rows.append([name, *judged(known, found)])
            if title != "turntable, grey":
                follows.append([title, name, *followed(known, found)])
            if title.startswith("turntable"):
                rows[-1] += repeated(found)
            if given.out:
                for image, peaks in list(zip(known, found, strict=True))[::6]:
                    draw(given.out / f"{title}, {image.name}, {name}.png".replace(", ", "-"), image, peaks)
        head = ["extractor", "rows with a line", "without a peak", f"> {_FAR_PX:.0f} px off", "rms off, px"]
        head += ["95 % intervals hold, %", "others a row"]
        head += ["repeats on the wall, px", "stated there, px"] if title.startswith("turntable") else []
        tables.append(Table(title, head, rows))
        print(tables[-1], flush=True)
    head = ["set", "extractor", "rows with a line", "followed, %", f"of these > {_FAR_PX:.0f} px off, %"]
    tables.append(Table("one line, by the coder single", head, follows))
    print(tables[-1], flush=True)
    home = folder_of("multi_stripe")
    if home is None:
        print("skipped: wheel set: not there; set ROEMETRY_REAL_DATA", file=sys.stderr)
    else:
        tables.append(wheelset(home, stages))
        print(tables[-1], flush=True)
    if given.page and follows:
        put_tables(tables, "real")


def followed(known: Sequence[Known], found: Sequence[Peaks | None]) -> list[str]:
    """Count rows of the line, those in which `single` sees it, and where it follows another one."""
    rows = seen = far = 0
    for image, peaks in zip(known, found, strict=True):
        known_rows = np.isfinite(image.line_px)
        rows += int(known_rows.sum())
        if peaks is None:
            continue
        coded = Single().code(peaks, None)
        on = known_rows & coded.seen[0]
        seen += int(on.sum())
        far += int((np.abs(coded.x_px[0] - image.line_px)[on] > _FAR_PX).sum())
    return [str(rows), number(100.0 * seen / max(rows, 1), 2), number(100.0 * far / max(seen, 1), 2)]


def _extracted(stage: Extractor[Any], frame: Frame) -> Peaks | None:
    try:
        return stage.extract(frame)
    except RoemetryError as refusal:
        print(f"{frame.name}: {refusal}", file=sys.stderr)
        return None


def judged(known: Sequence[Known], found: Sequence[Peaks | None]) -> list[str]:
    """Count the rows, those without a peak and those off; scatter, coverage and other peaks."""
    rows = missed = others = 0
    off: list[float] = []
    ratio: list[float] = []
    for image, peaks in zip(known, found, strict=True):
        for y in np.flatnonzero(np.isfinite(image.line_px)):
            rows += 1
            here = np.flatnonzero(peaks.row == y) if peaks is not None else np.zeros(0, np.int64)
            if peaks is None or not here.size:
                missed += 1
                continue
            away = peaks.x_px[here] - image.line_px[y]
            k = int(np.abs(away).argmin())
            off.append(float(away[k]))
            ratio.append(float(away[k] / peaks.x_std_px[here[k]]))
            others += here.size - 1
    each = np.array(off)
    near = np.abs(each) <= _FAR_PX
    stated = np.array(ratio)[near]
    holds = (
        "not stated" if np.isnan(stated).all() else number(100.0 * float((np.abs(stated) < 1.96).mean()), 1)
    )
    rms = float(np.sqrt(np.mean(each[near] ** 2))) if near.any() else float("nan")
    return [str(rows), str(missed), str(int((~near).sum())), number(rms, 2), holds, number(others / rows, 2)]


def repeated(found: Sequence[Peaks | None]) -> list[str]:
    """Scatter of a row's centre over the frames, median over the rows, and what is stated of it."""
    x_px, stated = np.full((2, len(found), _WALL_ROWS), np.nan)
    for k, peaks in enumerate(found):
        if peaks is None:
            continue
        inside = (peaks.row < _WALL_ROWS) & (peaks.x_px > _WALL_COLUMNS[0]) & (peaks.x_px < _WALL_COLUMNS[1])
        order = np.flatnonzero(inside)
        order = order[np.argsort(peaks.amplitude[order])]  # the highest of a row is written last
        x_px[k, peaks.row[order]], stated[k, peaks.row[order]] = peaks.x_px[order], peaks.x_std_px[order]
    kept = np.isfinite(x_px).sum(axis=0) > len(found) // 2
    if not kept.any():
        return [number(np.nan, 3), "not stated"]
    away = x_px[:, kept] - np.nanmedian(x_px[:, kept], axis=0)
    away -= np.nanmedian(away, axis=1)[:, None]
    usual = stated[:, kept][np.isfinite(stated[:, kept])]
    return [
        number(float(np.median(np.nanstd(away, axis=0))), 3),
        number(float(np.median(usual)), 2) if usual.size else "not stated",
    ]


def draw(path: Path, image: Known, peaks: Peaks | None) -> None:
    """Draw the known line (blue) and the peaks (red; violet where flagged) over the image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas = cv2.resize(image.picture, None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_NEAREST)
    dots = [(y, x, (255, 64, 0)) for y, x in enumerate(image.line_px) if np.isfinite(x)]
    if peaks is not None:
        violet = peaks.flags != 0
        for y, x, flagged in zip(peaks.row, peaks.x_px, violet, strict=True):
            dots.append((int(y), float(x), (255, 0, 255) if flagged else (0, 0, 255)))
    for y, x, colour in dots:
        cv2.circle(canvas, (round((x + 0.5) * _ZOOM), round((y + 0.5) * _ZOOM)), 1, colour, -1)
    cv2.imwrite(str(path), canvas)


def _read(path: Path) -> NDArray[np.uint8]:
    picture = cv2.imread(str(path))
    if picture is None:
        raise SystemExit(f"{path} cannot be read")
    return np.asarray(picture, np.uint8)


def turntable(channel: str = "grey", contrast: str = "none") -> Iterator[Known]:
    """The scan's frames, by one channel or contrast."""
    home = folder_of("turntable_green")
    for path in sorted((home / "scan").glob("*.jpg")) if home else []:
        picture = _read(path)
        core = picture[:, :, 1] >= _CORE
        line = np.full(core.shape[0], np.nan)
        for y in range(core.shape[0]):
            lit = np.flatnonzero(core[y])
            if lit.size >= _CORE_PX and lit[-1] - lit[0] == lit.size - 1:
                line[y] = lit.mean()
        yield Known(
            path.stem, prepared(picture, turn_deg=0, channel=channel, contrast=contrast), line, picture
        )


def boards(contrast: str = "none", *, subtract: bool = False) -> Iterator[Known]:
    """The red line on the circle boards in room light."""
    home = folder_of("laser_on_circle_grid")
    if home is None:
        return
    for pose in range(POSES):
        dark = _read(home / "calib_picture" / f"calib{pose}.jpg")
        lit = _read(home / "light_picture" / f"light{pose}.jpg")
        line = line_on_board(dark, lit)[::-1]
        yield Known(
            str(pose),
            prepared(lit, turn_deg=90, contrast=contrast, dark=dark if subtract else None),
            line,
            np.rot90(lit).copy(),
        )


def weld() -> Iterator[Known]:
    """The line in the groove, as marked by hand."""
    home = folder_of("weld_mit")
    if home is not None:
        picture = _read(home / "weld2.png")
        frame = prepared(picture, turn_deg=90, channel="max")
        yield Known("weld2", frame, line_of(picture)[::-1], np.rot90(picture).copy())


SETS: dict[str, Callable[[], Iterator[Known]]] = {
    "turntable, green": lambda: turntable(channel="green"),
    "turntable, contrast green": lambda: turntable(contrast="green"),
    "turntable, grey": lambda: turntable(channel="grey"),
    "boards, less the laser-off image": lambda: boards(subtract=True),
    "boards, contrast red": lambda: boards(contrast="red"),
    "weld": weld,
}
