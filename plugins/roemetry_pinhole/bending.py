"""The shape of a board that is not flat: how far its print lies off a plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.arrays import Floats

_POWERS = np.array([(i, degree - i) for degree in (2, 3, 4) for i in range(degree, -1, -1)])
"""What is of lower order is the pose's."""
BENDS = len(_POWERS)
"""Number of coefficients."""


@dataclass(frozen=True, eq=False, slots=True)
class Bend:
    """Heights of the print over the board's plane, away from the camera.

    Attributes
    ----------
    middle_mm
        (2,) where the powers are counted from, on the board.
    reach_mm
        Length of which x and y are taken in the powers.
    coefficients_mm
        (12,) of x², xy, y², x³, … y⁴.
    """

    middle_mm: Floats
    reach_mm: float
    coefficients_mm: Floats

    @classmethod
    def none(cls, width_mm: float, height_mm: float) -> Bend:
        """Give that of a flat board of this size."""
        return cls(0.5 * np.array([width_mm, height_mm]), 0.5 * max(width_mm, height_mm), np.zeros(BENDS))

    def moved(self, step_mm: Floats) -> Bend:
        """Give it with other coefficients."""
        return replace(self, coefficients_mm=self.coefficients_mm + step_mm)

    def by_coefficient(self, place_mm: Floats) -> Floats:
        """Give (n, 12) what each coefficient adds at places (n, 2)."""
        x, y = self._powers(place_mm)
        return np.asarray((x[_POWERS[:, 0]] * y[_POWERS[:, 1]]).T)

    def height_mm(self, place_mm: Floats) -> Floats:
        """Give (n,) how far the print lies off the plane at places (n, 2)."""
        return np.asarray(self.by_coefficient(place_mm) @ self.coefficients_mm)

    def slopes(self, place_mm: Floats) -> Floats:
        """Give (n, 2) the derivatives of the height along x and y."""
        x, y = self._powers(place_mm)
        i, j = _POWERS.T
        along = (self.coefficients_mm * i) @ (x[np.maximum(i - 1, 0)] * y[j])
        down = (self.coefficients_mm * j) @ (x[i] * y[np.maximum(j - 1, 0)])
        return np.column_stack([along, down]) / self.reach_mm

    def range_mm(self) -> float:
        """Give the range of heights over the board's best plane."""
        x, y = np.meshgrid(*(middle + np.linspace(-1.0, 1.0, 21) * middle for middle in self.middle_mm))
        places = np.column_stack([x.ravel(), y.ravel()])
        height = self.height_mm(places)
        flat = np.column_stack([places, np.ones(len(places))])
        return float(np.ptp(height - flat @ np.linalg.lstsq(flat, height, rcond=None)[0]))

    def _powers(self, place_mm: Floats) -> Floats:
        """(2, 5, n) of x and of y, the powers 0 to 4."""
        from_middle = ((place_mm - self.middle_mm) / self.reach_mm).T
        powers = np.ones((2, 5, len(place_mm)))
        for power in range(1, 5):
            np.multiply(powers[:, power - 1], from_middle, out=powers[:, power])
        return powers
