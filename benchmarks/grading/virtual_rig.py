"""Bodies measured on rigs that are drawn at random: profiles by intersection of planes and surface, no image.

Model. A body is its top surface z(x, y) on a grid of `STEP_MM`. A rig has a projector over one side of the
belt, N planes of light through it that are parallel to the belt's Y, and a camera over the middle. In each
plane and row (a constant Y) the light travels down a straight line; the first point of the surface on it is
lit. It is seen if no other part of the surface lies between it and the camera. Points that light or camera
meet at a grazing angle have no peak; some rows and whole pieces are lost at random. The noise of a peak's
place (independent, and a part that is correlated over some rows, as speckle is) moves a point along its
plane by noise · mm/px / (tan of light − tan of sight), as triangulation does; the planes' calibration errs a
little.

Assumed: pinhole and lens distortion do not matter to the shape of a section; rows are sampled at even steps
of Y; labels are right. What goes wrong in extraction and coding is not in here; `benchmarks.traced` has the
coder.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates, rotate

from roemetry.records import NOTHING, Product, Profiles
from roemetry.records.arrays import Floats
from roemetry.testing.scenes import LinearRig

STEP_MM = 0.25
"""Grid of a top surface: a quarter of the finest noise-free detail that a smoothed section keeps."""

_DEPTH_STEPS = 96
"""Places tried along a ray; the crossing between two of them is found by a straight line."""

GRAZING = 0.12
"""Cosine between normal and ray below which a peak is too wide and faint to be found: 83 degrees."""


class Surface(NamedTuple):
    """A body's top: (row of y, column of x) heights over the belt, mm, 0 outside; first x and y."""

    height_mm: Floats
    x0_mm: float
    y0_mm: float

    def at(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """Heights at places, mm, bilinear; 0 outside."""
        return map_coordinates(
            self.height_mm, [(y_mm - self.y0_mm) / STEP_MM, (x_mm - self.x0_mm) / STEP_MM], order=1, cval=0.0
        )

    def turned(self, degrees: float) -> Surface:
        """Turn the body on the belt, about the grid's middle."""
        height = np.maximum(rotate(self.height_mm, degrees, reshape=True, order=1), 0.0)
        return surface_of_grid(height)

    def mirrored(self) -> Surface:
        """Mirror the body left to right: a twist turns the other way, all other features stay."""
        return self._replace(height_mm=np.ascontiguousarray(self.height_mm[:, ::-1]))


def surface_of_grid(height_mm: Floats) -> Surface:
    """Put (row, column) heights about the belt's middle."""
    rows, columns = height_mm.shape
    return Surface(
        np.ascontiguousarray(height_mm), -0.5 * STEP_MM * (columns - 1), -0.5 * STEP_MM * (rows - 1)
    )


class Rig(NamedTuple):
    """What of a rig matters to a body's shape; mm, px and degrees as named."""

    stripes: int
    pitch_mm: float
    phase: float
    projector_x_mm: float
    projector_z_mm: float
    camera_x_mm: float
    camera_z_mm: float
    row_mm: float
    noise_px: float
    correlated_px: float
    correlation_rows: float
    plane_error_mm: float
    lost_rows: float
    lost_pieces: float


def draw_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig: 11 to 24 stripes over 95 to 125 mm, projector on either side, 20 to 50 degrees of light."""
    pitch = float(rng.uniform(4.8, 9.0))
    camera_z = float(rng.uniform(250.0, 450.0))
    side = float(rng.choice([-1.0, 1.0]))
    projector_z = float(rng.uniform(200.0, 450.0))
    return Rig(
        stripes=round(float(rng.uniform(100.0, 130.0)) / pitch),
        pitch_mm=pitch,
        phase=float(rng.uniform(-0.5, 0.5)),
        projector_x_mm=side * projector_z * float(np.tan(np.radians(rng.uniform(20.0, 50.0)))),
        projector_z_mm=projector_z,
        camera_x_mm=-side * float(rng.uniform(0.0, 60.0)),
        camera_z_mm=camera_z,
        row_mm=float(rng.uniform(0.1, 0.3)),
        noise_px=float(np.exp(rng.uniform(np.log(0.04), np.log(0.3)))),
        correlated_px=float(rng.uniform(0.0, 0.12)),
        correlation_rows=float(rng.uniform(1.0, 4.0)),
        plane_error_mm=float(rng.uniform(0.0, 0.04)),
        lost_rows=float(rng.uniform(0.0, 0.05)),
        lost_pieces=float(rng.choice([0.0, 0.0, 0.03])),
    )


def measured(surface: Surface, rig: Rig, rng: np.random.Generator) -> Product:
    """Measure a body on a rig: product 1 of its profiles, without belt points and without an outline."""
    rest = (np.arange(rig.stripes) - 0.5 * (rig.stripes - 1) + rig.phase) * rig.pitch_mm
    lean = (rest - rig.projector_x_mm) / rig.projector_z_mm  # of the light: dx for each mm down
    y = np.arange(surface.y0_mm, -surface.y0_mm, rig.row_mm)
    xyz = _first_lit(surface, rest, lean, y)
    seen = np.isfinite(xyz[..., 2]) & _seen(surface, xyz, rig) & ~_grazed(surface, xyz, lean, rig)
    sight = (xyz[..., 0] - rig.camera_x_mm) / (rig.camera_z_mm - xyz[..., 2])
    gain = rig.row_mm / np.abs(lean[:, None] - sight)  # mm of height for each px: one px is a row wide
    shape = xyz.shape[:2]
    smooth = gaussian_filter1d(rng.standard_normal(shape), rig.correlation_rows, axis=1)
    smooth *= np.sqrt(2.0 * np.sqrt(np.pi) * rig.correlation_rows)
    px = rig.noise_px * rng.standard_normal(shape) + rig.correlated_px * smooth
    rise = px * gain + rig.plane_error_mm * rng.standard_normal(len(rest))[:, None]
    xyz[..., 2] += rise
    xyz[..., 0] -= rise * lean[:, None]
    seen &= rng.uniform(size=shape) >= rig.lost_rows
    for k in range(shape[0]):
        if rng.uniform() < rig.lost_pieces * 10.0:
            first, count = int(rng.integers(shape[1])), round(float(rng.uniform(1.0, 5.0)) / rig.row_mm)
            seen[k, first : first + count] = False
    xyz[~seen] = np.nan
    rows = np.broadcast_to(np.arange(shape[1], dtype=np.float64), shape)
    normal = np.stack([np.ones_like(lean), np.zeros_like(lean), lean, rest], axis=1)
    std_mm = np.where(seen, np.hypot(rig.noise_px, rig.correlated_px) * gain, np.nan)
    profiles = Profiles(
        xyz_mm=xyz, product=np.where(seen, 1, NOTHING).astype(np.int16), seen=seen,
        x_px=np.where(seen, (rig.camera_x_mm + sight * rig.camera_z_mm) / rig.row_mm, np.nan),
        row_px=np.where(seen, rows, np.nan), height_std_mm=std_mm, stripe=np.arange(shape[0]),
        frame=np.zeros(shape[0], np.int64), plane=normal / np.hypot(1.0, lean)[:, None],
    )  # fmt: skip
    known = LinearRig(stripes=rig.stripes, spacing_px=10.0, first_px=5.0).calibration()
    displacement = np.abs(lean - (rest - rig.camera_x_mm) / rig.camera_z_mm) / rig.row_mm
    return Product(1, profiles, replace(known, displacement_px_per_mm=displacement), ("scene",))


def _first_lit(surface: Surface, rest: Floats, lean: Floats, y: Floats) -> Floats:
    """(stripe, row, 3) first point of the surface on each ray of light; NaN where that is the belt."""
    top = float(surface.height_mm.max()) + 0.5
    levels = np.linspace(top, 0.0, _DEPTH_STEPS)
    x = rest[:, None, None] - lean[:, None, None] * levels
    shape = (len(rest), len(y), _DEPTH_STEPS)
    over = levels - surface.at(np.broadcast_to(x, shape), np.broadcast_to(y[None, :, None], shape))
    under = over[..., :-1] <= 0.0
    first = np.argmax(under, axis=-1)
    hit = under.any(axis=-1) & (first > 0)
    first = np.maximum(first, 1)
    take = np.take_along_axis
    before, after = take(over, first[..., None] - 1, -1)[..., 0], take(over, first[..., None], -1)[..., 0]
    share = before / np.maximum(before - after, 1e-9)
    z = levels[first - 1] + share * (levels[1] - levels[0])
    xyz = np.stack([rest[:, None] - lean[:, None] * z, np.broadcast_to(y, z.shape), z], axis=-1)
    xyz[~hit] = np.nan
    return xyz


def _seen(surface: Surface, xyz: Floats, rig: Rig) -> np.ndarray:
    """Whether nothing stands between a point and the camera."""
    z = xyz[..., 2]
    away = (rig.camera_x_mm - xyz[..., 0]) / (rig.camera_z_mm - z)
    way = np.linspace(0.3, 12.0, 24)
    x = xyz[..., 0, None] + away[..., None] * way
    y = np.broadcast_to(xyz[..., 1, None], x.shape)
    known = np.isfinite(z)
    clear = np.zeros(z.shape, np.bool_)
    clear[known] = (surface.at(x[known], y[known]) < z[known][:, None] + way).all(axis=-1)
    return clear


def _grazed(surface: Surface, xyz: Floats, lean: Floats, rig: Rig) -> np.ndarray:
    """Whether light or camera meet the surface too flat for a peak."""
    x, y, z = np.moveaxis(np.nan_to_num(xyz), -1, 0)
    step = 2.0 * STEP_MM
    dx = (surface.at(x + step, y) - surface.at(x - step, y)) / (2.0 * step)
    dy = (surface.at(x, y + step) - surface.at(x, y - step)) / (2.0 * step)
    norm = np.sqrt(1.0 + dx**2 + dy**2)
    to_light = -lean[:, None]
    of_light = (1.0 - dx * to_light) / (norm * np.hypot(1.0, to_light))
    to_camera = (rig.camera_x_mm - x) / (rig.camera_z_mm - z)
    of_camera = (1.0 - dx * to_camera) / (norm * np.hypot(1.0, to_camera))
    return np.asarray(np.minimum(of_light, of_camera) < GRAZING)
