"""The page of a calibration: what speaks for it, what does not, what it will give."""

from roemetry.evidence.page import page

__all__ = ["page"]
