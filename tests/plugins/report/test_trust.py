"""The heat strip says what the margins are, row by row."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from roemetry.records import StripeMap
from roemetry_report.overview import CLASSES, classes_of, trust


def stripes_of(margin: np.ndarray, product: np.ndarray, *, ambiguous=None, bridged=None) -> StripeMap:
    """Give a map whose points are where the margin is not −1."""
    there = margin != -1.0
    nothing = np.full(margin.shape, np.nan)
    seen = there if bridged is None else there & ~bridged
    return StripeMap(
        x_px=np.where(there, 10.0, np.nan),
        x_std_px=nothing,
        product=np.where(there, product, -1).astype(np.int16),
        seen=seen,
        margin=np.where(there, margin, np.nan),
        ambiguous=np.zeros(margin.shape, bool) if ambiguous is None else ambiguous,
        rest_px=nothing,
        peak_stripe=np.full(3, -2, np.int16),
    )


@pytest.fixture
def drawn():
    margin = np.full((2, 30), 1.0)
    margin[0, 10:14], margin[0, 14:20], margin[1, 5:8] = 0.35, 0.6, -1.0
    product = np.zeros((2, 30))
    product[0, 8:22] = 1
    ambiguous = np.zeros((2, 30), bool)
    ambiguous[1, 6] = True
    return trust(stripes_of(margin, product, ambiguous=ambiguous))


def cells(drawing: str) -> dict[int, tuple[str, float]]:
    """Give class and height of each row of a band, and hold it to covering no row twice."""
    found: dict[int, tuple[str, float]] = {}
    for path in ElementTree.fromstring(drawing).iter():
        if not path.tag.endswith("path"):
            continue
        for x, y, width, height in re.findall(r"M(\d+) ([\d.]+)h(\d+)v([\d.]+)", path.get("d")):
            assert float(y) * 2 + float(height) == pytest.approx(10.0)
            for row in range(int(x), int(x) + int(width)):
                assert row not in found
                found[row] = path.get("class"), float(height)
    return found


def test_each_point_has_its_class_the_product_stands_out_and_the_first_strip_is_its_worst(drawn) -> None:
    assert [strip.name for strip in drawn.strips] == ["least", "1", "2"]
    least, first, second = (cells(strip.drawing) for strip in drawn.strips)
    assert sorted(first) == list(range(30))
    assert first[9] == ("t-sure", 10.0)
    assert first[10] == ("t-poor", 10.0)
    assert first[14] == ("t-weak", 10.0)
    assert first[2] == first[25] == ("t-sure", 5.0)
    assert not {5, 7} & set(second), "what is not seen is empty"
    assert second[6] == ("t-refused", 10.0)
    assert sorted(least) == [6, *range(8, 22)]
    assert [least[row][0] for row in (6, 8, 10, 15, 21)] == [
        "t-refused",
        "t-sure",
        "t-poor",
        "t-weak",
        "t-sure",
    ]


def test_doubt_says_what_it_is_when_it_is_pointed_at(drawn) -> None:
    titles = re.findall("<title>(.*?)</title>", drawn.strips[1].drawing)
    assert titles == ["rows 10 to 13: margin from 0.35", "rows 14 to 19: margin from 0.60"]
    assert "least on a product: 0.35, stripe 1, row 10; 29 % of its points" in drawn.notes[0]
    assert drawn.notes[1] == "3 peaks of the image refused as ambiguous"


def test_classes_hold_their_own_limits() -> None:
    margin = np.array([[1.0, 0.9, 0.89, 0.7, 0.5, 0.3, 0.29, 0.0]])
    kinds = classes_of(stripes_of(margin, np.ones(margin.shape)))[0]
    names = [CLASSES[kind][0] for kind in kinds]
    assert names == ["sure", "sure", "fair", "fair", "weak", "poor", "least", "least"]


def test_what_has_no_margin_has_no_strip() -> None:
    margin = np.full((2, 5), np.nan)
    margin[1] = -1.0
    assert trust(stripes_of(margin, np.zeros(margin.shape))) is None
    margin, bridged = np.full((1, 9), 0.95), np.zeros((1, 9), bool)
    bridged[0, 4] = True
    drawing = trust(stripes_of(margin, np.ones(margin.shape), bridged=bridged)).strips[1].drawing
    assert sorted(cells(drawing)) == [0, 1, 2, 3, 5, 6, 7, 8]
