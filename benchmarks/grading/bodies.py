"""Families of bodies for grading: our simulator's skeins, a second family of skeins, meshes, other products.

The second family (`second_skein`) shares no line with the simulator's. Stations along an axis y = f(x) carry
superellipse sections (exponent 1.7 to 2.8) that are turned about the axis by the lean and clipped at the
belt; width and height follow independent blunt tapers with slow ripples; waves of 6 to 30 mm lie on the
surface. Its axis and lean wander more in some populations' good bodies than others' defects do: a model that
learns from all of them must then doubt. Its defects are drawn over a wide range of size: one to three dents
(Gaussian or paraboloid), bends (arc, kink or S), twists (even or local), folds (a crease across, a lip, a
step of the axis), broken ends (an oblique cut).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.grading.virtual_rig import STEP_MM, Surface, surface_of_grid
from roemetry.records.arrays import Floats, Integers
from roemetry_simulate.products import PRODUCTS

MARGIN_MM = 4.0
CLASSES = ("good", "dent", "bend", "twist", "fold", "broken")
OUR_KINDS = {
    "good": ("healthy",), "dent": ("dented", "dented", "several-dents"), "bend": ("bent", "s-bent"),
    "twist": ("twisted",), "fold": ("folded",), "broken": ("broken",),
}  # fmt: skip


class Body(NamedTuple):
    """A body, the same one without its defect on the same grid, and its class."""

    surface: Surface
    sound: Surface
    label: str


def our_skein(seed: int, label: str) -> Body:
    """Draw a skein of the simulator's family `herring-roe` with a class of defect."""
    kinds = OUR_KINDS[label]
    made = PRODUCTS["herring-roe"]
    drawn = made.draw(seed, made.Options(kinds={kinds[seed % len(kinds)]: 1.0}, grid_step_mm=0.25))
    extents = np.array([drawn.solid.footprint_extent_mm(), drawn.reference.footprint_extent_mm()])
    x = np.arange(extents[:, 0].min() - MARGIN_MM, extents[:, 1].max() + MARGIN_MM, STEP_MM)
    y = np.arange(extents[:, 2].min() - MARGIN_MM, extents[:, 3].max() + MARGIN_MM, STEP_MM)
    tops = [_top(solid.heights_mm, x, y) for solid in (drawn.solid, drawn.reference)]
    return Body(tops[0], tops[1], label)


def _top(heights: Callable[[Floats, Floats], tuple[Floats, Floats]], x: Floats, y: Floats) -> Surface:
    one, other = heights(*np.meshgrid(x, y))
    return surface_of_grid(np.nan_to_num(np.fmax(one, other)))


def of_meshes(meshes: list[tuple[Floats, Integers]]) -> list[Surface]:
    """Take the tops of closed meshes that lie on the belt, by rays from above, on one grid."""
    import open3d as o3d

    low = np.min([points.min(axis=0) for points, _ in meshes], axis=0)
    high = np.max([points.max(axis=0) for points, _ in meshes], axis=0)
    x = np.arange(low[0] - MARGIN_MM, high[0] + MARGIN_MM, STEP_MM)
    y = np.arange(low[1] - MARGIN_MM, high[1] + MARGIN_MM, STEP_MM)
    grid_x, grid_y = np.meshgrid(x, y)
    from_mm = float(high[2]) + 10.0
    rays = np.stack([grid_x, grid_y, np.full_like(grid_x, from_mm)], axis=-1)
    rays = np.concatenate([rays, np.broadcast_to([0.0, 0.0, -1.0], rays.shape)], axis=-1)
    found = []
    for points, faces in meshes:
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(points.astype(np.float32), faces.astype(np.uint32))
        away = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy().astype(np.float64)
        height = np.where(np.isfinite(away), from_mm - away - points[:, 2].min(), 0.0)
        found.append(surface_of_grid(height))
    return found


class _Skein(NamedTuple):
    """What a skein of the second family is made of, over its stations x."""

    x: Floats
    axis: Floats
    half_width: Floats
    height: Floats
    lean: Floats
    squareness: float
    foot: float


_ACROSS = np.linspace(-28.0, 28.0, 225)


def second_skein(seed: int, label: str) -> Body:
    """Draw a skein of the second family."""
    rng, how = np.random.default_rng([seed, 11]), np.random.default_rng([seed, 12])
    sound = _sound(rng)
    length = float(np.ptp(sound.x))
    waves = _waves(rng, float(rng.uniform(0.05, 0.4)))
    deformed, pressed = sound, _nothing
    if label == "bend":
        deformed = sound._replace(axis=sound.axis + _bent(how, sound.x, length))
    elif label == "twist":
        deformed = sound._replace(lean=sound.lean + _twisted(how, sound.x, length))
    elif label == "dent":
        pressed = _dents(how, length, sound)
    elif label == "fold":
        at = length * float(how.uniform(-0.25, 0.25))
        step = float(how.choice([0.0, how.uniform(-5.0, 5.0)])) * 0.5 * (1 + np.tanh((sound.x - at) / 2.0))
        deformed = sound._replace(axis=sound.axis + step)
        pressed = _crease(how, at, float(sound.height.max()))
    elif label == "broken":
        pressed = _cut(how, length)
    margin = 0.5 * length + MARGIN_MM + 2.0
    grid = np.meshgrid(np.arange(-margin, margin, STEP_MM), np.arange(-30.0, 30.0, STEP_MM))
    tops = []
    for skein, change in ((deformed, pressed), (sound, _nothing)):
        z = _height(skein, *grid)
        z = np.where(z > 0.0, np.maximum(z + waves(*grid) * np.minimum(z / 4.0, 1.0), 0.0), 0.0)
        tops.append(surface_of_grid(np.maximum(change(*grid, z), 0.0)))
    return Body(tops[0], tops[1], label)


def _sound(rng: np.random.Generator) -> _Skein:
    length = float(rng.uniform(65.0, 105.0))
    width = length / float(rng.uniform(2.9, 4.3))
    height = width * float(rng.uniform(0.48, 0.74))
    x = np.linspace(-0.5, 0.5, 161) * length
    u = 2.0 * x / length
    blunt = rng.uniform(1.6, 3.6, 2)
    taper = np.where(u < 0.0, 1.0 - np.abs(u) ** blunt[0], 1.0 - np.abs(u) ** blunt[1]) ** 0.5
    ripple = [1.0 + _slow(rng, u, size) for size in (0.04, 0.05)]
    higher = float(rng.uniform(0.7, 1.0))
    return _Skein(
        x=x,
        axis=_slow(rng, u, float(rng.uniform(0.1, 1.8))),
        half_width=0.5 * width * taper * ripple[0],
        height=height * taper**higher * ripple[1],
        lean=np.radians(rng.normal(0.0, 2.0) + _slow(rng, u, float(rng.uniform(1.0, 6.0)))),
        squareness=float(rng.uniform(1.7, 2.8)),
        foot=float(rng.uniform(0.2, 0.45)),
    )


def _slow(rng: np.random.Generator, u: Floats, size: float) -> Floats:
    """A slow random run along u, about `size` large."""
    total = np.zeros_like(u)
    for k in range(1, 5):
        total += rng.normal(0.0, size / k) * np.sin(0.5 * np.pi * k * u + rng.uniform(0.0, 2.0 * np.pi))
    return total


def _height(skein: _Skein, x: Floats, y: Floats) -> Floats:
    """Upper side of the turned sections, interpolated over the grid, mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, 145)
    c, q = np.cos(angle), np.sin(angle)
    power = 2.0 / skein.squareness
    across, up = np.sign(c) * np.abs(c) ** power, np.sign(q) * np.abs(q) ** power
    rows = np.zeros((len(skein.x), len(_ACROSS)))
    for k in range(len(skein.x)):
        half, tall = skein.half_width[k], skein.height[k]
        if half < 0.3 or tall < 0.2:
            continue
        # The part below the widest place is flatter: foot of the height; it rests on the belt.
        v, w = half * across, tall * np.where(up > 0.0, (1.0 - skein.foot) * up, skein.foot * up)
        cos, sin = math.cos(skein.lean[k]), math.sin(skein.lean[k])
        t, z = cos * v - sin * w, sin * v + cos * w
        z = z - z.min() - 0.3
        first, last = int(t.argmax()), int(t.argmin())
        chain = np.arange(first, last + 1 if last > first else last + 145) % 144
        order = np.argsort(t[chain], kind="stable")
        rows[k] = np.interp(_ACROSS, t[chain][order], z[chain][order], left=0.0, right=0.0)
    rows = np.maximum(rows, 0.0)
    off = y - np.interp(x, skein.x, skein.axis)
    slope = np.interp(x, skein.x, np.gradient(skein.axis, skein.x))
    along = (x - skein.x[0]) / (skein.x[1] - skein.x[0])
    sideways = (off / np.hypot(1.0, slope) - _ACROSS[0]) / (_ACROSS[1] - _ACROSS[0])
    return np.asarray(map_coordinates(rows, [along, sideways], order=1, cval=0.0))


Change = Callable[[Floats, Floats, Floats], Floats]


def _nothing(x: Floats, y: Floats, z: Floats) -> Floats:
    return z


def _bent(how: np.random.Generator, x: Floats, length: float) -> Floats:
    bow, at = float(how.uniform(3.5, 9.0)), length * float(how.uniform(-0.12, 0.12))
    way, kind = float(how.choice([-1.0, 1.0])), int(how.integers(3))
    u = 2.0 * (x - at) / length
    if kind == 0:
        return np.asarray(way * bow * (1.0 - u**2))
    if kind == 1:
        soft = float(how.uniform(0.05, 0.25))
        return np.asarray(way * bow * 1.4 * (1.0 - np.sqrt(u**2 + soft**2)))
    return np.asarray(way * 0.9 * bow * np.sin(np.pi * 0.95 * u))


def _twisted(how: np.random.Generator, x: Floats, length: float) -> Floats:
    total, way = math.radians(float(how.uniform(35.0, 85.0))), float(how.choice([-1.0, 1.0]))
    u = 2.0 * x / length
    if how.integers(2):
        return np.asarray(way * 0.5 * total * u)
    return np.asarray(way * 0.5 * total * np.tanh((u - how.uniform(-0.3, 0.3)) / how.uniform(0.2, 0.5)))


def _dents(how: np.random.Generator, length: float, sound: _Skein) -> Change:
    tall, wide = float(sound.height.max()), float(sound.half_width.max())
    dents = []
    for _ in range(int(how.choice([1, 1, 1, 2, 3]))):
        place = length * how.uniform(-0.32, 0.32), wide * how.uniform(-0.5, 0.5)
        size = how.uniform(4.0, 9.0), how.uniform(3.5, 7.5), tall * how.uniform(0.15, 0.42)
        dents.append((*place, *size, int(how.integers(2))))

    def press(x: Floats, y: Floats, z: Floats) -> Floats:
        off = y - np.interp(x, sound.x, sound.axis)
        for x0, y0, a, b, deep, kind in dents:
            r2 = ((x - x0) / a) ** 2 + ((off - y0) / b) ** 2
            z = z - deep * (np.exp(-r2) if kind else np.clip(1.0 - 0.5 * r2, 0.0, None) ** 2)
        return z

    return press


def _crease(how: np.random.Generator, at: float, tall: float) -> Change:
    deep, half = tall * float(how.uniform(0.22, 0.5)), float(how.uniform(2.0, 5.0))
    lean, lip = math.tan(math.radians(float(how.uniform(-25.0, 25.0)))), float(how.uniform(0.0, 0.3))

    def press(x: Floats, y: Floats, z: Floats) -> Floats:
        along = (x - at - lean * y) / half
        crease = np.exp(-(along**2)) - lip * np.exp(-((along - 2.2) ** 2))
        return np.asarray(z - deep * crease * np.minimum(z / (0.4 * tall), 1.0))

    return press


def _cut(how: np.random.Generator, length: float) -> Change:
    at, way = length * float(how.uniform(0.1, 0.34)), float(how.choice([-1.0, 1.0]))
    lean, steep = math.tan(math.radians(float(how.uniform(-25.0, 25.0)))), float(how.uniform(2.0, 8.0))
    waves = _waves(how, 0.7)

    def press(x: Floats, y: Floats, z: Floats) -> Floats:
        beyond = way * x - at - lean * y + waves(x, y)
        return np.where(beyond > 0.0, np.minimum(z, np.maximum(-steep * (beyond - 3.0), 0.0)), z)

    return press


def _waves(rng: np.random.Generator, rms_mm: float) -> Callable[[Floats, Floats], Floats]:
    """Waves of 6 to 30 mm in all directions; longer ones are higher."""
    count = 16
    lengths = np.exp(rng.uniform(np.log(6.0), np.log(30.0), count))
    way, phase = rng.uniform(0.0, 2.0 * np.pi, (2, count))
    size = lengths / math.sqrt(float((lengths**2).sum())) * rms_mm * math.sqrt(2.0)

    def at(x: Floats, y: Floats) -> Floats:
        total = np.zeros_like(x)
        for k in range(count):
            total += size[k] * np.sin(
                2.0 * np.pi / lengths[k] * (x * np.cos(way[k]) + y * np.sin(way[k])) + phase[k]
            )
        return total

    return at
