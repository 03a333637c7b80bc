"""What a grader is not even asked about."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from roemetry import Recipe

ANY = "stages.grader={use: grade-table, options: {classes: [{label: any}]}}"
ALONE = ("stages.volume=null", "stages.weigher=null", "stages.classifier=null")


@pytest.mark.parametrize("sets", [(), ALONE], ids=["with other stages", "the only stage"])
def test_a_product_that_is_cut_by_the_images_edge_is_not_decided_upon(
    line: Callable[..., Path], rig, sets: tuple[str, ...]
) -> None:
    path = line(count=1)
    cut = rig.image(rig.x_px(rig.dome(first=170, last=270)))
    cv2.imwrite(str(path.parent / "images" / "p02.png"), cut)
    whole, at_the_edge = Recipe.load(path, sets=[ANY, *sets]).run()
    assert whole.decision is not None and whole.decision.label == "any"
    assert at_the_edge.decision is None
    assert at_the_edge.absent["grader"].code == "cut-by-edge"
