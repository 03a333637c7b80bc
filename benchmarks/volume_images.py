"""Volume from rendered images: extraction, coding, true planes, outline; nothing taken from the truth."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.volume_scenes import HERRING_ROE, calibration_of, skein
from roemetry.config.scene import Scene as SceneFile
from roemetry.errors import RoemetryError
from roemetry.io.files import write_whole
from roemetry.records import Frame, Outline, Product, Profiles, StripeMap, Volume
from roemetry.records.calibration import Calibration
from roemetry.run.monte_carlo import Chain, Drawn, Scene
from roemetry.run.open_parts import SHARE_MAX, open_parts
from roemetry.run.split_products import assemble
from roemetry.stages import StageOptions, Triangulator, VolumeEstimator
from roemetry_paper.window_tracking import WindowTracking
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_simulate import scene as scene_rig
from roemetry_simulate.render import render
from roemetry_volume.edge_contour import EdgeContour, EdgeContourOptions

_FUSING = "outline-surface"


class Pictured(NamedTuple):
    """One estimate from images, relative to the true visible volume.

    `std` is that of all draws, NaN where the estimator states none; `model_std` is the estimator's own.
    """

    seed: int
    estimator: str
    outline: str
    error: float
    std: float
    model_std: float
    defect: str
    true_share: float


class TruePlanes(Triangulator[StageOptions]):
    """Meets the rays of coded peaks with the planes of the calibration's view, which are the true ones."""

    Options = StageOptions

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give slices in the belt frame."""
        return lifted(stripes, calibration)


def image_rows(
    seeds: Sequence[int],
    cache: Path,
    estimators: Mapping[str, VolumeEstimator[Any]],
    *,
    draws: int,
    code: str,
    lights: Sequence[str] = ("plain", "laser"),
) -> tuple[list[Pictured], list[str]]:
    """Measure skeins from their images, with outlines in the light of each; also what was refused.

    What was measured with the same code, by its hash, is taken from the cache.
    """
    rows, refusals = [], []
    for seed in seeds:
        path = cache / f"{seed}_{code}_{draws}_{'_'.join(lights)}_{len(estimators)}.json"
        if not path.exists():
            write_whole(path, json.dumps(_of_one(seed, cache, estimators, draws, lights)))
        mine, refused = json.loads(path.read_text("utf-8"))
        rows += [Pictured(*row) for row in mine]
        refusals += refused
    return rows, refusals


def _of_one(
    seed: int,
    cache: Path,
    estimators: Mapping[str, VolumeEstimator[Any]],
    draws: int,
    lights: Sequence[str],
) -> tuple[list[Pictured], list[str]]:
    rig, drawn = skein(seed)
    calibration, truth = calibration_of(rig), drawn.solid
    laser, plain = images(seed, cache)
    rows, refusals = [], []
    for outline in lights:
        mine = estimators if outline == "plain" else {_FUSING: estimators[_FUSING]}
        try:
            stripes, contours = coded(laser, plain, calibration, outline)
            product = product_of(stripes, contours, calibration)
        except RoemetryError as error:
            if outline == "plain":
                refusals.append(f"{seed}: {str(error).splitlines()[0]}")
            continue
        found: dict[str, Volume] = {}
        for name, estimator in mine.items():
            try:
                found[name] = estimator.estimate(product)
            except RoemetryError as error:
                refusals.append(f"{seed}, `{name}`: {str(error).splitlines()[0]}")
        scene = Scene(str(seed), stripes, contours, calibration)
        stds = drawn_stds(mine, found, scene, draws, np.random.default_rng([seed, 7]))
        rows += [
            Pictured(
                seed,
                name,
                outline,
                volume.visible_mm3.value / truth.visible_volume_mm3 - 1.0,
                stds[name] / truth.visible_volume_mm3,
                volume.visible_mm3.std / truth.visible_volume_mm3,
                drawn.truth.defect,
                truth.true_volume_mm3 / truth.visible_volume_mm3,
            )
            for name, volume in found.items()
        ]
    return rows, refusals


def drawn_stds(
    estimators: Mapping[str, VolumeEstimator[Any]],
    found: Mapping[str, Volume],
    scene: Scene,
    draws: int,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Draw peaks, outline and each estimator's own error as a run does; all estimators on the same draws.

    NaN where the estimator does not state its error, or more than a twentieth of the draws are refused.
    """
    drawing = Drawn(scene, Chain(TruePlanes(), None, None, None), rng)
    stating = {name: estimators[name] for name in found if estimators[name].states_model_error}
    values: dict[str, list[float]] = {name: [] for name in stating}
    for products in drawing.scenes(draws, drawing.causes):
        for name, estimator in stating.items():
            try:
                drawn = estimator.redraw(products[1], found[name], rng=rng)
                values[name].append(drawn.visible_mm3.value)
            except (RoemetryError, KeyError):
                continue
    enough = 0.95 * draws
    return {
        name: float(np.std(values[name], ddof=1)) if len(values.get(name, ())) >= enough else math.nan
        for name in found
    }


def is_rendered(seed: int, cache: Path) -> bool:
    """Whether the cache holds a skein's images."""
    return (cache / f"{seed}_images.npz").exists()


def images(seed: int, cache: Path) -> tuple[Frame, Frame]:
    """Render a skein in laser and in plain light, or take both from the cache."""
    path = cache / f"{seed}_images.npz"
    if not path.exists():
        rig, drawn = skein(seed)
        scene = SceneFile.load(HERRING_ROE).simulator.options
        surface = scene_rig.surface_of(scene, seed)  # type: ignore[arg-type]
        kept = {
            name: render(rig, drawn.solid, surface, seed=seed, plain=name == "plain")
            for name in ("laser", "plain")
        }
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, **kept)
        part.replace(path)
    with np.load(path) as found:
        return Frame(found["laser"]), Frame(found["plain"], role="plain")


def measured(laser: Frame, plain: Frame, calibration: Calibration, outline: str) -> Product:
    """Take the images of one product through extraction, coding, true planes and outline."""
    stripes, contours = coded(laser, plain, calibration, outline)
    return product_of(stripes, contours, calibration)


def coded(
    laser: Frame, plain: Frame, calibration: Calibration, outline: str
) -> tuple[StripeMap, tuple[Outline, ...]]:
    """Extract, code, and look for the outline in the image that `outline` names."""
    peaks = MaximumLikelihood().extract(laser)
    stripes = WindowTracking().code(peaks, calibration)
    if any(part.share > SHARE_MAX for part in open_parts(peaks, stripes).values()):  # as a run has it
        raise RoemetryError("more than a third of the product's points could not be given to a stripe")
    outliner = EdgeContour(EdgeContourOptions(light="plain" if outline == "plain" else "laser"))
    return stripes, outliner.outline(laser, plain, stripes, calibration)


def product_of(stripes: StripeMap, contours: tuple[Outline, ...], calibration: Calibration) -> Product:
    """Give the one product that was coded."""
    products = assemble(
        lifted(stripes, calibration), contours, calibration, "images", stripes.reasons, calibration.view
    )
    if len(products) != 1:
        raise RoemetryError(f"{len(products)} products were found, expected 1")
    return products[0]


def lifted(stripes: StripeMap, calibration: Calibration) -> Profiles:
    """Meet the rays of coded peaks with the true planes."""
    view = calibration.view
    assert view is not None
    count, rows = stripes.x_px.shape
    row_px = np.broadcast_to(np.arange(rows, dtype=np.float64), stripes.x_px.shape)
    number = np.broadcast_to(np.arange(count)[:, None], stripes.x_px.shape)
    return Profiles(
        xyz_mm=view.lift(np.stack([stripes.x_px, row_px], axis=-1), number),
        product=stripes.product,
        seen=stripes.seen,
        x_px=stripes.x_px,
        row_px=row_px,
        height_std_mm=np.full(stripes.x_px.shape, np.nan),
        stripe=np.arange(count),
        frame=np.zeros(count, np.int64),
        plane=view.planes.copy(),
    )
