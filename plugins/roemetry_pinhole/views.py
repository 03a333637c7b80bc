"""Poses of the board: what was seen of it with the laser off and on, and which images cannot be used."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.arrays import Flags, Floats
from roemetry.records import Board, CalibrationSet, Frame, Observation, Peaks
from roemetry_pinhole.marks import Marks, find_marks
from roemetry_pinhole.unseen import UnseenError

_LIT_GREY = 0.06
_UNEVEN_NOISE = 0.02
_LIT_SHARE_MIN = 2e-4
_OTHER_LIGHT_SHARE = 0.25


@dataclass(frozen=True, eq=False, slots=True)
class BoardView:
    """The board in one pose.

    Attributes
    ----------
    name
        Of the image in which its marks were found.
    marks
        Its marks.
    laser
        The image with the laser on, with its peaks; None where there is none that can be used.
    plain
        The image with the laser off, if there is one.
    on_belt
        Whether the board lies on the belt.
    count
        Encoder count; NaN where not known.
    raw_px
        (mark, 2) of circles: their centres of gravity, where those of `marks` have been corrected.
    """

    name: str
    marks: Marks
    laser: Observation | None
    plain: Observation | None
    on_belt: bool
    count: float
    raw_px: Floats | None = None


@dataclass(eq=False, slots=True)
class Seen:
    """All poses that can be used, and by image why others cannot."""

    views: list[BoardView] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def board_views(observed: CalibrationSet, board: Board) -> Seen:
    """Find the board in every pose; in the laser-off image if there is one and it serves."""
    seen = Seen()
    for shows in ("board", "board_on_belt"):
        poses: dict[str, dict[str, Observation]] = {}
        for observation in observed.showing(shows):
            poses.setdefault(observation.pose, {})[observation.frame.role] = observation
        for pose in poses.values():
            plain, laser = pose.get("plain"), pose.get("laser")
            found = _marks([one for one in (plain, laser) if one is not None], board, seen)
            if found is None:
                continue
            frame, marks = found
            if laser is not None and plain is not None:
                fault = _lit(plain, laser)
                if fault:
                    seen.left_out[laser.frame.name] = fault
                    laser = None
            count = plain.frame.encoder_count if plain is not None else np.nan
            seen.views.append(BoardView(frame, marks, laser, plain, shows == "board_on_belt", count))
    _one_layout(seen)
    return seen


def on_board(view: BoardView, board: Board, xy: Floats, rotation: Floats, shift: Floats) -> Floats:
    """Give (ray, 2) where rays through (ray, 2) places at distance 1 meet the board, mm on the board."""
    ray = np.column_stack([xy, np.ones(len(xy))])
    normal = rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ray * ((normal @ shift) / (ray @ normal))[:, None]
    return np.asarray((at - shift) @ rotation[:, :2])


def on_even_print(peaks: Peaks, plain: Frame, contrast_max: float) -> Flags:
    """Say which peaks lie where the print is even over the stripe's width: at its edges stripes seem shifted.

    Judged by the image with the laser off, along the row.
    """
    columns = plain.size[1]
    half = int(np.clip(np.ceil(0.6 * np.nanmedian(peaks.width_px)), 1, 25)) if len(peaks) else 1
    at = np.clip(np.rint(peaks.x_px).astype(np.int64)[:, None] + np.arange(-half, half + 1), 0, columns - 1)
    around = plain.pixels[peaks.row[:, None], at].astype(np.float64)
    low, high = around.min(axis=1), around.max(axis=1)
    return np.asarray((high - low) <= contrast_max * (high + low) + _UNEVEN_NOISE * plain.white)


def _marks(images: list[Observation], board: Board, seen: Seen) -> tuple[str, Marks] | None:
    for image in images:
        try:
            return image.frame.name, find_marks(image.frame, board)
        except UnseenError as error:
            seen.left_out[image.frame.name] = str(error)
    return None


def _lit(plain: Observation, laser: Observation) -> str:
    """Say what is wrong with a pair: the laser is on in neither, or in the one that should be without."""
    step = _LIT_GREY * laser.frame.white
    difference = laser.frame.pixels.astype(np.float32) - plain.frame.pixels
    brighter = float((difference > step).mean())
    darker = float((difference < -step).mean())
    if darker > _OTHER_LIGHT_SHARE:
        return ""  # taken in plain light: the pair cannot be compared
    if darker > 4.0 * brighter and darker > _LIT_SHARE_MIN:
        return (
            f"it is darker than {plain.frame.name}: are the images with the laser on and off exchanged? Name "
            "each where it belongs"
        )
    if brighter < _LIT_SHARE_MIN:
        return (
            f"no stripe is seen beside {plain.frame.name}: is it an image with the laser off? Take the pose "
            "again"
        )
    return ""


def _one_layout(seen: Seen) -> None:
    """Leave out images in which another ChArUco layout fits than in most."""
    layouts = [view.marks.layout for view in seen.views]
    if len(set(layouts)) < 2:
        return
    most = max(set(layouts), key=layouts.count)
    for view in seen.views:
        if view.marks.layout != most:
            seen.left_out[view.name] = f"its layout is the {view.marks.layout} one, that of most is {most}"
    seen.views = [view for view in seen.views if view.marks.layout == most]
