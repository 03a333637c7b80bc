"""Where to look for outlines: what stripes show of each product; without stripes, bright cores."""

from __future__ import annotations

import numpy as np

from roemetry.records import StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_volume.silhouette import area_of

_SMOOTH_PX = 2.0
_LEAST_SHARE = 5e-4
"""Of the image: smaller cores are dirt."""
_LEAST_CONTRAST = 0.08
"""Natural logarithm of brightness: with less between dark and bright there is nothing but belt."""
_GAP_ROWS = 3
"""A stripe that is not seen for longer may have something in between."""
_LEAST_ROWS = 5
"""Shorter pieces beside the product are glare in its shadow as often as not; on it they are not needed."""


def seen_regions(stripes: StripeMap, size: tuple[int, int]) -> dict[int, Flags]:
    """Give, by product, (row, column) the polygon through the ends of what is seen of its stripes.

    What a coder bridged is left out: it runs down to the belt beside the product, through its shadow.
    """
    import cv2

    regions = {}
    mine = stripes.seen & (stripes.product > 0)
    for number in np.unique(stripes.product[mine]).tolist():
        first, last, points = [], [], []
        for x_px, on in zip(stripes.x_px, mine & (stripes.product == number), strict=True):
            pieces = [piece for piece in _pieces(on) if piece.size >= _LEAST_ROWS]
            if pieces:
                rows = np.concatenate(pieces)
                first.append((x_px[rows[0]], rows[0]))
                last.append((x_px[rows[-1]], rows[-1]))
                points.append(np.column_stack([x_px[rows], rows]))
        if not points:
            continue
        # stripes are displaced on the product, so their order there is that of x, not of their numbers
        ring = sorted(first) + sorted(last, reverse=True)
        mask = np.zeros(size, np.uint8)
        cv2.fillPoly(mask, [np.rint(ring).astype(np.int32).reshape(-1, 1, 2)], 1)
        columns, rows = np.rint(np.concatenate(points)).astype(np.int64).T
        mask[rows, np.clip(columns, 0, size[1] - 1)] = 1
        regions[int(number)] = mask.astype(np.bool_)
    return regions


def cores(level: Floats) -> dict[int, Flags]:
    """Give what stands out of the belt, (row, column), numbered from left to right.

    `level` is (row, column) log(image / belt).
    """
    import cv2

    smooth = cv2.GaussianBlur(level, (0, 0), _SMOOTH_PX)
    return _numbered(_core(smooth))


def ring_around(region: Flags, spacing_px: float) -> Floats:
    """Give a smooth ring (n, 2) around a region's largest piece, px, half a stripe spacing outside.

    Notches up to two spacings wide are closed, since between neighbouring stripes nothing is known. Half a
    spacing outside, normals fan out at the region's corners, and reach a product's tip beyond them.
    """
    import cv2

    def disc(radius_px: float) -> Flags:
        width = 2 * round(radius_px) + 1
        return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)))

    edge = 2 * round(spacing_px)
    padded = np.pad(region.astype(np.uint8), edge)
    wide = cv2.dilate(padded, disc(spacing_px))
    found, _ = cv2.findContours(
        cv2.erode(wide, disc(0.5 * spacing_px)), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    if not found:
        return np.empty((0, 2))
    chains = [chain[:, 0, :].astype(np.float64) - edge for chain in found]
    return max(chains, key=lambda chain: abs(area_of(chain)))


def belt_stripes(stripes: StripeMap, number: int, size: tuple[int, int]) -> Flags:
    """Draw (row, column) what is seen of stripes that lie on the belt, or on another product."""
    import cv2

    drawn = np.zeros(size, np.uint8)
    for x_px, on in zip(stripes.x_px, stripes.seen & (stripes.product != number), strict=True):
        for piece in _pieces(on):
            chain = np.column_stack([np.rint(x_px[piece]), piece]).astype(np.int32)
            cv2.polylines(drawn, [chain.reshape(-1, 1, 2)], isClosed=False, color=1)
    return drawn.astype(np.bool_)


def _pieces(on: Flags) -> list[Integers]:
    """Give the rows of each piece of a stripe that is seen without a gap."""
    rows = np.flatnonzero(on)
    return np.split(rows, np.flatnonzero(np.diff(rows) > _GAP_ROWS) + 1)


def _core(smooth: Floats) -> Flags:
    """Threshold after Otsu; what covers less of the image is the product, bright or dark."""
    import cv2

    low, high = np.percentile(smooth, [0.5, 99.5])
    if not high - low > _LEAST_CONTRAST:
        return np.zeros(smooth.shape, np.bool_)
    grey = np.clip(255.0 * (smooth - low) / (high - low), 0, 255).astype(np.uint8)
    step, _ = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    bright = smooth > low + (high - low) * step / 255.0
    return np.asarray(bright)


def _numbered(core: Flags) -> dict[int, Flags]:
    """Number the pieces that are large enough, from left to right."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(core.astype(np.uint8))
    large = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] > _LEAST_SHARE * core.size]
    large.sort(key=lambda k: int(stats[k, cv2.CC_STAT_LEFT]))
    return {number: np.asarray(labels == k) for number, k in enumerate(large, start=1)}
