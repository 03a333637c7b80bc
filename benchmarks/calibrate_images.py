"""Boards in simulated images: heights of `pinhole-plane` and of `block-linear` against the truth.

``python -m benchmarks calibrate_images [--rig narrow] [--poses 30] [--seed 1] [--out DIR] [--images 200]
[--plates 3]`` renders belt, block and ChArUco board (kept in DIR, so that it can be stopped and started
again), calibrates both ways, and prints height errors over 2 to 30 mm and over the image.

``--images`` renders a level at each of five heights as well, exposes it so many times with fresh speckle and
noise, and takes the recipe's way: extractor, triangulator; the light of a still scene is cast once a height.
``--plates`` lays the shipped sphere plate under the stripes so many times and measures its size.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.command import parser_of
from benchmarks.tables import table
from benchmarks.volume_scenes import sphere_plate
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.io.yaml_source import dump
from roemetry.records import Frame, StripeMap
from roemetry.records import Sensor as Noise
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages.registry import discover
from roemetry_pinhole.plates import plate_scale
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import lay
from roemetry_simulate.ray_caster import RayCaster
from roemetry_simulate.render import Rig as TrueRig
from roemetry_simulate.render import expose, laser_light, render
from roemetry_simulate.scene import RayCasterOptions, rig_of, surface_of
from roemetry_simulate.solid import Block
from roemetry_simulate.surface import Surface

_BOARD = {"square_mm": 10.5, "marker_mm": 7.9, "tilt_max_deg": 25.0}
RIGS: dict[str, dict[str, object]] = {
    "narrow": {"targets": {"board": {**_BOARD, "poses": 30}}},
    "dense": {
        "laser": {"planes": 31, "spacing_mm": 3.3, "line_width_mm": 0.75},
        "targets": {"board": {**_BOARD, "poses": 16}},
    },
    "wide": {
        "camera": {
            "width_px": 640, "height_px": 512, "pixel_size_um": 10.0, "focal_length_mm": 8.0,
            "distance_mm": 200.0, "tilt_x_deg": 6.0, "tilt_y_deg": -4.0,
            "distortion": {"k1": -0.12, "k2": 0.03, "p1": 0.0005, "p2": -0.0004},
        },
        "laser": {"projector_mm": [120.0, -4.0, 190.0], "line_width_mm": 1.2},
        "targets": {
            "board": {
                "columns": 13, "rows": 10, "square_mm": 12.0, "marker_mm": 9.0, "tilt_max_deg": 25.0,
                "poses": 24,
            }
        },
    },
}  # fmt: skip
METHODS = ("block-linear", "pinhole-plane")
HEIGHTS_MM = (2.0, 5.0, 10.0, 16.5, 20.0, 25.0, 30.0)
GRID_MM = (2.0, 10.0, 16.5, 25.0, 30.0)
_WIDE_MM = 2000.0
"""Side of a level: wider than any view."""
_NEAR_PX = 4.0
"""A peak belongs to the stripe that is nearer than this."""


def main() -> None:
    """Print both methods' errors."""
    parser = parser_of(__doc__)
    parser.add_argument("--rig", choices=sorted(RIGS), default="narrow")
    parser.add_argument("--poses", type=int, help="left out: narrow 30, wide 24, dense 16")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--extractor", default="centre-of-gravity")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--images", type=int, default=0, help="exposures of each of five levels")
    parser.add_argument("--plates", type=int, default=0, help="places of the sphere plate")
    given = parser.parse_args()
    scene = scene_of(given.rig, given.poses)
    with tempfile.TemporaryDirectory() as made:
        folder = given.out or Path(made)
        render_targets(scene, folder, given.seed)
        both = {method: calibrated(scene, folder, method, given.extractor) for method in METHODS}
    rig = rig_of(scene)
    row_px = np.arange(rig.camera.height_px, dtype=np.float64)
    found = {
        method: {z: _heights(one, exact_lines(rig, z, row_px)) - z for z in HEIGHTS_MM}
        for method, (one, _) in both.items()
    }
    print(
        f"rig {given.rig}: {rig.camera.width_px} × {rig.camera.height_px}, seed {given.seed}, "
        f"{scene.targets.board.poses} poses, {given.extractor}"
    )
    for method, (calibration, seconds) in both.items():
        print(f"{method}: calibrated in {seconds:.1f} s")
        for name, value in calibration.residuals.items():
            print(f"  {name}: {value:.4g}")
    _table(found)
    _cells(found["pinhole-plane"])
    pinhole = both["pinhole-plane"][0]
    _judge(scene, pinhole)
    for count in (1, given.images) if given.images else ():
        errors = {}
        for number, height in enumerate(GRID_MM):
            first = 1_000_000 * (given.seed + 1) + 10_000 * number
            seen = _averaged(scene, height, given.extractor, first, count)
            errors[height] = _heights(pinhole, seen) - height
        print(f"{count} images of each level:")
        _cells(errors)
    _plates(scene, pinhole, given.extractor, given.seed, given.plates)


def scene_of(name: str, poses: int | None) -> RayCasterOptions:
    """Give one of `RIGS`, with so many poses of the board."""
    scene = RayCasterOptions.model_validate(RIGS[name])
    if poses is None:
        return scene
    targets = scene.targets.model_dump()
    targets["board"]["poses"] = poses
    return RayCasterOptions.model_validate({**RIGS[name], "targets": targets})


def render_targets(scene: RayCasterOptions, folder: Path, seed: int) -> None:
    """Write the images of belt, block and board that are not there yet."""
    frames = RayCaster(scene).calibration_frames(seed)
    for kind in ("belt", "block", "charuco"):
        for name in frames[kind]:
            path = folder / kind / f"{name}.png"
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), frames[kind][name].pixels)


def calibrated(
    scene: RayCasterOptions, folder: Path, method: str, extractor: str
) -> tuple[Calibration, float]:
    """Calibrate from the written images; give the time it took as well, s."""
    part, block = scene.targets.board, scene.targets.block
    images = {"belt": ["belt/belt.png"], "block": ["block/block.png"]}
    sizes = {name: getattr(block, name) for name in ("length_mm", "width_mm", "height_mm")}
    data: dict[str, object] = {
        "roemetry_rig": 1, "name": "simulated", "stripes": scene.laser.count,
        "working_distance_mm": scene.camera.distance_mm, "images": images, "extractor": extractor,
        "target": {"kind": "block", "name": "block", **sizes, "tolerance_mm": 0.02}, "calibrator": method,
    }  # fmt: skip
    if method == "pinhole-plane":
        data["board"] = {
            "kind": "charuco", "name": "board", "columns": part.columns, "rows": part.rows,
            "pitch_mm": part.square_mm, "marker_mm": part.marker_mm, "dictionary": part.dictionary,
            "tolerance_mm": 0.01,
        }  # fmt: skip
        images |= {"board": ["charuco/*_plain.png"], "board_laser": ["charuco/*_laser.png"]}
    path = folder / f"{method}.yaml"
    path.write_text(dump(data), encoding="utf-8")
    rig = Rig.load(path)
    begin = time.perf_counter()
    made = calibrate(rig)
    return made, time.perf_counter() - begin


def _stage(kind: str, name: str) -> Any:
    registry = discover()
    return registry.load(registry.find(kind, name))()


def _heights(calibration: Calibration, x_px: Floats) -> Floats:
    """(stripe, row) heights, mm, of places in the image, by the triangulator; NaN outside."""
    stage = _stage("triangulator", calibration.method)
    x_px = np.where((x_px < 0) | (x_px > calibration.image_size[1] - 1), np.nan, x_px)
    seen = np.isfinite(x_px)
    rest_px = calibration.rest_line_px(np.arange(x_px.shape[1], dtype=np.float64))
    stripes = StripeMap(
        x_px=x_px, x_std_px=np.where(seen, 0.1, np.nan), product=np.where(seen, 1, -1).astype(np.int16),
        seen=seen, margin=np.where(seen, 1.0, np.nan), ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=rest_px, peak_stripe=np.empty(0, np.int16),
    )  # fmt: skip
    return np.asarray(stage.triangulate(stripes, calibration).xyz_mm[..., 2])


def exact_lines(rig: TrueRig, height_mm: float, row_px: Floats) -> Floats:
    """Where each plane lies on a level of this height, (stripe, row) px, by projecting many points."""
    away = float(rig.camera.centre_mm[2])
    y = np.linspace(-1.0, 1.0, 4001) * away
    x = rig.laser.x_mm(y, height_mm)
    lines = np.full((x.shape[1], row_px.size), np.nan)
    for stripe in range(x.shape[1]):
        xy = rig.camera.project(np.column_stack([x[:, stripe], y, np.full(y.size, height_mm)]))
        near = (np.abs(xy[:, 0]) < 3 * rig.camera.width_px) & (np.abs(xy[:, 1]) < 3 * rig.camera.height_px)
        order = np.argsort(xy[near, 1])
        lines[stripe] = np.interp(row_px, xy[near, 1][order], xy[near, 0][order], left=np.nan, right=np.nan)
    return lines


def _table(found: dict[str, dict[float, Floats]]) -> None:
    rows = []
    for height in HEIGHTS_MM:
        errors = [found[method][height] for method in METHODS]
        cells = [f"{np.nanmean(error):+.3f}, {np.nanmax(np.abs(error)):.3f}" for error in errors]
        rows.append([f"{height:g}", *cells])
    print(table(["height mm", *(f"{method}: mean, largest error mm" for method in METHODS)], rows), end="")


def _cells(found: dict[float, Floats]) -> None:
    """Mean errors in cells of five groups of stripes × five of rows × five heights."""
    cells = []
    for height in GRID_MM:
        for stripes in np.array_split(found[height], 5):
            for cell in np.array_split(stripes, 5, axis=1):
                if np.isfinite(cell).sum() > 20:
                    cells.append(abs(float(np.nanmean(cell))))
    depth = max(HEIGHTS_MM)
    median, worst = float(np.median(cells)), max(cells)
    print(
        f"pinhole-plane, {len(cells)} cells of 5 × 5 × {len(GRID_MM)}: median cell {1e3 * median:.1f} µm "
        f"(1/{depth / median:.0f} of {depth:g} mm), worst {1e3 * worst:.1f} µm (1/{depth / worst:.0f})"
    )


def _judge(scene: RayCasterOptions, calibration: Calibration) -> None:
    """Errors over the standard uncertainty that the calibration states, at points all over the volume."""
    stage = _stage("triangulator", calibration.method)
    rig = rig_of(scene)
    row = np.linspace(0.1, 0.9, 5) * (calibration.image_size[0] - 1)
    xy, stripe, truth = [], [], []
    for height in HEIGHTS_MM:
        x = exact_lines(rig, height, row)
        number, at = np.nonzero((x > 0) & (x < calibration.image_size[1] - 1))
        xy.append(np.column_stack([x[number, at], row[at]]))
        stripe.append(number)
        truth.append(np.full(number.size, height))
    places, stripes, heights = np.concatenate(xy), np.concatenate(stripe), np.concatenate(truth)
    off = stage.view(calibration).lift(places, stripes)[:, 2] - heights
    draws = calibration.redraws(np.random.default_rng(7))
    drawn = [stage.view(one).lift(places, stripes)[:, 2] for _, one in zip(range(100), draws, strict=False)]
    std = np.std(drawn, axis=0)
    print(
        f"stated standard uncertainty of heights (common part): median {1e3 * np.median(std):.1f} µm; "
        f"errors over it, rms {np.sqrt(np.mean((off / std) ** 2)):.2f}"
    )


def _averaged(scene: RayCasterOptions, height_mm: float, extractor: str, seed: int, images: int) -> Floats:
    """Give (stripe, row) mean place, px, of each stripe on a level over many images; NaN where never seen."""
    rig = rig_of(scene)
    stage = _stage("extractor", extractor)
    lines = exact_lines(rig, height_mm, np.arange(rig.camera.height_px, dtype=np.float64))
    laser, ambient = laser_light(rig, Block(_WIDE_MM, _WIDE_MM, height_mm), _matt(scene, seed), scene.samples)
    total, many = np.zeros(lines.shape), np.zeros(lines.shape)
    for number in range(images):
        peaks = stage.extract(_frame(rig, expose(laser, ambient, rig.sensor, seed + number)))
        off = np.abs(lines[:, peaks.row] - peaks.x_px)
        off[np.isnan(off)] = np.inf
        stripe = off.argmin(axis=0)
        near = off[stripe, np.arange(len(peaks))] < _NEAR_PX
        at = stripe[near], peaks.row[near]
        np.add.at(total, at, peaks.x_px[near])
        np.add.at(many, at, 1.0)
    return np.where(many > 0, total / np.maximum(many, 1.0), np.nan)


def _plates(
    scene: RayCasterOptions, calibration: Calibration, extractor: str, seed: int, plates: int
) -> None:
    """Print the size of the shipped sphere plate, over the true one, in so many places and turns."""
    rig, stage = rig_of(scene), _stage("extractor", extractor)
    plate, mesh = sphere_plate()
    rng = np.random.default_rng(seed)
    for count in range(plates):
        pose = Pose(*rng.uniform(-4.0, 4.0, 2), float(rng.uniform(-8.0, 8.0)))
        own = 1000 * (seed + 1) + count
        pixels = render(rig, lay(mesh, pose), _matt(scene, own), seed=own, samples=scene.samples)
        found = plate_scale(calibration, [stage.extract(_frame(rig, pixels))], plate)
        if found is None:
            print(f"plate {count + 1}: not seen")
            continue
        common = float(found.by_parameter @ calibration.covariance @ found.by_parameter)
        std = float(np.hypot(found.own_std, np.sqrt(common)))
        print(f"plate {count + 1}: size {found.ratio:.5f} ± {std:.5f} of the true one; {found.said}")


def _frame(rig: TrueRig, pixels: np.ndarray) -> Frame:
    """Give a rendered image with the sensor's noise as its owner knows it."""
    sensor = rig.sensor
    noise = Noise(sensor.grey_per_electron, sensor.read_noise_grey)
    return Frame(pixels, name="level", bit_depth=sensor.bit_depth, sensor=noise)


def _matt(scene: RayCasterOptions, seed: int) -> Surface:
    """The simulated targets' material: matt, with a third of the product's texture."""
    surface = surface_of(scene, seed)
    texture, albedo = 1.0 + 0.35 * (surface.texture - 1.0), (surface.laser_albedo[0], 0.60)
    plain = {"gloss": (0.0, 0.0), "below": (0.0, 0.0, 0.0)}
    return replace(surface, texture=texture, laser_albedo=albedo, **plain)
