"""Line against scale: what has moved is seen, what has not is let be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from roemetry.calibrating.weight_check import WeighedPair, check_weights
from roemetry.errors import DataError


def pairs(line_over_scale: np.ndarray, std: float = 0.02) -> list[WeighedPair]:
    scale = 25.0
    return [
        WeighedPair(f"p{k}", scale * ratio, scale * std, scale) for k, ratio in enumerate(line_over_scale)
    ]


def test_what_has_not_moved_holds(rng: np.random.Generator) -> None:
    """Of 300 checks of 20 true pairs each, at most 3 % say otherwise."""
    false = sum(
        check_weights(pairs(1.0 + 0.02 * rng.standard_normal(20))).verdict != "holds" for _ in range(300)
    )
    assert false <= 9 + 9  # 3 %, and three standard deviations of the count


def test_a_bias_is_seen_and_one_below_the_tolerance_let_be(rng: np.random.Generator) -> None:
    off = 0.02 * rng.standard_normal(30)
    check = check_weights(pairs(1.04 + off - off.mean()))
    assert check.verdict == "refit"
    assert check.bias_share == pytest.approx(0.04, abs=1e-12)
    assert "+4.0%" in check.words[0]
    assert check_weights(pairs(1.004 + off - off.mean())).verdict == "holds"


def test_a_season_that_begins_is_dated() -> None:
    quiet = np.tile([0.99, 1.01], 15)
    check = check_weights(pairs(np.concatenate([quiet, quiet + 0.05])))
    assert check.verdict == "refit"
    assert check.since in ("p29", "p30", "p31")


def test_uncertainties_that_are_too_small_are_seen(rng: np.random.Generator) -> None:
    off = rng.standard_normal(40)
    off = (off - off.mean()) / off.std()
    check = check_weights(pairs(1.0 + 0.02 * off[np.argsort(np.abs(off))], std=0.01))
    assert check.verdict == "refit"
    assert check.scatter_over_stated == pytest.approx(2.0, abs=1e-9)
    assert any("2.00 times as wide as stated" in sentence for sentence in check.words)


def test_what_says_nothing_is_told() -> None:
    assert check_weights(pairs(np.ones(4))).verdict == "too few"
    unstated = [pair._replace(line_std_g=math.nan) for pair in pairs(np.tile([0.98, 1.02], 5))]
    check = check_weights(unstated)
    assert check.verdict == "holds"
    assert math.isnan(check.within_share)
    with pytest.raises(DataError, match="no product was weighed by line and scale both"):
        check_weights([])
    with pytest.raises(DataError, match="not the same unit"):
        check_weights(pairs(np.full(6, 1000.0)))


def test_a_bias_within_the_tolerance_never_adds_up_to_running_away() -> None:
    """0.9 % in each of 200 pairs, stated to 0.5 %: 1.8 uncertainties to one side, every time."""
    sure = pairs(np.full(200, 1.009), std=0.005)
    assert check_weights(sure, 0.01).since == ""
    assert check_weights(sure, 0.0).since == "p0"
    assert check_weights(pairs(np.full(200, 1.02), std=0.005), 0.01).since == "p0"


def test_the_scales_own_uncertainty_is_part_of_a_difference() -> None:
    off = np.tile([0.98, 1.02], 10)
    rough = [pair._replace(scale_std_g=math.sqrt(3.0) * pair.line_std_g) for pair in pairs(off, std=0.01)]
    assert check_weights(pairs(off, std=0.01)).scatter_over_stated == pytest.approx(2.0, abs=1e-9)
    assert check_weights(rough).scatter_over_stated == pytest.approx(1.0, abs=1e-9)
