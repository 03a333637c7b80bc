"""What the source yields: acquisitions of one or more frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records.arrays import Checker, Floats, Integers
from roemetry.records.display import Shown
from roemetry.records.profiles import Profiles

Role = Literal["laser", "plain", "dark"]


@dataclass(frozen=True, slots=True)
class Sensor:
    """What is known of the camera's noise; NaN where it is not known.

    A pixel that shows g grey levels above black has a variance of ``gain · g + read_noise²``.
    """

    gain_grey_per_electron: float = math.nan
    """Grey levels for each electron."""
    read_noise_grey: float = math.nan
    """Standard deviation of a dark pixel, grey levels."""

    def __post_init__(self) -> None:
        if self.gain_grey_per_electron <= 0 or self.read_noise_grey < 0:
            raise DataError(
                f"Sensor: gain_grey_per_electron is {self.gain_grey_per_electron}, read_noise_grey is "
                f"{self.read_noise_grey}; expected > 0 and ≥ 0"
            )


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Frame(Shown):
    """One image."""

    pixels: NDArray[Any]
    """(row, column) or, at the source only, (row, column, colour in the order blue, green, red); 8 or 16 bit
    unsigned, grey levels. Pixel centres are whole numbers; (0, 0) is the centre of the top-left pixel, x
    to the right, y down."""
    role: Role = "laser"
    """What lit the scene: ``laser``, ``plain`` light, or ``dark`` (laser off, as for the laser frame)."""
    name: str = ""
    bit_depth: int = 8
    """Bits in use; the white level is ``2**bit_depth - 1``."""
    headroom: int = 0
    """Grey levels above white that pixels reach where the camera's channel was clipped and others tell more
    of the light, as in a contrast image; 0 in an image as taken."""
    turn_deg: int = 0
    """Counter-clockwise turn that has been applied to the image as acquired: 0, 90, 180 or 270."""
    time_s: float = math.nan
    encoder_count: float = math.nan
    """time_s, encoder_count: when and where on the belt it was taken; NaN where not known."""
    sensor: Sensor | None = None
    """The camera's noise, or None where nothing is known of it."""
    second: NDArray[Any] | None = None
    """(row, column) of light in two families: the second family's channel, prepared as `pixels`, which
    are the first's; None: there is one."""

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels)
        faults = []
        second = self.second
        if second is not None and (second.shape != pixels.shape or second.dtype != pixels.dtype):
            faults.append(f"second is {second.shape} {second.dtype}, not {pixels.shape} {pixels.dtype}")
        if pixels.dtype not in (np.uint8, np.uint16):
            faults.append(f"pixels are {pixels.dtype}, expected uint8 or uint16")
        if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)):
            faults.append(f"pixels have shape {pixels.shape}, expected (rows, columns) or (rows, columns, 3)")
        elif 0 in pixels.shape:
            faults.append(f"pixels have shape {pixels.shape}: the image is empty")
        if not 1 <= self.bit_depth <= 8 * pixels.dtype.itemsize:
            faults.append(f"bit_depth is {self.bit_depth}, which {pixels.dtype} cannot hold")
        if self.headroom and not 0 < self.headroom <= np.iinfo(pixels.dtype).max - self.white:
            faults.append(f"headroom is {self.headroom} above white, which {pixels.dtype} cannot hold")
        if self.turn_deg not in (0, 90, 180, 270):
            faults.append(f"turn_deg is {self.turn_deg}, expected 0, 90, 180 or 270")
        if faults:
            raise DataError(f"Frame {self.name!r}: " + "; ".join(faults))
        view = pixels.view()
        view.flags.writeable = False
        object.__setattr__(self, "pixels", view)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.pixels.shape[0]), int(self.pixels.shape[1])

    @property
    def white(self) -> int:
        """Highest grey level the sensor can give; it clipped what reaches it."""
        return int(2**self.bit_depth - 1)

    @property
    def highest(self) -> int:
        """Grey level from which on no pixel tells more of the light: `white`, and the headroom above it."""
        return self.white + self.headroom


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ScanLines(Shown):
    """The frames of one scan, each read when it is asked for, with where the belt was."""

    frame: Callable[[int], Frame]
    """Gives the frame of a line, 0 to ``len(count) - 1``."""
    count: Floats
    """(line,) encoder count as the counter gave it, wrapped or not; NaN where it is missing."""
    number: Integers
    """(line,) frame number as the camera gave it; a line's index where it gave none."""
    own: tuple[int, int]
    """First line, and line after the last, of those in which a product of this acquisition begins; what
    begins later belongs to the next acquisition, which overlaps this one."""
    start: int = 0
    """Lines of the scan before the first of these."""

    def __post_init__(self) -> None:
        check = Checker(self)
        lines = check.array("count", np.float64, (None,)).shape[0]
        check.array("number", np.int64, (lines,))
        check.require(0 <= self.own[0] < self.own[1] <= lines, f"own is {self.own} of {lines} lines")
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Acquisition(Shown):
    """The frames that were taken of one scene, with an id that is unique in the run."""

    id: str
    frames: tuple[Frame, ...]
    lines: ScanLines | None = None
    """Of a scan: its lines, each with its encoder count; `frames` is then empty."""
    profiles: Profiles | None = None
    """Of a sensor that gives heights: its slices, in which belt and products are not told apart yet."""
    before: NDArray[Any] | None = None
    """Pixels of the laser image that was taken before this one, as acquired; None where there is none: a
    transport's fault may leave a part of it in this one."""

    def frame(self, role: Role) -> Frame | None:
        """Give the first frame with this role, or None."""
        return next((frame for frame in self.frames if frame.role == role), None)


@dataclass(frozen=True, slots=True)
class AcquisitionReference:
    """Where an acquisition can be read from, light enough to hand to a worker process."""

    id: str
    files: Mapping[Role, Path]
    before: Path | None = field(default=None, kw_only=True)
    """The laser image that was taken before this one."""
    sha256: Mapping[Role, str] = field(default_factory=dict, kw_only=True)
    """What the files' bytes must hash to, where that is known: others are refused."""
