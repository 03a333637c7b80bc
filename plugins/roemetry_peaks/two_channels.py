"""Lines of two families, each found in its own channel of the image.

Model. Two lasers of different colours throw lines between each other. Each family is measured in its channel
by `gaussian`, as if the other were not there, and each peak says which family it is of. A channel passes a
little of the other colour: such light has the place of a line of the other family and a fraction of its
height, and is no line. Where two lines of both families really meet both are kept.

A frame of one channel has one family, and is measured as `gaussian` does. It fails where a channel passes
more of the other colour than a dark line of its own is bright. Source: our own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Flags
from roemetry.stages import Capabilities, Extractor
from roemetry_peaks.gaussian import Gaussian, GaussianOptions

_NEAR_PX = 2.0
"""Within which light of the other colour has the place of that line: a filter does not move it."""
_LEAK_MAX = 0.25
"""Of the other family's peak, that its light in this channel may reach: filters pass up to a tenth, and light
that is as high is told from it by nothing."""
_APART_PX = 1e-6
"""Between two peaks at the same place: peaks of a row are in order."""


class TwoChannels(Extractor[GaussianOptions]):
    """Finds the lines of each family in its channel."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def rows_apart(self) -> int:
        """Give 0: each row is measured by itself."""
        return 0

    def extract(self, frame: Frame) -> Peaks:
        """Find the lines of a frame; `Peaks.family` says in which channel each was found."""
        one = Gaussian(self.options)
        if frame.second is None:
            return one.extract(frame)
        channels = replace(frame, second=None), replace(frame, pixels=frame.second, second=None)
        first, second = (one.extract(each) for each in channels)
        return _joined(first, ~_leaked(first, second), second, ~_leaked(second, first))


def _leaked(peaks: Peaks, other: Peaks) -> Flags:
    """Say which peaks are light of the other family."""
    if not len(peaks) or not len(other):
        return np.zeros(len(peaks), np.bool_)
    # rows one after the other on one axis, each longer than the image is wide
    wide = float(peaks.image_size[1]) + 10.0 * _NEAR_PX
    key, of = peaks.row * wide + peaks.x_px, other.row * wide + other.x_px
    at = np.searchsorted(of, key)
    before, after = np.maximum(at - 1, 0), np.minimum(at, of.size - 1)
    nearest = np.where(np.abs(of[before] - key) < np.abs(of[after] - key), before, after)
    near = np.abs(of[nearest] - key) < _NEAR_PX
    return np.asarray(near & (peaks.amplitude < _LEAK_MAX * other.amplitude[nearest]))


def _joined(first: Peaks, mine: Flags, second: Peaks, its: Flags) -> Peaks:
    """Give the peaks of both families in order."""

    def both(name: str) -> Any:
        return np.concatenate([getattr(first, name)[mine], getattr(second, name)[its]])

    family = np.repeat(np.array([0, 1], np.int64), [int(mine.sum()), int(its.sum())])
    row, x_px = both("row"), both("x_px")
    order = np.lexsort((family, x_px, row))
    row, x_px = row[order], x_px[order]
    # places of a row must rise
    same = np.flatnonzero((np.diff(row) == 0) & (np.diff(x_px) <= 0.0))
    x_px[same + 1] += _APART_PX
    return Peaks(
        image_size=first.image_size,
        row=row,
        x_px=x_px,
        **{name: both(name)[order] for name in ("x_std_px", "amplitude", "background", "width_px", "flags")},
        correlation_rows=max(first.correlation_rows, second.correlation_rows),
        reasons=(*first.reasons, *(one for one in second.reasons if one not in first.reasons)),
        family=family[order],
    )
