"""Finished runs for sinks: a product that was measured, one that failed, and their traces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.records import (
    Acquisition,
    Coding,
    Estimate,
    Grade,
    Measurement,
    ProductTrace,
    Reason,
    Shares,
    Trace,
    Volume,
    Weight,
)
from roemetry.stages import Run
from roemetry.testing.scenes import LinearRig, frame_of
from roemetry.testing.solids import product_from, profiles_with_belt


def measured(acquisition: str = "p1") -> Measurement:
    """Give the row of a product that was measured, uncertainty not stated."""
    return Measurement(
        id=f"{acquisition}#1",
        acquisition=acquisition,
        product=1,
        status="measured",
        coding=Coding(7, 7, 1400, 1400, 0, 0, 500, 0, 0.0, 20.0),
        height_max_mm=Estimate(10.0),
        volume=volume_of(9000.0),
        weight=Weight(Estimate(9.9)),
        grade=Grade("good", reasons=(Reason("convex", "no arc is concave"),)),
        provenance={"recipe_sha256": "0" * 64},
    )


def failed(acquisition: str = "p2") -> Measurement:
    """Give the row of an acquisition that could not be read."""
    why = Reason("source-refused", f"{acquisition}.png: the file is empty")
    return Measurement(f"{acquisition}#0", acquisition, 0, "failed", absent={"source": why}, reasons=(why,))


def volume_of(visible_mm3: float) -> Volume:
    """Give a volume of three slices, mm³, wholly seen, uncertainty not stated."""
    return Volume(
        visible_mm3=Estimate(visible_mm3),
        true_mm3=None,
        shares=Shares(1.0, 0.0, 0.0),
        slice_stripe=np.arange(1, 4),
        slice_area_mm2=np.full(3, visible_mm3 / 30.0),
        slice_spacing_mm=np.full(3, 10.0),
        reasons=(Reason("no-volume", "nothing is known"),) if math.isnan(visible_mm3) else (),
    )


def run_of(folder: Path, rows: Sequence[Measurement]) -> Run:
    """Give a finished run of these rows, to be written to a folder; only measured ones can be replayed."""

    def measurements() -> Iterator[Measurement]:
        return iter(rows)

    def replay(acquisition: str) -> Trace:
        for row in rows:
            if row.acquisition == acquisition and row.status == "measured":
                return _trace(row)
        raise DataError(f"{acquisition}: the image is gone")

    return Run(
        folder=folder,
        title="dome",
        measurements=measurements,
        replay=replay,
        provenance={
            "recipe": "recipe.yaml",
            "started": "2026-07-11T08:00:00+00:00",
            "calibration": "rig.yaml",
        },
    )


def _trace(row: Measurement) -> Trace:
    """Make the trace of a drawn dome."""
    rig = LinearRig()
    heights = rig.dome()
    frame = frame_of(rig.light(rig.x_px(heights)))
    product = product_from(heights, rig)
    return Trace(
        acquisition_id=row.acquisition,
        acquisition=Acquisition(row.acquisition, (frame,)),
        frame=frame,
        peaks=rig.peaks(rig.x_px(heights)).peaks,
        stripes=rig.stripe_map(heights),
        profiles=profiles_with_belt(heights, rig),
        products=(ProductTrace(product, row.volume, row.weight, row.grade),),
        seconds={"extractor": 0.001},
    )
