"""A short simulation beside the prediction: flat plates, the centre of gravity of each stripe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from roemetry.records import PlanColumn, PlanTable
from roemetry_simulate.camera import Camera
from roemetry_simulate.plan_geometry import scale_at
from roemetry_simulate.plan_uncertainty import WINDOW_SIGMAS, PeakStd, Stripe, peak_std, stripes_at
from roemetry_simulate.plan_volume import Space
from roemetry_simulate.render import Rig, render
from roemetry_simulate.solid import Block, EmptyBelt
from roemetry_simulate.surface import even

Floats = NDArray[np.float64]

ROWS_MAX = 64
_PLATE_MM = 4000.0
_SEED = 5


@dataclass(frozen=True)
class Scatter:
    """What a simulated plate showed, over all stripes and rows, and what was predicted of it.

    Attributes
    ----------
    height_mm : float
        Of the plate.
    centres : int
        Stripe centres that were measured.
    measured_px, predicted_px : float
        Root mean square scatter of the centre of gravity about its mean along each stripe.
    bound_px : float
        Cramér-Rao bound.
    offset_px : float
        Mean difference from the true place.
    measured_um, predicted_um : float
        The scatter as heights.
    """

    height_mm: float
    centres: int
    measured_px: float
    predicted_px: float
    bound_px: float
    offset_px: float
    measured_um: float
    predicted_um: float


def check_table(space: Space) -> PlanTable:
    """Simulate plates at belt, middle and top, and put their scatter beside the prediction."""
    found = [simulated_scatter(space, z) for z in (0.0, 0.5 * space.top_mm, space.top_mm)]

    def column(name: str, title: str, unit: str, digits: int) -> PlanColumn:
        values = np.array([float(getattr(one, name)) for one in found])
        return PlanColumn(name.replace("_", "-"), title, unit, values, digits)

    ratio = np.array([one.measured_um / one.predicted_um for one in found])
    return PlanTable(
        "check",
        "Predicted and simulated",
        (
            column("height_mm", "plate at", "mm", 1),
            column("centres", "centres", "1", 0),
            column("predicted_um", "predicted", "µm", 1),
            column("measured_um", "simulated", "µm", 1),
            PlanColumn("ratio", "simulated / predicted", "1", ratio, 3),
            column("predicted_px", "predicted", "px", 4),
            column("measured_px", "simulated", "px", 4),
            column("bound_px", "best possible", "px", 4),
            column("offset_px", "mean offset", "px", 4),
        ),
        f"Images of {min(ROWS_MAX, space.rig.camera.height_px)} rows of matt, even plates of the product's "
        "albedo, with noise and speckle; standard deviation of the centre of gravity from the true place, "
        "each stripe's mean taken out.",
    )


def simulated_scatter(space: Space, height_mm: float, seed: int = _SEED) -> Scatter:
    """Render a plate and measure how its stripes' centres of gravity scatter.

    Parameters
    ----------
    space : Space
        The rig.
    height_mm : float
        Of the plate; 0 is a belt of the product's albedo.
    seed : int
        Of noise and speckle.

    Returns
    -------
    Scatter
        Of stripes that lie in the image with room for the window; NaN where there is none.
    """
    rig = replace(space.rig, camera=_strip(space.rig.camera))
    plate = Block(_PLATE_MM, _PLATE_MM, height_mm, 0.0, space.y_mm) if height_mm > 0.0 else EmptyBelt()
    image = render(rig, plate, even(space.albedo), seed=seed).astype(np.float64)
    points = _points(rig, height_mm, space.y_mm)
    middle = points[:, rig.camera.height_px // 2]
    stripes = stripes_at(rig, middle, space.albedo, rig.laser.peak_grey)
    stds = [peak_std(stripe, rig.sensor) for stripe in stripes]
    scale = np.abs(scale_at(rig.camera, rig.laser, middle).height_px_per_mm)
    true_px = rig.camera.project(points)[..., 0]
    kept: list[tuple[PeakStd, float, Floats]] = []
    for i, stripe in enumerate(stripes):
        off = _offsets(image, true_px[i], stripe, rig)
        if off.size:
            kept.append((stds[i], float(scale[i]), off))
    if not kept:
        return Scatter(height_mm, 0, *([np.nan] * 6))
    spread = np.array([off.std(ddof=1) for _, _, off in kept])
    expected = np.array([one.centre_of_gravity_px for one, _, _ in kept])
    per_mm = np.array([each for _, each, _ in kept])
    return Scatter(
        height_mm,
        sum(off.size for _, _, off in kept),
        _rms(spread),
        _rms(expected),
        _rms(np.array([one.bound_px for one, _, _ in kept])),
        float(np.mean([off.mean() for _, _, off in kept])),
        1e3 * _rms(spread / per_mm),
        1e3 * _rms(expected / per_mm),
    )


def _strip(camera: Camera) -> Camera:
    """The camera's middle rows alone; the optical axis stays where it is."""
    rows = min(ROWS_MAX, camera.height_px)
    first = (camera.height_px - rows) // 2
    x, y = camera.principal_px
    return replace(camera, height_px=rows, principal_point_px=(float(x), float(y) - first))


def _points(rig: Rig, height_mm: float, y_mm: float) -> Floats:
    """Where each plane meets a level in the middle of each row, shape (N, rows, 3)."""
    fan, camera = rig.laser, rig.camera
    rows = np.arange(camera.height_px, dtype=np.float64)
    y = np.full((fan.count, rows.size), y_mm)

    def at(y: Floats) -> Floats:
        n = fan.normals
        x = (fan.offsets_mm[:, None] - y * n[:, 1:2] - height_mm * n[:, 2:3]) / n[:, :1]
        return np.stack([x, y, np.full_like(x, height_mm)], axis=-1)

    for _ in range(8):  # Newton's method; rows are nearly even in Y
        here = camera.project(at(y))[..., 1]
        slope = (camera.project(at(y + 0.01))[..., 1] - here) / 0.01
        y = y + (rows - here) / slope
    return at(y)


def _offsets(image: Floats, true_px: Floats, stripe: Stripe, rig: Rig) -> Floats:
    """Centre of gravity minus true place for one stripe in all rows; empty where it has no room."""
    reach = int(np.ceil(WINDOW_SIGMAS * stripe.width_px(rig.sensor)))
    middle = np.rint(true_px).astype(np.int64)
    if not np.isfinite(true_px).all() or middle.min() < reach or middle.max() >= image.shape[1] - reach:
        return np.empty(0)
    columns = middle[:, None] + np.arange(-reach, reach + 1)
    light = image[np.arange(len(image))[:, None], columns]
    light = light - rig.sensor.black_level_grey - stripe.background_grey
    centres: Floats = (light * columns).sum(axis=1) / light.sum(axis=1)
    return centres - true_px


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
