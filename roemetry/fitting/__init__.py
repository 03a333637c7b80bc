"""Learning from products whose answer is known."""

from roemetry.fitting.table import read_labels, read_samples
from roemetry.fitting.weighed import read_weighed, read_weights

__all__ = ["read_labels", "read_samples", "read_weighed", "read_weights"]
