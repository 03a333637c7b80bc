"""The page of a comparison: one file that opens anywhere, for a reader who was not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from markupsafe import Markup

from roemetry.html.page import environment_of
from roemetry.html.plots import plain, share
from roemetry.io.yaml_source import dump
from roemetry_tools.compare import plots
from roemetry_tools.compare.aggregate import QUANTITIES
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.tables import STEPS, flat

PLOTS_MAX = 12
"""So many variants have plots of their own: more than a screen of them nobody compares."""

_TITLES = {
    "visible_mm3": ("Visible volume", "mm³"),
    "true_mm3": ("True volume", "mm³"),
    "mass_g": ("Weight", "g"),
}
_CODED = (("right", "right"), ("wrong", "wrong"), ("refused", "refused"), ("unseen", "unseen"))


def page(compared: Sequence[Compared], told: Mapping[str, Any]) -> str:
    """Write the whole page as one text; `told` is what ``comparison.json`` holds."""
    rows = [flat(one) for one in compared]
    environment = environment_of("roemetry_tools.compare")
    return environment.get_template("comparison.html.j2").render(
        told=told,
        variants=list(zip(compared, rows, strict=True)),
        began=_when(told["began"]),
        quantities=[_quantity(name, compared, told["terms"]["tolerance_pct"]) for name in QUANTITIES],
        classes=[(one, one.figures.classes) for one in compared if one.figures and one.figures.classes],
        probabilities=probabilities(compared),
        choices=choices(compared, told["choices"]),
        coding=_coding(compared, rows),
        centres=_centres(compared, rows, "centre"),
        centres_on_product=_centres(compared, rows, "centre_on_product"),
        found=_found(compared, rows),
        times=_times(compared, rows),
        steps=[step for step in STEPS if any(row[f"time_{step}_median_ms"] is not None for row in rows)],
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
        "truth": agreement_with_truth(name, unit, compared, tolerance_pct),
        "recipe": agreement_with_recipe(name, unit, compared, tolerance_pct),
    }


def _coding(compared: Sequence[Compared], rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    """Draw what was wrong or left; the rest to 100 % is right, and would hide it."""
    bars = []
    for one, row in zip(compared, rows, strict=True):
        if row["coding_points"] is None:
            continue
        values = [(part, row[f"coding_{part}_pct"], kind) for part, kind in _CODED if part != "right"]
        bars.append((one.variant.name, values, f"right {share(row['coding_right_pct'])} %"))
    top = max((sum(value for _, value, _ in values) for _, values, _ in bars), default=0.0)
    return plots.stacked(bars, 1.05 * top or 1.0, "% of the visible points on products") if bars else None


def _centres(compared: Sequence[Compared], rows: Sequence[Mapping[str, Any]], group: str) -> Markup | None:
    bars = [
        (
            one.variant.number,
            one.variant.name,
            row[f"{group}_bias_px"],
            row[f"{group}_robust_std_px"],
            row[f"{group}_rms_px"],
            f"bias {plain(row[f'{group}_bias_px'], 3, True)}, RMS {plain(row[f'{group}_rms_px'], 3)} px",
        )
        for one, row in zip(compared, rows, strict=True)
        if row[f"{group}_bias_px"] is not None
    ]
    return plots.centres(bars) if bars else None


def _found(compared: Sequence[Compared], rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    bars = []
    for one, row in zip(compared, rows, strict=True):
        missed, false = row["centre_missed_pct"], row["centre_false_pct"]
        if missed is not None:
            values = [("missed", missed, "unseen"), ("false", false or 0.0, "wrong")]
            words = f"missed {share(missed)} %, false {share(false)} %"
            bars.append((one.variant.name, values, words))
    top = max((value for _, values, _ in bars for _, value, _ in values), default=0.0)
    if not bars:
        return None
    return plots.stacked(bars, 1.05 * top or 1.0, "% of the true centres; % of the peaks", beside=True)


def _times(compared: Sequence[Compared], rows: Sequence[Mapping[str, Any]]) -> Markup | None:
    bars = []
    for one, row in zip(compared, rows, strict=True):
        if row["time_frame_median_ms"] is None:
            continue
        values = [(s, value, f"step-{s}") for s in STEPS if (value := row[f"time_{s}_median_ms"]) is not None]
        low, high = row["time_frame_low_quartile_ms"], row["time_frame_high_quartile_ms"]
        words = f"{plain(row['time_frame_median_ms'], 2)} ms ({plain(low, 2)} to {plain(high, 2)})"
        bars.append((one.variant.name, values, words))
    top = max((sum(value for _, value, _ in values) for _, values, _ in bars), default=0.0)
    return plots.stacked(bars, 1.05 * top, "ms for an acquisition, medians of the steps") if top else None


def _absent(compared: Sequence[Compared]) -> list[tuple[str, str]]:
    """Say what is missing, and why, once for all variants that say the same."""
    words = {name: title for name, (title, _) in _TITLES.items()} | {
        "label": "Classes",
        "centres": "Stripe centres",
        "coding": "Coding of stripes",
    }
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


def _when(iso: str) -> str:
    moment = datetime.fromisoformat(iso)
    return f"{moment.day} {moment:%B %Y, %H:%M} {moment.tzname()}"


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


def agreement_with_truth(
    name: str, unit: str, compared: Sequence[Compared], tolerance_pct: float | None
) -> dict[str, Any]:
    """Gather table and plots of a quantity beside what is true."""
    lines, drawn = [], []
    for one in compared:
        found = one.standing.truth.get(name)
        if found is None or one.figures is None:
            continue
        lines.append((one, found))
        points = plots.over_truth(list(one.figures.values[name].values()))
        drawn.append((one.variant, points, found))
    return {"lines": lines, "plots": _drawn(drawn, f"true, {unit}", tolerance_pct)}


def agreement_with_recipe(
    name: str, unit: str, compared: Sequence[Compared], tolerance_pct: float | None
) -> dict[str, Any]:
    """Gather the same for every other variant beside the recipe as it is."""
    base = compared[0].figures
    lines, drawn = [], []
    for one in compared[1:]:
        found = one.standing.recipe.get(name)
        if found is None or one.figures is None or base is None:
            continue
        lines.append((one, found, one.standing.nearer.get(name)))
        mine, others = one.figures.values[name], base.values[name]
        pairs = [(value, others[key]) for key, value in mine.items() if key in others]
        drawn.append((one.variant, plots.over_mean(pairs), found))
    return {"lines": lines, "plots": _drawn(drawn, f"mean of both, {unit}", tolerance_pct)}


def probabilities(compared: Sequence[Compared]) -> list[dict[str, Any]]:
    """Gather the calibration curve of each variant that states probabilities."""
    found = []
    for one in compared:
        curve = one.standing.reliability
        if curve is not None:
            drawing = plots.reliability(one.variant.number, one.variant.name, curve)
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


def _drawn(drawn: Sequence[Any], size_words: str, tolerance_pct: float | None) -> list[tuple[str, Any]]:
    """Draw the first few; where nothing differs there is nothing to draw."""
    differing = [one for one in drawn if any(point[1] for point in one[1])][:PLOTS_MAX]
    return [
        (one.name, plots.bland_altman(one.number, one.name, points, found, size_words, tolerance_pct))
        for one, points, found in differing
    ]
