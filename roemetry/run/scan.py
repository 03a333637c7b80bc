"""The lines of a scan through extractor and coder, into one map of stripes that the assembler places.

A frame of a scan shows a moving belt, so nothing is asked of it but its stripes: the coder gets the
calibration only where it has to tell several stripes apart. A line that cannot be followed is left empty and
counted; only if none can, the scan is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from roemetry.errors import RoemetryError, StageError
from roemetry.records import NOTHING, Acquisition, Frame, Product, Profiles, Reason, ScanLines, StripeMap
from roemetry.records.arrays import Integers
from roemetry.records.calibration import Calibration
from roemetry.records.view import View


def gather(
    lines: ScanLines,
    ready: Callable[[Acquisition], Frame],
    stages: Mapping[str, Any],
    calibration: Calibration,
) -> StripeMap:
    """Give (line · stripe, row) the stripes of every line; those of a line that cannot be followed are NaN.

    Parameters
    ----------
    lines
        With frames of the calibration's size.
    ready
        Makes a frame ready for the extractor, as the source says.
    stages
        With extractor and coder, perhaps a smoother.

    Raises
    ------
    StageError
        No line could be followed; with what was said of the first.
    """
    rows, count = calibration.image_size[0], calibration.stripe_count
    shape = (len(lines.count) * count, rows)
    x_px, x_std_px = np.full(shape, np.nan), np.full(shape, np.nan)
    seen = np.zeros(shape, np.bool_)
    extractor, coder, smoother = stages["extractor"], stages["coder"], stages.get("smoother")
    first_fault: Exception | None = None
    followed, reach = 0, 0.0
    for line in range(len(lines.count)):
        try:
            frame = ready(Acquisition("", (lines.frame(line),)))
            if frame.size != calibration.image_size:
                raise StageError(
                    f"frame {line + lines.start} is {frame.size[1]} × {frame.size[0]} pixels, those of the "
                    f"calibration are {calibration.image_size[1]} × {calibration.image_size[0]}"
                )
            found = coder.code(extractor.extract(frame), calibration if count > 1 else None)
            if smoother is not None:
                found = smoother.smooth(found)
        except RoemetryError as error:
            first_fault = first_fault or error
            continue
        here = slice(line * count, (line + 1) * count)
        x_px[here], x_std_px[here], seen[here] = found.x_px, found.x_std_px, found.seen
        reach = found.correlation_rows
        followed += 1
    if not followed:
        raise StageError(f"no line of the scan could be followed; of the first: {first_fault}")
    unknown = np.broadcast_to(np.nan, shape)
    return StripeMap(
        x_px=x_px,
        x_std_px=x_std_px,
        product=np.where(np.isnan(x_px), np.int16(NOTHING), np.int16(1)),
        seen=seen,
        margin=unknown,
        ambiguous=np.broadcast_to(np.False_, shape),
        rest_px=unknown,
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=reach,
    )


def placed_only(
    stripes: StripeMap, lines: ScanLines, profiles: Profiles, stripe: int
) -> tuple[StripeMap, ScanLines]:
    """Leave of a scan what was placed: a row of the map for each slice, with the slice's labels.

    `stripe` is that of which slices were made.
    """
    at = profiles.frame * (stripes.stripe_count // len(lines.count)) + stripe
    x_px = stripes.x_px[at]
    product = np.where(np.isnan(x_px), np.int16(NOTHING), profiles.product)
    # what lies on nothing that counts is left out: a StripeMap knows no point without a label
    x_px = np.where(product == NOTHING, np.nan, x_px)
    unknown = np.broadcast_to(np.nan, x_px.shape)
    kept = StripeMap(
        x_px=x_px,
        x_std_px=stripes.x_std_px[at],
        product=product,
        seen=stripes.seen[at] & ~np.isnan(x_px),
        margin=unknown,
        ambiguous=np.broadcast_to(np.False_, x_px.shape),
        rest_px=unknown,
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=stripes.correlation_rows,
    )
    index: Integers = profiles.frame
    return kept, ScanLines(lines.frame, lines.count[index], lines.number[index], (0, len(index)), lines.start)


@dataclass(frozen=True)
class Placing:
    """The triangulator of a scan: triangulates its lines and places them, as often as is asked."""

    assembler: Any
    lines: ScanLines
    triangulator: Any

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give the slices that a calibration makes of the stripes."""
        found: Profiles = self.assembler.place(stripes, self.lines, calibration, self.triangulator)
        return found

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of a calibration's parameters."""
        found: View | None = self.triangulator.view(calibration)
        return found


def cut_by_scan(product: Product) -> Reason | None:
    """Say why nothing can be stated of a product that the scan's first or last line still shows."""
    label = product.profiles.product
    if not len(label) or not ((label[0] > 0).any() or (label[-1] > 0).any()):
        return None
    return Reason(
        "cut-by-scan",
        "the product reaches the first or last line of the scan: a part is not seen (begin and end with bare "
        "belt, or raise the source's longest_product_lines)",
    )


def measured_by_another(profiles: Profiles) -> Calibration:
    """Give a calibration that stands for a sensor that was calibrated elsewhere and gives slices in mm."""
    heights = profiles.xyz_mm[:, :, 2]
    top = float(np.nanmax(heights)) if np.isfinite(heights).any() else 0.0
    slices, points = profiles.product.shape
    return Calibration(
        method="slices",
        image_size=(points, slices),
        turn_deg=0,
        rest_px=np.arange(slices, dtype=np.float64)[:, None],
        displacement_px_per_mm=np.ones(slices),
        height_range_mm=(0.0, max(0.0, top)),
        parameters={},
        covariance=np.zeros((0, 0)),
    )
