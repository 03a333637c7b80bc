"""The simulator stage: a scene file's options in, images and their truth out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Frame, ProductTruth, Role, Simulated, StripeTruth, Truth
from roemetry.stages import Simulator
from roemetry_simulate.population import Lying, product_of
from roemetry_simulate.render import Rig, render
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.scene_rig import rig_of, surface_of
from roemetry_simulate.shown import stripes_show
from roemetry_simulate.solid import EmptyBelt
from roemetry_simulate.targets import TargetViews
from roemetry_simulate.truth import StripeTruth as Crossings
from roemetry_simulate.truth import stripe_centres


class RayCaster(Simulator[RayCasterOptions]):
    """Casts float64 rays: at least 4 × 4 a pixel, occlusion exact for camera and laser.

    The item of number k has the seed (first seed + k), so a longer set of the same seed begins with the
    shorter one. Light that is scattered between surfaces is left out, and the belt stands still during the
    exposure.
    """

    Options = RayCasterOptions

    def __init__(self, options: RayCasterOptions | None = None) -> None:
        super().__init__(options)
        # a product that cannot be, or does not fit, is told before anything is rendered
        product_of(self.options.product, self._rig, 0, 0)

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the item of this number; raise StageError where its product does not fit into the view."""
        lying = product_of(self.options.product, self._rig, number, seed)
        solid = EmptyBelt() if lying.drawn is None else lying.drawn.solid
        surface = surface_of(self.options, lying.seed)
        crossings = stripe_centres(self._rig.camera, self._rig.laser, solid)
        frames = []
        for role in self.options.light.images:
            rig = self._rig if role != "dark" else replace(self._rig, laser=dimmed(self._rig))
            # a dark image has a noise of its own
            noise_seed = lying.seed if role != "dark" else lying.seed + 2**32
            pixels = render(
                rig, solid, surface, seed=noise_seed, plain=role == "plain", samples=self.options.samples
            )
            frames.append(self._frame(pixels, role, number))
        products = () if lying.drawn is None else (_truth_of(lying, crossings),)
        return Simulated(tuple(frames), Truth(products, stripes_of(crossings)))

    def calibration_frames(self, seed: int) -> Mapping[str, Mapping[str, Frame]]:
        """Give the calibration images, by kind and name; each is made when it is asked for."""
        return TargetViews(self.options, self._rig, seed)

    @cached_property
    def _rig(self) -> Rig:
        return rig_of(self.options)

    def _frame(self, pixels: NDArray[Any], role: Role, number: int) -> Frame:
        belt = self.options.belt
        travel_mm = number * belt.pitch_mm
        return Frame(
            pixels,
            role=role,
            bit_depth=self.options.camera.bit_depth,
            time_s=travel_mm / belt.speed_mm_per_s if belt.speed_mm_per_s > 0.0 else math.nan,
            encoder_count=float(math.floor(travel_mm / belt.encoder_step_mm + 1e-9)),
        )


def stripes_of(crossings: Crossings) -> StripeTruth:
    """Return the record of what the ray caster knows of the stripes."""
    return StripeTruth(crossings.x_px.copy(), crossings.on_product == 1, crossings.xyz_mm.copy())


def dimmed(rig: Rig) -> Any:
    """Return the rig's laser, switched off."""
    return replace(rig.laser, peak_grey=np.zeros_like(rig.laser.peak_grey))


def _truth_of(lying: Lying, crossings: Crossings) -> ProductTruth:
    assert lying.drawn is not None
    truth = lying.drawn.truth
    seen = asdict(stripes_show(lying.drawn.solid, lying.drawn.reference, crossings))
    figures = {name: float(value) for name, value in seen.items()}
    return replace(truth, figures={"seed": float(lying.seed), **truth.figures, **figures})
