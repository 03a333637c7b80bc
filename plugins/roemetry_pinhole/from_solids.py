"""Planes of light from solids of known shape on the belt, with a camera that is known or comes from boards.

Model. By a first geometry (solids.py) each peak is lifted onto its plane of light and goes to the face of
the solid, or to the belt, on which it then lies within a share of the height; where a stripe leaves a face
over a wall, the place in the image is an observation of that edge. All is adjusted together (bundle.py), and
peaks go to faces anew with a narrower share, seven times. Of ways round that a staircase may lie, that with
the least residuals is taken. What the solid's own tolerances do is found by adjusting again with each length
longer.

It fails where a stripe lies on one surface only (its plane may turn about its line) and where edges and
faces do not tell the belt's distance: both are refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_pinhole.bundle import Adjusted, Measured
from roemetry_pinhole.geometry import (
    NO_EDGES,
    ON_BELT,
    BeltContacts,
    Edges,
    Geometry,
    StripePoints,
    unknowns_of,
)
from roemetry_pinhole.solids import (
    Numbered,
    Shape,
    Solid,
    Start,
    belt_lines,
    footprint,
    inside,
    numbered,
    shape_of,
    start_of,
    toleranced,
)

_GAP_ROWS_MAX = 3.0
"""Rows between a face's last peak and the next one: over a wider gap the edge may be anywhere."""
_ON_FACE_MIN = 4  # peaks of a stripe on a face before its end is taken for an edge
_EDGE_PX = 0.6
"""Standard uncertainty of an edge between two rows, px: rectangular over a row, chamfer and blur as much
again."""
_SOMEWHERE_SHARE = 0.5
"""Of the image's width: that the solid is in the image at all, as an observation that keeps the start
there."""
_NOWHERE, _BELT = -2, -1


@dataclass(frozen=True, eq=False, slots=True)
class Assigned:
    """Peaks on belt and faces, and ends of faces; by number, so that other lengths can be put in."""

    points: StripePoints
    edges: Edges
    """points, edges: of the adjustment; their `face` and `wall` not yet given."""
    solid: Integers
    face: Integers
    """solid, face: (point,) number of the view's solid and of the face on it, −1 on the belt."""
    edge_solid: Integers
    edge_face: Integers
    edge_side: Integers
    """edge_solid, edge_face, edge_side: (edge,) solid, face and which of its walls; −1 for the one that says
    that the solid is in the image."""
    left_share: float
    """Share of the peaks that lie nowhere."""

    def placed(self, shapes: list[Shape]) -> tuple[StripePoints, Edges]:
        """Give points and edges with the planes of these shapes."""
        plane = np.tile([0.0, 0.0, 1.0, 0.0], (self.face.size, 1))
        face, wall = (
            np.empty((self.edge_face.size, 4)),
            np.tile([1.0, 0.0, 0.0, 0.0], (self.edge_face.size, 1)),
        )
        for number, shape in enumerate(shapes):
            planes = np.array([one.plane for one in shape.faces])
            mine = (self.solid == number) & (self.face >= 0)
            plane[mine] = planes[self.face[mine]]
            own = self.edge_solid == number
            face[own] = planes[self.edge_face[own]]
            own &= self.edge_side >= 0
            walls = np.array([one.walls for one in shape.faces])
            wall[own] = walls[self.edge_face[own], self.edge_side[own]]
        return replace(self.points, face=plane), replace(self.edges, face=face, wall=wall)


def assigned(
    geometry: Geometry,
    bare: list[Numbered],
    views: list[Numbered],
    shapes: list[Shape],
    first_pose: int,
    image_size: tuple[int, int],
    *,
    off_share: float,
    rim_share: float,
    points_max: int,
) -> Assigned:
    """Assign peaks to belt and faces by a geometry that is nearly right; the solids' poses are its last ones.

    `bare` are images of the empty belt, `views` those of the solids `shapes`, the first of which has the pose
    `first_pose`. Points may be `off_share` of a solid's height off a face and must lie `rim_share` of its
    extent within its rim; of more than `points_max` peaks every so many-th is taken.
    """
    every = sum(view.stripe.size for view in [*bare, *views])
    # rounded up: at most so many points
    step = max(1, -(-every // points_max))
    points, edges, kept = [], [], 0
    for view in bare:
        points.append(_rows(view, ON_BELT, 0, np.full(view.stripe.size, _BELT)))
        kept += view.stripe.size
    for number, (view, shape) in enumerate(zip(views, shapes, strict=True)):
        pose = first_pose + number
        xyz = _on_solid(geometry, view, pose)
        face, core = _faces(xyz, shape, off_share * shape.height_mm, rim_share * shape.along_mm)
        use = core & (face != _NOWHERE)
        kept += int((face != _NOWHERE).sum())
        points.append(_rows(view, pose, number, face)[use])
        edges += [(pose, number, *end) for end in _ends(view, face, xyz[:, 1], shape)]
        # so loose that only a solid that leaves the image feels it
        middle = (0.5 * (image_size[1] - 1), 0.5 * (image_size[0] - 1))
        edges.append((pose, number, shape.top, -1, *middle, _SOMEWHERE_SHARE * image_size[1]))
    table = np.concatenate(points)[::step]
    rims = np.array(edges, np.float64).reshape(-1, 7)
    none = np.empty((len(rims), 4))
    x_px, row_px, std_px = np.ascontiguousarray(table[:, 2:5].T)
    pose, stripe, solid, face = table[:, [0, 1, 5, 6]].astype(np.int64).T
    rim_pose, rim_solid, rim_face, side = rims[:, :4].astype(np.int64).T
    return Assigned(
        StripePoints(
            np.where(face < 0, ON_BELT, pose),
            np.ascontiguousarray(stripe),
            x_px,
            row_px,
            std_px,
            np.zeros(len(table)),
        ),
        Edges(rim_pose, none, none, rims[:, 4:6], rims[:, 6]),
        solid,
        face,
        rim_solid,
        rim_face,
        side,
        left_share=1.0 - kept / max(every, 1),
    )


def _rows(view: Numbered, pose: int, solid: int, face: Integers) -> Floats:
    """(peak, 7) pose, stripe, x, row, standard uncertainty, solid, face."""
    same = np.ones(view.stripe.size)
    return np.column_stack(
        [pose * same, view.stripe, view.x_px, view.row_px, view.std_px, solid * same, face]
    )


def _on_solid(geometry: Geometry, view: Numbered, pose: int) -> Floats:
    """(peak, 3) where the peaks' rays meet their planes of light, in the solid's frame, mm."""
    depth = 1.0 / (view.ray * geometry.planes[view.stripe]).sum(axis=1)
    return np.asarray((view.ray * depth[:, None] - geometry.shift[pose]) @ geometry.rotation[pose])


def _faces(xyz: Floats, shape: Shape, off_mm: float, rim_mm: float) -> tuple[Integers, np.ndarray]:
    """(peak,) face, −1 belt, −2 none; and whether it is well within its rim."""
    face = np.full(len(xyz), _NOWHERE)
    core = np.zeros(len(xyz), np.bool_)
    away = footprint(shape, xyz[:, :2])
    # belt beside the solid, up to the rim of its footprint
    on_belt = (np.abs(xyz[:, 2]) <= off_mm) & (away < rim_mm)
    face[on_belt], core[on_belt] = _BELT, (away < -rim_mm)[on_belt]
    for number, one in enumerate(shape.faces):
        off = np.abs(xyz @ one.plane[:3] - one.plane[3])
        depth = inside(one, xyz[:, :2])
        mine = (off <= off_mm) & (depth > -rim_mm)
        # where two faces meet a point belongs to the one in whose outline it lies
        mine &= (depth > 0.0) | (face == _NOWHERE)
        face[mine], core[mine] = number, depth[mine] > rim_mm
    return face, core


def _ends(view: Numbered, face: Integers, y_mm: Floats, shape: Shape) -> list[tuple[float, ...]]:
    """Where stripes leave a face over one of its walls: face, side, x, row, standard uncertainty."""
    found: list[tuple[float, ...]] = []
    for stripe in np.unique(view.stripe):
        mine = np.flatnonzero(view.stripe == stripe)
        row, x, at = view.row_px[mine], view.x_px[mine], face[mine]
        for number, one in enumerate(shape.faces):
            on = np.flatnonzero(at == number)
            if on.size < _ON_FACE_MIN:
                continue
            for end, inwards in ((on[0], 1), (on[-1], -1)):
                beyond = end - inwards
                if not 0 <= beyond < row.size or abs(row[end] - row[beyond]) > _GAP_ROWS_MAX:
                    continue
                # which of the two walls is nearer
                side = int(y_mm[mine[end]] > 0.5 * (one.walls[0, 3] + one.walls[1, 3]))
                if not one.ends[side]:
                    continue
                # half way to the next row, along the stripe's slope
                half = 0.5 * (row[beyond] - row[end])
                at_x = x[end] + abs(half) * (x[end] - x[end + inwards])
                found.append((number, side, at_x, row[end] + half, _EDGE_PX))
    return found


_ROUNDS = (
    (0.30, 0.05, 4000),
    (0.20, 0.05, 4000),
    (0.12, 0.03, 4000),
    (0.06, 0.02, 4000),
    (0.06, 0.02, 4000),
    (0.04, 0.02, 4000),
    (0.04, 0.02, 8000),
)
"""Of each round: how far off a face points may be, in heights; how far within its rim, in
extents; how many points."""
_LIES_STD_MM = 0.01  # how well a machined solid lies on the belt, mm
_SURFACE_POINTS_MIN = 12  # points of a stripe on a surface: two such surfaces determine its plane
_HEIGHT_RELATIVE_MAX = 0.05
"""Of the camera's distance, for the belt's place: with more, the scale itself is open by as much."""


@dataclass(frozen=True, eq=False, slots=True)
class OnSolids:
    """What the adjustment of solids found."""

    measured: Measured
    adjusted: Adjusted
    """measured, adjusted: what went into it and what came out."""
    shapes: tuple[Shape, ...]
    """The solids."""
    by_tolerance: tuple[Geometry, ...]
    """For each length with a tolerance the geometry it would have been if it were longer by its standard
    uncertainty."""
    left_share: float
    """Share of the peaks that lie on no face."""


def solids_in(observed: CalibrationSet) -> list[tuple[str, Solid]]:
    """Give the solids that are described and seen, by what their images show."""
    given = {"block": observed.block, "staircase": observed.staircase, "pyramid": observed.pyramid}
    return [(shows, solid) for shows, solid in given.items() if solid is not None and observed.showing(shows)]


def from_solids(
    observed: CalibrationSet, boards: Measured, free_camera: Flags, belt: Floats | None
) -> OnSolids:
    """Find planes and belt from described solids.

    `boards` are their marks, with the camera and poses to start with; `free_camera` (12,) says which of the
    camera's numbers are looked for; `belt` (3,) b·X = 1 is where boards on it say, else None.

    Raises
    ------
    CalibrationError
        A solid is not seen, a stripe is seen on one level only, or the belt is not determined.
    """
    camera, stripes = boards.start.camera, observed.stripe_count
    bare = [numbered(view, camera, stripes) for view in observed.showing("belt")]
    given = [(view, solid) for shows, solid in solids_in(observed) for view in observed.showing(shows)]
    views = [numbered(view, camera, stripes) for view, _ in given]
    solids = [solid for _, solid in given]
    fits: list[_Fit] = []
    refusals: list[CalibrationError] = []
    # of the solid that tells most ways round apart
    for turn_deg in max((shape_of(solid).turns_deg for solid in solids), key=len):
        try:
            fits.append(_fitted(boards, free_camera, belt, bare, views, solids, turn_deg, observed))
        except CalibrationError as error:
            refusals.append(error)
    if not fits:
        raise refusals[0]
    fit = min(fits, key=_badness)
    _check_belt(fit.adjusted)
    longer = []
    for number, solid in enumerate(solids):
        # a tolerance is a half-width: rectangular
        for made in toleranced(solid, solid.tolerance_mm / np.sqrt(3.0)):
            other = [*solids[:number], made, *solids[number + 1 :]]
            points, edges = fit.assigned.placed([shape_of(one) for one in other])
            longer.append(replace(fit.measured, points=points, edges=edges).step_of(fit.adjusted)[0])
    shapes = tuple(shape_of(solid) for solid in solids)
    return OnSolids(fit.measured, fit.adjusted, shapes, tuple(longer), fit.assigned.left_share)


@dataclass(frozen=True, eq=False, slots=True)
class _Fit:
    measured: Measured
    adjusted: Adjusted
    assigned: Assigned


def _badness(fit: _Fit) -> float:
    """Rms of the stripes, px, the worse the more peaks lie nowhere."""
    rms = np.sqrt((fit.adjusted.stripe_px[fit.adjusted.stripe_used] ** 2).mean())
    return float(rms / max(1.0 - fit.assigned.left_share, 1e-3) ** 4)


def _fitted(
    boards: Measured,
    free_camera: Flags,
    belt: Floats | None,
    bare: list[Numbered],
    views: list[Numbered],
    solids: list[Solid],
    turn_deg: float,
    observed: CalibrationSet,
) -> _Fit:
    shapes = [shape_of(solid) for solid in solids]
    focal_px, stripes = float(boards.start.camera[0]), observed.stripe_count
    starts: list[Start] = []
    for view, shape in zip(views, shapes, strict=True):
        lines = belt_lines(bare[0] if bare else None, view, stripes, focal_px)
        turn = turn_deg if len(shape.turns_deg) > 1 else 0.0
        # all on one belt: places by different belts would not fit together
        starts.append(start_of(view, lines, shape, focal_px, starts[0].belt if starts else belt, turn))
    first_pose = len(boards.start.shift)
    geometry = replace(
        boards.start,
        rotation=np.concatenate([boards.start.rotation, np.array([start.rotation for start in starts])]),
        shift=np.concatenate([boards.start.shift, np.array([start.shift for start in starts])]),
        planes=starts[0].planes,
        belt=starts[0].belt,
    )
    size = observed.observations[0].frame.size
    under = [shape.along_mm * _UNDER for shape in shapes]
    for number, (off, rim, most) in enumerate(_ROUNDS):
        last = number + 1 == len(_ROUNDS)
        found = assigned(
            geometry, bare, views, shapes, first_pose, size, off_share=off, rim_share=rim, points_max=most
        )
        _check_surfaces(found, stripes, views[0].name, _SURFACE_POINTS_MIN if last else 3)
        points, edges = found.placed(shapes)
        measured = resting(boards, free_camera, geometry, points, under, first_pose, edges)
        if last:
            break
        # robustly between the rounds; only the last is adjusted to the end
        geometry = measured.robust_prefit()
    return _Fit(measured, measured.adjusted(), found)


_UNDER = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]])
"""Three points under a solid that touch the belt, in its extents along the stripes."""


def resting(
    boards: Measured,
    free_camera: Flags,
    geometry: Geometry,
    points: StripePoints,
    under_mm: list[Floats],
    first_pose: int,
    edges: Edges = NO_EDGES,
) -> Measured:
    """Give what boards and solids show together; each solid rests on the belt on three points (3, 3), mm."""
    pose = first_pose + np.repeat(np.arange(len(under_mm)), 3)
    contacts = BeltContacts(
        np.concatenate([boards.contacts.pose, pose]),
        np.concatenate([boards.contacts.board_mm, *under_mm]),
        np.concatenate([boards.contacts.counts, np.zeros(pose.size)]),
    )
    of_boards = np.broadcast_to(boards.contact_std_mm, boards.contacts.pose.shape)
    std_mm = np.concatenate([of_boards, np.full(pose.size, _LIES_STD_MM)])
    warp = geometry.warp is not None
    unknowns = unknowns_of(geometry, free_camera=free_camera, planes=True, belt=True, warp=warp)
    return Measured(geometry, unknowns, boards.corners, points, contacts, std_mm, edges)


def _check_surfaces(found: Assigned, stripes: int, name: str, least: int) -> None:
    """Each stripe must lie on two surfaces: on one its plane may turn about its line."""
    for stripe in range(stripes):
        mine = found.points.stripe == stripe
        places, many = np.unique(
            np.where(found.face[mine] < 0, -1, 100 * found.solid[mine] + found.face[mine]), return_counts=True
        )
        if (many >= least).sum() < 2:
            where = "no surface" if places.size == 0 else "one surface only"
            raise CalibrationError(
                f"{name}: stripe {stripe + 1} is found on {where}: that determines no plane",
                hint="lay the solid under all stripes, or take several images with the solid elsewhere; is "
                "the camera file that of this camera, and are the solid's lengths right?",
            )


def _check_belt(found: Adjusted) -> None:
    """The belt's distance and tilt must be known well enough for heights, not only nominally."""
    belt, at = found.geometry.belt, found.unknowns.belt
    worst = float(np.sqrt(np.linalg.eigvalsh(found.covariance[np.ix_(at, at)]).max() / (belt @ belt)))
    if worst > _HEIGHT_RELATIVE_MAX:
        raise CalibrationError(
            f"the images do not determine where the belt is: its position is uncertain by {worst:.0%} of its "
            "distance from the camera",
            hint="lay the board on the belt (images.board_on_belt), or take a solid whose edges or slopes "
            "are seen on several stripes",
        )
