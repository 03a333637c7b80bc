"""Everything that goes into the joint adjustment; whole, or with some poses kept out of it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from roemetry.arrays import Flags, Integers
from roemetry_pinhole.adjustment import Adjusted, adjust
from roemetry_pinhole.equations import ON_BELT, Corners, Feet, StripePoints
from roemetry_pinhole.geometry import Geometry, Unknowns, unknowns_of

_Rows = TypeVar("_Rows", Corners, StripePoints, Feet)


@dataclass(frozen=True, eq=False, slots=True)
class Measured:
    """What was seen, where the adjustment starts, and what it looks for.

    Attributes
    ----------
    start, unknowns
        See `adjust`.
    corners, points, feet
        What was seen.
    foot_std_mm
        Standard uncertainty of the feet's heights, mm.
    """

    start: Geometry
    unknowns: Unknowns
    corners: Corners
    points: StripePoints
    feet: Feet
    foot_std_mm: float

    def adjusted(self) -> Adjusted:
        """Adjust; raises as `adjust`."""
        return adjust(
            self.start,
            self.unknowns,
            self.corners,
            self.points,
            self.feet,
            foot_std_mm=self.foot_std_mm,
        )

    def of(self, poses: Integers, start: Geometry) -> Measured:
        """Give what was seen in some poses (ascending) and on the bare belt, from another start."""
        found = unknowns_of(
            replace(start, rotation=start.rotation[poses], shift=start.shift[poses]),
            free_camera=self.unknowns.camera >= 0,
            planes=bool((self.unknowns.planes >= 0).any()),
            belt=bool((self.unknowns.belt >= 0).any()),
            travel=bool((self.unknowns.travel >= 0).any()),
        )
        return Measured(
            replace(start, rotation=start.rotation[poses], shift=start.shift[poses]),
            found,
            chosen(self.corners, np.isin(self.corners.pose, poses), poses),
            chosen(self.points, np.isin(self.points.pose, [ON_BELT, *poses]), poses),
            chosen(self.feet, np.isin(self.feet.pose, poses), poses),
            self.foot_std_mm,
        )


def chosen(rows: _Rows, keep: Flags, poses: Integers | None = None) -> _Rows:
    """Give some of the rows; with `poses` (ascending) their poses numbered by the place in there."""
    parts = {field.name: getattr(rows, field.name)[keep] for field in fields(rows)}
    if poses is not None:
        pose = parts["pose"]
        parts["pose"] = np.where(pose == ON_BELT, ON_BELT, np.searchsorted(poses, pose))
    return replace(rows, **parts)
