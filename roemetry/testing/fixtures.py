"""What a stage needs and the kit cannot make: given by the function its capabilities name."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.config.dataset import DatasetWriter, Description, Item
from roemetry.errors import PluginError
from roemetry.records import Block, CalibrationSet, Observation
from roemetry.records.calibration import Calibration
from roemetry.stages import Calibrator, Source, Stage, Triangulator
from roemetry.testing.scenes import SEED, LinearRig, frame_of

BLOCK = Block("block", length_mm=100.0, width_mm=30.0, height_mm=8.0, tolerance_mm=0.05)
SUITED = (Calibrator, Source, Triangulator)


def made(cls: type[Stage[Any]], options: Mapping[str, Any] | None = None) -> Stage[Any]:
    """Make a stage with these options, else with those its fixture gives, else with its default ones."""
    if options is not None:
        return cls(cls.Options.model_validate(options))
    given = fixture_of(cls)
    return cls() if given is None or issubclass(cls, SUITED) else cls(given())


def fixture_of(cls: type[Stage[Any]]) -> Callable[..., Any] | None:
    """Import the function that a stage's capabilities name; None where they name none.

    Raises
    ------
    PluginError
        There is no such function.
    """
    target = cls.capabilities.fixture
    if not target:
        return None
    module, _, name = target.partition(":")
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise PluginError(f"{cls.__name__}.capabilities.fixture `{target}`: {error}") from error
    return found


def calibration_for(triangulator: Triangulator[Any], rig: LinearRig) -> Calibration:
    """Give the rig's calibration in the form the triangulator understands."""
    given = fixture_of(type(triangulator))
    calibration: Calibration = rig.calibration() if given is None else given(rig)
    return calibration


def calibration_set_for(calibrator: Calibrator[Any], rig: LinearRig) -> CalibrationSet:
    """Give observations of the rig that suit the calibrator: by default an empty belt and a block."""
    given = fixture_of(type(calibrator))
    observed: CalibrationSet = block_set(rig) if given is None else given(rig)
    return observed


def block_set(rig: LinearRig) -> CalibrationSet:
    """Give images of the empty belt and of a block under all stripes, with exact peaks.

    The camera is so far away that the scale does not depend on height.
    """
    y_mm = (rig.middle_row - np.arange(rig.rows)) * rig.mm_per_px
    on_block = np.abs(y_mm) < BLOCK.width_mm / 2.0
    block = np.where(on_block, BLOCK.height_mm, 0.0) * np.ones((rig.stripes, 1))
    observations = tuple(
        Observation(shows, frame_of(rig.light(x_px)), rig.peaks(x_px).peaks)
        for shows, x_px in (("belt", rig.x_px(rig.belt())), ("block", rig.x_px(block)))
    )
    return CalibrationSet(observations, rig.stripes, BLOCK, 1e6, {"use": "exact"})


def readable_path(source: Source[Any], folder: Path) -> Path:
    """Put two acquisitions into a folder and give the path at which the source finds them.

    By default the folder is a data set whose images lie in it, so that it is a folder of images, too.
    """
    given = fixture_of(type(source))
    if given is not None:
        path: Path = given(folder)
        return path
    description = Description(roemetry_dataset=1, name="kit", licence="CC0-1.0")
    with DatasetWriter(folder, description) as kept:
        for number in (1, 2):
            write_image(folder / f"p{number}.png", number)
            kept.add(Item(f"p{number}", {"laser": f"p{number}.png"}))
    return folder


def write_image(path: Path, number: int) -> None:
    """Write a grey 8-bit PNG of 24 × 32 pixels that is another for each number."""
    import cv2

    pixels = np.random.default_rng(SEED + number).integers(0, 256, (24, 32), np.uint8)
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
