"""Figures of the variants as flat rows: one set of names for CSV, terminal and page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from typing import Any

from roemetry_tools.compare.aggregate import Figures
from roemetry_tools.compare.agreement import Shift
from roemetry_tools.compare.bootstrap import Interval
from roemetry_tools.compare.centres import CentreScore
from roemetry_tools.compare.coding import CodingScore
from roemetry_tools.compare.grading import Reliability
from roemetry_tools.compare.ranking import Compared, Standing
from roemetry_tools.compare.statistics import Errors

Value = float | int | str | None

GROUPS = (
    ("volume_visible", "visible_mm3", "mm3"),
    ("volume_true", "true_mm3", "mm3"),
    ("weight", "mass_g", "g"),
)
"""Name in the table, name of the quantity, unit."""

STEPS = (
    "source",
    "extractor",
    "coder",
    "smoother",
    "outliner",
    "triangulator",
    "volume",
    "weigher",
    "classifier",
    "grader",
)


def to_csv(compared: Sequence[Compared]) -> str:
    """Write a line for each variant; columns that no variant has anything in are left out."""
    rows = [flat(one) for one in compared]
    filled = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    axes = list(dict.fromkeys(key for one in compared for key in one.variant.settings))
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["variant", "name", *(f"set {key}" for key in axes), "status", "reason", *filled])
    for one, row in zip(compared, rows, strict=True):
        variant = one.variant
        settings = [variant.settings.get(key, "") for key in axes]
        status = "failed" if one.failure else "compared"
        writer.writerow(
            [
                variant.number,
                variant.name,
                *settings,
                status,
                one.failure,
                *("" if row[name] is None else row[name] for name in filled),
            ]
        )
    return stream.getvalue()


def flat(one: Compared) -> dict[str, Value]:
    """Give every figure of a variant by name, units in the names; None for what is missing."""
    figures = one.figures
    row: dict[str, Value] = {
        "acquisitions": None if figures is None else figures.acquisitions,
        "refused": None if figures is None else figures.refused,
    }
    for group, quantity, unit in GROUPS:
        row |= _errors(group, unit, None if figures is None else figures.errors[quantity])
        row |= _agreements(group, quantity, one.standing)
    row["volume_true_from_visible_n"] = _true_from_visible(figures)
    classes = None if figures is None else figures.classes
    row |= {
        "classes_n": None if classes is None else classes.n,
        "classes_accuracy": None if classes is None else classes.accuracy,
        "classes_balanced_accuracy": None if classes is None else classes.balanced_accuracy,
    }
    row |= _ends("classes_balanced", one.standing.balanced_interval, "")
    row |= _shift("classes_balanced_shift", one.standing.balanced_shift, "")
    row |= _probabilities(one.standing.reliability)
    row |= coding_shares(None if figures is None else figures.coding)
    row |= centre_figures("centre", None if figures is None else figures.centres)
    row |= centre_figures("centre_on_product", None if figures is None else figures.centres_on_product)
    for step in (*STEPS, "frame"):
        quartiles = None if figures is None else figures.seconds.get(step)
        for part in ("median", "low", "high"):
            name = f"time_{step}_{part}_ms" if part == "median" else f"time_{step}_{part}_quartile_ms"
            row[name] = None if quartiles is None else 1000.0 * getattr(quartiles, part)
    return {name: None if isinstance(v, float) and math.isnan(v) else v for name, v in row.items()}


def coding_shares(score: CodingScore | None) -> dict[str, Value]:
    """Shares of the visible product points, %, and runs of wrong labels, rows."""
    usable = score if score is not None and score.visible else None
    shares: dict[str, Value] = {"coding_points": None if usable is None else usable.visible}
    for part in ("right", "wrong", "refused", "unseen", "ambiguous"):
        shares[f"coding_{part}_pct"] = (
            None if usable is None else 100.0 * getattr(usable, part) / usable.visible
        )
    shares["coding_wrong_points"] = None if score is None else score.wrong_points
    shares["coding_longest_wrong_run_rows"] = None if score is None else score.longest_wrong_run
    return shares


def centre_figures(group: str, score: CentreScore | None) -> dict[str, Value]:
    """Error of the centres, px: mean, root mean square, median, half of the middle 68 %; missed, false, %."""
    if score is None or score.true == 0:
        names = ("points", "bias_px", "rms_px", "median_px", "robust_std_px", "missed_pct", "false_pct")
        return {f"{group}_{name}": None for name in names}
    n = score.matched
    false = None if score.peaks == 0 else 100.0 * (score.peaks - n) / score.peaks
    return {
        f"{group}_points": score.true,
        f"{group}_bias_px": score.sum_px / n if n else None,
        f"{group}_rms_px": math.sqrt(score.sum_px2 / n) if n else None,
        f"{group}_median_px": score.quantile_px(0.5) if n else None,
        f"{group}_robust_std_px": (score.quantile_px(0.84135) - score.quantile_px(0.15865)) / 2
        if n
        else None,
        f"{group}_missed_pct": 100.0 * (score.true - n) / score.true,
        f"{group}_false_pct": false if group == "centre" else None,
    }


def _errors(group: str, unit: str, errors: Errors | None) -> dict[str, Value]:
    return {
        f"{group}_n": None if errors is None else errors.n,
        f"{group}_bias_pct": None if errors is None else errors.bias_pct,
        f"{group}_spread_pct": None if errors is None else errors.spread_pct,
        f"{group}_mean_absolute_pct": None if errors is None else errors.mean_absolute_pct,
        f"{group}_rmse_{unit}": None if errors is None else errors.rmse,
        f"{group}_median_pct": None if errors is None else errors.median_pct,
        f"{group}_min_pct": None if errors is None else errors.min_pct,
        f"{group}_max_pct": None if errors is None else errors.max_pct,
    }


def _agreements(group: str, quantity: str, standing: Standing) -> dict[str, Value]:
    """Against the truth: interval of the bias, limits, verdict; the same and more against the recipe."""
    truth, recipe = standing.truth.get(quantity), standing.recipe.get(quantity)
    return {
        **_ends(f"{group}_bias", None if truth is None else truth.mean_interval_pct, "_pct"),
        **_ends(f"{group}_limit", None if truth is None else truth.limits_pct, "_pct"),
        f"{group}_verdict": None if truth is None else truth.verdict or None,
        f"{group}_to_recipe_n": None if recipe is None else recipe.n,
        f"{group}_to_recipe_mean_pct": None if recipe is None else recipe.mean_pct,
        **_ends(f"{group}_to_recipe_mean", None if recipe is None else recipe.mean_interval_pct, "_pct"),
        **_ends(f"{group}_to_recipe_limit", None if recipe is None else recipe.limits_pct, "_pct"),
        f"{group}_to_recipe_verdict": None if recipe is None else recipe.verdict or None,
        **_shift(f"{group}_nearer", standing.nearer.get(quantity), "_pct"),
    }


def _ends(name: str, interval: Interval | None, unit: str) -> dict[str, Value]:
    low, high = (None, None) if interval is None else interval
    return {f"{name}_low{unit}": low, f"{name}_high{unit}": high}


def _shift(name: str, shift: Shift | None, unit: str) -> dict[str, Value]:
    value, interval = (None, None) if shift is None else shift
    return {f"{name}{unit}": value, **_ends(name, interval, unit)}


def _probabilities(found: Reliability | None) -> dict[str, Value]:
    return {
        "probability_n": None if found is None else found.n,
        "probability_stated": None if found is None else found.stated,
        "probability_right": None if found is None else found.right,
        **_shift("probability_excess", None if found is None else found.excess, ""),
        "probability_brier": None if found is None else found.brier,
        "probability_calibration_error": None if found is None else found.calibration_error,
    }


def _true_from_visible(figures: Figures | None) -> Any:
    return None if figures is None or figures.errors["true_mm3"] is None else figures.true_from_visible
