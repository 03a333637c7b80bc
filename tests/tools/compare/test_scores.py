"""The judges of `compare`, on maps and peaks made by hand; scores come back from their file."""

from __future__ import annotations

import base64
import json
import math
import pickle
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import OutputError
from roemetry.records import (
    AMBIGUOUS,
    UNLABELLED,
    Estimate,
    Frame,
    Grade,
    Measurement,
    Peaks,
    ProductTruth,
    Reason,
    Shares,
    StripeMap,
    StripeTruth,
    Volume,
)
from roemetry.stages.registry import discover
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import NOT_GRADED, Pair, Scored, classes_of, errors_of
from roemetry_tools.compare.stripes import (
    CentreScore,
    CodingScore,
    by_place,
    nearest,
    score_centres,
    score_coding,
    truth_in,
)
from roemetry_tools.compare.variants import make_variants
from roemetry_tools.compare.write import KEPT, StoredScores, _plain
from tests.tools.compare.conftest import dataset

ROWS, COLUMNS = 40, 100


def truth(x_px: np.ndarray, on_product: np.ndarray | None = None) -> StripeTruth:
    on = np.isfinite(x_px) if on_product is None else on_product
    return StripeTruth(x_px, on, np.full((*x_px.shape, 3), np.nan))


def peaks(row: np.ndarray, x_px: np.ndarray) -> Peaks:
    order = np.lexsort((x_px, row))
    n = row.size
    nan = np.full(n, np.nan)
    return Peaks((ROWS, COLUMNS), row[order], x_px[order], nan, nan, nan, nan, np.zeros(n, np.uint8))


def of_map(x_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    stripe, row = np.nonzero(np.isfinite(x_px))
    return row, x_px[stripe, row]


def stripe_map(x_px: np.ndarray, peak_stripe: np.ndarray) -> StripeMap:
    seen = np.isfinite(x_px)
    nan = np.full(x_px.shape, np.nan)
    return StripeMap(x_px, nan, np.where(seen, 1, -1), seen, nan, np.zeros_like(seen), nan, peak_stripe)


@pytest.fixture
def lines() -> np.ndarray:
    """(stripe, row) four stripes 20 px apart, slightly slanted."""
    return 20.0 + 20.0 * np.arange(4)[:, None] + 0.05 * np.arange(ROWS)[None, :]


def test_shifted_peaks_have_the_shift_as_their_bias(lines: np.ndarray) -> None:
    score, on_product = score_centres(peaks(*of_map(lines + 0.3)), truth(lines))
    assert score.true == score.matched == score.peaks == lines.size
    assert score.sum_px / score.matched == pytest.approx(0.3, abs=1e-12)
    assert math.sqrt(score.sum_px2 / score.matched) == pytest.approx(0.3, abs=1e-12)
    assert score.quantile_px(0.5) == pytest.approx(0.3, abs=0.002)
    assert on_product.matched == lines.size


def test_missed_and_false_are_counted(lines: np.ndarray) -> None:
    found = lines.copy()
    found[1, 10:20] = np.nan  # not found
    found[2, 5] += 3.5  # found, but too far away: missed and false
    row, x_px = of_map(found)
    score, on_product = score_centres(
        peaks(np.append(row, [0, 0]), np.append(x_px, [5.0, 41.0])),  # 41.0 lies beside another peak
        truth(lines, np.arange(4)[:, None] * np.ones((1, ROWS)) == 1),
    )
    assert score.matched == lines.size - 11
    assert score.peaks - score.matched == 3
    assert (on_product.true, on_product.matched, on_product.peaks) == (40, 30, 30)


def test_quantiles_are_those_of_the_errors(rng: np.random.Generator) -> None:
    lines = 20.0 + 20.0 * np.arange(4)[:, None] + np.zeros((1, ROWS))
    error = np.clip(rng.normal(0.1, 0.3, lines.shape), -2, 2)
    score, _ = score_centres(peaks(*of_map(lines + error)), truth(lines))
    for share in (0.16, 0.5, 0.84):
        assert score.quantile_px(share) == pytest.approx(np.quantile(error, share), abs=0.02)
    assert (score + score).quantile_px(0.5) == pytest.approx(score.quantile_px(0.5))


def test_nearest_stays_in_the_row_and_within_reach(rng: np.random.Generator) -> None:
    row, other_row = rng.integers(0, 8, 200), rng.integers(0, 8, 150)
    x_px, other_x_px = rng.uniform(0, 60, 200), rng.uniform(0, 60, 150)
    off = np.where(row[:, None] == other_row[None, :], np.abs(x_px[:, None] - other_x_px[None, :]), np.inf)
    want = np.where(off.min(axis=1) <= 3.0, off.argmin(axis=1), -1)
    assert np.array_equal(nearest(row, x_px, other_row, other_x_px), want)
    assert np.array_equal(nearest(row, x_px, other_row[:0], other_x_px[:0]), np.full(200, -1))


def test_coding_is_scored_as_it_was_made(lines: np.ndarray) -> None:
    coded = lines.copy()
    coded[0, :10] = np.nan  # called ambiguous
    coded[1, :5] = np.nan  # left out
    coded[2, 3:11] = lines[3, 3:11]  # taken for its neighbour's: its own points and those are affected
    coded[3, 3:11] = np.nan
    found = lines.copy()
    found[1, 30:36] = np.nan  # no peak there
    coded[1, 30:36] = np.nan
    row, x_px = of_map(found)
    stripe = np.nonzero(np.isfinite(found))[0]
    label = np.where((stripe == 0) & (row < 10), AMBIGUOUS, stripe)
    label = np.where((stripe == 1) & (row < 5), UNLABELLED, label)
    label = np.where((stripe == 2) & (row >= 3) & (row < 11), UNLABELLED, label)
    label = np.where((stripe == 3) & (row >= 3) & (row < 11), 2, label)
    order = np.lexsort((x_px, row))
    score = score_coding(stripe_map(coded, label[order]), peaks(row, x_px), truth(lines))
    assert score.visible == lines.size
    assert score.wrong == score.wrong_points == score.longest_wrong_run == 8
    assert score.refused == 10 + 5 + 8
    assert score.ambiguous == 10
    assert score.unseen == 6
    assert score.right == lines.size - 8 - 23 - 6


def test_only_visible_product_points_count(lines: np.ndarray) -> None:
    on_product = np.zeros(lines.shape, np.bool_)
    on_product[1, 10:20] = True
    shifted = np.roll(lines, 1, axis=0)  # every label wrong, the outer ones too
    label = np.repeat([1, 2, 3, 0], ROWS)
    row, x_px = of_map(lines)
    order = np.lexsort((x_px, row))
    score = score_coding(stripe_map(shifted, label[order]), peaks(row, x_px), truth(lines, on_product))
    assert (score.visible, score.wrong, score.right) == (10, 10, 0)
    assert score.wrong_points == lines.size
    assert score.longest_wrong_run == ROWS
    total = score + score
    assert (total.visible, total.longest_wrong_run) == (20, ROWS)


def test_products_are_matched_by_the_points_they_share(lines: np.ndarray) -> None:
    label = np.zeros(lines.shape, np.int16)
    label[:2, 5:15], label[2:, 5:15], label[:, 25:35] = 1, 2, 3
    known = StripeTruth(lines, label > 0, np.full((*lines.shape, 3), np.nan), label)
    # found: the last one as number 1, the first as number 2, nothing of the second; and one on the belt
    found = np.where(label == 3, 1, np.where(label == 1, 2, 0)).astype(np.int16)
    found[:, 18:22] = 3
    made = replace(stripe_map(lines + 0.2, np.arange(lines.size) // ROWS), product=found)
    assert by_place(made, known) == {1: 3, 2: 1}
    # a coder that shifts every label by one stripe does not move a product
    shifted = np.vstack([lines[1:], np.full((1, ROWS), np.nan)])
    moved = np.vstack([found[1:], np.full((1, ROWS), -1, np.int16)])
    assert by_place(replace(stripe_map(shifted, np.full(lines.size, -1)), product=moved), known) == {
        1: 3,
        2: 1,
    }
    nothing = replace(made, product=np.zeros_like(found))
    assert by_place(nothing, known) == {}


def test_truth_of_another_turn_or_size_is_refused(lines: np.ndarray) -> None:
    told = [
        truth_in(Frame(np.zeros((rows, COLUMNS), np.uint8), turn_deg=turn), truth(lines))
        for rows, turn in ((ROWS, 90), (ROWS, 270), (ROWS - 1, 0))
    ]
    assert [one.code for one in told if isinstance(one, Reason)] == [
        "truth-other-turn",
        "truth-other-turn",
        "truth-other-size",
    ]
    assert isinstance(told[0], Reason) and "turned by 90°" in told[0].text


def test_errors_are_those_of_the_closed_forms() -> None:
    true = np.array([100.0, 200.0, 400.0, 50.0])
    found = errors_of(true * [1.1, 0.9, 1.0, 1.4], true)
    assert (found.n, found.bias_pct, found.median_pct) == (4, pytest.approx(10.0), pytest.approx(5.0))
    assert found.mean_absolute_pct == pytest.approx(15.0)
    assert found.spread_pct == pytest.approx(math.sqrt((0.0 + 400.0 + 100.0 + 900.0) / 3.0))
    assert found.rmse == pytest.approx(math.sqrt((100.0 + 400.0 + 0.0 + 400.0) / 4.0))
    assert (found.min_pct, found.max_pct) == (pytest.approx(-10.0), pytest.approx(40.0))
    assert math.isnan(errors_of(true[:1], true[:1]).spread_pct)
    assert errors_of(true[:0], true[:0]) is None


def test_classes_are_counted_and_none_is_not_right() -> None:
    classes = classes_of({
        ("good", "good"): 8, ("good", "henkei"): 2, ("henkei", "henkei"): 1,
        ("henkei", "unknown"): 1, ("henkei", NOT_GRADED): 2,
    })  # fmt: skip
    assert classes.true == ("good", "henkei")
    assert classes.given == ("good", "henkei", "unknown", NOT_GRADED)
    assert classes.counts == ((8, 2, 0, 0), (0, 1, 1, 2))
    assert classes.accuracy == pytest.approx(9 / 14)
    assert classes.balanced_accuracy == pytest.approx((0.8 + 0.25) / 2)
    only = classes_of({("good", "good"): 3})
    assert math.isnan(only.balanced_accuracy)


__all__ = ["dataset"]

WHY = Reason("undecided", "a third of the points is open")


class Evil:
    """What runs code where a pickle is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "ran")


def scored() -> Scored:
    counts = np.zeros_like(CentreScore().counts)
    counts[[3, 2999]] = 7, 1
    row = Measurement(
        "a#1",
        "a",
        1,
        status="measured",
        height_max_mm=Estimate(0.1 + 0.2, 1e-300, interval=(-math.inf, math.inf)),
        volume=Volume(Estimate(math.pi * 1e4, 1.0), None, Shares(1.0, 0.0, 0.0), reasons=(WHY,)),
        grade=Grade("good", math.nan),
        absent={"weigher": WHY},
    )
    true = ProductTruth("good", visible_mm3=31000.0, figures={"length_mm": 71.3})
    return Scored(
        2,
        "ä\udce4",
        (Pair(1, row, true, (WHY,)), Pair(0, None, None)),
        WHY,
        CentreScore(9, 8, 7, 0.1 + 0.2, math.inf, counts),
        CentreScore(),
        CodingScore(5, 3),
        {"stripes": WHY},
        {"frame": 0.0125},
    )


@pytest.fixture
def kept(dataset, tmp_path):
    variants = make_variants(dataset(2), [], registry=discover())
    data = Data(variants[0].recipe)
    return lambda: StoredScores(tmp_path, variants, data, Terms(), resume=True)


def test_what_was_kept_comes_back_to_the_last_digit(kept) -> None:
    with kept() as file:
        file.add((True, [scored()]))
        ((cold, (found,)),) = file.found()
    assert cold is True
    assert json.dumps(found, default=_plain) == json.dumps(scored(), default=_plain)
    assert (found.centres.counts == scored().centres.counts).all()
    assert found.pairs[0].reasons == (WHY,)
    assert found.pairs[0].measured.height_max_mm.interval == (-math.inf, math.inf)
    assert math.isnan(found.pairs[0].measured.grade.probability)


def test_a_stranger_s_file_runs_nothing(kept, tmp_path) -> None:
    with kept():
        pass
    bad = base64.b64encode(zlib.compress(pickle.dumps(Evil(tmp_path / "ran"))))
    with (tmp_path / KEPT).open("ab") as file:
        file.write(bad + b"\n")
    with kept() as file, pytest.raises(OutputError, match=r"\.scored:2: damaged, or of another roemetry"):
        next(file.found())
    assert not (tmp_path / "ran").exists()
