"""Products that are not skeins: a classifier that learned from skeins must say that it does not know them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.grading.judges import GOOD
from benchmarks.grading.scores import UNKNOWN
from benchmarks.tables import kept_rows, share, table
from benchmarks.traced import traced
from benchmarks.traced.tables import SMOOTHING_MM
from roemetry.errors import RoemetryError
from roemetry_shape.features import shape_of
from roemetry_shape.learned import Learned, LearnedOptions
from roemetry_tools.compare.agreement import wilson

NOT_SEEN = ("whole cylinder", "sloping block", "single step", "cap of a ball", "ball-bar")
"""Kinds that no measure was chosen with an eye on; the others had been tried, of other sizes and seeds."""

_NOTHING = "nothing"
_LIES = {"turn_range_deg": 15.0, "offset_range_x_mm": 5.0, "offset_range_y_mm": 6.0}


class Size(NamedTuple):
    """Of a product as large as a skein, mm."""

    length: float
    width: float
    height: float


Options = Callable[[Size], Mapping[str, Any]]

UNSEEN: Mapping[str, tuple[str, Options]] = {
    "potato": ("potato", lambda size: {}),
    "fillet": ("fillet", lambda size: {}),
    "bread-roll": ("bread-roll", lambda size: {}),
    "egg": ("egg", lambda size: {}),
    "half cylinder": ("cylinder", lambda size: {"length_mm": size.length, "radius_mm": size.width / 2}),
    "whole cylinder": (
        "cylinder",
        lambda size: {"length_mm": size.length, "radius_mm": size.height / 2, "half": False},
    ),
    "block": (
        "block",
        lambda size: {"length_mm": size.length, "width_mm": size.width, "height_mm": size.height},
    ),
    "wedge": (
        "wedge",
        lambda size: {"length_mm": size.length, "width_mm": size.width, "high_height_mm": size.height},
    ),
    "sloping block": (
        "wedge",
        lambda size: {
            "length_mm": size.length,
            "width_mm": size.width,
            "low_height_mm": 0.5 * size.height,
            "high_height_mm": size.height,
        },
    ),
    "single step": (
        "staircase",
        lambda size: {
            "steps": 2,
            "tread_mm": size.length / 2,
            "riser_mm": size.height / 2,
            "width_mm": size.width,
        },
    ),
    "staircase": (
        "staircase",
        lambda size: {
            "tread_mm": size.length / 5,
            "riser_mm": size.height / 5,
            "width_mm": size.width,
        },
    ),
    "truncated-pyramid": (
        "truncated-pyramid",
        lambda size: {"length_mm": size.length, "width_mm": size.width, "height_mm": size.height},
    ),
    "ball": ("sphere", lambda size: {"radius_mm": size.width / 2}),
    "cap of a ball": (
        "sphere",
        # Half a length wide at its foot: r² = (r − h)² + foot².
        lambda size: {
            "radius_mm": ((0.25 * size.length) ** 2 + size.height**2) / (2 * size.height),
            "height_mm": size.height,
        },
    ),
    "ball-bar": (
        "ball-bar",
        lambda size: {
            "ball_radius_mm": size.height / 2,
            "centre_distance_mm": size.length - size.height,
            "rod_radius_mm": 0.35 * size.height,
        },
    ),
}
"""Family and options by name: foods as they are simulated; bodies of geometry as large as a skein."""


def unseen_products(model: Path, seeds: Sequence[int], cache: Path) -> str:
    """Write what the model says of products of other families, on rigs about the recipe's."""
    learned = Learned(LearnedOptions(model=model))
    wanted = itertools.product(UNSEEN, seeds)
    known = kept_rows(cache / "unseen_products.jsonl", wanted, lambda key: features_of(*key))
    rows: list[list[str]] = []
    found = {True: (0, 0), False: (0, 0)}
    for name in UNSEEN:
        said = Counter(_said(learned, known[name, seed]) for seed in seeds)
        asked, unknown, seen = said.total() - said[_NOTHING], said[UNKNOWN], name not in NOT_SEEN
        named = {label: n for label, n in said.items() if label not in (UNKNOWN, GOOD, _NOTHING)}
        others = ", ".join(f"{n} {label}" for label, n in sorted(named.items())) or "·"
        rows.append([name, "yes" if seen else "no", str(asked), str(unknown), str(said[GOOD] or "·"), others])
        found[seen] = (found[seen][0] + unknown, found[seen][1] + asked)
    head = ("product", "kind was tried", "judged", "unknown", "called good", "called a defect")
    text = _TEXT.format(n=len(seeds), first=seeds[0], last=seeds[-1])
    return "\n".join(["", text, table(head, rows), _whole(found[True], found[False])])


def _whole(tried: tuple[int, int], new: tuple[int, int]) -> str:
    ends = [wilson(*part) for part in (tried, new)]
    words = [f"{100 * end.low:.1f} to {100 * end.high:.1f} %" for end in ends]
    return (
        f"Unknown are {share(*tried)} of kinds that had been tried ({words[0]}),\n"
        f"and {share(*new)} of those that had not ({words[1]}).\n"
    )


def features_of(name: str, seed: int) -> dict[str, float]:
    """Measure a product of no known kind; empty where it was refused, or too few stripes met it."""
    family, options = UNSEEN[name]
    sizes = np.random.default_rng([seed, 3]).uniform((70.0, 20.0, 10.0), (105.0, 34.0, 20.0))
    lies = {} if family in ("potato", "fillet", "bread-roll", "egg") else _LIES
    try:
        one = traced(seed, family=family, options={**lies, **options(Size(*sizes.tolist()))})
    except RoemetryError:
        return {}
    return {} if one.exact is None else shape_of(one.exact, SMOOTHING_MM).features


def _said(learned: Learned, features: dict[str, float]) -> str:
    """Give the label; `_NOTHING` where there was nothing to judge."""
    return learned.judge(features).label if features else _NOTHING


_TEXT = """\
## Products that are not skeins

`learned`, {n} products of each kind, seeds {first} to {last}, on rigs about the recipe's. Foods are as they
are simulated; bodies of geometry have lengths, widths and heights drawn from those of skeins (70 to 105,
20 to 34, 10 to 20 mm), and lie as skeins do. Those that the coder refused, or that fewer than three stripes
met, were not judged: no class of them is stated. While the measures and the features were
chosen, products of seeds 64000 to 64023 were looked at, bodies of geometry in one size.
"""
