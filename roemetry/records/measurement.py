"""What a product is found to be (volume, weight, grade, decision), and its row in the record of a run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from roemetry.errors import DataError, RecordError
from roemetry.io.files import first_fault, json_values
from roemetry.records.arrays import Checker, Flags, Floats, Integers, Number
from roemetry.records.display import Shown, estimate, picture_of_surface, table
from roemetry.records.reasons import Reason


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ReliefMap(Shown):
    """One number at each place of a relief."""

    title: str
    unit: str
    """title, unit: what it is; unit "" for a pure number."""
    values: Floats
    """(section, sample) NaN where it is not known."""
    about_zero: bool = False
    """Whether its sign matters: colours then part at zero."""
    full_scale: float = 0.0
    """Colours reach at least so far: what is small beside it looks pale."""
    arrows: Floats | None = None
    """(section, sample, 2) a direction at each place, of length 1 at most, belt frame: for a normal what it
    has along X and Y. None: there is none to draw."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ReliefRegion(Shown):
    """A dent or a hump."""

    kind: str
    depth_mm: float
    area_mm2: float
    xy_mm: Floats
    """(2,) where it is deepest, belt frame, mm."""
    cells: Integers
    """(cell, 2) section and sample of the relief's places in it."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Relief(Shown):
    """A product's surface over the belt, in sections from edge to edge."""

    xy_mm: Floats
    """(section, sample, 2) places, belt frame, mm."""
    middle_mm: Floats
    """(section, 2) middle of each section: the mid-line, mm."""
    maps: tuple[ReliefMap, ...] = ()
    regions: tuple[ReliefRegion, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)
    """Sizes to write beside it, by name, units in the names."""

    def __post_init__(self) -> None:
        check = Checker(self)
        sections, samples, _ = check.array("xy_mm", np.float64, (None, None, 2)).shape
        check.array("middle_mm", np.float64, (sections, 2))
        for shown in self.maps:
            fits = shown.values.shape == (sections, samples)
            check.require(fits, f"the map {shown.title} has another shape")
            fits = shown.arrows is None or shown.arrows.shape == (sections, samples, 2)
            check.require(fits, f"the arrows of the map {shown.title} have another shape")
        check.finish()


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard uncertainty (VIM 2.30) and the uncertainty's parts by cause.

    The unit stands in the name of the field that holds the estimate. NaN in `std` means "not stated".
    `interval` holds the true value in 95 % of cases; NaN where the uncertainty is not stated.
    """

    value: Number
    std: Number = math.nan
    budget: Mapping[str, Number] = field(default_factory=dict)
    interval: tuple[Number, Number] = (math.nan, math.nan)

    def __post_init__(self) -> None:
        check = Checker(self)
        check.require(not math.isinf(self.value), f"the value is {self.value}, expected a number, or NaN")
        parts = {"std": self.std, **self.budget}
        bad = [f"{name} {part}" for name, part in parts.items() if part < 0.0 or math.isinf(part)]
        check.require(not bad, f"uncertainties must be 0 or more, or NaN: {', '.join(bad)}")
        low, high = self.interval
        check.require(not low > high, f"the interval {self.interval} ends before it begins")
        outside = self.value < low or self.value > high
        check.require(not outside, f"the value {self.value} lies outside its interval {self.interval}")
        check.finish()


@dataclass(frozen=True, slots=True)
class Shares:
    """Shares of a volume, adding up to 1."""

    seen: Number
    """Carried by points at which a stripe was seen."""
    interpolated: Number
    """Carried by points bridged between seen ones of the same stripe."""
    assumed: Number
    """Carried by no point of the stripe it is reckoned for: an end cap, a dead stripe, an underside."""

    def __post_init__(self) -> None:
        check = Checker(self)
        parts = (self.seen, self.interpolated, self.assumed)
        within = (
            all(-_ROUNDING <= part <= 1.0 + _ROUNDING for part in parts)
            and abs(sum(parts) - 1.0) <= _ROUNDING
        )
        check.require(within or any(map(math.isnan, parts)), f"shares {parts} do not add up to 1")
        check.finish()


_ROUNDING = 1e-6  # shares add up to 1 within what their sum rounds by


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Volume(Shown):
    """Volume of one product."""

    visible_mm3: Estimate
    """Integral of the top surface's height over the vertical footprint on the belt, mm³ (undercuts and air
    below count as filled)."""
    true_mm3: Estimate | None
    """Volume of the closed body, mm³, or None where the estimator cannot know it."""
    shares: Shares
    """What of the visible volume was seen, interpolated and assumed."""
    slice_stripe: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    slice_area_mm2: Floats = field(default_factory=lambda: np.empty(0))
    slice_spacing_mm: Floats = field(default_factory=lambda: np.empty(0))
    """slice_stripe, slice_area_mm2, slice_spacing_mm: (slice,) the slices the estimator summed, where it did:
    stripe, area of the cross-section, and the distance the area was held over."""
    reasons: tuple[Reason, ...] = ()
    solution: Any = None
    """Of the estimator: what its `redraw` begins with. It is not in the record of a run."""

    def __post_init__(self) -> None:
        check = Checker(self)
        slices = check.array("slice_stripe", np.int64, (None,)).shape[0]
        check.array("slice_area_mm2", np.float64, (slices,))
        check.array("slice_spacing_mm", np.float64, (slices,))
        for name, volume in (("visible", self.visible_mm3), ("true", self.true_mm3)):
            if volume is not None:
                _require_amount(check, f"{name} volume", "mm³", volume.value, self.reasons)
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Surface(Shown):
    """The top surface a volume was integrated under, as a grid for drawings."""

    xyz_mm: Floats
    """(station, point, 3) belt frame, mm: stations follow the product, points run across it from border to
    border. NaN where the product has a gap."""
    assumed: Flags
    """(station, point) True where no stripe was seen that the surface could rest on."""

    def __post_init__(self) -> None:
        check = Checker(self)
        xyz = check.array("xyz_mm", np.float64, (None, None, 3))
        check.array("assumed", np.bool_, xyz.shape[:2])
        check.finish()


@dataclass(frozen=True, slots=True)
class Weight:
    """Mass of one product, grams, and how it was reckoned.

    `features` holds the numbers besides the volume that it rests on, each with its unit in the name.
    """

    mass_g: Estimate
    reasons: tuple[Reason, ...] = ()
    features: Mapping[str, Number] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check = Checker(self)
        _require_amount(check, "mass", "g", self.mass_g.value, self.reasons)
        _require_no_infinite(check, self.features)
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ImageArrows(Shown):
    """Evidence that can be drawn over the image: arrows from a place to a place, px in the turned image."""

    kind: str
    """What an arrow is, in words, e.g. ``centre of arc``."""
    unit: str
    stripe: Integers
    """(arrow,) stripe the evidence lies on."""
    from_px: Floats
    to_px: Floats
    """from_px, to_px: (arrow, 2) x and y of the arrow's ends."""
    value: Floats
    """(arrow,) the number behind the arrow; its unit stands in `unit`."""
    flagged: Flags
    """(arrow,) True where this piece of evidence speaks against the product."""

    def __post_init__(self) -> None:
        check = Checker(self)
        n = check.array("stripe", np.int64, (None,)).shape[0]
        check.array("from_px", np.float64, (n, 2))
        check.array("to_px", np.float64, (n, 2))
        check.array("value", np.float64, (n,))
        check.array("flagged", np.bool_, (n,))
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Grade(Shown):
    """Class of one product."""

    label: str
    """The class, or ``unknown``: an answer every classifier may give."""
    probability: Number = math.nan
    """That the label is right, 0…1; NaN where it is not modelled."""
    features: Mapping[str, Number] = field(default_factory=dict)
    """The numbers the decision rests on, each with its unit in the name."""
    reasons: tuple[Reason, ...] = ()
    arrows: ImageArrows | None = None
    features_std: Mapping[str, Number] = field(default_factory=dict)
    """Standard uncertainties of features, by name; a feature that is not in it has none stated."""
    relief: Relief | None = None
    """The surface to draw; like arrows, not in the record of a run."""

    def __post_init__(self) -> None:
        check = Checker(self)
        check.require(bool(self.label.strip()), "the label is empty; a class that is not known is `unknown`")
        within = math.isnan(self.probability) or 0.0 <= self.probability <= 1.0
        check.require(within, f"the probability is {self.probability}, expected 0…1, or NaN")
        _require_no_infinite(check, self.features)
        _require_no_infinite(check, self.features_std)
        check.finish()


@dataclass(frozen=True, slots=True)
class Decision:
    """What is to be done with one product."""

    label: str
    """The buyer's class, or ``undecided`` where the uncertainty leaves several."""
    lane: str = ""
    """Where the product is to go: a belt, a bin; "" where the table does not say."""
    possible: tuple[str, ...] = ()
    """The classes it may be of; one where it is decided."""
    reasons: tuple[Reason, ...] = ()
    """Why, a code and a sentence for each class that was asked about."""


def _require_amount(check: Checker, name: str, unit: str, value: Number, reasons: tuple[Reason, ...]) -> None:
    """Require that an amount is not negative, and that there is a reason where it is NaN."""
    check.require(not value < 0.0, f"the {name} is {value:g} {unit}, less than nothing")
    check.require(bool(reasons) or not math.isnan(value), f"the {name} is NaN, and no reason says why")


def _require_no_infinite(check: Checker, features: Mapping[str, Number]) -> None:
    """Require that features are numbers, or NaN."""
    if any(map(math.isinf, features.values())):  # each row of a record comes by here
        bad = ", ".join(name for name, value in features.items() if math.isinf(value))
        check.require(False, f"infinite: {bad}")


Status = Literal["measured", "empty", "failed"]
_UNKNOWN = Estimate(math.nan)
_ORDER = (
    *("id", "acquisition", "product", "products", "status", "decision", "grade", "weight", "volume"),
    *("height_max_mm", "coding", "absent", "reasons", "provenance"),
)
"""The fields of a line: first what a person looks for."""


@dataclass(frozen=True, slots=True)
class Coding:
    """How well the stripes of the acquisition were found and labelled."""

    stripes: int
    stripes_seen: int
    """Number of stripes with at least one peak."""
    peaks: int
    labelled: int
    ambiguous: int
    unlabelled: int
    """peaks, labelled, ambiguous, unlabelled: peaks extracted; of them with a stripe; with several possible
    stripes; with none."""
    rows_seen: int
    rows_interpolated: int
    """rows_seen, rows_interpolated: (stripe, row) cells on this product with a seen point and with a bridged
    one. Without a product (an uncalibrated run, an empty belt) those of everything that is not belt."""
    saturated_share: Number = math.nan
    displacement_max_px: Number = math.nan
    """Largest displacement from the rest line on the product, px, with its sign; NaN where unknown."""
    motion_px: tuple[float, ...] = ()
    """What shift, roll, zoom and tilt of the camera since the calibration do at the image's edge, px, as
    the aligner found them, corrected or not; empty without one."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Measurement(Shown):
    """All that was found of one product."""

    id: str
    """``<acquisition>#<product>``; ``#0`` where the acquisition gave no product."""
    acquisition: str
    product: int
    """acquisition, product: id of the acquisition; number of the product, 0 for none."""
    status: Status
    """``measured``: what the recipe asked for is there, or stands in `absent` with a reason. ``empty``: the
    image was read and labelled, and shows no product. ``failed``: it could not be measured."""
    products: int = 1
    """Number of rows this acquisition has in the record."""
    coding: Coding | None = None
    """How the stripes were found; None where extraction or coding failed."""
    height_max_mm: Estimate = _UNKNOWN
    """Largest height of a point above the belt, mm; its value is NaN where unknown."""
    volume: Volume | None = None
    weight: Weight | None = None
    grade: Grade | None = None
    absent: Mapping[str, Reason] = field(default_factory=dict)
    """By stage kind, why its result is missing."""
    reasons: tuple[Reason, ...] = ()
    """What must be known to believe the numbers."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Hashes of recipe, calibration and image, and version of every plugin that had a part."""
    decision: Decision | None = None
    seen_xyz_mm: Any = field(default=None, repr=False)
    """Points that were seen, mm, (slice, point, 3), which a notebook draws: all from `Recipe.measure`, a
    coarse grid of them from `Recipe.run`, None from a record."""

    @property
    def all_reasons(self) -> tuple[Reason, ...]:
        """Every reason on this row, each once: its own, then volume's, weight's, grade's, decision's."""
        parts = (self, self.volume, self.weight, self.grade, self.decision)
        return tuple(dict.fromkeys(reason for part in parts if part is not None for reason in part.reasons))

    def _repr_html_(self) -> str:
        """Give the numbers that a person looks for, as a table for notebooks."""
        rows = [("status", str(self.status)), ("height, mm", estimate(self.height_max_mm))]
        if self.volume is not None:
            rows.append(("visible volume, cm³", estimate(self.volume.visible_mm3, scale=1e-3)))
            rows.append(("true volume, cm³", estimate(self.volume.true_mm3, scale=1e-3)))
        if self.weight is not None:
            rows.append(("mass, g", estimate(self.weight.mass_g)))
        if self.grade is not None:
            likely = (
                "" if math.isnan(self.grade.probability) else f", probability {self.grade.probability:.2f}"
            )
            rows.append(("grade", self.grade.label + likely))
        if self.decision is not None:
            rows.append(("decision", self.decision.label))
        rows += [(f"no {kind}", reason.text) for kind, reason in self.absent.items()]
        rows += [(reason.code, reason.text) for reason in self.all_reasons]
        picture = "" if self.seen_xyz_mm is None else picture_of_surface(self.seen_xyz_mm)
        return table(self.id, rows, picture)

    def to_json(self) -> str:
        """One line of JSON; NaN is written as null."""
        row = {name: _plain(getattr(self, name)) for name in _ORDER}
        if self.volume is not None:
            volume = row["volume"]
            columns = (volume.pop(f"slice_{name}") for name in _SLICE)
            reasons = volume.pop("reasons")
            volume["slices"] = [dict(zip(_SLICE, one, strict=True)) for one in zip(*columns, strict=True)]
            volume["reasons"] = reasons
        return json.dumps(row, ensure_ascii=False, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Measurement:
        """Read a line that `to_json` wrote, or an older version; arrows are not stored and come back None."""
        try:
            row = _parsed(line)
            if row["coding"] is not None:
                row["coding"] = {_RENAMED.get(name, name): one for name, one in row["coding"].items()}
            if row["volume"] is not None:
                slices = row["volume"].pop("slices")
                row["volume"] |= {
                    f"slice_{name}": [math.nan if one[name] is None else one[name] for one in slices]
                    for name in _SLICE
                }
            found: Measurement = _reader().validate_python(row)
            return found
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, RecordError) as error:
            raise DataError(
                f"not a measurement: {line[:60]!r}… ({first_fault(error)})",
                hint="the line was written by another version of roemetry, or edited by hand",
            ) from error


_SLICE = ("stripe", "area_mm2", "spacing_mm")
_RENAMED = {"coded": "labelled", "uncoded": "unlabelled"}
"""Fields of `Coding` by the names they had in older records, which can still be read."""
_NOT_KEPT = ("arrows", "relief", "solution")
"""What of a grade is drawn, and what an estimator goes on from."""


def _plain(value: Any) -> Any:
    """Make a record the values of its line: reasons last, without what is not kept, NaN as null."""
    kind = type(value)  # compared itself: each row of a run comes by here, number by number
    if kind is float:
        return value if math.isfinite(value) else None
    if kind is str or kind is int or value is None:
        return value
    if kind is Reason:
        return {"code": value.code, "text": value.text}
    if kind is tuple:
        return [_plain(item) for item in value]
    if kind is dict:
        return {key: _plain(item) for key, item in value.items()}
    if is_dataclass(kind):
        return {name: _plain(getattr(value, name)) for name in _names(kind)}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return json_values(value.tolist() if kind is np.ndarray else value)


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(sorted((f.name for f in fields(kind) if f.name not in _NOT_KEPT), key="reasons".__eq__))


def _parsed(line: str) -> Any:
    """Parse a line, four times as fast as Python's own parser does."""
    from pydantic_core import from_json

    try:
        return from_json(line, cache_strings="keys")
    except ValueError:  # half a surrogate pair, which names of files may hold, only Python's takes
        return json.loads(line)


@cache
def _reader() -> Any:
    """Make pydantic's reader of a line when the first one is read: it takes a while."""
    from pydantic import TypeAdapter

    return TypeAdapter(Measurement)
