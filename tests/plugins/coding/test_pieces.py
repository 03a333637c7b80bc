"""Numbers without a calibration: broken stripes with truth are numbered right, or not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.testing import LinearRig
from roemetry_coding.pieces import Pieces, PiecesOptions

ROWS, STRIPES, SPACING_PX = 300, 8, 30.0
RIG = LinearRig()


def peaks_of(x_px: Floats, noise_px: float = 0.15, seed: int = 5) -> tuple[Peaks, Integers]:
    """Give the peaks of (stripe, row) centres, and the stripe of each."""
    noisy = x_px + np.random.default_rng(seed).normal(0.0, noise_px, x_px.shape)
    stripe, row = np.nonzero(np.isfinite(noisy) & (noisy > 0.0) & (noisy < 399.0))
    x = noisy[stripe, row]
    order = np.lexsort((x, row))
    flat = np.full(x.size, 5.0)
    flags = np.zeros(x.size, np.uint8)
    peaks = Peaks((ROWS, 400), row[order], x[order], 0.02 * flat, 20.0 * flat, flat, flat, flags)
    return peaks, stripe[order]


def lines(lean: float = 0.15, bend: float = 0.0) -> Floats:
    """(stripe, row) centres of stripes that lean, and bend in the middle."""
    row = np.arange(ROWS)
    along = lean * row + bend * np.maximum(row - 150, 0)
    return 50.0 + SPACING_PX * np.arange(STRIPES)[:, None] + along[None, :]


def shifts(stripes: StripeMap, true: Integers) -> Integers:
    """Give true minus given for all that is numbered: one value, if nothing is wrong."""
    given = stripes.peak_stripe >= 0
    return np.unique(true[given] - stripes.peak_stripe[given])


def refused_or_right(x_px: Floats, **kwargs: float) -> StripeMap | None:
    """Code; nothing may be wrong. None for a frame that is refused."""
    peaks, true = peaks_of(x_px, **kwargs)
    try:
        stripes = Pieces().code(peaks, None)
    except StageError as refusal:
        assert str(refusal)
        return None
    assert shifts(stripes, true).size == 1
    assert "relative-numbers" in {reason.code for reason in stripes.reasons}
    return stripes


def numbered(stripes: StripeMap | None) -> float:
    return 0.0 if stripes is None else float((stripes.peak_stripe >= 0).mean())


@pytest.mark.parametrize("seed", range(6, 12))
def test_single_breaks_cost_numbers_and_give_no_wrong_ones(seed: int) -> None:
    """Twenty breaks of 3–40 rows anywhere: what hangs on a break that is in doubt goes with it."""
    rng = np.random.default_rng(seed)
    x_px = lines(bend=0.3)
    for _ in range(20):
        start = int(rng.integers(0, ROWS - 10))
        x_px[int(rng.integers(STRIPES)), start : start + int(rng.integers(3, 41))] = np.nan
    assert numbered(refused_or_right(x_px, seed=seed)) > 0.4


@pytest.mark.parametrize("off_spacings", [0.0, 0.2, -0.2, 0.3])
def test_a_front_of_breaks_between_two_stripes_that_go_through(off_spacings: float) -> None:
    """All but the outer stripes break along a slanting line, and go on a little to the side."""
    x_px = lines()
    for stripe in range(1, STRIPES - 1):
        begin = 90 + 8 * stripe
        x_px[stripe, begin : begin + 50] = np.nan
        x_px[stripe, begin + 50 :] += off_spacings * SPACING_PX
    assert numbered(refused_or_right(x_px)) == 1.0


@pytest.mark.parametrize("off_spacings", [0.5, -0.5, 0.55])
def test_where_two_stripes_point_equally_well_neither_is_taken(off_spacings: float) -> None:
    x_px = lines()
    x_px[1:-1, 120:170] = np.nan
    x_px[1:-1, 170:] += off_spacings * SPACING_PX
    stripes = refused_or_right(x_px)
    assert numbered(stripes) < 0.8
    if stripes is not None:
        assert (stripes.peak_stripe == AMBIGUOUS).any()


@pytest.mark.parametrize("off_spacings", [0.85, 0.9, 1.0, 1.1, -0.9, -1.0, -1.1])
@pytest.mark.parametrize("back", [False, True])
def test_stripes_moved_aside_by_one_spacing_are_not_taken_for_their_neighbours(
    off_spacings: float, back: bool
) -> None:
    """Where the first stripe's end is left over, one too few goes on: who is who cannot be said."""
    x_px = lines(lean=0.05)
    moved = slice(170, 240 if back else ROWS)
    x_px[1:-1, 120:170] = np.nan
    if back:
        x_px[1:-1, 240:250] = np.nan
    assert numbered(refused_or_right(x_px)) == 1.0  # where nothing is moved
    x_px[1:-1, moved] += off_spacings * SPACING_PX
    hidden = STRIPES - 2 if off_spacings > 0 else 1  # it would lie on the one that goes through
    x_px[hidden, moved] = np.nan
    assert numbered(refused_or_right(x_px)) < 1.0


def test_a_front_from_end_to_end_has_nothing_to_count_from() -> None:
    """All stripes break along one line, and go on by any step: only one half is numbered."""
    x_px = lines()
    x_px[:, 120:160] = np.nan
    stripes = refused_or_right(x_px)
    assert numbered(stripes) < 0.7


def test_stripes_are_counted_from_the_left_but_not_over_a_wide_gap() -> None:
    """Where a stripe is dark from end to end nothing says how many are missing."""
    peaks, true = peaks_of(lines())
    stripes = Pieces().code(peaks, None)
    np.testing.assert_array_equal(stripes.peak_stripe, true)
    assert stripes.stripe_count == STRIPES
    assert np.nanmin(stripes.margin) > 0.7
    stripes = Pieces().code(peaks_of(np.delete(lines(), 2, axis=0))[0], None)
    assert stripes.stripe_count == STRIPES - 3  # those right of it
    assert (stripes.peak_stripe == AMBIGUOUS).sum() == 2 * ROWS


@pytest.mark.parametrize("off_spacings", [-0.8, -0.9, -1.1, 0.8, 0.9, 1.1])
@pytest.mark.parametrize("dead", [1, 2, 4])
def test_bodies_beside_a_dead_stripe_do_not_take_its_number(off_spacings: float, dead: int) -> None:
    """What is moved aside stands at a regular distance from a stripe that is not its neighbour.

    By a whole spacing, to a twentieth, it goes on as the neighbour itself would: that is not told apart.
    """
    x_px = lines(lean=0.05)
    body = slice(dead + 1, STRIPES - 1) if off_spacings < 0 else slice(1, dead)
    x_px[body, 95:105] = x_px[body, 200:210] = np.nan
    assert numbered(refused_or_right(x_px)) == 1.0  # where nothing is moved
    x_px[body, 105:200] += off_spacings * SPACING_PX
    x_px[dead] = np.nan
    assert numbered(refused_or_right(x_px)) < 1.0


def test_glare_across_the_stripes_takes_no_number_and_specks_and_lost_rows_cost_none(
    rng: np.random.Generator,
) -> None:
    x_px, row = lines(), np.arange(ROWS)
    x_px[2:5, 140:160] = np.nan
    across = np.where((row >= 138) & (row < 165), 190.0 - 2.6 * (row - 138), np.nan)
    peaks, true = peaks_of(np.concatenate([x_px, across[None]]))
    given = Pieces().code(peaks, None).peak_stripe
    assert not (given[true == STRIPES] >= 0).any()
    assert np.unique((true - given)[given >= 0]).size == 1
    x_px = lines()
    x_px[:, 100:106] = np.nan
    specks = np.full((30, ROWS), np.nan)
    specks[np.arange(30), rng.integers(0, ROWS, 30)] = rng.uniform(10.0, 390.0, 30)
    peaks, true = peaks_of(np.concatenate([x_px, specks]))
    given, known = Pieces().code(peaks, None).peak_stripe, true < STRIPES
    assert np.unique((true - given)[known & (given >= 0)]).size == 1
    assert (given[known] >= 0).mean() > 0.95


def test_mirrored_and_turned_upside_down_it_says_the_same() -> None:
    x_px = lines(bend=0.3)
    x_px[1:-1, 100:150] = np.nan
    x_px[1:-1, 150:] += 6.0
    for variant in (x_px, x_px[:, ::-1], (399.0 - x_px)[::-1]):
        assert numbered(refused_or_right(variant)) == 1.0


def test_too_little_to_say_anything_of_is_refused_and_a_single_stripe_is_one(
    rng: np.random.Generator,
) -> None:
    found = RIG.peaks(RIG.x_px(RIG.dome()), 0.1)
    with pytest.raises(StageError, match="numbers stripes from the first one seen"):
        Pieces().code(found.peaks, RIG.calibration())
    one_row, few = np.full((2, STRIPES, ROWS), np.nan)
    one_row[:, 100], few[:, 40:52] = lines()[:, 100], lines()[:, 40:52]
    noise = rng.uniform(5.0, 395.0, (12, ROWS))
    for nothing in (np.full((1, ROWS), np.nan), one_row, noise):
        with pytest.raises(StageError):
            Pieces().code(peaks_of(nothing)[0], None)
    assert Pieces().code(peaks_of(lines()[:1])[0], None).stripe_count == 1
    refused_or_right(few)


def test_no_margin_is_asked_for_and_all_of_it() -> None:
    x_px = lines()
    x_px[1:-1, 120:170] = np.nan
    x_px[1:-1, 170:] += 0.3 * SPACING_PX
    peaks, _ = peaks_of(x_px)
    easy = Pieces(PiecesOptions(margin_min=0.0)).code(peaks, None)
    strict = Pieces(PiecesOptions(margin_min=0.9)).code(peaks, None)
    assert (easy.peak_stripe >= 0).sum() > (strict.peak_stripe >= 0).sum()
    assert np.nanmin(strict.margin) >= 0.9


def test_skeins_on_a_belt_are_never_numbered_wrongly() -> None:
    """A dome of the kit, at heights to a stripe spacing and more, with the belt on all sides."""
    rig = replace(RIG, stripes=9, columns=460)
    for height_mm in (3.0, 8.0, 14.0, 20.0, 26.0):
        found = rig.peaks(rig.x_px(rig.dome(height_mm)), 0.1)
        try:
            stripes = Pieces().code(found.peaks, None)
        except StageError:
            continue
        assert shifts(stripes, found.stripe).size == 1
