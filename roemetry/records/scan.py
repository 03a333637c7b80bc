"""Scans: how the belt moves, and what was noticed of the lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.display import Shown


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Motion(Shown):
    """The product's way for each encoder count, in the belt frame of the calibration it belongs to."""

    mm_per_count: Floats
    """(3,) mm; its Z is not 0 where the calibration's belt plane leans against the way the belt runs."""
    covariance: Floats
    """(3, 3) mm², of the motion as it is found with this very calibration."""
    per_parameter: Floats = field(default_factory=lambda: np.zeros((3, 0)))
    """(3, parameter) by how much the motion is another one, mm, if a parameter of the calibration is larger
    by 1, in the order in which they stand: a scale that is wrong makes body and motion larger together.
    Without columns the covariance holds the calibration's errors as well."""
    line_ends_rows: Floats = field(default_factory=lambda: np.full(2, np.nan))
    """(2,) image rows between which the line of light was seen; NaN where it reached the image's side."""

    def __post_init__(self) -> None:
        check = Checker(self)
        vector = check.array("mm_per_count", np.float64, (3,))
        covariance = check.array("covariance", np.float64, (3, 3))
        check.array("per_parameter", np.float64, (3, None))
        check.array("line_ends_rows", np.float64, (2,))
        sound = bool(np.isfinite(vector).all() and np.isfinite(covariance).all())
        check.require(sound and bool(np.abs(vector).max(initial=0.0) > 0), "the motion is zero or not finite")
        check.finish()

    def with_parameters(self, step: Floats) -> Motion:
        """Give the motion that a calibration whose parameters are larger by a step would have found."""
        if not self.per_parameter.size:
            return self
        return replace(self, mm_per_count=self.mm_per_count + self.per_parameter @ step)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as they stand in a calibration file."""
        told = {"mm_per_count": self.mm_per_count.tolist(), "covariance": self.covariance.tolist()}
        if self.per_parameter.size:
            told["per_parameter"] = self.per_parameter.tolist()
        if np.isfinite(self.line_ends_rows).all():
            told["line_ends_rows"] = self.line_ends_rows.tolist()
        return told

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Motion:
        """Read what `to_dict` wrote; KeyError, ValueError or DataError where it is damaged."""
        vector, covariance = (np.array(data[name], np.float64) for name in ("mm_per_count", "covariance"))
        per_parameter = np.array(data.get("per_parameter", np.zeros((3, 0))), np.float64)
        ends = np.array(data.get("line_ends_rows", [math.nan, math.nan]), np.float64)
        return cls(vector, covariance, per_parameter, ends)


@dataclass(frozen=True, slots=True)
class ScanFigures:
    """What placing the lines of a scan came to."""

    lines: int
    placed: int
    lost: int = 0
    repeated: int = 0
    reversed: int = 0
    wraps: int = 0
    unreadable: int = 0
    """lines, placed, …: how many frames there are; how many became slices; places between them at which no
    line was taken; lines taken while the belt stood; while it ran backwards, until it had made up for that;
    overflows of the counter; frames in which no line could be followed."""
    damaged: int = 0
    """Lines that were left out, for a part of them belongs to another frame, and, of a head that sees the
    belt, those in which no line could be followed."""
    pitch_mm: float = math.nan
    """Distance of neighbouring slices, perpendicular to the plane of light, mm."""
    pitch_rel_std: float = 0.0
    """Relative standard uncertainty of that by the motion's covariance."""
    quantum_mm: float = 0.0
    """The belt's way for one encoder count, mm."""
    jitter_mm: float = 0.0
    """Scatter of the belt's height from line to line beyond its points' noise, mm (standard deviation)."""
    belt_off_rel_std: float = 0.0
    """Relative standard uncertainty of volumes where the belt lies beside the calibrated one: it may have
    sunk, or camera or laser may have moved."""
    line_length_rel_std: float = math.nan
    """Relative standard uncertainty of volumes where the line of light is longer or shorter in the image than
    at calibration: the camera may have come nearer; NaN where the line's ends are not in view to tell."""
    registration_mm: float = 0.0
    """Of two heads: standard uncertainty of the height of one against the other, mm."""
    first_count: float = math.nan
    """Encoder count at which the slices' frame lies where the rig's does, as the counter gave it."""
    mm_per_count: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """The belt's way for one count upwards in the slices' frame, mm."""
    slip_rel: float = math.nan
    """Relative scatter of the belt's way against the counter, by the disagreement of several lines; NaN for
    a single line, which cannot tell."""

    def to_dict(self) -> dict[str, float | tuple[float, float, float]]:
        """Plain numbers by name."""
        return {name: getattr(self, name) for name in self.__slots__}
