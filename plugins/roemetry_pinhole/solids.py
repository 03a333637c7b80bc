"""Blocks, staircases and truncated pyramids: their shapes, and a first geometry of where one stands.

Model. A solid is a set of plane faces in its own frame (X across the stripes, Y along them, Z up from the
belt). Stripes are numbered by their order in the rows in which all of them are seen. With a known camera, a
stripe's plane goes through its line on the bare belt and through its peaks on the solid's highest level,
which are lifted by the known height: so belt and height give all planes, and what lies between must lie on
the solid's faces. The belt's distance follows from the solid's extent; distances about it and tilts are
tried, and the adjustment goes on from the best.

It fails where no rows show all stripes, and where the solid is not seen beside bare belt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import EDGE, WIDE, Block, Observation, Pyramid, Staircase
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_pinhole.geometry import rays, turned
from roemetry_pinhole.pinhole_plane import belt_pose

Solid = Block | Staircase | Pyramid


@dataclass(frozen=True, eq=False, slots=True)
class Face:
    """One face as seen from above."""

    plane: Floats
    """(4,) n and d with n·X = d, mm, in the solid's frame: X across the stripes, Y along them, Z up, origin
    on the belt under its middle."""
    corners_mm: Floats
    """(corner, 2) X and Y of its corners, convex, counter-clockwise."""
    walls: Floats
    """(2, 4) vertical planes at which it ends towards −Y and +Y."""
    ends: tuple[bool, bool]
    """Whether it drops there, so that a stripe that crosses it ends at the wall."""


@dataclass(frozen=True, eq=False, slots=True)
class Shape:
    """A solid."""

    kind: str
    name: str
    """kind, name: for people."""
    faces: tuple[Face, ...]
    """All that stripes can lie on, but for the belt."""
    top: int
    height_mm: float
    """top, height_mm: index and height of its highest level face."""
    along_mm: float
    along_height_mm: float
    """along_mm, along_height_mm: extent along the stripes over which they are not on the belt, and the height
    at its ends."""
    wide_top: bool
    """Whether all stripes that lie on the solid reach its highest face."""
    turns_deg: tuple[float, ...] = (0.0,)
    """Ways round it may lie, as far as its shape tells them apart."""


def shape_of(solid: Solid) -> Shape:
    """Give the shape of a block, a staircase or a truncated pyramid."""
    match solid:
        case Block():
            half, high = 0.5 * solid.width_mm, solid.height_mm
            top = _level(solid.length_mm, -half, half, high, (True, True))
            return Shape("block", solid.name, (top,), 0, high, solid.width_mm, high, True)
        case Staircase():
            heights = solid.heights_mm
            y = ((np.arange(len(heights) + 1) - 0.5 * len(heights)) * solid.tread_mm).tolist()
            around = (0.0, *heights, 0.0)
            faces = []
            for step, high in enumerate(heights):
                ends = (around[step] < high, around[step + 2] < high)
                faces.append(_level(solid.width_mm, y[step], y[step + 1], high, ends))
            highest = int(np.argmax(heights))
            turns = (0.0,) if heights == heights[::-1] else (0.0, 180.0)
            high, along_mm, at_ends = heights[highest], y[-1] - y[0], 0.5 * (heights[0] + heights[-1])
            return Shape("staircase", solid.name, tuple(faces), highest, high, along_mm, at_ends, True, turns)
        case Pyramid():
            base, half, high = 0.5 * solid.base_mm, 0.5 * solid.top_mm, solid.height_mm
            none = np.tile([0.0, 1.0, 0.0, 0.0], (2, 1))
            faces = [_level(2.0 * half, -half, half, high, (False, False))]
            corners = np.array([[base, -base], [base, base], [half, half], [half, -half]])
            # of the side towards +X: X + Z (base − half)/high = base
            normal = np.array([1.0, 0.0, (base - half) / high])
            for cos, sin in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                way = np.array([[cos, -sin], [sin, cos]], np.float64)
                plane = np.array([*(way @ normal[:2]), normal[2], base]) / np.sqrt(normal @ normal)
                faces.append(Face(plane, corners @ way.T, none, (False, False)))
            return Shape("truncated-pyramid", solid.name, tuple(faces), 0, high, solid.base_mm, 0.0, False)


def toleranced(solid: Solid, more_mm: float) -> list[Solid]:
    """Give, for each length with a tolerance, the solid with that length longer."""
    if isinstance(solid, Staircase):
        heights = np.array(solid.heights_mm) + more_mm * np.eye(len(solid.heights_mm))
        higher: list[Solid] = [replace(solid, heights_mm=tuple(row)) for row in heights.tolist()]
        return [*higher, replace(solid, tread_mm=solid.tread_mm + more_mm / len(heights))]
    names = ("height_mm", "width_mm") if isinstance(solid, Block) else ("base_mm", "top_mm", "height_mm")
    return [replace(solid, **{name: getattr(solid, name) + more_mm}) for name in names]


def _level(length: float, low: float, high: float, height: float, ends: tuple[bool, bool]) -> Face:
    half = 0.5 * length
    corners = np.array([[-half, low], [half, low], [half, high], [-half, high]])
    walls = np.array([[0.0, 1.0, 0.0, low], [0.0, 1.0, 0.0, high]])
    return Face(np.array([0.0, 0.0, 1.0, height]), corners, walls, ends)


def inside(face: Face, xy_mm: Floats) -> Floats:
    """Give (point,) how far points lie inside a face's outline, mm; negative outside."""
    corners = face.corners_mm
    # a counter-clockwise outline has its inside to the left
    along = np.roll(corners, -1, axis=0) - corners
    inwards = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    off = (xy_mm[:, None, :] - corners) * inwards
    # the nearest edge counts
    return np.asarray(off.sum(axis=2).min(axis=1))


def footprint(shape: Shape, xy_mm: Floats) -> Floats:
    """Give (point,) how far points lie inside the solid's outline on the belt, mm; negative outside."""
    return np.asarray(np.stack([inside(face, xy_mm) for face in shape.faces]).max(axis=0))


def off_surface(shape: Shape, xyz_mm: Floats, rim_mm: float) -> Floats:
    """Give (point,) how far points in the solid's frame are from belt or faces, mm.

    Near a rim, by less than `rim_mm`, the nearer of both sides counts.
    """
    off = np.where(footprint(shape, xyz_mm[:, :2]) < rim_mm, np.abs(xyz_mm[:, 2]), np.inf)
    for face in shape.faces:
        there = inside(face, xyz_mm[:, :2]) > -rim_mm
        own = np.abs(xyz_mm @ face.plane[:3] - face.plane[3])
        off = np.where(there, np.minimum(off, own), off)
    return off


_BARE_SHARE = 0.08
"""Of a stripe's rows at either end that are bare belt, where no image of the empty belt is given."""
_OFF_PX = 1.5
"""A peak farther than this from its belt line is on the solid: above the scatter of peaks on a belt."""
_ROWS_MIN = 12  # rows of a stripe: from fewer its line is not known to a pixel over the image
_PLATEAU_SHARE = 0.93
"""Of a stripe's highest displacement: peaks above are on its highest level, for steps are larger than 7 %."""
_OFF_SHARE_MAX = 0.2
"""Of the height: a peak farther off the surface counts as so far, for it may be a shadow or a wall."""
_FAN_CONDITION = 0.01
"""Planes of one fan do not say where on its axis the projector is: singular values below are taken for 0."""
_LEANS = 0.5  # tangent of a tilt (27°) that doubles a start's distance: cameras over belts stand straighter
_DISTANCES = (0.76, 0.84, 0.92, 1.0, 1.08)
"""Of the distance by the solid's extent: what is hidden of it and its edges make that wrong by up to a
fifth."""
_TILTS_DEG = [(x, y) for x in (-12.0, -4.0, 4.0, 12.0) for y in (-12.0, -4.0, 4.0, 12.0)]
"""Of the camera about its x and y axes, that starts are tried at."""


@dataclass(frozen=True, eq=False, slots=True)
class Numbered:
    """Peaks of one image whose stripe is known."""

    name: str
    stripe: Integers
    """name, stripe: of the image; (peak,)."""
    x_px: Floats
    row_px: Floats
    std_px: Floats
    """x_px, row_px, std_px: (peak,) where they are, px."""
    ray: Floats
    """(peak, 3) their rays, without distortion, z = 1."""


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """A first geometry."""

    planes: Floats
    belt: Floats
    """planes, belt: (stripe, 3) and (3,) p·X = 1, camera frame, 1/mm."""
    rotation: Floats
    shift: Floats
    """rotation, shift: (3, 3) and (3,) to the camera's frame from the solid's."""
    off_mm: float
    """Mean distance of the peaks from the surface where they should lie; large ones count little."""


def numbered(view: Observation, camera: Floats, stripes: int) -> Numbered:
    """Number the peaks by their order, in the rows that show as many as there are stripes.

    Raises
    ------
    CalibrationError
        There are too few such rows.
    """
    peaks = view.peaks
    good = np.flatnonzero((peaks.flags & (EDGE | WIDE)) == 0)
    count = np.bincount(peaks.row[good], minlength=peaks.image_size[0])
    whole = good[count[peaks.row[good]] == stripes]
    if whole.size < _ROWS_MIN * stripes:
        usual = int(np.median(count[count > 0])) if (count > 0).any() else 0
        raise CalibrationError(
            f"{view.frame.name}: all {stripes} stripes are seen in {whole.size // max(stripes, 1)} rows only "
            f"(most rows show {usual})",
            hint="check `stripes` and the extractor's threshold; every stripe must be seen on belt and solid",
        )
    # from left to right in each row: the order is the number
    order = np.lexsort((peaks.x_px[whole], peaks.row[whole]))
    whole = whole[order]
    std = peaks.x_std_px[whole]
    return Numbered(
        view.frame.name,
        np.tile(np.arange(stripes), whole.size // stripes),
        peaks.x_px[whole],
        peaks.row[whole].astype(np.float64),
        np.where(np.isfinite(std) & (std > 0), std, 1.0),
        rays(camera, np.column_stack([peaks.x_px[whole], peaks.row[whole]])),
    )


def belt_lines(bare: Numbered | None, view: Numbered, stripes: int, focal_px: float) -> Floats:
    """Give (stripe, 2) start and slope of each stripe on the bare belt: x = start + slope · y, undistorted.

    Without an image of the empty belt the first and last rows of the solid's image are taken as bare.
    """
    lines = np.empty((stripes, 2))
    for stripe in range(stripes):
        part = view if bare is None else bare
        mine = part.ray[part.stripe == stripe]
        if bare is None:
            # a stripe's rows follow each other: its outer ones are bare
            ends = max(int(_BARE_SHARE * len(mine)), 4)
            mine = np.concatenate([mine[:ends], mine[-ends:]])
        for _ in range(4):
            lines[stripe] = np.polynomial.polynomial.polyfit(mine[:, 1], mine[:, 0], 1)
            off = np.abs(mine[:, 0] - lines[stripe] @ [np.ones(len(mine)), mine[:, 1]]) * focal_px
            near = off <= max(3.0 * float(np.median(off)), 0.5)
            mine = mine[near]
    return lines


def start_of(
    view: Numbered, lines: Floats, shape: Shape, focal_px: float, belt: Floats | None, turn_deg: float
) -> Start:
    """Find a first geometry from one image of a solid that lies this way round.

    `lines` are those of `belt_lines`, and `focal_px` makes pixels of distances on the plane at distance 1.
    Where the belt (3,) b·X = 1 is not known, distances about the one that the solid's extent gives, and tilts
    of the camera, are tried.

    Raises
    ------
    CalibrationError
        The solid is not seen.
    """
    own = lines[view.stripe]
    off_px = (view.ray[:, 0] - own[:, 0] - own[:, 1] * view.ray[:, 1]) * focal_px
    lifted = np.abs(off_px) > _OFF_PX
    on = {stripe: np.flatnonzero(lifted & (view.stripe == stripe)) for stripe in range(len(lines))}
    on = {stripe: peaks for stripe, peaks in on.items() if peaks.size >= _ROWS_MIN}
    if not on:
        raise CalibrationError(
            f"{view.name}: the {shape.kind} is not seen: no stripe is off its place on the bare belt",
            hint="lay it under the stripes; with bare belt above and below it in the image",
        )
    # the peaks on the highest level that each stripe reaches
    high = {}
    for stripe, peaks in on.items():
        size = np.abs(off_px[peaks])
        # nine tenths of the largest, so that strays do not say what is highest
        high[stripe] = peaks[size >= _PLATEAU_SHARE * float(np.quantile(size, 0.9))]

    def made(of_belt: Floats, stripes: list[int]) -> Start:
        return _start(view, lines, shape, of_belt, lifted, {s: high[s] for s in stripes}, turn_deg)

    def unlikely(start: Start) -> float:
        """Distance off the surface, mm, the larger the more the belt is tilted: tilts are told by little."""
        lean = start.belt[:2] / (_LEANS * start.belt[2])
        return float(start.off_mm * (1.0 + lean @ lean))

    def best(belts: list[Floats], stripes: list[int]) -> Start:
        return min((made(one, stripes) for one in belts), key=unlikely)

    if belt is None:
        spans = [float(np.ptp(np.quantile(view.ray[peaks, 1], [0.01, 0.99]))) for peaks in on.values()]
        # extent over its angle, and the height at which it is seen
        distance = shape.along_mm / float(np.median(spans)) + shape.along_height_mm
        level = [np.array([0.0, 0.0, 1.0 / (factor * distance)]) for factor in _DISTANCES]
    else:
        level = [belt]
    stripes = list(high)
    if not shape.wide_top:
        # of a pyramid only some stripes cross the top: neighbours that fit best
        groups = [[s for s in (at - 1, at, at + 1) if s in high] for at in high]
        if len(groups) > 1:
            stripes = min(groups, key=lambda group: best(level, group).off_mm)
    if belt is not None:
        return best(level, stripes)
    # the distance is that along the optical axis
    tilts = [np.array([np.tan(y), -np.tan(x), 0.0]) for x, y in np.radians(_TILTS_DEG)]
    return best(level + [one + one[2] * tilt for one in level for tilt in tilts], stripes)


def _start(
    view: Numbered,
    lines: Floats,
    shape: Shape,
    belt: Floats,
    lifted: Flags,
    top: dict[int, Integers],
    turn_deg: float,
) -> Start:
    # the level h over the belt: b·X = 1 − h |b|
    level = belt / (1.0 - shape.height_mm * float(np.sqrt(belt @ belt)))
    planes = np.full((len(lines), 3), np.nan)
    y = np.array([view.ray[:, 1].min(), view.ray[:, 1].max()])
    for stripe, peaks in top.items():
        ends = np.column_stack([lines[stripe, 0] + lines[stripe, 1] * y, y, np.ones(2)])
        # two points of the line on the belt, and the peaks on the top
        rays = np.vstack([ends, view.ray[peaks]])
        sides = np.concatenate([ends @ belt, view.ray[peaks] @ level])
        planes[stripe] = np.linalg.lstsq(rays, sides, rcond=None)[0]
    planes = _of_one_fan(planes, lines, belt)
    pose = belt_pose(belt)
    xyz = view.ray / (view.ray * planes[view.stripe]).sum(axis=1)[:, None] @ pose[:3, :3].T + pose[:3, 3]
    low, high = np.quantile(xyz[lifted, :2], [0.01, 0.99], axis=0)
    middle = np.array([*(0.5 * (low + high)), 0.0])
    turn = turned(np.radians([[0.0, 0.0, turn_deg]]))[0]
    off = np.minimum(off_surface(shape, (xyz - middle) @ turn, 0.0), _OFF_SHARE_MAX * shape.height_mm)
    rotation, shift = pose[:3, :3].T @ turn, pose[:3, :3].T @ (middle - pose[:3, 3])
    return Start(planes, belt, rotation, shift, float(off.mean()))


def _of_one_fan(planes: Floats, lines: Floats, belt: Floats) -> Floats:
    """Fill in planes that are not known: through their belt line and the others' point of light."""
    known = np.isfinite(planes).all(axis=1)
    if known.all():
        return planes
    point = np.linalg.lstsq(planes[known], np.ones(int(known.sum())), rcond=_FAN_CONDITION)[0]
    filled = planes.copy()
    for stripe in np.flatnonzero(~known):
        line = np.array([1.0, -lines[stripe, 1], -lines[stripe, 0]])
        filled[stripe] = belt + line * (1.0 - belt @ point) / (line @ point)
    return filled
