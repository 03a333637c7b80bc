"""Disturbed images through recipes: how often a number lies, and how often harmless images are refused.

``python -m benchmarks faults RECIPE… [--images 3] [--only NAMES] [--page FILE]``

A recipe's own data must state true volumes (a data set, or `truth.json` of a rendered rig beside it). Every
image is disturbed in each way and size of `DISTURBANCES`; a case is *held* (the true visible volume lies
within the stated 95 % interval), *outside* it, *gross* (beyond three half-widths) or *refused*. The first
line has the same images undisturbed: a disturbance is to blame only for what that line does not show.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roemetry import Measurement, Recipe
from roemetry.config.dataset import Dataset

Image = NDArray[Any]
SEED = 20261123


class Scene(NamedTuple):
    """Images of one acquisition, as acquired, with what is true of it; `other` is another scene's."""

    name: str
    laser: Image
    plain: Image | None
    true_mm3: float
    other: Scene | None = None


Disturbance = Callable[[Scene], tuple[Image, Image | None]]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipes", nargs="+", type=Path)
    parser.add_argument("--images", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=(), help="names of disturbances")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    found: dict[str, list[tuple[str, float]]] = {}
    for path in asked.recipes:
        recipe = Recipe.load(path, sets=["uncertainty=linear"])
        scenes = list(scenes_of(recipe, asked.images))
        scenes = [scene._replace(other=scenes[i - 1]) for i, scene in enumerate(scenes)]
        for name, disturb in DISTURBANCES.items():
            if not asked.only or any(name.startswith(word) for word in asked.only):
                found.setdefault(name, []).extend(judged(recipe, scene, disturb) for scene in scenes)
                print(
                    f"{path}: {name}: {', '.join(said for said, _ in found[name][-len(scenes) :])}",
                    flush=True,
                )
    text = f"{table(found)}\n\n{summary(found)}"
    print(text)
    if asked.page:
        asked.page.write_text(f"{text}\n", "utf-8")


def scenes_of(recipe: Recipe, count: int) -> Iterator[Scene]:
    """Give the first acquisitions of a recipe's data of which one product's visible volume is known."""
    source, folder = recipe.source.make(), recipe.path.parent
    truths: dict[str, float] = {}
    if (folder / "truth.json").exists():
        bodies = json.loads((folder / "truth.json").read_text("utf-8"))["objects"]
        truths = {name: body["topview_volume_mm3"] for name, body in bodies.items()}
    else:
        data = Dataset(folder if (folder / "dataset.yaml").exists() else recipe.source_path)
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


def judged(recipe: Recipe, scene: Scene, disturb: Disturbance) -> tuple[str, float]:
    """Measure one disturbed scene; the verdict, and the relative error of the largest product, else NaN."""
    laser, plain = disturb(scene)
    rows = [row for row in recipe.measure(laser, plain=plain, name=scene.name) if row.volume is not None]
    if not rows:
        return "refused", np.nan
    volume = max(rows, key=_volume_mm3).volume
    assert volume is not None
    low, high = volume.visible_mm3.interval
    error_mm3 = volume.visible_mm3.value - scene.true_mm3
    half = (high - low) / 2.0
    said = "not stated" if not np.isfinite(half) else "held" if abs(error_mm3) <= half else "outside"
    return ("gross" if abs(error_mm3) > 3.0 * half else said), error_mm3 / scene.true_mm3


def table(found: dict[str, list[tuple[str, float]]]) -> str:
    """Write a line a disturbance: cases, verdicts, mean and largest error of what was measured."""
    lines = [
        "| disturbance | cases | held | outside | gross | not stated | refused | mean error | largest |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, cases in found.items():
        count = Counter(said for said, _ in cases)
        errors = np.array([error for _, error in cases if np.isfinite(error)])
        size = f"{errors.mean():+.2%} | {np.abs(errors).max():.2%}" if errors.size else "– | –"
        told = " | ".join(str(count[said]) for said in ("held", "outside", "gross", "not stated", "refused"))
        lines.append(f"| {name} | {len(cases)} | {told} | {size} |")
    return "\n".join(lines)


def summary(found: dict[str, list[tuple[str, float]]]) -> str:
    """Say the shares of all disturbed cases that lie, and of the harmless ones that are refused."""
    disturbed = [case for name, cases in found.items() if name != "none" for case in cases]
    harmless = [case for name in HARMLESS for case in found.get(name, ())]
    if not disturbed or not harmless:
        return "too few cases to sum up"
    count = Counter(said for said, _ in disturbed)
    refused = sum(said == "refused" for said, _ in harmless)
    return (
        f"{len(disturbed)} disturbed cases: {count['outside'] / len(disturbed):.2%} outside the interval, "
        f"{count['gross'] / len(disturbed):.2%} beyond three half-widths, "
        f"{count['refused'] / len(disturbed):.1%} refused; of {len(harmless)} harmless ones "
        f"{refused / len(harmless):.1%} refused"
    )


def _volume_mm3(row: Measurement) -> float:
    return 0.0 if row.volume is None else row.volume.visible_mm3.value


def _moved(
    image: Image, right: float = 0.0, down: float = 0.0, turn_deg: float = 0.0, scale: float = 1.0
) -> Image:
    rows, columns = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -turn_deg, scale)
    matrix[:, 2] += right, down
    how = {"flags": cv2.INTER_LANCZOS4, "borderMode": cv2.BORDER_REFLECT}
    return np.asarray(cv2.warpAffine(image, matrix, (columns, rows), **how))


def _camera(**motion: float) -> Disturbance:
    return lambda scene: (
        _moved(scene.laser, **motion),
        None if scene.plain is None else _moved(scene.plain, **motion),
    )


def _plain_alone(**motion: float) -> Disturbance:
    return lambda scene: (scene.laser, None if scene.plain is None else _moved(scene.plain, **motion))


def _both(change: Callable[[Image], Image]) -> Disturbance:
    return lambda scene: (change(scene.laser), None if scene.plain is None else change(scene.plain))


def _laser(change: Callable[[Image], Image]) -> Disturbance:
    return lambda scene: (change(scene.laser), scene.plain)


def _jpeg(quality: int) -> Callable[[Image], Image]:
    return lambda image: np.asarray(
        cv2.imdecode(
            cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_UNCHANGED
        )
    )


def _gamma(power: float) -> Callable[[Image], Image]:
    levels = np.rint(255.0 * (np.arange(256) / 255.0) ** power).astype(np.uint8)
    return lambda image: levels[image]


def _specks(share: float) -> Callable[[Image], Image]:
    def change(image: Image) -> Image:
        rng = np.random.default_rng(SEED)
        hit = rng.random(image.shape[:2])
        image = image.copy()
        image[hit < share / 2], image[hit > 1.0 - share / 2] = 0, 255
        return image

    return change


def _noise(std: float) -> Callable[[Image], Image]:
    return lambda image: np.clip(
        np.rint(image + np.random.default_rng(SEED).normal(0.0, std, image.shape)), 0, 255
    ).astype(np.uint8)


def _lost(image: Image, lines: int, axis: int) -> Image:
    """Lines lost in the middle: what follows moves up, the last ones stand twice."""
    middle = image.shape[axis] // 2
    kept = np.delete(image, np.s_[middle : middle + lines], axis)
    return np.concatenate([kept, np.take(image, range(-lines, 0), axis)], axis)


def _torn(image: Image, other: Image, axis: int) -> Image:
    middle = image.shape[axis] // 2
    return np.concatenate(
        [np.take(image, range(middle), axis), np.take(other, range(middle, image.shape[axis]), axis)], axis
    )


def _other_plain(scene: Scene) -> tuple[Image, Image | None]:
    return scene.laser, scene.plain if scene.other is None else scene.other.plain


DISTURBANCES: dict[str, Disturbance] = {
    "none": lambda scene: (scene.laser, scene.plain),
    **{f"camera right {px:g} px": _camera(right=px) for px in (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)},
    **{f"camera down {px:g} px": _camera(down=px) for px in (0.3, 1.0, 5.0)},
    **{
        f"camera turned {deg:g}°": _camera(turn_deg=deg) for deg in (0.05, 0.1, 0.2, -0.3, 0.4, 0.5, 1.0, 3.0)
    },
    **{f"camera scale {by:g}": _camera(scale=by) for by in (0.999, 1.002, 0.995, 0.985, 1.015, 1.05)},
    "camera all": _camera(right=0.4, down=0.5, turn_deg=0.15, scale=1.001),
    **{f"plain image right {px:g} px": _plain_alone(right=px) for px in (0.3, 1.0, 3.0, 10.0)},
    **{f"plain image scale {by:g}": _plain_alone(scale=by) for by in (0.995, 0.97, 1.03)},
    "plain image of another product": _other_plain,
    **{f"JPEG quality {quality}": _both(_jpeg(quality)) for quality in (95, 75, 40, 20)},
    **{f"gamma {power:g}": _both(_gamma(power)) for power in (0.8, 1.25, 2.0)},
    **{f"noise {std:g} grey levels": _both(_noise(std)) for std in (1.0, 4.0, 10.0)},
    **{f"specks {share:g}": _laser(_specks(share)) for share in (0.001, 0.01)},
    **{f"{lines} rows lost": _laser(lambda image, n=lines: _lost(image, n, 0)) for lines in (1, 5, 20)},
    **{f"{lines} columns lost": _laser(lambda image, n=lines: _lost(image, n, 1)) for lines in (1, 5, 20)},
    "lower half of another": lambda scene: (_torn(scene.laser, scene.other.laser, 0), scene.plain),
    "right half of another": lambda scene: (_torn(scene.laser, scene.other.laser, 1), scene.plain),
    "laser off": _laser(lambda image: np.minimum(image, np.median(image).astype(image.dtype))),
    "mirrored": _both(lambda image: np.ascontiguousarray(image[:, ::-1])),
    "upside down": _both(lambda image: np.ascontiguousarray(image[::-1])),
}

HARMLESS = ("camera right 0.03 px", "JPEG quality 95", "gamma 0.8", "gamma 1.25", "noise 1 grey levels")
"""Disturbances that no one would see in the stripes: a refusal of these is a false alarm."""


if __name__ == "__main__":
    main()
