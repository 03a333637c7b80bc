"""The rig file: what `roemetry calibrate` looks at."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import Field, model_validator

from roemetry.config.overrides import Overridden
from roemetry.config.pattern_file import PatternFile, read_pattern
from roemetry.config.recipe_file import (
    Channel,
    Choice,
    Colour,
    Contrast,
    Section,
    SensorFile,
    StageChoice,
    Turn,
    check_channels,
)
from roemetry.config.resolve import ResolvedStage, StageResolver
from roemetry.config.target_file import (
    BlockFile,
    BoardFile,
    PyramidFile,
    SpherePlateFile,
    StaircaseFile,
    read_block,
    read_board,
    read_pyramid,
    read_sphere_plate,
    read_staircase,
)
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.io.files import is_file
from roemetry.io.yaml_source import read
from roemetry.records import Block, Board, Pyramid, Ruler, Sensor, SpherePlate, Staircase
from roemetry.records.display import table
from roemetry.stages.registry import Registry, discover

_Target = TypeVar("_Target")


class CalibrationImages(Section):
    """Images by what lies on the belt; paths or patterns relative to the rig file."""

    block: list[str] = Field(default_factory=list, description="the block under the stripes")
    belt: list[str] = Field(default_factory=list, description="the empty belt")
    staircase: list[str] = Field(default_factory=list, description="the staircase under the stripes")
    pyramid: list[str] = Field(default_factory=list, description="the truncated pyramid under the stripes")
    sphere_plate: list[str] = Field(default_factory=list, description="the sphere plate under the stripes")
    board: list[str] = Field(default_factory=list, description="the board in many poses, laser off")
    board_laser: list[str] = Field(default_factory=list, description="the board in these poses, laser on")
    board_on_belt: list[str] = Field(
        default_factory=list, description="the board lying on the belt, laser off"
    )
    board_on_belt_laser: list[str] = Field(
        default_factory=list, description="the board lying on the belt, laser on"
    )


class BoardImages(Section):
    """Images of a further board; paths or patterns as in `CalibrationImages`."""

    board: list[str] = Field(default_factory=list, description="in many poses, laser off")
    board_laser: list[str] = Field(default_factory=list, description="in these poses, laser on")


class FurtherBoard(Section):
    """A board beside the first, of any kind, with its images."""

    board: str | BoardFile = Field(description="the board's description: a file, or the board itself")
    images: BoardImages


class RulerFile(Section):
    """A length of the board's sheet, as it should be and as it is."""

    printed_mm: float = Field(gt=0, description="what it should be, e.g. that of the sheet's own ruler, mm")
    measured_mm: float = Field(gt=0, description="what a steel ruler or a calliper measures, mm")
    std_mm: float = Field(default=0.2, gt=0, description="standard uncertainty of that, mm")


class RigScan(Section):
    """One pass of the pyramid or the sphere plate through the light, from which the belt's motion comes."""

    path: str = Field(description="the scan, as the source reads it; relative to the rig file")
    source: Choice = Field(
        default_factory=lambda: StageChoice(use="belt-scan"), description="what reads its lines"
    )
    coder: Choice = Field(
        default_factory=lambda: StageChoice(use="single"),
        description="what follows its stripes, as in the recipe",
    )
    assembler: Choice = Field(
        default_factory=lambda: StageChoice(use="belt-motion"), description="what measures the motion"
    )
    runs: Literal["right", "left"] = Field(
        default="right",
        description="where the belt carries things in the (turned) image while the counter counts up",
    )
    base: str | None = Field(
        default=None,
        description="calibration that the motion is added to; default: the one that this rig's images make",
    )


class RigFile(Section):
    """What is calibrated, from what."""

    roemetry_rig: Literal[1] = Field(description="version of the rig format")
    name: str = Field(min_length=1, description="what to call the rig")
    pattern: str | PatternFile | None = Field(
        default=None,
        description="the light's pattern, a file or the pattern itself: it says `stripes` and lines along Y",
    )
    stripes: int | None = Field(
        default=None,
        ge=1,
        le=200,
        description="number of stripes the laser projects; needed where an image shows them",
    )
    channel: Channel = Field(default="grey", description="what to make of a colour image")
    second_channel: Colour | None = Field(default=None, description="as in the recipe")
    contrast: Contrast = Field(
        default="none",
        description="instead of a channel: that of the laser's colour, less the lamp light that others show",
    )
    turn_deg: Turn = Field(default=0, description="counter-clockwise turn, degrees, as in the recipe")
    bit_depth: int | None = Field(
        default=None, ge=1, le=16, description="bits in use; default: all that the files' pixels have"
    )
    sensor: SensorFile | None = Field(default=None, description="the camera's noise, as in the recipe")
    working_distance_mm: float | None = Field(
        default=None, gt=0, description="camera (its entrance pupil) to belt, mm; leave out if unknown"
    )
    target: str | BlockFile | None = Field(default=None, description="a target's file, or the target itself")
    board: str | BoardFile | None = Field(
        default=None, description="the board's description: a file, or the board itself"
    )
    more_boards: list[FurtherBoard] = Field(
        default_factory=list,
        description="further boards with their images: they help, and check the first one's scale",
    )
    staircase: str | StaircaseFile | None = Field(
        default=None, description="the staircase's description: a file, or the staircase itself"
    )
    pyramid: str | PyramidFile | None = Field(
        default=None, description="the truncated pyramid's description: a file, or the pyramid itself"
    )
    sphere_plate: str | SpherePlateFile | None = Field(
        default=None, description="the sphere plate's description: a file, or the plate itself"
    )
    ruler: RulerFile | None = Field(
        default=None, description="a length of the board's print, measured with a ruler"
    )
    encoder_counts: list[float] = Field(
        default_factory=list,
        description="of the images in board_on_belt, in their order, if the belt carries the board along",
    )
    encoder_mm_per_count: float | None = Field(
        default=None,
        gt=0,
        description="the belt's way per encoder count, mm, where it is known from elsewhere",
    )
    encoder_mm_per_count_std: float = Field(default=0.0, ge=0, description="its standard uncertainty, mm")
    images: CalibrationImages | None = Field(
        default=None, description="what the calibrator looks at; needed unless `scan.base` is given"
    )
    scan: RigScan | None = Field(
        default=None, description="a scan of the pyramid or the sphere plate: how the belt runs"
    )
    extractor: Choice = Field(
        default_factory=lambda: StageChoice(use="maximum-likelihood"),
        description="what finds the stripes' peaks",
    )
    calibrator: Choice = Field(default_factory=lambda: StageChoice(use="block-linear"))

    @model_validator(mode="after")
    def _is_one_way_to_colours(self) -> RigFile:
        check_channels(self.channel, self.second_channel, self.contrast)
        return self


@dataclass(frozen=True, repr=False)
class Rig:
    """A checked rig file, its target read, its classes imported."""

    path: Path
    file: RigFile
    block: Block | None
    board: Board | None
    staircase: Staircase | None
    pyramid: Pyramid | None
    sphere_plate: SpherePlate | None
    images: dict[str, list[Path]]
    extractor: ResolvedStage
    calibrator: ResolvedStage
    more_boards: tuple[tuple[Board, dict[str, list[Path]]], ...] = ()
    """Further boards, each with its images as in `images`."""
    scan_source: ResolvedStage | None = None
    scan_coder: ResolvedStage | None = None
    scan_assembler: ResolvedStage | None = None
    """scan_source, scan_coder, scan_assembler: what reads and places the scan, where there is one."""

    def __repr__(self) -> str:
        """Give one line: the rig's name, its stages, and how many images of what it has."""
        return f"Rig({str(self.path)!r}, {', '.join(': '.join(row) for row in self._rows())})"

    def _repr_html_(self) -> str:
        """Give its stages and how many images of what it has as a table, for notebooks."""
        return table(self.file.name, self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        images = ", ".join(f"{len(paths)} {shows}" for shows, paths in self.images.items() if paths)
        stages = [("extractor", repr(self.extractor)), ("calibrator", repr(self.calibrator))]
        return [*stages, ("stripes", str(self.file.stripes or "not stated")), ("images", images or "none")]

    @property
    def ruler(self) -> Ruler | None:
        """What a ruler measured of the board's print, where the file states it."""
        return None if self.file.ruler is None else Ruler(**self.file.ruler.model_dump())

    @property
    def sensor(self) -> Sensor | None:
        """The camera's noise, where the file states it."""
        return None if self.file.sensor is None else Sensor(**self.file.sensor.model_dump())

    @classmethod
    def load(cls, path: Path | str, *, sets: Sequence[str] = (), registry: Registry | None = None) -> Rig:
        """Read and check a rig file; raise ConfigurationError with every fault, each with its place."""
        path = Path(path)
        document = Overridden(read(path), sets)
        file, faults = checked(RigFile, document.data, document.place)
        if file is None:
            raise ConfigurationError(faults)
        chooser = StageResolver(registry or discover(), document.place, path.parent)
        folder = path.parent
        pattern = None
        if file.pattern is not None:
            told = file.pattern
            pattern = _asked(chooser, "pattern", lambda: read_pattern(told, folder))
        if pattern is not None:
            file = _with_pattern(file, pattern, chooser)
        extractor = chooser.choose("extractor", file.extractor, "extractor")
        calibrator = chooser.choose("calibrator", file.calibrator, "calibrator")
        for key, chosen in (("extractor", extractor), ("calibrator", calibrator)):
            if pattern is not None and chosen is not None:
                light = chosen.stage.capabilities.pattern
                if light != pattern.light:
                    said = (
                        f"`{chosen.registered.entry.name}` is made for {light}, the pattern is {pattern.kind}"
                    )
                    chooser.fault(said, key)
        images = _images(folder, file.images or CalibrationImages(), chooser, ("images",))
        more: list[tuple[Board, dict[str, list[Path]]]] = []
        for number, one in enumerate(file.more_boards):
            at = ("more_boards", number, "images")
            found = _asked(chooser, "more_boards", partial(read_board, one.board, folder))
            theirs = _images(folder, one.images, chooser, at)
            for shows, paths in theirs.items():
                _poses_differ(paths, chooser, *at, shows)
            if found is not None:
                more.append((found, theirs))
        block = _asked(chooser, "target", lambda: read_block(file.target, folder))
        board = _asked(chooser, "board", lambda: read_board(file.board, folder))
        staircase = _asked(chooser, "staircase", lambda: read_staircase(file.staircase, folder))
        pyramid = _asked(chooser, "pyramid", lambda: read_pyramid(file.pyramid, folder))
        spheres = _asked(chooser, "sphere_plate", lambda: read_sphere_plate(file.sphere_plate, folder))
        for shows in ("board", "board_laser", "board_on_belt", "board_on_belt_laser"):
            _poses_differ(images[shows], chooser, "images", shows)
        if more and board is None:
            chooser.fault("there are more_boards, and no `board` from which lengths come", "more_boards")
        counts = file.encoder_counts
        if counts and len(counts) != len(images["board_on_belt"]):
            chooser.fault(
                f"{len(counts)} counts for {len(images['board_on_belt'])} images in images.board_on_belt",
                "encoder_counts",
            )
        scan = file.scan
        if (
            file.stripes is None
            and file.pattern is None
            and (scan is not None or _with_laser(images, *(theirs for _, theirs in more)))
        ):
            chooser.fault("this is missing", "stripes")
        if file.images is None and (scan is None or scan.base is None):
            chooser.fault("this is missing", "images")
        for_scan = {
            f"scan_{kind}": None if scan is None else chooser.choose(kind, getattr(scan, kind), "scan", kind)
            for kind in ("source", "coder", "assembler")
        }
        if chooser.faults or extractor is None or calibrator is None:
            raise ConfigurationError(chooser.faults)
        return cls(
            path,
            file,
            block,
            board,
            staircase,
            pyramid,
            spheres,
            images,
            extractor,
            calibrator,
            tuple(more),
            **for_scan,
        )


def _with_pattern(file: RigFile, pattern: PatternFile, chooser: StageResolver) -> RigFile:
    """Give the rig with what its pattern says of stripes and calibrator."""
    if file.stripes not in (None, pattern.stripes):
        has = f"{pattern.lines_x} lines along X"
        if pattern.stripes != pattern.lines_x:
            has = f"{pattern.stripes} halves of circles"
        chooser.fault(f"the pattern has {has}, `stripes` says {file.stripes}", "stripes")
    calibrator = _asked(chooser, "calibrator", lambda: pattern.calibrated_by(file.calibrator))
    return file.model_copy(update={"stripes": pattern.stripes, "calibrator": calibrator or file.calibrator})


def _with_laser(*images: dict[str, list[Path]]) -> bool:
    return any(
        paths for each in images for shows, paths in each.items() if shows not in ("board", "board_on_belt")
    )


def _images(
    folder: Path, asked: Section, chooser: StageResolver, at: tuple[str | int, ...]
) -> dict[str, list[Path]]:
    """Give the files of each kind, in order."""
    return {
        shows: [
            found
            for index, pattern in enumerate(patterns)
            for found in _found(folder, pattern, chooser, *at, shows, index)
        ]
        for shows, patterns in asked.model_dump().items()
    }


def _found(folder: Path, pattern: str, chooser: StageResolver, *at: str | int) -> list[Path]:
    try:
        whole = folder.absolute() / pattern  # an absolute pattern leaves nothing of the folder
        found = sorted(Path(whole.anchor).glob(str(whole.relative_to(whole.anchor))), key=_in_order)
    except (OSError, ValueError):  # a name that no file system takes
        found = []
    found = [file for file in found if is_file(file)]
    if not found:
        chooser.fault(f"there is no file {folder / pattern}", *at)
    return found


def pose_of(path: Path) -> str:
    """Tell a board's pose by the numbers in its file's name: ``calib07.png``, ``light_7.png`` show one."""
    numbers = re.findall(r"\d+", path.stem)
    return "-".join(str(int(number)) for number in numbers) or path.stem


def _in_order(path: Path) -> tuple[tuple[int, str], ...]:
    """By name, with numbers in it taken as numbers: 2 before 10."""
    parts = re.split(r"(\d+)", path.name)
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in parts)


def _poses_differ(paths: list[Path], chooser: StageResolver, *at: str | int) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        other = seen.setdefault(pose_of(path), path)
        if other != path:
            chooser.fault(
                f"{other.name} and {path.name} hold the same numbers: the number in a file's name tells "
                "the pose, which pairs images with the laser on and off",
                *at,
            )


def _asked(chooser: StageResolver, key: str, read_it: Callable[[], _Target]) -> _Target | None:
    try:
        return read_it()
    except RoemetryError as error:
        chooser.fault(str(error), key)
        return None
