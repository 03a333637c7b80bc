"""A model of one ratio, for the checks of the fitted weigher."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from roemetry_volume.fitted_weight import FittedWeightOptions
from roemetry_volume.weight_model import WeightModel


def weight_options() -> FittedWeightOptions:
    """Write a model of 1.1 g/cm³ with a scatter of 0.05 g/cm³; give its options."""
    nothing = np.empty(0)
    model = WeightModel(
        form="scale",
        features=(),
        centre=nothing,
        spread=nothing,
        coefficients=np.array([1.1]),
        covariance=np.array([[0.05**2 / 20]]),
        scatter_g_per_cm3=0.05,
        degrees_of_freedom=19.0,
        limits={"visible_cm3": (1.0, 100.0)},
    )
    path = Path(tempfile.mkdtemp()) / "one_ratio.json"
    path.write_text(model.to_json({"samples": 20}), encoding="utf-8")
    return FittedWeightOptions(model=path)
