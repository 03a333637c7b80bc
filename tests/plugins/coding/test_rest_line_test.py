"""Belt stays on its rest line; bodies beside it are doubted, or numbered by the uneven spacing of the fan."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.testing.scenes import LinearRig
from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.pieces import on_rest_line
from roemetry_coding.planes.vetoes import denies_belt, numbered_by_pattern, on_end
from roemetry_kernels.rest_lines import calibrated_rest_lines

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


def entries_of(start: np.ndarray, count: int) -> Entries:
    """Give entries of lines, one unit from each to the next, of no pieces."""
    none = np.full(count, -1)
    return Entries(start, np.arange(count), np.arange(float(count)), none, none, np.zeros(count))


@pytest.mark.parametrize(("denied", "doubted"), [(0, False), (4, False), (8, True), (40, True)])
def test_a_body_may_not_leave_out_belt_of_its_own_stripes(denied: int, doubted: bool) -> None:
    """Each of 60 lines holds two stripes of a body, and some amid it the belt of the second, left out."""
    lines = np.arange(60)
    order = np.tile([0, 1, 2], 60)
    stripe = np.tile([1, 2, -1], 60)
    line = np.where(order == 2, 2, -1)
    amid = (lines >= 10) & (lines < 10 + denied)
    line[(order == 2) & ~np.repeat(amid, 3)] = 5  # of a stripe that the body has not
    entries = entries_of(np.arange(0, order.size + 1, 3), order.size)
    body = np.where(order == 2, 0, 1)
    found = denies_belt(entries, line, stripe, body, np.ones(body.size))
    np.testing.assert_array_equal(found, doubted & (body == 1))


def test_belt_of_another_bodys_stripe_is_no_doubt() -> None:
    """Two bodies; the belt that is left out is of a stripe which only the second one has."""
    stripe, line, body = np.tile([1, 4, -1], 20), np.tile([-1, -1, 4], 20), np.tile([1, 2, 0], 20)
    entries = entries_of(np.arange(0, stripe.size + 1, 3), stripe.size)
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body, np.ones(body.size)), body == 2)


def test_light_over_a_bodys_edge_is_no_doubt() -> None:
    """An edge askew to the lines: the belt of each of 14 stripes reaches over it, 4 lines at either end."""
    stripes, lines, spread = 14, 30, 4
    start, stripe, line = [0], [], []
    for e in range(spread * stripes + lines):
        for s in range(stripes):
            since = e - spread * s  # the body's edge meets each stripe that much later
            if not 0 <= since < lines:
                continue
            stripe.append(s)
            line.append(-1)
            if since < spread or since >= lines - spread:
                stripe.append(-1)
                line.append(s)
        start.append(len(stripe))
    said, on = np.array(stripe), np.array(line)
    entries = entries_of(np.array(start), said.size)
    assert not denies_belt(entries, on, said, np.where(said >= 0, 1, 0), np.ones(said.size)).any()


@pytest.mark.parametrize(("share", "glows"), [(0.2, True), (0.5, False)])
def test_light_that_came_through_the_body_is_refused_and_the_body_is_not(share: float, glows: bool) -> None:
    """A stripe on 40 lines, the last 14 of them so faint; on ten of these its belt was seen and left out."""
    lines = np.arange(40)
    stripe, body = np.tile([1, -1], 40), np.tile([1, 0], 40)
    line = np.where((body == 0) & np.repeat((lines >= 26) & (lines < 36), 2), 1, -1)
    amplitude = np.where((body == 1) & np.repeat(lines >= 26, 2), share, 1.0)
    entries = entries_of(np.arange(0, body.size + 1, 2), body.size)
    refused = (amplitude < 1.0) if glows else (body == 1)
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body, amplitude), refused)


PATTERN_ROWS, STRIPES = 120, 12


def scene(
    rng: np.random.Generator, *, uneven_px: float, off: int, dome_px: float = 0.0, alternating: bool = False
):
    """Peaks of a body on stripes 3 to 9, 50 px up, labelled `off` stripes on."""
    rig = LinearRig(rows=PATTERN_ROWS, columns=640, stripes=STRIPES, first_px=60.0)
    calibration = rig.calibration()
    rest_px = calibration.rest_px.copy()
    by = np.resize([1.0, -1.0], STRIPES) if alternating else rng.uniform(-1.0, 1.0, STRIPES)
    rest_px[:, 0] += uneven_px * by
    object.__setattr__(calibration, "rest_px", rest_px)
    x_px = calibration.rest_line_px(np.arange(PATTERN_ROWS, dtype=np.float64))
    body = np.s_[3:10, 30:90]
    stripes = np.arange(3, 10)[:, None]
    x_px[body] += 50.0 + dome_px * np.cos((stripes - 6.0) / 4.0)
    drawn = rig.peaks(x_px, scatter_px=0.1)
    rest = calibrated_rest_lines(drawn.peaks, calibration)
    on_body = (drawn.stripe >= 3) & (drawn.stripe < 10) & (drawn.peaks.row >= 30) & (drawn.peaks.row < 90)
    stripe = np.where(on_body, drawn.stripe + off, drawn.stripe)
    rest = rest._replace(line=np.where(on_body, -1, drawn.stripe))
    return numbered_by_pattern(drawn.peaks.row, drawn.peaks.x_px, stripe, rest), on_body


@pytest.mark.parametrize("off", [1, -1, 2])
@pytest.mark.parametrize("dome_px", [0.0, 6.0])
def test_a_body_that_is_off_gets_its_number_or_none(
    off: int, dome_px: float, rng: np.random.Generator
) -> None:
    (shift, wrong), on_body = scene(rng, uneven_px=2.0, off=off, dome_px=dome_px)
    np.testing.assert_array_equal((shift != 0) | wrong, on_body)
    assert set(shift[on_body]) <= {0, -off}, "never a wrong one"
    if dome_px == 0.0:
        assert (shift[on_body] == -off).all(), "a level body is told apart from all others"


@pytest.mark.parametrize("dome_px", [0.0, 6.0, 30.0])
@pytest.mark.parametrize("uneven_px", [0.0, 2.0])
def test_a_body_that_is_right_is_kept(uneven_px: float, dome_px: float, rng: np.random.Generator) -> None:
    (shift, wrong), _ = scene(rng, uneven_px=uneven_px, off=0, dome_px=dome_px)
    assert not shift.any()
    assert not wrong.any()


def test_a_fan_that_repeats_itself_refuses(rng: np.random.Generator) -> None:
    """Every second distance alike: a number that is odd by one fits as well as one that is odd by three."""
    (shift, wrong), on_body = scene(rng, uneven_px=2.0, off=1, alternating=True)
    assert not shift.any()
    np.testing.assert_array_equal(wrong, on_body)
