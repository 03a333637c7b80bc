"""The page docs/explanation/grading.md, made of what `python -m benchmarks grade` measured."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.coding_plots import curves
from benchmarks.grading.judges import GOOD
from benchmarks.grading.scores import Judged, confusion_of, graded_of, score_of
from benchmarks.grading.words import confusion, ends, share, table
from benchmarks.traced.tables import NAMED, Row
from roemetry.compare.agreement import Terms
from roemetry.compare.grading import reliability_of
from roemetry.compare.resampling import wilson
from roemetry.records import Fitted
from roemetry_shape.shape_limits import ShapeLimitsOptions

RIGS = {
    "recipe-like": "rigs about the recipe's",
    "farther": "another design, camera 270 to 420 mm above the belt",
    "dense": "21 stripes 5 mm apart, wide angle, three times the noise",
}
_BIN_MIN = 5
"""A share of fewer products is not drawn."""

_STATED_MIN = 20
"""Of fewer products with a probability nothing is said."""

_SHOWN_MM = (0.0, 0.3, 0.6, 1.0, 2.0, 4.0, np.inf)
_NAMES = list(dict.fromkeys(NAMED.values()))
Found = Mapping[str, Mapping[str, Sequence[Judged]]]


def page(
    learning: Sequence[Row],
    fitted: Fitted,
    limits: ShapeLimitsOptions,
    tests: Mapping[str, Sequence[Row]],
    found: Found,
    model_bytes: int,
    docs: Path,
) -> str:
    """Write the page, and its curve into the folder `images` of the docs."""
    seeds = "\n".join(
        f"- {RIGS[rig]}: seeds {rows[0].seed} to {rows[-1].seed}, "
        f"{sum(not row.features for row in rows)} refused;"
        for rig, rows in tests.items()
    )
    parts = [
        _HEAD.format(
            learn=len(learning),
            test=len(next(iter(tests.values()))),
            first=learning[0].seed,
            last=learning[-1].seed,
            seeds=seeds,
        ),
        *(_results(rig, by_judge) for rig, by_judge in found.items()),
        _DENSE,
        "## Over the size of what is shown\n",
        _SIZE,
        _over_shown(found["recipe-like"]),
        "## Which defect is taken for which\n",
        "`learned`, the test on rigs about the recipe's, whether a stripe shows the defect or not.\n",
        confusion(confusion_of(found["recipe-like"]["`learned`"]), [*_NAMES, "unknown"], "is \\ called"),
        _calibration(found, docs / "images" / "grading-probabilities.svg"),
        "## The model that is shipped\n",
        _MODEL.format(kilobytes=model_bytes / 1000, figures=_figures(fitted), learn=len(learning)),
        "## The limits\n",
        _LIMITS,
        _limits_yaml(limits),
    ]
    return "\n".join(parts).rstrip() + "\n"


def _results(rig: str, by_judge: Mapping[str, Sequence[Judged]]) -> str:
    rows = []
    for name, judged in by_judge.items():
        s = score_of(judged)
        named = f"{share(s.named, s.shown)} ({ends(wilson(s.named, s.shown))})"
        rows.append(
            [
                name,
                share(s.kept, s.good),
                share(s.caught, s.shown),
                f"{s.balanced:.3f} ({ends(s.balanced_interval)})",
                named if "paper" not in name else "does not name",
                share(s.caught_of_all, s.deformed),
                str(s.unknown),
            ]
        )
    head = (
        "classifier",
        "good kept",
        "caught",
        "balanced (95 %)",
        "named right (95 %)",
        "caught of all",
        "unknown",
    )
    return f"## On {RIGS[rig]}\n\n{table(head, rows)}"


def _over_shown(by_judge: Mapping[str, Sequence[Judged]]) -> str:
    """Write the share caught of all deformed ones, by what a lit stripe shows of the defect."""
    rows = []
    for low, high in itertools.pairwise(_SHOWN_MM):
        cells, n = [], 0
        for judged in by_judge.values():
            mine = [
                one for one in judged if one.row.name != GOOD and low <= one.row.defect["shown_mm"] < high
            ]
            n = len(mine)
            cells.append(f"{100.0 * sum(one.caught for one in mine) / n:.0f} %" if n else "–")
        size = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
        rows.append([size, str(n), *cells])
    return table(["shown, mm", "deformed skeins", *by_judge], rows)


def _calibration(found: Found, path: Path) -> str:
    lines = {"as it should be": [(0.0, 0.0), (1.0, 1.0)]}
    rows = []
    for rig, by_judge in found.items():
        curve = reliability_of(graded_of(by_judge["`learned`"]), Terms())
        if curve is None or curve.n < _STATED_MIN:
            continue
        lines[RIGS[rig]] = [(one.stated, one.right) for one in curve.bins if one.n >= _BIN_MIN]
        rows.append(
            [
                RIGS[rig],
                str(curve.n),
                f"{curve.stated:.3f}",
                f"{curve.right:.3f}",
                f"{curve.excess.value:+.3f} ({ends(curve.excess.interval)})",
                f"{curve.brier:.4f}",
                f"{curve.calibration_error:.3f}",
            ]
        )
    curves(path, lines, "stated probability", "share right")
    head = (
        "rigs",
        "products",
        "stated",
        "right",
        "stated − right (95 %)",
        "Brier score",
        "calibration error",
    )
    return (
        "## Are the stated probabilities true?\n\n"
        "![Share right over stated probability](../images/grading-probabilities.svg)\n\n" + table(head, rows)
    )


def _figures(fitted: Fitted) -> str:
    return ", ".join(f"`{name}` {value:.3f}" for name, value in fitted.figures.items())


def _limits_yaml(limits: ShapeLimitsOptions) -> str:
    lines = ["```yaml", "stages:", "  classifier:", "    use: shape-limits", "    options:", "      limits:"]
    for limit in limits.limits:
        key, at = ("at_most", limit.at_most) if limit.at_most is not None else ("at_least", limit.at_least)
        lines.append(f"        - {{feature: {limit.feature}, {key}: {at:g}, label: {limit.label}}}")
    return "\n".join([*lines, "```"]) + "\n"


_HEAD = """\
# Grading: which defects are caught

Made by `python -m benchmarks grade --learn {learn} --test {test}`: simulated herring roe skeins whose
stripes are traced ray by ray, without a rendered image. Peaks have noise, faint ones are lost, neighbours
merge, and `window-tracking` finds their numbers; the true planes of light place them. The paper's rule gets
peaks at whole pixels, with the noise of rendered images. Every skein has a rig of its own.

Learned from seeds {first} to {last}, on rigs about the recipe's. Tested on seeds that nothing was fitted to
and nothing chosen on:

{seeds}

Looked at while this was made, and so in no test: seeds 20000 to 21699 of an earlier trial, 60000 to 60099,
and 80000 to 80199, by which the limit of *good* and of what is strange were chosen. The features that tell a
fold from a dent were chosen on folds of the learning skeins. The first 300 of the first test and all of the
others had been judged once before, with fewer features; nothing was chosen by that. The first test has kinds
as the population has them; learning and the others have 6 good ones in 16, and the defects by turns.

*Caught*: of the deformed ones **of which a lit stripe shows a millimetre or more**, those that were called
deformed. *Balanced*: mean of good kept and caught, its interval from those of both shares. *Named right*:
of the same skeins, the defect by its name: several dents are a dent, an S-bend is a bend. *Caught of all*:
of all deformed ones, those too whose defect lies between the stripes. *Unknown* is neither kept nor caught.
"""

_DENSE = """\
The limits do not hold on a rig of twice as many stripes with three times the noise: sections are closer, and
there are more of them. The model of the recipe's rigs says itself that it knows none of this. Fitted on such
rigs (seeds 73000 to 73249) the same method does what the last line says. A model belongs to a design of a
rig: after a change of stripes, lens or extractor fit again.

The coder decides here. On 18 of the 92 good skeins of seeds 73000 to 73249 there is a hollow over 0.5 mm or a
saddle over 1 mm, up to eleven: `window-tracking` has given a stripe a wrong number. With `planes`, tried by
hand, the same 18 have hollows of 0.5 and saddles of 1.9 mm at most. What is numbered wrongly looks deformed,
and no classifier can know better: on such a rig take the coder first, then fit.
"""

_SIZE = """\
All deformed ones of the test on rigs about the recipe's, by the most that a lit stripe lies deep in the
defect. What lies between two stripes is shown with nothing; no classifier can know of it. How many that are,
and how many stripes would show them, is on [The paper's experiment](paper-experiment.md).
"""

_MODEL = """\
`recipes/herring_roe/classifier.json` ({kilobytes:.0f} kB) is the model of this page, fitted on {learn}
**simulated** skeins on rigs about the recipe's. On its own folds: {figures}.
It has seen no real skein:
take it as a start, grade a few hundred of your own by hand, and fit again with `roemetry fit-classifier`.
To try it, in the recipe:

```yaml
stages:
  extractor: centre-of-gravity
  classifier:
    use: learned
    options: {{model: classifier.json}}
```
"""

_LIMITS = """\
Found on the learning skeins one after the other: just beyond all good ones, where most of one class is
caught; each of another class that is caught, too, counts against a limit, until none is worth it.
`fuzzy-rules` has the same limits as words with soft edges, a tenth to either side; the first word decides,
and *good* is where none holds.
"""
