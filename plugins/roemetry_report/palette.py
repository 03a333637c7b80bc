"""Colours that keep apart for colour-blind eyes, and in print."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats


def stripe_colour(stripe: int) -> str:
    """Colour of a stripe on a dark picture; neighbours and next-but-one neighbours differ for all eyes."""
    return ON_DARK[stripe % len(ON_DARK)]


def stripe_colour_on_paper(stripe: int) -> str:
    """Colour of the same stripe on a white page, dark enough for a thin line."""
    return ON_PAPER[stripe % len(ON_PAPER)]


def height_colour(share: float) -> str:
    """Colour of a height from 0 to the largest: dark to light, for all eyes and in print."""
    return "#" + "".join(f"{level:02x}" for level in mixed(HEIGHTS, np.array(share)).tolist())


def mixed(colours: Sequence[str], shares: Floats) -> NDArray[np.uint8]:
    """Give red, green and blue (…, 3) at shares (…) of the way from the first colour to the last."""
    known = np.array([[int(code[i : i + 2], 16) for i in (1, 3, 5)] for code in colours], np.float64)
    place = np.clip(shares, 0.0, 1.0) * (len(colours) - 1)
    levels = [np.interp(place, np.arange(len(colours)), known[:, k]) for k in range(3)]
    return np.rint(np.stack(levels, axis=-1)).astype(np.uint8)


HEIGHTS = ("#26456e", "#3f6b8c", "#5f8f98", "#8eb08f", "#c6c97c", "#f3dc78")
"""Heights from low to high; lightness grows steadily."""

# fmt: off
ON_DARK = (
    "#E78AC3", "#8FA2FF", "#2FB592", "#F0E442", "#B8A22E", "#56B4E9",
    "#D9F2FF", "#FFB14A", "#C9A0FF", "#5FD8D8", "#F2D6B3", "#9AD14B",
)
"""Twelve colours, ordered so that the least CIE 1976 difference of neighbours is 22 for normal eyes and for
full protan, deutan and tritan vision. More stripes begin again: the number at the top tells them apart."""

ON_PAPER = (
    "#B71D7C", "#3F5BE0", "#187059", "#7A7000", "#726317", "#0D689C",
    "#2F6E8C", "#A65A00", "#7E3FD0", "#166E6E", "#8E5612", "#4A6E17",
)
# fmt: on

BELT, PEAK, OUTLINE = "#8A97A3", "#F4F7FA", "#FFFFFF"
AMBIGUOUS, UNLABELLED, MARK = "#FF4D4D", "#9AA5B0", "#A9B4BE"
RISING = ("#F4F6E8", "#DCE8C2", "#BBD8A5", "#8FC495", "#5FAE8C", "#389383", "#237676", "#1D5A66", "#183F55")
"""From little to much, lightness falls evenly."""

DIVERGING = (
    "#21456E",
    "#3E719E",
    "#7BA4C4",
    "#BBD2E2",
    "#F3F3EE",
    "#F3CFA9",
    "#E2A066",
    "#BF6F2B",
    "#854310",
)
"""From negative (blue) to positive (brown), pale about zero; both ends differ for all eyes."""
