"""Which checks of slow stages are left to `pytest -m thorough`."""

from __future__ import annotations

import re

import pytest

SLOW = re.compile(
    r"\[(planner/|calibrator/pinhole-|simulator/mitsuba|simulator/moving-belt|volume/surface-mesh).*"
    r"check_(threads_agree|keeps_nothing_between_calls|crosses_to_another_process)\]"
)
"""Each calls a stage that takes a second three to six times; that a stage gives the same result twice and
leaves its input alone is always checked."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark them."""
    for item in items:
        if SLOW.search(item.name):
            item.add_marker(pytest.mark.thorough)
