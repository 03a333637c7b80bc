"""What the feeds of industrial cameras share: options, the count of lost frames, and refusals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from pydantic import Field

from roemetry.errors import ConfigurationError, did_you_mean
from roemetry.stages import StageOptions

Counting = Literal["64-bit", "16-bit"]
"""``64-bit``: whole numbers that never wrap in practice (GigE Vision 2, USB3 Vision, GenTL). ``16-bit``: 1 to
65535, then 1 again: GigE Vision 1.x, which leaves 0 out."""

_GVSP_RANGE = 65535  # numbers of a 16-bit count, which has no 0
_BACK_MAX = 1000
"""A 16-bit number that is so little behind the last is a repeat, not 64,535 lost frames."""


class FrameNumbers:
    """Counts the frames that are missing, from frame to frame."""

    def __init__(self, counting: Counting = "64-bit") -> None:
        self._counting = counting
        self._last: int | None = None

    def lost_before(self, number: int) -> int:
        """Give how many frames are missing before the one of this number.

        A number that is not ahead of the last means that the device counts anew: nothing is known to be lost.
        """
        last, self._last = self._last, number
        if last is None:
            return 0
        if self._counting == "16-bit":
            step = (number - last) % _GVSP_RANGE
            return step - 1 if 0 < step < _GVSP_RANGE - _BACK_MAX else 0
        return number - last - 1 if number > last else 0


HINT = "is it plugged in and powered, and no other program using it?"


class CameraOptions(StageOptions):
    """How a GenICam camera is read and set."""

    counting: Counting = Field(
        default="64-bit", description="how frames are numbered; `16-bit` for GigE Vision 1.x"
    )
    buffers: int = Field(default=16, ge=2, le=1000, description="frames that the driver can hold")
    encoder_node: str = Field(
        default="", description="node with the encoder's count, such as `ChunkEncoderValue`; empty: none"
    )
    nodes: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="the camera's own settings, by node, set in this order"
    )


def no_node(name: str, known: Iterable[str]) -> ConfigurationError:
    """Give the error for a node that the camera has not."""
    hint = did_you_mean(name, known) or "the camera's manual lists its nodes"
    return ConfigurationError(f"the camera has no node `{name}`", hint=hint, at=("nodes", name))


def refused(name: str, value: object, error: BaseException) -> ConfigurationError:
    """Give the error for a value that the camera does not take."""
    return ConfigurationError(f"the camera refuses {name}: {value}: {first_line(error)}", at=("nodes", name))


def first_line(error: BaseException) -> str:
    """Give the first line of what a driver says."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
