"""Coders against known truth: what they label, what they get wrong, where they break, how long they take.

``python -m benchmarks coding [--parts easy,breaking,…] [--skeins 1000] [--coders a,b] [--page FILE]``

Every part leaves its result as JSON in ``--results``, and every run writes the page anew from all results
that lie there; so parts can be measured one at a time, and one coder again without the others. Seeds begin at
``--first`` = 500000: these rigs and products were never used while coders were made.
"""

from __future__ import annotations

import json
import platform
import statistics
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.coded import (
    DAMAGES,
    KINDS,
    SHAPES,
    CodingRig,
    Crossings,
    Sample,
    Score,
    crossings_of,
    dense_rig,
    easy_rig,
    grown,
    in_view,
    sample_from,
    score,
    shape,
    skein,
    verdicts,
)
from benchmarks.coded.cases import CASES
from benchmarks.coded.literal import Literal
from benchmarks.command import parser_of
from benchmarks.pictures import Points, curves
from benchmarks.tables import table
from roemetry.errors import StageError
from roemetry.records import Frame, StripeMap
from roemetry.records.arrays import Integers
from roemetry.stages import Coder
from roemetry.stages.registry import discover
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions
from roemetry_simulate.render import Rig, Sensor, render
from roemetry_simulate.solid import Solid
from roemetry_simulate.surface import textured
from roemetry_tools.compare.stripes import nearest

LITERAL = "the paper to the letter"
VARIANTS = (LITERAL, "planes (margin_min: 0)")
"""Measured beside the coders with their default options."""

MARGINS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
"""Edges of the classes of margin."""
LIMITS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)

RIGS: dict[str, Callable[[int], CodingRig]] = {"easy": easy_rig, "dense": dense_rig}
SPECKLE = {"easy": 0.10, "dense": 0.20}
DISPLACEMENTS = (1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0)
GROWTHS = (1.0, 1.3, 1.6, 2.0, 2.5, 3.0)
_EACH = {"easy": ("none", "belt-one-side", "blobs"), "dense": ("none",)}
"""Damages that every skein gets, by rig; of the others each skein gets one."""
_ONE_SIDE = ("belt-below", "belt-above")
_KEEP_EVERY = 50
"""Scenes after which what was found so far is written."""

_TRACED = 1
"""Counts up when the tracing changes, so that kept scenes are not mixed with new ones."""

_BEGIN = "<!-- measured: `python -m benchmarks coding` writes from here to the end -->\n"
_WRONG_LOW = 1e-6
_DRAWN_MIN = 100

Coders = Mapping[str, Coder[Any]]


def main() -> None:
    """Measure the chosen parts and write the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}; or none")
    parser.add_argument("--coders", default="", help="names, as the page has them; default: all")
    parser.add_argument("--skeins", type=int, default=1000, help="skeins on each rig")
    parser.add_argument("--few", type=int, default=24, help="products for each point of the smaller parts")
    parser.add_argument("--first", type=int, default=500_000, help="first seed")
    folder = Path(tempfile.gettempdir()) / "roemetry-coding"
    parser.add_argument("--results", type=Path, default=folder, help="folder of results and of traced scenes")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/coding.md"))
    given = parser.parse_args()
    coders = coders_named([name for name in given.coders.split(",") if name])
    results = Results(given.results)
    for name in [] if given.parts == "none" else given.parts.split(","):
        if name not in PARTS:
            parser.error(f"there is no part `{name}`; there are {', '.join(PARTS)}")
        print(PARTS[name].title, flush=True)
        if name == "speed":
            speed(results, coders, given)
        else:
            measure(name, results, coders, given)
    write_page(results, given.page)
    print(f"written: {given.page}")


def coders_named(names: list[str]) -> Coders:
    """Make all coders and `VARIANTS`, or those of the names: ``name`` or ``name (option: value)``."""
    registry = discover()
    there = {stage.entry.name: stage for stage in registry.of_kind("coder")}
    # those that count without a calibration have no planes to be right or wrong about
    known = [name for name, stage in there.items() if not registry.load(stage).capabilities.relative_numbers]
    known += [name for name in VARIANTS if name == LITERAL or name.split(" (")[0] in there]
    found: dict[str, Coder[Any]] = {}
    for name in names or known:
        if name == LITERAL:
            found[name] = Literal()
            continue
        base, _, option = name.removesuffix(")").partition(" (")
        if base not in there:
            raise SystemExit(f"no coder is called {base}; there are {', '.join(known)}")
        cls = registry.load(there[base])
        key, _, value = option.partition(": ")
        found[name] = cls(cls.Options.model_validate({key: value} if option else {}))
    return found


class Results:
    """A folder of results, a JSON file a part, and of traced scenes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "traced").mkdir(parents=True, exist_ok=True)

    def of(self, part: str) -> dict[str, Any]:
        """Read a part's result; empty where it was not measured."""
        path = self.folder / f"{part}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def keep(self, part: str, coder: str, found: dict[str, Any], **about: int) -> None:
        """Write one coder's figures of a part beside those of the others."""
        known = self.of(part)
        stamp = {"date": time.strftime("%Y-%m-%d"), "machine": machine(), **about}
        known[coder] = {"about": stamp, **found}
        (self.folder / f"{part}.json").write_text(json.dumps(known, indent=1), encoding="utf-8")

    def traced(self, name: str, rig: CodingRig, make: Callable[..., Solid], *of: Any) -> Crossings:
        """Trace what `make` makes of the rest, or read it where it was traced before."""
        path = self.folder / "traced" / f"{name}-{_TRACED}.npz"
        if not path.exists():
            found = crossings_of(rig.camera, rig.laser, in_view(make(*of), rig))
            np.savez_compressed(path, **found._asdict())
        with np.load(path) as kept:
            return Crossings(**{key: kept[key] for key in Crossings._fields})


class Scene(NamedTuple):
    """A sample, the conditions that it counts under, and the group that its margins count in."""

    conditions: tuple[str, ...]
    group: str
    sample: Sample


@dataclass
class Tally:
    """Scores by condition, margins by group, and dead stripes that were named, of one coder."""

    scores: dict[str, Score] = field(default_factory=dict)
    margins: dict[str, Integers] = field(default_factory=dict)
    named: dict[str, int] = field(default_factory=dict)

    def add(self, coder: Coder[Any], scene: Scene) -> None:
        """Code a sample and count it."""
        stripes = answer(coder, scene.sample)
        for condition in scene.conditions:
            before = self.scores.get(condition, Score(products=0))
            self.scores[condition] = before + score(stripes, scene.sample)
            self.named.setdefault(condition, 0)
            self.named[condition] += scene.sample.dead.size > 0 and _named(stripes, scene.sample)
        if stripes is not None:
            counts = margins_of(stripes, scene.sample)
            self.margins[scene.group] = self.margins.get(scene.group, np.zeros_like(counts)) + counts

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "scores": {name: asdict(found) for name, found in self.scores.items()},
            "margins": {name: found.tolist() for name, found in self.margins.items()},
            "named": self.named,
        }


def answer(coder: Coder[Any], sample: Sample) -> StripeMap | None:
    """Code a sample; None where the coder refuses the whole frame."""
    try:
        return coder.code(sample.peaks, sample.calibration)
    except StageError:
        return None


def _named(stripes: StripeMap | None, sample: Sample) -> bool:
    """Say whether a `stripe-missing` reason holds every dead stripe's number."""
    reasons = () if stripes is None else stripes.reasons
    words = " ".join(one.text for one in reasons if one.code == "stripe-missing").replace(",", " ").split()
    return all(str(stripe + 1) in words for stripe in sample.dead)


def margins_of(stripes: StripeMap, sample: Sample) -> Integers:
    """Count labelled peaks by their margin: (class, all and wrong and on a product).

    The last class has no margin.
    """
    given, _ = verdicts(stripes, sample)
    peaks, true = sample.peaks, sample.crossings
    of = nearest(peaks.row, peaks.x_px, true.row, true.x_px)
    counted = (given >= 0) & (of >= 0)
    stripe, row = given[counted], peaks.row[counted]
    wrong = true.stripe[of[counted]] != stripe
    margin = stripes.margin[stripe, row]
    place = np.searchsorted(MARGINS, margin, side="right") - 1
    place = np.where(np.isnan(margin), len(MARGINS) - 1, np.clip(place, 0, len(MARGINS) - 2))
    counts = np.zeros((len(MARGINS), 3), np.int64)
    for column, mine in enumerate((np.ones_like(wrong), wrong, true.on_product[of[counted]])):
        np.add.at(counts, (place[mine], column), 1)
    return counts


def machine() -> str:
    """Say what this is measured on."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text(encoding="utf-8").splitlines() if about.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{(names or [platform.machine()])[0]}, Python {platform.python_version()}"


def measure(part: str, results: Results, coders: Coders, given: Namespace) -> None:
    """Take every coder through a part's scenes."""
    tallies = {coder: Tally() for coder in coders}
    done = 0

    def keep() -> None:
        for coder, tally in tallies.items():
            results.keep(part, coder, tally.as_dict(), scenes=done, first=given.first)

    for scene in PARTS[part].scenes(results, given):
        for coder, stage in coders.items():
            tallies[coder].add(stage, scene)
        done += 1
        if done % _KEEP_EVERY == 0:
            keep()
            print(f"  {done} scenes", flush=True)
    keep()


def _skeins(results: Results, given: Namespace, name: str) -> Iterator[Scene]:
    # one of the rest for each skein, so that the kinds do not go in step with the damages
    others = [one for one in (*DAMAGES, "belt-one-side") if one not in (*_EACH[name], *_ONE_SIDE)]
    for number in range(given.skeins):
        seed, kind = given.first + number, KINDS[number % len(KINDS)]
        rig, traced = _skein(results, name, seed, kind)
        for condition in (*_EACH[name], others[(number // len(KINDS)) % len(others)]):
            damage = DAMAGES[_ONE_SIDE[number % 2] if condition == "belt-one-side" else condition]
            kinds = (f"kind {kind}",) if condition == "none" else ()
            yield Scene((condition, *kinds), name, sample_from(rig, traced, damage, seed=seed))


def _skein(results: Results, name: str, seed: int, kind: str) -> tuple[CodingRig, Crossings]:
    rig = RIGS[name](seed)
    return rig, results.traced(f"{name}-{seed}", rig, skein, seed, kind)


def _breaking(results: Results, given: Namespace) -> Iterator[Scene]:
    for at, number in product(DISPLACEMENTS, range(given.few)):
        seed = given.first + 100_000 + number
        rig = easy_rig(seed, at, planes=min(max(round(11 * at / 1.3), 5), 31))
        traced = results.traced(f"spacing-{at:g}-{seed}", rig, skein, seed, KINDS[seed % len(KINDS)])
        yield Scene((f"spacing {at:g}",), "all", sample_from(rig, traced, seed=seed))
    for at, number in product(GROWTHS, range(given.few)):
        seed = given.first + 110_000 + number
        rig = replace(easy_rig(seed), height_range_mm=(-1.0, 26.0 * at))
        solid = skein(seed, KINDS[seed % len(KINDS)])
        traced = results.traced(f"height-{at:g}-{seed}", rig, grown, solid, at)
        yield Scene((f"height {at:g}",), "all", sample_from(rig, traced, seed=seed))


def _shapes(results: Results, given: Namespace) -> Iterator[Scene]:
    first = given.first + 200_000
    for name, form, seed in product(RIGS, SHAPES, range(first, first + given.few)):
        rig = RIGS[name](seed)
        traced = results.traced(f"{name}-{form}-{seed}", rig, shape, seed, form)
        yield Scene((f"{name} {form}",), "all", sample_from(rig, traced, seed=seed))


def _dead(results: Results, given: Namespace) -> Iterator[Scene]:
    for name, number in product(RIGS, range(2 * given.few)):
        seed = given.first + number
        rig, traced = _skein(results, name, seed, KINDS[number % len(KINDS)])
        yield Scene((name,), name, sample_from(rig, traced, DAMAGES["dead-stripe"], seed=seed + 7))


def _cases(results: Results, given: Namespace) -> Iterator[Scene]:
    for name, make in CASES.items():
        yield Scene((name.replace("_", " "),), "all", make())


def _images(results: Results, given: Namespace) -> Iterator[Scene]:
    extractor = DominantPeak(DominantPeakOptions(threshold=15, start="lowest"))
    for name, number in product(RIGS, range(given.few)):
        seed = given.first + 300_000 + number
        rig = RIGS[name](seed)
        lying = in_view(skein(seed, KINDS[number % len(KINDS)]), rig)
        crossings = results.traced(f"image-{name}-{seed}", rig, in_view, lying, rig)
        path = results.folder / "traced" / f"pixels-{name}-{seed}.npy"
        if not path.exists():
            sensor = replace(Sensor(), speckle_contrast=SPECKLE[name])
            surface = textured(seed, laser_albedo=(0.66, 0.53), plain_albedo=(0.34, 0.62), gloss=(0.0, 0.10))
            np.save(path, render(Rig(rig.camera, sensor, rig.laser), lying, surface, seed=seed))
        peaks = extractor.extract(Frame(np.load(path)))
        sample = Sample(peaks, crossings, rig.calibration(), np.empty(0, np.int64), np.nan)
        yield Scene((name,), name, sample)


def speed(results: Results, coders: Coders, given: Namespace) -> None:
    """Time of a frame on the processor, after warm-up, in turns, so that all coders meet the same load."""
    times: dict[str, dict[str, list[float]]] = {coder: {name: [] for name in RIGS} for coder in coders}
    for name in RIGS:
        samples = []
        for number in range(8):
            seed = given.first + number
            rig, traced = _skein(results, name, seed, KINDS[number % len(KINDS)])
            samples.append(sample_from(rig, traced, seed=seed))
        for turn, (coder, stage), sample in product(range(13), coders.items(), samples):
            begin = time.process_time()
            answer(stage, sample)
            if turn >= 2:
                times[coder][name].append(1e3 * (time.process_time() - begin))
    for coder, found in times.items():
        medians = {name: statistics.median(each) for name, each in found.items()}
        quick = {name: statistics.quantiles(each, n=20)[0] for name, each in found.items()}
        results.keep("speed", coder, {"median_ms": medians, "quick_ms": quick})


_RENDERED = "speckle (contrast 0.10 and 0.20), shot noise, gloss; `dominant-peak`, threshold 15"


class Part(NamedTuple):
    """A part of the benchmark: its heading on the page, and its scenes."""

    title: str
    scenes: Callable[[Results, Namespace], Iterator[Scene]]


PARTS: dict[str, Part] = {
    "easy": Part("Skeins, 11 stripes, displaced by up to 1.3 spacings", lambda r, g: _skeins(r, g, "easy")),
    "dense": Part("Skeins, 21 stripes, displaced by up to 2.5 spacings", lambda r, g: _skeins(r, g, "dense")),
    "breaking": Part("Limits: denser stripes, taller skeins", _breaking),
    "shapes": Part("Other shapes", _shapes),
    "dead": Part("A dead stripe", _dead),
    "cases": Part("Difficult scenes: those of the tests", _cases),
    "images": Part(f"Rendered images: {_RENDERED}", _images),
    "speed": Part("Time of a frame", lambda r, g: iter(())),
}
"""All parts, in the order of the page."""


def write_page(results: Results, page: Path) -> None:
    """Write the measured part of the page anew; what stands above its mark is written by people."""
    told = page.read_text(encoding="utf-8").split(_BEGIN)[0] if page.exists() else "# Coding\n\n"
    pictures = page.parent.parent / "images"
    parts = [_section(results, name) for name in PARTS if name != "speed"]
    parts += [_margins(results, pictures), _breaking_curves(results, pictures), _speed(results)]
    page.write_text(told + _BEGIN + "\n" + "\n".join(part for part in parts if part), encoding="utf-8")


_HEAD = [
    "scene", "coder", "products", "labelled", "wrong of labelled", "wrong points",
    "products with a run > 3 rows", "frames refused", "taken for belt", "false peaks numbered",
]  # fmt: skip


def _section(results: Results, part: str) -> str:
    """Write one line for each scene and coder."""
    found = results.of(part)
    conditions = dict.fromkeys(name for one in found.values() for name in one["scores"])
    rows = []
    for name in sorted(conditions, key=lambda name: name.startswith("kind ")):
        for coder, one in found.items():
            if name in one["scores"]:
                figures = _figures(Score(**one["scores"][name]))
                named = [str(one["named"][name])] if part == "dead" else []
                rows.append([name, f"`{coder}`", *figures, *named])
    head = _HEAD + (["named"] if part == "dead" else [])
    return f"## {PARTS[part].title}\n{_about(found)}\n{table(head, rows)}" if rows else ""


def _figures(one: Score) -> list[str]:
    shared = f" ({one.shared} shared)" if one.shared else ""
    longest = f" (longest {one.longest_wrong_run})" if one.longest_wrong_run else ""
    return [
        str(one.products), _percent(one.labelled_share), _share(one.wrong_share), f"{one.wrong}{shared}",
        f"{one.products_wrong}{longest}", f"{one.frames_refused}", f"{one.as_belt}", f"{one.invented}",
    ]  # fmt: skip


def _margins(results: Results, pictures: Path) -> str:
    """Write and draw the share of wrong labels by margin, and what a limit to the margin leaves."""
    lines: dict[str, Points] = {}
    rows, limits = [], []
    names = [f"{low:g} – {min(high, 1.0):g}" for low, high in pairwise(MARGINS)] + ["not stated"]
    middles = [0.5 * (low + high) for low, high in pairwise(MARGINS)]
    found = [(rig, coder, one) for rig in RIGS for coder, one in results.of(rig).items()]
    for rig, coder, one in found:
        counts = one["margins"].get(rig, [])
        rows += [[rig, f"`{coder}`", name, f"{n}", f"{wrong}", _share(wrong / n)]
                 for name, (n, wrong, _) in zip(names, counts, strict=False) if n]  # fmt: skip
        stated = zip(middles, counts, strict=False)
        if points := [(at, wrong / n) for at, (n, wrong, _) in stated if n >= _DRAWN_MIN]:
            lines[f"{coder}, {rig}"] = points
            each = [Score(**found) for name, found in one["scores"].items() if not name.startswith("kind ")]
            there = sum(found.visible - found.unseen for found in each)
            for limit in LIMITS:
                left = counts[MARGINS.index(limit) : -1]
                n, wrong, on_product = (sum(column) for column in zip(*left, strict=True))
                cells = [_percent(on_product / max(there, 1)), _share(wrong / max(n, 1))]
                limits.append([rig, f"`{coder}`", f"{limit:g}", *cells])
    if lines:
        curves(pictures / "coding-margin.svg", lines, "stated margin", "share that is wrong", low=_WRONG_LOW)
    return "" if not rows else (
        "## Margin against error\n\nAll skeins and damages of the first two sections. Classes of "
        f"{_DRAWN_MIN} labels or more are drawn; those without a wrong label lie on the lower edge.\n\n"
        "![Share of wrong labels over the stated margin](../images/coding-margin.svg)\n\n"
        + table(["rig", "coder", "margin", "labelled", "wrong", "share"], rows)
        + "\nEffect of a limit on the margin, over all damages:\n\n"
        + table(["rig", "coder", "labels below this refused", "labelled", "wrong of labelled"], limits)
    )  # fmt: skip


def _breaking_curves(results: Results, pictures: Path) -> str:
    """Draw shares labelled and wrong over spacing and height."""
    found, said = results.of("breaking"), ""
    words = {"spacing": "displacement of a point 20 mm high, spacings", "height": "height, times"}
    for kind, across in words.items() if found else ():
        for what, low in (("labelled", None), ("wrong", 1e-5)):
            lines: dict[str, list[tuple[float, float]]] = {coder: [] for coder in found}
            for coder, one in found.items():
                for name, kept in one["scores"].items():
                    if name.startswith(kind):
                        share = getattr(Score(**kept), f"{what}_share")
                        lines[coder].append((float(name.split()[1]), share))
            curves(pictures / f"coding-{kind}-{what}.svg", lines, across, f"share {what}", low=low)
            said += f"![Share {what} over {across}](../images/coding-{kind}-{what}.svg)\n\n"
    return said


def _speed(results: Results) -> str:
    found = results.of("speed")
    if not found:
        return ""
    base = found.get("window-tracking", next(iter(found.values())))["median_ms"]
    rows = []
    for coder, one in found.items():
        times = [
            (one["median_ms"][rig], one["quick_ms"][rig], one["median_ms"][rig] / base[rig]) for rig in RIGS
        ]
        rows.append([f"`{coder}`", *(f"{value:.2f}" for of in times for value in of)])
    each = ["5 % quickest", "times window-tracking"]
    return (
        "## Time of a frame\n\n640 × 480, processor time of one thread, medians, coders alternating. "
        f"Times depend on the machine's load, ratios less.\n{_about(found)}\n"
        + table(["coder", "11 stripes, ms", *each, "21 stripes, ms", *each], rows)
    )


def _about(found: dict[str, Any]) -> str:
    """Say when, where and on what a part was measured; coders measured together are told together."""
    told: dict[str, list[str]] = {}
    for coder, one in found.items():
        about, words = one["about"], {"scenes": "scenes", "first": "first seed"}
        extra = [f"{word} {about[key]}" for key, word in words.items() if key in about]
        told.setdefault("; ".join([f"{about['date']}, {about['machine']}", *extra]), []).append(f"`{coder}`")
    return "".join(f"\n*{', '.join(coders)}: {said}.*\n" for said, coders in told.items())


def _share(value: float) -> str:
    """Write a share: per cent, or parts per million where that is easier to read."""
    if value == 0.0:
        return "0"
    return _percent(value) if value >= 1e-3 else f"{1e6 * value:.0f} ppm"


def _percent(value: float) -> str:
    return f"{100.0 * value:.2f} %"
