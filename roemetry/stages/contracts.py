"""What a stage's verb must give: checked where it is called, since a plugin's author is free to forget it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from roemetry.records import Decision, Grade, Peaks, Profiles, StripeMap, Volume, Weight
from roemetry.records.calibration import Alignment, Calibration

T = TypeVar("T")

_GIVES: Mapping[str, type] = {
    "extractor": Peaks,
    "aligner": Alignment,
    "coder": StripeMap,
    "smoother": StripeMap,
    "outliner": tuple,
    "calibrator": Calibration,
    "triangulator": Profiles,
    "volume": Volume,
    "weigher": Weight,
    "classifier": Grade,
    "grader": Decision,
}


def given(kind: str, result: T) -> T:
    """Give a result on, if it is the record of its kind or the kind is free to give what it likes.

    Else TypeError says what was expected: ``None`` would pass for a step that was not wanted, and a belt
    without a product be reported.
    """
    wanted = _GIVES.get(kind)
    if wanted is not None and not isinstance(result, wanted):
        found = "nothing (None)" if result is None else f"a {type(result).__name__}"
        raise TypeError(f"it gave {found}, expected {wanted.__name__}")
    return result
