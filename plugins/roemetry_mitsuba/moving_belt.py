"""The simulator `mitsuba-belt`: scans of products that a belt carries through sheets of light.

Light, materials and sensor are those of `mitsuba`, so lines broaden where they graze, wet sides mirror the
line on the belt, translucent products give it back beside where it entered, and speckle is what it is. A head
below the belt is the same rig turned about X: it sees the underside in a gap, and no belt.

Belt and product move as one, by what the product moves: with `slip_share` the belt's texture slips, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.config.scan_part import ScanPart
from roemetry.errors import StageError
from roemetry.records import Frame, ProductTruth, Simulated, Truth
from roemetry_mitsuba.bodies import Body
from roemetry_mitsuba.light import expose
from roemetry_mitsuba.moving_light import MovingTracer
from roemetry_mitsuba.scene import Fan, MitsubaOptions
from roemetry_mitsuba.simulator import MitsubaSimulator, Placed
from roemetry_mitsuba.truth import Crossings, crossings

Floats = NDArray[np.float64]

_NEXT_FRAME = 2**34
"""Between the seeds of a scan's frames, beyond any that other images have."""
_UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


class MitsubaBeltOptions(MitsubaOptions):
    """A scene whose products move."""

    samples: int = Field(
        default=2, ge=2, le=16, description="camera rays along each side of a pixel that is lit"
    )
    bounce_rays: int = Field(
        default=16, ge=0, le=4096, description="rays per node of the indirect light; 0 leaves it out"
    )
    scan: ScanPart = Field(default_factory=ScanPart, description="the belt and the frames")


class MitsubaBelt(MitsubaSimulator):
    """Makes scans: frames one below the other in one tall image, with their counts."""

    Options = MitsubaBeltOptions
    options: MitsubaBeltOptions

    @cached_property
    def fan(self) -> Fan:
        """The projector, with where its light ends."""
        fan = super().fan
        low, high = self.options.scan.runs(fan.origin_mm, fan.axis, fan.x_mm(0.0, 0.0))
        return replace(fan, runs=(float(low), float(high)))

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make one item's scan; raise StageError where its product is wider than the view."""
        placed, item_seed = self.placed(number, seed), seed + number
        frames = list(self.frames(placed, item_seed))
        counts, _ = self.belt(placed, item_seed)
        tall = Frame(np.vstack(frames), bit_depth=self.options.camera.bit_depth, sensor=self.sensor())
        products = tuple(
            replace(one.truth, figures={**one.truth.figures, "seed": float(item_seed)}) for one in placed
        )
        truth = Truth(products or (ProductTruth(),))
        return Simulated((tall,), truth, counts=self.options.scan.shown(counts))

    def belt(self, placed: Sequence[Placed], seed: int) -> tuple[NDArray[np.int64], Floats]:
        """Give (line,) counts, and (line, 3) by how much products have moved since they were placed, mm."""
        # without a product the belt itself is scanned
        extents = np.array([one.body.extent_mm[:2] for one in placed] or [(-1.0, 1.0)])
        along = float(extents[:, 0].min()), float(extents[:, 1].max())
        return self.options.scan.run(along, self.fan.x_mm(0.0, 0.0), seed)

    def frames(self, placed: Sequence[Placed], seed: int) -> Iterator[NDArray[Any]]:
        """Take the frames, turned as they are stored."""
        bodies, moved = self._in_head(placed, seed)
        surface = self._product_material("laser", bodies, seed)
        # in the gap below there is no belt
        ground = None
        if self.options.scan.below_mm is None:
            ground = self._belt_material("laser", seed, clean=False, moved_mm=moved)
        tracer = MovingTracer(
            self.camera,
            self._lens,
            self.fan,
            ground,
            bodies,
            surface,
            self._below,
            self.options.samples,
            seed,
        )
        lit = tracer.frames(moved, self._lamps("laser"), bounce_rays=self.options.bounce_rays)
        for line, (laser, other) in enumerate(lit):
            pixels = expose(laser, other, self.camera, self._sensor, seed + _NEXT_FRAME * (line + 1))
            # images are stored turned back
            yield np.ascontiguousarray(np.rot90(pixels, -self.options.turn_deg // 90))

    def crossings(self, placed: Sequence[Placed], seed: int) -> Iterator[Crossings]:
        """Find of each frame where stripes truly cross its rows; a head below sees none on a belt."""
        bodies, moved = self._in_head(placed, seed)
        for place in moved:
            shifted = [replace(body, points_mm=body.points_mm + place) for body in bodies]
            found = crossings(self.camera, self.fan, shifted)
            yield found if self.options.scan.below_mm is None else found.on_bodies()

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Give the true rig, where each target lay, and how the belt runs."""
        told = super().calibration_truth(seed)
        return {**told, "mm_per_count": self.options.scan.told_motion()}

    def _in_head(self, placed: Sequence[Placed], seed: int) -> tuple[list[Body], Floats]:
        """Give the bodies, and how far they have moved (line, 3), in the frame of the head."""
        bodies, (_, moved) = [one.body for one in placed], self.belt(placed, seed)
        below_mm = self.options.scan.below_mm
        if below_mm is None:
            return bodies, moved
        # turned about X, the head's level at z = 0
        up = np.array([0.0, 0.0, below_mm])
        turned = [replace(body, points_mm=(body.points_mm - up) @ _UPSIDE_DOWN) for body in bodies]
        return turned, moved @ _UPSIDE_DOWN

    def _fitted(self, one: Placed, name: str) -> Placed:
        """Give a product as it was laid: raise StageError where it is too wide or high for the view."""
        body = one.body
        # neither camera nor projector may be hit
        lowest = min(float(self.camera.centre_mm[2]), float(self.fan.origin_mm[2]))
        _, _, y_min, y_max = body.extent_mm
        _, _, near, far = self.camera.view_on(0.0)
        if body.height_mm >= lowest or y_min < near or y_max > far:
            raise StageError(
                f"{name}: the product is {body.height_mm:.1f} mm high and lies on Y = {y_min:.1f} to "
                f"{y_max:.1f} mm; the rig hangs at {lowest:.1f} mm, the view is Y = {near:.1f} to "
                f"{far:.1f} mm",
                hint="make the product smaller, or let the camera see more",
                at=("product",),
            )
        return one
