"""Where data sets disagree: the same variants' figures on each set, side by side.

Two simulators that render one scene share the rig but no assumption about light or bodies. A figure that
differs between their data sets by more than its own uncertainty rests on such an assumption, and says
little of images that neither of them made.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.tables import Value, flat

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
class Beside:
    """One figure of one variant on every data set.

    Attributes
    ----------
    variant, figure
        The variant's name; the column of ``comparison.csv``.
    values
        By data set; None where it has none.
    apart
        Whether the 95 % intervals of two sets do not meet; None where the figure has no interval.
    """

    variant: str
    figure: str
    values: Mapping[str, Value]
    apart: bool | None

    @property
    def difference(self) -> float:
        """Largest less smallest value; NaN where fewer than two sets have one."""
        known = [float(value) for value in self.values.values() if isinstance(value, int | float)]
        return max(known) - min(known) if len(known) > 1 else math.nan


def between(compared: Mapping[str, Sequence[Compared]]) -> list[Beside]:
    """Set the figures of the same variants on several data sets side by side.

    Parameters
    ----------
    compared
        By data set, what its comparison gave; the variants are the same ones in the same order.
    """
    found = []
    for same in zip(*compared.values(), strict=True):
        rows = {name: flat(one) for name, one in zip(compared, same, strict=True)}
        for figure in FIGURES:
            values = {name: row[figure] for name, row in rows.items()}
            if any(value is not None for value in values.values()):
                ends = [_interval(row, figure) for row in rows.values()]
                known = [end for end in ends if end is not None]
                # intervals all meet one another if and only if the last to begin does so before any ends
                apart = (
                    max(end[0] for end in known) > min(end[1] for end in known) if len(known) > 1 else None
                )
                found.append(Beside(same[0].variant.name, figure, values, apart))
    return found


def to_csv(found: Sequence[Beside]) -> str:
    """Write a line for each variant and figure."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["variant", "figure", *found[0].values, "difference", "apart"] if found else ["variant"])
    for one in found:
        values = ["" if value is None else value for value in one.values.values()]
        difference = "" if math.isnan(one.difference) else one.difference
        apart = "" if one.apart is None else str(one.apart).lower()
        writer.writerow([one.variant, one.figure, *values, difference, apart])
    return stream.getvalue()


def _interval(row: Mapping[str, Value], figure: str) -> tuple[float, float] | None:
    if not figure.endswith("_bias_pct"):
        return None
    low, high = (row.get(figure.replace("_bias_pct", f"_bias_{end}_pct")) for end in ("low", "high"))
    return (low, high) if isinstance(low, float) and isinstance(high, float) else None
