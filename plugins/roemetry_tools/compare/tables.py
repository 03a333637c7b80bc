"""Figures of the variants as flat rows: one set of names for CSV, terminal and page; several data sets.

Two simulators that render one scene share the rig but no assumption about light or bodies. A figure that
differs between their data sets by more than its own uncertainty rests on such an assumption, and says little
of images that neither of them made.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from roemetry.config.recipe_file import StageChoices
from roemetry.html.plots import share
from roemetry_tools.compare.agreement import Interval, Reliability, Shift, Terms
from roemetry_tools.compare.early_stopping import Stopped
from roemetry_tools.compare.ranking import (
    PRODUCTS_ENOUGH,
    Compared,
    Leader,
    Standing,
    leader_of,
    same_results,
)
from roemetry_tools.compare.score import Errors
from roemetry_tools.compare.stripes import CentreScore, CodingScore

Value = float | int | str | None

GROUPS = (
    ("volume_visible", "visible_mm3", "mm3"),
    ("volume_true", "true_mm3", "mm3"),
    ("weight", "mass_g", "g"),
)
"""Name in the table, name of the quantity, unit."""

STEPS = ("source", *StageChoices.model_fields)
"""Steps that are timed, in their order."""


def to_csv(compared: Sequence[Compared]) -> str:
    """Write a line for each variant; columns that no variant has anything in are left out."""
    rows = [flat(one) for one in compared]
    filled = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    axes = list(dict.fromkeys(key for one in compared for key in one.variant.settings))
    lines: list[list[Value]] = [
        ["variant", "name", *(f"set {key}" for key in axes), "status", "reason", *filled]
    ]
    for one, row in zip(compared, rows, strict=True):
        settings = [one.variant.settings.get(key, "") for key in axes]
        cells = [row[name] for name in filled]
        lines.append([one.variant.number, one.variant.name, *settings, one.status, one.failure, *cells])
    return csv_of(lines)


def csv_of(lines: Iterable[Sequence[object]]) -> str:
    """Write lines as CSV; None and NaN are left empty."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for line in lines:
        writer.writerow(["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in line])
    return stream.getvalue()


def flat(one: Compared) -> dict[str, Value]:
    """Give every figure of a variant by name, units in the names; None for what is missing."""
    figures = one.figures
    row: dict[str, Value] = {name: getattr(figures, name, None) for name in ("acquisitions", "refused")}
    for group, quantity, unit in GROUPS:
        row |= _errors(group, unit, None if figures is None else figures.errors[quantity])
        row |= _agreements(group, quantity, one.standing)
    from_visible = figures is not None and figures.errors["true_mm3"] is not None
    row["volume_true_from_visible_n"] = figures.true_from_visible if figures and from_visible else None
    classes = None if figures is None else figures.classes
    row |= _named("classes", classes, "n accuracy balanced_accuracy")
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
    shares: dict[str, Value] = {"coding_points": getattr(usable, "visible", None)}
    for part in ("right", "wrong", "refused", "unseen", "ambiguous"):
        share_pct = None if usable is None else 100.0 * getattr(usable, part) / usable.visible
        shares[f"coding_{part}_pct"] = share_pct
    shares["coding_wrong_points"] = getattr(score, "wrong_points", None)
    shares["coding_longest_wrong_run_rows"] = getattr(score, "longest_wrong_run", None)
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
        f"{group}_robust_std_px": score.robust_std_px if n else None,
        f"{group}_missed_pct": 100.0 * (score.true - n) / score.true,
        f"{group}_false_pct": false if group == "centre" else None,
    }


def _named(group: str, of: object, names: str) -> dict[str, Value]:
    """Give attributes under the group's name; all None where there is nothing."""
    return {f"{group}_{name}": None if of is None else getattr(of, name) for name in names.split()}


def _errors(group: str, unit: str, errors: Errors | None) -> dict[str, Value]:
    return {
        **_named(group, errors, "n bias_pct spread_pct mean_absolute_pct"),
        f"{group}_rmse_{unit}": None if errors is None else errors.rmse,
        **_named(group, errors, "median_pct min_pct max_pct"),
    }


def _agreements(group: str, quantity: str, standing: Standing) -> dict[str, Value]:
    """Against the truth: interval of the bias, limits, verdict; the same and more against the recipe."""
    truth, recipe = standing.truth.get(quantity), standing.recipe.get(quantity)
    return {
        **_ends(f"{group}_bias", None if truth is None else truth.mean_interval_pct, "_pct"),
        **_ends(f"{group}_limit", None if truth is None else truth.limits_pct, "_pct"),
        f"{group}_verdict": None if truth is None else truth.verdict or None,
        **_named(f"{group}_to_recipe", recipe, "n mean_pct"),
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
        **_named("probability", found, "n stated right"),
        **_shift("probability_excess", None if found is None else found.excess, ""),
        **_named("probability", found, "brier calibration_error"),
    }


FIGURES = (
    "refused",
    "volume_visible_bias_pct",
    "volume_visible_mean_absolute_pct",
    "volume_true_bias_pct",
    "weight_bias_pct",
    "classes_balanced_accuracy",
    "coding_right_pct",
    "coding_wrong_pct",
    "coding_refused_pct",
    "centre_bias_px",
    "centre_rms_px",
    "centre_missed_pct",
    "centre_false_pct",
)
"""Columns of ``comparison.csv`` that are set side by side."""


@dataclass(frozen=True)
class AcrossSets:
    """One figure of one variant on every data set."""

    variant: str
    figure: str
    """variant, figure: the variant's name; the column of ``comparison.csv``."""
    values: Mapping[str, Value]
    """By data set; None where it has none."""
    apart: bool | None
    """Whether the 95 % intervals of two sets do not meet; None where the figure has no interval."""

    @property
    def difference(self) -> float:
        """Largest less smallest value; NaN where fewer than two sets have one."""
        known = [float(value) for value in self.values.values() if isinstance(value, int | float)]
        return max(known) - min(known) if len(known) > 1 else math.nan


def across_sets(compared: Mapping[str, Sequence[Compared]]) -> list[AcrossSets]:
    """Set the figures of the same variants, in the same order, on several data sets side by side."""
    found = []
    for same in zip(*compared.values(), strict=True):
        rows = {name: flat(one) for name, one in zip(compared, same, strict=True)}
        for figure in FIGURES:
            values = {name: row[figure] for name, row in rows.items()}
            if any(value is not None for value in values.values()):
                ends = [_interval(row, figure) for row in rows.values()]
                known = [end for end in ends if end is not None]
                # intervals all meet one another if and only if the last to begin does so before any ends
                apart = None
                if len(known) > 1:
                    apart = max(low for low, _ in known) > min(high for _, high in known)
                found.append(AcrossSets(same[0].variant.name, figure, values, apart))
    return found


def across_to_csv(found: Sequence[AcrossSets]) -> str:
    """Write a line for each variant and figure."""
    head = ["variant", "figure", *found[0].values, "difference", "apart"] if found else ["variant"]
    apart = {None: "", True: "true", False: "false"}
    lines = [
        [one.variant, one.figure, *one.values.values(), one.difference, apart[one.apart]] for one in found
    ]
    return csv_of([head, *lines])


def _interval(row: Mapping[str, Value], figure: str) -> tuple[float, float] | None:
    if not figure.endswith("_bias_pct"):
        return None
    low, high = (row.get(figure.replace("_bias_pct", f"_bias_{end}_pct")) for end in ("low", "high"))
    return (low, high) if isinstance(low, float) and isinstance(high, float) else None


_MEASURED = (
    ("visible\nbias %", "volume_visible_bias_pct", "+.1f"),
    ("|err|\n%", "volume_visible_mean_absolute_pct", ".1f"),
    ("RMSE\nmm³", "volume_visible_rmse_mm3", ".0f"),
    ("true\nbias %", "volume_true_bias_pct", "+.1f"),
    ("weight\n|err| %", "weight_mean_absolute_pct", ".1f"),
    ("classes\nbalanced", "classes_balanced_accuracy", ".3f"),
)
_VERDICTS = (("visible volume", "volume_visible"), ("true volume", "volume_true"), ("weight", "weight"))
_STRIPES = (
    ("labelled\nright %", "coding_right_pct", "share"),
    ("wrong\n%", "coding_wrong_pct", "share"),
    ("wrong\nrun", "coding_longest_wrong_run_rows", "d"),
    ("centre\nbias px", "centre_bias_px", "+.3f"),
    ("RMS\npx", "centre_rms_px", ".3f"),
    ("missed\n%", "centre_missed_pct", "share"),
    ("false\n%", "centre_false_pct", "share"),
    ("time\nms", "time_frame_median_ms", ".2f"),
)


def tables_of(title: str, compared: Sequence[Compared]) -> list[Table]:
    """Make two tables, a line for each variant: products against truth; stripes against truth, and time.

    Columns without any figure are left out. |err| is the mean of the absolute errors.
    """
    rows = [flat(one) for one in compared]
    tables: list[Table] = []
    for heading, every in ((title, _MEASURED), ("", _STRIPES)):
        columns = [column for column in every if any(row[column[1]] is not None for row in rows)]
        if not columns and tables:
            continue
        table = _table(Text(heading) if heading else None)
        for words in ([] if tables else ["refused"]) + [words for words, _, _ in columns]:
            table.add_column(words, justify="right", no_wrap=True)
        for one, row in zip(compared, rows, strict=True):
            cells = [Text(_cell(row[key], form)) for _, key, form in columns]
            if not tables:
                measured = "{refused}/{acquisitions}".format(**row)
                cells.insert(0, Text("failed", "red") if one.figures is None else Text(measured))
            table.add_row(Text(one.variant.name, style="red" if one.failure else ""), *cells)
        tables.append(table)
    return tables


def _table(title: Text | None) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("variant", overflow="fold", min_width=16)
    return table


def _cell(value: Value, form: str) -> str:
    if value is None:
        return ""
    return share(float(value)) if form == "share" else format(value, form)


def across_table(found: Sequence[AcrossSets]) -> Table:
    """Make the table of figures on several data sets; red: their intervals do not meet."""
    table = _table(Text("between the data sets"))
    table.add_column("figure")
    for name in found[0].values if found else ():
        table.add_column(Text(name), justify="right", no_wrap=True)
    table.add_column("difference", justify="right", no_wrap=True)
    for one in found:
        cells = ["" if value is None else f"{value:.4g}" for value in one.values.values()]
        style = "red" if one.apart else ""
        difference = "" if math.isnan(one.difference) else f"{one.difference:.3g}"
        table.add_row(Text(one.variant), Text(one.figure, style), *cells, Text(difference, style))
    return table


def first_lines_of(compared: Sequence[Compared], terms: Terms, without_truth: str) -> list[str]:
    """Write which variant leads, by how much and how certainly; then what need not have been compared."""
    leader = leader_of(compared, terms)
    if leader is not None:
        said = [_led(leader), *warning_of(leader.specimens)]
    elif len(compared) < 2:
        said = ["no winner: there is one variant"]
    elif len(left := [one for one in compared if one.status == "compared"]) == 1 and len(left) < sum(
        one.status != "failed" for one in compared
    ):
        said = [f"winner: `{left[0].variant.name}`: the others are certainly worse"]
    else:
        said = [f"no winner: {without_truth or 'no two variants differ on the same products'}"]
    names = {one.variant.number: one.variant.name for one in compared}
    said += [_stopped(one.variant.name, one.stopped, names) for one in compared if one.stopped is not None]
    for one in compared:
        said += [
            f"`{name}` was left out: it is the same recipe as `{one.variant.name}`"
            for name in one.variant.left_out
        ]
    said += [
        f"`{one.name}` measured exactly what `{other.name}` did: their difference has no effect here"
        for one, other in same_results(compared)
    ]
    return said


WORDS = {"visible_mm3": "visible volume", "true_mm3": "true volume", "mass_g": "weight"}
"""Of the quantities."""


def warning_of(specimens: int) -> list[str]:
    """Warn of few products; nothing where there are enough."""
    if specimens >= PRODUCTS_ENOUGH:
        return []
    return [
        f"warning: {specimens} products; with fewer than {PRODUCTS_ENOUGH} differences and intervals say "
        "little about other products"
    ]


def _stopped(name: str, stopped: Stopped, names: Mapping[int, str]) -> str:
    return (
        f"`{name}` was stopped after {stopped.acquisitions} acquisitions: its mean absolute error of the "
        f"{WORDS[stopped.figure]} is {stopped.more_pct:.2f} percentage points more than that of "
        f"`{names[stopped.by]}` on {stopped.specimens} products, which is significant"
    )


def _led(leader: Leader) -> str:
    what = WORDS[leader.figure]
    value, (low, high) = leader.lead
    error = (
        f"mean absolute error of the {what} {leader.error_pct:.2f} %; `{leader.other.name}` has {value:.2f} "
        f"percentage points more (95 % interval {low:.2f} to {high:.2f})"
    )
    if leader.is_sure:
        return f"winner: `{leader.best.name}`: {error}; {leader.specimens} products are enough to decide"
    needed = f", about {leader.specimens_needed} would be" if leader.specimens_needed else ""
    return (
        f"no clear winner; `{leader.best.name}` is ahead: {error}; {leader.specimens} products are not "
        f"enough to decide{needed}"
    )


def verdicts_of(compared: Sequence[Compared], tolerance_pct: float | None) -> list[str]:
    """Write a sentence for each verdict on a variant beside the recipe as it is."""
    said = []
    for one in compared:
        row = flat(one)
        for what, group in _VERDICTS:
            if (verdict := row[f"{group}_to_recipe_verdict"]) is None:
                continue
            mean, low, high = (row[f"{group}_to_recipe_mean{end}_pct"] for end in ("", "_low", "_high"))
            said.append(
                f"{one.variant.name}: {what} beside the recipe's, tolerance {tolerance_pct:g} %: {verdict}; "
                f"mean difference {_signed(mean)} % ({_signed(low)} to {_signed(high)}), "
                f"{row[f'{group}_to_recipe_n']} products"
            )
    return said


def _signed(value: Value) -> str:
    return "?" if not isinstance(value, float) else f"{value:+.2f}"


def problems_of(compared: Sequence[Compared]) -> list[str]:
    """Write why variants failed or refused."""
    said = []
    for one in compared:
        if one.failure:
            said.append(f"{one.variant.name}: failed: {one.failure}")
        elif one.figures is not None:
            said += [
                f"{one.variant.name}: {cause.count} of {one.figures.acquisitions} acquisitions refused "
                f"({cause.code}): {cause.text}"
                for cause in one.figures.causes
            ]
    return said
