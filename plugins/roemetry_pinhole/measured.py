"""Everything that goes into the joint adjustment; whole, or with some poses kept out of it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_pinhole.adjustment import Adjusted, adjust, nearly
from roemetry_pinhole.edges import Edges, no_edges
from roemetry_pinhole.equations import ON_BELT, Corners, Feet, StripePoints
from roemetry_pinhole.geometry import Geometry, Unknowns, unknowns_of
from roemetry_pinhole.problem import Problem, Weights, inverse

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
        Standard uncertainty of the feet's heights, mm: of all, or of each.
    edges
        What was seen of solids' edges.
    """

    start: Geometry
    unknowns: Unknowns
    corners: Corners
    points: StripePoints
    feet: Feet
    foot_std_mm: float | Floats
    edges: Edges = field(default_factory=no_edges)

    def adjusted(self) -> Adjusted:
        """Adjust; raises as `adjust`."""
        return adjust(
            self.start,
            self.unknowns,
            self.corners,
            self.points,
            self.feet,
            foot_std_mm=self.foot_std_mm,
            edges=self.edges,
        )

    def nearly(self) -> Geometry:
        """Adjust robustly and not to the last digit; raises as `adjust`."""
        return nearly(self._problem(None), self.start)

    def stepped(self, found: Adjusted) -> Geometry:
        """Give where what was found goes if this was seen instead: one step, the weights as they were."""
        problem = self._problem(found)
        normal, gradient = problem.normal(found.geometry)
        return self.unknowns.moved(found.geometry, -inverse(normal) @ gradient)

    def _problem(self, found: Adjusted | None) -> Problem:
        weights = Weights(1.0, 1.0, np.ones(self.corners.pose.size), np.ones(self.points.pose.size))
        if found is not None:
            weights = Weights(
                found.corner_std_px,
                found.stripe_scale,
                found.corner_used.astype(np.float64),
                found.stripe_used.astype(np.float64),
                robust=False,
                correlation=found.correlation * found.conflict,
            )
        return Problem(
            self.unknowns, self.corners, self.points, self.feet, self.foot_std_mm, weights, self.edges
        )

    def of(self, poses: Integers, start: Geometry) -> Measured:
        """Give what boards in some poses (ascending) and the bare belt show, from another start."""
        feet = np.isin(self.feet.pose, poses)
        found = unknowns_of(
            replace(start, rotation=start.rotation[poses], shift=start.shift[poses]),
            free_camera=self.unknowns.camera >= 0,
            planes=bool((self.unknowns.planes >= 0).any()),
            belt=bool((self.unknowns.belt >= 0).any()),
            travel=bool((self.unknowns.travel >= 0).any()),
            bend=bool(self.unknowns.bend.size),
        )
        return Measured(
            replace(start, rotation=start.rotation[poses], shift=start.shift[poses]),
            found,
            chosen(self.corners, np.isin(self.corners.pose, poses), poses),
            chosen(self.points, np.isin(self.points.pose, [ON_BELT, *poses]), poses),
            chosen(self.feet, feet, poses),
            self.foot_std_mm if isinstance(self.foot_std_mm, float) else self.foot_std_mm[feet],
            no_edges(),
        )


def chosen(rows: _Rows, keep: Flags, poses: Integers | None = None) -> _Rows:
    """Give some of the rows; with `poses` (ascending) their poses numbered by the place in there."""
    given = {field.name: getattr(rows, field.name) for field in fields(rows)}
    parts: dict[str, Any] = {name: None if column is None else column[keep] for name, column in given.items()}
    if poses is not None:
        pose = rows.pose[keep]
        parts["pose"] = np.where(pose == ON_BELT, ON_BELT, np.searchsorted(poses, pose))
    return replace(rows, **parts)
