"""Learning from products whose answer is known."""

from roemetry.fitting.table import read_samples

__all__ = ["read_samples"]
