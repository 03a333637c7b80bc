"""Calibration from real images: twelve boards with a laser line, thirty-two views of a chessboard.

``python -m benchmarks calibrate_real [--extractor NAME] [--channel grey] [--contrast 0.85]``, with the data
where the environment variable ROEMETRY_REAL_DATA says. The laser-off partner is subtracted. Extractor,
channel and the print's contrast up to which peaks count (``print_contrast_max``) were chosen on this set.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.command import parser_of
from benchmarks.real_images import folder_of
from benchmarks.spoil import CIRCLES
from roemetry.calibrating import observe
from roemetry.config.rig import Rig
from roemetry.io.yaml_source import dump
from roemetry.records import Board, CalibrationSet, Frame
from roemetry.records.arrays import Floats
from roemetry.stages.registry import discover
from roemetry_pinhole.boards import BoardNotFoundError, BoardView, Seen, board_views, find_marks
from roemetry_pinhole.bundle import Adjusted, adjust, chosen
from roemetry_pinhole.geometry import (
    BeltContacts,
    Corners,
    Geometry,
    StripePoints,
    plane_distances,
    unknowns_of,
)
from roemetry_pinhole.initial_intrinsics import InitialCamera, free_numbers, initial_camera
from roemetry_pinhole.stripes import Gathered, gather

AUTHORS_PLANE = np.array([-1.3051671468331907e-01, -6.3959525011364002e00, 1.0])
NOBODY = np.empty(0, np.int64)


def main() -> None:
    """Print what each set gives, or why it is skipped."""
    parser = parser_of(__doc__)
    parser.add_argument("--extractor", default="fir-zero-crossing")
    parser.add_argument("--channel", default="grey")
    parser.add_argument("--contrast", type=float, default=0.85)
    given = parser.parse_args()
    circles, chessboard = folder_of("laser_on_circle_grid"), folder_of("chessboard_mit")
    if circles is not None:
        _boards(circles, given.extractor, given.channel, given.contrast)
    if chessboard is not None:
        _chessboard(chessboard)
    if circles is None or chessboard is None:
        print("a set that is not there was skipped: set ROEMETRY_REAL_DATA")


def _boards(folder: Path, extractor: str, channel: str, contrast: float) -> None:
    observed = _observed(folder, extractor, channel)
    board = observed.board
    if board is None:
        raise AssertionError("the rig file describes a board")
    seen = Seen()
    board_views(observed, seen)
    size = observed.observations[0].frame.size
    first = initial_camera(seen, size, "brown", None, 12)
    gathered = gather(first, (), 1, np.zeros(len(first.views)), {}, print_contrast_max=contrast)
    found = _adjusted(first, gathered.planes, gathered.points)
    off = plane_distances(found.geometry, gathered.points)
    used = found.stripe_used
    print(f"laser_on_circle_grid: {len(first.views)} of 12 boards, left out: {seen.left_out or 'none'}")
    print(f"  corners: reprojection rms {np.sqrt((found.corner_px**2).sum(axis=1).mean()):.4f} px, all")
    print(
        f"  fx, fy {found.geometry.camera[1]:.2f} {found.geometry.camera[0]:.2f} px (author 1144.44 1142.49)"
    )
    print(
        f"  plane: rms {np.sqrt((off**2).mean()):.4f} mm over all {off.size} points that lie on even print, "
        f"{np.sqrt((off[used] ** 2).mean()):.4f} mm over those used"
    )
    stray = 1.0 - (1.0 - gathered.stray_share) * float(used.mean())
    print(f"  left out: {gathered.print_share:.1%} on uneven print, {stray:.1%} of the others as far off")
    print(f"  plane to the author's: {_to_author_deg(found.geometry.planes[0]):.3f}°")
    print(f"  leave one pose out: rms {_left_out(first, gathered):.4f} mm")


def _observed(folder: Path, extractor: str, channel: str) -> CalibrationSet:
    images = {
        shows: [str(path) for pattern in patterns for path in sorted(folder.resolve().glob(pattern))]
        for shows, patterns in CIRCLES["images"].items()
    }
    data = {key: value for key, value in CIRCLES.items() if key != "calibrator"}
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "rig.yaml"
        told = data | {"images": images, "channel": channel, "extractor": extractor}
        path.write_text(dump(told), encoding="utf-8")
        return observe(Rig.load(path), discover())[0]


def _adjusted(first: InitialCamera, planes: Floats, points: StripePoints) -> Adjusted:
    """Adjust camera, poses and planes; there is no belt, and no board lies on one."""
    start = Geometry(first.camera, first.rotation, first.shift, planes, np.full(3, np.nan), np.zeros(3))
    free = unknowns_of(
        start, free_camera=free_numbers("brown"), planes=bool(len(planes)), belt=False, travel=False
    )
    size = [len(view.marks.xy_px) for view in first.views]
    corners = Corners(
        np.repeat(np.arange(len(size)), size),
        np.concatenate([view.marks.board_mm for view in first.views]),
        np.concatenate([view.marks.xy_px for view in first.views]),
        np.zeros(sum(size)),
        np.zeros(sum(size), np.int64),
    )
    return adjust(
        start, free, corners, points, BeltContacts(NOBODY, np.empty((0, 3)), np.empty(0)), contact_std_mm=1.0
    )


def _to_author_deg(plane: Floats) -> float:
    """The images were turned by 90°: the author's x is our −y, and y our x."""
    own = np.array([-plane[1], plane[0], plane[2]]) / np.sqrt(plane @ plane)
    author = AUTHORS_PLANE / np.sqrt(AUTHORS_PLANE @ AUTHORS_PLANE)
    return float(np.degrees(np.arccos(min(abs(own @ author), 1.0))))


def _left_out(first: InitialCamera, gathered: Gathered) -> float:
    """Distance of each pose's points from the plane that the other poses give, camera and poses alike."""
    off, points = [], gathered.points
    for pose in range(len(first.views)):
        found = _adjusted(first, gathered.planes, chosen(points, points.pose != pose))
        off.append(plane_distances(found.geometry, chosen(points, points.pose == pose)))
    return float(np.sqrt((np.concatenate(off) ** 2).mean()))


def _chessboard(folder: Path) -> None:
    board = Board("chessboard", "chessboard", columns=12, rows=9, pitch_mm=25.0)
    seen = Seen()
    size = (0, 0)
    files = sorted(folder.glob("*.png"))
    for path in files:
        frame = Frame(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), role="plain", name=path.name)
        size = frame.size
        try:
            marks = find_marks(frame, board)
        except BoardNotFoundError as error:
            seen.left_out[path.name] = str(error)
            continue
        seen.views.append(BoardView(path.name, marks, None, None, on_belt=False, count=np.nan, board=board))
    first = initial_camera(seen, size, "brown", None, len(files))
    none = np.empty(0)
    nothing = StripePoints(NOBODY, NOBODY, none, none, none, none)
    found = _adjusted(first, np.empty((0, 3)), nothing)
    rms = np.sqrt((found.corner_px**2).sum(axis=1).mean())
    print(f"chessboard_mit: {len(first.views)} of {len(files)} boards, left out: {seen.left_out or 'none'}")
    print(f"  corners: reprojection rms {rms:.4f} px, all corners; fx {found.geometry.camera[0]:.1f} px")
