"""roemetry: calibration and metrology for laser-stripe inspection of curved products.

The public names are imported when they are used, so that ``import roemetry`` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roemetry.calibrating import calibrate
    from roemetry.config.resolve import make_stage
    from roemetry.config.rig import Rig
    from roemetry.errors import RoemetryError
    from roemetry.records import Measurement
    from roemetry.records.calibration import Calibration
    from roemetry.records.convert import to_pandas, to_point_cloud, to_xarray
    from roemetry.records.from_points import product_from_points
    from roemetry.run.api import Recipe
    from roemetry.run.batch import run_recipe
    from roemetry.run.pipeline import Pipeline

__all__ = [
    "Calibration",
    "Measurement",
    "Pipeline",
    "Recipe",
    "Rig",
    "RoemetryError",
    "calibrate",
    "make_stage",
    "product_from_points",
    "run_recipe",
    "to_pandas",
    "to_point_cloud",
    "to_xarray",
]

_HOMES = {
    "Calibration": "records.calibration",
    "Measurement": "records",
    "Pipeline": "run.pipeline",
    "Recipe": "run.api",
    "Rig": "config.rig",
    "RoemetryError": "errors",
    "calibrate": "calibrating",
    "make_stage": "config.resolve",
    "product_from_points": "records.from_points",
    "run_recipe": "run.batch",
    "to_pandas": "records.convert",
    "to_point_cloud": "records.convert",
    "to_xarray": "records.convert",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'roemetry' has no attribute {name!r}")
    return getattr(import_module(f"roemetry.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    # the names to use, and those that Python asks for; not what this file imports for itself
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
