"""The confirmation set: rendered images, a real extractor, and the same score."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.coded import KINDS, CodingRig, Sample, dense_rig, easy_rig, skein
from benchmarks.coded.products import in_view
from benchmarks.coding_results import Coders, Results, Tally
from roemetry.records import Frame
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions
from roemetry_simulate.render import Rig, Sensor, render
from roemetry_simulate.surface import textured

SPECKLE = {"easy": 0.10, "dense": 0.20}


def images(results: Results, coders: Coders, given: Namespace) -> None:
    """Rendered images of some of the skeins, with speckle, shot noise and gloss; peaks by `dominant-peak`."""
    tallies = {coder: Tally() for coder in coders}
    makers: dict[str, Callable[[int], CodingRig]] = {"easy": easy_rig, "dense": dense_rig}
    extractor = DominantPeak(DominantPeakOptions(threshold=15, start="lowest"))
    for name, make in makers.items():
        for number in range(given.few):
            seed = given.first + 300_000 + number
            rig = make(seed)
            pixels, crossings = _image(results, name, rig, seed, KINDS[number % len(KINDS)])
            peaks = extractor.extract(Frame(pixels))
            sample = Sample(peaks, crossings, rig.calibration(), np.empty(0, np.int64), np.nan)
            for coder, stage in coders.items():
                tallies[coder].add(name, name, stage, sample)
        print(f"  {name}", flush=True)
    for coder, tally in tallies.items():
        results.keep("images", coder, tally.as_dict(), {"each": given.few, "first": given.first + 300_000})


def _image(results: Results, name: str, rig: CodingRig, seed: int, kind: str) -> tuple[NDArray[Any], Any]:
    """Render an image, or read it where it was rendered before; and trace the scene."""
    lying = in_view(skein(seed, kind), rig)
    crossings = results.traced(f"image-{name}-{seed}", rig, lambda: lying)
    path = results.folder / "traced" / f"pixels-{name}-{seed}.npy"
    if not path.exists():
        sensor = replace(Sensor(), speckle_contrast=SPECKLE[name])
        surface = textured(seed, laser_albedo=(0.66, 0.53), plain_albedo=(0.34, 0.62), gloss=(0.0, 0.10))
        np.save(path, render(Rig(rig.camera, sensor, rig.laser), lying, surface, seed=seed))
    return np.load(path), crossings
