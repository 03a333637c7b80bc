"""Everything that happened to one acquisition, from the frame to the outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from roemetry.records.acquisition import Acquisition, Frame
from roemetry.records.calibration import Alignment
from roemetry.records.outcome import Decision, Estimate, Grade, Volume, Weight
from roemetry.records.product import Outline, Product, Profiles
from roemetry.records.reasons import Reason
from roemetry.records.stripes import Peaks, StripeMap


@dataclass(frozen=True, eq=False, slots=True)
class ProductTrace:
    """One product and what was found of it; None where a stage was not asked for or not possible.

    `height_max_mm` is None where no uncertainty was drawn: the product itself knows its largest height.
    """

    product: Product
    volume: Volume | None
    weight: Weight | None
    grade: Grade | None
    absent: Mapping[str, Reason] = field(default_factory=dict)
    decision: Decision | None = None
    height_max_mm: Estimate | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """One acquisition's way through the stages."""

    acquisition_id: str
    acquisition: Acquisition | None = None
    frame: Frame | None = None
    """The laser frame as the extractor saw it: one channel, turned, subtracted."""
    peaks: Peaks | None = None
    alignment: Alignment | None = None
    stripes: StripeMap | None = None
    outlines: tuple[Outline, ...] = ()
    profiles: Profiles | None = None
    products: tuple[ProductTrace, ...] = ()
    """peaks, alignment, stripes, outlines, profiles, products: what each stage gave; None (or empty) where it
    was not asked for or not possible."""
    absent: Mapping[str, Reason] = field(default_factory=dict)
    """By stage kind, why its result is missing."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """By stage kind, the time it took, s."""
