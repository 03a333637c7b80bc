"""results.csv and those who learn from it agree on what is a feature."""

from __future__ import annotations

from roemetry.fitting.cells import features_in
from roemetry_files.csv_table import COLUMNS


def test_no_column_of_its_own_is_taken_for_a_feature() -> None:
    """Numbers in all of them, as where classes and lanes are called 1, 2, 3."""
    header = [*COLUMNS, "length_mm"]
    assert features_in(header, [(2, dict.fromkeys(header, "1"))]) == ["length_mm"]
