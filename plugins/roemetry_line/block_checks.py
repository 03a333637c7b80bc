"""A known block is measured while the line runs: a person asks, and the next frame is taken for it.

The frame shows the block and no product: it is kept as an image, measured by `check_calibration`, and what
came out goes into the control chart of the recipe or, where that names none, of the line. The next run then
begins, so that its rows carry what the check found.
"""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from roemetry.calibrating import QUANTITIES, Chart, Check, block_of, check_calibration
from roemetry.config.recipe import Recipe
from roemetry.errors import FAULTS, RoemetryError
from roemetry.io.files import make_folder, write_bytes
from roemetry.records import Acquisition, Frame, Trace
from roemetry_line.outbox import Outbox
from roemetry_line.runs import tiff_of

_FOLDER = "checks"
_LOOK_S = 0.25  # between two looks at whether the line stops
_FRAME_S = 60.0
"""How long a frame is waited for once a check is asked for, s; then a product's frame is not taken for it."""


def chart_of(recipe: Recipe, folder: Path, station: str) -> Chart:
    """Give the control chart that a station's checks are kept in."""
    return Chart(_chart_path(recipe, folder, station))


def _chart_path(recipe: Recipe, folder: Path, station: str) -> Path:
    asked = recipe.calibration_check
    if asked is not None and asked.chart:
        return recipe.path.parent / asked.chart
    return folder / _FOLDER / f"{station}.sqlite"


def summary_of(check: Check) -> str:
    """Say in one line what a check found."""
    lengths = ", ".join(
        f"{name.removesuffix('_mm')} not measured"
        if math.isnan(q.value)
        else f"{name.removesuffix('_mm')} {q.value:.3f} mm (expected {q.expected:.3f} ± {2 * q.std:.3f})"
        for name, q in ((name, check.quantity(name)) for name in QUANTITIES)
    )
    return f"{check.target} {check.verdict}: {lengths}"


class BlockChecks:
    """Waits until a check is asked for, takes a frame for it, and tells what it found."""

    def __init__(
        self,
        station: str,
        block: Path | None,
        folder: Path,
        outbox: Outbox,
        recipe: Callable[[], Recipe],
        told: Callable[[str, str], None],
    ) -> None:
        """Make it; `recipe` gives the one at work, `told` takes a verdict (`failed`: none) and a sentence."""
        self._station, self._block, self._folder = station, block, folder
        self._outbox, self._recipe, self._told = outbox, recipe, told
        self._frames: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._wanted = threading.Event()

    def takes(self, frame: Frame) -> bool:
        """Keep a frame for the check that was asked for; False where none was, and it shows a product."""
        if not self._wanted.is_set():
            return False
        self._wanted.clear()
        self._frames.put(frame)
        return True

    def run(self, stop: threading.Event) -> None:
        """Look for what is asked until told to stop."""
        while not stop.wait(_LOOK_S):
            try:
                check = self._outbox.last_check(self._station)
                if check is not None and check["ended"] is None:
                    verdict, said = self._checked(stop, check["asked"] + _FRAME_S)
                    self._outbox.end_check(check["n"], verdict, said)
                    self._told(verdict, said)
            except RoemetryError:  # a full disk, a recipe half edited: said elsewhere, and tried again
                continue

    def _checked(self, stop: threading.Event, until: float) -> tuple[str, str]:
        """Measure the next frame, if it comes by a time, s since 1970; after that it shows a product."""
        self._frames = queue.SimpleQueue()
        self._wanted.set()
        while not stop.is_set() and datetime.now(UTC).timestamp() < until:
            try:
                return self._measured(self._frames.get(timeout=_LOOK_S))
            except queue.Empty:
                continue
        self._wanted.clear()
        if stop.is_set():
            return "failed", "the check block was not measured: the line stopped"
        return "failed", f"the check block was not measured: no frame came within {_FRAME_S:g} s"

    def _measured(self, frame: Frame) -> tuple[str, str]:
        now = datetime.now(UTC)
        image = self._folder / _FOLDER / f"{self._station}-{now:%Y%m%dT%H%M%S.%fZ}.tif"
        try:
            make_folder(image.parent)
            write_bytes(image, tiff_of(frame.pixels))
            recipe = self._recipe()
            check = check_calibration(
                recipe,
                image,
                block_of(recipe, self._block),
                _chart_path(recipe, self._folder, self._station),
                Acquisition(image.stem, (frame,)),
            )
        # Whatever is before the camera, the line measures on.
        except FAULTS as error:
            said = error.message if isinstance(error, RoemetryError) else f"{type(error).__name__}: {error}"
            return "failed", f"the check block was not measured: {said}"
        return check.verdict, summary_of(check)


_FIRST = 20
"""Frames of a run whose mean light is what later frames are compared with."""
_DARK = 0.5
"""Less of that light than this is told: a dirty window or an ageing diode, before stripes are lost."""
_IN_A_ROW = 3
"""Frames: a hand before the camera is not told."""


class LaserHealth:
    """Follows the light of the stripes over the frames of a run."""

    def __init__(self) -> None:
        self.percent = math.nan
        """Median height of the last frame's peaks, % of white; 0 where none was found."""
        self._sum, self._count, self._dark = 0.0, 0, 0

    def look(self, trace: Trace | None) -> str | None:
        """Take a frame; say what is wrong with the laser, "" where it is well, None: not known."""
        if trace is None or trace.frame is None or trace.peaks is None:
            return None
        heights = trace.peaks.amplitude
        self.percent = 100.0 * float(np.median(heights)) / trace.frame.white if len(heights) else 0.0
        usual = self._sum / self._count if self._count else math.nan
        if self.percent > 0.0 and not self.percent < _DARK * usual:
            self._dark = 0
            if self._count < _FIRST:
                self._sum, self._count = self._sum + self.percent, self._count + 1
            return ""
        self._dark += 1
        if self._dark < _IN_A_ROW:
            return None
        if self.percent == 0.0:
            return "no stripe is seen: is the laser on, and its window clean?"
        now, before = f"{self.percent:.0f} %", f"{usual:.0f} %"
        return f"the stripes have {now} of white, {before} when the run began: is the window dirty?"
