"""The page docs/measurements/paper-experiment.md, made of what the benchmark measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.experiment import crowd
from benchmarks.experiment.six import FIRST_FIGURE, Sample
from benchmarks.grading.scores import Judged, confusion_of
from benchmarks.tables import confusion, table
from benchmarks.traced.tables import NAMED, Row

_NAMES = list(dict.fromkeys(NAMED.values()))


def page(
    six: Sequence[Sample],
    rows: Sequence[Row],
    found: Mapping[str, Sequence[Judged]],
    rendered: str,
    images: Path,
) -> str:
    """Write the page, and its curves into a folder."""
    head = _HEAD.format(
        count=len(rows), first=rows[0].seed, last=rows[-1].seed, refused=sum(bool(r.refused) for r in rows)
    )
    parts = [
        head,
        "## Table 1\n",
        _table_1(six),
        _TABLE_1,
        "## Figures 17 to 22\n",
        "From left to right: the image, dominant peaks, peaks over the image, the curves of the product\n"
        "after connection (bridged points in orange).\n",
        *_figures(six),
        f"## {len(rows)} skeins: good against deformed\n",
        crowd.good_against_deformed(found),
        "## Which defect escapes which classifier\n",
        crowd.by_kind(found),
        _WHO,
        *(
            f"What {name} takes them for:\n\n{_taken(found[name])}"
            for name in ("`learned`", "`shape-limits`")
        ),
        "## Dents and the spacing of the stripes\n",
        "![Share of dents caught over their extent in spacings](../images/paper/over-spacing.svg)\n",
        crowd.over_spacing(found, images / "over-spacing.svg"),
        _SPACING,
        "## How many stripes would show it\n",
        "![Share of defects shown over the number of stripes](../images/paper/by-stripes.svg)\n",
        crowd.by_stripes(rows, images / "by-stripes.svg"),
        _STRIPES,
        "## Where the weight goes wrong\n",
        "![Error of the weight by cause](../images/paper/weight.svg)\n",
        crowd.weights(rows, images / "weight.svg"),
        _WEIGHT,
        "## The same on pictures\n",
        _RENDERED,
        rendered,
    ]
    return "\n".join(parts).rstrip() + "\n"


def _taken(judged: Sequence[Judged]) -> str:
    kinds = ["good", *crowd.KINDS]
    return confusion(confusion_of(judged, by_kind=True), [*_NAMES, "unknown"], "made \\ called", kinds)


def _table_1(six: Sequence[Sample]) -> str:
    errors = [100.0 * (one.weight_g / one.true_g - 1.0) for one in six]
    lines = [
        [
            one.name,
            one.made,
            f"{one.true_g:.1f}",
            f"{one.volume_cm3:.2f}",
            f"{one.weight_g:.1f}",
            f"{error:+.1f} %",
            one.paper,
            one.best,
        ]
        for one, error in zip(six, errors, strict=True)
    ]
    lines.append(["mean absolute", "", "", "", "", f"{sum(map(abs, errors)) / len(errors):.1f} %", "", ""])
    head = ["sample", "made", "true weight, g", "volume, cm³", "estimated weight, g", "error"]
    return table([*head, "paper's rule", "best options"], lines)


def _figures(six: Sequence[Sample]) -> list[str]:
    return [
        f"![Figure {number}: {one.name}](../images/paper/figure-{number}.jpg)\n\n"
        f"*Figure {number}. {one.name}, {one.made}.*\n"
        for number, one in enumerate(six, start=FIRST_FIGURE)
    ]


_HEAD = """\
# The paper's experiment, again and at scale

Lee et al. (2000) tried their method on six skeins, weighed five of them, and printed Table 1 and Figures 17
to 22. Here are that table and those figures for six simulated skeins, whose every answer is known, and then
what {count} skeins say of the same method, of what it confuses, and of where its weight goes wrong.

Made by `python -m benchmarks paper_experiment --count {count}`. The six are images that come with the
recipe, coded by `window-tracking`. The {count} are traced ray by ray without a rendered image, seeds
{first} to {last} of the whole population, each on a rig of its own about the recipe's; {refused} of them
were refused by the coder. The options of the paper's rule, the limits and the model of `learned` were
chosen and fitted on other seeds; how the limit of *good* is chosen was changed after a look at the first
200. What `learned` does on skeins and rigs that nobody had looked at is on
[Grading](../explanation/grading.md).
"""

_TABLE_1 = """\
The paper's own five: +10.7, −12.0, +20.2, −2.7 and +0.7 %, mean absolute error 9.3 %. Which defect its
henkei had, it does not say. Its rule finds what bows a stripe inwards; a skein that is bent in the plane of
the belt, or broken between two stripes, is convex wherever light falls on it.
"""

_WHO = """\
Share that is called deformed. *Shown*: skeins of which a lit stripe lies 1 mm or more deep in the defect;
for a bent one that is the crease on its inner side, and a bend without a crease is not counted as shown
though its middle line tells it.
"""

_SPACING = """\
A dent that is narrower than the spacing may lie between two stripes. Then no stripe is displaced by it, and
no classifier can know; the line *shown* is what can be had at all.
"""

_STRIPES = """\
By how many stripes it could be shown: evenly spaced lines over the same width as the rig's eleven. What
hides behind the product counts as seen here, so this is the most that so many stripes could show. More
stripes stand closer, and coding has to tell them apart ([Coding](../explanation/coding.md)).
"""

_WEIGHT = """\
The error of the paper's weight is taken apart step by step, so that the parts add up, each relative to the
true mass:

- **density**: the skein's own density is not 1.1 g/cm³. Its scatter of 0.02 g/cm³ is an assumption, nothing
  more;
- **underside**: the visible volume stands for the true one, with the rounded underside and the air below;
- **ends**: before the first lit stripe nothing is counted, after the last its section is held to the next
  stripe;
- **between stripes**: each upright section is held to the next stripe;
- **points**: planes of light lean and draw together upwards, flanks are hidden or too dim, peaks scatter:
  sections are not the upright ones;
- **calibration**: one scale for all heights and one coefficient a stripe, from a block 16.5 mm high, and
  peaks at whole pixels.
"""

_RENDERED = """\
A check of the traced skeins with pictures: rendered images of the recipe's own rig with speckle and noise,
seeds from 9000, calibrated by the recipe's block. `dominant-peak` for the paper's rule, `centre-of-gravity`
for `learned`.
"""
