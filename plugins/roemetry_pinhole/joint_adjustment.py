"""From a calibration set to the joint adjustment of all that is seen in it.

What there is decides the way: boards under the stripes tell camera and planes together; solids or a sphere
plate on the belt tell the planes, with a camera that boards or a file tell; and with camera and planes from
files (`roemetry_pinhole.known_files`) only the belt is looked for. Without a belt one pose of the board gives
the plane from which heights are measured. The boards alone give the camera alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import Board, CalibrationSet, CameraFit
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_pinhole.boards import Seen, board_views
from roemetry_pinhole.bundle import Adjusted, Measured, with_disagreement
from roemetry_pinhole.from_solids import OnSolids, from_solids, solids_in
from roemetry_pinhole.geometry import CAMERA, BoardWarp, Geometry, rays, unknowns_of
from roemetry_pinhole.initial_intrinsics import (
    InitialCamera,
    belt_under,
    boards_alone,
    contacts_of,
    corners_of,
    free_numbers,
    initial_camera,
    reasons,
)
from roemetry_pinhole.known_files import read_camera
from roemetry_pinhole.plates import from_plate
from roemetry_pinhole.prints import stretched
from roemetry_pinhole.stripes import Gathered, belt_points, gather

_OFF_MAX_PX = 3.0
"""Median residual of the belt's stripes by known planes, px: planes of another rig or frame are off by
tens."""


def with_known_planes(observed: CalibrationSet, camera: Floats | None, planes: Floats) -> Measured:
    """Give the belt's stripes, to be adjusted with camera (12,) and planes (stripe, 3) p·X = 1 as they are.

    Raises
    ------
    CalibrationError
        No camera, another number of planes than stripes, one stripe alone, no image of the belt, or the
        stripes on it do not lie where the planes could meet one belt.
    """
    if camera is None:
        raise CalibrationError(
            "planes of light are given without the camera in whose frame they are",
            hint="name the camera's file as well: options: {camera: camera.yaml, planes: planes.yaml}",
        )
    if len(planes) != observed.stripe_count:
        raise CalibrationError(
            f"the file of planes holds {len(planes)}, the rig has {observed.stripe_count} stripes",
            hint="give a row A, B, C, D for each stripe, from left to right",
        )
    if len(planes) < 2 or not observed.showing("belt"):
        raise CalibrationError(
            "nothing shows where the belt is",
            hint="with known planes, name images of the empty belt in images.belt; a single stripe does not "
            "determine its tilt: calibrate with boards",
        )
    points, belt = belt_points(observed.showing("belt"), camera, planes)
    start = Geometry(camera, np.empty((0, 3, 3)), np.empty((0, 3)), planes, belt)
    unknowns = unknowns_of(start, free_camera=np.zeros(CAMERA, np.bool_), belt=True)
    measured = Measured(start, unknowns, points=points)
    hint = "are they in the camera's frame, in mm, from left to right, and is `planes_form` right?"
    if belt[2] <= 0:
        raise CalibrationError("by the known planes the belt is behind the camera", hint=hint)
    # camera and planes are held: the belt alone is looked for
    off_px = float(np.median(np.abs(measured.adjusted().stripe_px)))
    if off_px > _OFF_MAX_PX:
        raise CalibrationError(
            f"the known planes meet no belt where the stripes are: those are off by {off_px:.1f} px",
            hint=hint,
        )
    return measured


def known_planes_covariance(
    measured: Measured, found: Adjusted, angle_std_deg: float, offset_std_mm: float
) -> Floats:
    """Give the covariance, of planes and belt, that the known planes' own uncertainty makes.

    Each plane may lean about two axes through the middle of its stripe on the belt, and lie beside that
    place along its normal, all on their own; the belt follows, since it is where the planes and the stripes
    on it meet. Gives (3 stripe + 3, 3 stripe + 3) of `planes_per_mm` and `belt_per_mm`, flattened.
    """
    before, points = found.geometry, measured.points
    # where the belt comes out with the planes as given
    mean = np.concatenate([before.planes.ravel(), measured.step_of(found)[0].belt])
    covariance = np.zeros((mean.size, mean.size))
    for stripe, plane in enumerate(before.planes):
        mine = points.stripe == stripe
        ray = rays(before.camera, np.array([[points.x_px[mine].mean(), points.row_px[mine].mean()]]))[0]
        # the middle of the stripe on the belt, about which the plane leans
        place = ray / (ray @ before.belt)
        middle = place - (plane @ place - 1.0) / (plane @ plane) * plane
        normal = plane / np.sqrt(plane @ plane)
        one = np.cross(normal, [0.0, 1.0, 0.0])
        one /= np.sqrt(one @ one)
        lean = [normal + np.radians(angle_std_deg) * way for way in (one, np.cross(normal, one))]
        shifted = normal / (normal @ middle + offset_std_mm)
        # p = n / (n·middle): the leaned plane goes through the same middle
        for moved in (*(way / (way @ middle) for way in lean), shifted):
            planes = before.planes.copy()
            planes[stripe] = moved
            there = replace(found, geometry=replace(before, planes=planes))
            way = np.concatenate([planes.ravel(), measured.step_of(there)[0].belt]) - mean
            # each of the three errors by itself, independent of the others
            covariance += np.outer(way, way)
    return covariance


@dataclass(frozen=True, eq=False, slots=True)
class JointAdjustment:
    """The joint adjustment, and what it was made of."""

    board: Board | None
    """What was held under the stripes; None where solids alone were seen."""
    size: tuple[int, int]
    """Rows and columns of the images."""
    seen: Seen
    first: InitialCamera
    """seen, first: poses, and by image why others are not used; the views that are."""
    pose: Integers
    """(view,) number of the view's pose in the adjustment."""
    print_share: float
    outlier_share: float
    """print_share, outlier_share: share of the boards' stripe peaks on uneven print, which are not used, and
    share of the others that is left out before the adjustment, far off its stripe."""
    solids: OnSolids | None
    """What solids on the belt gave, where the planes come from them; else None."""
    measured: Measured
    adjusted: Adjusted
    """measured, adjusted: what went into the adjustment, and what came out."""
    moves: bool
    """Whether the belt's travel is among the unknowns."""
    belts: tuple[str, ...] = ()
    """Names of the images of the empty belt."""


def adjust_jointly(
    observed: CalibrationSet,
    seen: Seen,
    *,
    lens: str,
    camera_file: Path | None,
    print_contrast_max: float,
    fit_warp: bool = False,
    planes: Floats | None = None,
    reference_pose: str | None = None,
) -> JointAdjustment:
    """Find everything in the images and adjust it together.

    `seen` is filled with the poses, and by image why others are not used, also where this then fails;
    `camera_file` holds a camera that is known and not looked for, `planes` (stripe, 3) p·X = 1 the same; the
    rest as among `PinholeCalibrator`'s options. Raises as `PinholeCalibrator.calibrate`.
    """
    board = observed.board
    by_solids = planes_by_solids(observed)
    known = None if camera_file is None else read_camera(camera_file)
    if planes is not None:
        measured = with_known_planes(observed, known, planes)
        start = measured.start
        first = InitialCamera(start.camera, [], start.rotation, start.shift)
        none = np.empty(0, np.int64)
        size = observed.observations[0].frame.size
        return JointAdjustment(
            None, size, Seen(), first, none, 0.0, 0.0, None, measured, measured.adjusted(), moves=False
        )
    if board is None and not (by_solids and known is not None):
        raise CalibrationError(
            "no board is described",
            hint="add `board:` to the rig file: its kind, columns, rows and pitch_mm; or give a camera file "
            "and images of a block, a staircase or a truncated pyramid",
        )
    board_views(observed, seen)
    if board is not None and reference_pose is not None:
        _on_reference(seen, reference_pose)
    tried = poses_tried(observed)
    if not tried and not (by_solids and known is not None):
        raise CalibrationError("there is no image of the board", hint="name them in images.board")
    size = observed.observations[0].frame.size
    free = np.zeros(CAMERA, np.bool_) if known is not None else free_numbers(lens)
    # until no view is left out any more
    while True:
        first = initial_camera(seen, size, lens, known, tried, **({"least_if_known": 0} if by_solids else {}))
        if reference_pose is not None and not any(view.on_belt for view in first.views):
            raise CalibrationError(
                f"the pose {reference_pose!r}, which is to be the reference, is not used"
                + reasons(seen.left_out),
                hint="look at its images, or name another pose in reference_pose",
            )
        if board is None or by_solids:
            return _by_solids(observed, board, seen, first, free, fit_warp=fit_warp)
        pose, counts = _placed(first)
        gathered = gather(
            first,
            observed.showing("belt"),
            observed.stripe_count,
            counts,
            seen.left_out,
            print_contrast_max=print_contrast_max,
        )
        if not gathered.outlying_views:
            break
        outlying = {first.views[number].name for number in gathered.outlying_views}
        # a view whose stripes contradict the others takes its marks along
        seen.views = [view for view in seen.views if view.name not in outlying]
    measured = _measured(first, gathered, pose, counts, free, fit_warp=fit_warp)
    adjusted = with_disagreement(measured, measured.adjusted())
    if not fit_warp and known is None:
        seen.notes += stretched(measured, adjusted, first.views)
    return JointAdjustment(
        board,
        size,
        seen,
        first,
        np.unique(pose, return_inverse=True)[1],
        gathered.print_share,
        gathered.outlier_share,
        None,
        measured,
        adjusted,
        bool(np.ptp(counts) > 0),
        tuple(one.frame.name for one in observed.showing("belt")),
    )


_PARTS = 8  # parts of the images, of which each is left out once: their spread is known to a quarter


def camera_alone(observed: CalibrationSet, *, lens: str) -> CameraFit:
    """Find the camera from the boards' marks, without a laser.

    The residuals of an image's marks are not independent: boards bend and move, focus and shutter change. So
    the standard uncertainty is that of leaving out runs of consecutive images, where that is larger and there
    are many (delete-group jackknife; Shao, Wu 1989, Ann. Statist. 17:1176).

    Raises
    ------
    CalibrationError
        No board is described, too few poses, or poses too much alike.
    """
    if observed.board is None:
        raise CalibrationError(
            "no board is described", hint="add `board:` to the rig file: its kind, columns, rows and pitch_mm"
        )
    seen = Seen()
    board_views(observed, seen)
    size = observed.observations[0].frame.size
    first = initial_camera(seen, size, lens, None, poses_tried(observed))
    free, count = free_numbers(lens), len(first.views)
    found = boards_alone(first, free).adjusted()
    at = found.unknowns.camera
    std = np.where(at >= 0, np.sqrt(np.diag(found.covariance)[np.maximum(at, 0)]), 0.0)
    if count >= 2 * _PARTS:
        # runs of consecutive images: what errs together is taken together
        part = np.arange(count) * _PARTS // count
        cameras = []
        for left_out in range(_PARTS):
            kept = part != left_out
            views = [view for view, stays in zip(first.views, kept, strict=True) if stays]
            some = InitialCamera(first.camera, views, first.rotation[kept], first.shift[kept])
            cameras.append(boards_alone(some, free).adjusted().geometry.camera)
        # jackknife: √(k − 1) times the spread of k estimates
        std = np.maximum(std, np.std(cameras, axis=0) * np.sqrt(_PARTS - 1.0))
    off_px = found.corner_px[found.corner_used]
    return CameraFit(
        image_size=size,
        focal_px=found.geometry.camera[:2],
        principal_px=found.geometry.camera[2:4],
        distortion=found.geometry.camera[4:],
        std=std,
        rms_px=float(np.sqrt((off_px**2).sum(axis=1).mean())),
        images=count,
        left_out=dict(seen.left_out),
    )


def marks_alone(
    observed: CalibrationSet, lens: str, camera_file: Path | None
) -> tuple[Seen, InitialCamera, Adjusted]:
    """Find camera, boards and belt by the boards' marks alone; a pattern's light is adjusted after them.

    Raises
    ------
    CalibrationError
        No board, too few poses, no board on the belt or no image of the empty belt.
    """
    if observed.board is None:
        raise CalibrationError("no board is described", hint="add `board:` to the rig file")
    if not observed.showing("belt"):
        raise CalibrationError("there is no image of the empty belt", hint="name one in images.belt")
    seen = Seen()
    board_views(observed, seen)
    known = None if camera_file is None else read_camera(camera_file)
    free = np.zeros(CAMERA, np.bool_) if known is not None else free_numbers(lens)
    size = observed.observations[0].frame.size
    first = initial_camera(seen, size, lens, known, poses_tried(observed))
    if not any(view.on_belt for view in first.views):
        raise CalibrationError(
            "nothing shows where the belt is",
            hint="lay the board on the belt and name the image in images.board_on_belt",
        )
    return seen, first, boards_alone(first, free, contacts=True).adjusted()


def poses_tried(observed: CalibrationSet) -> int:
    """Give the number of poses of boards that images are named of, found or not."""
    return len({(one.shows, one.board, one.pose) for one in observed.observations if one.shows in _BOARDS})


def _on_reference(seen: Seen, pose: str) -> None:
    """Let the board of one pose lie in the plane Z = 0, its print uppermost."""
    there = [number for number, view in enumerate(seen.views) if view.pose == pose]
    if not there:
        poses = ", ".join(view.pose for view in seen.views)
        raise CalibrationError(
            f"the board is not seen in the pose {pose!r}, which is to be the reference; "
            f"it is in {poses or 'none'}{reasons(seen.left_out)}",
            hint="reference_pose is the number in the image's name, as 7 in board_07.png",
        )
    if any(view.on_belt for view in seen.views):
        raise CalibrationError(
            "a board lies on the belt, and another pose is to be the reference",
            hint="leave reference_pose out, or images.board_on_belt",
        )
    there_on = seen.views[there[0]]
    # heights count from its print: the thickness is nothing
    flat = replace(there_on.board, thickness_mm=0.0)
    seen.views[there[0]] = replace(there_on, on_belt=True, board=flat)


def planes_by_solids(observed: CalibrationSet) -> bool:
    """Say whether the planes come from solids: some are there, and no board is under the laser."""
    on_boards = any(one.shows in _BOARDS and one.frame.role == "laser" for one in observed.observations)
    balls = observed.sphere_plate is not None and bool(observed.showing("sphere_plate"))
    return (bool(solids_in(observed)) or balls) and not on_boards


def _by_solids(
    observed: CalibrationSet,
    board: Board | None,
    seen: Seen,
    first: InitialCamera,
    free: Flags,
    *,
    fit_warp: bool,
) -> JointAdjustment:
    """Planes from solids on the belt; boards, if there are any, tell the camera, and where the belt is."""
    boards = boards_alone(first, free, contacts=board is not None, warped=board if fit_warp else None)
    belt = boards.start.belt if boards.contacts.pose.size else None
    plate = observed.sphere_plate
    if solids_in(observed) or plate is None:
        found = from_solids(observed, boards, free, belt)
    else:
        found = from_plate(observed, plate, boards, free, belt)
    return JointAdjustment(
        board if first.views else None,
        observed.observations[0].frame.size,
        seen,
        first,
        np.arange(len(first.views)),
        0.0,
        found.left_share,
        found,
        found.measured,
        found.adjusted,
        moves=False,
    )


_BOARDS = ("board", "board_on_belt")


def _measured(
    first: InitialCamera, gathered: Gathered, pose: Integers, counts: Floats, free: Flags, *, fit_warp: bool
) -> Measured:
    keep = np.unique(pose)
    # poses that were merged get numbers without gaps
    number = np.searchsorted(keep, pose)
    on = gathered.points.pose
    boards = np.array([view.number for view in first.views])
    # the first board's print is as described; another's size is looked for where a stripe lies on it
    sizes = np.zeros((boards.max() + 1 if boards.any() else 0, 2))
    looked_for = np.zeros(sizes.shape, np.bool_)
    if boards.any():
        if fit_warp:
            raise CalibrationError(
                "the shape of the print cannot be fitted with several boards",
                hint="leave `flatness: free` out, or name one board",
            )
        looked_for[np.unique(boards[on[on >= 0]]), 0] = True
        looked_for[0] = False
        sizes[: len(gathered.sizes), 0] = np.log(gathered.sizes)
        # a larger print stands farther away
        first = replace(first, shift=first.shift * np.exp(sizes[boards, :1]))
    start = Geometry(
        first.camera,
        first.rotation[keep],
        first.shift[keep],
        gathered.planes,
        _belt(first, gathered),
        warp=BoardWarp.none(*first.views[0].board.size_mm.tolist()) if fit_warp else None,
        prints=sizes,
    )
    moves = bool(np.ptp(counts) > 0)
    unknowns = unknowns_of(
        start, free_camera=free, planes=True, belt=True, travel=moves, warp=fit_warp, prints=looked_for
    )
    points = replace(gathered.points, pose=np.where(on < 0, on, number[on]))
    contacts, contact_std_mm = contacts_of(first.views, number, counts)
    return Measured(start, unknowns, corners_of(first, number, counts), points, contacts, contact_std_mm)


def _belt(first: InitialCamera, gathered: Gathered) -> Floats:
    """Give the belt (3,) b·X = 1 to start with: under the first board on it, or from its own stripes."""
    for number, view in enumerate(first.views):
        if view.on_belt:
            return belt_under(first, number)
    if gathered.belt is None or not np.isfinite(gathered.belt).all():
        raise CalibrationError(
            "nothing shows where the belt is",
            hint="name images of the empty belt in images.belt, or of the board lying on it in "
            "images.board_on_belt",
        )
    if np.unique(gathered.points.stripe[gathered.points.pose < 0]).size < 2:
        raise CalibrationError(
            "one stripe on the empty belt does not determine how the belt is tilted",
            hint="lay the board on the belt and name the image in images.board_on_belt",
        )
    return gathered.belt


def _placed(first: InitialCamera) -> tuple[Integers, Floats]:
    """Give each view the pose it belongs to and the encoder counts it was carried on since.

    Boards that lie on the belt with known encoder counts were laid there once and are carried along.
    """
    pose = np.arange(len(first.views))
    counts = np.zeros(len(first.views))
    carried = [n for n, view in enumerate(first.views) if view.on_belt and np.isfinite(view.count)]
    for number in carried:
        pose[number] = carried[0]
        counts[number] = first.views[number].count - first.views[carried[0]].count
    return pose, counts
