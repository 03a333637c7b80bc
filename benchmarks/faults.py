"""Disturbed images through recipes: how often a number lies, and how often harmless images are refused.

``python -m benchmarks faults RECIPE[=DATA]… [--cases 20000] [--record FILE] [--minutes 8] [--page FILE]
[--jobs 1] [--cluster ADDRESS]``

The data must state true volumes: a data set, or `truth.json` of a rendered rig beside the recipe; with
`--moved` scenes are rendered anew by both simulators with the rig moved. Each case takes one scene, one of
`DISTURBANCES` and a size. It is *held* (the true visible volume lies in the stated 95 % interval), *outside*
it, *gross* (beyond three half-widths), *not stated* or *refused*. Of a hundred undisturbed scenes up to five
may be outside, so what the disturbance is to blame for is said, too: a case outside is a *lie* where the same
scene undisturbed is not, or the volume moved by more than the half-width. Cases come in an order drawn at
random, so that a part of them is a sample of all; `--record` goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup

from benchmarks.command import add_sharing, keep, kept, parser_of, shared
from benchmarks.disturbances import (
    DISTURBANCES,
    MOTIONS,
    Disturbance,
    Image,
    Motion,
    Scene,
    disturbs,
    moved_scenes,
    of_frames,
)
from benchmarks.pictures import svg_file
from benchmarks.tables import table
from roemetry import Recipe
from roemetry.config.dataset import Dataset
from roemetry.errors import DataError, RoemetryError
from roemetry.html import plots as svg
from roemetry.records import Acquisition
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of

SEED = 20261124
NONE = "none"
KINDS: dict[str, Disturbance | Motion] = {**DISTURBANCES, **MOTIONS}
_VERDICTS = ("held", "outside", "gross", "not stated", "refused")
_GROSS = 3.0
_MUCH = 0.05


@dataclass(frozen=True)
class Case:
    """One measured scene, disturbed or not."""

    recipe: str
    scene: str
    disturbance: str
    size: float
    verdict: str
    error: float = math.nan
    half: float = math.nan
    """error, half: of the visible volume and of its interval, shares of the true volume."""
    grade: str = ""
    why: str = ""
    """Codes of the reasons of a refusal."""
    base_verdict: str = ""
    base_error: float = math.nan
    base_grade: str = ""
    """base_…: the same of the scene undisturbed."""

    @property
    def outside(self) -> bool:
        """Whether its interval does not hold the truth."""
        return self.verdict in ("outside", "gross")

    @property
    def lies(self) -> bool:
        """Whether the disturbance made a number whose interval does not hold the truth."""
        moved = not abs(self.error - self.base_error) <= self.half
        return self.outside and (self.base_verdict not in ("outside", "gross") or moved)


def main() -> None:
    """Measure what is asked for and print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("recipes", nargs="*", help="a recipe, or recipe=folder of a data set")
    parser.add_argument("--images", type=int, default=6, help="scenes of each recipe")
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", nargs="*", default=(), help="how names of disturbances begin")
    parser.add_argument("--moved", type=int, default=0, help="scenes with a moved rig, of each recipe's")
    parser.add_argument("--record", type=Path, help="file of cases, continued")
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after so many")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--curves", type=Path, help="SVG of size against error")
    add_sharing(parser)
    asked = parser.parse_args()
    until = time.monotonic() + 60.0 * asked.minutes
    found = [Case(**case) for case in kept(asked.record)]
    begun = len(found)
    try:
        for case in measured(asked, done=begun):
            found.append(case)
            keep(asked.record, asdict(case))
            if time.monotonic() > until:
                break
    except RoemetryError as error:
        raise SystemExit(str(error)) from error
    text = f"{verdicts(found)}\n{summary(found)}"
    print(text)
    print(f"{len(found) - begun} cases were new")
    if asked.page:
        asked.page.write_text(f"{text}\n", "utf-8")
    if asked.curves:
        draw(asked.curves, found)


def measured(asked: argparse.Namespace, done: int) -> Iterator[Case]:
    """Measure the cases that are asked for but the first `done`."""
    if not asked.recipes:  # the record as it is
        return
    if asked.moved:
        yield from _rendered(asked, done)
        return
    fixed = (asked.recipes, Path.cwd(), asked.images, asked.seed)
    names = [name for name in DISTURBANCES if not asked.only or name.startswith(tuple(asked.only))]
    drawn_cases = _shuffled(_Disturbed(*fixed).pairs(names), asked.cases, asked.seed)
    yield from shared(asked, _Disturbed, fixed, list(enumerate(drawn_cases))[done:])


def recipe_of(word: str, folder: Path) -> Recipe:
    """Load ``recipe`` or ``recipe=folder of a data set``, relative to a folder."""
    path, _, data = word.partition("=")
    recipe = Recipe.load(folder / path, sets=["uncertainty=linear"])
    if not data:
        return recipe
    if recipe.source.stage.gives == "lines":
        sets = [f"source.path={folder / data}/images"]
    else:
        sets = ["source.use=dataset", f"source.path={folder / data}", "source.options={}"]
        sensor = Dataset(folder / data).sensor  # images are measured as arrays, which say nothing of it
        if sensor is not None and recipe.sensor is None:
            sets.append(f"source.sensor={json.dumps(asdict(sensor))}")
    return Recipe.load(folder / path, sets=["uncertainty=linear", *sets])


class _Disturbed:
    """Disturbs and measures one case at a time."""

    def __init__(self, words: Sequence[str], folder: Path, images: int, seed: int) -> None:
        every = {word: recipe_of(word, folder) for word in words}
        self._recipes = {word: recipe for word, recipe in every.items() if "volume" in recipe.stages}
        for word in every.keys() - self._recipes.keys():
            print(f"{word}: it states no volume, so none can be wrong", file=sys.stderr)
        self._seed, self._scenes = seed, dict[str, list[Scene]]()
        for word, recipe in self._recipes.items():
            taken = list(scenes_of(recipe, images))
            self._scenes[word] = [scene._replace(other=taken[i - 1]) for i, scene in enumerate(taken)]
        self._base: dict[tuple[str, int], Case] = {}

    def pairs(self, names: Sequence[str]) -> list[tuple[tuple[str, int], str]]:
        """Recipes with the numbers of their scenes, each with what may disturb it."""
        return [
            ((word, k), name)
            for word, scenes in self._scenes.items()
            for k, scene in enumerate(scenes)
            for name in names
            if disturbs(name, scene)
        ]

    def __call__(self, task: tuple[int, tuple[tuple[str, int], str]]) -> Case:
        """Measure the disturbed scene beside the undisturbed one."""
        number, (place, name) = task
        word, k = place
        recipe, scene, kind = self._recipes[word], self._scenes[word][k], DISTURBANCES[name]
        if place not in self._base:
            self._base[place] = judged(recipe, scene, scene.laser, scene.plain)
        rng = np.random.default_rng([self._seed, number])
        size = float(np.exp(rng.uniform(np.log(kind.low), np.log(kind.high))))
        images = (
            kind.make(scene, size, rng)
            if scene.lines is None
            else of_frames(scene, name, size, [self._seed, number])
        )
        if "another" in name:
            scene = scene._replace(true_mm3=scene.shown_mm3(images[0]))
        return against(judged(recipe, scene, *images), self._base[place], word, name, size)


def _rendered(asked: argparse.Namespace, done: int) -> Iterator[Case]:
    """Measure scenes that are rendered with the rig moved."""
    number = 0
    for word in asked.recipes:
        recipe, base = recipe_of(word, Path.cwd()), None
        for moved in moved_scenes(recipe.path.parent / "scene.yaml", asked.moved, asked.seed):
            case = judged(recipe, moved.scene, moved.scene.laser, moved.scene.plain)
            number += 1
            if moved.motion == NONE:
                base = case
            elif base is not None and number > done:
                yield against(case, base, f"{word} {moved.maker}", moved.motion, moved.size)


def scenes_of(recipe: Recipe, count: int) -> Iterator[Scene]:
    """Give the first acquisitions of a recipe's data of which one product's visible volume is known."""
    source, folder = recipe.source.make(), recipe.path.parent
    if (folder / "truth.json").exists():
        bodies = json.loads((folder / "truth.json").read_text("utf-8"))["objects"]
        truths = {name: body["topview_volume_mm3"] for name, body in bodies.items()}
    else:
        near = (recipe.source_path, recipe.source_path.parent, folder)
        data = Dataset(next((one for one in near if (one / "dataset.yaml").exists()), folder))
        products = {item.id: data.truth(item).products for item in data.items()}
        truths = {name: one[0].visible_mm3 for name, one in products.items() if len(one) == 1}
    if not truths:
        raise DataError(
            f"{recipe.path}: no volume is stated of any of its scenes", hint="name a data set: recipe=folder"
        )
    for reference in source.references(recipe.source_path):
        if reference.id in truths and count > 0:
            count -= 1
            taken = source.read(reference)
            true_mm3, lines = truths[reference.id], taken.lines
            if lines is not None:
                frames = np.stack([lines.frame(line).pixels for line in range(len(lines.count))])
                yield Scene(reference.id, frames, None, true_mm3, lines=lines)
                continue
            laser, plain = taken.frame("laser"), taken.frame("plain")
            assert laser is not None
            yield Scene(reference.id, laser.pixels, plain and plain.pixels, true_mm3)


def judged(recipe: Recipe, scene: Scene, laser: Image, plain: Image | None) -> Case:
    """Measure images of a scene; what is said of the largest product against the truth."""
    if scene.lines is None:
        before = None if scene.other is None else scene.other.laser
        rows = recipe.measure(laser, plain=plain, before=before, name=scene.name)
    else:
        like = scene.lines.frame(0)
        depth = like.bit_depth if laser.dtype == like.pixels.dtype else 8 * laser.dtype.itemsize
        lines = replace(scene.lines, frame=lambda line: replace(like, pixels=laser[line], bit_depth=depth))
        trace = Pipeline(recipe).trace(Acquisition(scene.name, (), lines=lines))
        rows = measurements_of(trace, recipe, recipe.hashes)
    volumes = [(row, row.volume) for row in rows if row.volume is not None]
    case = Case(str(recipe.path), scene.name, NONE, 0.0, "refused")
    if not volumes:
        codes = {reason.code for row in rows for reason in (*row.absent.values(), *row.reasons)}
        return replace(case, why=" ".join(sorted(codes)))
    row, volume = max(volumes, key=lambda pair: pair[1].visible_mm3.value)
    low, high = volume.visible_mm3.interval
    error_mm3, half = volume.visible_mm3.value - scene.true_mm3, (high - low) / 2.0
    said = "held" if abs(error_mm3) <= half else "gross" if abs(error_mm3) > _GROSS * half else "outside"
    return replace(
        case, verdict=said if math.isfinite(half) else "not stated", error=error_mm3 / scene.true_mm3,
        half=half / scene.true_mm3, grade="" if row.grade is None else row.grade.label,
    )  # fmt: skip


def against(case: Case, base: Case, recipe: str, disturbance: str, size: float) -> Case:
    """Give a case its name and the undisturbed one beside it."""
    return replace(
        case, recipe=recipe, disturbance=disturbance, size=size, base_verdict=base.verdict,
        base_error=base.error, base_grade=base.grade,
    )  # fmt: skip


def verdicts(found: Sequence[Case]) -> str:
    """Write a line a disturbance: cases, verdicts, lies, and what was measured against the undisturbed."""
    by_name: dict[str, list[Case]] = defaultdict(list)
    for case in found:
        by_name[case.disturbance].append(case)
    rows = []
    for name in sorted(by_name, key=list(KINDS).index):
        cases, kind = by_name[name], KINDS[name]
        sizes = f"{kind.low:g}–{kind.high:g} {kind.unit}" if kind.unit else ""
        counts = [sum(case.verdict == said for case in cases) for said in _VERDICTS]
        counts.append(sum(case.lies for case in cases))
        held = [abs(case.error) for case in cases if case.verdict == "held"]
        largest = f"{max(held):.1%}" if held else "–"
        rows.append(
            [name, sizes, f"{len(cases)}", *map(str, counts), largest, f"{sum(map(_flipped, cases))}"]
        )
    last = ("lies", "largest error of the held", "grades right → wrong")
    return table(["disturbance", "sizes", "cases", *_VERDICTS, *last], rows)


def _flipped(case: Case) -> bool:
    """Say whether another class is told than of the undisturbed scene; `unknown` is none."""
    told = {case.grade, case.base_grade}
    return len(told) == 2 and not told & {"", "unknown"}


def harmless(case: Case) -> bool:
    """Say whether no stripe was harmed, and the undisturbed scene was measured."""
    return case.size <= KINDS[case.disturbance].harmless and case.base_verdict != "refused"


def summary(found: Iterable[Case]) -> str:
    """Say the shares of all cases that lie, and of the harmless ones that are refused."""
    found = list(found)
    mild = [case for case in found if harmless(case)]
    if not found or not mild:
        return "too few cases to sum up"

    def part(which: Iterable[bool]) -> str:
        return f"{sum(which) / len(found):.2%}"

    gross = [case for case in found if case.verdict == "gross"]
    bare = [case for case in found if case.verdict == "not stated"]
    moved = [case for case in bare if abs(case.error - case.base_error) > _MUCH]
    return (
        f"{len(found)} disturbed cases: {part(case.outside for case in found)} outside the interval, "
        f"{part(case.lies for case in found)} by the disturbance; beyond three half-widths "
        f"{len(gross) / len(found):.2%}, {part(case.lies for case in gross)} by the disturbance; "
        f"{part(case.verdict == 'refused' for case in found)} refused. Of {len(mild)} harmless "
        f"ones {sum(case.verdict == 'refused' for case in mild) / len(mild):.1%} refused, "
        f"{sum(map(_flipped, mild)) / len(mild):.1%} with another class. Of {len(bare)} numbers without an "
        f"interval {len(moved)} moved by more than {_MUCH:.0%}."
    )


def _shuffled(
    pairs: Sequence[tuple[tuple[str, int], str]], cases: int, seed: int
) -> Iterator[tuple[tuple[str, int], str]]:
    """Give pairs of place and name, each as often as any other, in an order drawn at random."""
    rng = np.random.default_rng([seed, 7])
    for _ in range(math.ceil(cases / len(pairs)) if pairs else 0):
        for k in rng.permutation(len(pairs))[:cases]:
            yield pairs[k]
            cases -= 1


# Size of disturbance against error: a panel for each, with every case, the interval, what is refused.

_STYLE = (
    "text{font:10px system-ui,sans-serif;fill:#3c434c;text-anchor:middle}"
    ".start{text-anchor:start}.end{text-anchor:end}.title{font-weight:600;text-anchor:start}"
    ".grid{stroke:#d9dee4;fill:none}.zero{stroke:#8a93a0;fill:none}.ground{fill:#fff}"
    ".interval{fill:#cfe3ef}.held{fill:#0d689c;fill-opacity:.55}.lie{fill:#d0453b}.refused{fill:#b9c0c9}"
)
_ACROSS, _WIDE, _HIGH, _LEFT = 3, 300.0, 168.0, 40.0
_BINS = 8
_FARTHEST = 0.06
"""Errors beyond stand at the panel's edge."""
_LEGEND = (
    "dots: error of the volume (red: outside its interval by the disturbance); blue: median interval "
    "(95 %); grey, from below: share refused"
)


def draw(path: Path, found: Sequence[Case]) -> None:
    """Draw a panel for each disturbance that has sizes and cases."""
    there = {case.disturbance for case in found}
    sized = [name for name, kind in KINDS.items() if kind.low < kind.high and name in there]
    high = 26.0 + _HIGH * math.ceil(len(sized) / _ACROSS)
    parts = [svg.text(8.0, 16.0, _LEGEND, "start")]
    for number, name in enumerate(sized):
        left, top = _WIDE * (number % _ACROSS), 26.0 + _HIGH * (number // _ACROSS)
        parts += _panel(name, [case for case in found if case.disturbance == name], left, top)
    label = "error of the volume over the size of each disturbance"
    svg_file(path, parts, (_ACROSS * _WIDE, high), label, _STYLE)


def _panel(name: str, cases: Sequence[Case], left: float, top: float) -> list[Markup]:
    kind = KINDS[name]
    low, high, right = math.log10(kind.low), math.log10(kind.high), left + _WIDE - 10.0
    x = svg.Axis(low, high, left + _LEFT, right)
    y = svg.Axis(-_FARTHEST, _FARTHEST, top + _HIGH - 34.0, top + 20.0)
    floor = y(-_FARTHEST)
    parts = [svg.text(left + 8.0, top + 12.0, name, "title")]
    for first, last in pairwise(np.linspace(low, high, _BINS + 1)):
        here = [case for case in cases if first <= math.log10(case.size) <= last]
        if halves := [case.half for case in here if math.isfinite(case.half)]:
            half, wide = min(float(np.median(halves)), _FARTHEST), x(last) - x(first) - 1.0
            parts.append(svg.box(x(first), y(half), wide, y(-half) - y(half), "interval"))
        if here:
            share = sum(case.verdict == "refused" for case in here) / len(here)
            tall = share * (floor - y(_FARTHEST))
            parts.append(svg.box(x(first), floor - tall, 4.0, tall, "refused", f"{share:.0%} refused"))
    for share, words in ((-0.05, "-5 %"), (0.0, "0"), (0.05, "+5 %")):
        line = "zero" if share == 0.0 else "grid"
        parts.append(svg.line(left + _LEFT, y(share), right, y(share), line))
        parts.append(svg.text(left + _LEFT - 4.0, y(share) + 4.0, words, "end"))
    for power in range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1):
        parts.append(svg.text(x(power), top + _HIGH - 20.0, f"{10.0**power:g}"))
    parts.append(svg.text(left + 0.5 * (_LEFT + _WIDE), top + _HIGH - 7.0, kind.unit))
    for case in sorted(cases, key=lambda case: case.lies):
        if math.isfinite(case.error):
            look, radius = ("lie", 2.6) if case.lies else ("held", 1.5)
            parts.append(svg.dot(x(math.log10(case.size)), y(case.error), look, "", "", radius))
    return parts
