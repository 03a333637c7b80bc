"""Planes of light from solids of known shape on the belt, with a camera that is known or comes from boards.

Peaks go to the faces of the solid by a first geometry; all is adjusted; the peaks go to the faces anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry_pinhole.adjustment import Adjusted
from roemetry_pinhole.equations import Feet
from roemetry_pinhole.geometry import Geometry, unknowns_of
from roemetry_pinhole.measured import Measured
from roemetry_pinhole.solid_faces import Assigned, assigned, righted
from roemetry_pinhole.solid_shapes import Shape, Solid, shape_of, toleranced
from roemetry_pinhole.solid_start import Numbered, Start, belt_lines, numbered, start_of

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
_RIGHTED_FROM = 3
"""Stripes that change places at a rim are told apart only by a geometry that is nearly right."""
_LIES_STD_MM = 0.01
_SURFACE_POINTS_MIN = 12
_HEIGHT_RELATIVE_MAX = 0.05
_ROWS = 5


@dataclass(frozen=True, eq=False, slots=True)
class OnSolids:
    """What the adjustment of solids found.

    Attributes
    ----------
    measured, adjusted
        What went into it and what came out.
    shapes
        The solids.
    by_tolerance
        For each length with a tolerance the geometry it would have been if it were longer by its standard
        uncertainty.
    left_share
        Share of the peaks that lie on no face.
    """

    measured: Measured
    adjusted: Adjusted
    shapes: tuple[Shape, ...]
    by_tolerance: tuple[Geometry, ...]
    left_share: float


def solids_in(observed: CalibrationSet) -> list[tuple[str, Solid]]:
    """Give the solids that are described and seen, by what their images show."""
    given = {"block": observed.block, "staircase": observed.staircase, "pyramid": observed.pyramid}
    return [(shows, solid) for shows, solid in given.items() if solid is not None and observed.showing(shows)]


def from_solids(
    observed: CalibrationSet, boards: Measured, free_camera: Flags, belt: Floats | None
) -> OnSolids:
    """Find planes and belt.

    Parameters
    ----------
    observed
        The images; the solids must be described.
    boards
        The boards' marks, with the camera and their poses to start with; planes and belt of it do not count.
    free_camera
        (12,) which of the camera's numbers are looked for.
    belt
        (3,) b·X = 1 where boards on the belt say where it is; else None.

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
    for turn_deg in max((shape_of(solid).turns_deg for solid in solids), key=len):
        try:
            fits.append(_fitted(boards, free_camera, belt, bare, views, solids, turn_deg, observed))
        except CalibrationError as error:
            refusals.append(error)
    if not fits:
        raise refusals[0]
    fit = min(fits, key=_badness)
    _check_belt(fit)
    return OnSolids(
        fit.measured,
        fit.adjusted,
        tuple(shape_of(solid) for solid in solids),
        tuple(_if_longer(fit, solids)),
        fit.assigned.left_share,
    )


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
    right = views
    for number, (off_share, rim_share, points_max) in enumerate(_ROUNDS):
        last = number + 1 == len(_ROUNDS)
        found = assigned(
            geometry,
            bare,
            right,
            shapes,
            first_pose,
            size,
            off_share=off_share,
            rim_share=rim_share,
            points_max=points_max,
        )
        _check_surfaces(found, stripes, views[0].name, _SURFACE_POINTS_MIN if last else 3)
        measured = _measured(boards, free_camera, geometry, found, shapes, first_pose)
        if last:
            break
        geometry = measured.nearly()
        if number < _RIGHTED_FROM:
            continue
        right = [
            righted(geometry, view, shape, first_pose + place)
            for place, (view, shape) in enumerate(zip(views, shapes, strict=True))
        ]
    return _Fit(measured, measured.adjusted(), found)


def _measured(
    boards: Measured,
    free_camera: Flags,
    geometry: Geometry,
    found: Assigned,
    shapes: list[Shape],
    first_pose: int,
) -> Measured:
    points, edges = found.placed(shapes)
    size = [shape.along_mm for shape in shapes]
    under = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]])
    pose = first_pose + np.repeat(np.arange(len(shapes)), 3)
    feet = Feet(
        np.concatenate([boards.feet.pose, pose]),
        np.concatenate([boards.feet.board_mm, *(side * under for side in size)]),
        np.concatenate([boards.feet.counts, np.zeros(pose.size)]),
    )
    of_boards = np.broadcast_to(boards.foot_std_mm, boards.feet.pose.shape)
    return Measured(
        geometry,
        unknowns_of(
            geometry,
            free_camera=free_camera,
            planes=True,
            belt=True,
            travel=False,
            bend=geometry.bend is not None,
        ),
        boards.corners,
        points,
        feet,
        np.concatenate([of_boards, np.full(pose.size, _LIES_STD_MM)]),
        edges,
    )


def _if_longer(fit: _Fit, solids: list[Solid]) -> list[Geometry]:
    """Adjust again for each length with a tolerance, longer by its standard uncertainty."""
    found = []
    for number, solid in enumerate(solids):
        for longer in toleranced(solid):
            other = [*solids[:number], longer(solid.tolerance_mm / np.sqrt(3.0)), *solids[number + 1 :]]
            points, edges = fit.assigned.placed([shape_of(one) for one in other])
            found.append(replace(fit.measured, points=points, edges=edges).stepped(fit.adjusted))
    return found


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


def _check_belt(fit: _Fit) -> None:
    """The belt's distance and tilt must be known well enough for heights, not only nominally."""
    geometry, unknowns = fit.adjusted.geometry, fit.adjusted.unknowns
    covariance = fit.adjusted.covariance[np.ix_(unknowns.belt, unknowns.belt)]
    size = float(np.sqrt(geometry.belt @ geometry.belt))
    worst = float(np.sqrt(np.linalg.eigvalsh(covariance).max())) / size
    if worst > _HEIGHT_RELATIVE_MAX:
        raise CalibrationError(
            f"what was seen does not tell where the belt is: its place is uncertain by {worst:.0%} of its "
            "distance from the camera",
            hint="lay the board on the belt (images.board_on_belt), or take a solid whose edges or slopes "
            "are seen on several stripes",
        )
