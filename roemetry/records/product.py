"""One product as volume, weigher and classifier receive it.

`Trace` holds everything that happened to one acquisition, from the frame to the outcomes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.acquisition import Acquisition, Frame
from roemetry.records.arrays import Checker, Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.display import Shown, estimate, picture_of_stripes, picture_of_surface, table
from roemetry.records.measurement import Decision, Estimate, Grade, Surface, Volume, Weight
from roemetry.records.profiles import Profiles
from roemetry.records.reasons import Reason
from roemetry.records.stripes import Peaks, StripeMap
from roemetry.records.view import View


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Outline(Shown):
    """A product's contour in the image."""

    product: int
    xy_px: Floats
    """(point, 2) closed contour in the turned image, px, the last point is not the first again."""
    xy_std_px: float = math.nan
    """Standard uncertainty of the contour across itself, px; NaN where it is not modelled."""
    features: Mapping[str, float] = field(default_factory=dict)
    """Further numbers read off the image inside the contour, units in the names."""
    fault: Reason | None = None
    """Why outline and stripes cannot both be true; the product is then refused."""

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("xy_px", np.float64, (None, 2))
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Product(Shown):
    """The slices of one product."""

    number: int
    """1…n within its acquisition."""
    profiles: Profiles
    """All slices of the acquisition; points that are not this product's are NaN, with product −1."""
    calibration: Calibration
    acquisition_ids: tuple[str, ...]
    outline: Outline | None = None
    """The contour in the image, where an outliner was asked for and found one."""
    reasons: tuple[Reason, ...] = ()
    """What the stages before had to say."""
    view: View | None = None
    """The rig's geometry as it was used for these slices; None where the calibration gives none."""

    @property
    def height_max_mm(self) -> float:
        """Largest height of a point on the product above the belt, mm; NaN where it has none."""
        heights = np.ascontiguousarray(self.profiles.xyz_mm[:, :, 2])
        return float(np.fmax.reduce(heights, axis=None, initial=math.nan))


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ProductTrace(Shown):
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
    surface: Surface | None = None
    """The surface behind the volume, where it was asked for and the estimator has one."""
    undrawn: Mapping[str, Reason] = field(default_factory=dict)
    """By ``surface`` and ``relief``, why what was asked for to be drawn could not be given."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Trace(Shown):
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

    def _repr_html_(self) -> str:
        """Give the stripes that were found, drawn on the frame, and each product's numbers, for notebooks."""
        picture = ""
        if self.frame is not None and self.peaks is not None:
            found, map_ = self.peaks, self.stripes
            of = np.zeros(len(found), np.int64) if map_ is None else map_.peak_stripe
            picture = picture_of_stripes(self.frame.pixels, found.row, found.x_px, of)
        picture += "".join(
            picture_of_surface(one.surface.xyz_mm) for one in self.products if one.surface is not None
        )
        rows = [
            (
                f"product {one.product.number}",
                f"{one.product.height_max_mm:.4g} mm high, visible volume "
                + ("not stated" if one.volume is None else estimate(one.volume.visible_mm3, "cm³", 1e-3))
                + ("" if one.grade is None else f", {one.grade.label}"),
            )
            for one in self.products
        ]
        rows += [(f"no {kind}", reason.text) for kind, reason in self.absent.items()]
        return table(self.acquisition_id, rows, picture)
