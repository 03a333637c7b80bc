"""The noise of a line's images, measured beforehand, as a file."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from roemetry.errors import StageError
from roemetry.records import Frame
from roemetry_peaks.speckle_noise import TILES, StripeNoise

if TYPE_CHECKING:
    from roemetry_peaks.peak_scan import Area

_AGAIN = "measure again: python -m roemetry_peaks.measure_noise RECIPE --out FILE"


class NoiseFile(BaseModel):
    """What the file holds."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    roemetry_noise: int = Field(ge=1, le=1)
    image_size: tuple[int, int]
    region: tuple[int, int, int, int]
    turn_deg: int
    bit_depth: int
    frames: int = Field(ge=1)
    peaks: int = Field(ge=1)
    read_noise_grey: float = Field(ge=0.0)
    gain_grey_per_electron: float = Field(ge=0.0)
    speckle_correlation: float = Field(ge=0.0, le=0.95)
    speckle_contrast: tuple[tuple[float, ...], ...]


def noise_of_file(path: Path, frame: Frame, area: Area, rounding: float) -> StripeNoise:
    """Read the noise of a frame's part from a file; raise StageError where it is none, or another image's."""
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise StageError(f"the noise file {path} cannot be read: {error.strerror}", hint=_AGAIN) from error
    held = _read(path, stamp)
    expected = {
        "image_size": frame.size,
        "region": tuple(area),
        "turn_deg": frame.turn_deg,
        "bit_depth": frame.bit_depth,
    }
    for name, wanted in expected.items():
        if getattr(held, name) != wanted:
            raise StageError(
                f"the noise file {path} was measured on images of {name} {getattr(held, name)}, "
                f"this one has {wanted}",
                hint=_AGAIN,
            )
    contrast = np.array(held.speckle_contrast)
    return StripeNoise(
        held.read_noise_grey**2 + rounding,
        held.gain_grey_per_electron,
        held.speckle_correlation,
        contrast**2,
    )


@lru_cache(maxsize=8)
def _read(path: Path, stamp: int) -> NoiseFile:
    """Read a file once for each state of it."""
    try:
        held = NoiseFile.model_validate(json.loads(path.read_text("utf-8")))
    except (ValueError, ValidationError) as error:
        raise StageError(f"{path} is no noise file: {str(error).splitlines()[0]}", hint=_AGAIN) from error
    if [len(line) for line in held.speckle_contrast] != [TILES[1]] * TILES[0]:
        raise StageError(f"{path}: speckle_contrast is not {TILES[0]} × {TILES[1]} tiles", hint=_AGAIN)
    return held
