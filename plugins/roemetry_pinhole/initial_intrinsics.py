"""Initial camera and poses from the marks alone; views that do not fit are left out with the reason.

Model (Zhang 2000). Each view of a flat board is a homography; three and more of different tilts determine
the camera's focal length. OpenCV's linear guess gives it, poses come from Collins and Bartoli's method
(2014), and marks alone are adjusted with the lens model less its highest orders, which the joint adjustment
adds. A circle's centre of gravity in the image is not the image of its centre: the difference, integrated
over the disc, is taken off once the pose is known. A view whose marks are off by many times the others' is
left out by name.

It fails where all boards are parallel, which is refused.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import Board
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_pinhole.boards import BoardView, Seen
from roemetry_pinhole.bundle import Measured
from roemetry_pinhole.geometry import CAMERA, BeltContacts, BoardWarp, Corners, Geometry, distort, unknowns_of
from roemetry_pinhole.pinhole_plane import camera_matrix

_POSES_MIN = 4  # poses of an unknown camera: Zhang's method needs three, a fourth shows which one is wrong
_POSES_MIN_KNOWN = 2  # poses of a known camera: two lines determine each plane of light
_TILT_SPREAD_MIN_DEG = 8.0
"""Largest angle between two boards: parallel boards leave focal length and distance undecided (Zhang
2000)."""
_VIEW_FACTOR_MAX = 4.0
"""A view's rms over the median view's: light and focus change noise little; a bent or mirrored
board is far off."""
_VIEW_RMS_MIN_PX = 0.3
"""A view below this is never left out: half a pixel of blur or a simpler lens model do as much."""

FREE: dict[str, tuple[int, ...]] = {
    "none": (),
    "radial": (4, 5),
    "brown": (4, 5, 6, 7, 8),
    "rational": tuple(range(4, CAMERA)),
    "tangential": (4, 5, 6, 7),
}
"""By name of the lens model, which of the camera's twelve numbers are looked for beside the first four."""


@dataclass(frozen=True, eq=False, slots=True)
class InitialCamera:
    """Camera (12,), views that fit, and (view, 3, 3), (view, 3) their poses."""

    camera: Floats
    views: list[BoardView]
    rotation: Floats
    shift: Floats

    def surface(self, number: int, under_mm: float = 0.0) -> Floats:
        """Give (3,) p·X = 1 of a view's board, or of what is so far under its print."""
        normal = self.rotation[number][:, 2]
        return np.asarray(normal / (normal @ self.shift[number] + under_mm))


def initial_camera(
    seen: Seen,
    image_size: tuple[int, int],
    lens: str,
    known: Floats | None,
    tried: int,
    *,
    least_if_known: int = _POSES_MIN_KNOWN,
) -> InitialCamera:
    """Find the camera, or only the poses where the camera is known.

    What is left out of the poses is added to `seen`; `lens` is a key of `FREE`, `known` (12,) the camera, if
    it is known, `tried` the number of poses there were, for messages, and `least_if_known` the number that is
    needed where the camera is known.

    Raises
    ------
    CalibrationError
        Too few poses, or poses too much alike.
    """
    views = list(seen.views)
    least = _POSES_MIN if known is None else least_if_known
    while True:
        if len(views) < least:
            alike = max(Counter(seen.left_out.values()).values(), default=0)
            raise CalibrationError(
                f"the board is seen in {len(views)} of {tried} poses; {least} are the least"
                + reasons(seen.left_out),
                hint=f"begin with the reason given for {'the image' if alike == 1 else f'{alike} images'}"
                if alike > tried / 2
                else "take ten to twenty poses: all over the image, at all heights, tilted in all directions",
            )
        if not views and known is not None:
            return InitialCamera(known, [], np.empty((0, 3, 3)), np.empty((0, 3)))
        # one view at a time, the worst: it may spoil the others' fit
        found = _solved(views, image_size, lens, known)
        rms = _rms(found)
        worst = int(rms.argmax())
        limit = max(_VIEW_FACTOR_MAX * float(np.median(rms)), _VIEW_RMS_MIN_PX)
        if rms[worst] <= limit:
            break
        seen.left_out[views[worst].name] = (
            f"its corners are off by {rms[worst]:.2f} px (rms), those of the others by {np.median(rms):.2f}"
            " px: is it mirrored or bent, or did it move? Leave the image out"
        )
        del views[worst]
    if any(view.marks.radius_mm for view in found.views):
        # twice: the shift moves the poses, and they the shift
        for _ in range(2):
            centred = [_without_shift(view, found, number) for number, view in enumerate(views)]
            found = replace(_solved(centred, image_size, lens, known), views=centred)
    normal = found.rotation[:, :, 2]
    spread = float(np.degrees(np.arccos(np.clip((normal @ normal.T).min(), -1.0, 1.0))))
    if known is None and spread < _TILT_SPREAD_MIN_DEG:
        raise CalibrationError(
            f"the poses have no variety: no two boards are tilted against each other by more than "
            f"{spread:.1f}° ({_TILT_SPREAD_MIN_DEG:g}° is the least)",
            hint="tilt the board by 20 to 30 degrees, another way in each pose",
        )
    return found


_SIMPLER = {"none": "none", "radial": "radial", "brown": "tangential", "rational": "tangential"}


def free_numbers(lens: str) -> Flags:
    """Give (12,) which of the camera's numbers are looked for."""
    free = np.zeros(CAMERA, np.bool_)
    free[[0, 1, 2, 3, *FREE[lens]]] = True
    return free


def _solved(
    views: list[BoardView], image_size: tuple[int, int], lens: str, known: Floats | None
) -> InitialCamera:
    """Poses of a guessed camera by Collins and Bartoli's method, then marks alone adjusted."""
    import cv2

    places = [view.marks.board_mm.astype(np.float32) for view in views]
    seen = [view.marks.xy_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    camera = np.zeros(CAMERA)
    if known is not None:
        camera = known
    else:
        # the aspect ratio is left free: of a rank-deficient set the guess would not be a number
        guess = cv2.initCameraMatrix2D(places, seen, image_size[::-1], 1.0)
        sane = np.isfinite(guess).all() and 0.2 * max(image_size) < guess[0, 0] < 50.0 * max(image_size)
        camera[:2] = guess[0, 0] if sane else 1.5 * max(image_size)
        camera[2:4] = (image_size[1] - 1) / 2.0, (image_size[0] - 1) / 2.0
    matrix = camera_matrix(camera)
    rotation, shift = np.empty((len(views), 3, 3)), np.empty((len(views), 3))
    for number, (place, xy) in enumerate(zip(places, seen, strict=True)):
        _, turn, way = cv2.solvePnP(place, xy, matrix, camera[4:], flags=cv2.SOLVEPNP_IPPE)
        rotation[number], shift[number] = cv2.Rodrigues(turn)[0], way.ravel()
    # the sixth order and the rational model come in by the joint adjustment: from a start without them it
    # goes to the right minimum
    free = np.zeros(CAMERA, np.bool_) if known is not None else free_numbers(_SIMPLER[lens])
    found = boards_alone(InitialCamera(camera, views, rotation, shift), free).adjusted().geometry
    return InitialCamera(found.camera, views, found.rotation, found.shift)


def _without_shift(view: BoardView, found: InitialCamera, number: int) -> BoardView:
    """Take off how far a circle's centre of gravity in the image lies from the image of its centre."""
    marks = view.marks
    # six rings of equal area, 24 directions
    radius, turn = np.meshgrid(np.sqrt((np.arange(6) + 0.5) / 6.0), np.arange(24) * np.pi / 12.0)
    disc = marks.radius_mm * np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.0 * turn], axis=-1)
    shape = (len(marks.board_mm), disc.size // 3, 3)
    places = np.broadcast_to(marks.board_mm[:, None, :], shape) + disc.reshape(1, -1, 3)
    seen, weight = _projected(found, number, places.reshape(-1, 3))
    seen, weight = seen.reshape(*shape[:2], 2), weight.reshape(shape[:2])
    # each part by how large it is seen
    centre = (seen * weight[..., None]).sum(axis=1) / weight.sum(axis=1)[:, None]
    shift = centre - _projected(found, number, marks.board_mm)[0]
    raw = view.raw_px if view.raw_px is not None else marks.xy_px
    return replace(view, marks=replace(marks, xy_px=raw - shift), raw_px=raw)


def _projected(found: InitialCamera, number: int, places: Floats) -> tuple[Floats, Floats]:
    """Give (n, 2) places in the image, px, and how large a unit of the board's area is there."""
    at = places @ found.rotation[number].T + found.shift[number]
    lens = distort(at[:, :2] / at[:, 2:], found.camera[4:])
    # area: determinant of the lens over the depth cubed
    area = np.linalg.det(lens.by_place) / at[:, 2] ** 3
    return lens.xy * found.camera[:2] + found.camera[2:4], area


def _rms(found: InitialCamera) -> Floats:
    rms = []
    for number, view in enumerate(found.views):
        xy = _projected(found, number, view.marks.board_mm)[0]
        rms.append(float(np.sqrt(((xy - view.marks.xy_px) ** 2).sum(axis=1).mean())))
    return np.array(rms)


def reasons(left_out: dict[str, str]) -> str:
    """Give a line for each reason, with the names of all images that share it; the commonest first."""
    names: dict[str, list[str]] = {}
    for name, why in left_out.items():
        names.setdefault(why, []).append(name)
    each = sorted(names.items(), key=lambda one: -len(one[1]))
    return "".join(f"\n  {', '.join(those)}: {why}" for why, those in each)


def boards_alone(
    first: InitialCamera, free: Flags, *, contacts: bool = False, warped: Board | None = None
) -> Measured:
    """Give what boards tell of the camera and their poses without any light on them.

    `contacts`: boards that lie on the belt determine it as well; `warped`: the board whose shape is fitted.
    """
    number, still = np.arange(len(first.views)), np.zeros(len(first.views))
    lies = [n for n, view in enumerate(first.views) if contacts and view.on_belt]
    belt = belt_under(first, lies[0]) if lies else np.full(3, np.nan)
    warp = None if warped is None or not first.views else BoardWarp.none(*warped.size_mm.tolist())
    start = Geometry(first.camera, first.rotation, first.shift, belt=belt, warp=warp)
    unknowns = unknowns_of(start, free_camera=free, belt=bool(lies))
    found = Measured(start, unknowns, corners_of(first, number, still))
    if not lies:
        return found
    stand, std_mm = contacts_of(first.views, number, still)
    return replace(found, contacts=stand, contact_std_mm=std_mm)


def corners_of(first: InitialCamera, pose: Integers, counts: Floats) -> Corners:
    """Give the marks of all views, each with its pose (view,) and encoder counts (view,)."""
    marks = [view.marks for view in first.views]
    size = [len(one.xy_px) for one in marks]
    return Corners(
        np.repeat(pose, size).astype(np.int64),
        np.concatenate([np.empty((0, 3)), *(one.board_mm for one in marks)]),
        np.concatenate([np.empty((0, 2)), *(one.xy_px for one in marks)]),
        np.repeat(counts, size),
        np.repeat([view.number for view in first.views], size).astype(np.int64),
    )


def belt_under(first: InitialCamera, number: int) -> Floats:
    """Give (3,) b·X = 1 of what the board of a view lies on."""
    return first.surface(number, first.views[number].board.thickness_mm)


def contacts_of(views: list[BoardView], pose: Integers, counts: Floats) -> tuple[BeltContacts, Floats]:
    """Three corners of the underside of each board that lies on the belt; standard uncertainties, mm."""
    lies = [number for number, view in enumerate(views) if view.on_belt]
    places, std_mm = [np.empty((0, 3))], []
    for board in (views[number].board for number in lies):
        width, height = board.size_mm
        at = [[0.0, 0.0], [width, 0.0], [0.5 * width, height]]
        places.append(np.column_stack([at, np.full(3, board.thickness_mm)]))
        std_mm += [max(board.flatness_mm, 0.005) / np.sqrt(3.0)] * 3
    contacts = BeltContacts(
        np.repeat(pose[lies], 3).astype(np.int64), np.concatenate(places), np.repeat(counts[lies], 3)
    )
    return contacts, np.array(std_mm)
