"""Where to look for an outline: the products' regions, roughly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry.records import StripeMap

_AROUND_PX = 40
_SMOOTH_PX = 2.0
_LEAST_SHARE = 5e-4
_LEAST_CONTRAST = 0.08


def stripe_regions(stripes: StripeMap, size: tuple[int, int]) -> dict[int, NDArray[np.bool_]]:
    """Give, by product, the polygon through the stripes' ends: down one side, up the other."""
    import cv2

    regions = {}
    for number in np.unique(stripes.product[stripes.product > 0]).tolist():
        first, last = [], []
        for x_px, mine in zip(stripes.x_px, stripes.product == number, strict=True):
            rows = np.flatnonzero(mine)
            if rows.size:
                first.append((x_px[rows[0]], rows[0]))
                last.append((x_px[rows[-1]], rows[-1]))
        # stripes are displaced on the product, so their order there is that of x, not of their numbers
        ring = sorted(first) + sorted(last, reverse=True)
        mask = np.zeros(size, np.uint8)
        cv2.fillPoly(mask, [np.rint(ring).astype(np.int32).reshape(-1, 1, 2)], 1)
        for x_px, mine in zip(stripes.x_px, stripes.product == number, strict=True):
            rows = np.flatnonzero(mine)
            columns = np.clip(np.rint(x_px[rows]).astype(np.int64), 0, size[1] - 1)
            mask[rows, columns] = 1
        regions[int(number)] = mask.astype(np.bool_)
    return regions


def start_regions(level: Floats, known: dict[int, NDArray[np.bool_]]) -> dict[int, NDArray[np.bool_]]:
    """Join each product's polygon with the bright (or dark) core around it; without any, find cores alone.

    Parameters
    ----------
    level
        (row, column) log(image / belt).
    known
        By product, what stripes show; may be empty.
    """
    import cv2

    smooth = cv2.GaussianBlur(level, (0, 0), _SMOOTH_PX)
    if not known:
        core = _core(smooth, np.ones(level.shape, np.bool_), None)
        return _numbered(core)
    found = {}
    everything = np.zeros(level.shape, np.bool_)
    for mask in known.values():
        everything |= mask
    core = _core(smooth, _grown(everything, _AROUND_PX), everything)
    nearest = np.argmin(
        [cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) for mask in known.values()], axis=0
    )
    for place, (number, mask) in enumerate(known.items()):
        mine = (core & (nearest == place)) | mask
        found[number] = _solid(_touching(mine, mask))
    return found


def _core(smooth: Floats, where: NDArray[np.bool_], inside: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Threshold after Otsu within a part of the image; product may be the brighter or the darker side."""
    import cv2

    values = smooth[where]
    low, high = np.percentile(values, [0.5, 99.5])
    if not high - low > _LEAST_CONTRAST:
        return np.zeros(smooth.shape, np.bool_)
    grey = np.clip(255.0 * (values - low) / (high - low), 0, 255).astype(np.uint8)
    step, _ = cv2.threshold(grey.reshape(-1, 1), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    limit = low + (high - low) * step / 255.0
    brighter = True
    if inside is not None and inside.any():
        brighter = float(np.median(smooth[inside])) >= float(np.median(smooth[where & ~inside]))
    return np.asarray(where & ((smooth > limit) if brighter else (smooth < limit)))


def _numbered(core: NDArray[np.bool_]) -> dict[int, NDArray[np.bool_]]:
    """Number the pieces that are large enough, from left to right."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(core.astype(np.uint8))
    large = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] > _LEAST_SHARE * core.size]
    large.sort(key=lambda k: int(stats[k, cv2.CC_STAT_LEFT]))
    return {number: _solid(labels == k) for number, k in enumerate(large, start=1)}


def _touching(region: NDArray[np.bool_], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pieces of a region that touch a mask."""
    import cv2

    _, labels = cv2.connectedComponents(region.astype(np.uint8))
    return np.isin(labels, np.unique(labels[mask & region])) & region


def _solid(region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Close small notches, fill holes, keep the largest piece."""
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
    closed = cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    found, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = np.zeros(region.shape, np.uint8)
    if found:
        cv2.drawContours(out, [max(found, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return out.astype(np.bool_)


def _grown(mask: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    import cv2

    away: Any = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away <= by_px)
