"""Whether camera, laser or belt move in the course of a run: a cumulative-sum chart of the belt's motion.

The first images give centre and scatter of each part of the motion. From then on what lies beyond the centre
by more than a standard deviation is summed up, on either side, and the sum begins anew where it falls
below nothing (Page, Biometrika 41, 1954). Beyond eight standard deviations something moves: by chance less
than once in a million images. The motion began where the sum last began; a chart of single values would not
say where.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import Reason
from roemetry.records.arrays import Floats

_FIRST = 8
"""Images that give centre and scatter: the scatter is then known to 25 %."""
_SLACK, _LIMIT = 1.0, 8.0
"""Standard deviations that are not summed up, and of the sum from which something moves. The mean of the
first eight is off by a third of one: half of one, which is usual, would hardly cover it."""
_SCATTER_MIN_PX = 0.02
"""Less scatter than this says more of rounding than of the rig."""
_TOLD_FROM_PX = 0.1
"""Less motion is corrected without a trace in any number: it needs no one's attention."""
_MOVING_RANGE_TO_STD = 1.128  # mean range of two normal values over their standard deviation (Shewhart's d₂)
_WORDS = ("shifts along x", "turns", "grows or shrinks", "tilts about its x axis")


class MotionTrend:
    """Takes the images of a run one after another, and says since which of them something moves."""

    def __init__(self) -> None:
        self._first: list[Floats] = []
        self._centre_px: Floats = np.zeros(4)
        self._std_px: Floats = np.ones(4)
        self._sum: Floats = np.zeros((2, 4))
        self._since = [["", ""] for _ in _WORDS]
        self._sums_px: Floats = np.zeros((2, 4))
        self._count: Floats = np.zeros((2, 4))
        self._last = ""

    def add(self, acquisition: str, motion_px: tuple[float, ...]) -> None:
        """Take what one image's motion does at its edge, px; of an image's rows the first."""
        if acquisition == self._last or len(motion_px) != len(_WORDS):
            return
        self._last = acquisition
        motion = np.array(motion_px)
        if len(self._first) < _FIRST:
            self._first.append(motion)
            first = np.array(self._first)
            self._centre_px = first.mean(axis=0)
            if len(first) > 1:
                scatter = np.abs(np.diff(first, axis=0)).mean(axis=0) / _MOVING_RANGE_TO_STD
                self._std_px = np.maximum(scatter, _SCATTER_MIN_PX)
            return
        off = (motion - self._centre_px) / self._std_px
        for side, sign in enumerate((1.0, -1.0)):
            self._sum[side] = np.maximum(self._sum[side] + sign * off - _SLACK, 0.0)
            begins = self._sum[side] == 0.0
            self._sums_px[side] = np.where(begins, 0.0, self._sums_px[side] + motion - self._centre_px)
            self._count[side] = np.where(begins, 0.0, self._count[side] + 1.0)
            for part in np.flatnonzero(self._count[side] == 1.0):
                self._since[part][side] = acquisition

    @property
    def reason(self) -> Reason | None:
        """What moves, by how much, and since when; None where nothing does."""
        mean_px = self._sums_px / np.maximum(self._count, 1.0)
        told = (self._sum > _LIMIT) & (np.abs(mean_px) >= _TOLD_FROM_PX)
        if not told.any():
            return None
        side, part = np.unravel_index(int(np.argmax(np.where(told, np.abs(mean_px), 0.0))), told.shape)
        return Reason(
            "drifting",
            f"from {self._since[int(part)][int(side)]} on the image {_WORDS[int(part)]}: at its edge by "
            f"{mean_px[side, part]:+.2f} px in the mean against the run's first {_FIRST} images; each image "
            "was corrected or refused; look for what is loose, and calibrate again",
        )
