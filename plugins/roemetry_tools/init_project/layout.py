"""From what an engineer knows of product and camera to a rig that can measure it.

Seen from straight above, a point at height H on a plane of light is displaced by

    H · tan · D / (D − H),  tan = the projector's offset over its height,

on a belt that lies D below the camera. A flank that is displaced by a whole stripe spacing looks like its
neighbour's belt; so the projector is placed for 0.7 of a spacing at the greatest height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from roemetry.errors import ConfigurationError

MEASURES = ("volume", "weight", "shape")
"""What may be asked for; weight needs the volume."""

STRIPES_LEAST, STRIPES_CHOSEN_MOST, STRIPES_MOST = 5, 15, 40
"""Fewer leave a volume to its ends; more than 15 cost angle and gain little; 40 is the most that are
labelled."""

_SHARE_OF_SPACING = 0.7
"""Of a spacing that the greatest height displaces a stripe: the rest is for flanks seen a little aside."""
_FAN = 1.1
"""Width of all stripes over the product's length: one stripe stands beside each end."""
_FREE = _SHARE_OF_SPACING * _FAN
_STEEPEST, _GOOD, _FLATTEST = 0.5, 0.12, 0.06
"""Tangents of the laser's angle at the belt: the largest, the least to choose, the least to accept."""

_SPACING_LEAST_PX = 14.0
"""About three widths of a stripe, which is 4 to 5 px wide in focus."""
_TURNED_DEG = 10.0
"""Products are laid down by hand or by a chute, so straight at best."""
_BESIDE_MM = 8.0
"""Bare belt beside the block, for rest lines."""


@dataclass(frozen=True, slots=True)
class Answers:
    """What `roemetry init` asks of the product and the camera.

    The size is that of the largest product: length across the stripes, width along them, height. Without a
    distance of camera and belt it is as near as the product allows; without a number of stripes there are as
    many as leave the projector room beside the camera. `measures` are some of `MEASURES`; with `plain_light`
    a second image is taken, laser off.
    """

    product: str
    size_mm: tuple[float, float, float]
    columns: int = 640
    rows: int = 480
    pixel_um: float = 10.0
    focal_mm: float = 16.0
    distance_mm: float | None = None
    stripes: int | None = None
    measures: tuple[str, ...] = ("volume",)
    density_g_per_cm3: float | None = None
    plain_light: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """A rig that measures the product; lengths in mm, rounded as one would build it.

    `distance` is from camera to belt, `view` what the image shows of the belt, across and along, `spacing`
    that of the stripes on it. 1 mm of height displaces a stripe by `px_per_mm`, the greatest height by
    `spacings` of them. `block` (length, width, height) checks the calibration; the board has 11 × 8 squares
    of side `board_square`.
    """

    stripes: int
    distance: float
    mm_per_px: float
    view: tuple[float, float]
    spacing: float
    line_width: float
    projector_x: float
    projector_z: float
    px_per_mm: float
    spacings: float
    block: tuple[float, float, float]
    board_square: float


def lay_out(answers: Answers) -> Layout:
    """Place camera and projector, or say what cannot be.

    Raises
    ------
    ConfigurationError
        With every fault of the answers, or why no such rig measures the product.
    """
    faults = _faults(answers)
    if faults:
        raise ConfigurationError(faults)
    length, _, height = answers.size_mm
    per_distance = 1e-3 * answers.pixel_um / answers.focal_mm
    distance = _distance(answers, per_distance)
    mm_per_px = distance * per_distance
    view = (answers.columns * mm_per_px, answers.rows * mm_per_px)
    grows = distance / (distance - height)
    stripes = answers.stripes or _chosen(length, height * grows, mm_per_px)
    spacing = _rounded(_FAN * length / (stripes - 1), 0.1)
    if spacing < _SPACING_LEAST_PX * mm_per_px:
        most = int(_FAN * length / (_SPACING_LEAST_PX * mm_per_px)) + 1
        raise ConfigurationError(
            f"--stripes: {stripes} stripes over {length:g} mm would stand {spacing / mm_per_px:.1f} "
            f"px apart in the image; they need {_SPACING_LEAST_PX:g} px to be told apart",
            hint=f"take {max(most, STRIPES_LEAST)} stripes or fewer, or a camera with more pixels",
        )
    tangent = min(_STEEPEST, _SHARE_OF_SPACING * spacing / (height * grows))
    if tangent < _FLATTEST:
        fewer = int(_FREE * length / (height * grows * _FLATTEST)) + 1
        raise ConfigurationError(
            f"--stripes: for no flank of a product {height:g} mm high to be taken for the next stripe, "
            f"{spacing:g} mm away, the projector must stand {tangent * distance:.0f} mm beside a camera "
            f"{distance:g} mm away: too near for both to have room",
            hint=f"take {max(fewer, STRIPES_LEAST)} stripes or fewer",
        )
    high = _rounded(0.96 * distance, 1.0)
    fan = spacing * (stripes - 1)
    block_height = max(_rounded(0.6 * height, 1.0), 2.0)
    return Layout(
        stripes=stripes,
        distance=distance,
        mm_per_px=mm_per_px,
        view=view,
        spacing=spacing,
        line_width=_rounded(min(5.0 * mm_per_px, 0.3 * spacing), 0.05),
        # near the camera a whole millimetre would be a tenth of the displacement
        projector_x=_rounded(tangent * high, 1.0 if tangent * high >= 20.0 else 0.1),
        projector_z=high,
        px_per_mm=tangent / mm_per_px,
        spacings=height * grows * tangent / spacing,
        block=(
            _rounded(fan + block_height * tangent + _BESIDE_MM, 1.0),
            _rounded(0.3 * view[1], 1.0),
            block_height,
        ),
        # its 11 × 8 squares span four fifths of the view: with less the lens stays unproven at the borders
        board_square=max(_rounded(min(view[0] / 13.7, view[1] / 10.3), 0.5), 0.5),
    )


def _chosen(length: float, grown_height: float, mm_per_px: float) -> int:
    """Give the number of stripes that leaves the laser a good angle, and the stripes room in the image."""
    by_angle = _FREE * length / (grown_height * _GOOD)
    by_image = _FAN * length / (_SPACING_LEAST_PX * mm_per_px)
    return min(max(int(min(by_angle, by_image)) + 1, STRIPES_LEAST), STRIPES_CHOSEN_MOST)


def _faults(answers: Answers) -> list[str]:
    found = []
    if not answers.product.strip():
        found.append("--product: the name is empty; say what lies on the belt")
    named = zip(("length", "width", "height"), answers.size_mm, strict=True)
    found += [
        f"--size: the {name} is {value:g} mm; expected more than 0 and at most 2000 mm"
        for name, value in named
        if not 0.0 < value <= 2000.0
    ]
    if answers.stripes is not None and not STRIPES_LEAST <= answers.stripes <= STRIPES_MOST:
        found.append(
            f"--stripes: found {answers.stripes}; expected {STRIPES_LEAST} to {STRIPES_MOST}. A volume from "
            "one picture needs several stripes on each product"
        )
    for flag, value, least, most in (
        ("--image", min(answers.columns, answers.rows), 64, 8192),
        ("--image", max(answers.columns, answers.rows), 64, 8192),
        ("--pixel-um", answers.pixel_um, 0.5, 100),
        ("--focal-mm", answers.focal_mm, 1, 1000),
        ("--distance-mm", 100.0 if answers.distance_mm is None else answers.distance_mm, 10, 20000),
    ):
        if not least <= value <= most:
            found.append(f"{flag}: found {value:g}; expected {least:g} to {most:g}")
    unknown = [name for name in answers.measures if name not in MEASURES]
    if unknown:
        found.append(f"--measure: there is no `{unknown[0]}`; expected some of {', '.join(MEASURES)}")
    density = answers.density_g_per_cm3
    if "weight" in answers.measures and density is None:
        found.append(
            "--density: a weight needs the density, g/cm³: weigh some products and divide by their volumes"
        )
    if density is not None and not 0.0 < density <= 30.0:
        found.append(
            f"--density: found {density:g}; expected g/cm³, more than 0 and at most 30 (water has 1)"
        )
    return found


def _distance(answers: Answers, per_distance: float) -> float:
    """Give the distance, mm; refuse one from which the product, turned a little, is not seen whole."""
    length, width, height = answers.size_mm
    turned = math.radians(_TURNED_DEG)
    across = 1.3 * (length * math.cos(turned) + width * math.sin(turned)) + 0.2 * height + 6.0
    along = 1.3 * (width * math.cos(turned) + length * math.sin(turned)) + 16.0
    needed = height + max(across / answers.columns, along / answers.rows) / per_distance
    if answers.distance_mm is None:
        return 10.0 * math.ceil(0.1 * needed)
    if answers.distance_mm < needed:
        seen = [answers.distance_mm * per_distance * side for side in (answers.columns, answers.rows)]
        raise ConfigurationError(
            f"--distance-mm: from {answers.distance_mm:g} mm the camera sees {seen[0]:.0f} × {seen[1]:.0f} "
            f"mm of the belt; a product of {length:g} × {width:g} × {height:g} mm, turned by up to "
            f"{_TURNED_DEG:g}° and with bare belt around it, needs {across:.0f} × {along:.0f} mm at its top",
            hint=f"go to {10.0 * math.ceil(0.1 * needed):g} mm, or take a shorter lens",
        )
    return answers.distance_mm


def _rounded(value: float, step: float) -> float:
    return round(round(value / step) * step, 6)
