"""The simulator `moving-belt`: frames of stripes over a product that a belt carries through the light.

The product stands still in its own frame; camera, projector and planes of light run by −t·c past it at the
encoder count c. Where a plane of light shows in an image row is found without an image: of the plane, the
camera sees in that row a straight line (with a lens that distorts, found again at where it was met), which is
followed downwards to the body's surface or the belt; the point counts if projector and camera both see it.

    x(row) exact,    grey(column) = b + A·cos i·exp(−(column − x)² / 2s²)·grain

with the angle of incidence i and the line's width s in px: a thousandth of the time of the ray caster, with
the same geometry, noise of the sensor and blur along the line. Left out: texture, gloss, reflections.

A head below the belt is the same rig turned about X: it sees the product's underside in a gap, and no belt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from roemetry.config.scan_part import ScanPart
from roemetry.config.scene_parts import family_options
from roemetry.errors import MisfitError
from roemetry.records import Frame, ProductTruth, Simulated, Truth
from roemetry_kernels.compiling import kernel
from roemetry_simulate.optics import camera_ray
from roemetry_simulate.products import MODELS, PRODUCTS, Drawn
from roemetry_simulate.raycast import AnyBody, first_hit, normal_at, sees
from roemetry_simulate.scene import RayCasterLaser, RayCasterOptions
from roemetry_simulate.solid import EmptyBelt, Solid
from roemetry_simulate.targets import RigSimulator

Floats = NDArray[np.float64]

_BLUR_ROWS = 7
"""Rows that a lens blurs over, at most."""
_UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
_BESIDE_PX = 20.0
"""Half the distance of the two places that give a row's line in the plane of light, px."""


class MovingBeltOptions(RayCasterOptions):
    """A scene whose product moves."""

    scan: ScanPart = Field(default_factory=ScanPart, description="the belt and the frames")

    @field_validator("laser")
    @classmethod
    def _is_a_line(cls, laser: RayCasterLaser) -> RayCasterLaser:
        for name in ("dots", "grid", "circles"):
            if getattr(laser, name) is not None:
                raise MisfitError(((name,), "a belt scan is made of lines"))
        return laser


class MovingBelt(RigSimulator[MovingBeltOptions]):
    """Makes scans: frames one below the other in one tall image, with their counts."""

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make one product's scan; the frames are one image of role laser, `lines` says their counts."""
        drawn = self.drawn(number, seed)
        frames = [frame for _, _, frame in self.frames(drawn, seed + number)]
        counts, _ = self.belt(drawn, seed + number)
        tall = Frame(np.vstack(frames), bit_depth=self.options.camera.bit_depth, sensor=self.sensor())
        truth = Truth((ProductTruth() if drawn is None else drawn.truth,))
        return Simulated((tall,), truth, counts=self.options.scan.shown(counts))

    def drawn(self, number: int, seed: int) -> Drawn | None:
        """Draw the product of an item; None for an empty belt."""
        part = self.options.product
        if part.family not in PRODUCTS:
            return None
        chosen = part.items[number] if number < len(part.items) else None
        own = seed + number if chosen is None else chosen.seed
        options = family_options(
            part.family, part.options | ({} if chosen is None else chosen.options), MODELS
        )
        return PRODUCTS[part.family].draw(own, options)

    def belt(self, drawn: Drawn | None, seed: int) -> tuple[NDArray[np.int64], Floats]:
        """Give (line,) counts, and (line, 3) by how much the product has moved since it lay at X = 0, mm."""
        # an empty belt has an extent, too, so that lines are made
        extent = (-1.0, 1.0) if drawn is None else drawn.solid.footprint_extent_mm()[:2]
        return self.options.scan.run(extent, self.rig.laser.x_mm(0.0, 0.0), seed)

    def crossings(self, drawn: Drawn | None, seed: int) -> Iterator[tuple[Floats, Floats]]:
        """Give of each line (stripe, row) where it shows, px, NaN nowhere, and how brightly, 0 to 1."""
        solid: Solid = EmptyBelt() if drawn is None else drawn.solid
        body, camera, laser = solid.body(), self.rig.camera, self.rig.laser
        below_mm = self.options.scan.below_mm
        side, turn, place = 1.0, np.eye(3), np.zeros(3)
        if below_mm is not None:
            side, turn, place = -1.0, _UPSIDE_DOWN, np.array([0.0, 0.0, below_mm])
        normals, axis = laser.normals @ turn, turn @ laser.line_axis
        runs = self.options.scan.runs(laser.projector_mm, laser.line_axis, laser.x_mm(0.0, 0.0))
        for shift in self.belt(drawn, seed)[1]:
            # the rig moves against the belt, in the product's frame
            to = place - shift
            packed = camera.packed()
            packed[:3] = turn @ camera.centre_mm + to
            yield _cross(
                body, packed, turn @ camera.rotation, turn @ laser.projector_mm + to, normals,
                laser.offsets_mm + normals @ to, axis, runs, camera.height_px, camera.width_px,
                camera.distorts, side,
            )  # fmt: skip

    def frames(self, drawn: Drawn | None, seed: int) -> Iterator[tuple[Floats, Floats, NDArray[Any]]]:
        """Give of each line where it shows, how brightly, and the frame."""
        import cv2

        rng = np.random.default_rng([seed, 89])
        options, sensor = self.options, self.rig.sensor
        white = 2**sensor.bit_depth - 1
        grey = self.rig.laser.peak_grey * options.surface.albedo_laser
        for x_px, bright in self.crossings(drawn, seed):
            light = np.full((self.rig.camera.height_px, self.rig.camera.width_px), self.rig.ambient_grey)
            _draw(x_px, bright * grey[:, None], options.scan.line_sigma_px, light)
            # along the line the lens blurs as well: no edge is sharper than it draws
            light = cv2.GaussianBlur(light, (1, _BLUR_ROWS), 0.0, sigmaY=sensor.psf_sigma_px)
            if sensor.speckle_contrast:
                grain = 1.0 + sensor.speckle_contrast * rng.standard_normal(light.shape)
                light = np.maximum(light + (light - self.rig.ambient_grey) * (grain - 1.0), 0.0)
            # shot noise of many electrons and the read noise are one normal number
            spread = np.sqrt(light * sensor.grey_per_electron + sensor.read_noise_grey**2)
            seen = light + sensor.black_level_grey + spread * rng.standard_normal(light.shape)
            kind = np.uint8 if sensor.bit_depth <= 8 else np.uint16
            yield x_px, bright, np.clip(np.floor(seen + 0.5), 0, white).astype(kind)

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Give the true rig, where each target lay, and how the belt runs."""
        told = super().calibration_truth(seed)
        return {**told, "mm_per_count": self.options.scan.told_motion()}


@kernel
def _cross(
    body: AnyBody, pinhole: Floats, rotation: Floats, projector: Floats, normals: Floats, offsets: Floats,
    axis: Floats, runs: Floats, rows: int, columns: int, distorts: bool, side: float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Give where planes of light show, and how brightly; `side` is 1 for a head above, −1 for one below.

    Light goes where the cosine of its angle with the fan's `axis` lies within `runs`.
    """
    count = offsets.size
    found, bright = np.full((count, rows), np.nan), np.zeros((count, rows))
    near, far, d, o = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    view, point, normal, beam, scratch = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    reach = body.reach
    # above the body, or below the belt for a head that looks up
    start = max(reach[5], 0.0) + 1.0 if side > 0.0 else -1.0
    for i in range(count):
        n, offset = normals[i], offsets[i]
        # the next row's crossing is near this one's
        guess = 0.5 * columns
        for row in range(rows):
            x = guess
            good = True
            # without distortion a row's sight and the plane meet in one straight line: one step is exact
            for _ in range(3 if distorts else 1):
                # two places of the row on the plane: a line in space
                _lift(pinhole, rotation, n, offset, x - _BESIDE_PX, row, view, near)
                _lift(pinhole, rotation, n, offset, x + _BESIDE_PX, row, view, far)
                length = 0.0
                for k in range(3):
                    d[k] = far[k] - near[k]
                    length += d[k] * d[k]
                length = math.sqrt(length)
                # followed from the rig towards the belt
                if side * d[2] > 0.0:
                    length = -length
                for k in range(3):
                    d[k] /= length
                # the line runs level: it meets nothing that this head sees
                if side * d[2] > -1e-6:
                    good = False
                    break
                for k in range(3):
                    o[k] = near[k] + (start - near[2]) / d[2] * d[k]
                on = first_hit(body, reach, o, d, 1e-9, point)
                if on < 0:
                    good = False
                    break
                x = _column(pinhole, rotation, point, row, x)
            # outside the image
            if not good or not (-0.5 <= x < columns - 0.5):
                continue
            guess = x
            normal_at(body, on, point, normal)
            # met by the plane, but hidden from the camera
            if sees(body, reach, point, normal, pinhole[:3], beam, scratch) <= 0.0:
                continue
            light = sees(body, reach, point, normal, projector, beam, scratch)
            run = 0.0
            for k in range(3):
                run -= beam[k] * axis[k]
            # within the part of the fan that the projector lights
            if light > 0.0 and runs[0] <= run <= runs[1]:
                found[i, row], bright[i, row] = x, light
    return found, bright


@kernel
def _lift(
    pinhole: Floats, rotation: Floats, n: Floats, offset: float, x_px: float, row: float, view: Floats,
    out: Floats,
) -> None:  # fmt: skip
    """Write where a pixel's ray meets a plane of light."""
    camera_ray(pinhole, rotation, x_px, row, view)
    over, along = offset, 0.0
    for k in range(3):
        over -= n[k] * pinhole[k]
        along += n[k] * view[k]
    for k in range(3):
        out[k] = pinhole[k] + over / along * view[k]


@kernel
def _column(pinhole: Floats, rotation: Floats, point: Floats, row: float, start: float) -> float:
    """Give the column in which a row's rays come nearest to a point, by Newton's steps along the row."""
    view, other = np.zeros(3), np.zeros(3)
    x = start
    # the direction to the point, turned into the camera, as a ratio x / z
    to = np.zeros(3)
    for k in range(3):
        to[k] = point[k] - pinhole[k]
    wanted = _ratio(rotation, to)
    for _ in range(20):
        camera_ray(pinhole, rotation, x, row, view)
        camera_ray(pinhole, rotation, x + 1.0, row, other)
        # secant over one pixel
        here, ahead = _ratio(rotation, view), _ratio(rotation, other)
        step = (wanted - here) / (ahead - here)
        x += step
        if abs(step) < 1e-10:
            break
    return x


@kernel
def _ratio(rotation: Floats, way: Floats) -> float:
    """Give x over z of a direction in the camera's frame."""
    x = z = 0.0
    for k in range(3):
        x += rotation[k, 0] * way[k]
        z += rotation[k, 2] * way[k]
    return x / z


@kernel
def _draw(x_px: Floats, grey: Floats, sigma: float, image: Floats) -> None:
    """Add each line's light to an image."""
    # beyond five deviations nothing is left
    reach = math.ceil(5.0 * sigma)
    for i in range(x_px.shape[0]):
        for row in range(x_px.shape[1]):
            x = x_px[i, row]
            if math.isnan(x):
                continue
            middle = math.floor(x + 0.5)
            for k in range(max(middle - reach, 0), min(middle + reach + 1, image.shape[1])):
                off = (k - x) / sigma
                image[row, k] += grey[i, row] * math.exp(-0.5 * off * off)
