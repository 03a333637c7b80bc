"""Descriptions of calibration targets: what they are, how large, and how well that is known."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeVar, cast, get_args

from pydantic import Field, PositiveFloat, model_validator

from roemetry.config.recipe_file import Section
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError
from roemetry.io.yaml_source import read
from roemetry.records import Block, Board, Pyramid, SpherePlate, Staircase


class BlockFile(Section):
    """A square block: its sides as it lies on the belt."""

    kind: Literal["block"]
    name: str = Field(description="what to call it, e.g. its serial number")
    length_mm: float | None = Field(default=None, gt=0, description="side across the stripes, mm")
    width_mm: float | None = Field(default=None, gt=0, description="side along the stripes, mm")
    height_mm: float | None = Field(default=None, gt=0, description="height, mm")
    tolerance_mm: float = Field(default=0.05, ge=0, description="half width of each side's tolerance, mm")


class BoardFile(Section):
    """A flat board: a ChArUco board, a chessboard, or a grid of circles."""

    kind: Literal["charuco", "chessboard", "circle-grid"]
    name: str = Field(description="what to call it, e.g. its serial number")
    columns: int = Field(ge=3, le=100, description="squares (of a grid: circles) along the board's x")
    rows: int = Field(ge=3, le=100, description="squares (of a grid: circles) along the board's y")
    pitch_mm: float = Field(gt=0, description="side of a square, or from circle to circle, mm")
    marker_mm: float | None = Field(default=None, gt=0, description="side of a ChArUco marker, mm")
    dictionary: str | None = Field(default=None, description="OpenCV's name of the ChArUco markers")
    layout: Literal["auto", "new", "old"] = Field(
        default="auto", description="of a ChArUco board: OpenCV's from 4.6 on, the one before, or found out"
    )
    tolerance_mm: float = Field(
        default=0.1, ge=0, description="half width of the longer side's tolerance, mm"
    )
    flatness_mm: float = Field(default=0.1, ge=0, description="largest distance from a plane, mm")
    thickness_mm: float = Field(default=0.0, ge=0, description="from the print to what it lies on, mm")
    margin_mm: float = Field(
        default=0.0, ge=0, description="white margin around the pattern on which stripes count, too, mm"
    )
    row_pitch_mm: float | None = Field(
        default=None, gt=0, description="pitch along the board's y, mm, where the print is stretched"
    )

    @model_validator(mode="after")
    def _has_markers(self) -> BoardFile:
        if self.kind == "charuco" and (self.marker_mm is None or self.dictionary is None):
            raise ValueError("a ChArUco board needs marker_mm and dictionary")
        if self.marker_mm is not None and self.marker_mm >= self.pitch_mm:
            raise ValueError("marker_mm must be less than pitch_mm")
        return self


class StaircaseFile(Section):
    """Level steps, one behind the other along the stripes."""

    kind: Literal["staircase"]
    name: str = Field(description="what to call it, e.g. its serial number")
    heights_mm: list[PositiveFloat] = Field(
        min_length=1, max_length=50, description="height of each step over the belt, mm"
    )
    tread_mm: float = Field(gt=0, description="extent of a step along the stripes, mm")
    width_mm: float = Field(gt=0, description="side across the stripes, mm")
    tolerance_mm: float = Field(default=0.05, ge=0, description="half width of each height's tolerance, mm")


class PyramidFile(Section):
    """A square pyramid without its top."""

    kind: Literal["truncated-pyramid"]
    name: str = Field(description="what to call it, e.g. its serial number")
    base_mm: float = Field(gt=0, description="side of its base, mm")
    top_mm: float = Field(gt=0, description="side of its top, mm")
    height_mm: float = Field(gt=0, description="from base to top, mm")
    tolerance_mm: float = Field(default=0.05, ge=0, description="half width of each length's tolerance, mm")


class SpherePlateFile(Section):
    """Equal balls on a plate, in a square grid."""

    kind: Literal["sphere-plate"]
    name: str = Field(description="what to call it, e.g. its serial number")
    columns: int = Field(ge=1, le=50, description="balls along x")
    rows: int = Field(ge=1, le=50, description="balls along y")
    pitch_mm: float = Field(gt=0, description="from ball to ball, mm")
    diameter_mm: float = Field(gt=0, description="of a ball, mm")
    centre_height_mm: float = Field(
        gt=-1000, le=1000,
        description="of the balls' centres over the plane beside them, mm; below 0: under the plate's face",
    )  # fmt: skip
    tolerance_mm: float = Field(default=0.02, ge=0, description="half width of each length's tolerance, mm")


TARGET_FILES: tuple[type[Section], ...] = (BlockFile, BoardFile, StaircaseFile, PyramidFile, SpherePlateFile)
"""Every kind of target that can be described."""

TargetFile = BlockFile | BoardFile | StaircaseFile | PyramidFile | SpherePlateFile

_File = TypeVar("_File", bound=Section)


def read_target(path: Path) -> TargetFile:
    """Read a target of any kind; raise ConfigurationError, with the place, where its file is at fault."""
    document = read(path)
    kind = document.data.get("kind") if isinstance(document.data, dict) else None
    by_kind = {
        name: model for model in TARGET_FILES for name in get_args(model.model_fields["kind"].annotation)
    }
    if kind not in by_kind:
        raise ConfigurationError(
            f"{document.place(('kind',))}: kind: found {kind!r}, expected one of {', '.join(by_kind)}",
            hint="the shipped descriptions are in calib_targets/",
        )
    target, faults = checked(by_kind[kind], document.data, document.place)
    if target is None:
        raise ConfigurationError(faults)
    return cast(TargetFile, target)


def read_block(given: str | BlockFile | None, folder: Path) -> Block | None:
    """Give the block; raise ConfigurationError where its file is at fault or a side is not known."""
    found = described(given, folder, BlockFile)
    if found is None:
        return None
    sides = {name: getattr(found, name) for name in ("length_mm", "width_mm", "height_mm")}
    unknown = [name for name, side in sides.items() if side is None]
    if unknown:
        raise ConfigurationError(
            f"the block `{found.name}` has no {' and no '.join(unknown)}",
            hint="measure it with a calliper: the height gives heights, the other two the scale",
        )
    return Block(found.name, **sides, tolerance_mm=found.tolerance_mm)


def read_board(given: str | BoardFile | None, folder: Path) -> Board | None:
    """Give the board; raise ConfigurationError where its file is at fault, as of the targets below."""
    found = described(given, folder, BoardFile)
    return None if found is None else Board(**found.model_dump())


def read_staircase(given: str | StaircaseFile | None, folder: Path) -> Staircase | None:
    """Give the staircase."""
    found = described(given, folder, StaircaseFile)
    if found is None:
        return None
    return Staircase(found.name, tuple(found.heights_mm), found.tread_mm, found.width_mm, found.tolerance_mm)


def read_pyramid(given: str | PyramidFile | None, folder: Path) -> Pyramid | None:
    """Give the truncated pyramid."""
    found = described(given, folder, PyramidFile)
    if found is not None and found.top_mm >= found.base_mm:
        raise ConfigurationError(f"`{found.name}`: its top is no smaller than its base")
    return None if found is None else Pyramid(**found.model_dump(exclude={"kind"}))


def read_sphere_plate(given: str | SpherePlateFile | None, folder: Path) -> SpherePlate | None:
    """Give the sphere plate."""
    found = described(given, folder, SpherePlateFile)
    if found is not None and found.columns * found.rows > 1 and found.diameter_mm >= found.pitch_mm:
        raise ConfigurationError(
            f"`{found.name}`: its balls touch each other: diameter_mm is not below pitch_mm"
        )
    return None if found is None else SpherePlate(**found.model_dump(exclude={"kind"}))


def described(given: str | _File | None, folder: Path, model: type[_File]) -> _File | None:
    """Read the file of a target or pattern, unless it was given; ConfigurationError with all its faults."""
    if not isinstance(given, str):
        return given
    document = read(folder / given)
    target, faults = checked(model, document.data, document.place)
    if target is None:
        raise ConfigurationError(faults)
    return cast(_File, target)
