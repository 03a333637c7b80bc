"""What the images of the empty belt and of the block show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError, StageError
from roemetry.records import CalibrationSet, Observation, Peaks
from roemetry_kernels.coding.rest_lines import rest_lines_of_frame
from roemetry_kernels.coding.tracing import trace_fragments

_FULL_ROWS_MIN = 0.5
_DISPLACED_MIN_PX = 4.0
_BLOCK_ROWS_MIN = 20
_TRIM = 0.1
_BATCH_ROWS = 10
_BATCHES_MIN = 6
_BODY_STEP_PX = 7.0
_END_ROWS = 12
_REST_RMS_MAX_PX = 1.5
_EDGE_ROOM_MIN_PX = 0.75
_EDGE_GAP_ROWS = 1
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False, slots=True)
class BlockView:
    """A block in one image.

    Attributes
    ----------
    offset_px, offset_std_px
        (stripe,) displacement on the block's top and its standard uncertainty, px; NaN where not seen.
    scatter_px
        Scatter of single rows about the offsets, px.
    width_px, width_std_px
        Extent of the top along the stripes, square to its edges, and its standard uncertainty, px.
    edge_rms_px
        Scatter of the edges about straight lines, px.
    yaw_rad
        Turn of the block about the vertical.
    span_px
        Extent of the top across the stripes that is seen, px.
    row_px
        (stripe,) mean row of what `offset_px` comes from, from the middle row.
    """

    offset_px: Floats
    offset_std_px: Floats
    scatter_px: float
    width_px: float
    width_std_px: float
    edge_rms_px: float
    yaw_rad: float
    span_px: float
    row_px: Floats


class RestFit(NamedTuple):
    """Rest lines of the bare belt.

    Attributes
    ----------
    lines_px
        (stripe, 2) x in the middle row, px, and slope.
    rms_px
        Rms distance of the peaks from them.
    covariance
        (stripe, 2, 2) of each line.
    """

    lines_px: Floats
    rms_px: float
    covariance: Floats


def rest_polynomials(observed: CalibrationSet) -> RestFit:
    """Fit each stripe's rest line, a straight one.

    From the images of the empty belt; without one, from the belt above and below the block.

    Raises
    ------
    CalibrationError
        Not the expected number of stripes.
    """
    belts = observed.showing("belt")
    if not belts:
        view = observed.showing("block")[0]
        return _from_block_image(view, observed.stripe_count)
    x_px = np.full((observed.stripe_count, 0), np.nan)
    row_px = np.empty(0)
    for view in belts:
        full = _full_rows(view.peaks, observed.stripe_count)
        lit = int((np.diff(view.peaks.row_start) > 0).sum())
        if full.size < _FULL_ROWS_MIN * view.peaks.image_size[0]:
            found = np.bincount(np.diff(view.peaks.row_start)).argmax() if lit else 0
            raise CalibrationError(
                f"{view.frame.name}: {observed.stripe_count} stripes are expected, "
                f"but most rows show {found} (only {full.size} rows show all)",
                hint="check `stripes` in the rig file, the extractor's threshold, turn_deg, "
                "and that every stripe crosses the whole image",
            )
        x_px = np.concatenate([x_px, _in_rows(view.peaks, full, observed.stripe_count)], axis=1)
        row_px = np.concatenate([row_px, full])
    middle = (belts[0].frame.size[0] - 1) / 2.0
    return _fitted(row_px - middle, x_px, belts[0].frame.name)


def view_of_block(view: Observation, rest_px: Floats) -> BlockView:
    """Measure displacements and edges of the block in one image."""
    stripes = rest_px.shape[0]
    peaks = view.peaks
    rows = _full_rows(peaks, stripes)
    middle = (peaks.image_size[0] - 1) / 2.0
    x_px = _in_rows(peaks, rows, stripes)
    offset = x_px - (rest_px[:, :1] + rest_px[:, 1:] * (rows - middle))
    mean, std, first, last, place, scatter, at_row = (np.full(stripes, np.nan) for _ in range(7))
    for stripe in range(stripes):
        run = _longest_run(rows, np.abs(offset[stripe]) > _DISPLACED_MIN_PX)
        if run.size < _BLOCK_ROWS_MIN:
            continue
        trim = int(_TRIM * run.size)
        inner = offset[stripe, run[trim : run.size - trim]]
        typical = np.median(inner)
        inner = inner[np.abs(inner - typical) < _DISPLACED_MIN_PX]
        mean[stripe], std[stripe] = inner.mean(), _std_of_mean(inner)
        scatter[stripe] = inner.std()
        at_row[stripe] = rows[run].mean() - middle
        from_middle = np.arange(peaks.image_size[0]) - middle
        lines = rest_px[:, :1] + rest_px[:, 1:] * from_middle
        edges = _edges(peaks, lines, stripe, mean[stripe], int(rows[run[run.size // 2]]))
        if edges is not None:
            first[stripe], last[stripe] = edges
            place[stripe] = x_px[stripe, run].mean()
    width, width_std, edge_rms, yaw = _width(place, first, last)
    scatter_px = float(np.nanmean(scatter)) if np.isfinite(scatter).any() else np.nan
    span_px = float(np.nanmax(place) - np.nanmin(place)) if np.isfinite(place).any() else np.nan
    return BlockView(mean, std, scatter_px, width, width_std, edge_rms, yaw, span_px, at_row)


def _full_rows(peaks: Peaks, stripes: int) -> Floats:
    """Rows that show exactly as many peaks as there are stripes: there, order is certain."""
    return np.flatnonzero(np.diff(peaks.row_start) == stripes).astype(np.float64)


def _in_rows(peaks: Peaks, rows: Floats, stripes: int) -> Floats:
    """(stripe, row) x of the peaks of full rows, px."""
    first = peaks.row_start[rows.astype(np.int64)]
    return np.asarray(peaks.x_px[first[None, :] + np.arange(stripes)[:, None]])


def _fitted(from_middle: Floats, x_px: Floats, name: str) -> RestFit:
    rest = np.empty((x_px.shape[0], 2))
    covariance = np.empty((x_px.shape[0], 2, 2))
    residual = np.empty_like(x_px)
    for stripe, x in enumerate(x_px):
        keep = np.ones(x.size, np.bool_)
        for _ in range(3):
            slope, start = np.polyfit(from_middle[keep], x[keep], 1)
            off = x - (start + slope * from_middle)
            keep = np.abs(off) <= max(3.0 * float(np.std(off[keep])), 0.5)
        rest[stripe] = start, slope
        residual[stripe] = np.where(keep, off, np.nan)
        covariance[stripe] = _of_line(from_middle[keep], off[keep])
    rms = float(np.sqrt(np.nanmean(residual**2)))
    if rms > _REST_RMS_MAX_PX:
        raise CalibrationError(
            f"{name}: the stripes on the belt are not straight (rms {rms:.2f} px)",
            hint="is the belt flat and empty? a strongly distorting lens needs a full camera calibration",
        )
    return RestFit(rest, rms, covariance)


def _of_line(from_middle: Floats, off: Floats) -> Floats:
    """(2, 2) covariance of a line through rows that are correlated over a few rows: from sums of batches."""
    powers = np.column_stack([np.ones(off.size), from_middle])
    inverse = np.linalg.inv(powers.T @ powers)
    batches = off.size // _BATCH_ROWS
    if batches < _BATCHES_MIN:
        return np.asarray(float(off @ off) / off.size * _BATCH_ROWS * inverse)
    batch = np.minimum(np.arange(off.size) // _BATCH_ROWS, batches - 1)
    sums = np.stack([np.bincount(batch, column * off) for column in powers.T])
    return np.asarray(inverse @ (sums @ sums.T) @ inverse * batches / (batches - 2))


def _from_block_image(view: Observation, stripes: int) -> RestFit:
    peaks = view.peaks
    fragment, fragments = trace_fragments(peaks.row_start, peaks.x_px, _BODY_STEP_PX)
    try:
        lines = rest_lines_of_frame(peaks, fragment, fragments, stripes, _END_ROWS)
    except StageError as error:
        raise CalibrationError(
            f"{view.frame.name}: {error.message}", hint="add an image of the empty belt (images.belt)"
        ) from error
    if lines is None:
        raise AssertionError("rest lines of a known number of stripes are found or refused")
    rows = np.arange(peaks.image_size[0]) - (peaks.image_size[0] - 1) / 2.0
    rest = np.array([np.polyfit(rows, line, 1)[::-1] for line in lines.x_px])
    rms = lines.tolerance_px / 4.0
    # the belt above and below the block: at least the image's ends
    ends = np.concatenate([rows[:_END_ROWS], rows[-_END_ROWS:]])
    covariance = _of_line(ends, np.full(ends.size, rms))
    return RestFit(rest, rms, np.repeat(covariance[None], stripes, axis=0))


def _longest_run(rows: Floats, displaced: np.ndarray) -> np.ndarray:
    """Positions in `rows` of the longest displaced run; gaps of a few rows do not end it."""
    at = np.flatnonzero(displaced)
    if not at.size:
        return at
    pieces = np.split(at, np.flatnonzero(np.diff(rows[at]) > _END_ROWS) + 1)
    return max(pieces, key=len)


def _edges(
    peaks: Peaks, lines: Floats, stripe: int, offset_px: float, inside: int
) -> tuple[float, float] | None:
    """First and last edge of the block's top along one stripe, rows; None where they cannot be told.

    From a row inside, go up and down while the row has a peak where the stripe is expected on the top. At a
    displacement of about a spacing the neighbour's belt line is near that place: then a peak must be
    nearer to the top's place than to any belt line, and if that leaves less than a pixel, nothing is said.
    """
    top = lines[stripe] + offset_px
    room = min(_DISPLACED_MIN_PX, float(np.abs(lines - top).min()) / 2.0)
    if room < _EDGE_ROOM_MIN_PX:
        return None
    ends = []
    for step in (-1, 1):
        row, end, missed = inside, inside, 0
        while 0 <= row < lines.shape[1] and missed <= _EDGE_GAP_ROWS:
            in_row = peaks.x_px[peaks.row_start[row] : peaks.row_start[row + 1]]
            if in_row.size and np.abs(in_row - top[row]).min() <= room:
                end, missed = row, 0
            else:
                missed += 1
            row += step
        ends.append(end + 0.5 * step)
    return ends[0], ends[1]


def _std_of_mean(values: Floats) -> float:
    """Standard uncertainty of a mean of rows that are correlated over a few rows: from batch means."""
    batches = values.size // _BATCH_ROWS
    if batches < 3:
        return float(values.std())
    means = values[: batches * _BATCH_ROWS].reshape(batches, _BATCH_ROWS).mean(axis=1)
    return float(means.std(ddof=1) / np.sqrt(batches))


def _width(place: Floats, first: Floats, last: Floats) -> tuple[float, float, float, float]:
    """Extent square to the edges, its standard uncertainty, the edges' scatter, and the yaw."""
    known = np.isfinite(place)
    if known.sum() < 3:
        return np.nan, np.nan, np.nan, 0.0
    slopes, residuals, starts = [], [], []
    for edge in (first[known], last[known]):
        slope, start = _robust_line(place[known], edge)
        slopes.append(slope)
        starts.append(start)
        residuals.append(edge - (start + slope * place[known]))
    slope = float(np.mean(slopes))
    middle = float(place[known].mean())
    along = starts[1] - starts[0] + (slopes[1] - slopes[0]) * middle
    scatter = _MAD_TO_STD * float(np.median(np.abs(residuals)))
    # each edge is known to a row (rectangular), better by averaging over the stripes' different phases
    std = np.sqrt(2.0 * max(scatter**2, 1.0 / 12.0) / known.sum())
    return along * float(np.cos(np.arctan(slope))), float(std), scatter, -float(np.arctan(slope))


def _robust_line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and intercept by medians (Theil, Sen): a few edges that ran on along a belt line do not count."""
    one, other = np.triu_indices(x.size, 1)
    slope = float(np.median((y[other] - y[one]) / (x[other] - x[one])))
    return slope, float(np.median(y - slope * x))
