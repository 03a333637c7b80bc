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


def in_words(name: str) -> str:
    """Write a figure's name for people: ``length_mm`` is "length (mm)"."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def stated(value: float, digits: int = 2) -> str:
    """Write a number for people; a NaN (nothing is known) is written "not stated"."""
    return f"{value:.{digits}f}" if math.isfinite(value) else NOT_STATED


_UNITS = {"_per_mm": "1/mm", "_px": "px", "_mm3": "mm³", "_mm2": "mm²", "_mm": "mm", "_g": "g", "_deg": "°"}
