"""Traced skeins: parts of an error that add up, and stripes that show what they meet."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from benchmarks.grading.judges import GOOD, Judged, fitted_limits, rules_of, score_of
from benchmarks.tables import confusion
from benchmarks.traced import CAUSES, Row, Traced, defect_figures, traced, weight_figures
from roemetry_shape.fuzzy_rules import FuzzyRules
from roemetry_shape.shape_limits import ShapeLimits


@pytest.fixture(scope="module")
def dented() -> Traced:
    """A skein with a dent that stripes meet."""
    return traced(7, "recipe-like", "dented")


def test_the_parts_of_the_weights_error_add_up(dented: Traced) -> None:
    found = weight_figures(dented)
    parts = [found[f"error: {cause}"] for cause in CAUSES]
    assert sum(parts) == pytest.approx(found["paper_g"] / found["true_g"] - 1.0, abs=1e-9)
    assert found["error: underside"] > 0.0


def test_ideal_lines_show_what_traced_stripes_show(dented: Traced) -> None:
    """Within what a point every quarter of a millimetre may miss, and no more than there is."""
    found = defect_figures(dented)
    assert found["shown_11_mm"] == pytest.approx(found["shown_mm"], abs=0.3)
    assert found["shown_41_mm"] <= found["depth_mm"] + 0.1
    assert found["shown_41_mm"] >= found["shown_11_mm"] - 0.05
    assert found["extent_mm"] > 0.0


def test_the_papers_peaks_are_at_whole_pixels_and_its_product_is_near_the_true_one(dented: Traced) -> None:
    assert dented.exact is not None
    assert dented.paper is not None
    seen = dented.paper.profiles.seen & (dented.paper.profiles.product > 0)
    x_px = dented.paper.profiles.x_px[seen]
    assert (x_px == np.round(x_px)).all()
    tops = [float(np.nanmax(one.profiles.xyz_mm[..., 2])) for one in (dented.exact, dented.paper)]
    assert tops[0] == pytest.approx(tops[1], abs=1.5)


def row(seed: int, kind: str, shown_mm: float, **features: float) -> Row:
    return Row(seed, "", kind, "", features, {"paper": "good"}, {"shown_mm": shown_mm}, {})


def test_limits_lie_beyond_all_good_ones_and_rules_say_the_same() -> None:
    rows = [row(k, "none", 0.0, hollow=0.01 * k, turn=1.0) for k in range(20)]
    rows += [row(50 + k, "dented", 2.0, hollow=2.0 + k, turn=1.0) for k in range(8)]
    rows += [row(80 + k, "bent", 2.0, hollow=0.0, turn=9.0 + k) for k in range(8)]
    limits = fitted_limits(rows)
    by_limits, by_rules = ShapeLimits(limits), FuzzyRules(rules_of(limits))
    for one in rows:
        assert by_limits.judge(one.features).label == one.name
        assert by_rules.judge(one.features).label == one.name


def test_scores_count_unknown_as_neither() -> None:
    judged = [
        Judged(row(1, "none", 0.0), GOOD, 1.0),
        Judged(row(2, "none", 0.0), "unknown", float("nan")),
        Judged(row(3, "dented", 2.0), "fold", 0.5),
        Judged(row(4, "dented", 2.0), "dent", 0.9),
        Judged(row(5, "dented", 0.2), GOOD, 0.9),
    ]
    found = score_of(judged)
    assert (found.good, found.kept, found.shown, found.caught, found.named) == (2, 1, 2, 2, 1)
    assert (found.deformed, found.caught_of_all, found.unknown) == (3, 2, 1)
    assert found.balanced == 0.75


def test_a_confusion_leaves_out_what_does_not_occur() -> None:
    found = Counter({("bent", "good"): 2, ("bent", "bend"): 1, ("good", "good"): 3})
    text = confusion(found, ["good", "dent", "bend"], "x", ["good", "dented", "bent"])
    assert text.splitlines() == [
        "| x | good | bend |",
        "| --- | --- | --- |",
        "| good | 3 | · |",
        "| bent | 2 | 1 |",
    ]
