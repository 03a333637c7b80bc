"""Centre of gravity of each run of pixels above a grey level."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import EDGE, SATURATED, Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions


class RunCentroidOptions(StageOptions):
    """Options of `RunCentroid`."""

    threshold: float = Field(
        default=40.0, ge=0.0, le=255.0, description="grey levels of 0…255; a run of pixels lies above it"
    )


class RunCentroid(Extractor[RunCentroidOptions]):
    """Weighs each pixel of a run above the threshold by its grey level above it."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)
    expected_failures: ClassVar[dict[str, str]] = {
        "check_brightness_does_not_matter": "the threshold is a fixed level: in more light a run is wider",
    }

    def extract(self, frame: Frame) -> Peaks:
        """Find the runs of all rows."""
        if frame.pixels.ndim != 2:
            raise DataError(f"{frame.name or 'the frame'} has colours; an extractor takes one channel")
        rows, columns = frame.size
        level = self.options.threshold * frame.white / 255.0
        above = np.zeros((rows, columns + 2), np.int8)
        above[:, 1:-1] = frame.pixels > level
        step = np.diff(above, axis=1)
        row, first = np.nonzero(step == 1)  # sorted by row, then by column
        last = np.nonzero(step == -1)[1] - 1
        stripes = (last - first + 1) < columns  # a row that is bright all over shows none
        row, first, last = row[stripes], first[stripes], last[stripes]

        weight = np.maximum(frame.pixels - level, 0.0).ravel()
        place = np.tile(np.arange(columns, dtype=np.float64), rows)
        # Between two runs every weight is 0, so a sum from one run's start to the next is the run's sum.
        start = row * columns + first
        total = np.add.reduceat(weight, start) if row.size else np.empty(0)
        moment = np.add.reduceat(weight * place, start) if row.size else np.empty(0)
        highest = np.maximum.reduceat(weight, start) if row.size else np.empty(0)

        flags = np.zeros(row.size, np.uint8)
        flags[highest + level >= frame.white] |= SATURATED
        flags[(first == 0) | (last == columns - 1)] |= EDGE
        return Peaks(
            image_size=frame.size,
            row=row,
            x_px=moment / total,
            x_std_px=np.full(row.size, np.nan),  # not modelled: say so, do not invent
            amplitude=highest,
            background=np.full(row.size, level),
            width_px=(last - first + 1).astype(np.float64),
            flags=flags,
        )
