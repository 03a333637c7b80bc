"""What every extractor keeps: centres where the light is, whatever its brightness."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from roemetry.errors import DataError, RoemetryError
from roemetry.records import SATURATED, Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.stages import Extractor
from roemetry.testing.scenes import LinearRig, frame_of, in_steps
from roemetry.testing.verdict import difference, refused, require, within

_NEAR_PX = 5.0  # of a true centre: a peak farther off is not that stripe's
_EXACT_PX = 1e-6  # rounding
_ROWS_LEFT_OUT = 2
"""At the image's top and bottom an extractor need not look."""
_SHIFT_PX = 3  # whole pixels, so that the image itself is the same
_BRIGHTER = 1.3  # times: still below white


def check_centres_are_right(extractor: Extractor[Any]) -> None:
    """Every centre of a noise-free stripe is found within the declared `tolerance_px`."""
    rig = LinearRig()
    x_px = rig.x_px(rig.dome())
    error_px = _errors_px(extractor.extract(frame_of(rig.light(x_px))), x_px)
    _all_found(error_px, extractor.capabilities.tolerance_px)


def check_centres_are_not_biased(extractor: Extractor[Any]) -> None:
    """Over all sub-pixel phases the errors' mean is within a third of the declared `tolerance_px`."""
    rig = LinearRig()
    x_px = rig.x_px(rig.dome())
    peaks = extractor.extract(frame_of(rig.light(x_px)))
    bias_px = float(np.nanmean(_signed_errors_px(peaks, x_px)))
    limit = extractor.capabilities.tolerance_px / 3.0
    require(abs(bias_px) <= limit, f"the mean error is {bias_px:+.3g} px, expected within ±{limit:.3g} px")


def check_one_stripe_gives_one_peak(extractor: Extractor[Any]) -> None:
    """A noise-free stripe gives one peak per row, and there is none between stripes."""
    rig = LinearRig()
    peaks = extractor.extract(frame_of(rig.light(rig.x_px(rig.belt()))))
    inner = np.diff(peaks.row_start)[_ROWS_LEFT_OUT:-_ROWS_LEFT_OUT]
    other = np.flatnonzero(inner != rig.stripes)
    require(
        not other.size,
        f"{other.size} of {inner.size} rows with {rig.stripes} stripes show another number of peaks, "
        f"{int(inner.min())} to {int(inner.max())}",
    )


def check_a_shifted_image_shifts_the_peaks(extractor: Extractor[Any]) -> None:
    """An image shifted by 3 columns gives the same peaks, shifted by 3 px."""
    rig = LinearRig()
    pixels = frame_of(rig.light(rig.x_px(rig.dome()))).pixels
    here = extractor.extract(Frame(pixels))
    there = extractor.extract(Frame(np.roll(pixels, _SHIFT_PX, axis=1)))
    _same_peaks(here, there, _SHIFT_PX)


def check_brightness_does_not_matter(extractor: Extractor[Any]) -> None:
    """An image 1.3 times as bright, nowhere saturated, gives the same peaks at the same places."""
    rig = LinearRig()
    dim_to_bright = np.linspace(60.0, 180.0, rig.stripes)
    light = in_steps(rig.light(rig.x_px(rig.dome()), dim_to_bright), 10)
    _same_peaks(extractor.extract(frame_of(light)), extractor.extract(frame_of(light * _BRIGHTER)))


def check_bit_depth_does_not_matter(extractor: Extractor[Any]) -> None:
    """The same image in 8, 12 and 16 bit gives the same peaks."""
    rig = LinearRig()
    light = in_steps(rig.light(rig.x_px(rig.dome())), 17)
    in_8_bit = extractor.extract(frame_of(light))
    for bits in (12, 16):
        _same_peaks(in_8_bit, extractor.extract(frame_of(light, bit_depth=bits)), what=f"in {bits} bit ")


def check_dark_rows_give_nothing(extractor: Extractor[Any]) -> None:
    """Rows without light give no peak, with the sensor's noise on them."""
    rig = LinearRig()
    x_px = rig.x_px(rig.belt())
    dark = slice(80, 120)
    x_px[:, dark] = np.nan
    peaks = extractor.extract(frame_of(rig.light(x_px), noise=2.0))
    found = int(peaks.row_start[dark.stop] - peaks.row_start[dark.start])
    require(found == 0, f"{found} peaks on {dark.stop - dark.start} rows without light")


def check_dark_gives_nothing(extractor: Extractor[Any]) -> None:
    """An image without light gives no peak of any family, with the sensor's noise on it."""
    found = _count(extractor.extract(frame_of(np.full((200, 320), 10.0), noise=2.0)))
    require(found == 0, f"{found} peaks in the dark")


def check_saturated_stripes_are_found(extractor: Extractor[Any]) -> None:
    """A saturated stripe is found on every row, within the declared `saturated_tolerance_px`."""
    rig = LinearRig()
    x_px = rig.x_px(rig.belt())
    error_px = _errors_px(extractor.extract(frame_of(rig.light(x_px, 1200.0))), x_px)
    _all_found(error_px, extractor.capabilities.saturated_tolerance_px)


def check_saturated_peaks_are_flagged(extractor: Extractor[Any]) -> None:
    """A peak at the white level carries the flag `SATURATED`; one far below it does not."""
    rig = LinearRig()
    amplitude = np.where(np.arange(rig.stripes) == 3, 1200.0, 160.0)
    x_px = rig.x_px(rig.belt())
    peaks = extractor.extract(frame_of(rig.light(x_px, amplitude)))
    white = np.abs(peaks.x_px - x_px[3, peaks.row]) < _NEAR_PX
    flagged = (peaks.flags & SATURATED) > 0
    require(bool(flagged[white].all()), f"{int((~flagged[white]).sum())} saturated peaks are not flagged")
    require(
        not flagged[~white].any(), f"{int(flagged[~white].sum())} peaks are flagged that are not saturated"
    )


def check_two_near_stripes_stay_two(extractor: Extractor[Any]) -> None:
    """Two stripes 12 px apart give two peaks, each within the declared `tolerance_px`."""
    rig = LinearRig(stripes=2, first_px=150.0, spacing_px=12.0)
    x_px = rig.x_px(rig.belt())
    error_px = _errors_px(extractor.extract(frame_of(rig.light(x_px))), x_px)
    _all_found(error_px, extractor.capabilities.tolerance_px)


def check_memory_layout_does_not_matter(extractor: Extractor[Any]) -> None:
    """Pixels that are not contiguous, or stored column by column, give the same peaks."""
    rig = LinearRig()
    pixels = frame_of(rig.light(rig.x_px(rig.dome()))).pixels
    wide = np.zeros((rig.rows, 2 * rig.columns), pixels.dtype)
    wide[:, ::2] = pixels
    usual = extractor.extract(Frame(pixels.copy()))
    for name, other in (("every second pixel", wide[:, ::2]), ("by column", np.asfortranarray(pixels))):
        found = difference(usual, extractor.extract(Frame(other)))
        require(found is None, f"stored {name}: {found}")


def check_uncertainty_is_positive_or_not_stated(extractor: Extractor[Any]) -> None:
    """Each `x_std_px` is positive, or NaN where it is not modelled; no amplitude is negative."""
    rig = LinearRig()
    peaks = extractor.extract(frame_of(rig.light(rig.x_px(rig.dome())), noise=2.0))
    stated = peaks.x_std_px[~np.isnan(peaks.x_std_px)]
    require(bool((stated > 0.0).all()), "x_std_px is zero or negative")
    require(not (peaks.amplitude < 0.0).any(), "an amplitude is negative")


def check_a_colour_frame_is_refused(extractor: Extractor[Any]) -> None:
    """A frame with colours is refused by a `DataError`: an extractor takes one channel."""
    with refused("a frame of three channels", DataError):
        extractor.extract(Frame(np.zeros((20, 30, 3), np.uint8)))


def check_steps_are_counted_right(extractor: Extractor[Any]) -> None:
    """If an extractor counts grey-level steps for the core, its counts equal those of plain numpy."""
    rig = LinearRig()
    pixels = frame_of(rig.light(rig.x_px(rig.dome())), noise=2.0).pixels
    light, least = pixels.astype(np.int64), 20
    found = extractor.count_steps(pixels, least)
    if found is None:
        return
    step = np.abs(np.diff(light, axis=1))
    far, near = np.abs(light[:, 3:] - light[:, :-3]), step[:, 1:-1]
    wanted = (
        (np.abs(np.diff(light, axis=0)) > least).sum(axis=1),
        (step > least).sum(axis=0),
        ((near > least) & (np.maximum(far - near, 0) <= near // 2)).sum(axis=0),
    )
    by_row, by_column, breaks = found
    for what, counted, right in zip(
        ("between rows", "between columns", "that break off"),
        (by_row, by_column, breaks[1:-1]),
        wanted,
        strict=True,
    ):
        require(np.array_equal(counted, right), f"steps {what} are counted wrong")


def check_differing_lines_are_told_for_certain(extractor: Extractor[Any]) -> None:
    """If an extractor says that all lines differ, no row or column repeats another or is of one level."""
    rng = np.random.default_rng(1)
    for bits, axis, what in product((8, 16), (0, 1), ("repeats another", "is of one level")):
        pixels = rng.integers(0, 2**bits, (400, 320), np.dtype(f"u{bits // 8}"))
        lines = pixels if axis == 0 else pixels.T
        lines[250] = lines[31] if what == "repeats another" else 7
        kind = ("row", "column")[axis]
        require(not extractor.lines_differ(pixels), f"a {kind} {what}, and all lines are said to differ")


def check_the_smallest_frames_are_taken(extractor: Extractor[Any]) -> None:
    """A frame of one pixel, row or column gives no peak; of lines alone it may be a `RoemetryError`."""
    for shape in ((1, 1), (1, 40), (40, 1), (2, 2), (3, 3)):
        frame = Frame(np.full(shape, 200, np.uint8))
        try:
            peaks = extractor.extract(frame)
        except RoemetryError:
            if extractor.capabilities.pattern != "lines":
                raise
            continue
        found = _count(peaks)
        require(found == 0, f"{found} peaks in an even frame of {shape[0]} × {shape[1]} pixels")


def _count(peaks: Peaks) -> int:
    return len(peaks) + (0 if peaks.across is None else len(peaks.across))


def _all_found(error_px: Floats, limit_px: float) -> None:
    """Require that every centre is found, within what is declared."""
    missing = int(np.isnan(error_px).sum())
    require(not missing, f"{missing} of {error_px.size} are not found")
    within(error_px, limit_px, "errors")


def _errors_px(peaks: Peaks, x_px: Floats) -> Floats:
    return np.abs(_signed_errors_px(peaks, x_px))


def _signed_errors_px(peaks: Peaks, x_px: Floats) -> Floats:
    """(stripe, inner row) distance of the nearest peak from each true centre, px; NaN where none is near."""
    rows = np.arange(_ROWS_LEFT_OUT, x_px.shape[1] - _ROWS_LEFT_OUT)
    error = np.full((x_px.shape[0], rows.size), np.nan)
    for column, row in enumerate(rows):
        found = peaks.x_px[peaks.row_start[row] : peaks.row_start[row + 1]]
        if found.size:
            off = found[None, :] - x_px[:, row, None]
            error[:, column] = np.take_along_axis(off, np.abs(off).argmin(axis=1)[:, None], axis=1)[:, 0]
    error[np.abs(error) > _NEAR_PX] = np.nan
    return error


def _same_peaks(one: Peaks, other: Peaks, shift_px: float = 0.0, what: str = "") -> None:
    require(len(one) > 0, "no peak at all")
    require(len(one) == len(other), f"{what}{len(one)} peaks, then {len(other)}")
    require(np.array_equal(one.row, other.row), f"{what}peaks are on other rows")
    moved = np.abs(other.x_px - one.x_px - shift_px)
    require(
        moved.max() <= _EXACT_PX,
        f"{what}{int((moved > _EXACT_PX).sum())} peaks move, by up to {moved.max():.3g} px",
    )
