"""What every outliner keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from roemetry.stages import Outliner
from roemetry.testing.cases import cases_for
from roemetry.testing.verdict import require


def check_contours_lie_in_the_image(outliner: Outliner[Any]) -> None:
    """Contours have at least three points, lie within the image, and are numbered from 1, each once."""
    case = cases_for(outliner).ordinary
    rows, columns = case.inputs[0].size
    outlines = case.call(outliner)
    require(outlines, "a bright product on a dark belt is not found")
    numbers = [outline.product for outline in outlines]
    require(len(set(numbers)) == len(numbers) and min(numbers) >= 1, f"they are numbered {numbers}")
    for outline in outlines:
        require(outline.xy_px.shape[0] >= 3, f"a contour of {outline.xy_px.shape[0]} points")
        inside = (outline.xy_px >= -0.5) & (outline.xy_px <= np.array([columns, rows]) - 0.5)
        require(bool(inside.all()), "a contour leaves the image")


CHECKS = (check_contours_lie_in_the_image,)
