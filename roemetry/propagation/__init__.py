"""Uncertainty of results by Monte Carlo with frozen labels."""

from roemetry.propagation.propagating import propagate
from roemetry.propagation.scene import Chain, Scene
from roemetry.propagation.stating import without_draws

__all__ = ["Chain", "Scene", "propagate", "without_draws"]
