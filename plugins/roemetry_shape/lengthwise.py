"""How a product's volume lies along it: as much on one side of its middle as on the other, and how evenly."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_shape.sections import Sections


def lengthwise_features(sections: Sections) -> dict[str, float]:
    """Give skewness (its size: there is no head end) and kurtosis of the volume along the product.

    Third and fourth standardised moments of the sections' areas over their places. An ellipsoid has 0 and
    15/7, a prism 0 and 9/5; what is thick at one end is skewed.
    """
    s, area = sections.along_mm, sections.area_mm2
    whole = _integral(area, s)
    off = s - _integral(area * s, s) / whole
    variance = _integral(area * off**2, s) / whole
    return {
        "lengthwise_skew": abs(_integral(area * off**3, s) / whole) / variance**1.5,
        "lengthwise_kurtosis": _integral(area * off**4, s) / whole / variance**2,
    }


def _integral(values: Floats, places: Floats) -> float:
    return float((0.5 * (values[1:] + values[:-1]) * np.diff(places)).sum())
