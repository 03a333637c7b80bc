"""Stripe width, saturation and grey levels of simulated images beside those of real ones.

``python -m benchmarks image_looks [--images recipes/herring_roe/images]``

Real images are looked for in the folder that the environment variable ROEMETRY_REAL_DATA names
(``../shared/real``); without it only the simulated ones are measured. A peak is a local maximum that stands
30 grey levels above both sides. On the stripe is within half its width at half height; off the stripe is
farther than five such widths from every peak.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks, peak_widths

REAL = {
    "weld groove": ("weld_mit/weld2.png", 1),
    "wheel set": ("multi_stripe/wheelset.jpg", 1),
    "line on circle grid": ("laser_on_circle_grid/light_picture/*", 1),
}
_PROMINENCE = 30.0


def main() -> None:
    """Print a table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=Path("recipes/herring_roe/images"))
    given = parser.parse_args()
    real = Path(os.environ.get("ROEMETRY_REAL_DATA", "../shared/real"))
    print("| images | width at half height (px) | peaks cut off at white | on the stripe | off the stripe |")
    print("|---|---|---|---|---|")
    report("simulated herring roe", sorted(given.images.glob("*.png")), 0)
    for name, (pattern, turns) in REAL.items():
        report(name, sorted(real.glob(pattern))[:4], turns)


def report(name: str, files: list[Path], turns: int) -> None:
    """Print a row: medians, and the 5, 25, 50, 75, 95 % points of the grey levels."""
    if not files:
        print(f"| {name} | not here | | | |")
        return
    widths, cut, on, off = (
        np.concatenate(column) for column in zip(*(look(f, turns) for f in files), strict=True)
    )
    low, middle, high = np.percentile(widths, [10, 50, 90])
    levels = [" ".join(f"{v:.0f}" for v in np.percentile(grey, [5, 25, 50, 75, 95])) for grey in (on, off)]
    width = f"{middle:.1f} ({low:.1f}–{high:.1f})"
    print(f"| {name} | {width} | {100 * cut.mean():.1f} % | {levels[0]} | {levels[1]} |")


def look(file: Path, turns: int) -> tuple[NDArray[np.float64], ...]:
    """Give widths, cut-off flags, grey levels on and off the stripes."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{file}: cannot be read")
    colours = image.astype(np.float64)
    # a red line in a lit room stands out by its colour alone
    lit_room = "light_picture" in str(file)
    light = np.clip(colours[..., 2] - colours[..., 1], 0.0, None) if lit_room else colours.max(axis=2)
    grey = np.rot90(light, turns)
    white = np.rot90(colours.max(axis=2), turns)
    widths, cut = [], []
    on, near = np.zeros(grey.shape, bool), np.zeros(grey.shape, bool)
    columns = np.arange(grey.shape[1])
    for number in range(0, grey.shape[0], 2):
        row = grey[number]
        peaks, _ = find_peaks(row, prominence=_PROMINENCE)
        width = peak_widths(row, peaks, rel_height=0.5)[0]
        widths.append(width)
        cut.append(white[number, peaks] >= 255.0)
        for x, w in zip(peaks, width, strict=True):
            on[number] |= np.abs(columns - x) <= 0.5 * w
            near[number] |= np.abs(columns - x) <= 5.0 * w
    rows = np.arange(0, grey.shape[0], 2)
    return (
        np.concatenate(widths),
        np.concatenate(cut).astype(float),
        grey[rows][on[rows]],
        grey[rows][~near[rows]],
    )


if __name__ == "__main__":
    main()
