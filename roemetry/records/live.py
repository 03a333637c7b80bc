"""What comes from a camera while a line runs, and what goes out of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from roemetry.errors import DataError
from roemetry.records.acquisition import Frame
from roemetry.records.display import Shown


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class LiveFrame(Shown):
    """One frame as a camera gave it, or what is known of one that did not arrive whole."""

    frame: Frame | None
    """As the sensor gave it, with the host's time (s since 1970) and the encoder's count; None where it is
    not whole."""
    number: int
    """The device's own number of the frame."""
    lost_before: int = 0
    """Frames that the device took between the one before and this one, and that did not arrive."""
    device_time_s: float = math.nan
    """The device's clock, s since a moment of its own; NaN where it tells none."""
    fault: str = ""
    """Why the frame is not whole; empty where it is."""

    def __post_init__(self) -> None:
        if (self.frame is None) != bool(self.fault) or self.lost_before < 0:
            raise DataError(
                f"LiveFrame {self.number}: fault is {self.fault!r}, frame {self.frame!r}, lost_before is "
                f"{self.lost_before}; expected a fault where there is no frame, and 0 or more"
            )


class LineControl(Protocol):
    """What a receiver of rows may know and ask of the line that it hears from."""

    def state(self) -> Literal["starting", "running", "faulty"]:
        """Say whether every station measures; ``faulty`` where one does not and an alarm says why."""

    def recipes(self) -> Mapping[str, Sequence[str]]:
        """Give each station's recipes, by its name: the one that measures first, then the others."""

    def choose(self, station: str, recipe: str, who: str) -> bool:
        """Let a station measure with another of its recipes; False where it has no such recipe."""

    def warn(self, text: str | None) -> None:
        """Show the operator what is wrong with who receives, where rows are delivered; None: nothing."""


@dataclass(frozen=True, slots=True)
class LineRow:
    """What is told of one product, or of a frame that gave none in time."""

    number: int
    """Position in the line's outbox: rows are delivered in its order."""
    key: str
    """The same whenever the row is delivered again, and never another row's."""
    kind: Literal["product", "notice"]
    """``notice``: no measurement, but what happened to a frame (too late, not whole, lost)."""
    summary: Mapping[str, str | float | int | None]
    """What a controller asks for, by name, units in the names; None where it is not known."""
    text: str
    """Everything, as one line of JSON, the row of the record included."""
