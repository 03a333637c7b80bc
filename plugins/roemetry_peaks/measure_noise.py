"""``python -m roemetry_peaks.measure_noise RECIPE --out noise.json``: a line's noise, once, from its images.

The stages keep nothing from frame to frame. What the noise of a line is, which would cost each frame half of
its time, is measured here and handed to the extractor as a file.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roemetry import Recipe
from roemetry.errors import DataError, RoemetryError
from roemetry.io.files import write_whole
from roemetry.records import Frame
from roemetry.run.pipeline import frame_of
from roemetry_peaks.maximum_likelihood import (
    MaximumLikelihood,
    MaximumLikelihoodOptions,
    estimated_noise,
    most_noise,
    products_of,
    starts,
)
from roemetry_peaks.searching import searched
from roemetry_peaks.speckle_noise import StripeNoise, noise_from

_PEAKS = 4000  # that are looked at in each frame


def main(words: Sequence[str] | None = None) -> int:
    """Measure, write, and say what was found."""
    parser = argparse.ArgumentParser(prog="python -m roemetry_peaks.measure_noise", description=__doc__)
    parser.add_argument("recipe", type=Path, help="recipe whose extractor is maximum-likelihood")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    parser.add_argument("--frames", type=int, default=10, help="images to look at, from the first on")
    given = parser.parse_args(words)
    try:
        frames, options = _frames(given.recipe, max(given.frames, 1))
        held = measured(frames, options)
        write_whole(given.out, json.dumps(held, indent=1) + "\n")
    except RoemetryError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    contrast = np.array(held["speckle_contrast"])
    print(  # noqa: T201
        f"{given.out}: {held['peaks']} peaks of {held['frames']} frames; read noise "
        f"{held['read_noise_grey']:.2f} grey levels, gain {held['gain_grey_per_electron']:.4f} grey levels "
        f"per electron, speckle contrast {contrast.min():.3f} to {contrast.max():.3f}"
    )
    return 0


def measured(frames: Sequence[Frame], options: MaximumLikelihoodOptions) -> dict[str, object]:
    """Measure the noise that frames of one line share; gives what the file holds.

    Raises
    ------
    DataError
        There is no frame, or no stripe in them, or they differ in size, turn or bit depth.
    """
    if not frames:
        raise DataError("there is no image to measure the noise from")
    alike = {(frame.size, frame.turn_deg, frame.bit_depth) for frame in frames}
    if len(alike) > 1:
        raise DataError(f"the images differ in size, turn or bit depth: {sorted(alike)}")
    options = options.model_copy(update={"noise": None, "speckle_contrast": "auto"})
    seen = [(*starts(frame, options), frame.highest) for frame in frames]
    seen = [(image, found, white) for image, found, white in seen if found.starts.row.size]
    if not seen:
        raise DataError("there is no stripe in the images", hint="is the laser on? See threshold")
    first = seen[0][1]
    noise: StripeNoise = estimated_noise(seen[0][0], seen[0][2], first)
    peaks = 0
    # twice, since residuals are weighed by the noise
    for _ in range(2):
        parts = [products_of(image, white, found, noise, _PEAKS) for image, found, white in seen]
        products, tile, contrast2 = (np.concatenate(part) for part in zip(*parts, strict=True))
        peaks = int((products[:, 2, 2] > 0.0).sum())
        noise = noise_from(
            products,
            tile,
            contrast2,
            variance=first.variance,
            gain=first.gain,
            rounding=first.rounding,
            most=most_noise(first, seen[0][2]),
        )
    frame = frames[0]
    return {
        "roemetry_noise": 1,
        "image_size": list(frame.size),
        "region": list(searched(frame, options.region)),
        "turn_deg": frame.turn_deg,
        "bit_depth": frame.bit_depth,
        "frames": len(frames),
        "peaks": peaks,
        "read_noise_grey": float(np.sqrt(max(noise.variance - first.rounding, 0.0))),
        "gain_grey_per_electron": noise.gain,
        "speckle_correlation": noise.correlation,
        "speckle_contrast": np.sqrt(noise.contrast2).round(5).tolist(),
    }


def _frames(path: Path, count: int) -> tuple[list[Frame], MaximumLikelihoodOptions]:
    """Read and prepare a recipe's first images as a run would."""
    recipe = Recipe.load(path)
    extractor = recipe.stages["extractor"].make()
    if not isinstance(extractor, MaximumLikelihood):
        raise DataError(
            f"{path}: the extractor is not maximum-likelihood", hint="only that one takes a noise file"
        )
    source = recipe.source.make()
    acquisitions = (source.read(reference) for reference in source.references(recipe.source_path)[:count])
    frames = [frame_of(recipe, acquisition) for acquisition in acquisitions]
    return frames, extractor.options


if __name__ == "__main__":
    sys.exit(main())
