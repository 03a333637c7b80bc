"""The page docs/explanation/volume.md, made of what `python -m benchmarks volume` measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from roemetry_volume.underside import fitted_share

if TYPE_CHECKING:
    from benchmarks.volume import Row
    from benchmarks.volume_images import Pictured

_K = 1.96
_OVERHANGS = (0.0, 0.5, 0.75, 1.0, 1.5, 9.0)
_BENDS_DEG = (0.0, 10.0, 30.0, 45.0, 61.0)


def page(rows: Sequence[Row], pictures: Sequence[Pictured], first: int, count: int) -> str:
    """Write the page."""
    eleven = [row for row in rows if row.stripes == 11]
    names = list(dict.fromkeys(row.estimator for row in eleven))
    parts = [
        _HEAD.format(first=first, last=first + count - 1, count=count, images=_images(pictures)),
        "## Eleven stripes, exact centres and outline\n",
        _table(
            (
                "estimator",
                "mean",
                "mean absolute",
                "95 % point",
                "largest",
                "intervals with the truth",
                "median width",
            ),
            [_line(name, _errors(eleven, name)) for name in names]
            + [_fitted("zero-order-hold × one fitted factor", _errors(eleven, "zero-order-hold"))],
        ),
        _COVERAGE,
        "## From images\n",
        _table(
            (
                "chain",
                "mean",
                "mean absolute",
                "95 % point",
                "largest",
                "intervals with the truth",
                "median width",
            ),
            _from_images(pictures, names),
        ),
        _FROM_IMAGES,
        "## How many stripes are enough\n",
        _table(
            ("stripes", *(f"`{name}`" for name in _BY_STRIPES)),
            [
                (str(stripes), *(_mean_p95(_of(rows, name, stripes)) for name in _BY_STRIPES))
                for stripes in sorted({row.stripes for row in rows})
            ],
        ),
        _STRIPES,
        "## Overhang\n",
        _binned(
            eleven,
            lambda row: row.overhang,
            (0.0, 0.5, 0.75, 1.0, 1.5, 9.0),
            "spacings beyond the outer lit point",
        ),
        "## Bending\n",
        _binned(
            eleven, lambda row: row.bend_deg, (0.0, 10.0, 30.0, 45.0, 61.0), "turn of the mid-line, degrees"
        ),
        "## Defects\n",
        _by_defect(eleven),
        "## Underside: from visible to true\n",
        _underside(eleven),
        "## Time\n",
        _times(eleven),
    ]
    return "\n".join(parts).rstrip() + "\n"


_COLUMNS = ("mean", "mean absolute", "95 % point", "largest", "intervals with the truth", "median width")
_BY_STRIPES = (
    "zero-order-hold",
    "slice-trapezoid",
    "slice-simpson",
    "slice-pchip",
    "slice-spline",
    "outline-surface",
)

_HEAD = """\
# Volume: what was seen, what was assumed

Made by `python -m benchmarks volume --first {first} --count {count}`: {count} simulated herring roe
skeins of all kinds, seeds {first} to {last}, each on a rig of its own (camera 270 to 420 mm above the
belt, laser on either side, stripes over 87.5 mm). While the estimators were made, seeds below 3000 and
30000 to 30011 were looked at. Errors are those of the **visible volume**, the integral of the top
surface's height over the footprint, in per cent of the truth. {images}

Stripe centres, planes and silhouettes are exact unless it says *from images*: what is left is the error
of the method.
"""

_COVERAGE = """
*Intervals with the truth*: share of products whose 95 % interval (value ± 1.96 standard uncertainties)
holds the true visible volume; *median width* is that of the interval. The outline's own uncertainty is 0
here. The factor of the last line was fitted on these very skeins, which favours it.
"""

_FROM_IMAGES = """
The chain: `centre-of-gravity`, `window-tracking`, the true planes of light, `edge-contour` without an
image of the empty belt, 8-bit images of 640 × 480 with speckle and noise. Nothing is taken from the truth
but the calibration. Intervals hold the model's error alone, not the noise of the peaks.
"""

_STRIPES = """
Each cell: mean absolute error / 95 % point, per cent. All over the same 87.5 mm: 11 stripes are 8.75 mm
apart. A dash: fewer than three stripes lie on most products.
"""


def _of(rows: Sequence[Row], name: str, stripes: int) -> np.ndarray:
    return np.array([row.error for row in rows if row.estimator == name and row.stripes == stripes])


def _errors(rows: Sequence[Row] | Sequence[Pictured], name: str) -> np.ndarray:
    return np.array([(row.error, row.std) for row in rows if row.estimator == name])


def _line(name: str, found: np.ndarray) -> tuple[str, ...]:
    known = found[np.isfinite(found[:, 0])]
    error, std = 100.0 * known[:, 0], 100.0 * known[:, 1]
    covered = "not stated"
    width = "not stated"
    if np.isfinite(std).any():
        covered = f"{100.0 * np.mean(np.abs(error) < _K * std):.1f} %"
        width = f"{np.median(2.0 * _K * std):.2f} %"
    missing = len(found) - len(known)
    label = f"`{name}`" + (f" ({missing} refused)" if missing else "")
    return label, *_figures(error), covered, width


def _figures(error: np.ndarray) -> tuple[str, ...]:
    return (
        f"{error.mean():+.2f} %",
        f"{np.abs(error).mean():.2f} %",
        f"{np.percentile(np.abs(error), 95):.2f} %",
        f"{np.abs(error).max():.1f} %",
    )


def _fitted(name: str, found: np.ndarray) -> tuple[str, ...]:
    """One factor for all, which makes the mean absolute error least."""
    ratio = 1.0 + found[np.isfinite(found[:, 0]), 0]
    return name, *_figures(100.0 * (ratio / np.median(ratio) - 1.0)), "not stated", "not stated"


def _from_images(pictures: Sequence[Pictured], names: Sequence[str]) -> list[tuple[str, ...]]:
    plain = [row for row in pictures if row.outline == "plain"]
    if not plain:
        return []
    lines = [_line(name, _errors(plain, name)) for name in names]
    lines.append(_fitted("zero-order-hold × one fitted factor", _errors(plain, "zero-order-hold")))
    laser = _errors([row for row in pictures if row.outline == "laser"], "outline-surface")
    if laser.size:
        lines.append(("`outline-surface`, outline from the laser image", *_line("", laser)[1:]))
    return lines


def _images(pictures: Sequence[Pictured]) -> str:
    seeds = sorted({row.seed for row in pictures})
    return f"Images: {len(seeds)} more, seeds {seeds[0]} to {seeds[-1]}." if seeds else ""


def _mean_p95(error: np.ndarray) -> str:
    known = 100.0 * np.abs(error[np.isfinite(error)])
    if known.size < 0.5 * error.size or not known.size:
        return "–"
    return f"{known.mean():.2f} / {np.percentile(known, 95):.2f}"


def _binned(rows: Sequence[Row], figure: Callable[[Row], float], edges: Sequence[float], what: str) -> str:
    names = ("zero-order-hold", "slice-trapezoid", "slice-pchip", "outline-surface")
    lines = []
    for low, high in pairwise(edges):
        mine = [row for row in rows if low <= figure(row) < high]
        many = len({row.seed for row in mine})
        if many:
            label = f"{low:g} to {high:g}" if high != edges[-1] else f"from {low:g}"
            lines.append((label, str(many), *(_mean_p95(_of(mine, name, 11)) for name in names)))
    return _table((what, "skeins", *(f"`{name}`" for name in names)), lines)


def _by_defect(rows: Sequence[Row]) -> str:
    names = ("zero-order-hold", "slice-trapezoid", "slice-pchip", "outline-surface")
    lines = []
    for defect in sorted({row.defect for row in rows}, key=lambda name: (name != "none", name)):
        mine = [row for row in rows if row.defect == defect]
        cells = (_mean_p95(_of(mine, name, 11)) for name in names)
        lines.append((defect, str(len({row.seed for row in mine})), *cells))
    return _table(("defect", "skeins", *(f"`{name}`" for name in names)), lines)


def _underside(rows: Sequence[Row]) -> str:
    """Fit the share on half of the skeins, and judge it on the other half."""
    mine = [row for row in rows if row.estimator == "outline-surface" and math.isfinite(row.error)]
    visible = np.array([1.0 + row.error for row in mine])
    true = np.array([row.true_share for row in mine])
    fit, judge = np.arange(len(mine)) % 2 == 0, np.arange(len(mine)) % 2 == 1
    if fit.sum() < 3 or not judge.any():
        return ""
    share, scatter = fitted_share(visible[fit], true[fit])
    model_std = np.array([row.std for row in mine])[judge]
    lines = []
    for name, factor, std in (("flat", 1.0, math.nan), ("rounded, fitted share", share, scatter)):
        off = 100.0 * (factor * visible[judge] / true[judge] - 1.0)
        inside = "not stated"
        if math.isfinite(std):
            total = np.hypot(factor * model_std, std * visible[judge])
            inside = f"{100.0 * np.mean(np.abs(factor * visible[judge] - true[judge]) < _K * total):.1f} %"
        lines.append((name, *_figures(off), inside))
    return (
        f"The share fitted to every other skein is {share:.3f} ± {scatter:.3f}; judged on the rest, per\n"
        "cent of the true volume, visible volume by `outline-surface`:\n\n"
        + _table(("underside", *_COLUMNS[:-1]), lines)
        + "\nNothing seen from above tells one underside from another. A second view, or weighed\n"
        "samples of the product, would.\n"
    )


def _times(rows: Sequence[Row]) -> str:
    base = np.nanmedian([row.milliseconds for row in rows if row.estimator == "zero-order-hold"])
    lines = []
    for name in dict.fromkeys(row.estimator for row in rows):
        took = np.nanmedian([row.milliseconds for row in rows if row.estimator == name])
        fast = np.nanpercentile([row.milliseconds for row in rows if row.estimator == name], 5)
        lines.append((f"`{name}`", f"{took:.3f} ms", f"{fast:.3f} ms", f"{took / base:.2f}"))
    return _table(("estimator", "median", "5 % point", "over zero-order-hold"), lines) + (
        "\nProcessor time of one call, on a machine that was busy with other work.\n"
    )


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = "|".join("---" for _ in head)
    body = [f"| {' | '.join(cells)} |" for cells in (head, *lines)]
    return "\n".join([body[0], f"|{rule}|", *body[1:]]) + "\n"
