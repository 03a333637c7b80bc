"""Units of what people read, and the conversions between them.

Inside the program everything is millimetres, cubic millimetres, grams, pixels and degrees, and the unit
stands in the name.
"""

from __future__ import annotations

import math

MM3_PER_CM3 = 1000.0
NOT_STATED = "not stated"


def mm3_to_cm3(volume_mm3: float) -> float:
    """Cubic millimetres to cubic centimetres."""
    return volume_mm3 / MM3_PER_CM3


def stated(value: float, digits: int = 2) -> str:
    """Write a number for people; a NaN (nothing is known) is written "not stated"."""
    return f"{value:.{digits}f}" if math.isfinite(value) else NOT_STATED
