"""The paper's experiment again, on six skeins and on 500: tables and figures of its page.

``python -m benchmarks paper_experiment [--count 500] [--cache DIR] [--page FILE]``

The six are the recipe's own images. The many are traced, not rendered: seeds from 80000, a rig each.
Classifiers with something to learn have learned from other seeds (see ``grade``).
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import parser_of
from benchmarks.grade import LEARN_FROM, MODEL
from benchmarks.grading.judges import (
    SHOWN_MM,
    Judged,
    confusion_of,
    fitted_limits,
    judged_by,
    judges_of,
    score_of,
)
from benchmarks.pictures import curves
from benchmarks.products import Row as Product
from benchmarks.products import rows as products_of
from benchmarks.tables import confusion, ends, put_into, share, table
from benchmarks.traced import BEST_OPTIONS, CAUSES, LEARNING_MIX, NAMED, STRIPES, Row, rows_of
from roemetry import Pipeline, Recipe
from roemetry.records import Peaks, StripeMap, Trace
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_tools.compare.agreement import Bootstrap, mean_of

FIRST = 80000
RECIPE = Path("recipes/herring_roe")
SIX = ("skein_01", "skein_03", "skein_05", "skein_06", "skein_07", "skein_10")
"""Good, dented, bent, twisted, folded, broken: one of each that the paper's five henkei may have been."""
KINDS = ("none", "dented", "several-dents", "bent", "s-bent", "twisted", "folded", "broken")

_FIRST_FIGURE = 17
_DRAWN = ("paper's rule", "paper's rule, best options", "`learned`")
_BINS = 5
_PANEL, _GAP_PX = (320, 240), 6
_SEEN, _BRIDGED = (255, 255, 255), (80, 160, 255)

Picture = NDArray[np.uint8]


def main() -> None:
    """Measure, and write the page's tables and figures."""
    parser = parser_of(__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--learn", type=int, default=750, help="skeins that limits are found on")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-traced")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/paper-experiment.md"))
    given = parser.parse_args()
    rows = rows_of(range(FIRST, FIRST + given.count), "recipe-like", given.cache)
    learning = range(LEARN_FROM["ours"], LEARN_FROM["ours"] + given.learn)
    limits = fitted_limits(rows_of(learning, "recipe-like", given.cache, mix=LEARNING_MIX))
    found = {name: judged_by(judge, rows) for name, judge in judges_of(MODEL, limits).items()}
    images = given.page.parent.parent / "images" / "paper"
    images.mkdir(parents=True, exist_ok=True)
    figures(images)
    put_into(
        given.page,
        {
            "table 1": table_1(),
            "good against deformed": good_against_deformed(found),
            "by kind": by_kind(found),
            "taken by `learned`": _taken(found["`learned`"]),
            "taken by `shape-limits`": _taken(found["`shape-limits`"]),
            "over spacing": over_spacing(found, images / "over-spacing.svg"),
            "by stripes": by_stripes(rows, images / "by-stripes.svg"),
            "weights": weights(rows),
        },
    )


def table_1() -> str:
    """Write the paper's Table 1, of the six."""
    recipe = Recipe.load(RECIPE)
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    six = [row for row in products_of(recipe, recipe.source_path) if row.id.split("#")[0] in SIX]
    errors = [100.0 * row.off("mass_g") for row in six]
    lines = [_line(row, error, best) for row, error in zip(six, errors, strict=True)]
    mean = sum(map(abs, errors)) / len(errors)
    lines.append(["mean absolute", "", "", "", "", f"{mean:.1f} %", "", ""])
    head = ["sample", "made", "true weight, g", "volume, cm³", "estimated weight, g", "error"]
    return table([*head, "paper's rule", "best options"], lines)


def _line(row: Product, error: float, best: ArcCurvature) -> list[str]:
    mass = row.estimate("mass_g")
    assert row.one is not None
    assert mass is not None
    return [
        row.id.split("#")[0], "good" if row.truth.defect == "none" else row.truth.defect,
        f"{row.truth.mass_g:.1f}", f"{row.visible_cm3:.2f}", f"{mass.value:.1f}", f"{error:+.1f} %", row.says,
        best.classify(row.one.product).label,
    ]  # fmt: skip


def figures(images: Path) -> None:
    """Draw the paper's Figures 17 to 22, of the six."""
    recipe = Recipe.load(RECIPE)
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    references = [one for one in source.references(recipe.source_path) if one.id in SIX]
    for number, reference in enumerate(references, start=_FIRST_FIGURE):
        drawn = panels(pipeline.trace(source.read(reference)))
        cv2.imwrite(str(images / f"figure-{number}.jpg"), drawn, [cv2.IMWRITE_JPEG_QUALITY, 82])


def panels(trace: Trace) -> Picture:
    """Draw the paper's four: image, dominant peaks, peaks over the image, curves after connection."""
    assert trace.frame is not None
    assert trace.peaks is not None
    assert trace.stripes is not None
    frame = trace.frame
    grey = (frame.pixels.astype(np.float64) * 255.0 / frame.white).round().astype(np.uint8)
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    black = np.zeros_like(image)
    over = cv2.addWeighted(image, 0.6, black, 0.4, 0.0)
    drawn = [
        cv2.resize(image, _PANEL, interpolation=cv2.INTER_AREA),
        _half(_dotted(black, trace.peaks, (255, 255, 255))),
        _half(_dotted(over, trace.peaks, (60, 220, 255))),
        _half(_connected(black, trace.stripes)),
    ]
    gap = np.full((_PANEL[1], _GAP_PX, 3), 255, np.uint8)
    return np.hstack([part for panel in drawn for part in (panel, gap)][:-1])


def _dotted(picture: Picture, peaks: Peaks, colour: tuple[int, int, int]) -> Picture:
    dotted = picture.copy()
    dotted[peaks.row, np.floor(peaks.x_px + 0.5).astype(np.int64)] = colour
    return dotted


def _connected(picture: Picture, stripes: StripeMap) -> Picture:
    drawn = picture.copy()
    on = stripes.product > 0
    for kind, colour in ((on & ~stripes.seen, _BRIDGED), (on & stripes.seen, _SEEN)):
        stripe, row = np.nonzero(kind & np.isfinite(stripes.x_px))
        drawn[row, np.floor(stripes.x_px[stripe, row] + 0.5).astype(np.int64)] = colour
    return drawn


def _half(picture: Picture) -> Picture:
    """Make it half as large; a dot stays a dot."""
    wide = cv2.dilate(picture, np.ones((2, 2), np.uint8))
    return np.asarray(wide[::2, ::2], np.uint8)


Found = Mapping[str, Sequence[Judged]]


def good_against_deformed(found: Found) -> str:
    """Write the balanced accuracies."""
    rows = []
    for name, judged in found.items():
        s = score_of(judged)
        all_of = 0.5 * (s.kept / max(s.good, 1) + s.caught_of_all / max(s.deformed, 1))
        balanced = f"{s.balanced:.3f} ({ends(s.balanced_interval)})"
        named = share(s.named, s.shown) if "paper" not in name else "does not name"
        rows.append([name, share(s.kept, s.good), share(s.caught, s.shown), balanced, f"{all_of:.3f}", named])
    head = ["classifier", "good kept", "caught, if shown", "balanced, if shown (95 %)"]
    return table([*head, "balanced, all", "named right"], rows)


def by_kind(found: Found) -> str:
    """Write, kind by kind, how many each classifier calls deformed."""
    rows = []
    for kind in KINDS:
        mine = {name: [one for one in judged if one.row.kind == kind] for name, judged in found.items()}
        some = next(iter(mine.values()))
        shown = "" if kind == "none" else str(sum(one.row.defect["shown_mm"] >= SHOWN_MM for one in some))
        cells = [_share([one.caught for one in of]) for of in mine.values()]
        rows.append(["good" if kind == "none" else kind, str(len(some)), shown, *cells])
    return table(["made", "skeins", "shown", *found], rows)


def _taken(judged: Sequence[Judged]) -> str:
    names = [*dict.fromkeys(NAMED.values()), "unknown"]
    return confusion(confusion_of(judged, by_kind=True), names, "made \\ called", ["good", *KINDS[1:]])


def over_spacing(found: Found, path: Path) -> str:
    """Draw and write the share of skeins with one dent that is caught, over its extent in spacings."""
    dents = {name: [one for one in found[name] if one.row.kind == "dented"] for name in _DRAWN}
    some = next(iter(dents.values()))
    sizes = np.array([one.row.defect["spacings"] for one in some])
    edges = np.quantile(sizes, np.linspace(0.0, 1.0, _BINS + 1))
    place = np.clip(np.searchsorted(edges, sizes, "right") - 1, 0, _BINS - 1)
    called = {"shown": np.array([one.row.defect["shown_mm"] >= SHOWN_MM for one in some])}
    called |= {name.replace("`", ""): np.array([one.caught for one in of]) for name, of in dents.items()}
    shares = {name: [float(of[place == k].mean()) for k in range(_BINS)] for name, of in called.items()}
    middle = [float(np.median(sizes[place == k])) for k in range(_BINS)]
    curves(
        path,
        {name: list(zip(middle, of, strict=True)) for name, of in shares.items()},
        "extent of the dent along X where 1 mm or more is missing, in spacings of the stripes",
        "share of skeins with one dent",
    )
    rows = [
        [f"{edges[k]:.2f} to {edges[k + 1]:.2f}", str(int((place == k).sum())),
         *(f"{100.0 * of[k]:.0f} %" for of in shares.values())]
        for k in range(_BINS)
    ]  # fmt: skip
    return table(["extent, spacings", "skeins", *shares], rows)


def by_stripes(rows: Sequence[Row], path: Path) -> str:
    """Draw and write by how many stripes a defect would be shown."""
    kinds = {
        "one dent": [row for row in rows if row.kind == "dented" and row.defect["depth_mm"] >= SHOWN_MM],
        "several dents": [row for row in rows if row.kind == "several-dents"],
        "folded": [row for row in rows if row.kind == "folded"],
        "bent (its crease)": [row for row in rows if row.kind in ("bent", "s-bent")],
    }
    shares = {
        f"{name} ({len(of)})": [
            float(np.mean([row.defect[f"shown_{n}_mm"] >= SHOWN_MM for row in of])) for n in STRIPES
        ]
        for name, of in kinds.items()
        if of
    }
    curves(
        path,
        {name: list(zip(STRIPES, of, strict=True)) for name, of in shares.items()},
        "stripes over the same width",
        "share of skeins of which a stripe shows 1 mm",
    )
    lines = [[str(n), *(f"{100.0 * of[k]:.0f} %" for of in shares.values())] for k, n in enumerate(STRIPES)]
    return table(["stripes", *shares], lines)


def weights(rows: Sequence[Row]) -> str:
    """Write the error of the paper's weight, cause by cause."""
    weighed = [row for row in rows if "paper_g" in row.weight]
    parts = {c: 100.0 * np.array([row.weight[f"error: {c}"] for row in weighed]) for c in CAUSES}
    whole = np.sum(list(parts.values()), axis=0)
    ids = [str(row.seed) for row in weighed]
    lines = []
    for name, values in {**parts, "**all**": whole}.items():
        interval = Bootstrap(ids, 1).interval(values[:, None], mean_of)
        without = whole if name == "**all**" else whole - values
        low, high = np.quantile(values, (0.025, 0.975))
        lines.append([
            name, f"{values.mean():+.1f} % ({interval.low:+.1f} to {interval.high:+.1f})",
            f"{values.std(ddof=1):.1f} %", f"{low:+.1f} to {high:+.1f} %", f"{without.std(ddof=1):.1f} %",
        ])  # fmt: skip
    head = ["cause", "mean (95 %)", "standard deviation", "95 % of skeins", "spread of all without it"]
    return (
        f"All {len(weighed)} weighed skeins: mean absolute error {np.abs(whole).mean():.1f} %, "
        f"from {whole.min():+.1f} % to {whole.max():+.1f} %.\n\n{table(head, lines)}"
    )


def _share(of: Sequence[bool]) -> str:
    return f"{100.0 * sum(of) / len(of):.0f} %" if of else "–"
