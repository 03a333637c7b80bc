"""Whether a checked block agrees with the calibration, and whether the line drifts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roemetry.checking.block_reading import Reading
from roemetry.records import Block, Reason

Verdict = Literal["in order", "drifting", "out"]
QUANTITIES = ("height_mm", "belt_mm", "width_mm")

_HISTORY_MIN = 8
_ONE_SIDE_RUN = 8
_SIGMAS = 3.0
_MOVING_RANGE_TO_STD = 1.128
"""Mean range of two draws from a normal distribution, in standard deviations (d₂ of control charts)."""
WORDS = {"height_mm": "height of the block", "belt_mm": "belt's zero", "width_mm": "width of the block"}


@dataclass(frozen=True, slots=True)
class Quantity:
    """One length that was checked, mm.

    Attributes
    ----------
    value, expected
        As measured, and as the block's description says.
    std
        Standard uncertainty of their difference: the block's tolerance, the calibration's own, and a tenth
        of a pixel for what extractor and surface do to a peak.
    error_over_limit
        |value − expected| over twice `std` (Eₙ of ISO/IEC 17043); above 1 is out. NaN where not measured.
    """

    value: float
    expected: float
    std: float

    @property
    def error_over_limit(self) -> float:
        """Eₙ."""
        return abs(self.value - self.expected) / (2.0 * self.std) if self.std > 0 else math.nan


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a calibration.

    Attributes
    ----------
    made
        Date and time, ISO 8601, UTC.
    calibration_sha256, target, image, image_sha256
        What was checked, by what, in which image.
    height, belt, width
        The lengths.
    stripes, stripe_spread_mm
        Stripes on the block's top, and how far their own heights spread.
    verdict
        ``in order``; ``drifting``: within its limits, but the chart shows that something moves; ``out``.
    reasons
        Why, in words.
    """

    made: str
    calibration_sha256: str
    target: str
    image: str
    image_sha256: str
    height: Quantity
    belt: Quantity
    width: Quantity
    stripes: int
    stripe_spread_mm: float
    verdict: Verdict = "in order"
    reasons: tuple[Reason, ...] = ()

    def quantity(self, name: str) -> Quantity:
        """Give a length by its name in `QUANTITIES`."""
        found: Quantity = getattr(self, name.removesuffix("_mm"))
        return found


def quantities_of(
    reading: Reading, block: Block, spread: Reading, pixel_mm: tuple[float, float]
) -> tuple[Quantity, Quantity, Quantity]:
    """Put readings beside what they should be.

    Parameters
    ----------
    reading
        As measured.
    block
        As described; its tolerance is a rectangular distribution.
    spread
        Standard deviation of each reading over redrawn calibrations.
    pixel_mm
        Height, and length along the stripes, for one pixel, mm.
    """
    reference = block.tolerance_mm / math.sqrt(3.0)
    height_px, along_px = (_PEAK_DOUBT_PX * mm for mm in pixel_mm)
    return (
        Quantity(reading.height_mm, block.height_mm, math.hypot(reference, spread.height_mm, height_px)),
        Quantity(reading.belt_mm, 0.0, math.hypot(spread.belt_mm, height_px)),
        Quantity(
            reading.width_mm,
            block.width_mm,
            math.hypot(reference, spread.width_mm, _EDGE_DOUBT_PX / _PEAK_DOUBT_PX * along_px),
        ),
    )


def judged(check: Check, history: Sequence[Check]) -> tuple[Verdict, tuple[Reason, ...]]:
    """Give verdict and reasons; `history` holds earlier checks of the same calibration, oldest first."""
    out, drifting = [], []
    for name in QUANTITIES:
        now = check.quantity(name)
        if now.error_over_limit > 1.0:
            out.append(
                Reason(
                    "calibration-out",
                    f"{WORDS[name]}: {now.value:.3f} mm, expected {now.expected:.3f} mm; the difference of "
                    f"{now.value - now.expected:+.3f} mm is {now.error_over_limit:.1f} times its limit of "
                    f"{2 * now.std:.3f} mm",
                )
            )
        said = _drift(name, now, [earlier.quantity(name).value for earlier in history])
        if said:
            drifting.append(Reason("calibration-drift", said))
    verdict: Verdict = "out" if out else "drifting" if drifting else "in order"
    return verdict, (*out, *drifting)


def _drift(name: str, now: Quantity, before: Sequence[float]) -> str:
    """Say what a control chart of single values (Shewhart) sees, or nothing."""
    known = np.array([value for value in before if math.isfinite(value)])
    if known.size < _HISTORY_MIN or not math.isfinite(now.value):
        return ""
    # The line's own scatter from step to step: a slow drift does not widen it.
    scatter = float(np.abs(np.diff(known)).mean()) / _MOVING_RANGE_TO_STD
    centre = float(known[:_HISTORY_MIN].mean())
    if abs(now.value - centre) > _SIGMAS * max(scatter, 1e-6):
        return (
            f"{WORDS[name]}: {now.value:.3f} mm lies more than 3 standard deviations ({scatter:.4f} mm) "
            f"from the {centre:.3f} mm of the first {_HISTORY_MIN} checks"
        )
    last = np.append(known, now.value)[-_ONE_SIDE_RUN:] - centre
    if known.size + 1 >= _HISTORY_MIN + _ONE_SIDE_RUN and (np.all(last > 0) or np.all(last < 0)):
        side = "above" if last[-1] > 0 else "below"
        began = f"the {centre:.3f} mm it began with"
        return f"{WORDS[name]}: the last {_ONE_SIDE_RUN} checks all lie {side} {began}"
    return ""


_PEAK_DOUBT_PX = 0.1
"""What an extractor, and light that enters the surface, may shift all peaks of an image by."""
_EDGE_DOUBT_PX = 0.5
"""An edge lies somewhere between two rows."""
