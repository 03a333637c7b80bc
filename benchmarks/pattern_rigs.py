"""``python -m benchmarks pattern_rigs``: dots and grids on fresh rigs, against their truth.

Each rig is drawn from the seed about that of `recipes/potato_dots` or `recipes/potato_grid`: projector, lean
and spacing of the pattern, camera, lens, noise, speckle, light. The ray-caster renders its boards, it is
calibrated from them as a user would, and products of every family are measured with the shipped recipe's
stages. Labels, centres and heights of single points, and volumes with their intervals are compared with the
truth. What is rendered is kept in a folder and used again.

    python -m benchmarks pattern_rigs --seed 1 --rigs 4 --count 3
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from typer.testing import CliRunner

from benchmarks.command import parser_of
from benchmarks.patterns import (
    DOTS,
    FAMILIES,
    GRID,
    LABEL_HEAD,
    NEAR_PX,
    PAGE,
    VOLUME_HEAD,
    Tally,
    rendered,
    tell,
)
from benchmarks.tables import table
from roemetry import Recipe
from roemetry.cli.main import app
from roemetry.config.scene import Scene
from roemetry.records import Simulated, StripeTruth, Trace
from roemetry.run.pipeline import Pipeline

RECIPES = {"grid": GRID, "dots": DOTS}


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, required=True, help="decides rigs and products")
    parser.add_argument("--rigs", type=int, default=4, help="rigs of each pattern")
    parser.add_argument("--count", type=int, default=3, help="products of each family on each rig")
    parser.add_argument("--patterns", default=",".join(RECIPES), help="with commas between")
    parser.add_argument(
        "--images", type=Path, default=Path("build/pattern_rigs"), help="folder of rendered images"
    )
    parser.add_argument("--write", action="store_true", help=f"write the tables of {PAGE}")
    given = parser.parse_args()
    labels, volumes = [], []
    for pattern in given.patterns.split(","):
        rigs = [Rig(pattern, given.seed, number, given.images) for number in range(given.rigs)]
        for family in FAMILIES:
            found, reached = Tally(f"{pattern}, {family}"), np.zeros(2, np.int64)
            for rig in rigs:
                for number in range(given.count):
                    item = rig.item(family, number)
                    trace = found.add(rig.pipeline(), item, f"{rig.name}-{family}-{number}")
                    reached += labelled_of_visible(trace, item.truth.stripes)
            of = f"{reached[0] / max(reached[1], 1):.2%} of {reached[1]}"
            labels.append([pattern, family, *found.label_cells(), of])
            volumes.append([pattern, family, *found.volume_cells()])
    parts = {
        "rigs-labels": table(["pattern", "product", *LABEL_HEAD, "right, of all lit and visible"], labels),
        "rigs-volumes": table(["pattern", "product", *VOLUME_HEAD], volumes),
    }
    tell(parts, PAGE if given.write else None)


def labelled_of_visible(trace: Trace, truth: StripeTruth | None) -> Any:
    """Count true points on products that have a peak with their label, and all of them, lit and visible.

    Where no peak is found (at rims, at crossings) none has one: the number says what image and stages lose
    together.
    """
    if truth is None or trace.peaks is None or trace.stripes is None:
        return np.array([0, 0 if truth is None else int(truth.on_product.sum())])
    families = [(trace.peaks, trace.stripes, truth)]
    if truth.across is not None:
        assert trace.peaks.across is not None and trace.stripes.across is not None
        families.append((trace.peaks.across, trace.stripes.across, truth.across))
    right = visible = 0
    for peaks, stripes, true in families:
        stripe, row = np.nonzero(true.on_product & np.isfinite(true.x_px))
        visible += stripe.size
        label = stripes.peak_stripe
        kept = np.flatnonzero((label >= 0) & np.isfinite(stripes.x_px[np.maximum(label, 0), peaks.row]))
        if peaks.dots is None:
            mine = np.full(true.x_px.shape, np.nan)
            mine[label[kept], peaks.row[kept]] = peaks.x_px[kept]
            right += int((np.abs(mine - true.x_px)[stripe, row] < NEAR_PX).sum())
            continue
        found = np.column_stack([peaks.x_px, peaks.dots.y_px])[kept]
        for one, at in zip(stripe, row, strict=True):
            own = found[label[kept] == one]
            place = true.x_px[one, at], true.y_px[one, at]
            right += bool(len(own) and np.linalg.norm(own - place, axis=1).min() < NEAR_PX)
    return np.array([right, visible])


class Rig:
    """A rig of dots or of a grid: its files, its calibration from boards, its products.

    Parameters
    ----------
    pattern
        `dots` or `grid`.
    seed, number
        Which rig.
    folder
        Of all rigs.
    """

    def __init__(self, pattern: str, seed: int, number: int, folder: Path) -> None:
        self.name = f"{pattern}-{seed}-{number}"
        self._pattern, self._folder = pattern, folder / self.name
        self._seed = 1000 * seed + 100 * number
        self._sets = drawn_rig(np.random.default_rng([seed, number, *pattern.encode()]), pattern)
        self._pipeline: Pipeline | None = None

    def pipeline(self) -> Pipeline:
        """Give the shipped recipe's stages with this rig's calibration, which is made if it is not there."""
        if self._pipeline is None:
            path = self._folder / "calibration.yaml"
            if not path.exists():
                self._calibrate()
            self._pipeline = Pipeline(
                Recipe.load(RECIPES[self._pattern], sets=[f"calibration={path.resolve()}"])
            )
        return self._pipeline

    def item(self, family: str, number: int) -> Simulated:
        """Render a product, or read it."""
        path = self._folder / f"{family}-{number}.pickle"
        return rendered(path, RECIPES[self._pattern], family, self._seed + 1, number, self._sets)

    def _calibrate(self) -> None:
        scene = Scene.load(RECIPES[self._pattern] / "simulated.yaml", sets=self._sets)
        frames = scene.make().calibration_frames(self._seed)
        for kind, pose, place in _board_images():
            path = self._folder / "calibration" / place
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), frames[kind][pose].pixels)
        for name in ("rig.yaml", "pattern.yaml"):
            shutil.copy(RECIPES[self._pattern] / name, self._folder)
        result = CliRunner().invoke(app, ["calibrate", str(self._folder / "rig.yaml")])
        print(f"{self.name}: {result.output}", flush=True)
        if result.exit_code:
            raise SystemExit(f"{self.name} cannot be calibrated")


def drawn_rig(rng: np.random.Generator, pattern: str) -> list[str]:
    """Draw what of the recipe's scene is changed, as `--set` takes it."""

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 5)

    camera = {
        "tilt_x_deg": between(-1.5, 1.5), "tilt_y_deg": between(-1.5, 1.5),
        "distance_mm": between(485.0, 520.0), "focal_length_mm": between(15.6, 16.2),
        "blur_sigma_px": between(0.4, 0.7), "read_noise_e": between(6.0, 25.0),
        "distortion": {"k1": between(-0.12, 0.05), "p1": between(-4e-4, 4e-4)},
    }  # fmt: skip
    speckle, light = between(0.05, 0.11), between(0.85, 1.05)
    if pattern == "dots":
        laser: dict[str, Any] = {
            "projector_mm": [between(78.0, 95.0), between(-8.0, 8.0), between(450.0, 500.0)],
            "yaw_deg": between(9.5, 12.5), "line_width_mm": between(1.5, 1.8),
        }  # fmt: skip
    else:
        laser = {
            "projector_mm": [between(66.0, 82.0), between(66.0, 82.0), between(450.0, 490.0)],
            "yaw_deg": between(-1.5, 1.5), "line_width_mm": between(0.9, 1.1),
            "peak_e_per_ms": round(800.0 * light, 1),
        }  # fmt: skip
    laser |= {"speckle_contrast": speckle, "waist_distance_mm": laser["projector_mm"][2]}
    surface = {
        "albedo_laser": between(0.45, 0.6),
        "texture": between(0.03, 0.08),
        "gloss": between(0.0, 0.05),
    }
    return [
        f"simulator.options.{part}.{key}={json.dumps(value)}"
        for part, values in (("camera", camera), ("laser", laser), ("surface", surface))
        for key, value in values.items()
    ]


def _board_images() -> list[tuple[str, str, str]]:
    boards = [
        ("chessboard", f"pose_{k:02d}_{light}", f"chessboard/pose_{k:02d}_{light}.png")
        for k in range(1, 10)
        for light in ("laser", "plain")
    ]
    return [
        ("belt", "belt", "belt.png"),
        ("chessboard", "on_belt_plain", "chessboard/on_belt_plain.png"),
        *boards,
    ]
