"""The page about coding, from the benchmark's results."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.coded import SHAPES, Score
from benchmarks.coding_plots import curves
from benchmarks.coding_results import MARGINS, Results

_BEGIN = "<!-- measured: `python -m benchmarks coding` writes from here to the end -->\n"
_WRONG_LOW = 1e-6
_DRAWN_MIN = 100


def write_page(results: Results, page: Path) -> None:
    """Write the measured part of the page anew; what stands above its mark is written by people."""
    told = page.read_text(encoding="utf-8").split(_BEGIN)[0] if page.exists() else "# Coding\n\n"
    pictures = page.parent.parent / "images"
    parts = [
        _skeins(results, "easy", "Skeins, 11 stripes, displaced by up to 1.3 spacings"),
        _skeins(results, "dense", "Skeins, 21 stripes, displaced by up to 2.5 spacings"),
        _margin(results, pictures),
        _breaking(results, pictures),
        _shapes(results),
        _dead(results),
        _cases(results),
        _images(results),
        _speed(results),
    ]
    page.write_text(told + _BEGIN + "\n" + "\n".join(part for part in parts if part), encoding="utf-8")


def _skeins(results: Results, rig: str, title: str) -> str:
    found = results.of(f"skeins-{rig}")
    if not found:
        return ""
    conditions = dict.fromkeys(c for one in found.values() for c in one["scores"])
    damages = [c for c in conditions if not c.startswith("kind ")]
    kinds = [c for c in conditions if c.startswith("kind ")]

    def rows(of: list[str]) -> list[list[str]]:
        return [
            [condition.removeprefix("kind "), f"`{coder}`", *_figures(Score(**one["scores"][condition]))]
            for condition in of
            for coder, one in found.items()
            if condition in one["scores"]
        ]

    return (
        f"## {title}\n{_about(found)}\n"
        + _table(["damage", "coder", *_HEAD], rows(damages))
        + "\nBy the skein's defect, without damage to its peaks:\n\n"
        + _table(["defect", "coder", *_HEAD], rows(kinds))
    )


_HEAD = [
    "products", "labelled", "wrong of labelled", "wrong points", "products with a run > 3 rows",
    "frames refused", "taken for belt", "false peaks numbered",
]  # fmt: skip


def _figures(one: Score) -> list[str]:
    shared = f" ({one.shared} shared)" if one.shared else ""
    longest = f" (longest {one.longest_wrong_run})" if one.longest_wrong_run else ""
    return [
        str(one.products), _percent(one.labelled_share), _share(one.wrong_share), f"{one.wrong}{shared}",
        f"{one.products_wrong}{longest}", f"{one.frames_refused}", f"{one.as_belt}", f"{one.invented}",
    ]  # fmt: skip


def _margin(results: Results, pictures: Path) -> str:
    lines: dict[str, list[tuple[float, float]]] = {}
    rows, limits = [], []
    for rig in ("easy", "dense"):
        for coder, one in results.of(f"skeins-{rig}").items():
            counts = one["margins"].get(rig)
            if counts is None:
                continue
            names = [f"{low:g} – {min(high, 1.0):g}" for low, high in pairwise(MARGINS)] + ["not stated"]
            for name, (n, wrong, _) in zip(names, counts, strict=True):
                if n:
                    rows.append([rig, f"`{coder}`", name, f"{n}", f"{wrong}", _share(wrong / n)])
            middles = [0.5 * (low + high) for low, high in pairwise(MARGINS)]
            stated = list(zip(middles, counts, strict=False))
            points = [(at, wrong / n) for at, (n, wrong, _) in stated if n >= _DRAWN_MIN]
            if points:
                lines[f"{coder}, {rig}"] = points
                limits += _limits(rig, coder, one["scores"], counts)
    if not rows:
        return ""
    if lines:
        curves(pictures / "coding-margin.svg", lines, "stated margin", "share that is wrong", low=_WRONG_LOW)
    return (
        "## Margin against error\nAll skeins and damages of the two sections above; classes of "
        f"{_DRAWN_MIN} labels or more are drawn, and what is never wrong stands on the floor.\n\n"
        "![Share of wrong labels over the stated margin](../images/coding-margin.svg)\n\n"
        + _table(["rig", "coder", "margin", "labelled", "wrong", "share"], rows)
        + "\nWhat a limit to the margin does, over all damages:\n\n"
        + _table(["rig", "coder", "labels below this refused", "labelled", "wrong of labelled"], limits)
    )


def _limits(rig: str, coder: str, scores: dict[str, Any], counts: list[list[int]]) -> list[list[str]]:
    """Give rows that say what is left with a limit, from the classes of margin."""
    each = [Score(**one) for name, one in scores.items() if not name.startswith("kind ")]
    there = sum(one.visible - one.unseen for one in each)
    rows = []
    for place, limit in enumerate(MARGINS[:-1]):
        if limit in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
            n, wrong, on_product = (sum(column) for column in zip(*counts[place:-1], strict=True))
            cells = [_percent(on_product / max(there, 1)), _share(wrong / max(n, 1))]
            rows.append([rig, f"`{coder}`", f"{limit:g}", *cells])
    return rows


def _breaking(results: Results, pictures: Path) -> str:
    found = results.of("breaking")
    if not found:
        return ""
    said = f"## Until it breaks\n{_about(found)}\n"
    words = {
        "spacing": (
            "displacement of a point 20 mm high, spacings",
            "Stripes are put closer, with more of them over the same width",
        ),
        "height": ("height of the skeins, times", "Skeins are made taller on the rig of 11 stripes"),
    }
    for kind, (across, how) in words.items():
        rows = []
        labelled: dict[str, list[tuple[float, float]]] = {}
        wrong: dict[str, list[tuple[float, float]]] = {}
        for coder, one in found.items():
            for condition, kept in one["scores"].items():
                if not condition.startswith(kind):
                    continue
                at, score = float(condition.split()[1]), Score(**kept)
                labelled.setdefault(coder, []).append((at, score.labelled_share))
                wrong.setdefault(coder, []).append((at, score.wrong_share))
                rows.append([f"{at:g}", f"`{coder}`", *_figures(score)])
        curves(pictures / f"coding-{kind}-labelled.svg", labelled, across, "share labelled")
        curves(pictures / f"coding-{kind}-wrong.svg", wrong, across, "share wrong", low=1e-5)
        rows.sort(key=lambda row: float(row[0]))
        said += (
            f"\n### {how}\n![Share labelled over {across}](../images/coding-{kind}-labelled.svg)\n\n"
            f"![Share wrong over {across}](../images/coding-{kind}-wrong.svg)\n\n"
            + _table([across, "coder", *_HEAD], rows)
        )
    return said


def _shapes(results: Results) -> str:
    found = results.of("shapes")
    if not found:
        return ""
    rows = [
        [rig, form, f"`{coder}`", *_figures(Score(**one["scores"][f"{rig} {form}"]))]
        for rig in ("easy", "dense")
        for form in SHAPES
        for coder, one in found.items()
    ]
    return f"## Other shapes\n{_about(found)}\n" + _table(["rig", "shape", "coder", *_HEAD], rows)


def _dead(results: Results) -> str:
    found = results.of("dead")
    if not found:
        return ""
    rows = [
        [rig, f"`{coder}`", f"{n['named']} of {n['frames']}", *_figures(Score(**one["scores"][rig]))]
        for rig in ("easy", "dense")
        for coder, one in found.items()
        for n in [one["named"][rig]]
    ]
    return (
        f"## A dead stripe\nNamed: a `stripe-missing` reason holds its number.\n{_about(found)}\n"
        + _table(["rig", "coder", "named", *_HEAD], rows)
    )


def _cases(results: Results) -> str:
    found = results.of("cases")
    if not found:
        return ""
    names = next(iter(found.values()))["scores"]
    rows = []
    for name in names:
        row = [name.replace("_", " ")]
        for one in found.values():
            kept = one["scores"].get(name)
            row.append("" if kept is None else _verdict(Score(**kept)))
        rows.append(row)
    return (
        "## Known to be hard\nShare of the product's points that is labelled, and wrong points. The scenes "
        f"are those of the tests.\n{_about(found)}\n"
        + _table(["case", *(f"`{coder}`" for coder in found)], rows)
    )


def _verdict(one: Score) -> str:
    if one.frames_refused:
        return "frame refused"
    labelled = f"{100.0 * one.labelled_share:.1f} %"
    return f"{labelled}, **{one.wrong} wrong**" if one.wrong else f"{labelled}, 0"


def _images(results: Results) -> str:
    found = results.of("images")
    if not found:
        return ""
    rows = [
        [rig, f"`{coder}`", *_figures(Score(**one["scores"][rig]))]
        for rig in ("easy", "dense")
        for coder, one in found.items()
    ]
    return (
        "## Rendered images\nThe same on images with speckle (contrast 0.10 and 0.20), shot noise and gloss, "
        f"peaks by `dominant-peak` (threshold 15).\n{_about(found)}\n"
        + _table(["rig", "coder", *_HEAD], rows)
    )


def _speed(results: Results) -> str:
    found = results.of("speed")
    if not found:
        return ""
    base = found.get("window-tracking", next(iter(found.values())))["median_ms"]
    rows = [
        [f"`{coder}`"]
        + [
            cell
            for rig in ("easy", "dense")
            for cell in (
                f"{one['median_ms'][rig]:.2f}", f"{one['quick_ms'][rig]:.2f}",
                f"{one['median_ms'][rig] / base[rig]:.2f}",
            )
        ]
        for coder, one in found.items()
    ]  # fmt: skip
    head = ["coder", "11 stripes, ms", "5 % quickest", "times window-tracking", "21 stripes, ms"]
    return (
        "## Time of a frame\n640 × 480, time on the processor, one thread, medians of frames coded in turns. "
        f"Milliseconds move with the load of the machine, ratios less.\n{_about(found)}\n"
        + _table([*head, "5 % quickest", "times window-tracking"], rows)
    )


def _about(found: dict[str, Any]) -> str:
    """Say when, where and on what a part was measured; coders measured together are told together."""
    told: dict[str, list[str]] = {}
    for coder, one in found.items():
        about = one["about"]
        numbers = {
            "products": "products", "each": "products a point", "first": "first seed",
        }  # fmt: skip
        extra = ", ".join(f"{words} {about[key]}" for key, words in numbers.items() if key in about)
        said = f"{about['date']}, {about['machine']}" + (f"; {extra}" if extra else "")
        told.setdefault(said, []).append(f"`{coder}`")
    return "".join(f"\n*{', '.join(coders)}: {said}.*\n" for said, coders in told.items())


def _share(value: float) -> str:
    """Write a share: per cent, or parts per million where that is easier to read."""
    if value == 0.0:
        return "0"
    return _percent(value) if value >= 1e-3 else f"{1e6 * value:.0f} ppm"


def _percent(value: float) -> str:
    return f"{100.0 * value:.2f} %"


def _table(head: list[str], rows: Iterable[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
