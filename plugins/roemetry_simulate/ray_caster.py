"""The simulator stage: a scene file's options in, images and their truth out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Frame, ProductTruth, Role, Simulated, StripeTruth, Truth
from roemetry.stages import Turn
from roemetry_simulate.optics import turned
from roemetry_simulate.population import Group, draw_item
from roemetry_simulate.products import Drawn
from roemetry_simulate.render import as_stored, render
from roemetry_simulate.scene import RayCasterOptions, contaminate, surface_of
from roemetry_simulate.solid import Solid
from roemetry_simulate.targets import RigSimulator
from roemetry_simulate.truth import StripeTruth as Crossings
from roemetry_simulate.truth import dot_centres, stripe_centres, stripes_show


class RayCaster(RigSimulator[RayCasterOptions]):
    """Casts float64 rays: at least 4 × 4 a pixel, occlusion exact for camera and laser.

    The item of number k has the seed (first seed + k), so a longer set of the same seed begins with the
    shorter one. Light that is scattered between surfaces is left out, and the belt stands still during the
    exposure.
    """

    Options = RayCasterOptions

    def __init__(self, options: RayCasterOptions | None = None) -> None:
        super().__init__(options)
        # a product that cannot be, or does not fit, is told before anything is rendered
        draw_item(self.options.product, self.rig, 0, 0)

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the item of this number; raise StageError where its product does not fit into the view."""
        lying = draw_item(self.options.product, self.rig, number, seed)
        solid = lying.solid
        surface = surface_of(self.options, lying.seed)
        surface = contaminate(surface, self.options, self.rig, lying.products, lying.seed)
        pitch: Any = {"step_px": 0.5} if self.options.draft else {}
        camera, laser = self.rig.camera, self.rig.laser
        if len(laser.rows):
            crossings = dot_centres(camera, laser, solid)
        else:
            crossings = stripe_centres(camera, laser, solid, **pitch)
        stripes = stripes_of(crossings, solid)
        if laser.across is not None:
            across = stripe_centres(turned(camera), laser.across, solid, **pitch)
            stripes = replace(stripes, across=stripes_of(across, solid))
        frames = []
        for role in self.options.light.images:
            rig = self.rig
            if role == "dark":
                off = replace(laser, peak_grey=np.zeros_like(laser.peak_grey), across=None)
                rig = replace(rig, laser=off)
            # a dark image has a noise of its own
            noise_seed = lying.seed if role != "dark" else lying.seed + 2**32
            given: Any = {"samples": self.options.samples, "draft": self.options.draft}
            pixels = render(rig, solid, surface, seed=noise_seed, plain=role == "plain", **given)
            frames.append(self._frame(pixels, role, number))
        products = tuple(
            _truth_of(one, lying.seed, _only(crossings, stripes.product == place))
            for place, one in enumerate(lying.products, start=1)
        )
        return Simulated(tuple(frames), Truth(products, stripes))

    def turn_deg(self) -> Turn:
        """Give the turn that rights its images."""
        return self.options.turn_deg

    def _frame(self, pixels: NDArray[Any], role: Role, number: int) -> Frame:
        belt = self.options.belt
        travel_mm = number * belt.pitch_mm
        return Frame(
            as_stored(pixels, self.options.turn_deg),
            role=role,
            bit_depth=self.options.camera.bit_depth,
            time_s=travel_mm / belt.speed_mm_per_s if belt.speed_mm_per_s > 0.0 else math.nan,
            sensor=self.sensor(),
            encoder_count=float(math.floor(travel_mm / belt.encoder_step_mm + 1e-9)),
        )


def stripes_of(crossings: Crossings, solid: Solid | None = None) -> StripeTruth:
    """Return the record of what is known of the stripes; `solid` says which of a group is where."""
    on_product = crossings.on_product == 1
    label = np.where(np.isfinite(crossings.x_px), on_product.astype(np.int16), np.int16(-1))
    if isinstance(solid, Group):
        label[on_product] = solid.member_at(crossings.xyz_mm[on_product])
    x_px, y_px, xyz_mm = (one.copy() for one in (crossings.x_px, crossings.y_px, crossings.xyz_mm))
    return StripeTruth(x_px, on_product, xyz_mm, label, y_px)


def _only(crossings: Crossings, on_it: NDArray[np.bool_]) -> Crossings:
    """Leave those on one product alone on a product."""
    return replace(crossings, on_product=on_it.astype(np.int8))


def _truth_of(one: Drawn, seed: int, crossings: Crossings) -> ProductTruth:
    figures = stripes_show(one.solid, one.reference, crossings)
    return replace(one.truth, figures={"seed": float(seed), **one.truth.figures, **figures})
