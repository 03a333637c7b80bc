"""Damaged files through every reader: whatever is not our own error is a fault of ours.

``python -m benchmarks fuzz [--cases 10000] [--seed 1] [--keep FOLDER]``

A case takes one of the shipped files (recipe, rig, scene, calibration, classifier, record, image), damages
its bytes or its words one to four times (`damaged`), and hands it to what reads it; what can be read is used:
an image and a calibration are measured. Counted are crashes (any exception but `RoemetryError`), hangs (more
than `HANG_S` of processor time) and floods (more than `FLOOD_MB` of memory on top). Each is printed with its
seed, which makes the same file again; `--keep` writes it.
"""

from __future__ import annotations

import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.command import parser_of
from roemetry import Calibration, Measurement, Recipe, Rig, RoemetryError
from roemetry.config.scene import Scene
from roemetry.run.pipeline import Pipeline

HOME = Path("recipes/herring_roe")
HANG_S = 2.0
FLOOD_MB = 500.0

_WORDS = (
    b"&a [*a]", b"*a", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"!!python/object:os.system", b"{", b"]", b": ",
    b"nan", b".inf", b"-1", b"0", b"1e308", b"1e-308", b"99999999999999999999", b"true", b"null", b"~", b"''",
    b"[" * 3000, b"? " * 400, b"- " * 400, b"../" * 40, b"A" * 5000, b"\r", b"\t", b"\xe2\x80\xae",
)  # fmt: skip


class Target(NamedTuple):
    """A file that users write or cameras make, and what reads it."""

    name: str
    file: Path
    use: Callable[[Path], object]


class Fault(NamedTuple):
    """One case that went wrong, with the seed that makes it again."""

    seed: int
    target: str
    what: str


def main() -> None:
    """Run the cases and print what went wrong."""
    parser = parser_of(__doc__)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the files that went wrong")
    asked = parser.parse_args()
    faults = fuzzed(asked.cases, asked.seed, asked.keep)
    for fault in faults:
        print(f"seed {fault.seed}, {fault.target}: {fault.what}")
    print(f"{asked.cases} cases, {len(faults)} faults", dict(Counter(fault.target for fault in faults)))
    sys.exit(bool(faults))


def fuzzed(cases: int, seed: int, keep: Path | None = None) -> list[Fault]:
    """Run cases with consecutive seeds; what went wrong."""
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "recipes" / "product"
        shutil.copytree("calib_targets", Path(folder) / "calib_targets")
        shutil.copytree(HOME, home, ignore=shutil.ignore_patterns("comparison", "results*"))
        targets = targets_in(home)
        for target in targets:
            target.use(target.file)  # kernels are compiled before anything is timed
        for one in range(seed, seed + cases):
            target = targets[one % len(targets)]
            rng = np.random.default_rng(one)
            content = damaged(target.file.read_bytes(), rng)
            path = target.file.with_name(f"damaged_{target.file.name}")
            path.write_bytes(content)
            what = fault_of(target, path)
            if what:
                faults.append(Fault(one, target.name, what))
                if keep:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{one}_{target.file.name}").write_bytes(content)
    return faults


def fault_of(target: Target, path: Path) -> str:
    """Use a damaged file; what went wrong in doing so, "" for nothing."""
    before_mb, began = _peak_mb(), time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.use(path)
    except RoemetryError:
        pass
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {str(error)[:120]}"
    seconds, more_mb = time.process_time() - began, _peak_mb() - before_mb
    if seconds > HANG_S:
        return f"{seconds:.1f} s of processor time"
    return f"{more_mb:.0f} MB more memory" if more_mb > FLOOD_MB else ""


def targets_in(home: Path) -> list[Target]:
    """Give the files of a product line's folder with what reads each."""
    recipe = Recipe.load(home)
    image = home / "images" / "skein_01.png"
    pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    jpeg, tiff = home / "images" / "jpeg.jpg", home / "images" / "tiff.tif"
    cv2.imwrite(str(jpeg), pixels)
    cv2.imwrite(str(tiff), pixels)
    record = home / "record.jsonl"
    record.write_text(recipe.measure(pixels)[0].to_json(), "utf-8")
    pipeline = Pipeline(recipe)

    def measure_file(path: Path) -> object:
        source = recipe.source.make()
        return [pipeline.trace(source.read(one)) for one in source.references(path)]

    def measure_calibrated(path: Path) -> object:
        Calibration.load(path)
        sets = [f"calibration={path}"]
        return Recipe.load(home, sets=sets).measure(pixels)

    def read_rows(path: Path) -> object:
        return [Measurement.from_json(line) for line in path.read_text("utf-8", "replace").split("\n")]

    def classify(path: Path) -> object:
        sets = [f"stages.classifier.options.model={path}", "draws=0"]
        return Recipe.load(home / "with_outline.yaml", sets=sets).measure(pixels)

    return [
        Target("recipe", home / "recipe.yaml", Recipe.load),
        Target("recipe with outline", home / "with_outline.yaml", Recipe.load),
        Target("rig", home / "rig.yaml", Rig.load),
        Target("scene", home / "scene.yaml", Scene.load),
        Target("calibration", home / "calibration.yaml", measure_calibrated),
        Target("classifier", home / "classifier.json", classify),
        Target("record", record, read_rows),
        *(Target(path.suffix[1:].upper(), path, measure_file) for path in (image, jpeg, tiff)),
    ]


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes in one to four places: flipped, cut out, doubled, moved, overwritten by awkward words."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        first = int(rng.integers(len(data)))
        length = int(min(rng.geometric(0.02), len(data) - first))
        way = int(rng.integers(7))
        if way == 0:
            data[first] ^= 1 << int(rng.integers(8))
        elif way == 1:
            del data[first : first + length]
        elif way == 2:
            data[first:first] = data[first : first + length]
        elif way == 3:
            data[first:first] = _WORDS[int(rng.integers(len(_WORDS)))]
        elif way == 4:
            del data[first:]
        else:
            _replace_word(data, first, rng)
    return bytes(data)


def _replace_word(data: bytearray, first: int, rng: np.random.Generator) -> None:
    """Put an awkward word in the place of the word or number that stands at a byte."""
    inside = b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.-+"
    start = end = first
    while start > 0 and data[start - 1] in inside:
        start -= 1
    while end < len(data) and data[end] in inside:
        end += 1
    data[start:end] = _WORDS[int(rng.integers(len(_WORDS)))]


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
