"""results.csv and those who learn from it agree on what is a feature."""

from __future__ import annotations

from roemetry.calibrating.known_products import features_in
from roemetry_files.csv_table import COLUMNS, rounded


def test_no_column_of_its_own_is_taken_for_a_feature() -> None:
    """Numbers in all of them, as where classes and lanes are called 1, 2, 3."""
    header = [*COLUMNS, "length_mm"]
    assert features_in(header, [(2, dict.fromkeys(header, "1"))]) == ["length_mm"]


def test_small_numbers_keep_five_digits_and_large_ones_four_decimals() -> None:
    """A curvature of 0.0123 per mm with four decimals would be off by up to half a per cent."""
    given = [22395.31234, 24.63481, 1.000049, 0.123456, -0.0123456, 4.56789e-7, 0.0, float("inf")]
    kept = [22395.3123, 24.6348, 1.0, 0.12346, -0.012346, 4.5679e-7, 0.0, float("inf")]
    assert [rounded(value) for value in given] == kept
