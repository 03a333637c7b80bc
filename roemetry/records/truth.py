"""What is known of an acquisition beforehand: the judge of every measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.arrays import Checker, Flags, Floats
from roemetry.records.acquisition import Frame


@dataclass(frozen=True, eq=False, slots=True)
class StripeTruth:
    """Where each stripe truly is, stripes counted from 0, left to right on the belt.

    Attributes
    ----------
    x_px
        (stripe, row) where the middle of the light plane, lit and seen, crosses the middle of the image
        row, px in the image as it was taken; NaN where nothing is lit and seen.
    on_product
        (stripe, row) True where that point lies on a product.
    xyz_mm
        (stripe, row, 3) the point in the belt frame, mm; NaN where there is none.
    """

    x_px: Floats
    on_product: Flags
    xyz_mm: Floats

    def __post_init__(self) -> None:
        check = Checker(self)
        shape = check.array("x_px", np.float64, (None, None)).shape
        check.array("on_product", np.bool_, shape)
        check.array("xyz_mm", np.float64, (*shape, 3))
        check.finish()


@dataclass(frozen=True, slots=True)
class ProductTruth:
    """What is true of one product; NaN and "" where it is not known.

    Attributes
    ----------
    label
        Class, in the words the classifiers use (``good``, ``henkei``).
    defect
        What is wrong with it (``dented``, ``bent``, …), or ``none``.
    visible_mm3, true_mm3
        Volumes as the conventions define them, mm³.
    mass_g
        Mass, g.
    figures
        Further numbers by name, units in the names: sizes, and how much of a defect a lit stripe shows.
    """

    label: str = ""
    defect: str = ""
    visible_mm3: float = math.nan
    true_mm3: float = math.nan
    mass_g: float = math.nan
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Truth:
    """What is true of one acquisition.

    Attributes
    ----------
    products
        Its products, from left to right.
    stripes
        Where the stripes are; None where that is not known.
    """

    products: tuple[ProductTruth, ...] = ()
    stripes: StripeTruth | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Simulated:
    """An acquisition that was made, not taken, with its truth.

    Attributes
    ----------
    frames
        Its images, by role one at most.
    truth
        What is true of it.
    """

    frames: tuple[Frame, ...]
    truth: Truth
