"""A table of one mass, for the checks of the scale."""

from __future__ import annotations

import tempfile
from pathlib import Path

from roemetry_files.scale import ScaleOptions


def scale_options() -> ScaleOptions:
    """Write the mass of the product that the kit weighs; give the options to find it."""
    path = Path(tempfile.mkdtemp()) / "masses.csv"
    path.write_text("id,mass_g\nscene,10.5\n", encoding="utf-8")
    return ScaleOptions(masses=path, std_g=0.1)
