"""The control chart as a page: one file that opens anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

from markupsafe import Markup

from roemetry.checking.judging import QUANTITIES, WORDS, Check
from roemetry.pages.svg import Axis, dot, line, number, picture, plain, text
from roemetry.pages.templating import environment_of

_COLOURS = {"in order": "#0d689c", "drifting": "#c77700", "out": "#c8202a"}
_WIDTH = 900.0


def page(checks: Sequence[Check], title: str) -> str:
    """Write the page of one calibration's checks, oldest first; there is at least one."""
    return (
        environment_of("roemetry.checking")
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
