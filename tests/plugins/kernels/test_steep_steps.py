"""Counted steps are those of whole arrays, and the check for joined frames says the same with both."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.run.transport_faults import check_joins
from roemetry_kernels.steep_steps import count_steps


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 3), (17, 9), (257, 64), (300, 333)])
def test_steps_are_those_of_whole_arrays(
    kind: type[np.unsignedinteger], shape: tuple[int, int], rng: np.random.Generator
) -> None:
    top = np.iinfo(kind).max
    pixels = rng.integers(0, top + 1, shape).astype(kind)
    pixels[:, : shape[1] // 3] = top // 3  # a part where nothing changes
    light = pixels.astype(np.int64)
    for least in (top // 20, top // 4, top // 2):
        by_row, by_column, breaks = count_steps(pixels, least)
        step = np.abs(np.diff(light, axis=1))
        np.testing.assert_array_equal(by_row, (np.abs(np.diff(light, axis=0)) > least).sum(axis=1))
        np.testing.assert_array_equal(by_column, (step > least).sum(axis=0))
        if shape[1] > 3:
            far, near = np.abs(light[:, 3:] - light[:, :-3]), step[:, 1:-1]
            wanted = ((near > least) & (np.maximum(far - near, 0) <= near // 2)).sum(axis=0)
            np.testing.assert_array_equal(breaks[1:-1], wanted)


@pytest.mark.parametrize("part", ["none", "rows", "columns", "every second row"])
def test_the_check_says_the_same_with_counted_steps(part: str, rng: np.random.Generator) -> None:
    frame, other = (
        np.clip(np.rint(light + rng.normal(0.0, 1.2, light.shape)), 0, 255).astype(np.uint8)
        for light in (_lines(0.0), _lines(12.0))
    )
    if part == "rows":
        frame[150:] = other[150:]
    elif part == "columns":
        frame[:, 200:] = other[:, 200:]
    elif part == "every second row":
        frame[1::2] = other[1::2]
    said = []
    for counted in ((), (count_steps,)):
        try:
            check_joins(Frame(frame), *counted)
            said.append("")
        except DataError as error:
            said.append(str(error))
    assert said[0] == said[1]
    assert (said[0] == "") == (part == "none")


def _lines(shift_px: float) -> np.ndarray:
    rows, columns = np.mgrid[0:300, 0:400]
    off = (columns - shift_px - 0.02 * rows) % 25.0 - 12.5
    return 11.0 + 180.0 * np.exp(-0.5 * (off / 1.8) ** 2)
