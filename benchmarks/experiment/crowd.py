"""What many traced skeins say: who confuses what, what lies between the stripes, where weight is lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from benchmarks.coding_plots import curves
from benchmarks.grading.judges import SHOWN_MM
from benchmarks.grading.scores import Judged, score_of
from benchmarks.tables import ends, share, table
from benchmarks.traced.causes import CAUSES
from benchmarks.traced.shown import STRIPES
from benchmarks.traced.tables import Row
from roemetry.html import plots as svg
from roemetry_tools.compare.agreement import Bootstrap, mean_of

KINDS = ("none", "dented", "several-dents", "bent", "s-bent", "twisted", "folded", "broken")
_DRAWN = ("paper's rule", "paper's rule, best options", "`learned`")
_BINS = 5


def by_kind(found: Mapping[str, Sequence[Judged]]) -> str:
    """Write, kind by kind, how many each classifier calls deformed."""
    rows = []
    for kind in KINDS:
        cells, n, shown = [], 0, 0
        for judged in found.values():
            mine = [one for one in judged if one.row.kind == kind]
            n = len(mine)
            shown = sum(one.row.defect["shown_mm"] >= SHOWN_MM for one in mine)
            cells.append(f"{100.0 * sum(one.caught for one in mine) / n:.0f} %" if n else "–")
        rows.append(
            ["good" if kind == "none" else kind, str(n), "" if kind == "none" else str(shown), *cells]
        )
    return table(["made", "skeins", "shown", *found], rows)


def good_against_deformed(found: Mapping[str, Sequence[Judged]]) -> str:
    """Write the balanced accuracies."""
    rows = []
    for name, judged in found.items():
        s = score_of(judged)
        all_of = 0.5 * (s.kept / max(s.good, 1) + s.caught_of_all / max(s.deformed, 1))
        named = share(s.named, s.shown) if "paper" not in name else "does not name"
        rows.append(
            [
                name,
                share(s.kept, s.good),
                share(s.caught, s.shown),
                f"{s.balanced:.3f} ({ends(s.balanced_interval)})",
                f"{all_of:.3f}",
                named,
            ]
        )
    head = ["classifier", "good kept", "caught, if shown", "balanced, if shown (95 %)"]
    return table([*head, "balanced, all", "named right"], rows)


def over_spacing(found: Mapping[str, Sequence[Judged]], path: Path) -> str:
    """Draw and write the share of skeins with one dent that is caught, over its extent in spacings."""
    dents = {name: [one for one in found[name] if one.row.kind == "dented"] for name in _DRAWN}
    some = next(iter(dents.values()))
    sizes = np.array([one.row.defect["spacings"] for one in some])
    edges = np.quantile(sizes, np.linspace(0.0, 1.0, _BINS + 1))
    place = np.clip(np.searchsorted(edges, sizes, "right") - 1, 0, _BINS - 1)
    shown = np.array([one.row.defect["shown_mm"] >= SHOWN_MM for one in some])
    middle = [float(np.median(sizes[place == k])) for k in range(_BINS)]
    lines = {
        "shown: a lit stripe lies 1 mm deep in it": [float(shown[place == k].mean()) for k in range(_BINS)]
    }
    for name, of in dents.items():
        caught = np.array([one.caught for one in of])
        lines[name.replace("`", "")] = [float(caught[place == k].mean()) for k in range(_BINS)]
    curves(
        path,
        {name: list(zip(middle, shares, strict=True)) for name, shares in lines.items()},
        "extent of the dent along X where 1 mm or more is missing, in spacings of the stripes",
        "share of skeins with one dent",
    )
    rows = [
        [
            f"{edges[k]:.2f} to {edges[k + 1]:.2f}",
            str(int((place == k).sum())),
            *(f"{100.0 * shares[k]:.0f} %" for shares in lines.values()),
        ]
        for k in range(_BINS)
    ]
    return table(["extent, spacings", "skeins", *(name.split(":")[0] for name in lines)], rows)


def by_stripes(rows: Sequence[Row], path: Path) -> str:
    """Draw and write by how many stripes a defect would be shown."""
    kinds = {
        "one dent": [row for row in rows if row.kind == "dented" and row.defect["depth_mm"] >= SHOWN_MM],
        "several dents": [row for row in rows if row.kind == "several-dents"],
        "folded": [row for row in rows if row.kind == "folded"],
        "bent (its crease)": [row for row in rows if row.kind in ("bent", "s-bent")],
    }
    shares = {
        name: [float(np.mean([row.defect[f"shown_{n}_mm"] >= SHOWN_MM for row in of])) for n in STRIPES]
        for name, of in kinds.items()
        if of
    }
    curves(
        path,
        {f"{name} ({len(kinds[name])})": list(zip(STRIPES, of, strict=True)) for name, of in shares.items()},
        "stripes over the same width",
        "share of skeins of which a stripe shows 1 mm",
    )
    return table(
        ["stripes", *(f"{name} ({len(kinds[name])})" for name in shares)],
        [[str(n), *(f"{100.0 * of[k]:.0f} %" for of in shares.values())] for k, n in enumerate(STRIPES)],
    )


def weights(rows: Sequence[Row], path: Path) -> str:
    """Draw and write the error of the paper's weight, cause by cause."""
    weighed = [row for row in rows if "paper_g" in row.weight]
    parts = {c: 100.0 * np.array([row.weight[f"error: {c}"] for row in weighed]) for c in CAUSES}
    whole = np.sum(list(parts.values()), axis=0)
    ids = [str(row.seed) for row in weighed]
    lines = []
    for name, values in {**parts, "**all**": whole}.items():
        interval = Bootstrap(ids, 1).interval(values[:, None], mean_of)
        without = whole if name == "**all**" else whole - values
        low, high = np.quantile(values, (0.025, 0.975))
        lines.append(
            [
                name,
                f"{values.mean():+.1f} % ({interval.low:+.1f} to {interval.high:+.1f})",
                f"{values.std(ddof=1):.1f} %",
                f"{low:+.1f} to {high:+.1f} %",
                f"{without.std(ddof=1):.1f} %",
            ]
        )
    _bars(path, {**parts, "all": whole})
    summary = (
        f"All {len(weighed)} that were weighed: mean absolute error {np.abs(whole).mean():.1f} %, "
        f"from {whole.min():+.1f} % to {whole.max():+.1f} %. The paper's five had 9.3 %, from −12.0 % to "
        "+20.2 %.\n\n"
    )
    head = ["cause", "mean (95 %)", "standard deviation", "95 % of skeins", "spread of all without it"]
    return summary + table(head, lines)


def _bars(path: Path, parts: Mapping[str, np.ndarray]) -> None:
    """Draw each cause's middle 95 % as a line, its middle half as a box, its mean as a mark."""
    left, right, step = 120.0, 640.0, 30.0
    reach = [float(q) for values in parts.values() for q in np.quantile(values, (0.025, 0.975))]
    axis = svg.Axis.over(min(0.0, *reach), max(0.0, *reach), left, right)
    floor = 12.0 + step * len(parts)
    body = [_STYLE, svg.box(0.0, 0.0, 660.0, floor + 42.0, "ground")]
    for value, words in axis.ticks(8):
        body.append(svg.line(axis(value), 6.0, axis(value), floor, "axis" if value == 0 else "grid"))
        body.append(svg.text(axis(value), floor + 16.0, words))
    for k, (name, values) in enumerate(parts.items()):
        y = 12.0 + step * (k + 0.5)
        low, first, third, high = np.quantile(values, (0.025, 0.25, 0.75, 0.975)).tolist()
        colour = "#b3262c" if name == "all" else "#0d689c"
        body += [
            svg.text(left - 10.0, y + 4.0, name, "end"),
            svg.line(axis(low), y, axis(high), y, "axis"),
            svg.box(axis(first), y - 8.0, axis(third) - axis(first), 16.0, "part", "", colour),
            svg.dot(axis(float(values.mean())), y, "", f"{name}: mean {values.mean():+.1f} %", "#111", 3.5),
        ]
    body.append(svg.text(0.5 * (left + right), floor + 33.0, "part of the error of the weight, %"))
    drawn = svg.picture(body, floor + 42.0, "Error of the paper's weight by cause", width=660.0)
    path.write_text(
        str(drawn).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n", encoding="utf-8"
    )


_STYLE = Markup(
    "<style>text{font:12px system-ui,sans-serif;fill:#3c434c;text-anchor:middle}.end{text-anchor:end}"
    ".grid{stroke:#d9dee4;fill:none}.axis{stroke:#8a93a0;fill:none}.ground{fill:#fff}"
    ".part{fill-opacity:.45}</style>"
)
