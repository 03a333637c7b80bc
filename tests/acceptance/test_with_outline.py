"""The shipped recipe for volume: stripes and outline, uncertainties by cause, in record, table and report."""

from __future__ import annotations

from pathlib import Path

HOME = Path(__file__).parents[2] / "recipes" / "herring_roe"
