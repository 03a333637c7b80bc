"""Pieces of one body that only refused peaks hold together: what is open between them counts for each."""

from __future__ import annotations

import numpy as np

from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.run.open_parts import open_parts

SPACING_PX = 50.0
LIFTED_PX = 20.0


def test_what_is_open_between_two_pieces_counts_for_both() -> None:
    """Nine stripes; a body on stripes 1 to 7, of which 3 to 5 are refused: its two ends are no products."""
    rest_px = np.linspace(50.0, 450.0, 9)[:, None] + np.zeros(200)
    x_px, product = rest_px.copy(), np.zeros(rest_px.shape, np.int16)
    body = np.s_[60:140]
    x_px[1:8, body] += LIFTED_PX
    product[1:3, body], product[6:8, body] = 1, 2
    row, stripe = np.nonzero(np.ones(x_px.shape[::-1], bool))
    verdict = stripe.astype(np.int16)
    verdict[(stripe >= 3) & (stripe <= 5) & (row >= 60) & (row < 140)] = AMBIGUOUS
    one = np.ones(row.size)
    peaks = Peaks(
        image_size=(200, 500), row=row, x_px=x_px[stripe, row], x_std_px=0.05 * one, amplitude=100.0 * one,
        background=10.0 * one, width_px=4.0 * one, flags=np.zeros(row.size, np.uint8),
    )  # fmt: skip
    seen = np.zeros(x_px.shape, bool)
    seen[stripe, row] = verdict >= 0
    whole = np.where(seen, 1.0, np.nan)
    stripes = StripeMap(
        x_px=np.where(seen, x_px, np.nan), x_std_px=0.05 * whole, product=np.where(seen, product, -1),
        seen=seen, margin=whole, ambiguous=np.zeros(seen.shape, bool), rest_px=rest_px, peak_stripe=verdict,
        reasons=(),
    )  # fmt: skip
    found = open_parts(peaks, stripes)
    assert [part.points for part in found.values()] == [240, 240]
