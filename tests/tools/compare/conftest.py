"""A data set of drawn domes whose truth is made to give known figures."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.cli.main import main
from roemetry.config.dataset import DatasetWriter, Description, Item, save_stripes
from roemetry.config.recipe import Recipe
from roemetry.records import Acquisition, Frame, ProductTruth, StripeTruth
from roemetry.run.pipeline import Pipeline
from roemetry.stages.hookspecs import StageEntry
from roemetry.stages.registry import Registered, Registry, discover

sys.path.insert(0, str(Path(__file__).parent))


from comparing_lines import COUNT, Counting, Raising, Shifted


@pytest.fixture
def dataset(line: Callable[..., Path], rig: Any) -> Callable[..., Path]:
    """Make the line's folder a data set: true volume 1.1 times, mass 0.8 times what is measured."""

    def make(count: int = COUNT, half_turned: bool = False, quarter_turned: bool = False) -> Path:
        path = line(count)
        rig_heights = [8.0 + number % 6 for number in range(1, count + 1)]
        folder, pipeline = path.parent, Pipeline(Recipe.load(path))
        (folder / "truth").mkdir()
        writer = DatasetWriter(
            folder,
            Description(
                roemetry_dataset=1,
                name="drawn domes",
                licence="CC0-1.0",
                made_from={"seed": 7},
                turn_deg=90 if quarter_turned else 0,
            ),
        )
        for number, height in enumerate(rig_heights, start=1):
            image = cv2.imread(str(folder / "images" / f"p{number:02d}.png"), cv2.IMREAD_UNCHANGED)
            found = pipeline.trace(Acquisition("one", (Frame(image),))).products[0]
            assert found.volume is not None
            assert found.weight is not None
            heights = rig.dome(height_mm=height)
            x_px, on_product = rig.x_px(heights), heights > 0.3
            if half_turned:
                cv2.imwrite(str(folder / "images" / f"p{number:02d}.png"), image[::-1, ::-1])
                x_px, on_product = rig.columns - 1 - x_px[::-1, ::-1], on_product[::-1, ::-1]
            if quarter_turned:
                cv2.imwrite(str(folder / "images" / f"p{number:02d}.png"), np.rot90(image, -1))
            name = f"truth/p{number:02d}.npz"
            save_stripes(folder / name, StripeTruth(x_px, on_product, np.full((*x_px.shape, 3), np.nan)))
            measured = found.volume.visible_mm3.value
            true = ProductTruth(
                label="good" if number % 2 else "henkei",
                visible_mm3=1.1 * measured,
                mass_g=0.8 * found.weight.mass_g.value,
                figures={"seed": float(number)},
            )
            writer.add(Item(f"p{number:02d}", {"laser": f"images/p{number:02d}.png"}, {}, (true,), name))
        writer.close()
        return path

    return make


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """What is installed, and stages of this file."""
    module = ModuleType("stages_for_compare")
    found = discover()
    provider = found.stages[0].provider
    extra = []
    for kind, stage in (("extractor", Shifted), ("extractor", Counting), ("volume", Raising)):
        setattr(module, stage.__name__, stage)
        entry = StageEntry(kind, stage.__name__.lower(), f"{module.__name__}:{stage.__name__}", "", "")
        extra.append(Registered(entry, provider))
    missing = StageEntry("volume", "costly", "x:Y", "", "", requires=(("no_such_module", "pip install it"),))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return Registry((*found.stages, *extra, Registered(missing, provider)), ())


@pytest.fixture
def roemetry(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run the command line in this process; gives the exit code."""

    def run(*words: object) -> int:
        monkeypatch.setattr(sys, "argv", ["roemetry", "compare", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            main()
        return int(caught.value.code or 0)

    return run
