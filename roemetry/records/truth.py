"""What is known of an acquisition beforehand: the judge of every measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.acquisition import Frame
from roemetry.records.arrays import Checker, Flags, Floats, Integers, Labels, Number


@dataclass(frozen=True, eq=False, slots=True)
class StripeTruth:
    """Where each stripe truly is, stripes counted from 0, left to right on the belt."""

    x_px: Floats
    """(stripe, row) where the middle of the light plane, lit and seen, crosses the middle of the image row,
    px in the image as it was taken; NaN where nothing is lit and seen."""
    on_product: Flags
    """(stripe, row) True where that point lies on a product."""
    xyz_mm: Floats
    """(stripe, row, 3) the point in the belt frame, mm; NaN where there is none."""
    product: Labels = field(default_factory=lambda: np.empty((0, 0), np.int16))
    """(stripe, row) on which product it lies, 1 the first of the truth's products; 0 belt, -1 nothing. Left
    out (empty): there is one product at most."""
    y_px: Floats = field(default_factory=lambda: np.empty((0, 0)))
    """(stripe, row) of dots, each in the row its centre lies in: where down the rows that is, px. Empty: the
    stripes are lines, which cross the middle of each row."""
    across: StripeTruth | None = None
    """Of a grid: the lines of its second family, in the image turned by 90° counter-clockwise."""

    def __post_init__(self) -> None:
        check = Checker(self)
        x_px = check.array("x_px", np.float64, (None, None))
        on_product = check.array("on_product", np.bool_, x_px.shape)
        check.array("y_px", np.float64, x_px.shape if self.y_px.size else (0, 0))
        check.array("xyz_mm", np.float64, (*x_px.shape, 3))
        if on_product.shape == x_px.shape:
            if self.product.size == 0:
                label = np.where(np.isfinite(x_px), on_product.astype(np.int16), -1)
                object.__setattr__(self, "product", label)
            product = check.array("product", np.int16, x_px.shape)
            agree = product.shape == x_px.shape and bool(((product > 0) == on_product).all())
            check.require(agree, "product is above 0 exactly where on_product holds")
        check.finish()


@dataclass(frozen=True, slots=True)
class ProductTruth:
    """What is true of one product; NaN and "" where it is not known."""

    label: str = ""
    """Class, in the words the classifiers use (``good``, ``henkei``)."""
    defect: str = ""
    """What is wrong with it (``dented``, ``bent``, …), or ``none``."""
    visible_mm3: Number = math.nan
    true_mm3: Number = math.nan
    """visible_mm3, true_mm3: volumes as the conventions define them, mm³."""
    mass_g: Number = math.nan
    figures: Mapping[str, Number] = field(default_factory=dict)
    """Further numbers by name, units in the names: sizes, and how much of a defect a lit stripe shows."""


@dataclass(frozen=True, eq=False, slots=True)
class Truth:
    """What is true of one acquisition."""

    products: tuple[ProductTruth, ...] = ()
    stripes: StripeTruth | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Simulated:
    """An acquisition that was made, not taken, with its truth."""

    frames: tuple[Frame, ...]
    """Its images, by role one at most."""
    truth: Truth
    counts: Integers | None = None
    """Of a scan, whose one image holds its frames one below the other: (line,) encoder counts."""
