"""Tables of the page about volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from benchmarks.volume import Row
    from benchmarks.volume_images import Pictured

K = 1.96
OVERHANGS = (0.0, 0.5, 0.75, 1.0, 1.5, 9.0)
BENDS_DEG = (0.0, 10.0, 20.0, 30.0, 45.0, 61.0)
FIGURES = ("mean", "mean absolute", "95 % point", "largest")
COLUMNS = (*FIGURES, "intervals with the truth", "median width")
_BASE = "zero-order-hold"
_LIMITS = (0.05, 0.02, 0.01, 0.005)


def judged(rows: Sequence[Row]) -> str:
    """Give a line for each estimator, and one for the paper's sum times one factor."""
    names = dict.fromkeys(row.estimator for row in rows)
    lines = [line_of(f"`{name}`", errors(rows, name)) for name in names]
    lines.append(fitted(errors(rows, _BASE)))
    return table(("estimator", *COLUMNS), lines)


def from_images(pictures: Sequence[Pictured], names: Sequence[str] = ()) -> str:
    """Give the same from images, of these estimators alone if they are named."""
    plain = [row for row in pictures if row.outline == "plain"]
    if not plain:
        return ""
    lines = [
        line_of(f"`{name}`", errors(plain, name))
        for name in names or dict.fromkeys(row.estimator for row in plain)
    ]
    if not names:
        lines.append(fitted(errors(plain, _BASE)))
    laser = errors([row for row in pictures if row.outline == "laser"], "outline-surface")
    if laser.size:
        lines.append(line_of("`outline-surface`, outline from the laser image", laser))
    return table(("chain", *COLUMNS), lines)


def with_stripes(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Give mean absolute error and 95 % point by number of stripes."""
    return table(
        ("stripes", *(f"`{name}`" for name in names)),
        [
            (str(stripes), *(mean_p95(of(rows, name, stripes)) for name in names))
            for stripes in sorted({row.stripes for row in rows})
        ],
    )


def covered(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Give the share of intervals that hold the truth, and their median width, by number of stripes."""
    lines = []
    for stripes in sorted({row.stripes for row in rows}):
        mine = [row for row in rows if row.stripes == stripes]
        cells = []
        for name in names:
            found = errors(mine, name)
            known = np.isfinite(found).all(axis=1)
            if known.sum() < 0.5 * len(found) or not known.any():
                cells.append("–")
                continue
            error, std = found[known].T
            inside, width = np.mean(np.abs(error) < K * std), np.median(2.0 * K * std)
            cells.append(f"{100.0 * inside:.1f} / {100.0 * width:.2f}")
        lines.append((str(stripes), *cells))
    return table(("stripes", *(f"`{name}`" for name in names)), lines)


def enough(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Give the number of stripes from which on 95 % of the products are off by less than a limit."""
    tried = sorted({row.stripes for row in rows}, reverse=True)
    lines = []
    for limit in _LIMITS:
        cells = []
        for name in names:
            least = "–"
            for stripes in tried:
                error = of(rows, name, stripes)
                known = np.abs(error[np.isfinite(error)])
                if known.size < 0.95 * error.size or not known.size or np.percentile(known, 95) > limit:
                    break
                least = str(stripes)
            cells.append(least)
        lines.append((f"{100.0 * limit:g} %", *cells))
    return table(("95 % point below", *(f"`{name}`" for name in names)), lines)


def binned(
    rows: Sequence[Row],
    figure: Callable[[Row], float],
    edges: Sequence[float],
    what: str,
    names: Sequence[str],
) -> str:
    """Give mean absolute error and 95 % point of skeins between edges of some figure."""
    lines = []
    for low, high in pairwise(edges):
        mine = [row for row in rows if low <= figure(row) < high]
        many = len({row.seed for row in mine})
        if many:
            label = f"{low:g} to {high:g}" if high != edges[-1] else f"from {low:g}"
            lines.append((label, str(many), *(mean_p95(of(mine, name, 11)) for name in names)))
    return table((what, "skeins", *(f"`{name}`" for name in names)), lines)


def middles_of(
    rows: Sequence[Row], figure: Callable[[Row], float], edges: Sequence[float], name: str
) -> list[tuple[float, float]]:
    """Give the bins' median figures and mean absolute errors, for a plot."""
    points = []
    for low, high in pairwise(edges):
        mine = [row for row in rows if row.estimator == name and low <= figure(row) < high]
        if len(mine) >= 5:
            error = np.array([row.error for row in mine])
            points.append((float(np.median([figure(row) for row in mine])), float(np.nanmean(np.abs(error)))))
    return points


def by_defect(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Give mean absolute error and 95 % point by defect."""
    lines = []
    for defect in sorted({row.defect for row in rows}, key=lambda name: (name != "none", name)):
        mine = [row for row in rows if row.defect == defect]
        cells = (mean_p95(of(mine, name, 11)) for name in names)
        lines.append((defect, str(len({row.seed for row in mine})), *cells))
    return table(("defect", "skeins", *(f"`{name}`" for name in names)), lines)


def times(rows: Sequence[Row]) -> str:
    """Give processor time of a call."""
    base = np.nanmedian([row.milliseconds for row in rows if row.estimator == _BASE])
    lines = []
    for name in dict.fromkeys(row.estimator for row in rows):
        mine = [row.milliseconds for row in rows if row.estimator == name]
        took, fast = np.nanmedian(mine), np.nanpercentile(mine, 5)
        lines.append((f"`{name}`", f"{took:.3f} ms", f"{fast:.3f} ms", f"{took / base:.2f}"))
    return table(("estimator", "median", "5 % point", "over zero-order-hold"), lines) + (
        "\nProcessor time of one call, on a machine that was busy with other work.\n"
    )


def of(rows: Sequence[Row], name: str, stripes: int) -> np.ndarray:
    """Errors of an estimator under some number of stripes; NaN where it refused."""
    return np.array([row.error for row in rows if row.estimator == name and row.stripes == stripes])


def errors(rows: Sequence[Row] | Sequence[Pictured], name: str) -> np.ndarray:
    """Errors and standard uncertainties, shape (n, 2)."""
    return np.array([(row.error, row.std) for row in rows if row.estimator == name]).reshape(-1, 2)


def line_of(label: str, found: np.ndarray) -> tuple[str, ...]:
    """Give a line of the judged table."""
    known = found[np.isfinite(found[:, 0])]
    error, std = 100.0 * known[:, 0], 100.0 * known[:, 1]
    covered = width = "not stated"
    if np.isfinite(std).any():
        covered = f"{100.0 * np.mean(np.abs(error) < K * std):.1f} %"
        width = f"{np.median(2.0 * K * std):.2f} %"
    missing = len(found) - len(known)
    return label + (f" ({missing} refused)" if missing else ""), *figures(error), covered, width


def figures(error: np.ndarray) -> tuple[str, ...]:
    """Mean, mean absolute, 95 % point and largest, of errors in per cent."""
    return (
        f"{error.mean():+.2f} %",
        f"{np.abs(error).mean():.2f} %",
        f"{np.percentile(np.abs(error), 95):.2f} %",
        f"{np.abs(error).max():.1f} %",
    )


def fitted(found: np.ndarray) -> tuple[str, ...]:
    """One factor for all, which makes the mean absolute error least."""
    ratio = 1.0 + found[np.isfinite(found[:, 0]), 0]
    shown = figures(100.0 * (ratio / np.median(ratio) - 1.0))
    return f"{_BASE} × one fitted factor", *shown, "not stated", "not stated"


def mean_p95(error: np.ndarray) -> str:
    """Mean absolute error and 95 % point, or a dash where most were refused."""
    known = 100.0 * np.abs(error[np.isfinite(error)])
    if known.size < 0.5 * error.size or not known.size:
        return "–"
    return f"{known.mean():.2f} / {np.percentile(known, 95):.2f}"


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Give a table in Markdown."""
    rule = "|".join("---" for _ in head)
    body = [f"| {' | '.join(cells)} |" for cells in (head, *lines)]
    return "\n".join([body[0], f"|{rule}|", *body[1:]]) + "\n"
