"""A step target in one image: half of a block as it is, half in the product's own colour or material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry.errors import DataError
from roemetry.records import BELT, Block, Profiles

Half = Literal["top", "bottom"]

_TOP_FROM_SHARE = 0.6
"""A product's point higher than this share of the block's height is looked at as its top."""
_EDGE_ROWS = 3
_BETWEEN_SHARE = 0.1
"""So much of the top about its middle is left out: there the one half ends and the other begins."""
_POINTS_MIN = 10
_STRIPES_MIN = 3
_SCATTERS = 4.0
_LEAST_SHARE = 0.02
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False, slots=True)
class Halves:
    """(slice, point) points of the bare and of the covered half; frozen: redraws are read alike."""

    bare: Flags
    covered: Flags

    def steps_mm(self, profiles: Profiles) -> Floats:
        """Give (slice,) the covered half's mean height over the bare one's, mm, of slices that show both."""
        height = profiles.xyz_mm[:, :, 2]
        both = np.flatnonzero(self.bare.any(axis=1))
        return np.array([height[s][self.covered[s]].mean() - height[s][self.bare[s]].mean() for s in both])


def find_halves(profiles: Profiles, block: Block, covered: Half) -> Halves:
    """Find both halves of a block's top, split at its middle along the stripes.

    Parameters
    ----------
    profiles
        Of one image.
    block
        As described.
    covered
        Which half is covered, in the image: ``top`` (towards +Y) or ``bottom``.

    Raises
    ------
    DataError
        Fewer than three stripes (or than there are) show two level halves.
    """
    height = profiles.xyz_mm[:, :, 2]
    high = (profiles.product > BELT) & profiles.seen & (height > _TOP_FROM_SHARE * block.height_mm)
    halves = np.zeros((2, *high.shape), np.bool_)
    for s in range(len(high)):
        at = np.flatnonzero(high[s])
        if at.size < 2 * _POINTS_MIN:
            continue
        first, last = np.quantile(at, [0.01, 0.99])
        middle, gap = 0.5 * (first + last), max(0.5 * _BETWEEN_SHARE * (last - first), _EDGE_ROWS)
        halves[0, s, at[(at >= first + _EDGE_ROWS) & (at <= middle - gap)]] = True
        halves[1, s, at[(at >= middle + gap) & (at <= last - _EDGE_ROWS)]] = True
    for half in halves:
        if half.any():
            level = float(np.median(height[half]))
            scatter = _MAD_TO_STD * float(np.median(np.abs(height[half] - level)))
            half &= np.abs(height - level) <= max(_SCATTERS * scatter, _LEAST_SHARE * block.height_mm)
    both = (halves.sum(axis=2) >= _POINTS_MIN).all(axis=0)
    needed = min(_STRIPES_MIN, profiles.slice_count)
    if both.sum() < needed:
        raise DataError(
            f"the block `{block.name}` does not show two level halves on {needed} stripes",
            hint="does it lie under the stripes, its covered half above or below the other in the image, the "
            "border between them at its middle?",
        )
    halves &= both[:, None]
    top, bottom = halves
    return Halves(bottom, top) if covered == "top" else Halves(top, bottom)
