"""What is traced: rigs, what lies on the belt, and where each plane of light meets it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from benchmarks.volume_scenes import view_of
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_simulate.optics import Camera, LaserFan, camera_ray, fan_through, looking_down
from roemetry_simulate.population import moved
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.herring import FURTHER_KINDS, build, draw
from roemetry_simulate.products.herring import KINDS as DRAWN_KINDS
from roemetry_simulate.raycast import first_hit, normal_at, sees
from roemetry_simulate.solid import Body, GriddedSolid, Solid

TALLEST_MM = 20.0
"""Height of the tallest skeins: `displacement` counts the shift of a point at this height in spacings."""


@dataclass(frozen=True, eq=False)
class CodingRig:
    """A camera and a fan of light planes, and what is needed to draw peaks."""

    name: str
    """Its kind: ``easy`` or ``dense``."""
    camera: Camera
    laser: LaserFan
    """camera, laser: the true ones."""
    noise_px: float
    """Standard deviation of a peak's centre where the stripe has its usual width, px."""
    height_range_mm: tuple[float, float]
    """Heights that the calibration says it is meant for, mm."""

    @property
    def rows(self) -> int:
        """Image rows."""
        return self.camera.height_px

    def line_px(self, height_mm: float) -> Floats:
        """(stripe, row) where the planes meet a level height in the image, px."""
        y_mm = np.linspace(-250.0, 250.0, 2001)
        x_mm = self.laser.x_mm(y_mm, np.full_like(y_mm, height_mm))
        rows = np.arange(self.rows, dtype=np.float64)
        lines = []
        for stripe in range(self.laser.count):
            points = np.column_stack([x_mm[:, stripe], y_mm, np.full_like(y_mm, height_mm)])
            image = self.camera.project(points)
            order = np.argsort(image[:, 1])
            lines.append(np.interp(rows, image[order, 1], image[order, 0]))
        return np.array(lines)

    def displacement_spacings(self, height_mm: float = TALLEST_MM) -> float:
        """Shift of a point at a height, over the mean spacing of the rest lines, in the middle row."""
        middle = self.rows // 2
        rest, lifted = self.line_px(0.0)[:, middle], self.line_px(height_mm)[:, middle]
        return float(np.abs(lifted - rest).mean() / np.diff(rest).mean())

    def calibration(self) -> Calibration:
        """Give the exact calibration, with what the paper's triangulation needs of it."""
        rest = self.line_px(0.0)
        from_middle = np.arange(self.rows) - 0.5 * (self.rows - 1)
        rest_px = np.polynomial.polynomial.polyfit(from_middle, rest.T, 3).T
        per_mm = (self.line_px(1.0) - self.line_px(-1.0))[:, self.rows // 2] / 2.0
        scale = float(self.camera.centre_mm[2] / self.camera.focal_length_px)
        return Calibration(
            method="block-linear", image_size=(self.camera.height_px, self.camera.width_px), turn_deg=0,
            rest_px=rest_px, displacement_px_per_mm=per_mm, height_range_mm=self.height_range_mm,
            parameters={"omega_mm_per_px": 1.0 / per_mm, "mm_per_px": np.array([scale])},
            covariance=np.zeros((per_mm.size + 1, per_mm.size + 1)), extractor={"use": "exact"},
            view=view_of(self),
        )  # fmt: skip


def easy_rig(seed: int | None = None, displacement: float = 1.3, *, planes: int = 11) -> CodingRig:
    """Give the easy rig: 640 × 480, 11 stripes, little perspective.

    Parameters
    ----------
    seed
        None gives the nominal rig; a number draws one: laser on either side, all poses and spacings a little
        different.
    displacement
        Shift of a point 20 mm high, in spacings: by the spacing of the stripes.
    planes
        Number of stripes.
    """
    vary, side = _drawing(seed, 101)
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0 * vary(1.0, 0.06),
        tilt_x_deg=vary(1.0, 2.0), tilt_y_deg=vary(-0.4, 2.0),
    )  # fmt: skip
    projector = (side * 160.0 * vary(1.0, 0.15), vary(-4.0, 12.0), 300.0 * vary(1.0, 0.08))
    rig = _rig("easy", camera, projector, 8.75, planes, vary, sigma_mm=0.31, noise_px=0.08)
    return _spaced(rig, displacement, vary)


def dense_rig(seed: int | None = None) -> CodingRig:
    """Give the dense rig: 21 stripes, wide angle, camera and projector near, speckle; see `easy_rig`."""
    vary, side = _drawing(seed, 202)
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=8.0, distance_mm=160.0 * vary(1.0, 0.06),
        tilt_x_deg=vary(2.0, 3.0), tilt_y_deg=vary(-1.0, 3.0),
    )  # fmt: skip
    projector = (side * 110.0 * vary(1.0, 0.15), vary(-5.0, 15.0), 190.0 * vary(1.0, 0.1))
    rig = _rig("dense", camera, projector, 5.0, 21, vary, sigma_mm=0.22, noise_px=0.25)
    return _spaced(rig, 2.5, vary)


Vary = Callable[[float, float], float]


def _drawing(seed: int | None, own: int) -> tuple[Vary, float]:
    """Give what draws about a middle, by so much at most, or gives the middle; and the laser's side."""
    if seed is None:
        return lambda middle, reach: middle, 1.0
    rng = np.random.default_rng([seed, own])
    side = 1.0 if rng.random() < 0.5 else -1.0
    return lambda middle, reach: float(middle + reach * rng.uniform(-1.0, 1.0)), side


def _rig(
    name: str, camera: Camera, projector: tuple[float, float, float], spacing_mm: float, planes: int,
    vary: Vary, *, sigma_mm: float, noise_px: float,
) -> CodingRig:  # fmt: skip
    power = np.array([vary(1.0, 0.1) for _ in range(planes)])
    # lifted points go away from the projector: the fan's middle leaves room for that
    lines_x = spacing_mm * (np.arange(planes) - 0.5 * (planes - 1)) - 3.0 * np.sign(projector[0])
    turn = {"yaw_deg": vary(0.6, 2.0), "pitch_deg": vary(0.3, 1.0)}
    laser = fan_through(projector, lines_x, **turn, sigma_mm=sigma_mm, peak_grey=370.0 * power)
    return CodingRig(name, camera, laser, noise_px, (-1.0, 26.0))


def _spaced(rig: CodingRig, displacement: float, vary: Vary) -> CodingRig:
    """Space the planes so that the wanted displacement comes out, each spacing a little different."""
    laser, planes = rig.laser, rig.laser.count
    lines_x = laser.x_mm(0.0, 0.0)
    spacing = float(np.diff(lines_x).mean()) * rig.displacement_spacings() / displacement
    steps = np.array([spacing * vary(1.0, 0.02) for _ in range(planes - 1)])
    placed = np.concatenate([[0.0], np.cumsum(steps)])
    placed += lines_x.mean() - placed.mean()
    axis = laser.line_axis
    yaw = float(np.rad2deg(np.arctan2(-axis[0], axis[1])))
    pitch = float(np.rad2deg(np.arcsin(axis[2])))
    fan = fan_through(
        laser.projector_mm, placed, yaw_deg=yaw, pitch_deg=pitch, sigma_mm=laser.sigma_mm,
        peak_grey=laser.peak_grey,
    )  # fmt: skip
    return replace(rig, laser=fan)


KINDS = DRAWN_KINDS + FURTHER_KINDS
"""Every kind of skein: healthy, and with each defect."""

SHAPES = ("wedge", "sphere", "cylinder", "block", "potato")
_GRID_MM = 0.25


def skein(seed: int, kind: str) -> Solid:
    """Make a skein of a kind, on a grid of 0.25 mm."""
    return build(draw(seed, kind), _GRID_MM).solid


def shape(seed: int, name: str) -> Solid:
    """Make a plain shape with sizes drawn from the seed, at most about 20 mm high (a potato 24 mm)."""
    rng = np.random.default_rng([seed, 303])
    u = rng.uniform
    sizes: dict[str, dict[str, Any]] = {
        "wedge": {
            "length_mm": u(40, 90), "width_mm": u(20, 45), "low_height_mm": u(0, 4),
            "high_height_mm": u(8, 20),
        },
        "sphere": {"radius_mm": u(6, 10)},
        "cylinder": {"length_mm": u(30, 90), "radius_mm": u(6, 10), "half": bool(u() < 0.5)},
        "block": {"length_mm": u(20, 90), "width_mm": u(15, 45), "height_mm": u(4, 20)},
        "potato": {
            "length_range_mm": (50.0, 80.0), "width_range_mm": (26.0, 40.0),
            "thickness_range_mm": (14.0, 24.0),
        },
    }  # fmt: skip
    family = PRODUCTS[name]
    options = family.Options(**sizes[name], turn_range_deg=20.0, offset_range_x_mm=6.0, offset_range_y_mm=6.0)
    return family.draw(seed, options).solid


def grown(solid: Solid, factor: float) -> GriddedSolid:
    """Make a gridded body taller by a factor."""
    assert isinstance(solid, GriddedSolid)
    layers = solid.grid * np.array([factor, factor**2, factor**2])
    return replace(solid, grid=layers)


def side_by_side(one: Solid, other: Solid, x_mm: float) -> GriddedSolid:
    """Put two gridded bodies on one belt, the first moved by −x, the second by +x; they must not touch."""
    assert isinstance(one, GriddedSolid)
    assert isinstance(other, GriddedSolid)
    step = one.step_mm
    shift = step * round(x_mm / step)
    bodies = [moved(one, -shift), moved(other, shift)]
    x0 = min(body.x0_mm for body in bodies)  # type: ignore[attr-defined]
    y0 = min(body.y0_mm for body in bodies)  # type: ignore[attr-defined]
    at = [
        (round((body.y0_mm - y0) / step), round((body.x0_mm - x0) / step), body.grid)  # type: ignore[attr-defined]
        for body in bodies
    ]
    rows = max(j + grid.shape[0] for j, _, grid in at)
    columns = max(i + grid.shape[1] for _, i, grid in at)
    layers = np.empty((rows, columns, 3))
    layers[...] = [2.0, -50.0, -50.0]
    for j, i, grid in at:
        here = layers[j : j + grid.shape[0], i : i + grid.shape[1]]
        inside = grid[..., 1] > here[..., 1]
        here[inside] = grid[inside]
    return GriddedSolid(x0, y0, step, layers)


def in_view(solid: Solid, rig: CodingRig) -> Solid:
    """Move a body along X so that it lies about the middle of what the planes and the camera see of it."""
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    lines_x = rig.laser.x_mm(0.5 * (y_min + y_max), 4.0)
    spacing = float(np.diff(np.sort(lines_x)).mean())
    low, high = float(lines_x.min()) - 1.2 * spacing, float(lines_x.max()) + 1.2 * spacing
    shift = max(low - x_min, 0.0) + min(high - x_max, 0.0)
    return solid if shift == 0.0 else moved(solid, shift)


STEP_PX = 0.5
"""Pitch at which rows are searched; what is thinner between two jumps of depth is missed, as by a camera."""
_COARSE_PX = 8.0
"""The same where the belt is bare: there each plane is met once."""


class Crossings(NamedTuple):
    """All crossings, sorted by row, then by x; a stripe may have several in a row."""

    row: Integers
    stripe: Integers
    """row, stripe: (crossing,) image row, and stripe from 0, left to right."""
    x_px: Floats
    """(crossing,) sub-pixel place in the row."""
    xyz_mm: Floats
    """(crossing, 3) the point in the belt frame."""
    on_product: Flags
    """(crossing,) True on a product, False on the belt."""
    cosine: Floats
    """(crossing,) of the angle between the surface's normal and the light."""
    mm_per_px: Floats
    """(crossing,) by how much the distance to the light plane changes along the row."""


def crossings_of(camera: Camera, laser: LaserFan, solid: Solid) -> Crossings:
    """Find all crossings of a scene."""
    planes = np.column_stack([laser.normals, laser.offsets_mm])
    found, numbers = _search(
        solid.body(), camera.packed(), camera.rotation, laser.projector_mm, planes,
        camera.height_px, camera.width_px, _where(camera, solid),
    )  # fmt: skip
    order = np.lexsort((found[:, 0], numbers[:, 0]))
    found, numbers = found[order], numbers[order]
    columns = found[:, 0], found[:, 1:4], numbers[:, 2] == 1, found[:, 4], found[:, 5]
    return Crossings(*(column.copy() for column in (numbers[:, 0], numbers[:, 1], *columns)))


def _where(camera: Camera, solid: Solid) -> Floats:
    """First and last row, first and last column in which the body may be seen; beside it the belt is bare."""
    extent = np.array(solid.footprint_extent_mm())
    if np.isnan(extent).any():
        return np.array([1.0, 0.0, 1.0, 0.0])
    x_mm, y_mm = [extent[0] - 1.0, extent[1] + 1.0], [extent[2] - 1.0, extent[3] + 1.0]
    x, y, z = np.meshgrid(x_mm, y_mm, [0.0, solid.body().top_mm])
    seen = camera.project(np.column_stack([x.ravel(), y.ravel(), z.ravel()]))
    low, high = seen.min(axis=0) - 3.0, seen.max(axis=0) + 3.0
    return np.array([low[1], high[1], low[0], high[0]])


@njit(cache=True, nogil=True)
def _distance(
    body: Body, pinhole: Floats, rotation: Floats, plane: Floats, x_px: float, y_px: float, view: Floats,
    point: Floats, tol_mm: float,
) -> tuple[float, int]:  # fmt: skip
    """Signed distance from the plane to what the camera sees at an image point; and on what it lies."""
    camera_ray(pinhole, rotation, x_px, y_px, view)
    on = first_hit(body, body.reach, pinhole[:3], view, tol_mm, point)
    if on < 0:
        return np.nan, on
    return plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2] - plane[3], on


@njit(cache=True, nogil=True)
def _places(places: Floats, columns: int, where: Floats, dense: bool) -> int:
    """Fill in where a row is looked at: finely where the body may be, coarsely where the belt is bare."""
    filled, x_px = 0, -0.5
    while x_px < columns - 0.5:
        places[filled] = x_px
        filled += 1
        fine = dense and where[2] - _COARSE_PX <= x_px <= where[3]
        x_px += STEP_PX if fine else _COARSE_PX
    places[filled] = columns - 0.5
    return filled + 1


@njit(cache=True, nogil=True)
def _search(
    body: Body, pinhole: Floats, rotation: Floats, projector: Floats, planes: Floats, rows: int, columns: int,
    where: Floats,
) -> tuple[Floats, Integers]:  # fmt: skip
    count = planes.shape[0]
    space = 6 * count * rows
    found, numbers = np.empty((space, 6)), np.empty((space, 3), np.int64)
    filled = 0
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    before, now = np.empty(count), np.empty(count)
    places = np.empty(int(columns / STEP_PX) + columns + 2)
    for row in range(rows):
        steps = _places(places, columns, where, where[0] <= row <= where[1])
        for k in range(steps):
            camera_ray(pinhole, rotation, places[k], float(row), view)
            on = first_hit(body, body.reach, pinhole[:3], view, 1e-3, point)
            for i in range(count):
                now[i] = np.nan
                if on >= 0:
                    now[i] = -planes[i, 3]
                    for m in range(3):
                        now[i] += planes[i, m] * point[m]
            for i in range(count):
                if k == 0 or (before[i] <= 0.0) == (now[i] <= 0.0):
                    continue
                low, high, f_low, f_high = places[k - 1], places[k], before[i], now[i]
                x_px, f, on_here = low, np.inf, -1
                for turn in range(60):
                    share = f_low / (f_low - f_high) if turn % 3 < 2 else 0.5
                    if not 0.01 < share < 0.99:  # NaN, too
                        share = 0.5
                    x_px = low + share * (high - low)
                    f, on_here = _distance(body, pinhole, rotation, planes[i], x_px, row, view, point, 1e-9)
                    if abs(f) < 1e-9 or high - low < 1e-6:
                        break
                    if (f <= 0.0) == (before[i] <= 0.0):
                        low, f_low = x_px, f
                    else:
                        high, f_high = x_px, f
                if not abs(f) < 1e-3 or x_px > columns - 0.5 or filled == space:
                    continue  # a jump from one surface to another, not a crossing
                normal_at(body, on_here, point, normal)
                cosine = sees(body, body.reach, point, normal, projector, beam, scratch)
                if cosine == 0.0:
                    continue
                numbers[filled, 0], numbers[filled, 1], numbers[filled, 2] = row, i, on_here
                found[filled, 0] = x_px
                for m in range(3):
                    found[filled, 1 + m] = point[m]
                found[filled, 4] = cosine
                found[filled, 5] = abs(now[i] - before[i]) / (places[k] - places[k - 1])
                filled += 1
            for i in range(count):
                before[i] = now[i]
    return found[:filled], numbers[:filled]
