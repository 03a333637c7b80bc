"""Pictures of what a calibration rests on: corners and stripes on each image, and the boards in space."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from roemetry.html.plots import dots, image, path, text, view
from roemetry.records import Frame, TargetView
from roemetry.records.calibration import Calibration

_VIEWS_MAX = 40
"""Images shown: with more a page would pass 3 MB."""
_SIDE_PX, _QUALITY = 560, 70
_PEAKS_MAX = 500
"""Peaks drawn of one image: with more neighbours cover each other."""
_COLOURS = ("#56b4e9", "#f0e442", "#2fb592", "#e78ac3", "#ffb14a", "#c9a0ff")
_GAMMA = 0.6
"""Exponent by which pictures are lifted: what the laser does not light is nearly black."""


class Picture(NamedTuple):
    """An image with what was found in it, and that in words."""

    name: str
    drawing: Markup
    words: str


def target_pictures(views: Sequence[TargetView]) -> list[Picture]:
    """Draw corners as circles (crosses where they were left out) and stripe peaks as dots over each image."""
    return [Picture(one.name, _drawn(one), _words(one)) for one in views[:_VIEWS_MAX]]


def _drawn(one: TargetView) -> Markup:
    rows, columns = one.frame.size
    whole = (-0.5, -0.5, float(columns), float(rows))
    body = [image(_uri(one.frame), whole)]
    step = max(1, -(-len(one.stripe) // _PEAKS_MAX))
    for stripe in np.unique(one.stripe):
        x, y = one.peaks_px[one.stripe == stripe][::step].T
        body.append(path("peak", dots(x, y), stroke=_COLOURS[int(stripe) % len(_COLOURS)]))
    for kind, chosen in (("corner", one.used), ("corner out", ~one.used)):
        x, y = one.corners_px[chosen].T
        body.append(path(kind, dots(x, y)))
    return view(body, whole, f"{one.name}: {_words(one)}", "target")


def _words(one: TargetView) -> str:
    out = int((~one.used).sum())
    said = [f"{len(one.used)} corners" + (f", {out} left out" if out else "")] if len(one.used) else []
    stripes = np.unique(one.stripe[one.stripe >= 0]).size
    of = f" of {stripes} stripes" if stripes else ""
    said += [f"{len(one.stripe)} stripe peaks{of}"] if len(one.stripe) else []
    return "; ".join(said) or "nothing used"


def _uri(frame: Frame) -> str:
    import cv2

    pixels, scale = frame.pixels, min(1.0, _SIDE_PX / max(frame.size))
    rows, columns = (max(1, round(scale * side)) for side in frame.size)
    small = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
    top = max(float(np.percentile(small, 99.5)), 1.0)
    lifted = (255.0 * np.clip(small / top, 0.0, 1.0) ** _GAMMA).astype(np.uint8)
    coded = cv2.imencode(".jpg", lifted, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode()


_WIDTH, _HEIGHT = 620.0, 400.0  # of the picture, in the page's units
_YAW_DEG, _RISE_DEG = -30.0, 25.0  # from where the target is looked at: three faces show


class Space(NamedTuple):
    """The boards over the belt: a drawing, and its shapes as JSON for the script that turns it."""

    drawing: Markup
    shapes: str


def boards_in_space(views: Sequence[TargetView], calibration: Calibration) -> Space | None:
    """Draw belt, boards and camera, seen from the front and above; None where no board's place is known."""
    boards = [(str(n + 1), one.border_mm) for n, one in enumerate(views) if len(one.border_mm) == 4]
    if not boards or calibration.view is None:
        return None
    every = np.concatenate([border for _, border in boards])
    low, high = every.min(axis=0), every.max(axis=0)
    (x0, y0), (x1, y1) = low[:2] - 20.0, high[:2] + 20.0
    belt = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, high[2] / 2])
    reach = float(np.hypot(x1 - x0, y1 - y0))
    # The camera is far above: a line towards it, as long as the scene is wide.
    towards = calibration.view.T_belt_camera[:3, 3] - centre
    towards *= 0.45 * reach / float(np.hypot.reduce(towards))
    shapes = [("belt", "", belt), *(("board", name, border) for name, border in boards)]
    shapes.append(("axis", "camera", np.array([centre, centre + towards])))
    scale = min(_WIDTH / reach, _HEIGHT / (0.5 * reach + float(high[2]) + 0.3 * reach))
    yaw, rise = math.radians(_YAW_DEG), math.radians(_RISE_DEG)
    right = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    up = np.array([-math.sin(yaw) * math.sin(rise), math.cos(yaw) * math.sin(rise), math.cos(rise)])
    body = []
    for kind, name, corners in shapes:
        place = np.column_stack([(corners - centre) @ right, -((corners - centre) @ up)]) * scale
        place += (_WIDTH / 2, _HEIGHT / 2)
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in place.tolist())
        body.append(path(f"space-{kind}", data + ("Z" if len(corners) > 2 else "")))
        if name:
            x, y = place[0 if len(corners) > 2 else -1].tolist()
            body.append(text(x, y + 4, name, "space-word"))
    told = {
        "scale": scale,
        "shapes": [np.round(corners - centre, 2).tolist() for _, _, corners in shapes],
        "named": [bool(name) for _, name, _ in shapes],
    }
    label = f"{len(boards)} boards over the belt, seen from the front and above"
    drawing = view(body, (0.0, 0.0, _WIDTH, _HEIGHT), label, "space")
    return Space(drawing, json.dumps(told, separators=(",", ":")))
