"""Doubts about a calibration that every measurement made with it carries."""

from __future__ import annotations

from datetime import UTC, datetime

from roemetry.checking.chart import Chart
from roemetry.recipe import Recipe
from roemetry.records import Reason

_SECONDS_PER_DAY = 86400.0


def calibration_doubts(recipe: Recipe, now: datetime | None = None) -> tuple[Reason, ...]:
    """Give what the recipe's demands on its calibration find wanting.

    Parameters
    ----------
    recipe
        With its calibration and, maybe, demands on it.
    now
        None: this moment.

    Raises
    ------
    DataError
        The chart that is named is no chart.
    """
    asked, calibration = recipe.calibration_check, recipe.calibration
    if asked is None or calibration is None:
        return ()
    now = now or datetime.now(UTC)
    reasons = []
    old = _days_since(calibration.made, now)
    if asked.valid_days is not None and not old <= asked.valid_days:
        reasons.append(
            Reason(
                "calibration-expired",
                f"the calibration is of {calibration.made or 'an unknown date'}; "
                f"it may be {asked.valid_days:g} days old: calibrate again",
            )
        )
    if asked.chart is None:
        return tuple(reasons)
    chart = recipe.path.parent / asked.chart
    checks = Chart(chart).checks(calibration.sha256)
    if not checks:
        words = f"{chart.name} holds no check of this calibration: run `roemetry check-calibration`"
        return (*reasons, Reason("calibration-unchecked", words))
    last = checks[-1]
    if last.verdict != "in order":
        reasons += last.reasons
    since = _days_since(last.made, now)
    if asked.max_age_days is not None and since > asked.max_age_days:
        reasons.append(
            Reason(
                "calibration-overdue",
                f"the calibration was last checked {since:.1f} days ago; {asked.max_age_days:g} are allowed",
            )
        )
    return tuple(reasons)


def _days_since(moment: str, now: datetime) -> float:
    try:
        return (now - datetime.fromisoformat(moment)).total_seconds() / _SECONDS_PER_DAY
    except ValueError:
        return float("nan")
