"""The page of a comparison: one file that opens anywhere, its plots as inline SVG."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.page import environment_of
from roemetry.html.plots import plain, share, when
from roemetry.io.yaml_source import dump
from roemetry.records.arrays import Floats
from roemetry_tools.compare.agreement import Agreement, PairedValue, Reliability
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.score import QUANTITIES, Errors, Pairs, columns_of, relative_pct
from roemetry_tools.compare.tables import STEPS, flat
from roemetry_tools.compare.variants import Variant

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
        colour=colour,
        dots_max=DOTS_MAX,
        stages=dump({one.variant.name: _stages(one) for one in compared}),
    )


def _quantity(name: str, compared: Sequence[Compared], tolerance_pct: float | None) -> dict[str, Any]:
    """Gather the plots of one quantity; none where no variant has errors."""
    title, unit = _TITLES[name]
    variants = [
        Estimates(one.variant.number, one.variant.name, one.figures.pairs[name], errors)
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
        "strips": strips(variants, title.lower()) if variants else None,
        "scatters": [(v.name, scatter(v, min(values) - room, max(values) + room, unit)) for v in shown],
        "more": len(variants) - len(shown),
        "capped": any(len(v.pairs) > DOTS_MAX for v in variants),
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
    return stacked(bars, "% of the visible points on products") if bars else None


def _centres(rows: Rows, group: str) -> Markup | None:
    bars = []
    for one, row in rows:
        bias, spread, rms = (row[f"{group}_{name}_px"] for name in ("bias", "robust_std", "rms"))
        if bias is not None:
            words = f"bias {plain(bias, 3, True)}, RMS {plain(rms, 3)} px"
            bars.append((one.variant.number, one.variant.name, bias, spread, rms, words))
    return centres(bars) if bars else None


def _found(rows: Rows) -> Markup | None:
    bars = []
    for one, row in rows:
        missed, false = row["centre_missed_pct"], row["centre_false_pct"]
        if missed is not None:
            values = [("missed", missed, "unseen"), ("false", false or 0.0, "wrong")]
            bars.append((one.variant.name, values, f"missed {share(missed)} %, false {share(false)} %"))
    return stacked(bars, "% of the true centres; % of the peaks", beside=True) if bars else None


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
    return stacked(bars, "ms for an acquisition, medians of the steps") if bars else None


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
            truth.append((one, over_truth(list(values.values())), found))
        if (found := one.standing.recipe.get(name)) is not None:
            pairs = [(value, base[key]) for key, value in values.items() if key in base]
            recipe.append((one, over_mean(pairs), found))
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
        {"name": one.variant.name, "curve": curve, "drawing": reliability(one.variant, curve)}
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
    drawn: Sequence[tuple[Compared, Sequence[Point], Agreement]],
    size_words: str,
    tolerance_pct: float | None,
) -> list[tuple[str, Any]]:
    """Draw the first few; where nothing differs there is nothing to draw."""
    differing = [one for one in drawn if any(point[1] for point in one[1])][:PLOTS_MAX]
    return [
        (one.variant.name, bland_altman(one.variant, points, found, size_words, tolerance_pct))
        for one, points, found in differing
    ]


T = TypeVar("T")

DOTS_MAX = 300
"""So many dots are drawn of a variant; of more, these are taken evenly by rank."""

_COLOURS = ("#0d689c", "#a65a00", "#187059", "#b71d7c", "#5a4fcf", "#726317", "#7a3b1d", "#44525f")
_LEFT, _RIGHT = 12.0, 428.0
_ROW = 50.0
"""Ends of a row of a plot, and its height: name and words above, dots or bars below."""


def colour(number: int) -> str:
    """Colour of a variant; names tell them apart too."""
    return _COLOURS[number % len(_COLOURS)]


@dataclass(frozen=True, eq=False, slots=True)
class Estimates:
    """One variant's estimates of one quantity."""

    number: int
    name: str
    pairs: Pairs
    errors: Errors


def strips(variants: Sequence[Estimates], what: str) -> Markup:
    """Draw the relative errors: a dot for each product, the middle half as a box, the mean as a diamond."""
    drawn = [_evenly(v.pairs) for v in variants]
    relative = [relative_pct(*columns_of(pairs)) for pairs in drawn]
    axis = svg.Axis.over(*_range(relative), _LEFT, _RIGHT)
    floor = 8.0 + _ROW * len(variants)
    parts = axis.upright(8.0, floor, "error, % of the true value")
    for place, (variant, pairs, errors) in enumerate(zip(variants, drawn, relative, strict=True)):
        top = 8.0 + _ROW * place
        parts += _strip(variant, pairs, errors, axis, top)
    label = f"Relative errors of {what}: " + "; ".join(
        f"{v.name}: mean {svg.plain(v.errors.bias_pct, 1, True)} %, middle half from "
        f"{svg.plain(v.errors.low_pct, 1, True)} to {svg.plain(v.errors.high_pct, 1, True)} %"
        for v in variants
    )
    return svg.picture(parts, floor + 36.0, label)


def scatter(variant: Estimates, low: float, high: float, unit: str) -> Markup:
    """Draw estimates over true values; on the line both are equal."""
    size, left, right, floor = 260.0, 60.0, 232.0, 188.0  # beside the axes: room for a tick's whole number
    across = svg.Axis.over(low, high, left, right)
    up = svg.Axis.over(low, high, floor, 8.0)
    parts = [*across.upright(8.0, floor, f"true, {unit}", 3, size), *up.level(left, right, 4)]
    parts.append(svg.line(across(low), up(low), across(high), up(high), "equal"))
    for pair in _evenly(variant.pairs):
        title = f"{pair.product}: {svg.plain(pair.estimate, 1)} for {svg.plain(pair.true, 1)} {unit}"
        parts.append(svg.dot(across(pair.true), up(pair.estimate), "point", title, colour(variant.number)))
    parts.append(svg.text(left + 4.0, 19.0, f"estimated, {unit}", "start"))
    label = f"{variant.name}: {variant.errors.n} estimates over true values, {unit}"
    return svg.picture(parts, floor + 38.0, label, width=size)


def stacked(
    rows: Sequence[tuple[str, Sequence[tuple[str, float, str]], str]],
    axis_words: str,
    *,
    beside: bool = False,
) -> Markup:
    """Draw a bar for each row, stacked of (name, value, CSS class); the row's words stand above it.

    With `beside`, each value has a bar of its own, one below the other.
    """
    longest = max((max if beside else sum)(value for _, value, _ in values) for _, values, _ in rows)
    axis = svg.Axis.over(0.0, 1.05 * longest or 1.0, _LEFT, _RIGHT)
    floor = 8.0 + 44.0 * len(rows)
    parts = axis.upright(8.0, floor, axis_words)
    said = []
    for place, (name, values, words) in enumerate(rows):
        top, x = 8.0 + 44.0 * place, axis(0.0)
        parts += _headed(name, words, top)
        height = 15.0 / len(values) if beside else 15.0
        for order, (part, value, kind) in enumerate(values):
            width = axis(value) - axis(0.0)
            y = top + 19.0 + (height * order if beside else 0.0)
            if width > 0:
                parts.append(svg.box(x, y, width, height, f"part {kind}", f"{part}: {svg.plain(value, 2)}"))
            x += 0.0 if beside else width
        said.append(f"{name}: " + ", ".join(f"{p} {svg.plain(v, 2)}" for p, v, _ in values))
    return svg.picture(parts, floor + 36.0, f"{axis_words}: " + "; ".join(said))


def centres(rows: Sequence[tuple[int, str, float, float, float, str]]) -> Markup:
    """Draw, for each (number, name, bias, robust spread, RMS, words), the error of stripe centres, px."""
    far = max(max(abs(bias) + spread, rms) for _, _, bias, spread, rms, _ in rows) or 0.01
    axis = svg.Axis.over(-1.08 * far, 1.08 * far, _LEFT, _RIGHT)
    floor = 8.0 + 44.0 * len(rows)
    parts = axis.upright(8.0, floor, "found − true along the row, px")
    said = []
    for place, (number, name, bias, spread, rms, words) in enumerate(rows):
        top = 8.0 + 44.0 * place
        middle = top + 27.0
        parts += [
            *_headed(name, words, top),
            svg.line(axis(-rms), middle, axis(rms), middle, "whisker"),
            svg.box(
                axis(bias - spread),
                middle - 5.5,
                axis(bias + spread) - axis(bias - spread),
                11.0,
                "middle",
                f"bias {svg.plain(bias, 3, True)} ± {svg.plain(spread, 3)} px",
                colour(number),
            ),
            svg.diamond(axis(bias), middle, 5.0, "mean", f"bias {svg.plain(bias, 3, True)} px"),
        ]
        said.append(f"{name}: bias {svg.plain(bias, 3, True)} px, RMS {svg.plain(rms, 3)} px")
    return svg.picture(parts, floor + 36.0, "Error of stripe centres: " + "; ".join(said))


def _strip(variant: Estimates, pairs: Pairs, errors: Floats, axis: svg.Axis, top: float) -> list[Markup]:
    sums, paint, middle = variant.errors, colour(variant.number), top + 32.0
    words = f"bias {svg.plain(sums.bias_pct, 1, True)} %, n = {sums.n}"
    parts = [
        *_headed(variant.name, words, top),
        svg.line(axis(sums.min_pct), middle, axis(sums.max_pct), middle, "whisker"),
        svg.box(
            axis(sums.low_pct),
            middle - 11.0,
            axis(sums.high_pct) - axis(sums.low_pct),
            22.0,
            "middle",
            f"middle half: {svg.plain(sums.low_pct, 2, True)} to {svg.plain(sums.high_pct, 2, True)} %",
            paint,
        ),
        svg.line(axis(sums.median_pct), middle - 11.0, axis(sums.median_pct), middle + 11.0, "median"),
    ]
    for rank, (pair, error) in enumerate(zip(pairs, errors.tolist(), strict=True)):
        aside = 7.0 * ((rank * 0.618034) % 1.0 - 0.5) * 2.0  # spread evenly, and the same each time
        title = f"{pair.product}: {svg.plain(error, 2, True)} %"
        if axis.low <= error <= axis.high:
            parts.append(svg.dot(axis(error), middle + aside, "point", title, paint))
        else:
            way = 1.0 if error > axis.high else -1.0
            x, y = axis(error), middle + aside
            parts.append(
                svg.shape([(x, y), (x - 7 * way, y - 3.5), (x - 7 * way, y + 3.5)], "point", paint, title)
            )
    words = f"mean {svg.plain(sums.bias_pct, 2, True)} %"
    parts.append(svg.diamond(axis(sums.bias_pct), middle, 6.0, "mean", words))
    return parts


def _headed(name: str, words: str, top: float) -> list[Markup]:
    """Write a row's name at the left, cut off if it would meet the words at the right."""
    room = int((_RIGHT - _LEFT - 6.4 * len(words)) / 7.6)
    shown = name if len(name) <= room else name[: max(room - 1, 8)] + "…"
    return [svg.text(_LEFT, top + 13.0, shown, "start name"), svg.text(_RIGHT, top + 13.0, words, "end")]


def _range(relative: Sequence[Floats]) -> tuple[float, float]:
    """Hold all errors and 0; but one variant's far ones do not press the others together."""
    reach = sorted(float(np.abs(errors).max()) for errors in relative)
    usual = 4.0 * reach[(len(reach) - 1) // 2] or math.inf
    low = max(min(0.0, *(float(errors.min()) for errors in relative)), -usual)
    high = min(max(0.0, *(float(errors.max()) for errors in relative)), usual)
    room = 0.04 * (high - low)
    return low - room, high + room


def _evenly(pairs: Pairs) -> Pairs:
    return _some(pairs, lambda pair: pair.estimate / pair.true)


def _some(given: Sequence[T], rank: Callable[[T], float]) -> list[T]:
    """Take at most `DOTS_MAX`, evenly by rank, so that the far ones stay."""
    if len(given) <= DOTS_MAX:
        return list(given)
    ranked = sorted(given, key=rank)
    return [ranked[place] for place in np.linspace(0, len(ranked) - 1, DOTS_MAX).round().astype(int).tolist()]


_WIDTH, _FLOOR, _AXIS = 320.0, 196.0, 46.0
"""Of the smaller plots of agreement and probabilities: width, level of the lower axis, place of the left
one."""
_BESIDE, _BAR = (14.0, 8.5, 3.0), 3.5
"""Where, right of the plot, the bars of intervals stand, and how wide; side by side, since they overlap."""

_WRITING = 11.0
_LETTER = 7.8
"""Height of a line of writing, and width of a letter at most, in units of the plot."""

Point = tuple[float, float, str]
"""Size, difference in %, and of which product."""


def over_truth(values: Sequence[PairedValue]) -> list[Point]:
    """Give a point for each product: its true size, and the relative error."""
    return [(v.true, 100.0 * (v.estimate / v.true - 1.0), v.product) for v in values if v.true > 0]


def over_mean(pairs: Sequence[tuple[PairedValue, PairedValue]]) -> list[Point]:
    """Give a point for each product: the mean of both estimates, and their difference as a share of it."""
    points = []
    for one, other in pairs:
        mean = 0.5 * (one.estimate + other.estimate)
        if mean > 0:
            points.append((mean, 100.0 * (one.estimate - other.estimate) / mean, one.product))
    return points


def bland_altman(
    variant: Variant,
    points: Sequence[Point],
    agreement: Agreement,
    size_words: str,
    tolerance_pct: float | None,
) -> Markup:
    """Draw differences over size, their mean, limits of agreement, and the tolerance; intervals beside."""
    ends = [*agreement.low_limit_interval_pct, *agreement.high_limit_interval_pct, *agreement.limits_pct, 0.0]
    ends += [p[1] for p in points] + ([] if tolerance_pct is None else [-tolerance_pct, tolerance_pct])
    known = [value for value in ends if np.isfinite(value)]
    room = 0.06 * (max(known) - min(known)) or 1.0
    up = svg.Axis.over(min(known) - room, max(known) + room, _FLOOR, 8.0)
    # small differences have long values beside the axis
    left = max(_AXIS, _LETTER * max(len(written) for _, written in up.ticks()) + 8.0)
    across = svg.Axis.over(min(p[0] for p in points), max(p[0] for p in points), left + 8.0, _WIDTH - 70.0)
    right = _WIDTH - 64.0
    # as fine as the axis, as far as there is room
    digits = 2 if max(len(written.partition(".")[2]) for _, written in up.ticks()) > 1 else 1
    parts = []
    if tolerance_pct is not None:
        band = up(-tolerance_pct) - up(tolerance_pct)
        parts.append(svg.box(left, up(tolerance_pct), right - left, band, "tolerance", "the tolerance"))
    parts += up.level(left, right)
    parts += [svg.text(across(value), _FLOOR + 15.0, written) for value, written in across.ticks(3)]
    paint = colour(variant.number)
    low, high = agreement.limits_pct
    drawn = [
        (value, interval, kind)
        for value, interval, kind in (
            (high, agreement.high_limit_interval_pct, "equal"),
            (agreement.mean_pct, agreement.mean_interval_pct, "median"),
            (low, agreement.low_limit_interval_pct, "equal"),
        )
        if np.isfinite(value)
    ]
    written_at = _apart([up(value) + 4.0 for value, _, _ in drawn])
    for (value, interval, kind), at, beside in zip(drawn, written_at, _BESIDE, strict=False):
        parts.append(svg.line(left, up(value), right, up(value), kind))
        if np.isfinite(interval.low):
            words = f"{svg.plain(interval.low, 2, True)} to {svg.plain(interval.high, 2, True)} %"
            tall = up(interval.low) - up(interval.high)
            parts.append(svg.box(right + beside, up(interval.high), _BAR, tall, "interval", words, paint))
        parts.append(svg.text(right + 21.0, at, svg.plain(value, digits, True), "start"))
    for size, difference, product in _some(points, lambda point: point[1]):
        title = f"{product}: {svg.plain(difference, 2, True)} %"
        parts.append(svg.dot(across(size), up(difference), "point", title, paint))
    parts += [
        svg.text((left + right) / 2, _FLOOR + 31.0, size_words),
        svg.text(left, _FLOOR + 31.0, "%", "end"),
    ]
    label = (
        f"{variant.name}: mean difference {svg.plain(agreement.mean_pct, 2, True)} %, limits of agreement "
        f"{svg.plain(low, 2, True)} to {svg.plain(high, 2, True)} %, {agreement.n} products"
    )
    return svg.picture(parts, _FLOOR + 38.0, label, width=_WIDTH)


def _apart(places: Sequence[float]) -> list[float]:
    """Move writing that stands in falling order of value, so that no line covers the one above."""
    moved: list[float] = []
    for place in places:
        moved.append(max(place, moved[-1] + _WRITING) if moved else place)
    return moved


def reliability(variant: Variant, found: Reliability) -> Markup:
    """Draw the share that was right over the stated probability; on the line they are equal."""
    across, up = svg.Axis(0.0, 1.0, _AXIS, _WIDTH - 60.0), svg.Axis(0.0, 1.0, _FLOOR, 8.0)
    parts = [*across.upright(8.0, _FLOOR, "stated probability", 4, _WIDTH), *up.level(_AXIS, across.end, 4)]
    parts.append(svg.line(across(0.0), up(0.0), across(1.0), up(1.0), "equal"))
    most = max(one.n for one in found.bins)
    for one in found.bins:
        x, low, high = across(one.stated), up(one.right_interval.low), up(one.right_interval.high)
        title = (
            f"{one.n} products stated {svg.plain(one.stated, 3)}, right {svg.plain(one.right, 3)} "
            f"({svg.plain(one.right_interval.low, 3)} to {svg.plain(one.right_interval.high, 3)})"
        )
        radius = 2.5 + 4.5 * (one.n / most) ** 0.5
        parts += [
            svg.line(x, low, x, high, "whisker"),
            svg.dot(x, up(one.right), "point", title, colour(variant.number), radius),
        ]
    parts.append(svg.text(_AXIS + 5.0, 20.0, "share right", "start"))
    bins = "; ".join(f"stated {svg.plain(b.stated, 2)}, right {svg.plain(b.right, 2)}" for b in found.bins)
    return svg.picture(parts, _FLOOR + 38.0, f"{variant.name}: {bins}", width=_WIDTH)
