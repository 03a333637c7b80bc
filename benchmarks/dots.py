"""``python -m benchmarks dots``: dots on drawn and on rendered images, against their truth.

Centres are compared with the Cramér–Rao bound of drawn dots without speckle; labels, heights and volumes with
the truth of products that the ray-caster renders with the rig of `recipes/potato_dots`, in its calibration of
boards. Rendered images are kept in a folder and used again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from benchmarks.patterns import DOTS, HEIGHT_HEAD, NEAR_PX, VOLUME_HEAD, Tally, rendered, tell
from benchmarks.tables import table
from roemetry import Recipe
from roemetry.records import Frame, Sensor
from roemetry.records.arrays import Floats
from roemetry.run.pipeline import Pipeline
from roemetry_patterns.dot_centres import DotCentres

PAGE = Path("docs/measurements/dots.md")
FAMILIES = ("potato", "herring-roe", "egg")
_GAIN, _READ, _DARK = 0.05, 0.8, 6.0
"""Grey levels an electron makes, read noise and background of drawn dots, grey levels."""
_DRAWN = ((25.0, 1.3, 0.0), (40.0, 1.5, 0.5), (120.0, 1.5, 0.0), (180.0, 1.8, 0.3))
"""Height, grey levels, size, px, and how much longer than wide."""
_SIDE, _PITCH = 16, 16


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=29000, help="first seed of drawn dots and of products")
    parser.add_argument("--count", type=int, default=8, help="products of each family")
    parser.add_argument("--images", type=Path, default=Path("build/dots"), help="folder of rendered images")
    parser.add_argument("--write", action="store_true", help=f"write the tables of {PAGE}")
    given = parser.parse_args()
    parts = {"centres": centres(given.seed), **products(given.seed, given.count, given.images)}
    tell(parts, PAGE if given.write else None)


def centres(seed: int) -> str:
    """Write errors of centres over their bound, and over what is stated."""
    rng = np.random.default_rng(seed)
    rows = []
    for height, size_px, longer in _DRAWN:
        shape = size_px**2 * np.array([[1.0 + longer, 0.3 * longer], [0.3 * longer, 1.0]])
        off, over = [np.empty((0, 2))], [np.empty((0, 2))]
        for _ in range(8):
            places, light = _drawn(rng, height, shape)
            noisy = rng.poisson((light + _DARK) / _GAIN) * _GAIN + rng.normal(0.0, _READ, light.shape)
            pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
            peaks = DotCentres().extract(Frame(pixels, sensor=Sensor(_GAIN, _READ)))
            assert peaks.dots is not None
            found = np.column_stack([peaks.x_px, peaks.dots.y_px])
            away = np.linalg.norm(found[:, None] - places[None], axis=2)
            near = away.min(axis=1) < NEAR_PX
            error = (found - places[away.argmin(axis=1)])[near]
            off.append(error)
            std = np.sqrt(np.diagonal(peaks.dots.covariance_px2[near], axis1=1, axis2=2))
            over.append(error / std)
        error, ratio = np.concatenate(off), np.concatenate(over)
        rms, bound = np.sqrt((error**2).mean(axis=0)), _bound(rng, height, shape)
        rows.append([
            f"{height:g}", f"{size_px:g} × {size_px * np.sqrt(1 + longer):.2g}",
            f"{len(error)} of {8 * _SIDE**2}", f"{rms[0]:.4f}, {rms[1]:.4f}",
            f"{rms[0] / bound[0]:.3f}, {rms[1] / bound[1]:.3f}", f"{np.mean(np.abs(ratio) < 1.96):.1%}",
        ])  # fmt: skip
    head = ["height, grey levels", "size, px", "found", "rms x, y, px", "over the bound"]
    return table([*head, "95 % intervals hold"], rows)


def _drawn(rng: np.random.Generator, height: float, shape: Floats) -> tuple[Floats, Floats]:
    at = _PITCH * (1.5 + np.arange(_SIDE))
    places = np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2) + rng.uniform(-0.5, 0.5, (_SIDE**2, 2))
    y, x = np.mgrid[: _PITCH * (_SIDE + 2), : _PITCH * (_SIDE + 2)].astype(np.float64)
    inverse, light = np.linalg.inv(shape), np.zeros(x.shape)
    for place in places:
        off = np.stack([x - place[0], y - place[1]], axis=2)
        light += height * np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", off, inverse, off))
    return places, light


def _bound(rng: np.random.Generator, height: float, shape: Floats) -> Floats:
    """Cramér–Rao bound of x and y, px, of one dot whose height, background and shape are not known either."""
    y, x = np.mgrid[-12:13, -12:13].reshape(2, -1).astype(np.float64)
    variances = []
    for phase in rng.uniform(-0.5, 0.5, (40, 2)):
        off = np.column_stack([x, y]) - phase
        pull = off @ np.linalg.inv(shape)
        form = np.exp(-0.5 * (off * pull).sum(axis=1))
        m = height * form
        slopes = np.column_stack(
            [m * pull[:, 0], m * pull[:, 1], form, np.ones_like(m),
             0.5 * m * pull[:, 0] ** 2, m * pull[:, 0] * pull[:, 1], 0.5 * m * pull[:, 1] ** 2]
        )  # fmt: skip
        variance = _READ**2 + 1.0 / 12.0 + _GAIN * (m + _DARK)
        variances.append(np.diag(np.linalg.inv((slopes / variance[:, None]).T @ slopes))[:2])
    return np.asarray(np.sqrt(np.mean(variances, axis=0)))


def products(seed: int, count: int, folder: Path) -> dict[str, str]:
    """Write labels, heights and volumes of every family."""
    pipeline, labels, volumes = Pipeline(Recipe.load(DOTS)), [], []
    for family in FAMILIES:
        found = Tally(family)
        for number in range(count):
            item = rendered(folder / f"{family}-{seed}-{number}.pickle", DOTS, family, seed, number)
            found.add(pipeline, item, f"{family}_{number}")
        right, wrong, missed, strays = found.counts.tolist()
        share, of = f"{right / max(right + wrong + missed, 1):.2%}", f"{wrong} of {right + wrong}"
        labels.append([family, share, of, f"{strays}", f"{missed}", *found.height_cells()])
        volumes.append([family, *found.volume_cells()])
    head = ["product", "right", "wrong", "false light labelled", "no label", *HEIGHT_HEAD]
    return {"labels": table(head, labels), "volumes": table(["product", *VOLUME_HEAD], volumes)}
