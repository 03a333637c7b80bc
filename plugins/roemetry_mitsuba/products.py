"""Families of products of this simulator's own, none of which the plugin `simulate` draws.

`lofted-skein`: a closed section is swept along a cubic spline. The section is two half superellipses (a domed
top, a flatter underside) whose width, height and skew follow splines through random control values; the
surface is displaced along its normals by a sum of plane waves 7–28 mm long; the underside sags onto the belt
by a soft clamp. Its defects:

* dented: a compactly supported bump (Wendland C2) pressed down into the top, with a raised rim;
* bent: the spline gets a kink of 18–40 degrees, rounded over a few mm;
* twisted: the sections turn about the spline by 40–80 degrees from end to end;
* folded: a crease across, with the far part shifted sideways and a lip pushed up beside it;
* broken: the sweep ends early in a steep, ragged face.

`superquadric` (Barr 1981), `supershape` (Gielis 2003, lumpy as a potato), `ball`, `rod` (a lying cylinder)
and `box` are for shapes whose volumes have a formula or a check; `mesh` is any watertight PLY, OBJ or STL
file. Sizes are drawn uniformly from the options' ranges.

It assumes that a defect leaves the rest as it was, which makes the sound body its reference. It fails where a
strong bend meets a wide section: the sweep then crosses itself on the inner side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from roemetry.config.scene_parts import NONE, Part
from roemetry.errors import DataError
from roemetry_mitsuba.bodies import Body, Faces, normals_of, outwards, read_body, rest_on_belt

Floats = NDArray[np.float64]
Length = Annotated[float, Field(gt=0, le=2000)]
Range = tuple[Length, Length]

DEFECTS = ("none", "dented", "bent", "twisted", "folded", "broken")

_STATIONS, _AROUND = 181, 88
"""Sections along a skein and corners of a section: faces of about 0.5 × 0.8 mm, flat to 5 µm."""
_BROKEN_MM = 1.8  # over which a broken end is rounded
_FILE_AT = ("product", "options", "file")


class FamilyOptions(Part):
    """What all families share: how a product lies, and what it weighs."""

    density_g_per_cm3: float = Field(default=1.0, gt=0, le=25, description="density, g/cm³")
    turn_range_deg: float = Field(default=10.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(default=2.0, ge=0, le=5000, description="off centre in X by up to, mm")
    offset_range_y_mm: float = Field(default=3.0, ge=0, le=5000, description="off centre in Y by up to, mm")


class SkeinOptions(FamilyOptions):
    """Options of `lofted-skein`."""

    density_g_per_cm3: float = Field(default=1.10, gt=0, le=25, description="density, g/cm³")
    length_mm: Range = Field(default=(74.0, 98.0), description="smallest and largest length, mm")
    width_mm: Range = Field(default=(21.0, 29.0), description="smallest and largest width, mm")
    height_mm: Range = Field(default=(12.0, 17.5), description="smallest and largest thickness, mm")
    kinds: dict[str, float] = Field(
        default_factory=lambda: {kind: 5.0 if kind == NONE else 1.0 for kind in DEFECTS},
        description=f"share of each of {', '.join(DEFECTS)}; need not sum to 1",
    )

    @field_validator("kinds")
    @classmethod
    def _are_known(cls, kinds: dict[str, float]) -> dict[str, float]:
        for kind, share in kinds.items():
            if kind not in DEFECTS:
                raise ValueError(f"there is no kind `{kind}`; there are {', '.join(DEFECTS)}")
            if not 0.0 <= share < math.inf:
                raise ValueError(f"the share of `{kind}` is not 0 or more")
        if not sum(kinds.values()) > 0.0:
            raise ValueError("at least one kind needs a share above 0")
        return kinds


class SuperquadricOptions(FamilyOptions):
    """Options of `superquadric`."""

    length_mm: Range = Field(default=(45.0, 75.0), description="smallest and largest length, mm")
    width_mm: Range = Field(default=(22.0, 36.0), description="smallest and largest width, mm")
    height_mm: Range = Field(default=(12.0, 22.0), description="smallest and largest height, mm")
    exponent_upright: tuple[float, float] = Field(default=(0.7, 1.2), description="e1: 1 round, 0 a box")
    exponent_level: tuple[float, float] = Field(default=(0.6, 1.2), description="e2: 1 round, 0 a box")


class SupershapeOptions(FamilyOptions):
    """Options of `supershape`."""

    length_mm: Range = Field(default=(50.0, 72.0), description="smallest and largest length, mm")
    width_mm: Range = Field(default=(34.0, 44.0), description="smallest and largest width, mm")
    height_mm: Range = Field(default=(22.0, 32.0), description="smallest and largest height, mm")
    lumps: tuple[int, int] = Field(default=(2, 5), description="fewest and most lobes around it")


class BallOptions(FamilyOptions):
    """Options of `ball`."""

    diameter_mm: Range = Field(default=(20.0, 28.0), description="smallest and largest diameter, mm")


class RodOptions(FamilyOptions):
    """Options of `rod`."""

    diameter_mm: Range = Field(default=(16.0, 22.0), description="smallest and largest diameter, mm")
    length_mm: Range = Field(default=(50.0, 65.0), description="smallest and largest length, mm")


class BoxOptions(FamilyOptions):
    """Options of `box`."""

    length_mm: Range = Field(default=(45.0, 65.0), description="smallest and largest length, mm")
    width_mm: Range = Field(default=(20.0, 32.0), description="smallest and largest width, mm")
    height_mm: Range = Field(default=(10.0, 18.0), description="smallest and largest height, mm")


class MeshOptions(FamilyOptions):
    """Options of `mesh`."""

    turn_range_deg: float = Field(default=0.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(default=0.0, ge=0, le=5000, description="off centre in X by up to, mm")
    offset_range_y_mm: float = Field(default=0.0, ge=0, le=5000, description="off centre in Y by up to, mm")
    file: Path = Field(description="mesh file, .obj, .stl or .ply")
    mm_per_unit: float = Field(default=1.0, gt=0, le=1e6, description="millimetres in one unit of the file")
    up: Literal["x", "-x", "y", "-y", "z", "-z"] = Field(default="z", description="axis that points up")


@dataclass(frozen=True, eq=False)
class Drawn:
    """A product as drawn: its body about its own origin, its defect, and the same body without the defect."""

    body: Body
    defect: str = NONE
    reference: Body | None = None


@dataclass(frozen=True)
class Family:
    """A kind of product: its options, and the draw of one from a source of random numbers."""

    Options: type[FamilyOptions]
    make: Callable[[np.random.Generator, Any], Drawn]


def skein(rng: np.random.Generator, options: SkeinOptions) -> Drawn:
    """Draw a lofted skein, and the same one without its defect."""
    kinds = [kind for kind, share in options.kinds.items() if share > 0.0]
    share = np.array([options.kinds[kind] for kind in kinds])
    kind = str(rng.choice(kinds, p=share / share.sum()))
    seed = int(rng.integers(2**62))
    sound = _loft(seed, options, NONE)
    return Drawn(sound) if kind == NONE else Drawn(_loft(seed, options, kind), kind, sound)


def _loft(seed: int, options: SkeinOptions, kind: str) -> Body:
    """Sweep a skein; `rng` draws the sound body, `how` its defect, so that both share all but the defect."""
    rng, how = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
    length, width, height = (
        float(rng.uniform(*r)) for r in (options.length_mm, options.width_mm, options.height_mm)
    )
    s = np.linspace(0.0, 1.0, _STATIONS)
    s = 0.5 - 0.5 * np.cos(np.pi * s)  # closer together at the ends, where the sections shrink
    blunt = rng.uniform(2.0, 3.2, 2)
    swell = 1.0 + _spline(rng, s, 6, 0.05)
    thick = 1.0 + _spline(rng, s, 6, 0.06)
    skew = _spline(rng, s, 5, 0.07) * width
    drift = _spline(rng, s, 5, 1.1)
    ride = rng.uniform(0.60, 0.74)
    power_top, power_low = rng.uniform(1.9, 2.35), rng.uniform(2.4, 3.2)
    waves = _waves(rng)
    ramp = float(rng.uniform(0.5, 1.1))

    end = float(how.uniform(0.58, 0.78)) if kind == "broken" else 1.0
    t = s * end
    # widths fall to 0 at both ends, as bluntly as drawn
    taper = (1.0 - (1.0 - np.minimum(2.0 * t, 1.0)) ** blunt[0]) ** (1.0 / blunt[0])
    taper *= (1.0 - (1.0 - np.minimum(2.0 * (1.0 - t), 1.0)) ** blunt[1]) ** (1.0 / blunt[1])
    if kind == "broken":
        rounded = _BROKEN_MM / length
        taper *= np.sqrt(np.clip(1.0 - ((t - (end - rounded)) / rounded).clip(0.0) ** 2, 0.0, 1.0))
    x, y = length * (t - 0.5), np.array(drift)
    turn = np.zeros_like(s)
    flat, fold = 1.0, 0.0
    if kind == "bent":
        at, kink = length * how.uniform(-0.14, 0.14), math.radians(how.uniform(18.0, 40.0))
        way, soft = how.choice([-1.0, 1.0]), how.uniform(2.0, 6.0)
        # a hyperbola: two straight legs, rounded where they meet
        y = y + way * math.tan(0.5 * kink) * (np.sqrt((x - at) ** 2 + soft**2) - soft)
        # shorter along x, so that legs hardly grow longer
        x = at + (x - at) * math.cos(0.5 * kink)
    if kind == "twisted":
        most = how.choice([-1.0, 1.0]) * math.radians(how.uniform(40.0, 80.0))
        turn = most * (t - 0.5 + 0.06 * np.sin(2 * np.pi * t))
        flat = 0.88
    if kind == "folded":
        fold = length * how.uniform(-0.18, 0.18)
        # the far part lies aside
        y = y + how.choice([-1.0, 1.0]) * how.uniform(3.0, 6.0) / (1.0 + np.exp(-(x - fold) / 2.2))

    around = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    cos, sin = np.cos(around), np.sin(around)
    # superellipses in parameters; above and below the middle with powers of their own
    p = np.where(sin > 0.0, power_top, power_low)
    across = np.sign(cos) * np.abs(cos) ** (2.0 / p)
    up = np.sign(sin) * np.abs(sin) ** (2.0 / p)
    v = 0.5 * width * (swell * taper)[:, None] * across + (skew * taper)[:, None] * np.maximum(up, 0.0)
    w = height * flat * (thick * taper)[:, None] * np.where(up > 0.0, ride * up, (1.0 - ride) * up)
    c, q = np.cos(turn)[:, None], np.sin(turn)[:, None]
    v, w = c * v - q * w, q * v + c * w
    # across the spline, in the belt's plane
    dx, dy = np.gradient(x, s), np.gradient(y, s)
    norm = np.hypot(dx, dy)
    points = np.stack(
        [x[:, None] - v * (dy / norm)[:, None], y[:, None] + v * (dx / norm)[:, None], w], axis=-1
    )
    # the two ends are single points, so that the mesh closes
    body = points[1:-1].reshape(-1, 3)
    points_mm = np.concatenate([points[:1].mean(axis=1), body, points[-1:].mean(axis=1)])
    faces = _tube(_STATIONS - 2, _AROUND)
    # waves fade where sections shrink and corners crowd
    lump = np.concatenate([[0.0], np.repeat(taper[1:-1], _AROUND), [0.0]])
    bump = waves(points_mm) * lump
    if kind == "broken":
        place = np.concatenate([[0.0], np.repeat(t[1:-1], _AROUND), [end]])
        # ragged over the last 8 mm
        near = np.clip((place - (end - 8.0 / length)) * length / 8.0, 0.0, 1.0)
        ragged = _waves(how, (5.0, 11.0), 0.6)
        points_mm[:, 0] += near**2 * np.clip(ragged(points_mm * [0.0, 1.0, 1.0]), -1.6, 1.6)
    points_mm = points_mm + bump[:, None] * normals_of(points_mm, faces)
    if kind in ("dented", "folded"):
        points_mm = _pressed(points_mm, kind, how, (length, width, height), fold)
    low = points_mm[:, 2].min()
    z = points_mm[:, 2] - low - ramp
    points_mm[:, 2] = 0.5 * (z + np.sqrt(z * z + 0.5**2))  # sags onto the belt, rounded over half a mm
    return rest_on_belt(points_mm, faces)


def _pressed(
    points: Floats, kind: str, how: np.random.Generator, size: tuple[float, float, float], fold: float
) -> Floats:
    """Press a dent, or the crease of a fold, into the upper side."""
    length, width, height = size
    pressed = points.copy()
    # the upper side alone, fading downwards
    upper = np.clip(points[:, 2] / (0.35 * height) + 0.3, 0.0, 1.0)
    if kind == "dented":
        at = np.array([length * how.uniform(-0.28, 0.28), width * how.uniform(-0.16, 0.16)])
        reach = np.array([how.uniform(8.0, 15.0), how.uniform(6.0, 10.0)])
        depth = height * how.uniform(0.22, 0.42)
        r = np.linalg.norm((points[:, :2] - at) / reach, axis=1)
        # Wendland's C2 function: smooth, and 0 from r = 1 on
        hollow = np.clip(1.0 - r, 0.0, None) ** 4 * (4.0 * r + 1.0)
        rim = np.exp(-(((r - 1.05) / 0.22) ** 2))
        pressed[:, 2] += depth * upper * (0.10 * rim - hollow)
        return pressed
    lean = math.tan(math.radians(how.uniform(-25.0, 25.0)))
    depth, half = height * how.uniform(0.25, 0.42), how.uniform(2.0, 3.6)
    # distance from the crease, which runs across and leans
    along = points[:, 0] - fold - lean * points[:, 1]
    crease = 1.0 / (1.0 + (along / half) ** 2) ** 1.5
    lip = np.exp(-(((along - 2.6 * half) / (1.2 * half)) ** 2))
    pressed[:, 2] += depth * upper * (0.22 * lip - crease)
    return pressed


def superquadric(rng: np.random.Generator, options: SuperquadricOptions) -> Drawn:
    """Draw a superquadric that lies on its flattest side."""
    half = 0.5 * np.array([rng.uniform(*r) for r in (options.length_mm, options.width_mm, options.height_mm)])
    e1, e2 = rng.uniform(*options.exponent_upright), rng.uniform(*options.exponent_level)
    u, v = _sphere_angles(97, 192)
    signed = _signed_power
    x = half[0] * signed(np.cos(u), e1) * signed(np.cos(v), e2)
    y = half[1] * signed(np.cos(u), e1) * signed(np.sin(v), e2)
    return Drawn(_closed_sphere(x, y, half[2] * signed(np.sin(u), e1)))


def supershape(rng: np.random.Generator, options: SupershapeOptions) -> Drawn:
    """Draw a supershape: lobes around and from pole to pole, as uneven as a potato."""
    half = 0.5 * np.array([rng.uniform(*r) for r in (options.length_mm, options.width_mm, options.height_mm)])
    u, v = _sphere_angles(97, 192)
    lobes = int(rng.integers(options.lumps[0], options.lumps[1] + 1))
    level = _superformula(
        v + rng.uniform(0, 2 * np.pi), lobes, *rng.uniform([7.0, 4.0, 4.0], [14.0, 7.0, 7.0])
    )
    # the upright formula has no odd lobes, so that the poles stay smooth
    upright = _superformula(u, 2, *rng.uniform([2.6, 3.2, 3.2], [4.0, 4.6, 4.6]))
    level, upright = level / level.max(), upright / upright.max()
    x = half[0] * level * upright * np.cos(u) * np.cos(v)
    y = half[1] * level * upright * np.cos(u) * np.sin(v)
    body = _closed_sphere(x, y, half[2] * upright * np.sin(u))
    points = body.points_mm + _waves(rng, (14.0, 40.0), 0.5)(body.points_mm)[:, None] * body.normals
    return Drawn(rest_on_belt(points, body.faces))


def ball(rng: np.random.Generator, options: BallOptions) -> Drawn:
    """Draw a ball."""
    r = 0.5 * rng.uniform(*options.diameter_mm)
    u, v = _sphere_angles(129, 256)
    return Drawn(_closed_sphere(r * np.cos(u) * np.cos(v), r * np.cos(u) * np.sin(v), r * np.sin(u)))


def rod(rng: np.random.Generator, options: RodOptions) -> Drawn:
    """Draw a cylinder that lies along X, its ends flat."""
    r, length = 0.5 * rng.uniform(*options.diameter_mm), rng.uniform(*options.length_mm)
    around = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
    ring = np.stack([0 * around, r * np.cos(around), r * np.sin(around)], axis=-1)
    side = np.array([0.5 * length, 0.0, 0.0])
    points = np.concatenate([[-side], ring - side, ring + side, [side]])
    # flat faces: interpolated normals would round the edges of its ends; 256 faces are flat to 1 µm
    return Drawn(rest_on_belt(points, _tube(2, 256), smooth=False))


def box(rng: np.random.Generator, options: BoxOptions) -> Drawn:
    """Draw a block."""
    size = (rng.uniform(*r) for r in (options.length_mm, options.width_mm, options.height_mm))
    return Drawn(block(*(float(side) for side in size)))


def block(length_mm: float, width_mm: float, height_mm: float) -> Body:
    """Give a block about the origin, its lower side on the belt."""
    corners = np.array([[x, y, z] for z in (0.0, 1.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], dtype=np.int64)
    return Body(corners * [length_mm, width_mm, height_mm], faces, smooth=False)


def stairs(steps: int, tread_mm: float, riser_mm: float, width_mm: float) -> Body:
    """Give a staircase about the origin that rises along +Y; its profile is extruded along X."""
    outline = [(0.0, 0.0)]
    for k in range(steps):
        outline += [(k * tread_mm, (k + 1) * riser_mm), ((k + 1) * tread_mm, (k + 1) * riser_mm)]
    outline.append((steps * tread_mm, 0.0))
    foot = [(k * tread_mm, 0.0) for k in range(1, steps)]
    # corners of the foot divide the long lower side, so that each step is a rectangle
    profile = np.array(outline + foot) - [0.5 * steps * tread_mm, 0.0]
    n = len(profile)
    points = np.concatenate(
        [np.column_stack([np.full(n, x), profile]) for x in (-0.5 * width_mm, 0.5 * width_mm)]
    )
    flat: list[tuple[int, int, int]] = []
    last = 2 * steps + 1
    low = [0, *range(last + 1, n), last]  # places of the foot line from front to back
    for k in range(steps):  # each step is a rectangle of one end: front foot, back foot, its tread
        a, b, c, d = low[k], low[k + 1], 2 * k + 2, 2 * k + 1
        flat += [(a, c, b), (a, d, c)]
        if k:  # its riser's lower corner divides the rectangle's front side
            flat[-1] = (a, 2 * k, c)
            flat.append((2 * k, d, c))
    ring = [*range(last + 1), *range(n - 1, last, -1)]
    sides = []
    for k, i in enumerate(ring):
        j = ring[(k + 1) % n]
        sides += [(i, j, n + j), (i, n + j, n + i)]
    ends = [(a, c, b) for a, b, c in flat] + [(n + a, n + b, n + c) for a, b, c in flat]
    return outwards(Body(points, np.array(sides + ends, dtype=np.int64), smooth=False))


def from_file(rng: np.random.Generator, options: MeshOptions) -> Drawn:
    """Read a mesh."""
    try:
        return Drawn(read_body(options.file, options.mm_per_unit, options.up))
    except DataError as fault:
        fault.at = _FILE_AT
        raise


FAMILIES: Mapping[str, Family] = {
    "lofted-skein": Family(SkeinOptions, skein),
    "superquadric": Family(SuperquadricOptions, superquadric),
    "supershape": Family(SupershapeOptions, supershape),
    "ball": Family(BallOptions, ball),
    "rod": Family(RodOptions, rod),
    "box": Family(BoxOptions, box),
    "mesh": Family(MeshOptions, from_file),
}
"""Every family, by name."""

MODELS = {name: family.Options for name, family in FAMILIES.items()}
"""The options of every family."""


def _spline(rng: np.random.Generator, s: Floats, count: int, deviation: float) -> Floats:
    """Give a cubic spline through random values at even places, at s."""
    from scipy.interpolate import CubicSpline

    drawn: Floats = CubicSpline(np.linspace(0.0, 1.0, count), rng.normal(0.0, deviation, count))(s)
    return drawn


def _waves(
    rng: np.random.Generator, length_mm: tuple[float, float] = (7.0, 28.0), deviation_mm: float = 0.25
) -> Callable[[Floats], Floats]:
    """Give a random field over space, a sum of plane waves of some lengths."""
    count = 28
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    lengths = np.exp(rng.uniform(math.log(length_mm[0]), math.log(length_mm[1]), count))
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    size = lengths / math.sqrt(float((lengths**2).sum()))  # longer waves are higher
    numbers = 2.0 * np.pi * ways / lengths[:, None]
    return lambda at: math.sqrt(2.0) * deviation_mm * np.sin(at @ numbers.T + phase) @ size


def _superformula(angle: Floats, lobes: int, n1: float, n2: float, n3: float) -> Floats:
    """Gielis's radius with a = b = 1."""
    quarter = 0.25 * lobes * angle
    radius: Floats = (np.abs(np.cos(quarter)) ** n2 + np.abs(np.sin(quarter)) ** n3) ** (-1.0 / n1)
    return radius


def _signed_power(value: Floats, power: float) -> Floats:
    raised: Floats = np.sign(value) * np.abs(value) ** power
    return raised


def _sphere_angles(rings: int, around: int) -> tuple[Floats, Floats]:
    """Latitude and longitude of a sphere's corners without its poles, shape (rings, around)."""
    u = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rings + 2)[1:-1]
    v = np.linspace(-np.pi, np.pi, around, endpoint=False)
    level, upright = np.meshgrid(v, u)
    return upright, level


def _closed_sphere(x: Floats, y: Floats, z: Floats) -> Body:
    """Close rings of corners, shape (rings, around), by poles on the axis; poles lie at the rings' ends."""
    grid = np.stack([x, y, z], axis=-1)
    rings, around = x.shape
    poles = [grid[k].mean(axis=0) for k in (0, -1)]
    step = 0.3 * (poles[1] - grid[-2].mean(axis=0))
    points = np.concatenate([[poles[0] - step], grid.reshape(-1, 3), [poles[1] + step]])
    return rest_on_belt(points, _tube(rings, around))


def _tube(rings: int, around: int) -> Faces:
    """Faces of rings of corners (1 + ring · around + k), closed by corner 0 and the last one."""
    k = np.arange(around)
    after = (k + 1) % around
    faces = [np.stack([0 * k, 1 + after, 1 + k], axis=-1)]
    for ring in range(rings - 1):
        a, b = 1 + ring * around + k, 1 + ring * around + after
        faces += [np.stack([a, b, b + around], axis=-1), np.stack([a, b + around, a + around], axis=-1)]
    last = 1 + (rings - 1) * around
    faces.append(np.stack([last + k, last + after, 0 * k + last + around], axis=-1))
    return np.concatenate(faces).astype(np.int64)
