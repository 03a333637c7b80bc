"""The rig file: what `roemetry calibrate` looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from roemetry.choosing import Chooser, Chosen
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.overrides import Overridden
from roemetry.recipe_file import Channel, Choice, Section, SensorFile, StageChoice, Turn
from roemetry.records import Block, Sensor
from roemetry.registry import Registry, discover
from roemetry.validation import checked
from roemetry.yaml_source import read


class BlockFile(Section):
    """A square block: its sides as it lies on the belt."""

    kind: Literal["block"]
    name: str = Field(description="what to call it, e.g. its serial number")
    length_mm: float | None = Field(default=None, gt=0, description="side across the stripes, mm")
    width_mm: float | None = Field(default=None, gt=0, description="side along the stripes, mm")
    height_mm: float | None = Field(default=None, gt=0, description="height, mm")
    tolerance_mm: float = Field(default=0.05, ge=0, description="half width of each side's tolerance, mm")


class CalibrationImages(Section):
    """Images by what lies on the belt; paths or patterns relative to the rig file."""

    block: list[str] = Field(default_factory=list, description="the block under the stripes")
    belt: list[str] = Field(default_factory=list, description="the empty belt")


class RigFile(Section):
    """What is calibrated, from what."""

    roemetry_rig: Literal[1] = Field(description="version of the rig format")
    name: str = Field(min_length=1, description="what to call the rig")
    stripes: int = Field(ge=1, le=200, description="number of stripes the laser projects")
    channel: Channel = Field(default="grey", description="what to make of a colour image")
    turn_deg: Turn = Field(default=0, description="counter-clockwise turn, degrees, as in the recipe")
    bit_depth: int | None = Field(
        default=None, ge=1, le=16, description="bits in use; default: all that the files' pixels have"
    )
    sensor: SensorFile | None = Field(default=None, description="the camera's noise, as in the recipe")
    working_distance_mm: float | None = Field(
        default=None, gt=0, description="camera (its entrance pupil) to belt, mm; leave out if unknown"
    )
    target: str | BlockFile | None = Field(default=None, description="a target's file, or the target itself")
    images: CalibrationImages
    extractor: Choice
    calibrator: Choice = Field(default_factory=lambda: StageChoice(use="block-linear"))


@dataclass(frozen=True)
class Rig:
    """A checked rig file, its target read, its classes imported."""

    path: Path
    file: RigFile
    block: Block | None
    images: dict[str, list[Path]]
    extractor: Chosen
    calibrator: Chosen

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
        chooser = Chooser(registry or discover(), document.place, path.parent)
        extractor = chooser.choose("extractor", file.extractor, "extractor")
        calibrator = chooser.choose("calibrator", file.calibrator, "calibrator")
        images = {
            shows: [
                found
                for index, pattern in enumerate(patterns)
                for found in _found(path.parent, pattern, chooser, shows, index)
            ]
            for shows, patterns in file.images.model_dump().items()
        }
        block = None
        try:
            block = _block(file.target, path.parent)
        except RoemetryError as error:
            chooser.fault(str(error), "target")
        if chooser.faults or extractor is None or calibrator is None:
            raise ConfigurationError(chooser.faults)
        return cls(path, file, block, images, extractor, calibrator)


def _found(folder: Path, pattern: str, chooser: Chooser, shows: str, index: int) -> list[Path]:
    found = sorted(folder.glob(pattern)) if not Path(pattern).is_absolute() else [Path(pattern)]
    found = [file for file in found if file.is_file()]
    if not found:
        chooser.fault(f"there is no file {folder / pattern}", "images", shows, index)
    return found


def _block(target: str | BlockFile | None, folder: Path) -> Block | None:
    if target is None:
        return None
    described = target
    if isinstance(described, str):
        document = read(folder / described)
        described, faults = checked(BlockFile, document.data, document.place)
        if described is None:
            raise ConfigurationError(faults)
    sides = (described.length_mm, described.width_mm, described.height_mm)
    unknown = [
        name for name, side in zip(("length_mm", "width_mm", "height_mm"), sides, strict=True) if side is None
    ]
    if unknown:
        raise ConfigurationError(
            f"the block `{described.name}` has no {' and no '.join(unknown)}",
            hint="measure it with a calliper: the height gives heights, the other two the scale",
        )
    length_mm, width_mm, height_mm = (float(side) for side in sides if side is not None)
    return Block(described.name, length_mm, width_mm, height_mm, described.tolerance_mm)
