"""What goes wrong between the light and the list of peaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.coded.crossings import Crossings

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Damage:
    """How much of each damage a sample gets."""

    missing_share: float = 0.002
    """Share of peaks that are lost one by one."""
    gaps: int = 0
    """Breaks of 2–25 rows along single stripes."""
    belt_lost: str = ""
    """``above``, ``below``: the belt beyond the product on that side of the image is not seen, on four fifths
    of the stripes that a product moves; ``some``: on half of them, on a side drawn for each; "" for none."""
    blobs: int = 0
    """Bright spots of 5–14 px radius, where peaks are lost and one or two false ones a row appear."""
    false_peaks: int = 0
    """Single false peaks."""
    dirt: int = 0
    """Specks that glow: false runs of 3–15 rows."""
    ghosts: int = 0
    """Second reflections: false runs of 20–60 rows that follow a piece of a stripe 10–60 px beside it."""
    dead_stripes: int = 0
    """Stripes without light."""
    lost_rows: int = 0
    """Blocks of 3–12 rows of which nothing is left."""


DAMAGES = {
    "none": Damage(),
    "gaps": Damage(gaps=12),
    "belt-above": Damage(belt_lost="above"),
    "belt-below": Damage(belt_lost="below"),
    "belt-some": Damage(belt_lost="some"),
    "blobs": Damage(blobs=4),
    "false": Damage(false_peaks=60),
    "dirt": Damage(dirt=8),
    "ghosts": Damage(ghosts=2),
    "dead-stripe": Damage(dead_stripes=1),
    "lost-rows": Damage(lost_rows=3),
}
"""One damage at a time, by name; `none` still loses two peaks in a thousand."""


def kept(crossings: Crossings, damage: Damage, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Say which crossings make a peak at all: (crossing,). Blobs are counted by `blobs_of`."""
    keep = rng.random(crossings.row.size) >= damage.missing_share
    stripes = np.unique(crossings.stripe)
    for _ in range(damage.gaps):
        stripe, start = rng.choice(stripes), rng.integers(0, int(crossings.row.max()))
        rows = int(rng.integers(2, 26))
        within = (crossings.row >= start) & (crossings.row < start + rows)
        keep &= ~((crossings.stripe == stripe) & within)
    if damage.belt_lost:
        _lose_belt(crossings, damage.belt_lost, keep, rng)
    for stripe in rng.choice(stripes, damage.dead_stripes, replace=False):
        keep &= crossings.stripe != stripe
    for _ in range(damage.lost_rows):
        start = int(rng.integers(0, int(crossings.row.max())))
        keep &= ~((crossings.row >= start) & (crossings.row < start + int(rng.integers(3, 13))))
    return keep


def dead_of(crossings: Crossings, keep: NDArray[np.bool_]) -> Integers:
    """Stripes that have crossings and no peak."""
    return np.setdiff1d(crossings.stripe, crossings.stripe[keep])


def blobs_of(
    crossings: Crossings, keep: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], Floats]:
    """Put bright spots onto products: which crossings are left, and the false peaks (peak, row and x)."""
    false = [np.empty((0, 2))]
    at = np.flatnonzero(crossings.on_product)
    for _ in range(count if at.size else 0):
        middle = rng.choice(at)
        row, x_px = crossings.row[middle] + rng.normal(0, 6), crossings.x_px[middle] + rng.normal(0, 8)
        high, wide = rng.uniform(5.0, 14.0, 2)
        inside = ((crossings.row - row) / high) ** 2 + ((crossings.x_px - x_px) / wide) ** 2 < 1.0
        keep = keep & ~inside
        rows = np.arange(np.ceil(row - high), np.floor(row + high) + 1)
        half = wide * np.sqrt(np.clip(1.0 - ((rows - row) / high) ** 2, 0.0, None))
        if rng.random() < 0.5:  # one broad peak in its middle, or one at each edge
            false.append(np.column_stack([rows, x_px + rng.normal(0.0, 0.8, rows.size)]))
        else:
            wide_enough = half > 3.0
            for sign in (-1.0, 1.0):
                edge = x_px + sign * half + rng.normal(0.0, 0.5, rows.size)
                false.append(np.column_stack([rows, edge])[wide_enough])
    return keep, np.concatenate(false)


def false_peaks(
    crossings: Crossings, damage: Damage, size: tuple[int, int], rng: np.random.Generator
) -> Floats:
    """Draw false peaks, dirt and ghosts: (peak, row and x)."""
    rows, columns = size
    single = np.column_stack(
        [rng.integers(0, rows, damage.false_peaks), rng.uniform(5.0, columns - 6.0, damage.false_peaks)]
    ).astype(np.float64)
    false = [single]
    for _ in range(damage.dirt):
        row, length = rng.integers(0, rows - 16), int(rng.integers(3, 16))
        run = np.arange(row, row + length, dtype=np.float64)
        x_px = rng.uniform(10.0, columns - 11.0) + 1.5 * np.sin(np.linspace(0.0, np.pi, length))
        false.append(np.column_stack([run, x_px + rng.normal(0.0, 0.2, length)]))
    at = np.flatnonzero(crossings.on_product)
    for _ in range(damage.ghosts if at.size else 0):
        origin = rng.choice(at)
        stripe, start = crossings.stripe[origin], crossings.row[origin]
        length, beside = int(rng.integers(20, 61)), rng.choice([-1.0, 1.0]) * rng.uniform(10.0, 60.0)
        near = (crossings.stripe == stripe) & (crossings.row >= start) & (crossings.row < start + length)
        x_px = crossings.x_px[near] + beside + rng.normal(0.0, 0.2, int(near.sum()))
        false.append(np.column_stack([crossings.row[near].astype(np.float64), x_px]))
    return np.concatenate(false)


def _lose_belt(crossings: Crossings, which: str, keep: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Take the belt of one side of the product away, stripe by stripe."""
    for stripe in np.unique(crossings.stripe[crossings.on_product]):
        mine = crossings.stripe == stripe
        rows = crossings.row[mine & crossings.on_product]
        if rng.random() >= (0.5 if which == "some" else 0.8):
            continue
        side = rng.choice(["above", "below"]) if which == "some" else which
        beyond = crossings.row < rows.min() if side == "above" else crossings.row > rows.max()
        keep &= ~(mine & ~crossings.on_product & beyond)
