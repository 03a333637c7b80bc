"""What a calibrator receives: targets and the peaks seen on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from roemetry.records.acquisition import Frame
from roemetry.records.peaks import Peaks


@dataclass(frozen=True, slots=True)
class Block:
    """A square block: three sides as they lie on the belt, mm, with the tolerance (half width) of each.

    `length_mm` lies along X (across the stripes), `width_mm` along Y (along the stripes), `height_mm` up.
    """

    name: str
    length_mm: float
    width_mm: float
    height_mm: float
    tolerance_mm: float


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """One image of a target, and the peaks the recipe's extractor found in it.

    Attributes
    ----------
    shows
        What lies on the belt: ``belt`` (nothing) or ``block``.
    """

    shows: str
    frame: Frame
    peaks: Peaks


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationSet:
    """Everything a calibrator may use.

    Attributes
    ----------
    observations
        The images, prepared alike (channel, turn) and run through one extractor.
    stripe_count
        Number of stripes the rig projects.
    block
        The block in the ``block`` images, or None where none was described.
    working_distance_mm
        Camera (its centre of projection) to belt, mm; None where it is not known.
    extractor
        Name and version of the extractor the peaks come from, with its options.
    """

    observations: tuple[Observation, ...]
    stripe_count: int
    block: Block | None
    working_distance_mm: float | None
    extractor: Mapping[str, object]

    def showing(self, what: str) -> tuple[Observation, ...]:
        """Give the observations of one kind of target."""
        return tuple(observation for observation in self.observations if observation.shows == what)
