"""The page of `roemetry calibrate --doctor`: each image, what was found on it, why it was or was not used."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import ImageFinding
from roemetry.records.arrays import Floats

_WIDTH_PX = 560
"""Of a picture: what a stripe is can still be seen, and sixty fit a page of some megabytes."""
_COLOURS = {"peaks": (60, 60, 235), "points": (70, 200, 60), "marks": (235, 180, 30)}
"""BGR of all peaks, of the points that count, and of marks."""
_DIM = 0.75
"""Of the image's light: dots are to be seen on white paper."""
_TITLES = {
    "belt": "empty belt",
    "board": "board",
    "board_on_belt": "board on the belt",
    "sphere_plate": "sphere plate",
}


def findings_page(findings: Sequence[ImageFinding], name: str, refusal: str) -> str:
    """Write the page as one text that needs nothing else.

    Parameters
    ----------
    findings
        Of all images.
    name
        Of the rig.
    refusal
        Why there is no calibration; "" where there is one.
    """
    from roemetry.html.page import environment_of  # jinja2 takes 50 ms; calibrations do without

    faults = [one for one in findings if one.why]
    return (
        environment_of("roemetry.calibrating")
        .get_template("findings.html.j2")
        .render(
            name=name,
            refusal=refusal,
            images=[
                (one, _title(one), picture_of(one)) for one in [*faults, *(f for f in findings if not f.why)]
            ],
            faults=len(faults),
            version=version("roemetry"),
        )
    )


def _title(one: ImageFinding) -> str:
    seen = one.observation
    light = "laser off" if seen.frame.role == "plain" else "laser on"
    pose = f", pose {seen.pose}" if seen.pose else ""
    return f"{_TITLES.get(seen.shows, seen.shows)}{pose}, {light}"


def picture_of(one: ImageFinding) -> str:
    """Draw the image, smaller, with its peaks, points and marks: a data URI of a JPEG."""
    import cv2

    frame = one.observation.frame
    scale = min(1.0, _WIDTH_PX / frame.size[1])
    light = frame.pixels.astype(np.float32) * (255.0 * _DIM / max(frame.white, 1))
    # dark laser images are brightened: a line that a camera sees is to be seen here
    light *= (
        min(4.0, 200.0 / max(float(np.percentile(light, 99.7)), 1.0))
        if one.observation.peaks.row.size
        else 1.0
    )
    grey = cv2.resize(
        light.clip(0, 255).astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    canvas = np.ascontiguousarray(np.repeat(grey[:, :, None], 3, axis=2))
    peaks = one.observation.peaks
    _dots(canvas, np.column_stack([peaks.x_px, peaks.row]) * scale, _COLOURS["peaks"])
    _dots(canvas, one.points_px * scale, _COLOURS["points"])
    for x, y in np.rint(one.corners_px * scale).astype(int):
        cv2.drawMarker(canvas, (int(x), int(y)), _COLOURS["marks"], cv2.MARKER_CROSS, 7, 1)
    coded: NDArray[Any] = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 82])[1]
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode("ascii")


def _dots(canvas: NDArray[np.uint8], xy_px: Floats, colour: tuple[int, int, int]) -> None:
    at = np.rint(xy_px).astype(np.int64)
    inside = ((at >= 0) & (at < np.array(canvas.shape[1::-1]))).all(axis=1)
    canvas[at[inside, 1], at[inside, 0]] = colour
