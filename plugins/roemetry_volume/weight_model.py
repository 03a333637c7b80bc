"""A fitted weigher as a file: coefficients with their covariance, scatter, and where they hold."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records.arrays import Floats

VERSION = 1

FORMS: Mapping[str, tuple[str, ...]] = {
    "scale": (),
    "offset": ("per_cm3",),
    "ends": ("end_share",),
    "rim": ("end_share", "rim_share", "rim_bow_share"),
}
"""By name of a model, the features that mass over visible volume is linear in."""

BEYOND = 0.25
"""So much of the samples' range may a feature lie outside of it."""


@dataclass(frozen=True, eq=False)
class WeightModel:
    """Mass over visible volume, g/cm³, as a linear function of features.

    Attributes
    ----------
    form
        A key of `FORMS`.
    features
        Names, in the coefficients' order.
    centre, spread
        (feature,) mean and standard deviation of the samples.
    coefficients
        (1 + feature,) g/cm³: at the centre, and for each spread off it.
    covariance
        (1 + feature, 1 + feature) of the coefficients, (g/cm³)².
    scatter_g_per_cm3
        Standard deviation of products about the function.
    degrees_of_freedom
        Of that.
    limits
        By feature, and for `visible_cm3`, smallest and largest value among the samples.
    """

    form: str
    features: tuple[str, ...]
    centre: Floats
    spread: Floats
    coefficients: Floats
    covariance: Floats
    scatter_g_per_cm3: float
    degrees_of_freedom: float
    limits: Mapping[str, tuple[float, float]]

    def ratio(self, features: Mapping[str, float]) -> tuple[float, float, float]:
        """Give mass over visible volume, its uncertainty from the fit alone, and the scatter, g/cm³.

        Both are standard deviations of a Student's t of `degrees_of_freedom`. NaN where a feature is missing.
        """
        values = np.array([features.get(name, math.nan) for name in self.features])
        row = np.concatenate([[1.0], (values - self.centre) / self.spread])
        wider = self.student_std
        of_fit = math.sqrt(float(row @ self.covariance @ row)) if np.isfinite(row).all() else math.nan
        return float(row @ self.coefficients), wider * of_fit, wider * self.scatter_g_per_cm3

    @property
    def student_std(self) -> float:
        """Standard deviation of Student's t of the model's degrees of freedom."""
        return math.sqrt(self.degrees_of_freedom / (self.degrees_of_freedom - 2.0))

    def outside(self, features: Mapping[str, float]) -> tuple[str, ...]:
        """Say of which features a product lies beyond the samples."""
        said = []
        for name, (low, high) in self.limits.items():
            slack = BEYOND * (high - low)
            value = features.get(name, math.nan)
            if not low - slack <= value <= high + slack:
                said.append(f"{name} is {value:.3g}, the weighed samples have {low:.3g} to {high:.3g}")
        return tuple(said)

    def to_json(self, about: Mapping[str, Any]) -> str:
        """Write the model, with whatever is to be said about it."""
        content = {
            "roemetry_weight": VERSION,
            "about": dict(about),
            "form": self.form,
            "features": list(self.features),
            "centre": self.centre.tolist(),
            "spread": self.spread.tolist(),
            "coefficients": self.coefficients.tolist(),
            "covariance": self.covariance.tolist(),
            "scatter_g_per_cm3": self.scatter_g_per_cm3,
            "degrees_of_freedom": self.degrees_of_freedom,
            "limits": {name: list(ends) for name, ends in self.limits.items()},
        }
        return json.dumps(content, allow_nan=False, indent=1) + "\n"

    @classmethod
    def load(cls, path: Path) -> WeightModel:
        """Read a file; raise StageError where it is none, or damaged."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["roemetry_weight"] != VERSION:
                raise StageError(f"{path.name}: format {data['roemetry_weight']}, expected {VERSION}")
            count = len(data["features"])
            return cls(
                form=str(data["form"]),
                features=tuple(data["features"]),
                centre=np.array(data["centre"], np.float64).reshape(count),
                spread=np.array(data["spread"], np.float64).reshape(count),
                coefficients=np.array(data["coefficients"], np.float64).reshape(count + 1),
                covariance=np.array(data["covariance"], np.float64).reshape(count + 1, count + 1),
                scatter_g_per_cm3=float(data["scatter_g_per_cm3"]),
                degrees_of_freedom=float(data["degrees_of_freedom"]),
                limits={name: (float(low), float(high)) for name, (low, high) in data["limits"].items()},
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StageError(
                f"{path.name} is no fitted weigher, or it is damaged: {type(error).__name__}: {error}",
                hint="make it with `roemetry fit-weight`",
            ) from error
