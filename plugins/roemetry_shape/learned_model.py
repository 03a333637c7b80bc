"""A fitted classifier as a file: the forest, how its shares become probabilities, and what it has seen."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.errors import StageError
from roemetry_shape.forest_file import packed, unpacked
from roemetry_shape.strangeness import Seen, beyond, halves, whole

VERSION = 4
_FOREST = ("feature", "threshold", "left", "right", "shares", "roots")


class Strangeness(NamedTuple):
    """How far a sample is from all that was learned.

    Attributes
    ----------
    value
        As a multiple of what is usual; above 1 it is strange.
    feature, found, low, high
        The feature that lies farthest beyond what was seen, its value, and what was seen; "" and NaN where it
        is all features together that are farther from every class.
    """

    value: float
    feature: str = ""
    found: float = math.nan
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """What `roemetry fit-classifier` found.

    Attributes
    ----------
    features
        Names, in the forest's order.
    fill
        (feature,) median of the samples: stands for a feature that is missing.
    classes
        Names; `good` is one of them, or "".
    good, good_from
        The class of good products, and the least probability of it that is called so.
    sharpness
        Power that turns the forest's shares into probabilities.
    feature, threshold, left, right, shares, roots
        The forest, see `roemetry_kernels.shape.forest`.
    seen
        What the samples of each class look like: how far a product is from all of them.
    distance_max
        Largest such distance that is not yet strange.
    beyond_max
        The same of how far features lie beyond all that were seen.
    smoothing_rows
        How the features were measured.
    """

    features: tuple[str, ...]
    fill: Floats
    classes: tuple[str, ...]
    good: str
    good_from: float
    sharpness: float
    feature: Integers
    threshold: Floats
    left: Integers
    right: Integers
    shares: Floats
    roots: Integers
    seen: Seen
    distance_max: float
    beyond_max: float
    smoothing_rows: int

    def values(self, features: Mapping[str, float]) -> Floats:
        """Put features in the forest's order; NaN where one is missing."""
        return np.array([features.get(name, np.nan) for name in self.features])

    def probabilities(self, values: Floats) -> Floats:
        """(class,) calibrated probabilities of one sample."""
        from roemetry_kernels.shape.forest import forest_shares

        filled = np.where(np.isfinite(values), values, self.fill)
        shares = forest_shares(
            filled, self.feature, self.threshold, self.left, self.right, self.shares, self.roots
        )
        return sharpened(shares, self.sharpness)

    def strangeness(self, values: Floats) -> Strangeness:
        """How far a sample is from all that was learned; above 1 it is strange."""
        filled = np.where(np.isfinite(values), values, self.fill)[None]
        distance = float(self.seen.distances(filled)[0]) / self.distance_max
        excess = self.seen.excess(filled)
        outside = float(beyond(excess)[0]) / self.beyond_max
        if outside <= distance:
            return Strangeness(distance)
        most = int(excess[0].argmax())
        ends = np.sinh([self.seen.low[most], self.seen.high[most]])
        return Strangeness(
            outside, self.features[most], float(filled[0, most]), float(ends[0]), float(ends[1])
        )

    def to_json(self, about: Mapping[str, Any]) -> str:
        """Write the model, with whatever is to be said about it."""
        content = {
            "roemetry_classifier": VERSION,
            "about": dict(about),
            **{name: _plain(value) for name, value in vars(self).items() if name not in (*_FOREST, "seen")},
            "seen": {
                "centres": _plain(self.seen.centres),
                "spread": _plain(self.seen.spread),
                "low": _plain(self.seen.low),
                "high": _plain(self.seen.high),
                "precision": halves(self.seen.precision),
            },
            "forest": packed({name: getattr(self, name) for name in _FOREST}),
        }
        return json.dumps(content, allow_nan=False, separators=(",", ":")) + "\n"

    @classmethod
    def load(cls, path: Path) -> LearnedModel:
        """Read a file; raise StageError where it is none, or damaged."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["roemetry_classifier"] != VERSION:
                raise StageError(f"{path.name}: format {data['roemetry_classifier']}, expected {VERSION}")
            seen = data["seen"]
            forest = unpacked(data["forest"])
            if forest["feature"].max() >= len(data["features"]):
                raise ValueError("a split asks for a feature that is not there")
            return cls(
                features=tuple(data["features"]),
                fill=np.array(data["fill"], np.float64),
                classes=tuple(data["classes"]),
                good=str(data["good"]),
                good_from=float(data["good_from"]),
                sharpness=float(data["sharpness"]),
                distance_max=float(data["distance_max"]),
                beyond_max=float(data["beyond_max"]),
                smoothing_rows=int(data["smoothing_rows"]),
                seen=Seen(
                    np.array(seen["centres"], np.float64),
                    np.array(seen["spread"], np.float64),
                    whole(seen["precision"], len(data["features"])),
                    np.array(seen["low"], np.float64),
                    np.array(seen["high"], np.float64),
                ),
                **forest,
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StageError(
                f"{path.name} is no fitted classifier, or it is damaged: {type(error).__name__}: {error}",
                hint="make it with `roemetry fit-classifier`",
            ) from error


def sharpened(shares: Floats, power: float) -> Floats:
    """Raise class shares to a power and make them add up to 1 again, along the last axis."""
    raised = np.maximum(shares, 1e-6) ** power
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist() if value.dtype.kind == "i" else [_short(row) for row in value.tolist()]
    return list(value) if isinstance(value, tuple) else value


def _short(value: Any) -> Any:
    """Keep six significant digits."""
    return [_short(one) for one in value] if isinstance(value, list) else float(f"{value:.6g}")
