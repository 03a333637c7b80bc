"""Fixtures that all tests share: one seed, drawn stripes, a small rig whose truth is known."""

from __future__ import annotations

import os

# Several processes share the cores: threads of the linear algebra in each would only wait for one another.
# It is read when numpy is imported. Processes that are started from here take it over.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from scipy.ndimage import gaussian_filter1d

from roemetry.records.calibration import Calibration
from roemetry.testing import LinearRig
from tests.browser import browser

__all__ = ["browser"]

SEED = 20260711
# What lands must depend neither on luck nor on what else the machine does;
# `--hypothesis-profile=explore` looks for cases nobody has seen.
settings.register_profile(
    "steady", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("explore", max_examples=500)
settings.load_profile("steady")
ROOT = Path(__file__).resolve().parent.parent


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each process whole files, so that fixtures and kernels are made once.

    pytest-xdist would deal the tests out by turns: every process would make the fixture of each file, and
    all would wait for the same kernels at once. (Work stealing was quicker at the end, and hung there.)
    """
    from xdist.scheduler import LoadFileScheduling

    if config.getvalue("dist") != "load":
        return None
    # the largest files first would compile the same kernels, both, at once
    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


@pytest.fixture
def rng() -> np.random.Generator:
    """The one source of randomness: same numbers in every run."""
    return np.random.default_rng(SEED)


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@dataclass(frozen=True)
class DrawnRig(LinearRig):
    """A linear rig of upright stripes: stripe i rests at `rest_px[i]` and moves by `px_per_mm` per mm."""

    rows: int = 240
    first_px: float = 40.0
    fan: float = 0.0
    background: float = 12.0

    @property
    def rest_px(self) -> np.ndarray:
        return self.first_px + self.spacing_px * np.arange(self.stripes)

    def x_px(self, height_mm: np.ndarray) -> np.ndarray:
        """(stripe, row) stripe centres over (stripe, row) heights."""
        return self.rest_px[:, None] + self.px_per_mm * height_mm

    def image(
        self, x_px: np.ndarray, rng: np.random.Generator | None = None, lens_px: float = 0.0
    ) -> np.ndarray:
        """Draw stripes, blurred from row to row as by a lens (standard deviation, px); NaN draws nothing."""
        light = self.light(x_px, 180.0)
        if lens_px:
            light = gaussian_filter1d(light, lens_px, axis=0)
        if rng is not None:
            light += rng.normal(0.0, 2.0, light.shape)
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)

    def dome(self, height_mm: float = 10.0, first: int = 70, last: int = 170) -> np.ndarray:
        """(stripe, row) heights of a dome over the inner stripes with a smooth rise from the belt."""
        along = np.clip((np.arange(self.rows) - first) / (last - first), 0.0, 1.0)
        across = np.sin(np.pi * np.arange(self.stripes) / (self.stripes - 1))
        return height_mm * across[:, None] * np.sin(np.pi * along)[None, :] ** 2

    def calibration(self) -> Calibration:
        """The true calibration, as of a block: without a view."""
        given = {"height_range_mm": (0.0, 25.0), "extractor": {"use": "dominant-peak"}, "view": None}
        return replace(LinearRig.calibration(self), **given)


@pytest.fixture
def rig() -> DrawnRig:
    """A small linear rig."""
    return DrawnRig()


@pytest.fixture
def line(tmp_path: Path, rig: DrawnRig) -> Callable[..., Path]:
    """Make a folder with a recipe, a calibration and images; gives the recipe's path."""

    def make(count: int = 3, text: str = "", calibrated: bool = True) -> Path:
        folder = tmp_path / "line"
        (folder / "images").mkdir(parents=True)
        for number in range(1, count + 1):
            image = rig.image(rig.x_px(rig.dome(height_mm=8.0 + number % 6)))
            cv2.imwrite(str(folder / "images" / f"p{number:02d}.png"), image)
        rig.calibration().save(folder / "calibration.yaml")
        recipe = text or (RECIPE if calibrated else RECIPE.replace("calibration: calibration.yaml\n", ""))
        (folder / "recipe.yaml").write_text(recipe, encoding="utf-8")
        return folder / "recipe.yaml"

    return make


RECIPE = """\
roemetry: 1
product: test dome
source:
  path: images
calibration: calibration.yaml
stages:
  extractor: {use: dominant-peak, options: {threshold: 60}}
  coder: window-tracking
  triangulator: block-linear
  volume: zero-order-hold
  weigher: density
  classifier: arc-curvature
sinks: [csv]
"""
