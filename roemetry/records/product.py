"""One product, as volume, weigher and classifier receive it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.profiles import Profiles
from roemetry.records.reasons import Reason
from roemetry.records.view import View


@dataclass(frozen=True, eq=False, slots=True)
class Outline:
    """A product's contour in the image.

    Attributes
    ----------
    product
        Number of the product, 1…n.
    xy_px
        (point, 2) closed contour in the turned image, px, the last point is not the first again.
    xy_std_px
        Standard uncertainty of the contour across itself, px; NaN where it is not modelled.
    features
        Further numbers read off the image inside the contour, units in the names.
    """

    product: int
    xy_px: Floats
    xy_std_px: float = math.nan
    features: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("xy_px", np.float64, (None, 2))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class Product:
    """The slices of one product.

    Attributes
    ----------
    number
        1…n within its acquisition.
    profiles
        All slices of the acquisition; points that are not this product's are NaN, with product −1.
    calibration
        The calibration the slices were made with.
    acquisition_ids
        Where the slices came from.
    outline
        The contour in the image, where an outliner was asked for and found one.
    reasons
        What the stages before had to say.
    view
        The rig's geometry as it was used for these slices; None where the calibration gives none.
    """

    number: int
    profiles: Profiles
    calibration: Calibration
    acquisition_ids: tuple[str, ...]
    outline: Outline | None = None
    reasons: tuple[Reason, ...] = ()
    view: View | None = None

    @property
    def height_max_mm(self) -> float:
        """Largest height of a point on the product above the belt, mm; NaN where it has none."""
        heights = np.ascontiguousarray(self.profiles.xyz_mm[:, :, 2])
        return float(np.fmax.reduce(heights, axis=None, initial=math.nan))
