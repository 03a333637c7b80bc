"""What is compared: every registered extractor, and the peers that are installed."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.extraction import peers
from benchmarks.extraction.drawing import Found, Light
from roemetry.records import WIDE, Frame, Peaks, Sensor
from roemetry.stages import Extractor
from roemetry.stages.registry import discover

TOLD = {"dominant-peak": {"threshold": 30.0, "start": "lowest"}}
"""The paper's stage has a fixed threshold: it is told the one that suits these images."""
PEERS: dict[str, Callable[[NDArray[Any]], Found]] = {
    "the paper: fixed threshold": peers.numpy_runs,
    "the paper: local maxima": peers.numpy_maxima,
    "OpenCV blur + dilate + log-parabola": peers.opencv_log_parabola,
    "OpenCV blur + dilate + centre of gravity": peers.opencv_centre_of_gravity,
    "OpenCV Steger, vectorised": peers.opencv_steger,
    "numpy runs + centre of gravity": peers.numpy_run_centre_of_gravity,
    "scipy find_peaks + log-parabola": peers.scipy_log_parabola,
    "scipy find_peaks + centre of gravity": peers.scipy_centre_of_gravity,
    "C++, log-parabola of 5 pixels": peers.compiled(2, weighted=False),
    "C++, weighted Gaussian of 9 pixels": peers.compiled(4, weighted=True),
    "scikit-image Hessian": peers.skimage_hessian,
    "scikit-image sato": peers.skimage_sato,
    "ridge-detector": peers.ridge_detector,
}
PACKAGES = {
    "scikit-image Hessian": ("skimage", "pip install roemetry[benchmarks]"),
    "scikit-image sato": ("skimage", "pip install roemetry[benchmarks]"),
    "ridge-detector": ("ridge_detector", "pip install --no-deps ridge-detector imageio matplotlib"),
}
"""Module and remedy of the peers that must be installed; all are slow."""


@dataclass(frozen=True)
class Method:
    """A way to find peaks: `find` for pixels with what is known of the sensor (None: nothing)."""

    name: str
    ours: bool
    """Whether it is a registered extractor."""
    find: Callable[[NDArray[Any], Light | None], Found]
    slow: bool = False
    """Takes so long that it is tried on few images only."""


def methods(wanted: Sequence[str] = ()) -> tuple[list[Method], dict[str, str]]:
    """Give the methods (all, or those whose name holds one of the words), and why others are left out."""
    found, left_out = [], {}
    for name, each in (*_ours(), *_peers()):
        if wanted and not any(word in name for word in wanted):
            continue
        if isinstance(each, str):
            left_out[name] = each
        else:
            found.append(each)
    return found, left_out


def frame_of(pixels: NDArray[Any], light: Light | None) -> Frame:
    """Make the frame, with the sensor where it is known."""
    if light is None:
        return Frame(pixels)
    return Frame(pixels, sensor=Sensor(light.grey_per_electron, light.read_noise))


def found_in(peaks: Peaks) -> Found:
    """Take what a record holds; what it flags as wider than a stripe is not one."""
    stripe = peaks.flags & WIDE == 0
    return Found(peaks.row[stripe].astype(np.float64), peaks.x_px[stripe], peaks.x_std_px[stripe])


def extractors() -> Iterator[tuple[str, Extractor[Any] | str]]:
    """Make every registered extractor of lines, or say what it lacks."""
    registry = discover()
    for registered in registry.of_kind("extractor"):
        name = registered.entry.name
        if registered.missing is not None:
            yield name, registered.missing
        elif (cls := registry.load(registered)).capabilities.pattern == "lines":
            yield name, cls(cls.Options(**TOLD.get(name, {})))


def there(words: Sequence[str] = ()) -> Iterator[tuple[str, Extractor[Any]]]:
    """Make the extractors that can be used; with words, those whose name holds one."""
    for name, stage in extractors():
        if not isinstance(stage, str) and (not words or any(word in name for word in words)):
            yield name, stage


def _ours() -> Iterator[tuple[str, Method | str]]:
    def run(stage: Extractor[Any]) -> Callable[[NDArray[Any], Light | None], Found]:
        return lambda pixels, light: found_in(stage.extract(frame_of(pixels, light)))

    for name, stage in extractors():
        yield name, stage if isinstance(stage, str) else Method(name, True, run(stage))


def _peers() -> Iterator[tuple[str, Method | str]]:
    def plain(find: Callable[[NDArray[Any]], Found]) -> Callable[[NDArray[Any], Light | None], Found]:
        return lambda pixels, _: find(pixels)

    for name, find in PEERS.items():
        module, remedy = PACKAGES.get(name, ("", ""))
        if module and importlib.util.find_spec(module) is None:
            yield name, f"{module} is not installed: {remedy}"
        elif name.startswith("C++") and peers.COMPILER is None:
            yield name, "there is no C++ compiler"
        else:
            yield name, Method(name, False, plain(find), slow=bool(module))


def measured_beforehand(images: Callable[[tuple[int, int]], Sequence[Frame]]) -> Method:
    """Give maximum-likelihood as it runs on a line: the noise of that line's images measured once.

    `images` draws other images of an image size, which the noise is measured from at the first call.
    """
    from roemetry_peaks.maximum_likelihood import MaximumLikelihood, MaximumLikelihoodOptions
    from roemetry_peaks.measure_noise import measured

    folder = TemporaryDirectory()
    stages: dict[tuple[int, int], MaximumLikelihood] = {}

    def find(pixels: NDArray[Any], light: Light | None) -> Found:
        size = pixels.shape[0], pixels.shape[1]
        if size not in stages:
            path = Path(folder.name) / f"{size[0]}.json"
            held = measured(images(size), MaximumLikelihoodOptions())
            path.write_text(json.dumps(held), encoding="utf-8")
            stages[size] = MaximumLikelihood(MaximumLikelihoodOptions(noise=path))
        return found_in(stages[size].extract(frame_of(pixels, light)))

    return Method("maximum-likelihood, noise measured once", True, find)
