"""A data set of drawn domes whose truth is made to give known figures; stages that are wrong on purpose."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.config.dataset import DatasetWriter, Description, Item, save_stripes
from roemetry.config.recipe import Recipe
from roemetry.records import Acquisition, Frame, ProductTruth, StripeTruth
from roemetry.run.pipeline import Pipeline
from roemetry.stages.hookspecs import StageEntry
from roemetry.stages.registry import Registered, Registry, discover
from roemetry_paper.dominant_peak import DominantPeak
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.variants import make_variants
from tests.command import exit_code

COUNT = 3
"""Products of the data set."""


class Shifted(DominantPeak):
    """The paper's extractor, 0.3 px to the right."""

    def extract(self, frame):
        found = super().extract(frame)
        return replace(found, x_px=found.x_px + 0.3)


class Counting(DominantPeak):
    """Counts what it is asked for."""

    asked = 0

    def extract(self, frame):
        type(self).asked += 1
        return super().extract(frame)


class Raising(ZeroOrderHold):
    """Never works."""

    def estimate(self, product, *, rng=None):
        raise ZeroDivisionError("nothing to share")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """What is installed, the stages above, and one that lacks a module."""
    module, found = ModuleType("stages_for_compare"), discover()
    provider = found.stages[0].provider
    entries = [
        StageEntry("volume", "costly", "x:Y", "", "", requires=(("no_such_module", "pip install it"),))
    ]
    for kind, stage in (("extractor", Shifted), ("extractor", Counting), ("volume", Raising)):
        setattr(module, stage.__name__, stage)
        entries.append(
            StageEntry(kind, stage.__name__.lower(), f"{module.__name__}:{stage.__name__}", "", "")
        )
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return Registry((*found.stages, *(Registered(entry, provider) for entry in entries)), ())


@pytest.fixture
def compared(registry: Registry) -> Callable[..., tuple[Compared, ...]]:
    """Compare a recipe's variants on its own images."""

    def run(path: Path, *vary: str, sets: tuple[str, ...] = (), **more: Any) -> tuple[Compared, ...]:
        variants = make_variants(path, vary, sets=sets, registry=registry)
        return compare(variants, Data(variants[0].recipe), **more)

    return run


@pytest.fixture
def dataset(line: Callable[..., Path], rig: Any) -> Callable[..., Path]:
    """Make the line's folder a data set: true volume 1.1 times, mass 0.8 times what is measured."""

    def make(count: int = COUNT, turn_deg: int = 0) -> Path:
        path = line(count)
        folder, pipeline = path.parent, Pipeline(Recipe.load(path))
        (folder / "truth").mkdir()
        described = {"name": "drawn domes", "licence": "CC0-1.0", "made_from": {"seed": 7}}
        stored_deg = 90 if turn_deg == 90 else 0
        writer = DatasetWriter(folder, Description(roemetry_dataset=1, turn_deg=stored_deg, **described))
        for number in range(1, count + 1):
            file = folder / "images" / f"p{number:02d}.png"
            image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            found = pipeline.trace(Acquisition("one", (Frame(image),))).products[0]
            heights = rig.dome(height_mm=8.0 + number % 6)
            x_px, on_product = rig.x_px(heights), heights > 0.3
            if turn_deg == 180:
                x_px, on_product = rig.columns - 1 - x_px[::-1, ::-1], on_product[::-1, ::-1]
            cv2.imwrite(str(file), np.ascontiguousarray(np.rot90(image, -turn_deg // 90)))
            name = f"truth/p{number:02d}.npz"
            save_stripes(folder / name, StripeTruth(x_px, on_product, np.full((*x_px.shape, 3), np.nan)))
            true = ProductTruth(
                label="good" if number % 2 else "henkei",
                visible_mm3=1.1 * found.volume.visible_mm3.value,
                mass_g=0.8 * found.weight.mass_g.value,
                figures={"seed": float(number)},
            )
            writer.add(Item(file.stem, {"laser": f"images/{file.name}"}, {}, (true,), name))
        writer.close()
        if turn_deg:
            text = (
                (folder / "calibration.yaml")
                .read_text("utf-8")
                .replace("turn_deg: 0", f"turn_deg: {turn_deg}")
            )
            (folder / "calibration.yaml").write_text(text, "utf-8")
        return path

    return make


@pytest.fixture
def roemetry(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run the command line in this process; gives the exit code."""
    return partial(exit_code, monkeypatch, "compare")
