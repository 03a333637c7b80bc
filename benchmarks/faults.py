"""Disturbed images through recipes: how often a number lies, and how often harmless images are refused.

``python -m benchmarks faults RECIPE[=DATA]… [--cases 20000] [--record FILE] [--minutes 8] [--page FILE]
[--jobs 1] [--cluster ADDRESS]``

The data must state true volumes: a data set, or `truth.json` of a rendered rig beside the recipe; with
`--moved` scenes are rendered anew by both simulators with the rig moved (`benchmarks.moved_rigs`). Each case
takes one scene, one of `DISTURBANCES` and a size. It is *held* (the true visible volume lies in the stated
95 % interval), *outside* it, *gross* (beyond three half-widths), *not stated* or *refused*. Of a hundred
undisturbed scenes up to five may be outside, so what the disturbance is to blame for is said, too: a case
outside is a *lie* where the same scene undisturbed is not, or the volume moved by more than the half-width.
Cases come in an order drawn at random, so that a part of them is a sample of all; `--record` goes on where it
stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import sharing
from benchmarks.disturbances import DISTURBANCES, Disturbance, Scene
from benchmarks.moved_rigs import MOTIONS, moved_scenes
from roemetry import Recipe
from roemetry.config.dataset import Dataset

SEED = 20261124
NONE = "none"
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
    def lies(self) -> bool:
        """Whether the disturbance made a number whose interval does not hold the truth."""
        moved = not abs(self.error - self.base_error) <= self.half
        return self.verdict in ("outside", "gross") and (
            self.base_verdict not in ("outside", "gross") or moved
        )


def main() -> None:
    """Measure what is asked for and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipes", nargs="*", help="a recipe, or recipe=folder of a data set")
    parser.add_argument("--images", type=int, default=6, help="scenes of each recipe")
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", nargs="*", default=(), help="how names of disturbances begin")
    parser.add_argument(
        "--moved", type=int, default=0, help="scenes with a moved rig, of each recipe's scene"
    )
    parser.add_argument("--record", type=Path, help="file of cases, continued")
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after so many")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--curves", type=Path, help="SVG of size against error")
    sharing.add_options(parser)
    asked = parser.parse_args()
    until = time.monotonic() + 60.0 * asked.minutes
    found = [] if asked.record is None else read(asked.record)
    begun = len(found)
    for case in measured(asked, done=begun):
        found.append(case)
        if asked.record is not None:
            with asked.record.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(case)) + "\n")
        if time.monotonic() > until:
            break
    text = f"{table(found)}\n\n{summary(found)}"
    print(text)
    print(f"{len(found) - begun} cases were new")
    if asked.page:
        asked.page.write_text(f"{text}\n", "utf-8")
    if asked.curves:
        from benchmarks.faults_curves import draw

        draw(asked.curves, found)


def measured(asked: argparse.Namespace, done: int) -> Iterator[Case]:
    """Measure the cases that are asked for but the first `done`."""
    if not asked.recipes:  # the record as it is
        return
    if asked.moved:
        yield from _rendered({word: recipe_of(word, Path.cwd()) for word in asked.recipes}, asked, done)
        return
    fixed = (asked.recipes, Path.cwd(), asked.images, asked.seed)
    names = [name for name in DISTURBANCES if _asked_for(name, asked.only)]
    drawn_cases = _shuffled(_Disturbed(*fixed).places, names, asked.cases, asked.seed)
    yield from sharing.shared(asked, _Disturbed, fixed, list(enumerate(drawn_cases))[done:])


def recipe_of(word: str, folder: Path) -> Recipe:
    """Load ``recipe`` or ``recipe=folder of a data set``, relative to a folder."""
    path, _, data = word.partition("=")
    sets = ["uncertainty=linear"]
    if data:
        sets += ["source.use=dataset", f"source.path={folder / data}", "source.options={}"]
    return Recipe.load(folder / path, sets=sets)


class _Disturbed:
    """Disturbs and measures one case at a time."""

    def __init__(self, words: Sequence[str], folder: Path, images: int, seed: int) -> None:
        self._recipes = {word: recipe_of(word, folder) for word in words}
        self._seed, self._scenes = seed, dict[str, list[Scene]]()
        for word, recipe in self._recipes.items():
            taken = list(scenes_of(recipe, images))
            self._scenes[word] = [scene._replace(other=taken[i - 1]) for i, scene in enumerate(taken)]
        self._base: dict[tuple[str, int], Case] = {}

    @property
    def places(self) -> list[tuple[str, int]]:
        """Recipes, each with the numbers of its scenes."""
        return [(word, k) for word, scenes in self._scenes.items() for k in range(len(scenes))]

    def __call__(self, task: tuple[int, tuple[tuple[str, int], str]]) -> Case:
        """Measure the disturbed scene beside the undisturbed one."""
        number, (place, name) = task
        word, k = place
        recipe, scene = self._recipes[word], self._scenes[word][k]
        if place not in self._base:
            self._base[place] = judged(recipe, scene, scene.laser, scene.plain)
        rng = np.random.default_rng([self._seed, number])
        size = drawn(DISTURBANCES[name], rng)
        images = DISTURBANCES[name].make(scene, size, rng)
        scene = scene._replace(true_mm3=scene.shown_mm3(images[0]))
        return against(judged(recipe, scene, *images), self._base[place], word, name, size)


def _rendered(recipes: Mapping[str, Recipe], asked: argparse.Namespace, done: int) -> Iterator[Case]:
    """Measure scenes that are rendered with the rig moved."""
    number = 0
    for word, recipe in recipes.items():
        base: Case | None = None
        for moved in moved_scenes(recipe.path.parent / "scene.yaml", asked.moved, asked.seed, done - number):
            case = judged(recipe, moved.scene, moved.scene.laser, moved.scene.plain)
            number += 1
            if moved.motion == NONE:
                base = case
            elif base is not None and number > done:
                yield against(case, base, f"{word} {moved.maker}", moved.motion, moved.size)


def drawn(disturbance: Disturbance, rng: np.random.Generator) -> float:
    """Draw a size, evenly over its logarithm."""
    return float(np.exp(rng.uniform(np.log(disturbance.low), np.log(disturbance.high))))


def scenes_of(recipe: Recipe, count: int) -> Iterator[Scene]:
    """Give the first acquisitions of a recipe's data of which one product's visible volume is known."""
    source, folder = recipe.source.make(), recipe.path.parent
    truths: dict[str, float] = {}
    if (folder / "truth.json").exists():
        bodies = json.loads((folder / "truth.json").read_text("utf-8"))["objects"]
        truths = {name: body["topview_volume_mm3"] for name, body in bodies.items()}
    else:
        own = (recipe.source_path / "dataset.yaml").exists()
        data = Dataset(recipe.source_path if own else folder)
        for item in data.items():
            products = data.truth(item).products
            if len(products) == 1:
                truths[item.id] = products[0].visible_mm3
    for reference in source.references(recipe.source_path):
        if reference.id in truths and count > 0:
            count -= 1
            taken = source.read(reference)
            laser, plain = taken.frame("laser"), taken.frame("plain")
            assert laser is not None
            yield Scene(reference.id, laser.pixels, plain and plain.pixels, truths[reference.id])


def judged(recipe: Recipe, scene: Scene, laser: NDArray[np.uint8], plain: NDArray[np.uint8] | None) -> Case:
    """Measure images of a scene; what is said of the largest product against the truth."""
    before = None if scene.other is None else scene.other.laser
    rows = recipe.measure(laser, plain=plain, before=before, name=scene.name)
    volumes = [(row, row.volume) for row in rows if row.volume is not None]
    if not volumes:
        codes = {reason.code for row in rows for reason in (*row.absent.values(), *row.reasons)}
        return Case(str(recipe.path), scene.name, NONE, 0.0, "refused", why=" ".join(sorted(codes)))
    row, volume = max(volumes, key=lambda pair: pair[1].visible_mm3.value)
    low, high = volume.visible_mm3.interval
    error_mm3, half = volume.visible_mm3.value - scene.true_mm3, (high - low) / 2.0
    said = "held" if abs(error_mm3) <= half else "gross" if abs(error_mm3) > _GROSS * half else "outside"
    return Case(
        str(recipe.path),
        scene.name,
        NONE,
        0.0,
        said if math.isfinite(half) else "not stated",
        error_mm3 / scene.true_mm3,
        half / scene.true_mm3,
        "" if row.grade is None else row.grade.label,
    )


def against(case: Case, base: Case, recipe: str, disturbance: str, size: float) -> Case:
    """Give a case its name and the undisturbed one beside it."""
    own = asdict(case) | {"recipe": recipe, "disturbance": disturbance, "size": size}
    own |= {"base_verdict": base.verdict, "base_error": base.error, "base_grade": base.grade}
    return Case(**own)


def table(found: Sequence[Case]) -> str:
    """Write a line a disturbance: cases, verdicts, lies, and what was measured against the undisturbed."""
    lines = [
        f"| disturbance | sizes | cases | {' | '.join(_VERDICTS)} | lies | largest error of the held | "
        "grades right → wrong |",
        "|---" * (6 + len(_VERDICTS)) + "|",
    ]
    by_name: dict[str, list[Case]] = defaultdict(list)
    for case in found:
        by_name[case.disturbance].append(case)
    for name in sorted(by_name, key=[*DISTURBANCES, *MOTIONS].index):
        cases, kind = by_name[name], DISTURBANCES.get(name) or MOTIONS[name]
        sizes = f"{kind.low:g}–{kind.high:g} {kind.unit}" if kind.unit else ""
        told = " | ".join(str(sum(case.verdict == said for case in cases)) for said in _VERDICTS)
        held = [abs(case.error) for case in cases if case.verdict == "held"]
        flips = sum(map(flipped, cases))
        lines.append(
            f"| {name} | {sizes} | {len(cases)} | {told} | {sum(case.lies for case in cases)} | "
            f"{f'{max(held):.1%}' if held else '–'} | {flips} |"
        )
    return "\n".join(lines)


def flipped(case: Case) -> bool:
    """Say whether another class is told than of the undisturbed scene; `unknown` is none."""
    told = {case.grade, case.base_grade}
    return len(told) == 2 and not told & {"", "unknown"}


def harmless(case: Case) -> bool:
    """Say whether no stripe was harmed, and the undisturbed scene was measured."""
    kind = DISTURBANCES.get(case.disturbance) or MOTIONS[case.disturbance]
    return case.size <= kind.harmless and case.base_verdict != "refused"


def summary(found: Iterable[Case]) -> str:
    """Say the shares of all cases that lie, and of the harmless ones that are refused."""
    found = list(found)
    mild = [case for case in found if harmless(case)]
    if not found or not mild:
        return "too few cases to sum up"

    def part(cases: list[Case]) -> str:
        return f"{len(cases) / len(found):.2%}"

    outside = [case for case in found if case.verdict in ("outside", "gross")]
    bare = [case for case in found if case.verdict == "not stated"]
    moved = [case for case in bare if abs(case.error - case.base_error) > _MUCH]
    return (
        f"{len(found)} disturbed cases: {part(outside)} outside the interval, "
        f"{part([case for case in found if case.lies])} by the disturbance; beyond three half-widths "
        f"{part([case for case in found if case.verdict == 'gross'])}, "
        f"{part([case for case in found if case.verdict == 'gross' and case.lies])} by the disturbance; "
        f"{part([case for case in found if case.verdict == 'refused'])} refused. Of {len(mild)} harmless "
        f"ones {sum(case.verdict == 'refused' for case in mild) / len(mild):.1%} refused, "
        f"{sum(map(flipped, mild)) / len(mild):.1%} with another class. Of {len(bare)} numbers without an "
        f"interval {len(moved)} moved by more than {_MUCH:.0%}."
    )


def read(path: Path) -> list[Case]:
    """Read a record of cases; one that is not there is empty."""
    if not path.exists():
        return []
    return [Case(**json.loads(line)) for line in path.read_text("utf-8").splitlines()]


def _asked_for(name: str, only: Sequence[str]) -> bool:
    return not only or any(name.startswith(word) for word in only)


def _shuffled(
    places: Sequence[tuple[str, int]], names: Sequence[str], cases: int, seed: int
) -> Iterator[tuple[tuple[str, int], str]]:
    """Give pairs of place and name, each as often as any other, in an order drawn at random."""
    rng, pairs = np.random.default_rng([seed, 7]), [(place, name) for place in places for name in names]
    for _ in range(math.ceil(cases / len(pairs))):
        for k in rng.permutation(len(pairs))[:cases]:
            yield pairs[k]
            cases -= 1


if __name__ == "__main__":
    main()
