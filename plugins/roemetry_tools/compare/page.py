"""The page of a comparison: one file that opens anywhere, for a reader who was not there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from roemetry.html.page import environment_of
from roemetry.html.plots import plain, share, when
from roemetry.io.yaml_source import dump
from roemetry_tools.compare import plots
from roemetry_tools.compare.aggregate import QUANTITIES
from roemetry_tools.compare.agreement import Agreement
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.tables import STEPS, flat

PLOTS_MAX = 12
"""So many variants have plots of their own: more than a screen of them nobody compares."""

_TITLES = {
    "visible_mm3": ("Visible volume", "mm³"),
    "true_mm3": ("True volume", "mm³"),
    "mass_g": ("Weight", "g"),
}


def page(compared: Sequence[Compared], told: Mapping[str, Any]) -> str:
    """Write the whole page as one text; `told` is what ``comparison.json`` holds."""
    rows = [(one, flat(one)) for one in compared]
    environment = environment_of("roemetry_tools.compare")
    return environment.get_template("comparison.html.j2").render(
        told=told,
        variants=rows,
        began=when(told["began"]),
        quantities=[_quantity(name, compared, told["terms"]["tolerance_pct"]) for name in QUANTITIES],
        classes=[(one, one.figures.classes) for one in compared if one.figures and one.figures.classes],
        probabilities=_probabilities(compared),
        choices=_choices(compared, told["choices"]),
        coding=_coding(rows),
        centres=_centres(rows, "centre"),
        centres_on_product=_centres(rows, "centre_on_product"),
        found=_found(rows),
        times=_times(rows),
        steps=[step for step in STEPS if any(row[f"time_{step}_median_ms"] is not None for _, row in rows)],
        absent=_absent(compared),
        reasons=_reasons(compared),
        colour=plots.colour,
        dots_max=plots.DOTS_MAX,
        stages=dump({one.variant.name: _stages(one) for one in compared}),
    )


def _quantity(name: str, compared: Sequence[Compared], tolerance_pct: float | None) -> dict[str, Any]:
    """Gather the plots of one quantity; none where no variant has errors."""
    title, unit = _TITLES[name]
    variants = [
        plots.Estimates(one.variant.number, one.variant.name, one.figures.pairs[name], errors)
        for one in compared
        if one.figures is not None and (errors := one.figures.errors[name]) is not None
    ]
    values = [value for v in variants for pair in v.pairs for value in (pair.estimate, pair.true)]
    room = 0.05 * (max(values) - min(values)) if values else 0.0
    shown = variants[:PLOTS_MAX]
    by_visible = [
        (one.variant.name, one.figures.true_from_visible)
        for one in compared
        if name == "true_mm3" and one.figures is not None and one.figures.true_from_visible
    ]
    return {
        "key": name.replace("_", "-"),
        "title": title,
        "unit": unit,
        "variants": variants,
        "strips": plots.strips(variants, title.lower()) if variants else None,
        "scatters": [(v.name, plots.scatter(v, min(values) - room, max(values) + room, unit)) for v in shown],
        "more": len(variants) - len(shown),
        "capped": any(len(v.pairs) > plots.DOTS_MAX for v in variants),
        "by_visible": by_visible,
        **_agreements(name, unit, compared, tolerance_pct),
    }


Rows = Sequence[tuple[Compared, Mapping[str, Any]]]


def _coding(rows: Rows) -> Markup | None:
    """Draw what was wrong or left; the rest to 100 % is right, and would hide it."""
    bars = [
        (
            one.variant.name,
            [(part, row[f"coding_{part}_pct"], part) for part in ("wrong", "refused", "unseen")],
            f"right {share(row['coding_right_pct'])} %",
        )
        for one, row in rows
        if row["coding_points"] is not None
    ]
    return plots.stacked(bars, "% of the visible points on products") if bars else None


def _centres(rows: Rows, group: str) -> Markup | None:
    bars = []
    for one, row in rows:
        bias, spread, rms = (row[f"{group}_{name}_px"] for name in ("bias", "robust_std", "rms"))
        if bias is not None:
            words = f"bias {plain(bias, 3, True)}, RMS {plain(rms, 3)} px"
            bars.append((one.variant.number, one.variant.name, bias, spread, rms, words))
    return plots.centres(bars) if bars else None


def _found(rows: Rows) -> Markup | None:
    bars = []
    for one, row in rows:
        missed, false = row["centre_missed_pct"], row["centre_false_pct"]
        if missed is not None:
            values = [("missed", missed, "unseen"), ("false", false or 0.0, "wrong")]
            bars.append((one.variant.name, values, f"missed {share(missed)} %, false {share(false)} %"))
    return plots.stacked(bars, "% of the true centres; % of the peaks", beside=True) if bars else None


def _times(rows: Rows) -> Markup | None:
    bars = []
    for one, row in rows:
        every, low, high = (
            row[f"time_frame_{end}_ms"] for end in ("median", "low_quartile", "high_quartile")
        )
        values = [(s, value, f"step-{s}") for s in STEPS if (value := row[f"time_{s}_median_ms"]) is not None]
        if every is not None:
            words = f"{plain(every, 2)} ms ({plain(low, 2)} to {plain(high, 2)})"
            bars.append((one.variant.name, values, words))
    return plots.stacked(bars, "ms for an acquisition, medians of the steps") if bars else None


def _absent(compared: Sequence[Compared]) -> list[tuple[str, str]]:
    """Say what is missing, and why, once for all variants that say the same."""
    words = {"label": "Classes", "centres": "Stripe centres", "coding": "Coding of stripes"}
    words |= {name: title for name, (title, _) in _TITLES.items()}
    said: dict[tuple[str, str], list[str]] = {}
    whole = [one for one in compared if one.figures is not None and not one.failure]
    for one in whole:
        assert one.figures is not None
        for name, why in one.figures.absent.items():
            said.setdefault((words[name], why), []).append(one.variant.name)
    return [
        (what if len(names) == len(whole) else f"{what} ({'; '.join(names)})", why)
        for (what, why), names in said.items()
    ]


def _reasons(compared: Sequence[Compared]) -> list[tuple[str, str, str, list[tuple[str, int]]]]:
    """Gather kind, code, text of every reason, with the variants it was given for and how often."""
    found: dict[tuple[str, str], tuple[str, list[tuple[str, int]]]] = {}
    for one in compared:
        name, figures = one.variant.name, one.figures
        if figures is None:
            found.setdefault(("not made", one.variant.fault), (one.variant.fault, []))[1].append((name, 0))
            continue
        for kind, causes in (("refused", figures.causes), ("said", figures.warnings)):
            for cause in causes:
                found.setdefault((kind, cause.code), (cause.text, []))[1].append((name, cause.count))
    order = ("not made", "refused", "said")
    rows = [(k, "" if k == order[0] else code, text, of) for (k, code), (text, of) in found.items()]
    return sorted(rows, key=lambda row: order.index(row[0]))


def _stages(one: Compared) -> Any:
    recipe = one.variant.recipe
    if recipe is None:
        return one.variant.fault
    return {kind: chosen.described() for kind, chosen in recipe.stages.items()}


_FIGURES = {
    "visible_mm3": ("mean absolute error of the visible volume, %", 2),
    "true_mm3": ("mean absolute error of the true volume, %", 2),
    "mass_g": ("mean absolute error of the weight, %", 2),
    "label": ("balanced accuracy of the classes", 3),
}


def _agreements(
    name: str, unit: str, compared: Sequence[Compared], tolerance_pct: float | None
) -> dict[str, dict[str, Any]]:
    """Gather tables and plots of a quantity beside what is true, and beside the recipe as it is."""
    truth, recipe = [], []
    base = {} if compared[0].figures is None else compared[0].figures.values[name]
    for one in compared:
        values = {} if one.figures is None else one.figures.values[name]
        if (found := one.standing.truth.get(name)) is not None:
            truth.append((one, plots.over_truth(list(values.values())), found))
        if (found := one.standing.recipe.get(name)) is not None:
            pairs = [(value, base[key]) for key, value in values.items() if key in base]
            recipe.append((one, plots.over_mean(pairs), found))
    return {
        "truth": {
            "lines": [(one, found) for one, _, found in truth],
            "plots": _drawn(truth, f"true, {unit}", tolerance_pct),
        },
        "recipe": {
            "lines": [(one, found, one.standing.nearer.get(name)) for one, _, found in recipe],
            "plots": _drawn(recipe, f"mean of both, {unit}", tolerance_pct),
        },
    }


def _probabilities(compared: Sequence[Compared]) -> list[dict[str, Any]]:
    """Gather the calibration curve of each variant that states probabilities."""
    return [
        {"name": one.variant.name, "curve": curve, "drawing": plots.reliability(one.variant, curve)}
        for one in compared
        if (curve := one.standing.reliability) is not None
    ]


def _choices(compared: Sequence[Compared], told: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Put the choices among variants into words."""
    names = {one.variant.number: one.variant.name for one in compared}
    lines = []
    for choice in told:
        words, digits = _FIGURES[choice["figure"]]
        counted = Counter(choice["chosen"]).most_common()
        chosen = [(names[number], count) for number, count in counted]
        own = {"words": words, "digits": digits, "folds": len(choice["chosen"])}
        lines.append({**choice, **own, "best": names[choice["best"]], "chosen": chosen})
    return lines


def _drawn(
    drawn: Sequence[tuple[Compared, Sequence[plots.Point], Agreement]],
    size_words: str,
    tolerance_pct: float | None,
) -> list[tuple[str, Any]]:
    """Draw the first few; where nothing differs there is nothing to draw."""
    differing = [one for one in drawn if any(point[1] for point in one[1])][:PLOTS_MAX]
    return [
        (one.variant.name, plots.bland_altman(one.variant, points, found, size_words, tolerance_pct))
        for one, points, found in differing
    ]
