"""The frames of one product, which the camera takes one after another, each in its own light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from roemetry.records import Frame, Role
from roemetry.records.live import LiveFrame


class Exposures:
    """Puts frames together, from when the camera is opened: its first frame is in the first light.

    A frame that is lost or not whole takes its product with it; those that follow are in their light again.
    """

    def __init__(self, lights: Sequence[Role]) -> None:
        """Make it; `lights` says what lights the scene, in the order in which frames are taken."""
        self._lights = lights
        self._count = 0
        self._product = 0
        self._kept: list[Frame] = []

    def add(self, live: LiveFrame) -> tuple[Frame, ...] | None:
        """Give the frames of a product with its last one; None before that."""
        product, index = divmod(self._count + live.lost_before, len(self._lights))
        self._count += live.lost_before + 1
        if product != self._product:
            self._product, self._kept = product, []
        if live.frame is not None:
            self._kept.append(replace(live.frame, role=self._lights[index]))
        return tuple(self._kept) if len(self._kept) == len(self._lights) else None
