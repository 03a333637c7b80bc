"""Numbers, dates and reasons as people read them."""

from __future__ import annotations

import math
import re

from markupsafe import Markup, escape

from roemetry.html.plots import in_words, plain
from roemetry.html.plots import share as share_of_100
from roemetry.records import Estimate
from roemetry.records.units import NOT_STATED


def value(estimate: Estimate, per: float = 1.0, digits: int = 2) -> str:
    """Write an estimate's value, to the place its uncertainty supports where that is stated."""
    return plain(estimate.value / per, _decimals(estimate.std / per, digits))


def uncertainty(estimate: Estimate, per: float = 1.0, digits: int = 2) -> str:
    """Write the standard uncertainty with two significant digits, or say that it is not stated."""
    std = estimate.std / per
    return plain(std, _decimals(std, digits)) if math.isfinite(std) else NOT_STATED


def interval(estimate: Estimate, per: float = 1.0) -> str:
    """Write the 95 % interval to the place its uncertainty supports; nothing where it is not stated."""
    low, high = estimate.interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return ""
    decimals = _decimals(estimate.std / per, 2)
    return f"{plain(low / per, decimals)} to {plain(high / per, decimals)}"


def budget(estimate: Estimate, per: float = 1.0) -> tuple[tuple[str, str], ...]:
    """Give the causes of the uncertainty, each with its part, the largest first."""
    parts = sorted(estimate.budget.items(), key=lambda part: -part[1])
    decimals = _decimals(max(estimate.budget.values(), default=math.nan) / per, 2)
    return tuple((cause, plain(part / per, decimals)) for cause, part in parts)


def percent(share: float) -> str:
    """Write a share in per cent; a small one is never written as nothing."""
    if not math.isfinite(share):
        return "–"
    fine = 0 < share < 0.1 or 0.9 < share < 1
    return share_of_100(100 * share, 1 if fine else 0) + " %"


def breakable(name: str) -> Markup:
    """Let a long name break where its parts meet, and before its product's number."""
    return Markup("<wbr>").join(part for part in _JOINTS.split(name) if part)


def clause(text: str) -> str:
    """Give a sentence's first clause where the whole is long; an ellipsis says that there is more."""
    if len(text) <= _LONG:
        return text
    end = next((m.start() for m in re.finditer(r"[;:.,]?\s", text) if m.group()[0] in ";:."), _LONG)
    short = text[:end] if end <= _LONG else text[:_LONG].rsplit(" ", 1)[0]
    return short.rstrip() + " …"


def milliseconds(seconds: float) -> str:
    """Write a duration in ms with three significant digits or so."""
    ms = 1e3 * seconds
    return plain(ms, 2 if ms < 1 else 1 if ms < 100 else 0)


def marked(text: str) -> Markup:
    """Set what stands between back-ticks as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return Markup(escape(text))
    coded = (Markup("<code>{}</code>" if k % 2 else "{}").format(part) for k, part in enumerate(parts))
    return Markup("").join(coded)


def counted(count: int, one: str) -> str:
    """Write a count with its noun."""
    return f"{count} {one if count == 1 else one + 's'}"


def feature(name: str, figure: float, std: float = math.nan) -> tuple[str, str]:
    """Give a figure's name in words with its unit, and the figure with its standard uncertainty if stated."""
    text = _short(figure)
    if math.isfinite(figure) and std > 0:
        text = f"{plain(figure, _decimals(std, 2))} ± {plain(std, _decimals(std, 2))}"
    return in_words(name), text


_LONG = 100
"""Letters of a sentence that a cell of the table holds in three lines."""
_JOINTS = re.compile(r"(?<=\w[_/.-])(?=\w)|(?=#)")


def _short(figure: float) -> str:
    if not math.isfinite(figure):
        return "–"
    if figure == int(figure):
        return plain(figure, 0)
    return plain(figure, max(2, 2 - math.floor(math.log10(abs(figure)))) if abs(figure) < 1 else 2)


def _decimals(std: float, otherwise: int) -> int:
    if not math.isfinite(std) or std <= 0:
        return otherwise
    return max(0, min(6, 1 - math.floor(math.log10(std))))
