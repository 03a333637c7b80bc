"""Drawn scenes: stripes and outlines with noise, a calibration from its distribution."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.assembling import assemble
from roemetry.calibration import Calibration
from roemetry.errors import RoemetryError
from roemetry.penetration import raised
from roemetry.propagation.scene import Chain, Scene
from roemetry.records import Outline, Product, Profiles, StripeMap

PEAKS, CALIBRATION, OUTLINE, PENETRATION = "peak noise", "calibration", "outline", "penetration"


class Drawn:
    """Draws scenes: stripes and outlines with noise, a calibration from its distribution.

    Attributes
    ----------
    causes
        What can be drawn: causes whose size is stated.
    peaks_stated
        Whether each seen point of a product has an uncertainty.
    """

    def __init__(self, scene: Scene, chain: Chain, rng: np.random.Generator) -> None:
        self._scene, self._chain, self._rng = scene, chain, rng
        self._calibrations = scene.calibration.redraws(rng, chain.triangulator.view)
        stripes = scene.stripes
        lit = stripes.product > 0
        self._std_px = np.where(stripes.seen, stripes.x_std_px, 0.0)
        self.peaks_stated = bool(np.isfinite(self._std_px[stripes.seen & lit]).all())
        self._std_px = np.nan_to_num(self._std_px)
        contours = any(math.isfinite(outline.xy_std_px) for outline in scene.outlines)
        known = {PEAKS: self.peaks_stated, CALIBRATION: True, OUTLINE: contours}
        known[PENETRATION] = scene.penetration is not None
        self.causes = tuple(cause for cause, stated in known.items() if stated)
        self._bridges = _bridges(stripes)

    def scenes(self, count: int, causes: tuple[str, ...]) -> Iterator[Mapping[int, Product]]:
        """Give drawn products by number, `count` times; what is no cause stays as it was found."""
        for _ in range(count):
            scene = self._scene
            stripes, calibration, outlines = scene.stripes, scene.calibration, scene.outlines
            if PEAKS in causes:
                stripes = replace(stripes, x_px=stripes.x_px + self._noise_px())
            if CALIBRATION in causes:
                calibration = next(self._calibrations)
            if OUTLINE in causes:
                outlines = tuple(
                    moved(found, float(self._rng.normal(0.0, np.nan_to_num(found.xy_std_px))))
                    for found in outlines
                )
            light = scene.penetration
            offset_mm = 0.0 if light is None else light.offset_mm
            if light is not None and PENETRATION in causes:
                offset_mm = float(self._rng.normal(offset_mm, light.std_mm))
            yield self.products(stripes, calibration, outlines, offset_mm)

    def products(
        self,
        stripes: StripeMap,
        calibration: Calibration,
        outlines: tuple[Outline, ...],
        offset_mm: float = 0.0,
    ) -> Mapping[int, Product]:
        """Triangulate and assemble; empty where the drawn calibration makes that impossible."""
        triangulator = self._chain.triangulator
        try:
            profiles = triangulator.triangulate(stripes, calibration)
        except RoemetryError:
            return {}
        profiles = _cut(profiles)
        if offset_mm:
            profiles = raised(profiles, offset_mm)
        drawn = calibration is not self._scene.calibration
        view = calibration.view if drawn else triangulator.view(calibration)
        found = assemble(profiles, outlines, calibration, self._scene.acquisition_id, view=view)
        return {product.number: product for product in found}

    def _noise_px(self) -> Floats:
        """(stripe, row) errors, px: correlated along the stripe; bridged points move with their ends."""
        noise = self._rng.standard_normal(self._std_px.shape)
        reach = self._scene.stripes.correlation_rows
        if reach > 0:
            noise = _smoothed(noise, reach)
        noise *= self._std_px
        stripe, gap, before, after, share = self._bridges
        noise[stripe, gap] = (1.0 - share) * noise[stripe, before] + share * noise[stripe, after]
        return noise


def _bridges(stripes: StripeMap) -> tuple[Integers, Integers, Integers, Integers, Floats]:
    """Give bridged points: stripe, row, the seen rows before and after, how far between them it lies."""
    parts = [np.empty((5, 0))]
    bridged = ~stripes.seen & np.isfinite(stripes.x_px)
    for stripe in np.flatnonzero(bridged.any(axis=1)).tolist():
        seen, gap = np.flatnonzero(stripes.seen[stripe]), np.flatnonzero(bridged[stripe])
        if not seen.size:
            continue
        at = np.searchsorted(seen, gap)
        before, after = seen[np.maximum(at - 1, 0)], seen[np.minimum(at, seen.size - 1)]
        share = np.clip((gap - before) / np.maximum(after - before, 1), 0.0, 1.0)
        parts.append(np.stack([np.full(gap.size, float(stripe)), gap, before, after, share]))
    joined = np.concatenate(parts, axis=1)
    stripe_, row, first, last = joined[:4].astype(np.int64)
    return stripe_, row, first, last, joined[4]


def _cut(profiles: Profiles) -> Profiles:
    """Keep the points from the first to the last on a product: a third of the draws' time is saved."""
    lit = np.flatnonzero((profiles.product > 0).any(axis=0))
    points = slice(int(lit[0]), int(lit[-1]) + 1) if lit.size else slice(0, 0)
    fields = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm")
    return replace(profiles, **{name: getattr(profiles, name)[:, points] for name in fields})


def _smoothed(noise: Floats, reach_rows: float) -> Floats:
    """White noise of variance 1 with the autocorrelation exp(−Δ²/(4ℓ²)) along axis 1, variance 1."""
    half = max(1, math.ceil(4 * reach_rows))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / reach_rows) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    padded = np.pad(noise, ((0, 0), (half, half)), mode="wrap")
    return np.stack([np.convolve(line, kernel, mode="valid") for line in padded])


def moved(outline: Outline, by_px: float) -> Outline:
    """Move a contour outwards along its normals."""
    ahead = np.roll(outline.xy_px, -1, axis=0) - np.roll(outline.xy_px, 1, axis=0)
    length = np.sqrt((ahead**2).sum(axis=1))
    normal = np.column_stack([ahead[:, 1], -ahead[:, 0]]) / np.where(length > 0, length, 1.0)[:, None]
    x, y = outline.xy_px.T
    turns_left = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    outwards = 1.0 if turns_left > 0 else -1.0
    return replace(outline, xy_px=outline.xy_px + by_px * outwards * normal)
