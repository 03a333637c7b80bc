"""What a product is found to be: volume, weight, grade, each with what it owes its reader."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Flags, Floats, Integers
from roemetry.records.reasons import Reason
from roemetry.records.relief import Relief


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard uncertainty (VIM 2.30) and the uncertainty's parts by cause.

    The unit stands in the name of the field that holds the estimate. NaN in `std` means "not stated".
    `interval` holds the true value in 95 % of cases; NaN where the uncertainty is not stated.
    """

    value: float
    std: float = math.nan
    budget: Mapping[str, float] = field(default_factory=dict)
    interval: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Shares:
    """Shares of a volume, adding up to 1.

    Attributes
    ----------
    seen
        Carried by points at which a stripe was seen.
    interpolated
        Carried by points bridged between seen ones of the same stripe.
    assumed
        Carried by no point of the stripe it is reckoned for: an end cap, a dead stripe, an underside.
    """

    seen: float
    interpolated: float
    assumed: float


@dataclass(frozen=True, eq=False, slots=True)
class Volume:
    """Volume of one product.

    Attributes
    ----------
    visible_mm3
        Integral of the top surface's height over the vertical footprint on the belt, mm³ (undercuts and
        air below count as filled).
    true_mm3
        Volume of the closed body, mm³, or None where the estimator cannot know it.
    shares
        What of the visible volume was seen, interpolated and assumed.
    slice_stripe, slice_area_mm2, slice_spacing_mm
        (slice,) the slices the estimator summed, where it did: stripe, area of the cross-section, and
        the distance the area was held over.
    reasons
        What a reader of the number must know.
    """

    visible_mm3: Estimate
    true_mm3: Estimate | None
    shares: Shares
    slice_stripe: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    slice_area_mm2: Floats = field(default_factory=lambda: np.empty(0))
    slice_spacing_mm: Floats = field(default_factory=lambda: np.empty(0))
    reasons: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        check = Checker(self)
        slices = check.array("slice_stripe", np.int64, (None,)).shape[0]
        check.array("slice_area_mm2", np.float64, (slices,))
        check.array("slice_spacing_mm", np.float64, (slices,))
        check.finish()


@dataclass(frozen=True, slots=True)
class Weight:
    """Mass of one product, grams, and how it was reckoned.

    `features` holds the numbers besides the volume that it rests on, each with its unit in the name.
    """

    mass_g: Estimate
    reasons: tuple[Reason, ...] = ()
    features: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Marks:
    """Evidence that can be drawn over the image: arrows from a place to a place, px in the turned image.

    Attributes
    ----------
    kind
        What an arrow is, in words, e.g. ``centre of arc``.
    stripe
        (mark,) stripe the evidence lies on.
    from_px, to_px
        (mark, 2) x and y of the arrow's ends.
    value
        (mark,) the number behind the arrow; its unit stands in `unit`.
    flagged
        (mark,) True where this piece of evidence speaks against the product.
    """

    kind: str
    unit: str
    stripe: Integers
    from_px: Floats
    to_px: Floats
    value: Floats
    flagged: Flags

    def __post_init__(self) -> None:
        check = Checker(self)
        n = check.array("stripe", np.int64, (None,)).shape[0]
        check.array("from_px", np.float64, (n, 2))
        check.array("to_px", np.float64, (n, 2))
        check.array("value", np.float64, (n,))
        check.array("flagged", np.bool_, (n,))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class Grade:
    """Class of one product.

    Attributes
    ----------
    label
        The class, or ``unknown``: an answer every classifier may give.
    probability
        That the label is right, 0…1; NaN where it is not modelled.
    features
        The numbers the decision rests on, each with its unit in the name.
    reasons
        Why, in words.
    marks
        Evidence to draw.
    features_std
        Standard uncertainties of features, by name; a feature that is not in it has none stated.
    relief
        The surface to draw; like marks, not in the record of a run.
    """

    label: str
    probability: float = math.nan
    features: Mapping[str, float] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()
    marks: Marks | None = None
    features_std: Mapping[str, float] = field(default_factory=dict)
    relief: Relief | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """What is to be done with one product.

    Attributes
    ----------
    label
        The buyer's class, or ``undecided`` where the uncertainty leaves several.
    lane
        Where the product is to go: a belt, a bin; "" where the table does not say.
    possible
        The classes it may be of; one where it is decided.
    reasons
        Why, a code and a sentence for each class that was asked about.
    """

    label: str
    lane: str = ""
    possible: tuple[str, ...] = ()
    reasons: tuple[Reason, ...] = ()
