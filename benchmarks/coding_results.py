"""What the coding benchmark keeps: coders, scores added up, margins, and traced scenes."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.coded import CodingRig, Crossings, Sample, Score, crossings_of, score
from benchmarks.coded.products import in_view
from benchmarks.coded.scoring import verdicts
from roemetry.errors import StageError
from roemetry.records import StripeMap
from roemetry.stages import Coder
from roemetry.stages.registry import discover
from roemetry_simulate.solid import Solid
from roemetry_tools.compare.stripes import nearest

LITERAL = "window-tracking (belt: interruption)"
"""The paper to the letter, beside its safer reading."""

VARIANTS = (LITERAL, "planes (margin_min: 0)")
"""Measured beside the coders with their default options."""

MARGINS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
"""Edges of the classes of margin."""

_TRACED = 1
"""Counts up when the tracing changes, so that kept scenes are not mixed with new ones."""

Coders = dict[str, Coder[Any]]


def coders_named(names: list[str]) -> Coders:
    """Make all coders and `VARIANTS`, or those of the names: ``name`` or ``name (option: value)``."""
    registry = discover()
    there = {stage.entry.name: stage for stage in registry.of_kind("coder")}
    # those that count without a calibration have no planes to be right or wrong about
    known = [name for name, stage in there.items() if not registry.load(stage).capabilities.relative_numbers]
    known += [name for name in VARIANTS if name.split(" (")[0] in there]
    found: Coders = {}
    for name in names or known:
        base, _, option = name.removesuffix(")").partition(" (")
        if base not in there:
            raise SystemExit(f"no coder is called {base}; there are {', '.join(known)}")
        cls = registry.load(there[base])
        key, _, value = option.partition(": ")
        found[name] = cls(cls.Options.model_validate({key: value} if option else {}))
    return found


class Results:
    """A folder of results, a JSON file a part."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def of(self, part: str) -> dict[str, Any]:
        """Read a part's result; empty where it was not measured."""
        path = self.folder / f"{part}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def keep(self, part: str, coder: str, found: dict[str, Any], about: dict[str, Any]) -> None:
        """Write one coder's figures of a part beside those of the others."""
        known = self.of(part)
        stamp = {"date": time.strftime("%Y-%m-%d"), "machine": machine(), **about}
        known[coder] = {"about": stamp, **found}
        path = self.folder / f"{part}.json"
        path.write_text(json.dumps(known, indent=1), encoding="utf-8")

    def traced(self, name: str, rig: CodingRig, solid: Callable[[], Solid]) -> Crossings:
        """Trace a scene, or read it where it was traced before."""
        path = self.folder / "traced" / f"{name}-{_TRACED}.npz"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            found = crossings_of(rig.camera, rig.laser, in_view(solid(), rig))
            np.savez_compressed(path, **found._asdict())
        with np.load(path) as kept:
            return Crossings(**{key: kept[key] for key in Crossings._fields})


class Tally:
    """Scores by condition, and margins by rig, of one coder."""

    def __init__(self) -> None:
        self.scores: dict[str, Score] = {}
        self.margins: dict[str, NDArray[np.int64]] = {}
        self._last = Score(products=0)

    def add(self, condition: str, group: str, coder: Coder[Any], sample: Sample) -> None:
        """Code a sample and count it under a condition; its margins under a group."""
        stripes = answer(coder, sample)
        self._last = score(stripes, sample)
        self.again(condition)
        if stripes is not None:
            counts = margins_of(stripes, sample)
            self.margins[group] = self.margins.get(group, np.zeros_like(counts)) + counts

    def again(self, condition: str) -> None:
        """Count the last sample under another condition, too."""
        self.scores[condition] = self.scores.get(condition, Score(products=0)) + self._last

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "scores": {name: asdict(found) for name, found in self.scores.items()},
            "margins": {name: found.tolist() for name, found in self.margins.items()},
        }


def answer(coder: Coder[Any], sample: Sample) -> StripeMap | None:
    """Code a sample; None where the coder refuses the whole frame."""
    try:
        return coder.code(sample.peaks, sample.calibration)
    except StageError:
        return None


def margins_of(stripes: StripeMap, sample: Sample) -> NDArray[np.int64]:
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
    np.add.at(counts, (place, 0), 1)
    np.add.at(counts, (place[wrong], 1), 1)
    np.add.at(counts, (place[true.on_product[of[counted]]], 2), 1)
    return counts


def machine() -> str:
    """Say what this is measured on."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{name}, Python {platform.python_version()}"
