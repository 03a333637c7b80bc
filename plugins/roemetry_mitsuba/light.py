"""Light of an image, by Mitsuba 3: which rays are cast, what each adds, and what the sensor makes of it.

Mitsuba's `llvm_ad_mono` variant holds meshes and textures and casts all rays; how a surface sends light on
is in `roemetry_mitsuba.materials`. What reaches a pixel is summed from

1. *direct light*, at `samples`² camera rays a pixel on a regular grid (over the aperture too, where the lens
   has a focus): each laser plane is evaluated at the visible point as a Gaussian sheet, times the cosine, the
   fall along the line and 1/distance, if a shadow ray reaches the projector; lamps alike. A stripe thus has
   no Monte Carlo noise;
2. *mirrored light*: one ray a camera ray, drawn from the product's glossy lobe, that brings back what it
   meets: false stripes of the belt in a wet side, lamps, the sky;
3. *light scattered inside* the product, gathered from beams of the projector (the dipole of `materials`);
4. *diffuse interreflection and sky*: path tracing with one further bounce from nodes four pixels apart,
   `bounce_rays` rays each, smoothed over neighbouring nodes of the same plane and spread to the pixels. It
   varies over millimetres, so this bias is far below its noise at one sample a pixel.

Grey levels over black throughout: a white (albedo 1) diffuse surface under irradiance E shows E. Left out:
more than two bounces, caustics sharper than the nodes, polarisation. Rays are float32, so a point is right
to about 0.02 µm; truth never comes from here, see `roemetry_mitsuba.truth`.

The sensor (`expose`) adds vignetting, speckle, PSF, pixel gains, shot noise, full well, read noise, steps.
Speckle multiplies the laser's light. Its intensity is drawn as that of fully developed speckle averaged over
M = 1/C² independent patterns, which is gamma distributed with mean 1 and contrast C (Goodman 2007), from a
Gaussian field of the told grain by a table of quantiles. So it is skewed as real speckle is: bright grains
are brighter than dark ones are dark.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import StageError
from roemetry_mitsuba.bodies import Body, mitsuba
from roemetry_mitsuba.materials import (
    METALS,
    STEP_MM,
    Beams,
    Dipole,
    Surface,
    diffuse,
    enter_tissue,
    gather_scattered,
    glossy,
    sample_glossy,
)
from roemetry_mitsuba.scene import Camera, Fan

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

NODE_PX = 4
"""Distance of the nodes of indirect light; 0.7 mm at 0.17 mm a pixel, below the 2 mm it varies over."""
DOME_SHARE = 0.2
"""Share of the plain light that comes from all around, not from the ring: a ring in a white housing."""
_FAINTEST = 1e-3
"""Grey level below which a stripe's tail is not looked after: 1/500 of the least noise there is."""


@dataclass(frozen=True, eq=False)
class Material:
    """What a surface is made of.

    `albedo` is a texture (rows, columns), row 0 at v = 0, and `uv`, shape (2, 4), takes (x, y, z, 1) of the
    belt frame, mm, to its coordinates in 0…1. `gloss` scales the Fresnel reflection (0 is matt),
    `roughness` is GGX α; a `metal` is a rough conductor instead. `wet` holds weights of a smoother film, of
    the albedo's shape.
    """

    albedo: Floats
    uv: Floats
    gloss: float = 0.0
    roughness: float = 0.3
    metal: str = "none"
    wet: Floats | None = None


@dataclass(frozen=True, eq=False)
class Lamps:
    """Steady light: sky, ring of lamps, stray disc; grey levels on level white at the belt's origin."""

    sky_grey: float
    ring_grey: float = 0.0
    ring_height_mm: float = 1.0
    ring_radius_mm: float = 0.0
    stray_grey: float = 0.0
    stray_mm: tuple[float, float, float] = (0.0, 0.0, 1.0)
    stray_radius_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Lens:
    """A thin lens: where it is sharp (mm along the axis), and the radius of its aperture (mm); 0 pinhole."""

    focus_mm: float = 1.0
    aperture_mm: float = 0.0


class _Look(NamedTuple):
    """A material as Mitsuba holds it: textures, and numbers of one lane."""

    albedo: Any
    uv: tuple[tuple[Any, ...], ...]
    gloss: Any
    roughness: Any
    wet: Any


class Tracer:
    """A scene in Mitsuba's hands: camera, lens, fan, belt at z = 0 or none, bodies (all of one material).

    `below` is the dipole and the share of the diffuse light that it scatters; `samples` camera rays stand
    along each side of a pixel.
    """

    def __init__(
        self, camera: Camera, lens: Lens, fan: Fan, belt: Material | None, bodies: Sequence[Body],
        material: Material, below: tuple[Dipole, float] | None, samples: int, seed: int,
    ) -> None:  # fmt: skip
        self._mi = mitsuba()
        import drjit

        self._dr = drjit
        self._camera, self._lens, self._fan = camera, lens, fan
        self._below, self._samples, self._bodies = below, samples, tuple(bodies)
        self._seed, self._material = seed, material
        self._moved = self._mi.Vector3f(0.0)
        """How far belt and bodies have moved through the rig, mm: for all rays, or lane by lane."""
        try:
            self._scene = self._build_scene(belt is not None)
        except RuntimeError as error:
            said = (str(error).strip().splitlines() or ["no reason given"])[-1]
            raise StageError(f"Mitsuba cannot take this scene: {said}", at=("product",)) from error
        # without a belt there is nothing but bodies to look up, so any material will do for it
        ground = material if belt is None else belt
        self._belt_look, self._body_look = self._look_of(ground), self._look_of(material)
        shines = material.gloss > 0.0 or material.metal != "none"
        self._has_gloss = ground.gloss > 0.0 or (bool(bodies) and shines)
        # opaque, so that another rig or light does not compile the kernels anew
        opaque = [*fan.origin_mm, *fan.axis, fan.sigma_mm, fan.waist_mm, fan.divergence_rad, fan.fall_rad]
        opaque += fan.runs
        # light is told where the fan's middle meets the belt
        middle = np.array([fan.x_mm(0.0, 0.0).mean(), 0.0, 0.0])
        self._reference_mm = float(np.linalg.norm(fan.origin_mm - middle))
        opaque.append(self._reference_mm)
        self._constants = [drjit.opaque(self._mi.Float, float(value)) for value in opaque]
        self._planes = self._mi.Float(
            np.column_stack([fan.normals, fan.peak_grey]).ravel().astype(np.float32)
        )

    def image(self, lamps: Lamps, *, laser: bool, bounce_rays: int) -> tuple[Floats, Floats]:
        """Give the laser's light and all other, grey levels over black, each of shape (height, width)."""
        shape = self._camera.height_px, self._camera.width_px
        rng = np.random.default_rng([self._seed, 3 if laser else 4])
        count = self._samples**2
        # neighbouring pixels take phases far apart, so that the PSF averages what lamps leave of grain
        row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
        # powers of 1/1.3247, the plastic number: even over both directions (Roberts 2018)
        spin = ((0.7548776662466927 * column + 0.5698402909980532 * row) % 1.0).astype(np.float32)
        summed = np.zeros((5, shape[0] * shape[1]), dtype=np.float64)
        for k in range(count):
            origin, way = self._rays(k, spin, self._samples)
            u = rng.random((2, spin.size), dtype=np.float32)
            parts = self._look(origin, way, lamps, laser, (k + spin) / count, (k + 0.5) / count, u)
            summed += np.stack(parts)
        summed /= count
        light, other, albedo, albedo_body, _ = summed.reshape(5, *shape)
        # nodes give irradiance; the pixel's own albedo sends it on
        if bounce_rays:
            from_laser, from_rest = self._bounced(lamps, laser, bounce_rays, rng)
            light = light + albedo * from_laser
            other = other + albedo * from_rest
        if laser and self._below is not None and self._bodies:
            light = light + self._below[1] * albedo_body * self._scattered()
        return light, other

    @cached_property
    def _centres(self) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:
        """What pixel centres see: points and normals (H, W, 3), whether there is any, whether a body."""
        mi = self._mi
        shape = self._camera.height_px, self._camera.width_px
        x, y = np.meshgrid(np.arange(shape[1], dtype=np.float64), np.arange(shape[0], dtype=np.float64))
        way = self._camera.directions(x.ravel(), y.ravel())
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        si = self._scene.ray_intersect(mi.Ray3f(self._point(self._camera.centre_mm), self._vector(way)))
        valid = np.array(si.is_valid())
        body = valid & np.array(si.shape != self._belt)
        places = [np.array(part).T.astype(np.float64).reshape(*shape, 3) for part in (si.p, si.sh_frame.n)]
        return places[0], places[1], valid.reshape(shape), body.reshape(shape)

    def _rays(self, k: int, spin: Singles, n: int, at: Any = slice(None)) -> tuple[Any, Any]:
        """Camera rays of the sample k of n² of pixels (all of them): origins and unit directions."""
        dx, dy = (k % n + 0.5) / n - 0.5, (k // n + 0.5) / n - 0.5
        x, y, x_right, y_right, x_down, y_down = (part[at] for part in _pinhole(self._camera))
        x = x + dx * x_right + dy * x_down
        y = y + dx * y_right + dy * y_down
        rotation = self._camera.rotation
        if self._lens.aperture_mm <= 0.0:
            origin = self._point(self._camera.centre_mm)
            way = np.stack([x, y, np.ones_like(x)], axis=-1) @ rotation.T
        else:
            # every pixel meets all places of the aperture, in an order of its own
            place = (k + np.floor(spin * n * n)) % (n * n)
            # even in area by the root, turned by the golden angle (Vogel's spiral)
            r = self._lens.aperture_mm * np.sqrt((place + 0.5) / (n * n))
            turn = 2.399963229728653 * place
            u, v = r * np.cos(turn), r * np.sin(turn)
            at = np.stack([u, v, 0 * u], axis=-1)
            # all rays of a pixel meet where the lens is sharp
            goal = self._lens.focus_mm * np.stack([x, y, np.ones_like(x)], axis=-1)
            origin = self._point(self._camera.centre_mm + at @ rotation.T)
            way = (goal - at) @ rotation.T
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
        return origin, self._vector(way)

    def _look(
        self, origin: Any, way: Any, lamps: Lamps, laser: bool, ring: NDArray[Any], disc: float, u: Singles
    ) -> list[Singles]:
        """Laser light, other light, albedo, albedo of the body, coverage, that camera rays bring back."""
        mi, dr = self._mi, self._dr
        si = self._scene.ray_intersect(mi.Ray3f(origin, way))
        active = si.is_valid()
        on_body = active & (si.shape != self._belt)
        surface, seen = self._surface(si, on_body), si.wi
        # what nodes' light is multiplied by afterwards
        albedo = dr.select(active, diffuse(dr, surface, mi.Float(1.0), seen.z), 0.0)
        share = dr.opaque(mi.Float, 0.0 if self._below is None else self._below[1])
        light, other = mi.Float(0.0), mi.Float(0.0)
        spin = mi.Float(ring)
        if laser:
            e, wo, lit = self._laser(si, active)
            # what is scattered inside comes back by the dipole, not here
            keep = dr.select(on_body, 1.0 - share, 1.0)
            given = keep * diffuse(dr, surface, wo.z, seen.z)
            if self._has_gloss:
                given += glossy(dr, surface, seen, wo)
            light += dr.select(lit, e * given, 0.0)
        other += self._lamps(si, surface, lamps, spin, disc, active)
        if self._has_gloss:
            # mirrored light: one ray of the glossy lobe, and what it meets
            wo, weight = sample_glossy(mi, surface, seen, mi.Float(u[0]), mi.Float(u[1]))
            ahead = active & (weight > 0.0)
            a, b = self._trace_bounce(si.spawn_ray(si.to_world(wo)), lamps, laser, spin, disc, ahead)
            light += dr.select(ahead, weight * a, 0.0)
            other += dr.select(ahead, weight * b, 0.0)
        covered = dr.select(on_body, mi.Float(1.0), mi.Float(0.0))
        dr.eval(light, other, albedo, covered)
        body = albedo * covered
        return [self._as_array(part, len(ring)) for part in (light, other, albedo, body, covered)]

    def _trace_bounce(
        self, ray: Any, lamps: Lamps, laser: bool, spin: Any, disc: float, active: Any
    ) -> tuple[Any, Any]:
        """What rays that left a surface meet: its laser light, and its other light or the sky's."""
        mi, dr = self._mi, self._dr
        met = self._scene.ray_intersect(ray, active)
        hit = active & met.is_valid()
        surface = self._surface(met, hit & (met.shape != self._belt))
        light = mi.Float(0.0)
        if laser:
            e, wo, lit = self._laser(met, hit)
            given = diffuse(dr, surface, wo.z, met.wi.z)
            if self._has_gloss:
                given += glossy(dr, surface, met.wi, wo)
            light = dr.select(lit, e * given, 0.0)
        sky = dr.opaque(mi.Float, lamps.sky_grey)
        # a surface that leans by θ sees (1 + cos θ)/2 of the sky
        white = diffuse(dr, surface, mi.Float(1.0), met.wi.z) * (0.5 + 0.5 * met.sh_frame.n.z)
        above = active & ~hit & (ray.d.z > 0.0)
        other = dr.select(hit, sky * white, dr.select(above, sky, 0.0))
        return light, other + self._lamps(met, surface, lamps, spin, disc, hit)

    def _surface(self, si: Any, on_body: Any) -> Surface:
        """Look up what a surface is made of, by its place."""
        mi, dr = self._mi, self._dr
        found = []
        for look in (self._body_look, self._belt_look):
            u, v = (row[0] * si.p.x + row[1] * si.p.y + row[2] * si.p.z + row[3] for row in look.uv)
            wet = 0.0 if look.wet is None else look.wet.eval(mi.Point2f(u, v))[0]
            # a wet spot has a film's full gloss, and is smoother
            gloss = look.gloss + (1.0 - look.gloss) * wet
            found.append((look.albedo.eval(mi.Point2f(u, v))[0], gloss, look.roughness * (1.0 - 0.75 * wet)))
        albedo, gloss, roughness = (
            dr.select(on_body, mi.Float(a), mi.Float(b)) for a, b in zip(*found, strict=True)
        )
        metal = METALS.get(self._material.metal)
        return Surface(albedo, gloss, roughness, metal, on_body & (metal is not None))

    def _look_of(self, material: Material) -> _Look:
        """Put a material into Mitsuba's hands; numbers are opaque, so that others compile nothing anew."""
        mi, dr = self._mi, self._dr

        def texture(values: Floats) -> Any:
            data = mi.TensorXf(np.ascontiguousarray(values[..., None], dtype=np.float32))
            return mi.Texture2f(data, wrap_mode=dr.WrapMode.Mirror)

        uv = tuple(tuple(dr.opaque(mi.Float, float(value)) for value in row) for row in material.uv)
        return _Look(
            texture(material.albedo),
            uv,
            dr.opaque(mi.Float, min(1.0, 10.0 * material.gloss)),  # 0.1 and more: the full reflection
            dr.opaque(mi.Float, material.roughness),
            None if material.wet is None else texture(material.wet),
        )

    def _laser(self, si: Any, active: Any) -> tuple[Any, Any, Any]:
        """Irradiance by the laser's sheets before the cosine, its direction (local), where it is not 0."""
        mi, dr = self._mi, self._dr
        ox, oy, oz, ax, ay, az, sigma, waist, divergence, fall, low, high, reference = self._constants
        # rays may be told in the product's frame: back to the rig's
        beam = si.p + self._moved - mi.Point3f(ox, oy, oz)
        away = dr.norm(beam)
        way = beam / away
        # the sheet's deviation by its waist and its divergence
        wide = dr.sqrt(sigma * sigma + dr.square(divergence * (away - waist)))
        total = mi.Float(0.0)
        for i in range(len(self._fan.normals)):
            n = [dr.gather(mi.Float, self._planes, mi.UInt32(4 * i + m)) for m in range(4)]
            side = (n[0] * beam.x + n[1] * beam.y + n[2] * beam.z) / wide
            total += n[3] * dr.exp(-0.5 * side * side)
        # cosine with the line's axis: where along the line
        run = way.x * ax + way.y * ay + way.z * az
        angle = dr.asin(run) / fall
        # a wider sheet is fainter, and the fan thins out by 1/distance
        total *= dr.exp(-0.5 * angle * angle) * (sigma / wide) * (reference / away)
        wo = si.to_local(-way)
        # the face itself must look at the light, whatever its interpolated normal says
        lit = (
            active
            & (run >= low)
            & (run <= high)
            & (wo.z > 0.0)
            & (total > _FAINTEST)
            & (dr.dot(si.n, -way) > 0.0)
        )
        # and nothing stands between
        lit &= ~self._scene.ray_test(si.spawn_ray_to(mi.Point3f(ox, oy, oz) - self._moved), lit)
        return dr.select(lit, total, 0.0), wo, lit

    def _lamps(self, si: Any, surface: Surface, lamps: Lamps, spin: Any, disc: float, active: Any) -> Any:
        """Light of ring and stray lamp that a surface sends towards where it is seen from."""
        mi, dr = self._mi, self._dr
        found = mi.Float(0.0)
        if lamps.ring_grey > 0.0:
            height, radius = lamps.ring_height_mm, lamps.ring_radius_mm
            turn = 2.0 * dr.pi * spin
            h, r = dr.opaque(mi.Float, height), dr.opaque(mi.Float, radius)
            to = mi.Point3f(r * dr.cos(turn), r * dr.sin(turn), h) - si.p - self._moved
            away = dr.norm(to)
            wo = si.to_local(to / away)
            # lamps face straight down: k cos / d², of the told grey level at the origin
            k = dr.opaque(mi.Float, lamps.ring_grey * (height**2 + radius**2) ** 2 / height**2)
            found += self._lamp(si, surface, to, wo, k * (to.z / away) / (away * away), active)
        if lamps.stray_grey > 0.0:
            at = np.array(lamps.stray_mm)
            # two directions across the way to the lamp, for its disc
            side = np.cross(at, [0.0, 0.0, 1.0]) if np.hypot(*at[:2]) > 1e-6 else np.array([1.0, 0.0, 0.0])
            side /= np.linalg.norm(side)
            over = np.cross(at, side) / np.linalg.norm(at)
            r = dr.opaque(mi.Float, lamps.stray_radius_mm * math.sqrt(disc))
            s, c = dr.sincos(2.0 * dr.pi * (spin + dr.opaque(mi.Float, 7.618033988749895 * disc)))
            p, q, o = (
                mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in vector)) for vector in (side, over, at)
            )
            to = o + r * (c * p + s * q) - si.p - self._moved
            away = dr.norm(to)
            k = dr.opaque(mi.Float, lamps.stray_grey * float(at @ at))
            found += self._lamp(si, surface, to, si.to_local(to / away), k / (away * away), active)
        return found

    def _lamp(self, si: Any, surface: Surface, to: Any, wo: Any, e: Any, active: Any) -> Any:
        lit = active & (wo.z > 0.0)
        lit &= ~self._scene.ray_test(si.spawn_ray_to(si.p + to), lit)
        given = diffuse(self._dr, surface, wo.z, si.wi.z)
        if self._has_gloss:
            given += glossy(self._dr, surface, si.wi, wo)
        return self._dr.select(lit, e * given, 0.0)

    def _bounced(
        self, lamps: Lamps, laser: bool, rays: int, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Irradiance by one bounce and the sky at every pixel, by the laser and by the rest."""
        points, normals, valid, body = self._centres
        first = NODE_PX // 2
        coarse = (slice(first, None, NODE_PX), slice(first, None, NODE_PX))
        p, n, there = points[coarse], normals[coarse], valid[coarse]
        maps = self._gathered(p, n, there, lamps, laser, rays, rng)
        full = spread(smoothed(maps, p, n, there, body[coarse]), first, NODE_PX, valid.shape)
        return full[..., 0], full[..., 1]

    def _gathered(
        self, p: Floats, n: Floats, there: NDArray[np.bool_], lamps: Lamps, laser: bool, rays: int,
        rng: np.random.Generator,
    ) -> Floats:  # fmt: skip
        """Irradiance (…, 2) at points with normals (…, 3), where there are any: by the laser, by the rest."""
        mi, dr = self._mi, self._dr
        count = there.size
        k = np.arange(rays)
        # a rank-1 lattice, shifted anew at each node
        u = (((k + 0.5) / rays)[None] + rng.random((count, 1))) % 1.0
        v = ((k * 0.6180339887498949)[None] + rng.random((count, 1))) % 1.0
        # drawn by the cosine, so that the plain mean is irradiance
        r, turn = np.sqrt(u), 2 * np.pi * v
        local = np.stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(1.0 - u)])
        way = _to_world(n.reshape(-1, 3), local).reshape(-1, 3)
        # a µm above the surface, or rays would meet it again
        start = np.repeat((p + 1e-3 * n).reshape(-1, 3), rays, axis=0)
        active = mi.Bool(np.repeat(there.ravel(), rays))
        ray = mi.Ray3f(self._vector(start, point=True), self._vector(way))
        spin = mi.Float(rng.random(count * rays, dtype=np.float32))
        light, other = self._trace_bounce(ray, lamps, laser, spin, 0.5, active)
        dr.eval(light, other)
        found = [
            self._as_array(part, count * rays).reshape(count, rays).mean(axis=1) for part in (light, other)
        ]
        return np.stack(found, axis=-1).reshape(*there.shape, 2).astype(np.float64)

    def _scattered(self) -> Floats:
        """Light scattered inside the bodies that leaves each pixel, grey levels on white, (height, width)."""
        assert self._below is not None
        dipole = self._below[0]
        beams = self._beams(dipole, np.zeros(3))
        points, _, _, body = self._centres
        found = np.zeros(body.shape)
        found[body] = gather_scattered(points[body], self._fan, beams, dipole)
        return filled(found, body)

    def _beams(self, dipole: Dipole, moved_mm: Floats) -> Beams:
        """Cast beams from the projector along every plane, and keep those that enter a body that moved."""
        mi, fan = self._mi, self._fan
        start = fan.origin_mm - moved_mm
        corners = np.concatenate([body.points_mm for body in self._bodies]) - start
        away = np.linalg.norm(corners, axis=1)
        angles = np.arcsin(corners @ fan.axis / away)
        # beams STEP_MM apart at the bodies' mean distance
        step = STEP_MM / float(away.mean())
        first = float(angles.min()) - 2.0 * step
        angle = first + step * np.arange(int((angles.max() - first) / step) + 3)
        # in each plane the direction across the shared axis that points at the belt
        across = np.cross(fan.axis, fan.normals)
        across *= -np.sign(across[:, 2:])
        way = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * fan.axis
        # Gauss and Hermite's nodes and weights, across the sheet
        nodes, weights = np.array([-math.sqrt(3.0), 0.0, math.sqrt(3.0)]), np.array([1.0, 4.0, 1.0]) / 6.0
        distance = float(np.median(away))
        wide = math.hypot(fan.sigma_mm, fan.divergence_rad * (distance - fan.waist_mm))
        way = way[:, :, None] * distance + (wide * nodes)[:, None] * fan.normals[:, None, None]
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        shape = way.shape[:-1]
        si = self._scene.ray_intersect(mi.Ray3f(self._point(start), self._vector(way.reshape(-1, 3))))
        valid = np.array(si.is_valid()).reshape(shape)
        on_body = valid & np.array(si.shape != self._belt).reshape(shape)
        t = np.where(valid, np.array(si.t).reshape(shape), 1.0)
        hit = np.array(si.p).T.astype(np.float64).reshape(*shape, 3) + moved_mm
        normal = np.array(si.sh_frame.n).T.astype(np.float64).reshape(*shape, 3)
        fall = np.exp(-0.5 * (angle / fan.fall_rad) ** 2)
        fall[(np.sin(angle) < fan.runs[0]) | (np.sin(angle) > fan.runs[1])] = 0.0
        # a Gaussian sheet of peak E carries E σ √(2π) per length along the line; 1/distance thins it out
        flux = fan.peak_grey[:, None] * fall * fan.sigma_mm * math.sqrt(2.0 * math.pi) * step
        power = flux[..., None] * weights * t * (self._reference_mm / t)
        source, image, entering = enter_tissue(hit, normal, on_body, way, power, dipole)
        return Beams(source, image, entering, first, step)

    def _build_scene(self, has_belt: bool) -> Any:
        mi = self._mi
        far = 1500.0  # the belt's edge: far outside of any view, in mm
        level = np.array([[-far, -far, 0.0], [far, -far, 0.0], [far, far, 0.0], [-far, far, 0.0]])
        ground = Body(level, np.array([[0, 1, 2], [0, 2, 3]]), smooth=False)
        shapes = {"belt": self._mesh("belt", ground)} if has_belt else {}
        for number, body in enumerate(self._bodies):
            shapes[f"body_{number}"] = self._mesh(f"body_{number}", body)
        self._belt = mi.ShapePtr(shapes.get("belt"))
        return mi.load_dict({"type": "scene", **shapes})

    def _mesh(self, name: str, body: Body) -> Any:
        mi = self._mi
        told = mi.Properties()
        if not body.smooth:
            told["face_normals"] = True
        points, faces = body.points_mm, body.faces
        mesh = mi.Mesh(name, len(points), len(faces), has_vertex_normals=body.smooth, props=told)
        inside = mi.traverse(mesh)
        inside["vertex_positions"] = points.astype(np.float32).ravel()
        inside["faces"] = faces.astype(np.uint32).ravel()
        if body.smooth:
            inside["vertex_normals"] = body.normals.astype(np.float32).ravel()
        inside.update()
        return mesh

    def _vector(self, values: Floats, point: bool = False) -> Any:
        mi = self._mi
        parts = (mi.Float(np.ascontiguousarray(values[:, m], dtype=np.float32)) for m in range(3))
        return (mi.Point3f if point else mi.Vector3f)(*parts)

    def _point(self, values: Floats) -> Any:
        if values.ndim > 1:
            return self._vector(values, point=True)
        return self._mi.Point3f(*(self._dr.opaque(self._mi.Float, float(value)) for value in values))

    @staticmethod
    def _as_array(part: Any, count: int) -> Singles:
        found = np.array(part, dtype=np.float32)
        return np.broadcast_to(found, (count,)) if found.size == 1 else found


@lru_cache(maxsize=1)
def _pinhole(camera: Camera) -> tuple[Floats, ...]:
    """Pinhole coordinates x, y of all pixels, then their changes over a pixel to the right and down."""
    columns, rows = np.arange(camera.width_px), np.arange(camera.height_px)
    x: Floats = np.tile(columns, len(rows)).astype(np.float64)
    y: Floats = np.repeat(rows, len(columns)).astype(np.float64)
    at = camera.undistort(x, y)
    # half a pixel: as far as rays of a pixel's samples go
    right, down = camera.undistort(x + 0.5, y), camera.undistort(x, y + 0.5)
    steps = [2.0 * (after[m] - at[m]) for after in (right, down) for m in (0, 1)]
    return (*at, *steps)


def _to_world(normals: Floats, local: Floats) -> Floats:
    """Turn local directions (3, N, R) into frames about normals (N, 3): shape (N, R, 3)."""
    # a frame without division by 0 at any normal (Duff et al. 2017)
    sign = np.where(normals[:, 2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + normals[:, 2])
    b = normals[:, 0] * normals[:, 1] * a
    s = np.stack([1.0 + sign * normals[:, 0] ** 2 * a, sign * b, -sign * normals[:, 0]], axis=-1)
    t = np.stack([b, sign + normals[:, 1] ** 2 * a, -normals[:, 1]], axis=-1)
    x, y, z = local[..., None]
    return np.asarray(x * s[:, None] + y * t[:, None] + z * normals[:, None])


def filled(found: Floats, body: NDArray[np.bool_]) -> Floats:
    """Give pixels whose centre misses the body, and which its edge still crosses, their neighbours' mean."""
    weight = np.pad(body.astype(np.float64), 1)
    padded = np.pad(found, 1)
    near = [(i, j) for i in range(3) for j in range(3)]
    rows, columns = body.shape
    total = sum(padded[i : i + rows, j : j + columns] for i, j in near)
    number = sum(weight[i : i + rows, j : j + columns] for i, j in near)
    return np.where(body, found, total / np.maximum(number, 1.0))


def smoothed(
    maps: Floats, points: Floats, normals: Floats, valid: NDArray[np.bool_], body: NDArray[np.bool_]
) -> Floats:
    """Average nodes with neighbours of the same surface that look the same way: a cross-bilateral filter."""
    reach = 3
    rows, columns = valid.shape
    apart = np.linalg.norm(np.diff(points, axis=1), axis=-1)[valid[:, 1:] & valid[:, :-1]]
    if not apart.size:
        return maps
    spacing = 1.5 * float(np.median(apart))
    total, weight = np.zeros_like(maps), np.zeros((rows, columns, 1))
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            here = (slice(max(i, 0), rows + min(i, 0)), slice(max(j, 0), columns + min(j, 0)))
            there = (slice(max(-i, 0), rows + min(-i, 0)), slice(max(-j, 0), columns + min(-j, 0)))
            same = valid[here] & valid[there] & (body[here] == body[there])
            # normals 30° apart weigh a third
            alike = np.clip(np.einsum("...i,...i->...", normals[here], normals[there]), 0.0, 1.0) ** 8
            # how far off the neighbour's plane, in spacings of nodes
            off = np.einsum("...i,...i->...", points[here] - points[there], normals[there]) / spacing
            w = (same * alike * np.exp(-0.5 * off**2 - (i * i + j * j) / (1.5 * reach**2)))[..., None]
            total[here] += w * maps[there]
            weight[here] += w
    return total / np.maximum(weight, 1e-12)


def spread(maps: Floats, first: int, step: int, shape: tuple[int, ...]) -> Floats:
    """Interpolate nodes, `step` apart from pixel `first` on, to all pixels."""
    from scipy.ndimage import map_coordinates

    rows = np.clip((np.arange(shape[0]) - first) / step, 0, maps.shape[0] - 1)
    columns = np.clip((np.arange(shape[1]) - first) / step, 0, maps.shape[1] - 1)
    at = np.meshgrid(rows, columns, indexing="ij")
    return np.stack([map_coordinates(maps[..., k], at, order=1) for k in range(maps.shape[-1])], axis=-1)


_FIXED_PATTERN_SEED = 915
"""Of the pixels' gains: they belong to the camera, so they are the same in every image of every set."""


@dataclass(frozen=True)
class Sensor:
    """What the camera does to light: see the scene's camera part; all levels in grey levels."""

    grey_per_electron: float
    read_noise_grey: float
    black_level_grey: float
    psf_sigma_px: float
    full_well_e: float
    bit_depth: int
    vignetting: float
    prnu: float
    speckle_contrast: float
    speckle_sigma_px: float


def expose(laser: Floats, other: Floats, camera: Camera, sensor: Sensor, seed: int) -> NDArray[Any]:
    """Take a picture of light in grey levels over black; uint8, or uint16 where there are more bits."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng([seed, 57])
    # speckle is of the laser's light alone
    light = other + (laser * _speckle(rng, laser.shape, sensor) if laser.any() else 0.0)
    light = light * _falloff(camera, sensor.vignetting)
    if sensor.psf_sigma_px > 0.0:
        light = gaussian_filter(light, sensor.psf_sigma_px, mode="nearest")
    if sensor.prnu > 0.0:
        light = light * (1.0 + sensor.prnu * _gains(light.shape))
    # shot noise is of whole electrons
    electrons = rng.poisson(np.maximum(light, 0.0) / sensor.grey_per_electron).astype(np.float64)
    electrons = np.minimum(electrons, sensor.full_well_e)
    grey = electrons * sensor.grey_per_electron + sensor.black_level_grey
    grey += sensor.read_noise_grey * rng.standard_normal(light.shape)
    white = 2**sensor.bit_depth - 1
    return np.clip(np.rint(grey), 0, white).astype(np.uint8 if sensor.bit_depth <= 8 else np.uint16)


@lru_cache(maxsize=1)
def _gains(shape: tuple[int, ...]) -> Floats:
    """Deviations of the pixels' gains, in units of the standard deviation."""
    return np.random.default_rng(_FIXED_PATTERN_SEED).standard_normal(shape)


def _falloff(camera: Camera, strength: float) -> Floats:
    """Relative brightness over the image."""
    x = (np.arange(camera.width_px) - camera.principal_px[0]) / camera.focal_px
    y = (np.arange(camera.height_px) - camera.principal_px[1]) / camera.focal_px
    # v = 1 is cos⁴ of the field angle
    fall: Floats = 1.0 / (1.0 + strength * np.add.outer(y * y, x * x)) ** 2
    return fall


def _speckle(rng: np.random.Generator, shape: tuple[int, ...], sensor: Sensor) -> Floats:
    """Draw a gamma field of mean 1 with the sensor's contrast and grain."""
    if sensor.speckle_contrast <= 0.0:
        return np.ones(shape)
    from scipy.ndimage import gaussian_filter

    field = rng.standard_normal(shape)
    if sensor.speckle_sigma_px > 0.0:
        field = gaussian_filter(field, sensor.speckle_sigma_px, mode="wrap")
        # smoothing took away variance
        field /= field.std()
    return np.asarray(np.interp(field, *_speckle_table(sensor.speckle_contrast)))


@lru_cache(maxsize=1)
def _speckle_table(contrast: float) -> tuple[Floats, Floats]:
    """Normal deviates, and the intensities of mean 1 that are as probable."""
    from scipy.stats import gamma, norm

    # of a gamma distribution with contrast C = 1/√M
    count = 1.0 / contrast**2
    # one pixel in 26 million lies beyond 5.5 deviations
    at = np.linspace(-5.5, 5.5, 1101)
    return at, gamma.ppf(norm.cdf(at), count) / count
