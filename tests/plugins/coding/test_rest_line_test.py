"""Belt stays on its rest line; a body along it by chance lies slightly beside it."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.pieces import on_rest_line
from roemetry_coding.planes.vetoes import on_end

ROWS = 300
OUTER = 30
TOLERANCE_PX = 1.0
BODY = slice(100, 160)


def lines(beside_px: float, rng: np.random.Generator, *, moved_px: float = 0.0, noise_px: float = 0.25):
    """Give (row, stripe) rest lines found on the second of three lines, a body on it in `BODY`."""
    rest_px = np.array([50.0, 100.0, 150.0])[:, None] + np.zeros(ROWS)
    x_px = rest_px.T + moved_px + rng.normal(0.0, noise_px, (ROWS, 3))
    x_px[BODY, 1] += beside_px
    row, line = np.repeat(np.arange(ROWS), 3), np.tile(np.arange(3), ROWS)
    alone = np.where(np.abs(x_px.ravel() - rest_px[line, row]) <= TOLERANCE_PX, line, -1)
    found = on_rest_line(row, x_px.ravel(), line, alone, rest_px, TOLERANCE_PX, moved_px, OUTER)
    return alone.reshape(ROWS, 3), found.reshape(ROWS, 3)


@pytest.mark.parametrize("beside_px", [0.5, -0.6, 0.9])
def test_a_body_beside_the_line_within_the_tolerance_is_no_belt(
    beside_px: float, rng: np.random.Generator
) -> None:
    alone, found = lines(beside_px, rng)
    inner = slice(BODY.start + 8, BODY.stop - 8)  # nearer to its ends the mean holds belt, too
    assert (alone[inner, 1] >= 0).mean() > 0.5
    assert (found[inner, 1] == -1).mean() > 0.95
    assert (found[:, [0, 2]] == [0, 2]).mean() > 0.99
    outside = np.r_[0 : BODY.start, BODY.stop : ROWS]
    assert (found[outside, 1] == 1).mean() > 0.98


@pytest.mark.parametrize("moved_px", [0.0, 0.4, -0.7])
def test_what_lies_on_the_line_stays_on_it_also_where_all_has_moved(
    moved_px: float, rng: np.random.Generator
) -> None:
    """Exactly on it nothing tells a body from belt; the image's outer rows tell by how much it moved."""
    alone, found = lines(0.0, rng, moved_px=moved_px, noise_px=0.1 if moved_px else 0.25)
    np.testing.assert_array_equal(found, alone)


def test_uneven_belt_is_belt(rng: np.random.Generator) -> None:
    """Where the outer rows scatter in the mean, too, as much is allowed amid the image."""
    waves_px = 0.45 * np.sin(np.arange(ROWS) / 8.0)
    rest_px = np.full((1, ROWS), 100.0)
    x_px = 100.0 + waves_px + rng.normal(0.0, 0.05, ROWS)
    row, line = np.arange(ROWS), np.zeros(ROWS, np.int64)
    found = on_rest_line(row, x_px, line, line, rest_px, TOLERANCE_PX, 0.0, OUTER)
    assert (found == 0).mean() > 0.95


def test_a_few_peaks_by_themselves_keep_their_line() -> None:
    """The mean of five says too little."""
    rest_px = np.full((1, ROWS), 100.0)
    row = np.arange(140, 145)
    line = np.zeros(5, np.int64)
    found = on_rest_line(row, np.full(5, 100.9), line, line, rest_px, TOLERANCE_PX, 0.0, OUTER)
    assert (found == 0).all()


@pytest.mark.parametrize("slope_px", [1.2, -0.6])
def test_a_body_that_goes_through_the_line_is_no_belt(slope_px: float) -> None:
    """Its edge meets the neighbour's belt line and goes on to the other side, then belt begins."""
    rest_px = np.full((1, ROWS), 100.0)
    row, off_px = np.arange(ROWS), np.zeros(ROWS)
    off_px[BODY] = slope_px * (row[BODY] - BODY.stop + 4)
    alone = np.where(np.abs(off_px) <= TOLERANCE_PX, 0, -1)
    found = on_rest_line(
        row, 100.0 + off_px, np.zeros(ROWS, np.int64), alone, rest_px, TOLERANCE_PX, 0.0, OUTER
    )
    assert (alone[BODY] == 0).any()
    assert (found[BODY] == -1).all()
    assert (np.delete(found, np.r_[BODY]) == 0).all()


@pytest.mark.parametrize(
    ("rows", "between", "kept"), [(40, 0, True), (39, 0, False), (40, 3, True), (40, 4, False)]
)
def test_only_what_goes_on_for_long_counts(rows: int, between: int, kept: bool) -> None:
    """Two halves with some rows between; a second piece is found on alternate rows."""
    row = np.repeat(np.arange(100), 2)
    piece = np.tile([0, 1], 100)
    first = (row < 20) | ((row >= 20 + between) & (row < rows + (between if between > 3 else 0)))
    found = np.where(piece == 0, first, row % 2 == 0)
    got = on_end(row, piece, found, 40, 3)
    np.testing.assert_array_equal(got[piece == 0], (found & kept)[piece == 0])
    np.testing.assert_array_equal(got[piece == 1], found[piece == 1])


def test_a_short_run_keeps_its_line_where_its_trace_begins_or_ends_with_it() -> None:
    """Nothing lies before it, or after: what another trace does says nothing of it."""
    rest_px = np.full((1, ROWS), 100.0)
    x_px = np.array([[98.0] * 9, [100.0] * 3 + [103.0] * 6, [97.0] * 6 + [100.0] * 3, [103.0] * 9])
    row, trace = np.repeat(np.arange(140, 149), 4), np.tile(np.arange(4), 9)
    alone = np.where(x_px.T.ravel() == 100.0, 0, -1)
    found = on_rest_line(row, x_px.T.ravel(), trace, alone, rest_px, TOLERANCE_PX, 0.0, OUTER)
    np.testing.assert_array_equal(found, alone)
