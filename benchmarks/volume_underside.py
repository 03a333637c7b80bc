"""What the underside does to the true volume, for the page about volume."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.volume_tables import COLUMNS, K, errors, figures, table
from roemetry_volume.underside import fitted_share

if TYPE_CHECKING:
    from benchmarks.volume import Row
    from benchmarks.volume_images import Pictured

_SHARES = (0.7, 0.8, 0.85, 0.9, 0.92, 1.0)


def underside(rows: Sequence[Row], pictures: Sequence[Pictured]) -> str:
    """Fit the share on either half of the skeins, judge it on the other half, and on those from images."""
    mine = [row for row in rows if row.estimator == "outline-surface" and math.isfinite(row.error)]
    if len(mine) < 6:
        return ""
    visible = np.array([1.0 + row.error for row in mine])
    true = np.array([row.true_share for row in mine])
    model_std = np.array([row.std for row in mine])
    even = np.arange(len(mine)) % 2 == 0
    value, std, said = np.empty_like(visible), np.empty_like(visible), []
    for fit, judge in ((even, ~even), (~even, even)):
        share, scatter = fitted_share(visible[fit], true[fit])
        value[judge] = share * visible[judge]
        std[judge] = np.hypot(share * model_std[judge], scatter * visible[judge])
        said.append(f"{share:.3f} ± {scatter:.3f}")
    lines = [
        ("flat", *figures(100.0 * (visible / true - 1.0)), "not stated", "not stated"),
        ("rounded, fitted share", *figures(100.0 * (value / true - 1.0)), *_intervals(value, std, true)),
    ]
    lines += _from_images(pictures, *fitted_share(visible, true))
    return (
        "`fitted_share` is fitted to every other skein and judged on the rest, then the other way round:\n"
        f"{' and '.join(said)}. Per cent of the true volume, visible volume by `outline-surface`:\n\n"
        + table(("underside", *COLUMNS), lines)
        + "\n"
        + _few(visible, true, model_std)
        + "\nNothing seen from above tells one underside from another. A second view, or weighed\n"
        "samples of the product, would.\n"
    )


def _from_images(pictures: Sequence[Pictured], share: float, scatter: float) -> list[tuple[str, ...]]:
    """Judge the share of all exact skeins on those that were measured from images."""
    mine = [row for row in pictures if row.estimator == "outline-surface" and row.outline == "plain"]
    if not mine:
        return []
    visible = np.array([1.0 + row.error for row in mine])
    true = np.array([row.true_share for row in mine])
    std = np.hypot(share * np.array([row.std for row in mine]), scatter * visible)
    value = share * visible
    label = f"the share of all, on {len(mine)} from images"
    return [(label, *figures(100.0 * (value / true - 1.0)), *_intervals(value, std, true))]


def _intervals(value: np.ndarray, std: np.ndarray, true: np.ndarray) -> tuple[str, str]:
    inside = 100.0 * np.mean(np.abs(value - true) < K * std)
    return f"{inside:.1f} %", f"{100.0 * np.median(2.0 * K * std / true):.1f} %"


def _few(visible: np.ndarray, true: np.ndarray, model_std: np.ndarray) -> str:
    """Judge shares fitted to few samples: 200 draws of which ones."""
    rng = np.random.default_rng(20)
    lines = []
    for count in (10, 20, 50):
        if 2 * count > visible.size:
            continue
        inside, width = [], []
        for _ in range(200):
            order = rng.permutation(visible.size)
            fit, judge = order[:count], order[count:]
            share, scatter = fitted_share(visible[fit], true[fit])
            total = np.hypot(share * model_std[judge], scatter * visible[judge])
            inside.append(np.mean(np.abs(share * visible[judge] - true[judge]) < K * total))
            width.append(np.median(2.0 * K * total / true[judge]))
        lines.append((str(count), f"{100.0 * np.mean(inside):.1f} %", f"{100.0 * np.mean(width):.1f} %"))
    if not lines:
        return ""
    return "From fewer weighed samples, means over 200 choices of which:\n\n" + table(
        ("samples", "intervals with the truth", "median width"), lines
    )


def by_share(rows: Sequence[Row]) -> str:
    """Give the errors against the true volume by how much of the visible volume is air."""
    lines = []
    for low, high in pairwise(_SHARES):
        mine = [row for row in rows if low <= row.true_share < high]
        if not mine:
            continue
        cells = []
        for name in ("zero-order-hold", "slice-pchip", "outline-surface"):
            share = np.array([row.true_share for row in mine if row.estimator == name])
            off = 100.0 * ((1.0 + errors(mine, name)[:, 0]) / share - 1.0)
            cells.append(f"{np.nanmean(off):+.1f} %")
        many = len({row.seed for row in mine})
        lines.append((f"{100.0 * (1.0 - high):.0f} to {100.0 * (1.0 - low):.0f} %", str(many), *cells))
    return (
        "Mean error of the visible volume taken for the true one, by the air below the product:\n\n"
        + table(
            (
                "air in the visible volume",
                "skeins",
                "`zero-order-hold`",
                "`slice-pchip`",
                "`outline-surface`",
            ),
            lines,
        )
    )
