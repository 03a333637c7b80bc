"""Targets to print and to make: sheets at true scale, solids as triangle meshes."""

from roemetry.targets.sheets import Made, make_target

__all__ = ["Made", "make_target"]
