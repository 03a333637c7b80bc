"""What is learned from: samples whose answer is known, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Products of known class or mass, with their measured features.

    Attributes
    ----------
    ids
        (sample,) of the products.
    groups
        (sample,) what belongs together: samples of one group are never on both sides of a fold.
    features
        Names, units in them.
    values
        (sample, feature) measured; NaN where a feature is missing.
    labels
        (sample,) true classes; empty where masses are learned.
    mass_g, mass_std_g
        (sample,) true masses, grams, and the scale's standard uncertainty; empty where classes are.
    """

    ids: tuple[str, ...]
    groups: tuple[str, ...]
    features: tuple[str, ...]
    values: Floats
    labels: tuple[str, ...] = ()
    mass_g: Floats = field(default_factory=lambda: np.empty(0))
    mass_std_g: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        check = Checker(self)
        count = len(self.ids)
        check.array("values", np.float64, (count, len(self.features)))
        check.require(len(self.groups) == count, "groups and ids differ in number")
        check.require(len(self.labels) in (0, count), "labels and ids differ in number")
        for name in ("mass_g", "mass_std_g"):
            array = check.array(name, np.float64, (None,))
            check.require(array.size in (0, count), f"{name} and ids differ in number")
        check.finish()


@dataclass(frozen=True, slots=True)
class Fitted:
    """What a stage has learned.

    Attributes
    ----------
    content
        Text of the file that the stage's options name.
    figures
        How well it did on folds it had not seen, units in the names.
    words
        What the user must know, in sentences.
    """

    content: str
    figures: Mapping[str, float]
    words: tuple[str, ...] = ()
