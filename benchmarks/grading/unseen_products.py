"""Products that are not skeins: a classifier that learned from skeins must say that it does not know them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.grading.judges import GOOD, UNKNOWN
from benchmarks.tables import kept_rows, share, table
from benchmarks.traced import SMOOTHING_MM, traced
from roemetry.errors import RoemetryError
from roemetry_shape.features import shape_of
from roemetry_shape.learned import Learned, LearnedOptions
from roemetry_tools.compare.agreement import wilson

NOT_SEEN = ("whole cylinder", "sloping block", "single step", "cap of a ball", "ball-bar")
"""Kinds that no measure was chosen with an eye on; the others had been tried, of other sizes and seeds."""

_NOTHING = "nothing"
_LIES = {"turn_range_deg": 15.0, "offset_range_x_mm": 5.0, "offset_range_y_mm": 6.0}


Options = Callable[[float, float, float], Mapping[str, Any]]
"""Of a product as large as a skein: of length, width and height, mm."""
_SIZES = ("length_mm", "width_mm", "height_mm")


def _sized(*names: str) -> Options:
    return lambda *size: dict(zip(names, size, strict=True))


def _same(*_: float) -> Mapping[str, Any]:
    return {}


def _cap(length: float, _: float, height: float) -> Mapping[str, Any]:
    """Half a length wide at its foot: r² = (r − h)² + foot²."""
    return {"radius_mm": ((0.25 * length) ** 2 + height**2) / (2 * height), "height_mm": height}


UNSEEN: Mapping[str, tuple[str, Options]] = {
    "potato": ("potato", _same),
    "fillet": ("fillet", _same),
    "bread-roll": ("bread-roll", _same),
    "egg": ("egg", _same),
    "half cylinder": ("cylinder", lambda a, b, _: {"length_mm": a, "radius_mm": b / 2}),
    "whole cylinder": ("cylinder", lambda a, _, c: {"length_mm": a, "radius_mm": c / 2, "half": False}),
    "block": ("block", _sized(*_SIZES)),
    "wedge": ("wedge", _sized("length_mm", "width_mm", "high_height_mm")),
    "sloping block": (
        "wedge",
        lambda a, b, c: {"length_mm": a, "width_mm": b, "low_height_mm": 0.5 * c, "high_height_mm": c},
    ),
    "single step": (
        "staircase", lambda a, b, c: {"steps": 2, "tread_mm": a / 2, "riser_mm": c / 2, "width_mm": b}
    ),
    "staircase": ("staircase", lambda a, b, c: {"tread_mm": a / 5, "riser_mm": c / 5, "width_mm": b}),
    "truncated-pyramid": ("truncated-pyramid", _sized(*_SIZES)),
    "ball": ("sphere", lambda _, b, __: {"radius_mm": b / 2}),
    "cap of a ball": ("sphere", _cap),
    "ball-bar": (
        "ball-bar",
        lambda a, _, c: {"ball_radius_mm": c / 2, "centre_distance_mm": a - c, "rod_radius_mm": 0.35 * c},
    ),
}  # fmt: skip
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
        f"{share(*tried)} products of kinds used for that choice are `unknown` ({words[0]}),\n"
        f"and {share(*new)} of other kinds ({words[1]}).\n"
    )


def features_of(name: str, seed: int) -> dict[str, float]:
    """Measure a product of no known kind; empty where it was refused, or too few stripes met it."""
    family, options = UNSEEN[name]
    sizes = np.random.default_rng([seed, 3]).uniform((70.0, 20.0, 10.0), (105.0, 34.0, 20.0))
    lies = {} if family in ("potato", "fillet", "bread-roll", "egg") else _LIES
    try:
        one = traced(seed, family=family, options={**lies, **options(*sizes.tolist())})
    except RoemetryError:
        return {}
    return {} if one.exact is None else shape_of(one.exact, SMOOTHING_MM).features


def _said(learned: Learned, features: dict[str, float]) -> str:
    """Give the label; `_NOTHING` where there was nothing to judge."""
    return learned.judge(features).label if features else _NOTHING


_TEXT = """\
## Products that are not skeins

`learned`, {n} products of each kind, seeds {first} to {last}, on rigs similar to the recipe's. Foods are as
simulated; geometric bodies have lengths, widths and heights drawn from the ranges of skeins (70 to 105,
20 to 34, 10 to 20 mm), and lie as skeins do. Products that the coder refused, or that fewer than three
stripes cross, get no class and are not counted. Measures and features were chosen on products of seeds
64000 to 64023, with geometric bodies of one size.
"""
