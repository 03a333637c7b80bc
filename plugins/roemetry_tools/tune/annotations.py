"""What is drawn over the frame, and the places that want a look: saturation, ambiguity, gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import AMBIGUOUS, EDGE, SATURATED, UNCODED, WIDE, Peaks, Profiles, StripeMap, Trace

_GAPS_TOLD = 40


def places_of(trace: Trace, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Put a trace's arrays where they will be packed, and count the places that want a look.

    Parameters
    ----------
    trace
        What happened.
    arrays
        Filled: ``peaks.…``, ``stripes.…``, ``profiles.…`` and ``outline.N``.

    Returns
    -------
    dict
        Counts by kind of place, and the longest gaps: stripe, first and last row, x at both ends, px, and
        whether the gap was bridged.
    """
    told: dict[str, Any] = {}
    if trace.peaks is not None:
        told |= _of_peaks(trace.peaks, arrays)
    if trace.stripes is not None:
        told |= _of_stripes(trace.stripes, arrays)
    for outline in trace.outlines:
        arrays[f"outline.{outline.product}"] = outline.xy_px
    if trace.profiles is not None:
        _of_profiles(trace.profiles, arrays)
    return told


def _of_peaks(peaks: Peaks, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags"):
        arrays[f"peaks.{name}"] = getattr(peaks, name)
    return {
        "peaks": len(peaks),
        "saturated": int(np.count_nonzero(peaks.flags & SATURATED)),
        "edge": int(np.count_nonzero(peaks.flags & EDGE)),
        "wide": int(np.count_nonzero(peaks.flags & WIDE)),
        "peak_reasons": [reason.text for reason in peaks.reasons],
    }


def _of_stripes(stripes: StripeMap, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in ("x_px", "product", "seen", "margin", "ambiguous", "rest_px"):
        arrays[f"stripes.{name}"] = getattr(stripes, name)
    arrays["peaks.stripe"] = stripes.peak_stripe
    gaps = sorted(_gaps(stripes), key=lambda gap: gap["first"] - gap["last"])
    return {
        "coded": int(np.count_nonzero(stripes.peak_stripe >= 0)),
        "uncoded": int(np.count_nonzero(stripes.peak_stripe == UNCODED)),
        "ambiguous": int(np.count_nonzero(stripes.peak_stripe == AMBIGUOUS)),
        "gaps": len(gaps),
        "gap_list": gaps[:_GAPS_TOLD],
    }


def _gaps(stripes: StripeMap) -> Iterator[dict[str, Any]]:
    """Give runs of rows, between a stripe's first and last seen row, in which no peak of it was seen."""
    for stripe in range(stripes.stripe_count):
        seen = np.flatnonzero(stripes.seen[stripe])
        for before in np.flatnonzero(np.diff(seen) > 1):
            first, last = int(seen[before]) + 1, int(seen[before + 1]) - 1
            x = stripes.x_px[stripe]
            products = stripes.product[stripe, [first - 1, last + 1]]
            yield {
                "stripe": stripe,
                "first": first,
                "last": last,
                "x_first": float(x[first - 1]),
                "x_last": float(x[last + 1]),
                "bridged": bool(np.isfinite(x[first : last + 1]).all()),
                "product": int(products.max()),
            }


def _of_profiles(profiles: Profiles, arrays: dict[str, NDArray[Any]]) -> None:
    for name in ("xyz_mm", "product", "seen", "stripe", "height_std_mm"):
        arrays[f"profiles.{name}"] = getattr(profiles, name)
