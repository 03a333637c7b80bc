"""Six skeins as in the paper: Figures 17 to 22, and Table 1."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.traced.tables import BEST_OPTIONS
from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry.records import Peaks, StripeMap, Trace
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions

SIX = ("skein_01", "skein_03", "skein_05", "skein_06", "skein_07", "skein_10")
"""Good, dented, bent, twisted, folded, broken: one of each that the paper's five henkei may have been."""

FIRST_FIGURE = 17
PAPERS_CODER = ("stages.coder.use=window-tracking",)
"""The recipe's own coder is another one; all else in it is the paper's."""

Picture = NDArray[np.uint8]
_PANEL = (320, 240)
_GAP = 6
_SEEN, _BRIDGED = (255, 255, 255), (80, 160, 255)


class Sample(NamedTuple):
    """One line of the table."""

    name: str
    made: str
    true_g: float
    volume_cm3: float
    weight_g: float
    paper: str
    best: str


def measured(recipe_folder: Path, images: Path) -> list[Sample]:
    """Measure the six by the shipped recipe with the paper's coder, and draw their figures into a folder."""
    recipe = Recipe.load(recipe_folder, sets=PAPERS_CODER)
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    data = Dataset(recipe_folder)
    truths = {item.id: item.products[0] for item in data.items()}
    found = []
    for reference in source.references(recipe.source_path):
        if reference.id not in SIX:
            continue
        trace, known = pipeline.trace(source.read(reference)), truths[reference.id]
        one = trace.products[0]
        assert one.volume is not None
        assert one.weight is not None
        assert one.grade is not None
        images.mkdir(parents=True, exist_ok=True)
        figure = images / f"figure-{FIRST_FIGURE + len(found)}.jpg"
        cv2.imwrite(str(figure), panels(trace), [cv2.IMWRITE_JPEG_QUALITY, 82])
        found.append(
            Sample(
                reference.id,
                "good" if known.defect == "none" else known.defect,
                known.mass_g,
                one.volume.visible_mm3.value / 1000.0,
                one.weight.mass_g.value,
                one.grade.label,
                best.classify(one.product).label,
            )
        )
    return found


def panels(trace: Trace) -> Picture:
    """Draw the paper's four: image, dominant peaks, peaks over the image, curves after connection."""
    assert trace.frame is not None
    assert trace.peaks is not None
    assert trace.stripes is not None
    frame = trace.frame
    grey = (frame.pixels.astype(np.float64) * 255.0 / frame.white).round().astype(np.uint8)
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    black = np.zeros_like(image)
    over = cv2.addWeighted(image, 0.6, black, 0.4, 0.0)
    drawn = [
        cv2.resize(image, _PANEL, interpolation=cv2.INTER_AREA),
        _half(_dotted(black, trace.peaks, (255, 255, 255))),
        _half(_dotted(over, trace.peaks, (60, 220, 255))),
        _half(_connected(black, trace.stripes)),
    ]
    gap = np.full((_PANEL[1], _GAP, 3), 255, np.uint8)
    return np.hstack([part for panel in drawn for part in (panel, gap)][:-1])


def _dotted(picture: Picture, peaks: Peaks, colour: tuple[int, int, int]) -> Picture:
    dotted = picture.copy()
    dotted[peaks.row, np.floor(peaks.x_px + 0.5).astype(np.int64)] = colour
    return dotted


def _connected(picture: Picture, stripes: StripeMap) -> Picture:
    drawn = picture.copy()
    on = stripes.product > 0
    for kind, colour in ((on & ~stripes.seen, _BRIDGED), (on & stripes.seen, _SEEN)):
        stripe, row = np.nonzero(kind & np.isfinite(stripes.x_px))
        drawn[row, np.floor(stripes.x_px[stripe, row] + 0.5).astype(np.int64)] = colour
    return drawn


def _half(picture: Picture) -> Picture:
    """Make it half as large; a dot stays a dot."""
    wide = cv2.dilate(picture, np.ones((2, 2), np.uint8))
    return np.asarray(wide[::2, ::2], np.uint8)
