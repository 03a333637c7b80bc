"""From an acquisition to the frame the extractor sees: one channel, dark light off, turned.

Contrast. Of a colour image, the laser's own channel g shows lamp light, too. The other channels show that
light without the laser: away from the stripes g = r, with r = Σ cₖ oₖ + c₀ of the other channels o. The c are
least squares over pixels of the image; those much brighter than the fit, the stripes, are left out, again and
again. The contrast is

    white · (g − r) / (white − r),    0 where r exceeds g, white where g is white.

The denominator keeps clipped light clipped. Where the laser's channel is clipped (JPEG leaves ripples: from
0.98 white on) and the others are nearly white, too, nothing is left to compare: an overexposed stripe's core
looks like a lamp. The pixels beside decide: such light gets the smaller of the shares that contrast has of
the light at both ends of it along the row, since a stripe's core has the laser's colour on both sides.

Where a stripe's halo clips the laser's channel as well, its core is not seen there, and the middle of what is
clipped moves with the print below: on black the halo is no longer clipped, on white it is. The other channels
go on. Their filters pass a little of the laser, so they show the core alone, as a shorter exposure would. A
clipped pixel's excess is by how much they rise above the brightest light near it that is not clipped, over
what is left to white, so that print is not taken for it; where a tenth of the rows or more show such cores,
it is put on top of white, as the frame's headroom, which is as much as white again. What is not clipped keeps
its grey levels; from white on light was clipped in the laser's channel, and such peaks are `SATURATED`.

Assumed: the stripes fill less than half of the image, and light beside the laser is of one colour, whatever
it falls on; what is of another colour (a green mark, for a green laser) keeps its own contrast.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import DataError
from roemetry.records import Acquisition, Frame, Sensor
from roemetry.run.transport_faults import LineTeller, check_lines, check_repeats, not_told

_BLUE_GREEN_RED = {"blue": 0, "green": 1, "red": 2}
_LUMA = np.array([0.114, 0.587, 0.299])  # ITU-R BT.601, in the order blue, green, red


def prepare(
    acquisition: Acquisition,
    *,
    channel: str = "grey",
    contrast: str = "none",
    turn_deg: int,
    subtract: str,
    bit_depth: int | None = None,
    sensor: Sensor | None = None,
    second_channel: str | None = None,
    lines_differ: LineTeller = not_told,
) -> Frame:
    """Make the laser frame ready; DataError where a frame is missing, sizes differ, or bits are in doubt.

    Parameters
    ----------
    channel
        ``grey``, ``red``, ``green``, ``blue`` or ``max``: what to make of a colour image.
    contrast
        ``red``, ``green`` or ``blue``: instead of a channel, that one less what the others tell of it.
    turn_deg
        Counter-clockwise turn: a rotation, never a transpose, which would mirror the scene.
    subtract
        ``dark`` takes the laser-off partner away, grey level by grey level, cut off at 0; or ``none``.
    bit_depth, sensor
        Bits in use, and the camera's noise; None leaves what the source said.
    second_channel
        That of a second family of light, as `channel`; None: there is one family.
    lines_differ
        `roemetry.stages.Extractor.lines_differ` of the extractor that will see the frame, which saves time.
    """
    laser = acquisition.frame("laser")
    if laser is None:
        raise DataError(f"{acquisition.id}: there is no laser image")
    if bit_depth is None and laser.bit_depth == 16:
        _check_bits_in_use(laser)
    bits = laser.bit_depth if bit_depth is None else bit_depth
    check_lines(laser, lines_differ)
    if acquisition.before is not None:
        check_repeats(laser, acquisition.before)
    found = _ready(acquisition, laser, channel, contrast, turn_deg, subtract, bits, sensor)
    if second_channel is None:
        return found
    if laser.pixels.ndim == 2:
        raise DataError(
            f"{acquisition.id}: the laser image has no colours, of which `second_channel` is one",
            hint="give a colour image, or leave second_channel out",
        )
    second = _ready(acquisition, laser, second_channel, "none", turn_deg, subtract, bits, sensor)
    return replace(found, second=second.pixels)


def _ready(
    acquisition: Acquisition, laser: Frame, channel: str, contrast: str, turn_deg: int, subtract: str,
    bits: int, sensor: Sensor | None,
) -> Frame:  # fmt: skip
    """Give a channel of the laser frame, turned and without what the dark one shows; see `prepare`."""
    pixels, headroom = _one_channel(laser, channel, contrast, turn_deg, bits)
    if subtract == "dark":
        dark = acquisition.frame("dark")
        if dark is None:
            raise DataError(
                f"{acquisition.id}: there is no dark image to subtract",
                hint="name the dark images in source.options.dark, or set source.subtract to none",
            )
        off, _ = _one_channel(dark, channel, contrast, turn_deg, bits)
        if off.shape != pixels.shape or off.dtype != pixels.dtype:
            raise DataError(
                f"{acquisition.id}: the dark image is {off.shape} {off.dtype}, "
                f"the laser image {pixels.shape} {pixels.dtype}"
            )
        pixels = np.where(pixels > off, pixels - off, 0).astype(pixels.dtype)
    return replace(
        laser,
        pixels=pixels,
        headroom=headroom,
        turn_deg=(laser.turn_deg + turn_deg) % 360,
        bit_depth=bits,
        sensor=laser.sensor if sensor is None else sensor,
    )


def prepare_plain(acquisition: Acquisition, *, turn_deg: int) -> Frame | None:
    """Turn the plain-light image like the laser frame; its colours stay. None where there is none."""
    plain = acquisition.frame("plain")
    if plain is None:
        return None
    return replace(plain, pixels=_turned(plain.pixels, turn_deg), turn_deg=(plain.turn_deg + turn_deg) % 360)


_USUAL_BITS = (10, 12, 14)  # of sensors that write 16-bit files


def _check_bits_in_use(laser: Frame) -> None:
    """Refuse a 16-bit image that ends where a camera of fewer bits does: its white level is not known."""
    top = int(laser.pixels.max())
    clipped = next((bits for bits in _USUAL_BITS if top == 2**bits - 1), None)
    if clipped is None and not 0 < top < 2**12 - 1:
        return
    bits = clipped or next(bits for bits in _USUAL_BITS if top < 2**bits)
    raise DataError(
        f"{laser.name}: a 16-bit image whose brightest pixel is {top}: does the camera give {bits} bits?",
        hint=f"state `source.bit_depth: {bits}`, or 16 if all 16 bits are in use",
    )


def _turned(pixels: NDArray[Any], turn_deg: int) -> NDArray[Any]:
    return np.ascontiguousarray(np.rot90(pixels, turn_deg // 90) if turn_deg else pixels)


def _one_channel(
    frame: Frame, channel: str, contrast: str, turn_deg: int, bits: int
) -> tuple[NDArray[Any], int]:
    """Give one channel, and its headroom above white."""
    pixels = frame.pixels if turn_deg == 0 else np.rot90(frame.pixels, turn_deg // 90)
    if pixels.ndim == 3 and contrast != "none":
        return _contrast(pixels, _BLUE_GREEN_RED[contrast], 2**bits - 1, laser=frame.role == "laser")
    if pixels.ndim == 3 and channel == "max":
        pixels = pixels.max(axis=2)
    elif pixels.ndim == 3 and channel == "grey":
        pixels = np.rint(pixels @ _LUMA).astype(pixels.dtype)
    elif pixels.ndim == 3:
        pixels = pixels[:, :, _BLUE_GREEN_RED[channel]]
    return np.ascontiguousarray(pixels), 0


_SAMPLE = 20_000  # pixels that the others' share is fitted to: good to a grey level
_FITS = 6  # each without what the one before showed to be stripes; the share rests after four
_STRIPES = 2.0
"""Robust standard deviations above the fit from which on a pixel is a stripe's; costs 2 % of others."""
_CLIPPED = 0.98  # of white, from which on the laser's channel counts as clipped
_ALL_WHITE = 0.9  # of white: other channels so bright tell nothing of a clipped pixel
_NEAR_RUN_PX = 9  # the largest share of contrast so near to the end of clipped light is its share
_DARK = 0.25  # of white: the colour of darker pixels tells nothing of clipped light beside
_HEADROOM = 1.0
"""Of white, on top of it for what the other channels show beyond clipped light: half of a core's height, at
which extractors measure its width, is then above its halo. From a half on lines on print are found alike."""
_CORES_QUANTILE = 0.9  # cores in a tenth of all rows are a line's: a spot of glare is none
_ROOM_MIN = 0.2  # of white, in the sum of two channels: less is not told from noise and JPEG's ripples
_NEAR_PX = 41  # in which the brightest light is looked for: the widest line that extractors take by default


def _contrast(pixels: NDArray[Any], own: int, white: int, *, laser: bool) -> tuple[NDArray[Any], int]:
    """(row, column) the laser's light in its own channel, and its headroom; see the module's text.

    Cores are looked for with the `laser` on. Pixels of 8 bits become 16 whether there are any or not: one
    kind for all images of a run.
    """
    others = [k for k in range(3) if k != own]
    some = pixels.reshape(-1, pixels.shape[2])[:: max(1, pixels.shape[0] * pixels.shape[1] // _SAMPLE)]
    some = some[some[:, own] < white].astype(np.float64)
    design, wanted = np.column_stack([some[:, others], np.ones(len(some))]), some[:, own]
    share, used = np.zeros(3), np.ones(len(some), np.bool_)
    for _ in range(_FITS):
        share = np.linalg.lstsq(design[used], wanted[used], rcond=None)[0]
        over = wanted - design @ share
        used = over <= _STRIPES * 1.4826 * max(float(np.median(np.abs(over))), 0.5)
    light = pixels[:, :, own].astype(np.float32)
    rest = np.clip(
        pixels[:, :, others] @ share[:2].astype(np.float32) + np.float32(share[2]), 0.0, white - 1.0
    )
    out = np.maximum(light - rest, 0.0) * (white / (white - rest))
    clipped = light >= _CLIPPED * white
    out[clipped] = white
    lamp_or_core = (rest >= _ALL_WHITE * white) | (pixels[:, :, others].min(axis=2) >= _ALL_WHITE * white)
    _decide_by_ends(out, light, clipped & lamp_or_core, white)
    kind = np.uint16 if pixels.dtype == np.uint8 else pixels.dtype
    headroom = 0
    if laser and (1.0 + _HEADROOM) * white <= np.iinfo(kind).max:
        headroom = _raise_cores(out, pixels[:, :, others], white)
    return np.ascontiguousarray(np.rint(out).astype(kind)), headroom


def _raise_cores(contrast: NDArray[np.float32], others: NDArray[Any], white: int) -> int:
    """Put on top of clipped light what the other channels tell of cores in it; give the headroom."""
    rows = np.flatnonzero((contrast >= white).any(axis=1))
    if not rows.size:
        return 0
    import cv2

    clipped = contrast[rows] >= white
    light = others[rows].sum(axis=2, dtype=np.float32)
    nearby = cv2.dilate(np.where(clipped, 0.0, light), np.ones((1, _NEAR_PX), np.uint8))
    room = np.maximum(2.0 * white - nearby, _ROOM_MIN * white)
    excess = np.where(clipped, np.clip((light - nearby) / room, 0.0, 1.0), 0.0)
    most = np.zeros(contrast.shape[0])
    most[rows] = excess.max(axis=1)
    cores = float(np.quantile(most, _CORES_QUANTILE))
    share = min(max(4.0 * cores - 1.0, 0.0), 1.0)  # from a quarter on, wholly from a half on
    headroom = round(_HEADROOM * share / (2.0 - share) * white)
    contrast[rows] += headroom * excess
    return headroom


def _decide_by_ends(
    contrast: NDArray[np.float32], light: NDArray[np.float32], unknown: NDArray[np.bool_], white: float
) -> None:
    """Put into each run of unknown pixels of a row white times the smaller share of contrast at its two ends.

    A share, since print at an end may be dark: contrast there is low, but all light has the laser's colour.
    """
    rows = np.flatnonzero(unknown.any(axis=1))
    if not rows.size:
        return
    import cv2

    known = ~unknown[rows]
    some = np.where(
        known & (light[rows] >= _DARK * white), contrast[rows] / np.maximum(light[rows], 1.0), 0.0
    )
    nearby = cv2.dilate(some.astype(np.float32), np.ones((1, _NEAR_RUN_PX), np.uint8))
    columns = np.arange(some.shape[1])
    before = np.maximum.accumulate(np.where(known, columns, 0), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, columns[-1])[:, ::-1], axis=1)[:, ::-1]
    ends = [np.take_along_axis(nearby, end, axis=1) for end in (before, after)]
    contrast[rows] = np.where(known, contrast[rows], white * np.minimum(np.minimum(*ends), 1.0))
