"""Products that are no skeins: a classifier that learned from skeins must say that it does not know them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.grading.judges import GOOD
from benchmarks.grading.scores import UNKNOWN
from benchmarks.grading.words import table
from benchmarks.traced import traced
from benchmarks.traced.tables import SMOOTHING_ROWS
from roemetry.errors import RoemetryError
from roemetry_shape.features import shape_of
from roemetry_shape.learned import Learned, LearnedOptions

FAMILIES = (
    *("potato", "fillet", "bread-roll", "egg", "block", "staircase"),
    *("wedge", "cylinder", "sphere", "truncated-pyramid"),
)
_NOTHING = "nothing"


def strangers(model: Path, seeds: Sequence[int]) -> str:
    """Write what the model says of products of other families, on rigs about the recipe's."""
    learned = Learned(LearnedOptions(model=model))
    rows = []
    for family in FAMILIES:
        said = Counter(_said(learned, seed, family) for seed in seeds)
        asked = said.total() - said[_NOTHING]
        named = {label: n for label, n in said.items() if label not in (UNKNOWN, GOOD, _NOTHING)}
        others = ", ".join(f"{n} {label}" for label, n in sorted(named.items())) or "·"
        rows.append([family, str(asked), str(said[UNKNOWN]), str(said[GOOD] or "·"), others])
    head = ("product", "judged", "unknown", "called good", "called a defect")
    return "\n" + _TEXT.format(n=len(seeds), first=seeds[0], last=seeds[-1]) + "\n" + table(head, rows)


def _said(learned: Learned, seed: int, family: str) -> str:
    """Give the label; `_NOTHING` where the product was refused, or too few stripes met it."""
    try:
        one = traced(seed, "recipe-like", family=family)
    except RoemetryError:
        return _NOTHING
    features = {} if one.exact is None else shape_of(one.exact, SMOOTHING_ROWS).features
    return learned.judge(features).label if features else _NOTHING


_TEXT = """\
## Products that are no skeins

`learned`, {n} products of each family, seeds {first} to {last}, on rigs about the recipe's. Those that the
coder refused, or that fewer than three stripes met, were not judged. How far is too far was chosen on seeds
64000 to 64011. A fillet as it is simulated here, flat, long and smooth, has the cross-sections of a skein:
in features of shape it is none that stands out.
"""
