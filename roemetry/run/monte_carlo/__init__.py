"""Uncertainty of results by Monte Carlo with frozen labels."""

from roemetry.run.monte_carlo.propagate import Chain, Scene, propagate
from roemetry.run.monte_carlo.summarise import without_draws

__all__ = ["Chain", "Scene", "propagate", "without_draws"]
