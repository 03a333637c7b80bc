"""Classes by a fuzzy rule base over features (Zadeh 1965; Mamdani and Assilian 1975).

Model. A term is a word about one feature, whose truth is a polygon over the feature's values, constant beyond
its ends. Then

    truth(not t)  = 1 − truth(t)
    truth(rule)   = min over its terms
    truth(class)  = max over its rules

and the truest class is the answer. It is `unknown` where no class reaches `truth_min`, where the second is
more than half as true as the first, and where two standard uncertainties of one feature make another class
truest.

Assumed: the terms are right for the population and the rig; nothing is learned. A truth is not a probability.
It fails where a feature cannot be measured: its terms are then false, and what a rule asks not to be is true.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roemetry.records import Grade, Product, Reason, Relief
from roemetry.stages import Classifier, StageOptions
from roemetry_shape.features import SMOOTHING_MM, shape_features, shape_of
from roemetry_shape.product_frame import decisive_feature

UNKNOWN = "unknown"
_NEARLY = 0.5
"""Of the truest class's truth: another so true could as well be meant, were a feature off by its noise."""
_FEW = "fewer than three stripes show a cross-section: there is no shape to judge"
_NOT = "not "

Place = Annotated[float, Field(ge=-1e9, le=1e9)]
Degree = Annotated[float, Field(ge=0.0, le=1.0)]


class Term(BaseModel):
    """A word about a feature: how true it is at each value."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    feature: str = Field(description="name of the feature")
    points: tuple[tuple[Place, Degree], ...] = Field(
        min_length=2, description="(value, degree of truth), straight lines between, constant beyond"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Term:
        places = [place for place, _ in self.points]
        if any(b <= a for a, b in itertools.pairwise(places)):
            raise ValueError(f"the points of a term on {self.feature} do not rise: {places}")
        return self


class Rule(BaseModel):
    """If all of these terms hold, it is this class."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    when: tuple[str, ...] = Field(min_length=1, description="terms, each maybe with `not ` before it")
    label: str = Field(min_length=1, description="the class")


class FuzzyRulesOptions(StageOptions):
    """Options of `FuzzyRules`."""

    smoothing_mm: float = Field(
        default=SMOOTHING_MM, ge=0.0, le=50.0, description="window that smooths each curve first, mm; 0: none"
    )
    terms: dict[str, Term] = Field(default_factory=dict, description="words: `feature` and `points`")
    rules: tuple[Rule, ...] = Field(default=(), description="rules: `when` (terms) and `label`")
    truth_min: float = Field(
        default=0.3, ge=0.0, le=1.0, description="a class less true than this is not stated: unknown"
    )

    @model_validator(mode="after")
    def _known(self) -> FuzzyRulesOptions:
        for rule in self.rules:
            for word in rule.when:
                name = word.removeprefix(_NOT)
                if name not in self.terms:
                    known = ", ".join(self.terms) or "none"
                    raise ValueError(f"a rule for {rule.label} uses the term {name!r}; there are {known}")
        return self


class FuzzyRules(Classifier[FuzzyRulesOptions]):
    """Calls a product by the class whose rules are truest (Zadeh 1965; Mamdani and Assilian 1975).

    A term's truth is read off its straight lines; ``not`` is 1 − truth; a rule is as true as its least true
    term, a class as its truest rule. ``unknown`` is the answer where no class is true enough, or where the
    second is more than half as true as the first, or where a feature's own uncertainty makes another truest.
    """

    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Judge by rules; `rng` is not used: rules do not err."""
        del rng
        return self.judge(shape_features(product, self.options.smoothing_mm))

    def relief(self, product: Product) -> Relief | None:
        """Give the surface that the features were read off."""
        return shape_of(product, self.options.smoothing_mm).relief

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge features that were measured already."""
        if not features:
            return Grade(UNKNOWN, reasons=(Reason("too-few-sections", _FEW),))
        # a rule that cannot be read would count as false and another class might win by it
        missing = sorted({term.feature for term in self.options.terms.values()} - set(features))
        if missing:
            why = f"there is no feature {missing[0]}; there are {', '.join(sorted(features))}"
            return Grade(UNKNOWN, features=features, reasons=(Reason("no-such-feature", why),))
        truths = self._truths(features)
        told = {**features, **{f"truth_{label}": truth for label, truth in truths.items()}}
        ranked = sorted(truths.items(), key=lambda item: -item[1])
        if not ranked or ranked[0][1] < self.options.truth_min:
            why = f"no class is true to {self.options.truth_min:g}"
            return Grade(UNKNOWN, features=told, reasons=(Reason("no-rule-holds", why),))
        if len(ranked) > 1 and ranked[1][1] > _NEARLY * ranked[0][1]:
            why = " and ".join(f"{name} ({value:.2f})" for name, value in ranked[:2]) + " are nearly as true"
            return Grade(UNKNOWN, features=told, reasons=(Reason("rules-tie", why),))
        label, truth = ranked[0]
        # every feature that a term names may tip the balance, not only the winner's
        doubt = decisive_feature(
            features, {term.feature for term in self.options.terms.values()}, label, self._truest
        )
        if doubt is not None:
            return Grade(UNKNOWN, features=told, reasons=(doubt,))
        said = ", ".join(f"{name} {value:.2f}" for name, value in ranked[:3])
        return Grade(label, features=told, reasons=(Reason("rule-holds", f"true to {truth:.2f}: {said}"),))

    def _truest(self, features: Mapping[str, float]) -> str:
        truths = self._truths(features)
        return max(truths, key=lambda name: truths[name])

    def _truths(self, features: Mapping[str, float]) -> dict[str, float]:
        terms = {name: _truth(term, features[term.feature]) for name, term in self.options.terms.items()}
        truths: dict[str, float] = {}
        for rule in self.options.rules:
            each = [
                # Zadeh's complement
                1.0 - terms[word.removeprefix(_NOT)] if word.startswith(_NOT) else terms[word]
                for word in rule.when
            ]
            # all terms of a rule must hold (the least counts), one rule of a class suffices (the largest
            # counts)
            truths[rule.label] = max(truths.get(rule.label, 0.0), min(each))
        return truths


def _truth(term: Term, value: float) -> float:
    if math.isnan(value):
        # a value that is not known makes its term false, and `not` the term true
        return 0.0
    places, degrees = zip(*term.points, strict=True)
    return float(np.interp(value, places, degrees))
