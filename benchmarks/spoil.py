"""Deliberately damaged calibrations: refused, reported, or missed.

``python -m benchmarks spoil [--rigs FOLDER …] [--sets WORD …] [--kinds WORD …] [--seeds 1 …]``

With ``--record`` each case is written to a file of JSON lines, and cases in the file are not run again.

Sets are folders with a ``boards.yaml`` as `make_rigs` writes them, and the two real sets with a board under a
laser (in the folder ROEMETRY_REAL_DATA). Each is damaged in all ways of `SPOILED`, by its image files, and
goes through all of ``roemetry calibrate``; and each is changed in harmless ways (`SOUND`).

*Refused* and *reported* count if the message names the cause: a refusal must match the kind's words, and a
report must name the cause, or every damaged pose as not used. *Harmless* is what is not reported and need not
be: heights stay within three standard uncertainties, or 0.2 % of the height range, of those of the unchanged
set. All else was *missed*. A single board's pitch cannot be checked by its images: the report must say that
lengths depend on it alone; with the poses divided between two boards it must name the wrong one.
"""

from __future__ import annotations

import copy
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import keep, kept, parser_of
from benchmarks.real_images import folder_of
from benchmarks.tables import Table
from roemetry.calibrating import calibrate_with_evidence
from roemetry.config.rig import Rig, pose_of
from roemetry.errors import RoemetryError
from roemetry.io.yaml_source import dump, read
from roemetry.records import Board, Frame, Peaks
from roemetry.records.calibration import Calibration
from roemetry_pinhole import boards as marks_in_boards
from roemetry_pinhole.boards import BoardMarks, BoardNotFoundError
from roemetry_pinhole.pinhole_plane import lines_at_height, points_of

Image = NDArray[np.uint8]
_LASER, _BOTH = ("board_laser",), ("board", "board_laser")

_OFF_STDS, _OFF_SHARE = 3.0, 0.002  # heights that differ by less are those of the sound set
_POSES_MIN = 3  # of a sound set, beside the first: `pinhole-plane` asks for four


@dataclass
class Shots:
    """A set's rig file and its images, by what they show and by pose; images are read when they change."""

    rig: dict[str, Any]
    images: dict[str, dict[str, Path | Image]]
    named: list[str] = field(default_factory=list)
    """Poses that are not what they should be."""

    def poses(self, rng: np.random.Generator) -> list[str]:
        """Give, in random order, the poses with both images but for the first, which may give the frame."""
        both = [pose for pose in self.images["board"] if pose in self.images["board_laser"]]
        return [str(one) for one in rng.permutation(both[1:])]

    def change(self, shows: str, pose: str, change: Callable[[Image], Image]) -> None:
        """Put a changed image in place of one."""
        self.images[shows][pose] = change(_pixels(self.images[shows][pose]))


def _pixels(image: Path | Image) -> Image:
    if isinstance(image, Path):
        found = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
        if found is None:
            raise SystemExit(f"{image} cannot be read")
        return np.asarray(found, np.uint8)
    return image


Spoil = Callable[[Shots, np.random.Generator], None]


class Kind(NamedTuple):
    """A way to spoil, and the words by which its cause is named."""

    name: str
    spoil: Spoil
    words: str = ""


_MOVED = (
    r"paired|moved|move between|contradict|not one rigid|does not lie in one plane|lie on none of the planes|"
    r"no numbering|exchanged|darker than"
)


def _swap(count: int) -> Spoil:
    """Give each of `count` poses the laser image of the next; 0: all of them."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        """Exchange the laser images of some poses, drawn at random."""
        poses = shots.poses(rng)
        poses = poses[: count or len(poses)]
        laser = shots.images["board_laser"]
        laser.update(zip(poses, [laser[pose] for pose in (*poses[1:], poses[0])], strict=True))
        shots.named += poses

    return spoil


def _each(count: int, shows: tuple[str, ...], change: Callable[[Image], Image]) -> Spoil:
    """Change images of `count` poses; 0: of all."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        poses = shots.poses(rng)
        for pose in poses[: count or len(poses)]:
            for one in shows:
                shots.change(one, pose, change)
            shots.named.append(pose)

    return spoil


def _mirrored(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def _pitch(factor: float) -> Spoil:
    """Describe the one board wrongly."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        _grown(shots.rig["board"], factor)

    return spoil


def _second_pitch(factor: float) -> Spoil:
    """Share the poses out over two boards, of which one is described wrongly."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        """Give half of the poses, drawn at random, to the second board."""
        second = copy.deepcopy(shots.rig["board"]) | {"name": "the second"}
        _grown(second, factor)
        shots.rig["more_boards"] = [{"board": second}]
        others = shots.poses(rng)
        for pose in others[: len(others) // 2]:
            for shows in ("board", "board_laser"):
                shots.images.setdefault(f"second_{shows}", {})[pose] = shots.images[shows].pop(pose)

    return spoil


def _grown(board: dict[str, Any], factor: float) -> None:
    for key in ("pitch_mm", "marker_mm"):
        if key in board:
            board[key] = float(board[key]) * factor


def _shift(count: int, px: float, shows: str) -> Spoil:
    """Move the board between a pose's two images; 0: in all poses."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        poses = shots.poses(rng)
        for pose in poses[: count or len(poses)]:
            way = rng.uniform(0.0, 2.0 * np.pi)
            move = np.array([[1.0, 0.0, px * np.cos(way)], [0.0, 1.0, px * np.sin(way)]])
            shots.change(shows, pose, partial(_warped, move=move))
            shots.named.append(pose)

    return spoil


def _zoomed(image: Image, factor: float) -> Image:
    """Take an image with another camera: of another focal length."""
    rows, columns = image.shape[:2]
    middle = 0.5 * np.array([columns - 1, rows - 1])
    move = np.column_stack([factor * np.eye(2), (1.0 - factor) * middle])
    return _warped(image, move)


def _warped(image: Image, move: NDArray[np.float64]) -> Image:
    size = image.shape[1::-1]
    return np.asarray(
        cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101), np.uint8
    )


def _stripes(more: int) -> Spoil:
    """State another number of stripes; 0: one, or two of one."""

    def spoil(shots: Shots, rng: np.random.Generator) -> None:
        count = int(shots.rig["stripes"])
        shots.rig["stripes"] = (1 if count > 1 else 2) if more == 0 else count + more or count + 1

    return spoil


def _one_plane(shots: Shots, rng: np.random.Generator) -> None:
    """Leave five poses, all in one plane: one of them, shifted by some pixels."""
    kept = shots.poses(rng)[:5]
    reference = next(iter(shots.images["board"]))
    if reference in shots.images["board_laser"]:
        kept = [reference, *kept[:4]]
    for shows in ("board", "board_laser"):
        first = _pixels(shots.images[shows][kept[0]])
        shots.images[shows] = {kept[0]: first}
        for number, pose in enumerate(kept[1:]):
            way = 3.0 + 2.0 * number
            moved = _warped(first, np.array([[1.0, 0.0, way], [0.0, 1.0, -0.5 * way]]))
            shots.images[shows][pose] = moved
    for shows in ("board_on_belt", "board_on_belt_laser"):
        shots.images.pop(shows, None)
    shots.named = kept


_PITCH_ALONE = r"rest on the pitch of one board alone|its `pitch_mm` and `thickness_mm` right"
_TWO_BOARDS = r"the second.*contradict each other|contradict each other.*the second"
_STRIPES = r"stripes?\W.*(seen|expected|fits|boards)|planes of light are"
_CAMERA = rf"{_MOVED}|another camera|one camera|marks are off|do not fit|not noise"

SPOILED = (
    Kind("two laser images exchanged", _swap(2), _MOVED),
    Kind("three laser images exchanged", _swap(3), _MOVED),
    Kind("half of the laser images exchanged", _swap(5), _MOVED),
    Kind("each laser image that of another pose", _swap(0), _MOVED),
    Kind("one pose mirrored", _each(1, _BOTH, _mirrored), rf"mirror|{_MOVED}"),
    Kind("two poses mirrored", _each(2, _BOTH, _mirrored), rf"mirror|{_MOVED}"),
    Kind("three laser images mirrored", _each(3, _LASER, _mirrored), rf"mirror|{_MOVED}"),
    Kind("all laser images mirrored", _each(0, _LASER, _mirrored), rf"mirror|{_MOVED}"),
    Kind("pitch 1 % wrong, one board", _pitch(1.01), _PITCH_ALONE),
    Kind("pitch 2 % wrong, one board", _pitch(0.98), _PITCH_ALONE),
    Kind("pitch 10 % wrong, one board", _pitch(1.1), _PITCH_ALONE),
    Kind("second board's pitch 1 % wrong", _second_pitch(1.01), _TWO_BOARDS),
    Kind("second board's pitch 2 % wrong", _second_pitch(0.98), _TWO_BOARDS),
    Kind("second board's pitch 10 % wrong", _second_pitch(1.1), _TWO_BOARDS),
    Kind("board moved by 3 px in two poses", _shift(2, 3.0, "board"), _MOVED),
    Kind("board moved by 12 px in three poses", _shift(3, 12.0, "board_laser"), _MOVED),
    Kind("board moved by 6 px in all poses", _shift(0, 6.0, "board"), _MOVED),
    Kind("board moved by 25 px in all poses", _shift(0, 25.0, "board_laser"), _MOVED),
    Kind("stripes: 1, or 2 of 1", _stripes(0), _STRIPES),
    Kind("one stripe too many", _stripes(1), _STRIPES),
    Kind("one stripe too few", _stripes(-1), _STRIPES),
    Kind("two poses by another camera", _each(2, _BOTH, partial(_zoomed, factor=1.06)), _CAMERA),
    Kind("four poses by another camera", _each(4, _BOTH, partial(_zoomed, factor=0.9)), _CAMERA),
    Kind("laser images by another camera", _each(0, _LASER, partial(_zoomed, factor=1.06)), _CAMERA),
    Kind("three laser images by another camera", _each(3, _LASER, partial(_zoomed, factor=0.92)), _CAMERA),
    Kind("five poses of one plane", _one_plane, r"variety|tilted|poses"),
)


def _without(count: int) -> Spoil:
    def change(shots: Shots, rng: np.random.Generator) -> None:
        poses = shots.poses(rng)
        for pose in poses[: min(count, max(len(poses) - _POSES_MIN, 0))]:
            for shows in _BOTH:
                del shots.images[shows][pose]

    return change


def _everywhere(change_of: Callable[[Image, np.random.Generator], Image]) -> Spoil:
    def change(shots: Shots, rng: np.random.Generator) -> None:
        for shows, images in shots.images.items():
            for pose in images:
                shots.change(shows, pose, lambda image: change_of(image, rng))

    return change


def _noisier(image: Image, rng: np.random.Generator) -> Image:
    return np.asarray((image + rng.normal(0.0, 1.0, image.shape)).clip(0, 255), np.uint8)


def _as_jpeg(image: Image, rng: np.random.Generator) -> Image:
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED), np.uint8)


def _darker(image: Image, rng: np.random.Generator) -> Image:
    return np.asarray(0.85 * image, np.uint8)


SOUND = (
    Kind("as it is", lambda shots, rng: None),
    Kind("one pose fewer", _without(1)),
    Kind("two poses fewer", _without(2)),
    Kind("three poses fewer", _without(3)),
    Kind("two boards, both right", _second_pitch(1.0)),
    Kind("as JPEG", _everywhere(_as_jpeg)),
    Kind("more noise", _everywhere(_noisier)),
    Kind("darker", _everywhere(_darker)),
)


class Outcome(NamedTuple):
    """The result for a set: its class, the message, and how far heights are off, mm."""

    word: str
    why: str
    off_mm: float


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--rigs", type=Path, nargs="*", default=[], help="folders with a boards.yaml")
    parser.add_argument("--sets", nargs="*", default=[], help="only sets whose name holds a word")
    parser.add_argument("--kinds", nargs="*", default=[], help="only kinds whose name holds a word")
    parser.add_argument("--seeds", type=int, nargs="*", default=[1], help="which poses are spoiled")
    parser.add_argument("--record", type=Path, help="file of JSON lines: cases that are done, added to")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    _remember()
    done = {(one.pop("set"), one.pop("kind"), one.pop("seed")): Outcome(**one) for one in kept(given.record)}
    names = []
    for name, shots in _sets(given.rigs):
        if not _chosen(name, given.sets):
            continue
        names.append(name)
        cases = [
            (number, kind, seed)
            for number, kind in enumerate((*SPOILED, *SOUND))
            for seed in given.seeds
            if _chosen(kind.name, given.kinds) and (name, kind.name, seed) not in done
        ]
        sound = _calibrated(shots) if cases else ""
        if isinstance(sound, str):
            print(f"{name}: as it is it gives no calibration: {sound}" * bool(cases), flush=True)
            continue
        for number, kind, seed in cases:
            begin = time.perf_counter()
            changed = replace(shots, rig=copy.deepcopy(shots.rig), named=[])
            changed.images = {shows: dict(images) for shows, images in shots.images.items()}
            kind.spoil(changed, np.random.default_rng([seed, number]))
            found = judged(kind, _calibrated(changed), sound[0], changed.named)
            done[name, kind.name, seed] = found
            keep(given.record, {"set": name, "kind": kind.name, "seed": seed, **found._asdict()})
            print(
                f"{name}: {kind.name}, {seed}: {found.word} ({time.perf_counter() - begin:.0f} s), "
                f"{found.off_mm:.3f} mm: {found.why[:400]}",
                flush=True,
            )
    done = {of: found for of, found in done.items() if of[0] in names and of[2] in given.seeds}
    for kinds in (SPOILED, SOUND):
        print(_table([kind for kind in kinds if _chosen(kind.name, given.kinds)], done))


def _chosen(name: str, words: list[str]) -> bool:
    return not words or any(word in name for word in words)


def _table(kinds: list[Kind], done: Mapping[tuple[str, str, int], Outcome]) -> Table:
    words = ("refused", "reported", "harmless", "missed", "other words")
    rows = []
    for kind in kinds:
        found = [outcome.word for (_, name, _), outcome in done.items() if name == kind.name]
        rows.append([kind.name, *(str(found.count(word)) for word in words)])
    rows.append(["all", *(str(sum(int(row[n]) for row in rows)) for n in range(1, len(words) + 1))])
    title = "Harmless" if set(kinds) <= set(SOUND) else "Damaged"
    names = dict.fromkeys(name for name, _, _ in done)
    return Table(f"{title}: {', '.join(names)}", ["", *words], rows)


def judged(
    kind: Kind, found: tuple[Calibration, str] | str, sound: Calibration, spoiled: list[str]
) -> Outcome:
    """Classify the result for a damaged or harmlessly changed set."""
    sound_set = kind in SOUND
    if isinstance(found, str):
        right = sound_set or re.search(kind.words, found, re.DOTALL) is not None
        return Outcome("refused" if right else "other words", found, float("nan"))
    calibration = found[0]
    off_mm, near = off_by(calibration, sound)
    # notes that the unchanged set has as well report nothing
    usual = {re.sub(r"[\d.]+", "", note) for note in sound.notes} if kind.words != _PITCH_ALONE else set()
    said = " | ".join(one for one in calibration.notes if re.sub(r"[\d.]+", "", one) not in usual)
    if sound_set:
        return Outcome("harmless" if near else "missed", said, off_mm)
    named = [pose for pose in spoiled if re.search(rf"(not used: |between ).*?[fn]_{pose}\.", said)]
    if (spoiled and len(named) == len(spoiled)) or re.search(kind.words, said.replace("\n", " ")):
        return Outcome("reported", said, off_mm)
    return Outcome("harmless" if near else "missed", said, off_mm)


def off_by(calibration: Calibration, sound: Calibration) -> tuple[float, bool]:
    """Give the largest difference of heights, mm, and whether it is within what is allowed."""
    if calibration.stripe_count != sound.stripe_count:
        return float("inf"), False
    low, high = sound.height_range_mm
    rows = np.linspace(0.2, 0.8, 3) * (sound.image_size[0] - 1)
    worst, near = 0.0, True
    for z_mm in np.linspace(low, high, 3):
        x_px = lines_at_height(sound.parameters, rows, float(z_mm))
        stripe, row = np.nonzero(np.isfinite(x_px) & (x_px > 0) & (x_px < sound.image_size[1]))
        places = stripe, x_px[stripe, row], rows[row]
        off = points_of(calibration.parameters, *places)[:, 2] - points_of(sound.parameters, *places)[:, 2]
        redrawn = [points_of(drawn.parameters, *places)[:, 2] for drawn in _some(sound)]
        limit = np.hypot(_OFF_STDS * np.std(redrawn, axis=0) * np.sqrt(2.0), _OFF_SHARE * (high - low))
        worst = max(worst, float(np.nanmax(np.abs(off), initial=0.0)))
        near &= bool((np.abs(off) <= limit).all())
    return worst, near


def _some(calibration: Calibration) -> list[Calibration]:
    redraws = calibration.redraws(np.random.default_rng(1), lambda drawn: drawn.view)
    return [next(redraws) for _ in range(20)]


def _calibrated(shots: Shots) -> tuple[Calibration, str] | str:
    """Give the calibration and its verdict as the command line would write it, or why it refuses."""
    with tempfile.TemporaryDirectory() as place:
        rig = Rig.load(_written(shots, Path(place)))
        try:
            remembering: Any = _Remembering(rig.extractor)
            calibration, evidence = calibrate_with_evidence(replace(rig, extractor=remembering))
        except RoemetryError as error:
            return str(error)
    verdict = " ".join(evidence.verdict)
    return (calibration, verdict) if evidence.usable else "\n".join([verdict, *calibration.notes])


def _written(shots: Shots, folder: Path) -> Path:
    rig = copy.deepcopy(shots.rig)
    rig["images"] = {}
    for shows, images in shots.images.items():
        paths = []
        for pose, image in images.items():
            laser = shows.endswith("laser") or not shows.startswith(("board", "second"))
            path = folder / shows / f"{'on' if laser else 'off'}_{pose}"
            path.parent.mkdir(exist_ok=True)
            if isinstance(image, Path):
                path = path.with_suffix(image.suffix)
                path.symlink_to(image)
            else:
                path = path.with_suffix(".png")
                cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            paths.append(str(path))
        if shows.startswith("second_"):
            rig["more_boards"][0].setdefault("images", {})[shows.removeprefix("second_")] = paths
        else:
            rig["images"][shows] = paths
    (folder / "rig.yaml").write_text(dump(rig), encoding="utf-8")
    return folder / "rig.yaml"


def _sets(rigs: list[Path]) -> Iterator[tuple[str, Shots]]:
    for folder in rigs:
        rig = dict(read(folder / "boards.yaml").data)
        yield folder.name, _shots(rig, folder)
    circles, turntable = folder_of("laser_on_circle_grid"), folder_of("turntable_green")
    if circles is not None:
        yield "circle grids", _shots(CIRCLES, circles)
    if turntable is not None:
        yield "turntable", _shots(TURNTABLE, turntable)


def _shots(rig: Mapping[str, Any], folder: Path) -> Shots:
    images: dict[str, dict[str, Path | Image]] = {}
    for shows, patterns in rig["images"].items():
        paths = [path for pattern in patterns for path in sorted(folder.resolve().glob(pattern))]
        images[shows] = dict(sorted(((pose_of(path), path) for path in paths), key=lambda one: one[0]))
    return Shots({key: value for key, value in rig.items() if key != "images"}, images)


CIRCLES = {
    "roemetry_rig": 1,
    "name": "laser on circle grid",
    "stripes": 1,
    "turn_deg": 90,
    "board": {"kind": "circle-grid", "name": "grid", "columns": 7, "rows": 7, "pitch_mm": 37.5},
    "images": {"board": ["calib_picture/*.jpg"], "board_laser": ["light_picture/*.jpg"]},
    "extractor": "fir-zero-crossing",
    "calibrator": {
        "use": "pinhole-plane", "options": {"reference_pose": "0", "print_contrast_max": 0.85}
    },
}  # fmt: skip
TURNTABLE = {
    "roemetry_rig": 1,
    "name": "turntable, one green line",
    "stripes": 1,
    "contrast": "green",
    "board": {
        "kind": "chessboard", "name": "hand-held", "columns": 9, "rows": 7, "pitch_mm": 40.0,
        "margin_mm": 60.0,
    },
    "images": {"board": ["boards/*.jpg"], "board_laser": ["boards_laser/*.jpg"]},
    "extractor": "maximum-likelihood",
    "calibrator": {"use": "pinhole-plane", "options": {"reference_pose": "22"}},
}  # fmt: skip


class _Remembering:
    """A rig's extractor that keeps what it found: most images of a spoiled set are those of the sound one."""

    _found: ClassVar[dict[tuple[str, int], Peaks]] = {}

    def __init__(self, chosen: Any) -> None:
        self._chosen = chosen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._chosen, name)

    def make(self) -> _Remembering:
        self._stage = self._chosen.make()
        return self

    def extract(self, frame: Frame) -> Peaks:
        key = f"{self._chosen.described()}", hash(frame.pixels.tobytes())
        if key not in self._found:
            self._found[key] = self._stage.extract(frame)
        return self._found[key]


def _remember() -> None:
    """Look for each board in each image once."""
    find = marks_in_boards.find_marks
    kept: dict[tuple[int, Board], BoardMarks | BoardNotFoundError] = {}

    def find_marks(frame: Frame, board: Board) -> BoardMarks:
        """Find a board, or say again why it cannot be used."""
        key = hash(frame.pixels.tobytes()), board
        if key not in kept:
            try:
                kept[key] = find(frame, board)
            except BoardNotFoundError as error:
                kept[key] = error
        found = kept[key]
        if isinstance(found, BoardNotFoundError):
            raise found
        return found

    marks_in_boards.find_marks = find_marks
