"""How many frames are missing between two, by the numbers that the device gives them."""

from __future__ import annotations

from typing import Literal

Counting = Literal["64-bit", "16-bit"]
"""``64-bit``: whole numbers that never wrap in practice (GigE Vision 2, USB3 Vision, GenTL). ``16-bit``: 1 to
65535, then 1 again: GigE Vision 1.x, which leaves 0 out."""

_GVSP_RANGE = 65535
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
