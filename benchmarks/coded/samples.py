"""A sample: peaks, the truth they come from, and the calibration a coder is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.coded.crossings import Crossings, crossings_of
from benchmarks.coded.damage import Damage, blobs_of, dead_of, false_peaks, kept
from benchmarks.coded.products import in_view
from benchmarks.coded.rigs import CodingRig
from roemetry.records import Peaks
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import SATURATED
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_ALBEDO = np.array([0.66, 0.53])
_LEAST_GREY = 12.0
_MERGED_SIGMAS = 3.0
"""Two stripes closer than this share one peak."""
_BLUR_PX = 0.5
_AMBIENT = 12.0


@dataclass(frozen=True, eq=False)
class Sample:
    """One image's worth of peaks."""

    peaks: Peaks
    """What the coder is given."""
    crossings: Crossings
    """All true crossings, damaged or not."""
    calibration: Calibration
    """The exact one."""
    dead: NDArray[np.int64]
    """Stripes that were lit and of which no peak is left."""
    displaced_spacings: float
    """Largest displacement of a product's point from its rest line, in mean spacings."""


def sample_of(rig: CodingRig, solid: Solid, damage: Damage | None = None, *, seed: int) -> Sample:
    """Trace a product that is moved into view, and draw its peaks; the same arguments give the same peaks."""
    return sample_from(rig, crossings_of(rig.camera, rig.laser, in_view(solid, rig)), damage, seed=seed)


def sample_from(rig: CodingRig, crossings: Crossings, damage: Damage | None = None, *, seed: int) -> Sample:
    """Draw the peaks of known crossings: another damage to the same scene costs no tracing."""
    damage = Damage() if damage is None else damage
    rng = np.random.default_rng([seed, 404])
    keep = kept(crossings, damage, rng)
    dead = dead_of(crossings, keep)
    keep, blobs = blobs_of(crossings, keep, damage.blobs, rng)
    size = rig.camera.height_px, rig.camera.width_px
    true = _seen(rig, crossings, keep, rng)
    false = np.concatenate([blobs, false_peaks(crossings, damage, size, rng)])
    calibration = rig.calibration()
    rest_px = calibration.rest_line_px(np.arange(rig.rows, dtype=np.float64))
    moved_px = crossings.x_px - rest_px[crossings.stripe, crossings.row]
    far_px = float(np.abs(moved_px[crossings.on_product]).max(initial=0.0))
    spacing_px = float(np.diff(rest_px[:, rig.rows // 2]).mean())
    return Sample(
        _peaks(true, _drawn(false, rig, rng), size), crossings, calibration, dead, far_px / spacing_px
    )


def _seen(rig: CodingRig, crossings: Crossings, keep: NDArray[np.bool_], rng: np.random.Generator) -> Floats:
    """Give (peak, 6): row, x, deviation, amplitude, width and overlap of what an extractor would find."""
    row, x_px = crossings.row[keep], crossings.x_px[keep]
    stripe, on = crossings.stripe[keep], crossings.on_product[keep].astype(int)
    sigma_px = np.hypot(rig.laser.sigma_mm / np.maximum(crossings.mm_per_px[keep], 1e-3), _BLUR_PX)
    amplitude = rig.laser.peak_grey[stripe] * _ALBEDO[on] * crossings.cosine[keep]
    amplitude *= np.clip(rng.normal(1.0, 0.12, row.size), 0.4, 1.6)
    usual_px = np.median(sigma_px) if sigma_px.size else 1.0
    std_px = rig.noise_px * np.clip(sigma_px / usual_px, 0.5, 4.0)
    found = np.column_stack([row, x_px + std_px * rng.standard_normal(row.size), std_px, amplitude, sigma_px])
    found = found[(amplitude >= _LEAST_GREY) & (sigma_px < 30.0)]
    return _merged(found[np.lexsort((found[:, 1], found[:, 0]))])


def _merged(found: Floats) -> Floats:
    """Make one peak of neighbours that no valley parts."""
    while len(found) > 1:
        near = (np.diff(found[:, 0]) == 0.0) & (
            np.diff(found[:, 1]) < _MERGED_SIGMAS * 0.5 * (found[1:, 4] + found[:-1, 4])
        )
        near[1:] &= ~near[:-1]  # pairs, one after the other
        left = np.flatnonzero(near)
        if not left.size:
            break
        weight = found[left, 3] / (found[left, 3] + found[left + 1, 3])
        apart = found[left + 1, 1] - found[left, 1]
        found[left, 1] = weight * found[left, 1] + (1.0 - weight) * found[left + 1, 1]
        found[left, 2] = np.maximum(found[left, 2], found[left + 1, 2])
        found[left, 3] = np.maximum(found[left, 3], found[left + 1, 3])
        found[left, 4] = np.maximum(found[left, 4], found[left + 1, 4]) + 0.5 * apart
        found = np.delete(found, left + 1, axis=0)
    return found


def _drawn(false: Floats, rig: CodingRig, rng: np.random.Generator) -> Floats:
    """Give false peaks the looks of true ones."""
    count = len(false)
    amplitude, width = rng.uniform(15.0, 220.0, count), rng.uniform(1.0, 3.0, count)
    return np.column_stack([false, np.full(count, rig.noise_px), amplitude, width])


def _peaks(true: Floats, false: Floats, size: tuple[int, int]) -> Peaks:
    found = np.concatenate([true, false])
    inside = (found[:, 0] >= 0) & (found[:, 0] < size[0])
    inside &= (found[:, 1] > -0.5) & (found[:, 1] < size[1] - 0.5)
    found = found[inside]
    found = found[np.lexsort((found[:, 1], found[:, 0]))]
    found = _merged(found)
    top = 255.0 - _AMBIENT
    return Peaks(
        image_size=size,
        row=found[:, 0].astype(np.int64),
        x_px=found[:, 1],
        x_std_px=found[:, 2],
        amplitude=np.minimum(found[:, 3], top),
        background=np.full(len(found), _AMBIENT),
        width_px=2.355 * found[:, 4],
        flags=np.where(found[:, 3] > top, SATURATED, 0).astype(np.uint8),
    )
