"""The simulator `mitsuba-belt`: scans of products that a belt carries through sheets of light.

Light, materials and sensor are those of `mitsuba`, so lines broaden where they graze, wet sides mirror the
line on the belt, translucent products give it back beside where it entered, and speckle is what it is. A head
below the belt is the same rig turned about X: it sees the underside in a gap, and no belt.

Belt and product move as one, by what the product moves: with `slip_share` the belt's texture slips, too.

Meshes and textures stay where they are, and the rig passes them: a frame's rays start from where camera and
projector would be, so many frames are cast at once from one scene. Of a frame of one line, one pixel in
twenty is lit directly. There, and as far as the sheet's tails reach, `samples`² rays are cast a pixel.
Everything else (what glossy sides mirror, light of the sky, and light between surfaces) varies over several
pixels, and is taken from nodes four and eight pixels apart. Left out: blur of a lens out of focus beyond the
lit band.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.config.scan_part import ScanPart
from roemetry.errors import StageError
from roemetry.records import Frame, ProductTruth, Simulated, Truth
from roemetry_mitsuba.bodies import Body
from roemetry_mitsuba.light import Floats, Lamps, Tracer, expose, filled, smoothed, spread
from roemetry_mitsuba.materials import gather_scattered
from roemetry_mitsuba.scene import Fan, MitsubaOptions
from roemetry_mitsuba.simulator import MitsubaSimulator, Placed
from roemetry_mitsuba.truth import Crossings, crossings

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


Flags = NDArray[np.bool_]

_BATCH = 16
"""Frames cast at once: half a million rays, for which a launch's 10 ms no longer count."""
_NODE_PX = 4
"""Pitch of the nodes beside the lit band; food's film mirrors a line tens of pixels wide."""
_BOUNCE_NODES = 2
"""Spacing, in nodes, of those that gather light between surfaces: 8 px, below the 2 mm it varies over."""
_REACH = 5.0
"""Of a sheet's deviation: light of e^(−12.5) of the peak, a thousandth of a grey level."""


class _Nodes(NamedTuple):
    """What frames see at their nodes, product's frame: points, normals (…, 3), anything, a body."""

    points: Floats
    normals: Floats
    valid: Flags
    body: Flags


class MovingTracer(Tracer):
    """A scene of which frames are taken while it moves."""

    def frames(self, moved_mm: Floats, lamps: Lamps, *, bounce_rays: int) -> Iterator[tuple[Floats, Floats]]:
        """Give of each place (line, 3) the laser's light and all other, grey levels over black."""
        for start in range(0, len(moved_mm), _BATCH):
            rng = np.random.default_rng([self._seed, 5, start])
            yield from self._batch(moved_mm[start : start + _BATCH], lamps, bounce_rays, rng)

    def _batch(
        self, moved: Floats, lamps: Lamps, bounce_rays: int, rng: np.random.Generator
    ) -> Iterator[tuple[Floats, Floats]]:
        nodes = self._nodes(moved)
        maps = self._at_nodes(moved, nodes, lamps, bounce_rays, rng)
        lit = self._lit(moved, nodes)
        line, pixel = np.nonzero(lit.reshape(len(moved), -1))
        close = self._at_pixels(moved, line, pixel, lamps, rng)
        # pixels are sorted by frame
        ends = np.searchsorted(line, np.arange(len(moved) + 1))
        shape = self._camera.height_px, self._camera.width_px
        for k, place in enumerate(moved):
            at, band = pixel[ends[k] : ends[k + 1]], close[:, ends[k] : ends[k + 1]]
            # nodes everywhere; then the lit band by rays of its own
            light, other, body_albedo, from_laser, from_rest = _enlarged(maps[k], shape).reshape(5, -1)
            light[at] = band[0] + band[2] * from_laser[at]
            other[at] = band[1] + band[2] * from_rest[at]
            if self._below is not None and nodes.body[k].any():
                body_albedo[at] = band[3]
                light += self._below[1] * body_albedo * self._scattered_of(place, k, nodes, at).ravel()
            yield light.reshape(shape), other.reshape(shape)

    @cached_property
    def _node_ways(self) -> Floats:
        """Unit directions (rows, columns, 3) of the nodes, which lie in the middle of their pixels."""
        middle = 0.5 * (_NODE_PX - 1)
        x, y = (
            middle + np.arange(0, many, _NODE_PX) for many in (self._camera.width_px, self._camera.height_px)
        )
        way = self._camera.directions(*np.meshgrid(x, y))
        return np.asarray(way / np.linalg.norm(way, axis=-1, keepdims=True))

    def _carry(self, moved: Floats) -> Any:
        """Let the product lie (ray, 3) further, ray by ray; give where the camera is from there."""
        # the scene stays and the rig moves back: the same light without a new scene
        self._moved = self._vector(moved)
        return self._vector(self._camera.centre_mm - moved, point=True)

    def _met(self, moved: Floats, way: Floats) -> tuple[Floats, ...]:
        """Give what rays (N, 3) from the camera meet: points, normals, whether anything, whether a body."""
        mi = self._mi
        si = self._scene.ray_intersect(mi.Ray3f(self._carry(moved), self._vector(way)))
        valid = np.array(si.is_valid())
        places = [np.array(part).T.astype(np.float64) for part in (si.p, si.sh_frame.n)]
        return places[0], places[1], valid, valid & np.array(si.shape != self._belt)

    def _nodes(self, moved: Floats) -> _Nodes:
        ways = self._node_ways
        many = ways.shape[0] * ways.shape[1]
        found = self._met(np.repeat(moved, many, axis=0), np.tile(ways.reshape(-1, 3), (len(moved), 1)))
        shape = (len(moved), *ways.shape[:2])
        return _Nodes(*(part.reshape(*shape, *part.shape[1:]) for part in found))

    def _at_nodes(
        self, moved: Floats, nodes: _Nodes, lamps: Lamps, bounce_rays: int, rng: np.random.Generator
    ) -> Floats:
        """Laser light, other light, a body's albedo, and irradiance by laser and rest, (line, …, 5)."""
        shape = nodes.valid.shape
        many = math.prod(shape[1:])
        u = rng.random((2, many * len(moved)), dtype=np.float32)
        origin = self._carry(np.repeat(moved, many, axis=0))
        way = self._vector(np.tile(self._node_ways.reshape(-1, 3), (len(moved), 1)))
        seen = self._look(origin, way, lamps, True, u[0], 0.5, u)
        light, other, albedo, body_albedo = (part.reshape(shape).astype(np.float64) for part in seen[:4])
        bounced = np.zeros((*shape, 2))
        if bounce_rays:
            first = _BOUNCE_NODES // 2
            some = (slice(None), *(slice(first, None, _BOUNCE_NODES),) * 2)
            p, n, there, body = nodes.points[some], nodes.normals[some], nodes.valid[some], nodes.body[some]
            self._carry(np.repeat(moved, bounce_rays * math.prod(there.shape[1:]), axis=0))
            gathered = self._gathered(p, n, there, lamps, True, bounce_rays, rng)
            for k, maps in enumerate(gathered):
                even = smoothed(maps, p[k], n[k], there[k], body[k])
                bounced[k] = spread(even, first, _BOUNCE_NODES, shape[1:])
        light += albedo * bounced[..., 0]
        other += albedo * bounced[..., 1]
        return np.stack([light, other, body_albedo, bounced[..., 0], bounced[..., 1]], axis=-1)

    def _lit(self, moved: Floats, nodes: _Nodes) -> Flags:
        """Mark pixels (line, height, width) that a sheet of light may reach, and those around them."""
        from scipy.ndimage import binary_dilation

        fan = self._fan
        beam = nodes.points + moved[:, None, None] - fan.origin_mm
        away = np.linalg.norm(beam, axis=-1)
        wide = np.hypot(fan.sigma_mm, fan.divergence_rad * (away - fan.waist_mm))
        near = np.zeros(nodes.valid.shape, np.bool_)
        for normal in fan.normals[fan.peak_grey > 0.0]:
            side = beam @ normal / wide
            near |= np.abs(side) < _REACH
            # between two nodes the plane may cross an edge that neither lies near
            before = np.signbit(side)
            near[:, 1:] |= before[:, 1:] != before[:, :-1]
            near[:, :, 1:] |= before[:, :, 1:] != before[:, :, :-1]
        # one node more on every side, since nodes are coarse
        near = binary_dilation(near & nodes.valid, np.ones((1, 3, 3), np.bool_))
        full = near.repeat(_NODE_PX, axis=1).repeat(_NODE_PX, axis=2)
        return np.asarray(full[:, : self._camera.height_px, : self._camera.width_px])

    def _at_pixels(
        self, moved: Floats, line: NDArray[np.int64], pixel: NDArray[np.int64], lamps: Lamps,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Laser light, other light, albedo, a body's albedo, coverage of chosen pixels, (5, N)."""
        summed, count = np.zeros((5, line.size)), self._samples**2
        if not line.size:
            return summed
        row, column = np.divmod(pixel, self._camera.width_px)
        # phases as in `Tracer.image`
        spin = ((0.7548776662466927 * column + 0.5698402909980532 * row) % 1.0).astype(np.float32)
        self._carry(moved[line])
        for k in range(count):
            origin, way = self._rays(k, spin, self._samples, pixel)
            u = rng.random((2, line.size), dtype=np.float32)
            # rays are the rig's: from there to the product's frame
            start = origin - self._moved
            summed += np.stack(self._look(start, way, lamps, True, (k + spin) / count, (k + 0.5) / count, u))
        return summed / count

    def _scattered_of(self, moved: Floats, k: int, nodes: _Nodes, at: NDArray[np.int64]) -> Floats:
        """Light scattered inside the bodies of one frame, (height, width): exact at pixels `at`."""
        assert self._below is not None
        dipole = self._below[0]
        shape = self._camera.height_px, self._camera.width_px
        beams = self._beams(dipole, moved)
        # coarse at first, then exact in the lit band
        coarse = np.zeros(nodes.body[k].shape)
        coarse[nodes.body[k]] = gather_scattered(
            nodes.points[k][nodes.body[k]] + moved, self._fan, beams, dipole
        )
        found = _enlarged(filled(coarse, nodes.body[k])[..., None], shape)[0]
        body = np.ones(shape, np.bool_)
        if at.size:
            x, y = (at % shape[1]).astype(np.float64), (at // shape[1]).astype(np.float64)
            way = self._camera.directions(x, y)
            way /= np.linalg.norm(way, axis=-1, keepdims=True)
            points, _, _, on = self._met(np.tile(moved, (at.size, 1)), way)
            given = np.zeros(at.size)
            given[on] = gather_scattered(points[on] + moved, self._fan, beams, dipole)
            found.ravel()[at], body.ravel()[at] = given, on
        return filled(found, body)


def _enlarged(maps: Floats, shape: tuple[int, int]) -> Floats:
    """Interpolate maps (rows, columns, n) of nodes to all pixels, (n, height, width)."""
    import cv2

    size = (maps.shape[1] * _NODE_PX, maps.shape[0] * _NODE_PX)
    parts = [cv2.resize(np.ascontiguousarray(part), size) for part in np.moveaxis(maps, -1, 0)]
    return np.stack([part[: shape[0], : shape[1]] for part in parts])
