"""What the feeds of industrial cameras share: their options, and what is said where a camera refuses."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from pydantic import Field

from roemetry.errors import ConfigurationError
from roemetry.stages import StageOptions
from roemetry_line.feeds.frame_numbers import Counting

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
    close = difflib.get_close_matches(name, list(known), n=1)
    hint = f"did you mean `{close[0]}`?" if close else "the camera's manual lists its nodes"
    return ConfigurationError(f"the camera has no node `{name}`", hint=hint, at=("nodes", name))


def refused(name: str, value: object, error: BaseException) -> ConfigurationError:
    """Give the error for a value that the camera does not take."""
    return ConfigurationError(f"the camera refuses {name}: {value}: {first_line(error)}", at=("nodes", name))


def first_line(error: BaseException) -> str:
    """Give the first line of what a driver says."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
