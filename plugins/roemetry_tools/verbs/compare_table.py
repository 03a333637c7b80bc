"""The tables of a comparison, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from roemetry.html.plots import share
from roemetry_tools.compare.between import Beside
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.tables import Value, flat

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
    ("coded\nright %", "coding_right_pct", "share"),
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
        table = Table(
            title=Text(heading) if heading else None,
            title_justify="left",
            box=SIMPLE_HEAD,
            pad_edge=False,
            collapse_padding=True,
        )
        table.add_column("variant", overflow="fold", min_width=16)
        if not tables:
            table.add_column("refused", justify="right", no_wrap=True)
        for words, _, _ in columns:
            table.add_column(words, justify="right", no_wrap=True)
        for one, row in zip(compared, rows, strict=True):
            cells = [_cell(row[key], form) for _, key, form in columns]
            style = "red" if one.failure else ""
            table.add_row(Text(one.variant.name, style=style), *_refused(one, not tables), *cells)
        tables.append(table)
    return tables


def _cell(value: Value, form: str) -> str:
    if value is None:
        return ""
    if form == "share":
        assert isinstance(value, float)
        return share(value)
    return format(value, form)


def _refused(one: Compared, wanted: bool) -> list[Text]:
    if not wanted:
        return []
    figures = one.figures
    return [Text("failed", "red") if figures is None else Text(f"{figures.refused}/{figures.acquisitions}")]


def between_table(found: Sequence[Beside]) -> Table:
    """Make the table of figures on several data sets; red: their intervals do not meet."""
    table = Table(title="between the data sets", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("variant", overflow="fold", min_width=16)
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
    """Write what must be said of variants: why they failed or refused, why figures are missing."""
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
