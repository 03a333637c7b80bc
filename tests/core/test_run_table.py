"""The table of `roemetry run`: values with what they may be wrong by, and faults by their reason."""

from __future__ import annotations

import math
from dataclasses import replace

from rich.console import Console

from roemetry.cli.table import problems_of, table_of
from roemetry.records import Estimate, Measurement, Reason, Weight
from roemetry.testing.runs import measured

NO_LIGHT = Reason("source-refused", "the image is black")


def shown(*rows: Measurement) -> str:
    console = Console(width=80)
    with console.capture() as said:
        console.print(table_of("skeins", rows, len(rows)))
    return said.get()


def test_a_stated_uncertainty_stands_beside_its_value() -> None:
    row = replace(measured(), weight=Weight(Estimate(20.37, 1.21)), height_max_mm=Estimate(17.389, 0.041))
    text = shown(row)
    assert "20.4 ± 1.2" in text
    assert "17.39 ± 0.04" in text


def test_what_is_not_stated_stands_alone() -> None:
    text = shown(replace(measured(), weight=Weight(Estimate(20.37, math.nan))))
    assert "20.4" in text
    assert "±" not in text


def test_eighty_columns_hold_grade_and_all_figures() -> None:
    row = replace(
        measured("skein_01"), weight=Weight(Estimate(120.37, 11.2)), height_max_mm=Estimate(17.389, 0.041)
    )
    text = shown(row)
    for words in ("skein_01#1", "good", "120.4 ± 11.2", "17.39 ± 0.04", "7/7"):
        assert words in text
    assert max(map(len, text.splitlines())) <= 80


def test_a_fault_of_many_images_is_told_once() -> None:
    black = [Measurement(f"p{n}#0", f"p{n}", 0, "failed", reasons=(NO_LIGHT,)) for n in range(30)]
    other = Measurement("q#0", "q", 0, "empty")
    assert problems_of([measured(), *black, other]) == [
        "p0#0, p1#0, p2#0 and 27 more: the image is black",
        "q#0: empty",
    ]


def test_without_a_calibration_the_displacement_stands_there() -> None:
    nothing = Estimate(math.nan)
    row = replace(measured(), weight=None, volume=None, height_max_mm=nothing)
    assert row.coding is not None
    row = replace(row, coding=replace(row.coding, displacement_max_px=18.04))
    text = shown(row, Measurement("p2#0", "p2", 0, "failed", reasons=(NO_LIGHT,)))
    assert "px displaced" in text
    assert "18.0" in text
    assert "cm³" not in text
    assert "cm³" in shown(measured(), row), "one row in millimetres is enough"
