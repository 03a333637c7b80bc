"""The control chart of a calibration: checks with a known block, whether they agree, and whether they drift.

A check compares lengths of a known block with what the line measures, each against its standard uncertainty
(Eₙ of ISO/IEC 17043: |error| over twice that; above 1 is out). Earlier checks of the same calibration make a
chart of single values with rules by which drift is seen long before a limit is
passed. Checks are kept in a small SQLite file.

Centre and scatter are of the first values, the scatter from step to step, which a slow drift does not widen.
Rules: one value beyond three standard deviations (Shewhart 1931); two of three beyond two on one side, four
of five beyond one on one side, eight in a row on one side (Western Electric 1956); and the exponentially
weighted mean beyond its limits (Roberts 1959), which shows a small shift soonest.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from markupsafe import Markup
from pydantic import TypeAdapter

from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError, DataError, OutputError
from roemetry.html.plots import Axis, dot, line, number, picture, plain, text
from roemetry.io.files import json_values
from roemetry.records import Reason
from roemetry.records.arrays import Floats, Number

Verdict = Literal["in order", "drifting", "out"]
QUANTITIES = ("height_mm", "belt_mm", "width_mm")

WORDS = {"height_mm": "height of the block", "belt_mm": "belt's zero", "width_mm": "width of the block"}


@dataclass(frozen=True, slots=True)
class Quantity:
    """One length that was checked, mm.

    Attributes
    ----------
    value, expected
        As measured, and as the block's description says.
    std
        Standard uncertainty of their difference: the block's tolerance, the calibration's own, and a tenth
        of a pixel for what extractor and surface do to a peak.
    error_over_limit
        |value − expected| over twice `std` (Eₙ of ISO/IEC 17043); above 1 is out. NaN where not measured.
    """

    value: Number
    expected: Number
    std: Number

    @property
    def error_over_limit(self) -> float:
        """Eₙ."""
        return abs(self.value - self.expected) / (2.0 * self.std) if self.std > 0 else math.nan


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a calibration."""

    made: str
    calibration_sha256: str
    target: str
    image: str
    image_sha256: str
    height: Quantity
    belt: Quantity
    width: Quantity
    stripes: int
    stripe_spread_mm: Number
    verdict: Verdict = "in order"
    """``in order``; ``drifting``: within its limits, but the chart shows that something moves; ``out``."""
    reasons: tuple[Reason, ...] = ()

    def quantity(self, name: str) -> Quantity:
        """Give a length by its name in `QUANTITIES`."""
        found: Quantity = getattr(self, name.removesuffix("_mm"))
        return found


_CHECK = TypeAdapter(Check)


def judge(check: Check, history: Sequence[Check]) -> tuple[Verdict, tuple[Reason, ...]]:
    """Give verdict and reasons; `history` holds earlier checks of the same calibration, oldest first."""
    out, drifting = [], []
    for name in QUANTITIES:
        now = check.quantity(name)
        if now.error_over_limit > 1.0:
            out.append(
                Reason(
                    "calibration-out",
                    f"{WORDS[name]}: {now.value:.3f} mm, expected {now.expected:.3f} mm; the difference of "
                    f"{now.value - now.expected:+.3f} mm is {now.error_over_limit:.1f} times its limit of "
                    f"{2 * now.std:.3f} mm",
                )
            )
        said = _drift(name, now, [earlier.quantity(name).value for earlier in history])
        if said:
            drifting.append(Reason("calibration-drift", said))
    verdict: Verdict = "out" if out else "drifting" if drifting else "in order"
    return verdict, (*out, *drifting)


def _drift(name: str, now: Quantity, before: Sequence[float]) -> str:
    """Say which rule of a control chart of single values this check breaks, or nothing."""
    known = [value for value in before if math.isfinite(value)]
    limits = limits_of(known)
    if limits is None or not math.isfinite(now.value):
        return ""
    broken = [one for one in signals([*known, now.value], limits) if one.at == len(known)]
    if not broken:
        return ""
    return (
        f"{WORDS[name]}: {now.value:.3f} mm: {broken[0].words} ({limits.centre:.3f} ± {limits.std:.4f} mm, "
        f"by the first {BASELINE} checks)"
    )


_FORMAT = 1
"""Of the file."""
_TABLE = """
CREATE TABLE IF NOT EXISTS checks
(made TEXT NOT NULL, calibration_sha256 TEXT NOT NULL, content TEXT NOT NULL)
"""


class Chart:
    """A file of checks, made at the first one; each is written whole or not at all."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def add(self, check: Check) -> None:
        """Write a check down; raise OutputError where the file cannot be written."""
        row = (check.made, check.calibration_sha256, json.dumps(json_values(asdict(check))))
        try:
            with self._opened() as base:
                base.execute(_TABLE)
                base.execute(f"PRAGMA user_version = {_FORMAT}")
                base.execute("INSERT INTO checks VALUES (?, ?, ?)", row)
                base.commit()
        except sqlite3.OperationalError as error:
            raise OutputError(
                f"{self._path}: the check cannot be written: {error}",
                hint="can the folder be written, and is the disk not full? earlier checks are as they were",
            ) from error
        except sqlite3.DatabaseError as error:
            raise self._damaged(error) from error

    def checks(self, calibration_sha256: str | None = None) -> tuple[Check, ...]:
        """Give the checks, oldest first: of one calibration, or of all; none where there is no file."""
        if not self._path.is_file():
            return ()
        query = "SELECT content FROM checks"
        try:
            with self._opened() as base:
                if calibration_sha256 is None:
                    rows = base.execute(f"{query} ORDER BY made, rowid").fetchall()
                else:
                    wanted = f"{query} WHERE calibration_sha256 = ? ORDER BY made, rowid"
                    rows = base.execute(wanted, (calibration_sha256,)).fetchall()
            return tuple(_CHECK.validate_json(content) for (content,) in rows)
        except (sqlite3.DatabaseError, ValueError, KeyError, TypeError) as error:
            raise self._damaged(error) from error

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self._path, timeout=10.0)) as base:
            yield base

    def _damaged(self, error: Exception) -> DataError:
        return DataError(
            f"{self._path}: this is no control chart, or it is damaged: {error}",
            hint="name another file: a new chart begins there",
        )


_SECONDS_PER_DAY = 86400.0


def calibration_doubts(recipe: Recipe, now: datetime | None = None) -> tuple[Reason, ...]:
    """Give what the recipe's demands on its calibration find wanting `now` (None: this moment).

    DataError where the chart that is named is no chart.
    """
    asked, calibration = recipe.calibration_check, recipe.calibration
    reasons = []
    if calibration is not None and calibration.poor:
        reasons.append(
            Reason("calibration-poor", f"the calibration was accepted though refused: {calibration.poor}")
        )
    if asked is None or calibration is None:
        return tuple(reasons)
    now = now or datetime.now(UTC)
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


def refuse_doubtful(recipe: Recipe, doubts: Sequence[Reason]) -> None:
    """Raise CalibrationError where the recipe asks for that on a failed or missing check."""
    if recipe.calibration_check is not None and recipe.calibration_check.refuse and doubts:
        raise CalibrationError(
            f"{recipe.path}: the calibration is not fit for use: "
            f"{'; '.join(reason.text for reason in doubts)}",
            hint="`roemetry check-calibration` with a known block; where that fails, calibrate again "
            "(calibration_check.refuse in the recipe asks for this)",
        )


def due(check: Check, max_age_days: float) -> datetime:
    """Give the moment at which the next check is due."""
    return datetime.fromisoformat(check.made) + timedelta(days=max_age_days)


def _days_since(moment: str, now: datetime) -> float:
    try:
        return (now - datetime.fromisoformat(moment)).total_seconds() / _SECONDS_PER_DAY
    except ValueError:
        return float("nan")


_COLOURS = {"in order": "#0d689c", "drifting": "#c77700", "out": "#c8202a"}
_WIDTH = 900.0  # of a chart, in the page's units


def chart_page(checks: Sequence[Check], title: str) -> str:
    """Write the page of one calibration's checks, oldest first; there is at least one."""
    from roemetry.html.page import environment_of  # jinja2 takes 50 ms; runs do without

    return (
        environment_of("roemetry.run")
        .get_template("chart.html.j2")
        .render(
            title=title,
            checks=list(reversed(checks)),
            last=checks[-1],
            plots=[(WORDS[name], chart_plot(checks, name)) for name in QUANTITIES],
            quantities=QUANTITIES,
            colours=_COLOURS,
            version=version("roemetry"),
        )
    )


def chart_plot(checks: Sequence[Check], name: str) -> Markup:
    """Draw one length over the checks: what it should be, its limits, and what was measured."""
    known = [(n, check, check.quantity(name)) for n, check in enumerate(checks, start=1)]
    known = [item for item in known if item[2].value == item[2].value]
    if not known:
        return Markup("<p>not measured</p>")
    ends = [known[-1][2].expected + side * 2 * max(q.std for _, _, q in known) for side in (-1, 1)]
    values = [*ends, *(q.value for _, _, q in known)]
    left, right, top, bottom = 70.0, _WIDTH - 20.0, 16.0, 170.0
    room = 0.06 * (max(values) - min(values))
    y_axis = Axis.over(min(values) - room, max(values) + room, bottom, top)
    x_axis = Axis.over(0.5, len(checks) + 0.5, left, right)
    body = []
    for value, words in y_axis.ticks(5):
        body += [line(left, y_axis(value), right, y_axis(value), "grid")]
        body += [text(left - 6, y_axis(value) + 4, words, "end")]
    expected = known[-1][2].expected
    body += [line(left, y_axis(expected), right, y_axis(expected), "zero")]
    for side in (-1, 1):
        ways = [(x_axis(n), y_axis(q.expected + side * 2 * q.std)) for n, _, q in known]
        ways = [(left, ways[0][1]), *ways, (right, ways[-1][1])]
        path = "L".join(f"{number(x)} {number(y)}" for x, y in ways)
        body.append(Markup('<path class="limit" d="M{}"/>').format(path))
    for n, check, found in known:
        words = f"{check.made}: {plain(found.value, 3)} mm, {check.verdict}"
        body.append(dot(x_axis(n), y_axis(found.value), "point", words, _COLOURS[check.verdict], 4.0))
    ticks = [n for n, _ in x_axis.ticks(10) if n == round(n)]
    body += [text(x_axis(n), bottom + 16, f"{n:.0f}") for n in ticks]
    body += [text(right, bottom + 32, "check number", "end"), text(left - 6, top - 4, "mm", "end")]
    return picture(body, bottom + 38, f"{WORDS[name]} over the checks", _WIDTH)


BASELINE = 8
"""Values that centre and scatter are taken from: the scatter is then known to 25 %."""
SHEWHART = 3.0
"""Standard deviations of the outer limits: by chance once in 370 values."""
EWMA_WEIGHT, EWMA_LIMIT = 0.2, 2.86
"""Weight of the newest value, and the limit in standard deviations of the weighted mean, which goes with it:
by chance once in 370 values as well (Lucas and Saccucci 1990, table 3)."""
_MOVING_RANGE_TO_STD = 1.128
"""Mean range of two normal values in standard deviations (d₂)."""


class Signal(NamedTuple):
    """A value that breaks a rule."""

    at: int
    """Index of the value."""
    rule: str
    """Short name: ``3 sigma``, ``2 of 3``, ``4 of 5``, ``8 in a row``, ``EWMA``."""
    words: str


class Limits(NamedTuple):
    """Centre and scatter of a chart."""

    centre: float
    std: float


def limits_of(values: Sequence[float] | Floats) -> Limits | None:
    """Give centre and scatter by the first values; None where there are fewer than `BASELINE`."""
    known = np.asarray(values, np.float64)
    if known.size < BASELINE:
        return None
    scatter = float(np.abs(np.diff(known)).mean()) / _MOVING_RANGE_TO_STD
    return Limits(float(known[:BASELINE].mean()), max(scatter, 1e-12))


def signals(values: Sequence[float] | Floats, limits: Limits) -> tuple[Signal, ...]:
    """Give every value after the baseline that breaks a rule, once each, by the first rule that it breaks."""
    z = (np.asarray(values, np.float64) - limits.centre) / limits.std
    found = []
    mean = 0.0
    for index, value in enumerate(z.tolist()):
        mean = EWMA_WEIGHT * value + (1.0 - EWMA_WEIGHT) * mean
        if index < BASELINE:
            continue
        width = EWMA_LIMIT * math.sqrt(
            EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * (1.0 - (1.0 - EWMA_WEIGHT) ** (2 * (index + 1)))
        )
        side = "above" if value > 0 else "below"
        sign = math.copysign(1.0, value)
        if abs(value) > SHEWHART:
            found.append(
                Signal(index, "3 sigma", f"lies {abs(value):.1f} standard deviations {side} the centre")
            )
        elif (sign * z[index - 2 : index + 1] > 2.0).sum() >= 2:
            found.append(
                Signal(index, "2 of 3", f"two of three lie more than 2 standard deviations {side} the centre")
            )
        elif (sign * z[index - 4 : index + 1] > 1.0).sum() >= 4:
            found.append(
                Signal(index, "4 of 5", f"four of five lie more than 1 standard deviation {side} the centre")
            )
        elif index >= 2 * BASELINE - 1 and (sign * z[index - 7 : index + 1] > 0.0).all():
            found.append(Signal(index, "8 in a row", f"the last eight all lie {side} the centre"))
        elif abs(mean) > width:
            found.append(
                Signal(index, "EWMA", f"the weighted mean has moved {side} the centre by more than its limit")
            )
    return tuple(found)
