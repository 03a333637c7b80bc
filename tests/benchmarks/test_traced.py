"""Traced skeins: parts of an error that add up, and stripes that show what they meet."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.grading.judges import fitted_limits, rules_of
from benchmarks.tables import confusion
from benchmarks.traced import Row, Traced, shown_mm, traced
from roemetry_shape.fuzzy_rules import FuzzyRules
from roemetry_shape.shape_limits import ShapeLimits


@pytest.fixture(scope="module")
def dented() -> Traced:
    """A skein with a dent that stripes meet."""
    return traced(7, "recipe-like", "dented")


def test_what_stripes_show_of_a_dent_is_no_more_than_there_is(dented: Traced) -> None:
    """Stripes meet the dent; without a sound skein to compare with nothing is shown."""
    drawn, whole = dented.drawn, dented.drawn.reference
    assert whole is not None
    x_min, x_max, y_min, y_max = whole.footprint_extent_mm()
    x, y = np.meshgrid(np.arange(x_min, x_max, 0.25), np.arange(y_min, y_max, 0.25))
    depth_mm = np.nanmax(whole.heights_mm(x, y)[0] - drawn.solid.heights_mm(x, y)[0])
    assert 0.0 < shown_mm(dented) <= depth_mm + 0.1
    assert shown_mm(replace(dented, drawn=replace(drawn, reference=None))) == 0.0


def test_the_papers_peaks_are_at_whole_pixels_and_its_product_is_near_the_true_one(dented: Traced) -> None:
    assert dented.exact is not None
    assert dented.paper is not None
    seen = dented.paper.profiles.seen & (dented.paper.profiles.product > 0)
    x_px = dented.paper.profiles.x_px[seen]
    assert (x_px == np.round(x_px)).all()
    tops = [float(np.nanmax(one.profiles.xyz_mm[..., 2])) for one in (dented.exact, dented.paper)]
    assert tops[0] == pytest.approx(tops[1], abs=1.5)


def row(seed: int, kind: str, depth_mm: float, **features: float) -> Row:
    return Row(seed, "", kind, "", features, {"paper": "good"}, depth_mm)


def test_limits_lie_beyond_all_good_ones_and_rules_say_the_same() -> None:
    rows = [row(k, "none", 0.0, hollow=0.01 * k, turn=1.0) for k in range(20)]
    rows += [row(50 + k, "dented", 2.0, hollow=2.0 + k, turn=1.0) for k in range(8)]
    rows += [row(80 + k, "bent", 2.0, hollow=0.0, turn=9.0 + k) for k in range(8)]
    limits = fitted_limits(rows)
    by_limits, by_rules = ShapeLimits(limits), FuzzyRules(rules_of(limits))
    for one in rows:
        assert by_limits.judge(one.features).label == one.name
        assert by_rules.judge(one.features).label == one.name


def test_a_confusion_leaves_out_what_does_not_occur() -> None:
    found = Counter({("bent", "good"): 2, ("bent", "bend"): 1, ("good", "good"): 3})
    text = confusion(found, ["good", "dent", "bend"], "x", ["good", "dented", "bent"])
    assert text.splitlines() == [
        "| x | good | bend |",
        "| --- | --- | --- |",
        "| good | 3 | · |",
        "| bent | 2 | 1 |",
    ]
