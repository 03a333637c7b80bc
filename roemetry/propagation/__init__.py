"""Uncertainty of results by Monte Carlo with frozen labels."""

from roemetry.propagation.propagating import propagate
from roemetry.propagation.scene import Chain, Scene

__all__ = ["Chain", "Scene", "propagate"]
