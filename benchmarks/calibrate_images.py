"""Boards in simulated images: heights of `pinhole-plane` and of `block-linear` against the truth.

``python -m benchmarks calibrate_images [--rig narrow] [--poses 30] [--seed 1] [--out DIR] [--plot FILE]
[--map FILE]`` renders belt, block and ChArUco board (kept in DIR, so that it can be stopped and started
again), calibrates both ways, and prints height errors over 2 to 30 mm and over the image, and how long the
calibration took.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.calibrate_map import over_the_image
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.io.yaml_source import dump
from roemetry.records import StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages.registry import discover
from roemetry_simulate.ray_caster import RayCaster
from roemetry_simulate.scene import RayCasterOptions, rig_of

RIGS: dict[str, dict[str, object]] = {
    "narrow": {
        "targets": {"board": {"square_mm": 10.5, "marker_mm": 7.9, "tilt_max_deg": 25.0, "poses": 30}},
    },
    "dense": {
        "laser": {"planes": 31, "spacing_mm": 3.3, "line_width_mm": 0.75},
        "targets": {"board": {"square_mm": 10.5, "marker_mm": 7.9, "tilt_max_deg": 25.0, "poses": 16}},
    },
    "wide": {
        "camera": {
            "width_px": 640,
            "height_px": 512,
            "pixel_size_um": 10.0,
            "focal_length_mm": 8.0,
            "distance_mm": 200.0,
            "tilt_x_deg": 6.0,
            "tilt_y_deg": -4.0,
            "distortion": {"k1": -0.12, "k2": 0.03, "p1": 0.0005, "p2": -0.0004},
        },
        "laser": {"projector_mm": [120.0, -4.0, 190.0], "line_width_mm": 1.2},
        "targets": {
            "board": {
                "columns": 13,
                "rows": 10,
                "square_mm": 12.0,
                "marker_mm": 9.0,
                "tilt_max_deg": 25.0,
                "poses": 24,
            }
        },
    },
}
HEIGHTS_MM = (2.0, 5.0, 10.0, 16.5, 20.0, 25.0, 30.0)
GRID_MM = (2.0, 10.0, 16.5, 25.0, 30.0)


def main() -> None:
    """Print both methods' errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", choices=sorted(RIGS), default="narrow")
    parser.add_argument("--poses", type=int, help="left out: narrow 30, wide 24, dense 16")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--extractor", default="centre-of-gravity")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--plot", type=Path, help="SVG: errors against the height")
    parser.add_argument("--map", type=Path, help="SVG: errors over the image")
    given = parser.parse_args()
    scene = scene_of(given.rig, given.poses)
    with tempfile.TemporaryDirectory() as made:
        folder = given.out or Path(made)
        render_targets(scene, folder, given.seed)
        both = {method: calibrated(scene, folder, method, given.extractor) for method in METHODS}
    found = {method: _errors(scene, calibration) for method, (calibration, _) in both.items()}
    camera, poses = rig_of(scene).camera, scene.targets.board.poses
    print(
        f"rig {given.rig}: {camera.width_px} × {camera.height_px}, {poses} poses, "
        f"seed {given.seed}, {given.extractor}"
    )
    for method, (calibration, seconds) in both.items():
        print(f"{method}: calibrated in {seconds:.1f} s")
        for name, value in calibration.residuals.items():
            print(f"  {name}: {value:.4g}")
    _table(found)
    print_cells(found["pinhole-plane"])
    _judge(scene, both["pinhole-plane"][0])
    if given.plot:
        given.plot.write_text(_plot(found), encoding="utf-8")
    if given.map:
        given.map.write_text(over_the_image(found, (5.0, 16.5, 30.0)), encoding="utf-8")


METHODS = ("block-linear", "pinhole-plane")


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
    data: dict[str, object] = {
        "roemetry_rig": 1,
        "name": "simulated",
        "stripes": scene.laser.count,
        "working_distance_mm": scene.camera.distance_mm,
        "target": {
            "kind": "block",
            "name": "block",
            "length_mm": block.length_mm,
            "width_mm": block.width_mm,
            "height_mm": block.height_mm,
            "tolerance_mm": 0.02,
        },
        "images": images,
        "extractor": extractor,
        "calibrator": method,
    }
    if method == "pinhole-plane":
        data["board"] = {
            "kind": "charuco",
            "name": "board",
            "columns": part.columns,
            "rows": part.rows,
            "pitch_mm": part.square_mm,
            "marker_mm": part.marker_mm,
            "dictionary": part.dictionary,
            "tolerance_mm": 0.01,
        }
        images |= {"board": ["charuco/*_plain.png"], "board_laser": ["charuco/*_laser.png"]}
    path = folder / f"{method}.yaml"
    path.write_text(dump(data), encoding="utf-8")
    rig = Rig.load(path)
    begin = time.perf_counter()
    made = calibrate(rig)
    return made, time.perf_counter() - begin


def _errors(scene: RayCasterOptions, calibration: Calibration) -> dict[float, Floats]:
    """Of each height the (stripe, row) errors of Z, mm, of exact stripes; NaN outside the image."""
    rig = rig_of(scene)
    registry = discover()
    stage = registry.load(registry.find("triangulator", calibration.method))()
    rows, columns = calibration.image_size
    row_px = np.arange(rows, dtype=np.float64)
    found = {}
    for height in HEIGHTS_MM:
        x = exact_lines(rig, height, row_px)
        x[(x < 0) | (x > columns - 1)] = np.nan
        seen = np.isfinite(x)
        stripes = StripeMap(
            x_px=x,
            x_std_px=np.where(seen, 0.1, np.nan),
            product=np.where(seen, 1, -1).astype(np.int16),
            seen=seen,
            margin=np.where(seen, 1.0, np.nan),
            ambiguous=np.zeros(x.shape, np.bool_),
            rest_px=calibration.rest_line_px(row_px),
            peak_stripe=np.empty(0, np.int16),
        )
        found[height] = stage.triangulate(stripes, calibration).xyz_mm[..., 2] - height
    return found


def exact_lines(rig, height_mm: float, row_px: Floats) -> Floats:  # noqa: ANN001
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
    print("| height mm | " + " | ".join(f"{method}: mean, largest error mm" for method in METHODS) + " |")
    print("|---|" + "---|" * len(METHODS))
    for height in HEIGHTS_MM:
        cells = []
        for method in METHODS:
            error = found[method][height]
            cells.append(f"{np.nanmean(error):+.3f}, {np.nanmax(np.abs(error)):.3f}")
        print(f"| {height:g} | " + " | ".join(cells) + " |")


def print_cells(found: dict[float, Floats]) -> None:
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
    registry = discover()
    stage = registry.load(registry.find("triangulator", calibration.method))()
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


def _plot(found: dict[str, dict[float, Floats]]) -> str:
    """SVG: for both methods, the range of errors over the image against the height."""
    width, high, left, below = 640, 320, 60, 40
    limit = max(float(np.nanmax(np.abs(error))) for errors in found.values() for error in errors.values())
    limit = np.ceil(10.0 * limit) / 10.0

    def at(height: float, error: float) -> tuple[float, float]:
        x = left + (width - left - 20) * height / max(HEIGHTS_MM)
        return x, 20 + (high - below - 20) * (0.5 - 0.5 * error / limit)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {high}" font-family="sans-serif" '
        'font-size="12"><rect width="100%" height="100%" fill="white"/>'
    ]
    for error in (-limit, -limit / 2, 0.0, limit / 2, limit):
        x, y = at(0.0, error)
        parts.append(f'<line x1="{x}" y1="{y:.1f}" x2="{width - 20}" y2="{y:.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{error:+.2f}</text>')
    for height in HEIGHTS_MM:
        x, y = at(height, -limit)
        parts.append(f'<text x="{x:.1f}" y="{y + 16:.1f}" text-anchor="middle">{height:g}</text>')
    for method, colour, shift in (("block-linear", "#c04f15", -4.0), ("pinhole-plane", "#1f5fa8", 4.0)):
        line = []
        for height in HEIGHTS_MM:
            error = found[method][height]
            x, low = at(height, float(np.nanmin(error)))
            _, top = at(height, float(np.nanmax(error)))
            _, mean = at(height, float(np.nanmean(error)))
            x += shift
            line.append(f"{x:.1f},{mean:.1f}")
            parts.append(
                f'<line x1="{x:.1f}" y1="{low:.1f}" x2="{x:.1f}" y2="{top:.1f}" stroke="{colour}" '
                'stroke-width="3" stroke-opacity="0.45"/>'
            )
        parts.append(f'<polyline points="{" ".join(line)}" fill="none" stroke="{colour}" stroke-width="2"/>')
        y = 34 if method == "block-linear" else 50
        parts.append(
            f'<text x="{left + 12}" y="{y}" fill="{colour}">{method}: mean and range over the image</text>'
        )
    parts.append(f'<text x="{width / 2}" y="{high - 6}" text-anchor="middle">height, mm</text>')
    parts.append(f'<text x="14" y="{high / 2}" transform="rotate(-90 14 {high / 2})">error, mm</text></svg>')
    return "\n".join(parts)


if __name__ == "__main__":
    main()
