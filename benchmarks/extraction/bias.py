"""Mean errors over sub-pixel phases, heights and widths: what averaging would not take away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.extraction.drawing import Drawn, Light, Stripes, draw
from benchmarks.extraction.methods import Method
from benchmarks.extraction.scoring import hits, rms
from benchmarks.tables import Table, number
from roemetry.records.arrays import Floats

PHASES = 10
AMPLITUDES = (60.0, 120.0, 200.0)
SIGMAS_PX = (1.5, 2.2, 3.0)
ROWS_AN_IMAGE = 1000
_PITCH_PX = 60
_CONTRAST = {"clean": 0.0, "speckle": 0.15}


def bias(methods: Sequence[Method], rows: int, seed: int) -> Table:
    """Give the largest mean error over all cells; `rows` is the number of rows behind each mean when clean.

    With speckle five times as many are drawn, since the scatter is larger.
    """
    results: dict[str, list[str]] = {method.name: [method.name] for method in methods if not method.slow}
    for kind, contrast in _CONTRAST.items():
        images = max(1, (rows if kind == "clean" else 5 * rows) // ROWS_AN_IMAGE)
        means = {name: np.full((images, 3, 3, PHASES), np.nan) for name in results}
        for cell, (sigma, top) in enumerate((s, a) for s in range(3) for a in range(3)):
            for image in range(images):
                rng = np.random.default_rng([seed, 13, cell, image, int(contrast > 0)])
                drawn = phases(SIGMAS_PX[sigma], AMPLITUDES[top], contrast, rng)
                for method in methods:
                    if method.name in results:
                        error = hits(drawn.stripes, method.find(drawn.pixels, drawn.light)).error_px
                        means[method.name][image, sigma, top] = mean_of(error)
        for name, by_image in means.items():
            results[name] += summary(by_image)
    return Table(
        f"Bias: the largest of {PHASES} × {len(AMPLITUDES)} × {len(SIGMAS_PX)} mean errors "
        f"({rows} rows each when clean, {5 * rows} with speckle), px",
        [
            "method",
            *(f"{kind}: {what}" for kind in _CONTRAST for what in ("largest", "typical standard error")),
        ],
        list(results.values()),
    )


def phases(sigma_px: float, amplitude: float, contrast: float, rng: np.random.Generator) -> Drawn:
    """Draw ten upright stripes, one a sub-pixel phase."""
    x_px = (_PITCH_PX * (np.arange(PHASES) + 0.5) + np.arange(PHASES) / PHASES)[:, None]
    ones = np.ones((PHASES, ROWS_AN_IMAGE))
    stripes = Stripes(x_px * ones, sigma_px * ones, amplitude * ones, ones.astype(bool))
    return draw(stripes, (ROWS_AN_IMAGE, _PITCH_PX * (PHASES + 1)), rng, Light(contrast))


def mean_of(error: Floats) -> Floats:
    """Give each stripe's mean error; NaN where it was never found."""
    count = np.isfinite(error).sum(axis=1)
    return np.where(count > 0, np.nansum(error, axis=1) / np.maximum(count, 1), np.nan)


def summary(by_image: Floats) -> list[str]:
    """Give the largest mean over the images with its sign, and the typical standard error of such a mean.

    The standard error comes from the scatter among images: neighbouring rows share their speckle.
    """
    if np.isnan(by_image).any():
        return ["not always found", "–"]
    mean = by_image.mean(axis=0)
    images = by_image.shape[0]
    error = by_image.std(axis=0, ddof=1) / np.sqrt(images) if images > 1 else np.full(mean.shape, np.nan)
    return [number(float(mean.ravel()[np.abs(mean).argmax()]), 4), number(float(rms(error)), 4)]
