"""The parts of the coding benchmark."""

from __future__ import annotations

import statistics
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict, replace

from benchmarks.coded import (
    DAMAGES,
    KINDS,
    SHAPES,
    CodingRig,
    Sample,
    dense_rig,
    easy_rig,
    grown,
    sample_from,
    score,
    shape,
    skein,
)
from benchmarks.coded.cases import CASES
from benchmarks.coding_images import images
from benchmarks.coding_results import Coders, Results, Tally, answer

RIGS: dict[str, Callable[[int], CodingRig]] = {"easy": easy_rig, "dense": dense_rig}
DISPLACEMENTS = (1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0)
GROWTHS = (1.0, 1.3, 1.6, 2.0, 2.5, 3.0)
_EACH = {"easy": ("none", "belt-one-side", "blobs"), "dense": ("none",)}
"""Damages that every skein gets, by rig; of the others each skein gets one."""
_ONE_SIDE = ("belt-below", "belt-above")


def easy(results: Results, coders: Coders, given: Namespace) -> None:
    """Skeins of every kind on drawn rigs of 11 stripes, whole and damaged."""
    _skeins(results, coders, given, "easy")


def dense(results: Results, coders: Coders, given: Namespace) -> None:
    """Skeins of every kind on drawn rigs of 21 stripes, whole and damaged."""
    _skeins(results, coders, given, "dense")


def _skeins(results: Results, coders: Coders, given: Namespace, name: str) -> None:
    tallies = {coder: Tally() for coder in coders}
    # one of the rest for each skein, so that the kinds do not go in step with the damages
    others = [one for one in (*DAMAGES, "belt-one-side") if one not in (*_EACH[name], *_ONE_SIDE)]
    for number in range(given.skeins):
        seed = given.first + number
        kind = KINDS[number % len(KINDS)]
        rig = RIGS[name](seed)
        traced = results.traced(f"{name}-{seed}", rig, lambda s=seed, k=kind: skein(s, k))
        for condition in (*_EACH[name], others[(number // len(KINDS)) % len(others)]):
            damage = DAMAGES[_ONE_SIDE[number % 2] if condition == "belt-one-side" else condition]
            sample = sample_from(rig, traced, damage, seed=seed)
            for coder, stage in coders.items():
                tallies[coder].add(condition, name, stage, sample)
                if condition == "none":
                    tallies[coder].again(f"kind {kind}")
        if (number + 1) % 50 == 0 or number + 1 == given.skeins:
            about = {"products": number + 1, "first": given.first}
            for coder, tally in tallies.items():
                results.keep(f"skeins-{name}", coder, tally.as_dict(), about)
            print(f"  {name}: {number + 1} of {given.skeins}", flush=True)


def breaking(results: Results, coders: Coders, given: Namespace) -> None:
    """Spacing shrunk and height grown, until coding breaks."""
    tallies = {coder: Tally() for coder in coders}
    for wanted in DISPLACEMENTS:
        for number in range(given.few):
            seed = given.first + 100_000 + number
            planes = min(max(round(11 * wanted / 1.3), 5), 31)
            rig = easy_rig(seed, wanted, planes=planes)
            name = f"spacing-{wanted:g}-{seed}"
            traced = results.traced(name, rig, lambda s=seed: skein(s, KINDS[s % len(KINDS)]))
            _all(tallies, coders, f"spacing {wanted:g}", sample_from(rig, traced, seed=seed))
        print(f"  displacement {wanted:g}", flush=True)
    for factor in GROWTHS:
        for number in range(given.few):
            seed = given.first + 110_000 + number
            rig = easy_rig(seed)
            rig = replace(rig, height_range_mm=(-1.0, 26.0 * factor))
            name = f"height-{factor:g}-{seed}"
            traced = results.traced(
                name, rig, lambda s=seed, f=factor: grown(skein(s, KINDS[s % len(KINDS)]), f)
            )
            _all(tallies, coders, f"height {factor:g}", sample_from(rig, traced, seed=seed))
        print(f"  height × {factor:g}", flush=True)
    for coder, tally in tallies.items():
        results.keep("breaking", coder, tally.as_dict(), {"each": given.few, "first": given.first + 100_000})


def shapes(results: Results, coders: Coders, given: Namespace) -> None:
    """Wedge, ball, cylinder, block and potato."""
    tallies = {coder: Tally() for coder in coders}
    for name, make in RIGS.items():
        for form in SHAPES:
            for number in range(given.few):
                seed = given.first + 200_000 + number
                rig = make(seed)
                traced = results.traced(f"{name}-{form}-{seed}", rig, lambda s=seed, f=form: shape(s, f))
                _all(tallies, coders, f"{name} {form}", sample_from(rig, traced, seed=seed))
            print(f"  {name} {form}", flush=True)
    for coder, tally in tallies.items():
        results.keep("shapes", coder, tally.as_dict(), {"each": given.few, "first": given.first + 200_000})


def dead(results: Results, coders: Coders, given: Namespace) -> None:
    """A stripe without light: is it noticed and named, and what does it cost the others."""
    found = {coder: {name: {"frames": 0, "named": 0} for name in RIGS} for coder in coders}
    tallies = {coder: Tally() for coder in coders}
    for name, make in RIGS.items():
        for number in range(2 * given.few):
            seed = given.first + number
            rig = make(seed)
            kind = KINDS[number % len(KINDS)]
            traced = results.traced(f"{name}-{seed}", rig, lambda s=seed, k=kind: skein(s, k))
            sample = sample_from(rig, traced, DAMAGES["dead-stripe"], seed=seed + 7)
            for coder, stage in coders.items():
                tallies[coder].add(name, name, stage, sample)
                stripes = answer(stage, sample)
                said = (
                    ""
                    if stripes is None
                    else " ".join(
                        reason.text for reason in stripes.reasons if reason.code == "stripe-missing"
                    )
                )
                found[coder][name]["frames"] += 1
                words = said.replace(",", " ").split()
                found[coder][name]["named"] += all(str(stripe + 1) in words for stripe in sample.dead)
    for coder, tally in tallies.items():
        about = {"each": 2 * given.few, "first": given.first}
        results.keep("dead", coder, {**tally.as_dict(), "named": found[coder]}, about)


def cases(results: Results, coders: Coders, given: Namespace) -> None:
    """The scenes that are known to be hard."""
    samples = {name: make() for name, make in CASES.items()}
    for coder, stage in coders.items():
        scores = {name: asdict(score(answer(stage, sample), sample)) for name, sample in samples.items()}
        results.keep("cases", coder, {"scores": scores}, {})


def speed(results: Results, coders: Coders, given: Namespace) -> None:
    """Time of a frame on the processor, after warm-up, in turns, so that all coders meet the same load."""
    times: dict[str, dict[str, list[float]]] = {coder: {name: [] for name in RIGS} for coder in coders}
    for name, make in RIGS.items():
        samples = []
        for number in range(8):
            seed = given.first + number
            rig = make(seed)
            traced = results.traced(
                f"{name}-{seed}", rig, lambda s=seed, n=number: skein(s, KINDS[n % len(KINDS)])
            )
            samples.append(sample_from(rig, traced, seed=seed))
        for turn in range(13):
            for coder, stage in coders.items():
                for sample in samples:
                    begin = time.process_time()
                    answer(stage, sample)
                    if turn >= 2:
                        times[coder][name].append(1e3 * (time.process_time() - begin))
    for coder, found in times.items():
        medians = {name: statistics.median(each) for name, each in found.items()}
        quick = {name: statistics.quantiles(each, n=20)[0] for name, each in found.items()}
        results.keep("speed", coder, {"median_ms": medians, "quick_ms": quick}, {})


PARTS: dict[str, Callable[[Results, Coders, Namespace], None]] = {
    "easy": easy,
    "dense": dense,
    "breaking": breaking,
    "shapes": shapes,
    "dead": dead,
    "cases": cases,
    "images": images,
    "speed": speed,
}
"""All parts, in the order of the page."""


def _all(tallies: dict[str, Tally], coders: Coders, condition: str, sample: Sample) -> None:
    for coder, stage in coders.items():
        tallies[coder].add(condition, "all", stage, sample)
