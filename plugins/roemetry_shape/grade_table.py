"""Classes of a buyer: over shape, size, weight and colour; the first that a product fits wins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from roemetry.errors import MisfitError
from roemetry.records import Decision, Grade, Product, Reason, Volume, Weight
from roemetry.stages import Capabilities, Grader, StageOptions
from roemetry_shape.quantities import Quantities, needed_for
from roemetry_shape.table_faults import faults_of

UNDECIDED = "undecided"

Std = Annotated[float, Field(gt=0.0, le=1e9)]
Verdict = Literal["in", "out", "open"]


class Limits(BaseModel):
    """A range of one quantity; the lower end belongs to it, the upper does not."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at_least: float | None = Field(default=None, ge=-1e9, le=1e9, description="from this on, in its unit")
    below: float | None = Field(default=None, ge=-1e9, le=1e9, description="and below this")

    @model_validator(mode="after")
    def _is_a_range(self) -> Limits:
        if self.at_least is None and self.below is None:
            raise ValueError("neither at_least nor below is given")
        if self.at_least is not None and self.below is not None and self.at_least >= self.below:
            raise ValueError(f"nothing is at least {self.at_least:g} and below {self.below:g}")
        return self


class GradeClass(BaseModel):
    """One class: what a product of it is like."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(min_length=1, description="its name")
    lane: str = Field(default="", description="where its products go: a belt, a bin")
    shape: tuple[str, ...] = Field(default=(), description="classes of the classifier it takes; none: any")
    limits: dict[str, Limits] = Field(
        default_factory=dict, description="range by quantity: `at_least`, `below`"
    )


class GradeTableOptions(StageOptions):
    """Options of `GradeTable`."""

    classes: tuple[GradeClass, ...] = Field(
        min_length=1,
        description="in order, the first that fits wins: `label`, `lane`, `shape`, `limits`",
    )
    guard_factor: float = Field(
        default=1.65,
        ge=0.0,
        le=10.0,
        description="guard band at each limit, in standard uncertainties; 1.65: 95 % of one side; 0: none",
    )
    shape_probability_min: float = Field(
        default=0.95, ge=0.0, le=1.0, description="a class of shape less likely than this is not sure"
    )
    std: dict[str, Std] = Field(
        default_factory=dict,
        description="standard uncertainty by quantity, in its unit, where the run states none",
    )
    unproven: Literal["undecided", "next"] = Field(
        default="undecided",
        description="where several classes are possible: say `undecided`, or take the `next` that is sure",
    )
    undecided_lane: str = Field(default="", description="where undecided products go")
    overlaps: Literal["refuse", "first-wins"] = Field(
        default="refuse", description="what of two classes that share products and neither holds the other"
    )

    @model_validator(mode="after")
    def _is_whole(self) -> GradeTableOptions:
        ranges = [
            {
                name: (
                    -math.inf if limits.at_least is None else limits.at_least,
                    math.inf if limits.below is None else limits.below,
                )
                for name, limits in row.limits.items()
            }
            for row in self.classes
        ]
        found = faults_of(
            [row.label for row in self.classes],
            ranges,
            [row.shape for row in self.classes],
            overlaps_are_faults=self.overlaps == "refuse",
        )
        named = {name for row in self.classes for name in row.limits}
        found += [(("std", name), "no class has a limit on it") for name in self.std if name not in named]
        if found:
            raise MisfitError(*found)
        return self


class GradeTable(Grader[GradeTableOptions]):
    """Goes down a buyer's table and takes the first class that a product fits.

    A limit is kept, or broken, only if the value lies off it by more than the guard band, which is
    `guard_factor` standard uncertainties wide (the decision rule of ISO 14253-1, for every limit alike).
    Between, the limit is open: the product may be of this class, or of one below.
    """

    Options: ClassVar[type[StageOptions]] = GradeTableOptions
    capabilities = Capabilities(fixture="roemetry_shape.example_table:table_options")

    def needs(self) -> frozenset[str]:
        """Name the stages whose results the table asks for."""
        kinds = {needed_for(name) for row in self.options.classes for name in row.limits}
        if any(row.shape for row in self.options.classes):
            kinds.add("classifier")
        return frozenset(kinds - {""})

    def decide(
        self, product: Product, volume: Volume | None, weight: Weight | None, grade: Grade | None
    ) -> Decision:
        """Give the class, and for each class that was asked about why it is or is not this one."""
        found = Quantities(product, volume, weight, grade, self.options.std)
        said: list[Reason] = []
        possible: list[GradeClass] = []
        proven: GradeClass | None = None
        for row in self.options.classes:
            verdict, why = self._asked(row, found)
            if verdict == "out":
                said.append(Reason("class-refused", f"{row.label}: {why}"))
                continue
            possible.append(row)
            if verdict == "in":
                proven = row
                said.append(Reason("class-proven", f"{row.label}: {why}"))
                break
            said.append(Reason("class-open", f"{row.label}: {why}"))
        chosen = possible[0] if len(possible) == 1 else None
        if chosen is not None and chosen is not proven:
            said.append(Reason("class-left", f"{chosen.label}: every other class is ruled out"))
        if chosen is None and proven is not None and self.options.unproven == "next":
            chosen = proven
            passed = ", ".join(row.label for row in possible if row is not proven)
            said.append(Reason("taken-unproven", f"{proven.label} is sure, {passed} would be possible"))
        return Decision(
            label=UNDECIDED if chosen is None else chosen.label,
            lane=self.options.undecided_lane if chosen is None else chosen.lane,
            possible=tuple(dict.fromkeys(row.label for row in possible)),
            reasons=(*said, *_not_guarded(found, self.options.guard_factor)),
        )

    def _asked(self, row: GradeClass, found: Quantities) -> tuple[Verdict, str]:
        """Say whether a product is of a class, and by what."""
        asked = [_shape(row.shape, found.grade, self.options.shape_probability_min)] if row.shape else []
        factor = self.options.guard_factor
        asked += [_limit(name, limits, found, factor) for name, limits in row.limits.items()]
        for wanted in ("out", "open"):
            for verdict, why in asked:
                if verdict == wanted:
                    return verdict, why
        return "in", "; ".join(why for _, why in asked) or "it asks for nothing"


def _shape(wanted: tuple[str, ...], grade: Grade | None, probability_min: float) -> tuple[Verdict, str]:
    asked = " or ".join(wanted)
    if grade is None or grade.label == "unknown":
        return "open", f"the shape is not known, {asked} is asked"
    is_wanted, sure = grade.label in wanted, _sure(wanted, grade)
    if not math.isnan(sure) and (sure if is_wanted else 1.0 - sure) < probability_min:
        return "open", f"the shape is {grade.label}, {asked} has a probability of {sure:.2f}"
    return ("in" if is_wanted else "out"), f"the shape is {grade.label}" + (
        "" if is_wanted else f", {asked} is asked"
    )


def _sure(wanted: tuple[str, ...], grade: Grade) -> float:
    """Probability that the shape is one of those wanted; NaN where it is not modelled."""
    if math.isnan(grade.probability):
        return math.nan
    if grade.label in wanted:
        others = [label for label in wanted if label != grade.label]
        return min(1.0, grade.probability + sum(_of(grade.features, label) for label in others))
    named = [_of(grade.features, label) for label in wanted]
    return (
        sum(named)
        if any(f"probability_{label}" in grade.features for label in wanted)
        else (1.0 - grade.probability)
    )


def _of(features: Mapping[str, float], label: str) -> float:
    return features.get(f"probability_{label}", 0.0)


def _limit(name: str, limits: Limits, found: Quantities, factor: float) -> tuple[Verdict, str]:
    value, std = found.value(name), found.std(name)
    if math.isnan(value):
        return "open", found.why_missing(name)
    guard = 0.0 if math.isnan(std) else factor * std
    at_least = -math.inf if limits.at_least is None else limits.at_least
    below = math.inf if limits.below is None else limits.below
    is_said = f"{name} is {value:.4g}" + ("" if math.isnan(std) else f" ± {std:.2g}")
    if value + guard < at_least or value - guard >= below:
        return "out", f"{is_said}, {_range(limits)} is asked"
    if value - guard >= at_least and value + guard < below:
        return "in", f"{is_said}, {_range(limits)} is kept"
    return "open", f"{is_said}, too close to {_range(limits)} to tell"


def _range(limits: Limits) -> str:
    parts = [] if limits.at_least is None else [f"at least {limits.at_least:g}"]
    return " and ".join(parts + ([] if limits.below is None else [f"below {limits.below:g}"]))


def _not_guarded(found: Quantities, factor: float) -> tuple[Reason, ...]:
    if not found.without_std or factor == 0.0:
        return ()
    names = ", ".join(found.without_std)
    return (
        Reason("guard-not-stated", f"no uncertainty is stated of {names}: compared without a guard band"),
    )
