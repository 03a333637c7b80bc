"""Volume from rendered images: extraction, coding, true planes, outline; nothing taken from the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.volume_scenes import HERRING_ROE, exact_skein, skein
from roemetry.assembling import assemble
from roemetry.calibration import Calibration
from roemetry.errors import RoemetryError
from roemetry.pipeline import undecided
from roemetry.records import Frame, Product, Profiles, StripeMap
from roemetry.scene import Scene
from roemetry.stages import VolumeEstimator
from roemetry_paper.window_tracking import WindowTracking
from roemetry_peaks.centre_of_gravity import CentreOfGravity
from roemetry_simulate import scene_rig
from roemetry_simulate.render import render
from roemetry_volume.edge_contour import EdgeContour, EdgeContourOptions


class Pictured(NamedTuple):
    """One estimate from images; error and uncertainty relative to the true visible volume."""

    seed: int
    estimator: str
    outline: str
    error: float
    std: float
    defect: str
    true_share: float


def image_rows(
    seeds: Sequence[int], cache: Path, estimators: Mapping[str, VolumeEstimator[Any]]
) -> tuple[list[Pictured], list[str]]:
    """Measure skeins from their images, with and without the plain-light one; also what was refused."""
    rows, refusals = [], []
    for seed in seeds:
        one = exact_skein(seed, 11, cache)
        laser, plain = images(seed, cache)
        for outline in ("plain", "laser"):
            try:
                product = measured(laser, plain, one.product.calibration, outline)
            except RoemetryError as error:
                if outline == "plain":
                    refusals.append(f"{seed}: {str(error).splitlines()[0]}")
                continue
            for name, estimator in estimators.items():
                if outline == "laser" and name != "outline-surface":
                    continue
                try:
                    volume = estimator.estimate(product)
                except RoemetryError as error:
                    refusals.append(f"{seed}, `{name}`: {str(error).splitlines()[0]}")
                    continue
                found = volume.visible_mm3
                rows.append(
                    Pictured(
                        seed,
                        name,
                        outline,
                        found.value / one.visible_mm3 - 1.0,
                        found.std / one.visible_mm3,
                        one.defect,
                        one.true_mm3 / one.visible_mm3,
                    )
                )
    return rows, refusals


def is_rendered(seed: int, cache: Path) -> bool:
    """Whether the cache holds a skein's images."""
    return (cache / f"{seed}_images.npz").exists()


def images(seed: int, cache: Path) -> tuple[Frame, Frame]:
    """Render a skein in laser and in plain light, or take both from the cache."""
    path = cache / f"{seed}_images.npz"
    if not path.exists():
        rig, drawn = skein(seed)
        scene = Scene.load(HERRING_ROE).simulator.options
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
    stripes = WindowTracking().code(CentreOfGravity().extract(laser), calibration)
    doubt = undecided(stripes)
    if doubt is not None:  # as a run has it
        raise RoemetryError(doubt.text)
    outliner = EdgeContour(EdgeContourOptions(light="plain" if outline == "plain" else "laser"))
    contours = outliner.outline(laser, plain, stripes, calibration)
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
