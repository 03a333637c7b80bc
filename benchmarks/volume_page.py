"""The page docs/measurements/volume.md, made of what `python -m benchmarks volume` measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.coding_plots import curves
from benchmarks.volume_bodies import RIGS, BodyRow, bodies
from benchmarks.volume_tables import (
    BENDS_DEG,
    OVERHANGS,
    binned,
    by_defect,
    covered,
    enough,
    from_images,
    judged,
    middles_of,
    of,
    times,
    with_stripes,
)
from benchmarks.volume_underside import by_share, underside

if TYPE_CHECKING:
    from benchmarks.volume import Row
    from benchmarks.volume_images import Pictured

BY_STRIPES = (
    "zero-order-hold",
    "slice-sum",
    "slice-trapezoid",
    "slice-simpson",
    "slice-pchip",
    "slice-spline",
    "outline-surface",
    "surface-mesh, poisson",
)
DRAWN = ("zero-order-hold", "slice-trapezoid", "slice-pchip", "outline-surface")
STATED = ("slice-sum", "slice-trapezoid", "slice-simpson", "slice-pchip", "slice-spline", "outline-surface")
IN_IMAGES = ("slice-sum", "slice-trapezoid", "slice-pchip", "outline-surface")
_LOW = 1e-4


class Seeds(NamedTuple):
    """What was measured: first seed, skeins, how many with meshes, images asked for, their first seed.

    `bodies` is the first seed of the known bodies' rigs; `draws` how many each interval from images is of.
    """

    first: int
    count: int
    meshes: int
    images: int
    images_from: int
    draws: int
    bodies: int


class Pictures(NamedTuple):
    """What was measured from images: of skeins nothing was chosen on, of others, and what was refused."""

    unseen: Sequence[Pictured]
    looked_at: Sequence[Pictured]
    refusals: Sequence[str]


def page(
    rows: Sequence[Row],
    pictures: Pictures,
    known: Sequence[BodyRow],
    seeds: Seeds,
    plots: Path,
) -> str:
    """Write the plots into a folder and give the page."""
    eleven = [row for row in rows if row.stripes == 11]
    first_ones = [row for row in eleven if row.seed < seeds.first + seeds.meshes]
    draw(rows, plots)
    parts = [
        _HEAD.format(
            last=seeds.first + seeds.count - 1, pictured=_images(pictures.unseen), **seeds._asdict()
        ),
        "## Eleven stripes, exact centres and outline\n",
        judged([row for row in eleven if not row.estimator.startswith("surface-mesh")]),
        _COVERAGE,
        *(
            ["### Meshes\n", judged(first_ones), _MESHES.format(count=seeds.meshes)]
            if any(row.estimator.startswith("surface-mesh") for row in first_ones)
            else []
        ),
        "## From images\n",
        from_images(pictures.unseen),
        _FROM_IMAGES.format(draws=seeds.draws),
        _refused(pictures.refusals),
        *_looked_at(pictures.looked_at),
        "## Known bodies\n",
        bodies(known, ("outline-surface", "slice-pchip")),
        _BODIES.format(first=seeds.bodies, last=seeds.bodies + RIGS - 1, rigs=RIGS),
        "## How many stripes are enough\n",
        _PLOT.format(what="number of stripes", name="stripes"),
        with_stripes(rows, BY_STRIPES),
        _STRIPES,
        enough(rows, [name for name in BY_STRIPES if not name.startswith("surface-mesh")]),
        _ENOUGH,
        covered(rows, STATED),
        _COVERED,
        "## Overhang\n",
        _PLOT.format(what="overhang", name="overhang"),
        binned(eleven, lambda row: row.overhang, OVERHANGS, "spacings beyond the outer lit point", DRAWN),
        "## Bending\n",
        _PLOT.format(what="bending", name="bending"),
        binned(eleven, lambda row: row.bend_deg, BENDS_DEG, "turn of the mid-line, degrees", DRAWN),
        "## Defects\n",
        by_defect(eleven, DRAWN),
        "## Underside: from visible to true\n",
        underside(eleven, pictures.unseen),
        by_share(eleven),
        "## Time\n",
        times(eleven),
    ]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def draw(rows: Sequence[Row], plots: Path) -> None:
    """Draw mean absolute error over stripes, overhang and bending."""
    eleven = [row for row in rows if row.stripes == 11]
    lines: dict[str, list[tuple[float, float]]] = {}
    for name in DRAWN:
        for stripes in sorted({row.stripes for row in rows}):
            error = of(rows, name, stripes)
            if np.isfinite(error).mean() >= 0.5:
                lines.setdefault(name, []).append((float(stripes), float(np.nanmean(np.abs(error)))))
    _drawn(plots / "volume-stripes.svg", lines, "stripes over 87.5 mm")
    for what, figure, edges, across in (
        ("overhang", lambda row: row.overhang, OVERHANGS, "overhang, spacings"),
        ("bending", lambda row: row.bend_deg, BENDS_DEG, "turn of the mid-line, degrees"),
    ):
        binned_lines = {name: middles_of(eleven, figure, edges, name) for name in DRAWN}
        _drawn(plots / f"volume-{what}.svg", binned_lines, across)


def _drawn(path: Path, lines: Mapping[str, Sequence[tuple[float, float]]], across: str) -> None:
    kept = {name: points for name, points in lines.items() if points}
    if kept:
        curves(path, kept, across, "mean absolute error of the visible volume", low=_LOW)


def _images(pictures: Sequence[Pictured]) -> str:
    seeds = sorted({row.seed for row in pictures})
    return f"Images: {len(seeds)} more, seeds {seeds[0]} to {seeds[-1]}." if seeds else ""


def _looked_at(pictures: Sequence[Pictured]) -> list[str]:
    if not pictures:
        return []
    many = len({row.seed for row in pictures})
    return [
        f"On the {many} on which the widths of the intervals were looked at while they were chosen:\n",
        from_images(pictures, IN_IMAGES),
    ]


def _refused(refusals: Sequence[str]) -> str:
    if not refusals:
        return "No skein was refused.\n"
    return "Refused, as a run refuses them, and in no figure above:\n\n" + "".join(
        f"- {text}\n" for text in refusals
    )


_PLOT = "![Error over {what}](../images/volume-{name}.svg)\n"

_HEAD = """\
# Volume estimators, measured

Made by

```sh
python -m benchmarks volume --first {first} --count {count} --meshes {meshes} \\
    --images {images} --images-from {images_from}
```

{count} simulated herring roe skeins of all kinds, seeds {first} to {last}, each on a rig of its own
(camera 270 to 420 mm above the belt, laser on either side, stripes over 87.5 mm). {pictured}
Errors are those of the **visible volume**, the integral of the top surface's height over the footprint, in
per cent of the truth.

Nothing was chosen on these. While the estimators were made, skeins of the seeds below 3000, 30000 to
30499 and 40000 to 40059 were looked at, and known bodies on rigs of the seeds 96001 to 96024 and 97001
to 97024; when the widths of the intervals were chosen, 60000 to 60499 and images of the seeds 70000 to
70059, 90000 to 90059 and 110000 to 110059. (Earlier studies were of the same 500 skeins; they said which
intervals were wrong under some numbers of stripes and from images, and one skein, 80136, was off by 15 %
under 21 stripes, whereupon quadrics larger than the product were ruled out. No constant was fitted to
them.)

Stripe centres, planes and silhouettes are exact unless it says *from images*: what is left is the error
of the method.
"""

_COVERAGE = """
*Intervals with the truth*: share of products whose 95 % interval (value ± 1.96 standard uncertainties)
holds the true visible volume; *median width* is that of the interval. The outline's own uncertainty is 0
here. The factor of the last line was fitted on these very skeins, which favours it.
"""

_MESHES = """
The first {count} of these skeins, under all estimators: a mesh takes hundreds of times as long. Meshes
lie too low, by what a chain of flat faces lies below a dome; their intervals hold that as a doubt.
"""

_FROM_IMAGES = """
The chain: `maximum-likelihood`, `window-tracking`, the true planes of light, `edge-contour` without an
image of the empty belt, 8-bit images of 640 × 480 with speckle and noise. Nothing is taken from the
truth but the calibration. Intervals are those of {draws} draws each: the noise of the peaks, the
outline's place, and the estimator's own error, as a run with `--draws` has them; the calibration is
exact here, and draws nothing.
"""

_BODIES = """
Each cell: mean absolute error / largest, per cent of the visible volume / how many of the 95 % intervals
hold the truth. Each body lies somewhere else on {rigs} rigs, seeds {first} to {last}; centres and
silhouettes are exact. Without an outline ellipsoids, balls, their caps and nearly eggs are found by the
[quadric](../reference/plugins/slice-pchip.md#ends) through their outer slices. An upright end is known
as such by slices that do not fall; where between two stripes it stands is not, unless a slice runs over
its edge, and of a product that goes on beyond the outermost stripe even less: the intervals allow for
that.

The rigs of this table had been looked at to learn where errors come from. On 24 that never were, seeds
101001 to 101024, half ellipsoids are off by at most 0.22 % with an outline and 0.20 % without, the
staircase by 1.09 % on average and 3.5 % at most, and 360 and 358 of 360 intervals hold.

A staircase's riser that stripes cross is [found](../reference/plugins/outline-surface.md) to a tenth of a
millimetre: where they cross all three, the volume is off by 0.0 to 0.4 %. One of 4 mm that no stripe crosses
lies anywhere between two of them: a standard deviation of 1.2 to 1.6 % of the volume each, 2.7 % for three,
whatever surface is laid through the stripes. Only the outline's jogs or a plain-light image could tell more.

Some fillets gape: a furrow 3 to 8 mm wide, nearly along the stripes, passes between two of them unseen.
Nothing in stripes or outline tells of it, and no budget holds it; on these rigs every fillet whose
interval misses is such a one.
"""

_STRIPES = """
Each cell: mean absolute error / 95 % point, per cent. All over the same 87.5 mm: 11 stripes are 8.75 mm
apart. A dash: fewer than three stripes lie on most products.
"""

_ENOUGH = """
The smallest number of stripes, of those tried, from which on 95 % of the skeins are off by less than the
limit. A dash: none of them. More stripes help the outline's surface to the end; from slices alone the ends
are guessed, and beyond 21 stripes little is gained. A coder tells 11 stripes apart far more easily than 41.
"""

_COVERED = """
Share of the 95 % intervals that hold the truth / their median width, per cent. Three stripes over this width
put fewer than three on most products: only the paper's sum gives a number there. With exact centres the
slices' intervals are wider than they need be, since they are to hold from images, too, and where a product
other than roe goes on beyond the outermost stripe.
"""
