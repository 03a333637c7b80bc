"""Where the line of light ends on the belt, and how much longer it is in the image than at calibration.

A single line on a level belt looks the same from nearer by, but for its length, and areas are measured as
much larger as the square of that. So where both ends are in view, the line is measured. Towards an end its
light fades over a pixel or two, and the uncertainty of its places grows: the end is where that has doubled,
which is near half the light, between rows.

Fails where the line reaches the image's side: then nothing tells, and NaN is given. Most lines of a scan must
show bare belt at both ends. Where the light fades slowly, a dimmer line is a shorter one.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats

_SIDE_ROWS = 2
"""An end so near to the image's side may be cut off by it."""
_LINES = 100
"""Lines that are looked at, or up to twice so many: in 20 scans the ends by every third of 72 to 121 lines
(24 to 40) were within 0.02 rows of those by all of them."""
_DOUBLED, _NOT_SEEN = 2.0, 6.0
"""Times the line's usual uncertainty: at its end, and where light is too faint to be found."""
_END_STD_ROWS = 0.1
"""Standard uncertainty of an end, rows: in the shipped scans ends repeat to 0.04 rows. Other noise than at
calibration moves each by up to 0.3 rows, which counts as a line of another length."""


def line_ends(x_px: Floats, x_std_px: Floats) -> Floats:
    """Give (2,) first and last row of a line, from its places in (line, row) and their uncertainties, px.

    NaN where it reaches the image's side, or no uncertainties are stated.
    """
    rows = x_px.shape[1]
    some = slice(None, None, max(1, len(x_px) // _LINES))
    std_px = np.where(np.isfinite(x_px[some]), x_std_px[some], np.nan)
    std_px = std_px[np.isfinite(std_px).any(axis=1)]
    ends = np.full(2, np.nan)
    if not std_px.size:
        return ends
    std_px /= _medians_of_known(std_px)[:, None]  # noise is judged by lines that were read together
    seen = np.flatnonzero(np.isfinite(std_px).mean(axis=0) >= 0.5)
    times = np.full(rows, _NOT_SEEN)
    times[seen] = np.minimum(_medians_of_known(std_px[:, seen].T), _NOT_SEEN)
    for k, way in enumerate((1, -1)):
        clear = np.flatnonzero(times[::way] < _DOUBLED)
        if clear.size and clear[0] >= _SIDE_ROWS:
            inside, outside = np.log(times[::way][clear[0] - np.arange(2)])
            end = clear[0] - (np.log(_DOUBLED) - inside) / (outside - inside)
            ends[k] = end if way > 0 else rows - 1 - end
    return ends


def _medians_of_known(values: Floats) -> Floats:
    """Give (line,) medians of the values that are known in each line, NaN of none.

    As `numpy.nanmedian` does, in half its time or less, for it takes the lines one by one.
    """
    ordered = np.sort(values, axis=1)  # NaN come last
    known = np.count_nonzero(~np.isnan(values), axis=1)
    middle = np.column_stack([(known - 1) // 2, known // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))


def longer_by(ends: Floats, calibrated: Floats, rows: int) -> tuple[float, float]:
    """Give by which share a line is longer than the calibrated one, and the standard uncertainty of that.

    An end that has left an image of so many rows lies at its side at least; NaN where the calibrated line
    had not both of its ends in view.
    """
    inside = np.where(np.isfinite(ends), ends, [0.0, rows - 1.0])
    length = float(calibrated[1] - calibrated[0])
    return float(inside[1] - inside[0]) / length - 1.0, float(np.sqrt(2.0)) * _END_STD_ROWS / length
