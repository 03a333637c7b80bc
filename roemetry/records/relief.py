"""What a classifier shows of a product's surface: places, maps over them, and regions that stand out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats, Integers


@dataclass(frozen=True, eq=False, slots=True)
class ReliefMap:
    """One number at each place of a relief.

    Attributes
    ----------
    title, unit
        What it is; unit "" for a pure number.
    values
        (section, sample) NaN where it is not known.
    about_zero
        Whether its sign matters: colours then part at zero.
    full_scale
        Colours reach at least so far: what is small beside it looks pale.
    arrows
        (section, sample, 2) a direction at each place, of length 1 at most, belt frame: for a normal what it
        has along X and Y. None: there is none to draw.
    """

    title: str
    unit: str
    values: Floats
    about_zero: bool = False
    full_scale: float = 0.0
    arrows: Floats | None = None


@dataclass(frozen=True, eq=False, slots=True)
class ReliefRegion:
    """A dent or a hump.

    Attributes
    ----------
    kind
        ``dent`` or ``hump``.
    depth_mm
        Largest depth, or height, mm.
    area_mm2
        Area on the belt, mm².
    xy_mm
        (2,) where it is deepest, belt frame, mm.
    cells
        (cell, 2) section and sample of the relief's places in it.
    """

    kind: str
    depth_mm: float
    area_mm2: float
    xy_mm: Floats
    cells: Integers


@dataclass(frozen=True, eq=False, slots=True)
class Relief:
    """A product's surface over the belt, in sections from edge to edge.

    Attributes
    ----------
    xy_mm
        (section, sample, 2) places, belt frame, mm.
    middle_mm
        (section, 2) middle of each section: the mid-line, mm.
    maps, regions
        What there is to show.
    figures
        Sizes to write beside it, by name, units in the names.
    """

    xy_mm: Floats
    middle_mm: Floats
    maps: tuple[ReliefMap, ...] = ()
    regions: tuple[ReliefRegion, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)

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
