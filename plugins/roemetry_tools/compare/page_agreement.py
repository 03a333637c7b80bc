"""What the page says of agreement: plots and lines for the template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from roemetry_tools.compare import agreement_plots
from roemetry_tools.compare.ranking import Compared

PLOTS_MAX = 12
"""So many variants have plots of their own."""

_FIGURES = {
    "visible_mm3": ("mean absolute error of the visible volume, %", 2),
    "true_mm3": ("mean absolute error of the true volume, %", 2),
    "mass_g": ("mean absolute error of the weight, %", 2),
    "label": ("balanced accuracy of the classes", 3),
}


def agreement_with_truth(
    name: str, unit: str, compared: Sequence[Compared], tolerance_pct: float | None
) -> dict[str, Any]:
    """Gather table and plots of a quantity beside what is true."""
    lines, plots = [], []
    for one in compared:
        found = one.standing.truth.get(name)
        if found is None or one.figures is None:
            continue
        lines.append((one, found))
        points = agreement_plots.over_truth(list(one.figures.values[name].values()))
        plots.append((one, points, found))
    return {"lines": lines, "plots": _drawn(plots, f"true, {unit}", tolerance_pct)}


def agreement_with_recipe(
    name: str, unit: str, compared: Sequence[Compared], tolerance_pct: float | None
) -> dict[str, Any]:
    """Gather the same for every other variant beside the recipe as it is."""
    base = compared[0].figures
    lines, plots = [], []
    for one in compared[1:]:
        found = one.standing.recipe.get(name)
        if found is None or one.figures is None or base is None:
            continue
        lines.append((one, found, one.standing.nearer.get(name)))
        mine, others = one.figures.values[name], base.values[name]
        pairs = [(value, others[key]) for key, value in mine.items() if key in others]
        plots.append((one, agreement_plots.over_mean(pairs), found))
    return {"lines": lines, "plots": _drawn(plots, f"mean of both, {unit}", tolerance_pct)}


def probabilities(compared: Sequence[Compared]) -> list[dict[str, Any]]:
    """Gather the calibration curve of each variant that states probabilities."""
    found = []
    for one in compared:
        curve = one.standing.reliability
        if curve is not None:
            drawing = agreement_plots.reliability(one.variant.number, one.variant.name, curve)
            found.append({"name": one.variant.name, "curve": curve, "drawing": drawing})
    return found


def choices(compared: Sequence[Compared], told: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Put the choices among variants into words."""
    names = {one.variant.number: one.variant.name for one in compared}
    lines = []
    for choice in told:
        words, digits = _FIGURES[choice["figure"]]
        chosen = list(choice["chosen"])
        counted = sorted({number: chosen.count(number) for number in chosen}.items(), key=lambda x: -x[1])
        lines.append(
            {
                "words": words,
                "digits": digits,
                "best": names[choice["best"]],
                "seen": choice["seen"],
                "held_out": choice["held_out"],
                "n": choice["n"],
                "chosen": [(names[number], count) for number, count in counted],
                "folds": len(chosen),
            }
        )
    return lines


def _drawn(plots: Sequence[Any], size_words: str, tolerance_pct: float | None) -> list[tuple[str, Any]]:
    """Draw the first few; where nothing differs there is nothing to draw."""
    return [
        (
            one.variant.name,
            agreement_plots.bland_altman(
                one.variant.number, one.variant.name, points, found, size_words, tolerance_pct
            ),
        )
        for one, points, found in [plot for plot in plots if any(point[1] for point in plot[1])][:PLOTS_MAX]
    ]
