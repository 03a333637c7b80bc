"""Fresh rigs with truth, drawn at random and rendered by either simulator.

A rig is a folder of files as a user would have them (boards, block, empty belt, products by laser and by
plain light; rig and recipe files) with the truth beside it (`truth.json`, `truth/*.npz`), in the layout that
`python -m benchmarks outside` reads. Everything about it is
drawn from the seed: stripes, spacing, side and steepness of the projector, camera size, lens, tilt, light,
gloss, scattering, speckle, saturation. Kinds take turns: `paper` is like the published rig with another
camera, `dense` has narrow stripes of uneven power, a steep projector, speckle and gloss, `any` lies between.

    python -m benchmarks make_rigs --simulator mitsuba --seed 1 --rigs 3 --bodies 10 --out rigs
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import parser_of
from roemetry.config.dataset import save_bytes
from roemetry.io.files import shipped
from roemetry.io.yaml_source import dump
from roemetry.records import Frame, ProductTruth
from roemetry.stages.registry import discover

Floats = NDArray[np.float64]

MAKERS = ("mitsuba", "ray-caster")
KINDS = ("paper", "dense", "any")

_OWN_KEYS = {"camera": ("vignetting", "prnu"), "surface": ("metal",)}
"""What the ray caster does not know."""
_BOARD_WHITE = 0.62
"""Albedo of the boards' paper in both simulators; the exposure of boards with the laser follows from it."""
_EXPOSED_GREY = 200.0
"""Grey level at which a user exposes white paper under the laser: below saturation."""


@dataclass(frozen=True)
class Body:
    """A product to render: its name, family, options, and in truth.json its class and defect."""

    name: str
    family: str
    options: Mapping[str, Any]
    cls: str


def main() -> None:
    """Read the command line and write the rigs."""
    parser = parser_of(__doc__)
    parser.add_argument("--simulator", choices=MAKERS, default="mitsuba")
    parser.add_argument("--seed", type=int, required=True, help="decides everything about the rigs")
    parser.add_argument("--rigs", type=int, default=3, help="how many")
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds that take turns, with commas between")
    parser.add_argument("--bodies", type=int, default=10, help="products of each")
    parser.add_argument("--boards", type=int, default=9, help="tilted poses of the board")
    parser.add_argument("--samples", type=int, default=3, help="rays along a pixel's side (mitsuba)")
    parser.add_argument("--scale", type=float, default=1.0, help="image size over the rig's, for trials")
    parser.add_argument("--out", type=Path, required=True)
    told = parser.parse_args()
    kinds = told.kinds.split(",")
    told.out.mkdir(parents=True, exist_ok=True)
    shutil.copy(shipped("recipes", "herring_roe") / "classifier.json", told.out / "classifier.json")
    for number in range(told.rigs):
        kind = kinds[number % len(kinds)]
        name = f"{told.simulator.replace('-', '_')}_{told.seed}_{number + 1}_{kind}"
        rng = np.random.default_rng([told.seed, number, *told.simulator.encode()])
        scene = draw_rig(rng, kind, boards=told.boards, scale=told.scale)
        bodies = draw_bodies(rng, told.simulator, told.bodies, scene)
        maker = _Maker(told.simulator, scene, told.samples)
        write_rig(told.out / name, name, scene, bodies, maker, int(rng.integers(2**31)))


def draw_rig(rng: np.random.Generator, kind: str, *, boards: int, scale: float = 1.0) -> dict[str, Any]:
    """Draw a rig: the simulator's options but for the product.

    `hard` runs from 0 (paper) to 1 (dense); every quantity is drawn within a range that moves with it.
    """
    hard = {"paper": 0.0, "dense": 1.0, "any": float(rng.uniform(0.3, 0.8))}[kind]

    def between(easy: tuple[float, float], difficult: tuple[float, float]) -> float:
        low, high = (a + hard * (b - a) for a, b in zip(easy, difficult, strict=True))
        return float(rng.uniform(low, high))

    width, height = [(896, 672), (960, 720), (1024, 768), (1120, 840)][int(rng.integers(4))]
    width, height = round(scale * width), round(scale * height)
    view_mm = float(rng.uniform(122.0, 140.0))
    focal_mm, pixel_um = float(rng.uniform(8.0, 14.0)), float(rng.uniform(4.8, 6.9)) * 960.0 / width
    distance_mm = focal_mm * view_mm / (1e-3 * pixel_um * width)
    tilt_x = between((-3.0, 3.0), (4.0, 12.0)) * (1.0 if hard == 0.0 else float(rng.choice([-1.0, 1.0])))
    stripes = round(between((11.0, 15.0), (16.0, 21.0)))
    spacing = float(rng.uniform(84.0, 98.0)) / (stripes - 1)
    side = 1.0 if kind == "any" else float(rng.choice([-1.0, 1.0]))  # one of three at least shines from +x
    steep_rad = math.radians(between((22.0, 28.0), (33.0, 40.0)))
    up = float(rng.uniform(240.0, 330.0))
    power = np.round(1.0 + between((0.06, 0.1), (0.18, 0.25)) * rng.uniform(-1.7, 1.7, stripes), 3)
    gain = 255.0 / float(rng.uniform(12500.0, 17000.0))
    exposure = 10.0
    white = between((420.0, 600.0), (700.0, 1000.0))  # grey level of white in a stripe: over 255 saturates
    plain_belt = float(rng.uniform(0.22, 0.36))
    grey = gain * exposure
    even = spacing * (np.arange(stripes) - 0.5 * (stripes - 1))
    belt = np.round(even + rng.normal(0, 0.06, stripes), 4).tolist()
    stray = None
    if hard > 0.5:
        aside = rng.uniform(60.0, 130.0, 2) * rng.choice([-1, 1], 2)
        place = np.round([*aside, rng.uniform(150.0, 260.0)], 1).tolist()
        stray = {"position_mm": place, "e_per_ms": float(rng.uniform(12.0, 40.0)) / grey}
    # the board reaches beyond the outer stripes, so that each of them lies on it in most poses
    columns, rows = math.ceil((belt[-1] - belt[0] + 2.0) / 8.0), round(0.72 * view_mm * height / width / 8.0)
    # the block lies where the stripes meet its top, and reaches beyond them
    block_height, top = 16.5, 1.0 - 16.5 / up
    block_length, block_x = (belt[-1] - belt[0]) * top + 14.0, side * math.tan(steep_rad) * 16.5
    return {
        "camera": {
            "width_px": width, "height_px": height, "pixel_size_um": pixel_um, "focal_length_mm": focal_mm,
            "principal_point_px": [float(0.5 * width + rng.uniform(-8, 8)),
            float(0.5 * height + rng.uniform(-8, 8))],
            "distance_mm": distance_mm, "tilt_x_deg": tilt_x, "tilt_y_deg": between((-3.0, 3.0), (-6.0, 6.0)),
            "distortion": {
                "k1": float(rng.uniform(-0.13, 0.03)), "k2": float(rng.uniform(-0.02, 0.08)),
                "p1": float(rng.uniform(-6e-4, 6e-4)), "p2": float(rng.uniform(-6e-4, 6e-4)),
            },
            "blur_sigma_px": between((0.45, 0.6), (0.55, 0.85)), "exposure_ms": exposure,
            "gain_dn_per_e": gain,
            "full_well_e": float(round(270.0 / gain)), "read_noise_e": between((0.5, 0.9), (0.7, 1.3)) / gain,
            "black_level_dn": float(rng.uniform(3.0, 8.0)),
            "vignetting": between((0.6, 1.1), (1.2, 2.0)), "prnu": float(rng.uniform(0.003, 0.009)),
        },
        "laser": {
            "projector_mm": [side * up * math.tan(steep_rad), float(rng.uniform(-10.0, 10.0)), up],
            "belt_x_mm": belt, "power": [float(p) for p in power],
            "yaw_deg": float(rng.uniform(-1.5, 1.5)), "pitch_deg": float(rng.uniform(-1.0, 1.0)),
            "line_width_mm": 4.0 * between((0.24, 0.30), (0.20, 0.30)),
            "waist_distance_mm": up / math.cos(steep_rad), "divergence_mrad": float(rng.uniform(0.5, 3.0)),
            "peak_e_per_ms": white / grey, "fall_deg": float(rng.uniform(18.0, 40.0)),
            "speckle_contrast": between((0.08, 0.13), (0.17, 0.26)),
            "speckle_sigma_px": float(rng.uniform(0.6, 1.1)),
        },
        "belt": {
            "albedo_laser": between((0.30, 0.42), (0.2, 0.32)), "albedo_plain": plain_belt,
            "texture": float(rng.uniform(0.03, 0.08)),
            "gloss": 0.0 if hard < 0.5 else float(rng.uniform(0.0, 0.06)),
        },
        "light": {
            "ambient_e_per_ms": between((5.0, 12.0), (12.0, 30.0)) / grey,
            "plain_e_per_ms": float(rng.uniform(270.0, 320.0)) / grey,
            "lamp_height_mm": float(rng.uniform(180.0, 300.0)), "lamp_radius_mm": float(rng.uniform(70.0,
            150.0)),
            "images": ["laser", "plain"], **({"stray": stray} if stray else {}),
        },
        "surface": {
            "albedo_laser": float(rng.uniform(0.48, 0.62)), "albedo_plain": float(rng.uniform(0.5, 0.64)),
            "texture": float(rng.uniform(0.05, 0.10)), "gloss": between((0.03, 0.08), (0.08, 0.12)),
            "gloss_exponent": between((15.0, 40.0), (40.0, 160.0)),
            "below": {
                "share": between((0.12, 0.25), (0.25, 0.40)), "depth_mm": float(rng.uniform(0.2, 0.4)),
                "blur_mm": between((0.4, 0.7), (0.5, 0.9)),
            },
            "wet": {"count": 0 if hard < 0.5 else int(rng.integers(3, 9))},
        },
        "targets": {
            "block": {
                "length_mm": round(block_length), "width_mm": 32.0, "height_mm": block_height,
                "centre_x_mm": block_x, "centre_y_mm": 0.0, "yaw_deg": float(rng.uniform(-1.0, 1.0)),
            },
            "staircase": {"width_mm": round(block_length)},
            "board": {
                "columns": columns, "rows": rows, "square_mm": 8.0, "marker_mm": 6.0, "poses": boards,
                "thickness_mm": 3.0, "height_mm": [0.0, 12.0],
            },
        },
    }  # fmt: skip


def draw_bodies(rng: np.random.Generator, maker: str, count: int, scene: Mapping[str, Any]) -> list[Body]:
    """Choose the products: good skeins, skeins with a defect, and other shapes between them."""
    lines_x = scene["laser"]["belt_x_mm"]
    reach = min(lines_x[-1] - lines_x[0] + 8.0, 108.0)
    long = [0.76 * reach, 0.97 * reach]
    if maker == "mitsuba":
        defects = [str(d) for d in rng.permutation(["dented", "bent", "twisted", "folded", "broken"])]
        good, skein = "none", "lofted-skein"
        others = ["ball", "supershape", "box", "superquadric", "rod"]
        sizes: dict[str, Any] = {"length_mm": long}
        more: dict[str, dict[str, Any]] = {}
    else:
        defects = [str(d) for d in rng.permutation(["dented", "bent", "twisted", "folded", "s-bent"])]
        good, skein = "healthy", "herring-roe"
        others = ["sphere", "potato", "block", "egg", "cylinder"]
        sizes = {}
        more = {
            "sphere": {"radius_mm": float(rng.uniform(10.0, 14.0))},
            "potato": {"length_range_mm": [55.0, 68.0], "width_range_mm": [40.0, 48.0],
            "thickness_range_mm": [26.0, 34.0]},
            "block": {
                "length_mm": float(rng.uniform(45, 65)), "width_mm": float(rng.uniform(20, 32)),
                "height_mm": float(rng.uniform(10, 18)), "turn_range_deg": 8.0,
            },
            "cylinder": {"length_mm": float(rng.uniform(50, 65)), "radius_mm": float(rng.uniform(8, 11)),
            "half": False},
        }  # fmt: skip
    order = [*"gdodogodgodgodg"]
    found: list[Body] = []
    while len(found) < count:
        what = order[len(found) % len(order)]
        number = len(found) + 1
        if what == "o":
            family = others[sum(b.family != skein for b in found) % len(others)]
            cls = "potato" if family in ("potato", "supershape") else "reference"
            found.append(Body(f"{family}_{number:02d}", family, more.get(family, {}), cls))
        else:
            kind = good if what == "g" else defects[sum(b.cls == "defective" for b in found) % len(defects)]
            cls = "good" if what == "g" else "defective"
            found.append(Body(f"roe_{number:02d}", skein, {**sizes, "kinds": {kind: 1.0}}, cls))
    return found


def write_rig(
    folder: Path, name: str, scene: dict[str, Any], bodies: list[Body], maker: _Maker, seed: int
) -> None:
    """Render a rig and write all its files; what is there already is kept, so a stopped run goes on."""
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    boards = scene["targets"]["board"]["poses"]
    targets = [("empty", "belt", "belt"), ("block", "block", "block"), ("stair", "staircase", "staircase")]
    targets += [(f"board_{k:02d}", "charuco", f"pose_{k:02d}" if k else "on_belt") for k in range(boards + 1)]
    images: dict[str, Any] = {}
    for label, kind, pose in targets:
        lights = ("laser", "plain") if kind == "charuco" else ("laser",)
        images[label] = {"kind": kind, "truth": f"truth/{label}.npz"}
        for light in lights:
            images[label][light] = f"calibration/{label}_{light}.png"
            path = folder / images[label][light]
            if not path.exists():
                view = f"{pose}_{light}" if kind == "charuco" else pose
                bright = light == "laser" and kind != "belt"
                _save(path, maker.calibration_frame(kind, view, seed, bright=bright))
        if not (folder / f"truth/{label}.npz").exists():
            _save_truth(folder / f"truth/{label}.npz", maker.calibration_truth(kind, pose, seed))
    objects: dict[str, Any] = {}
    for number, body in enumerate(bodies):
        frames, product, stripes = maker.body(body, seed + 100 * (number + 1))
        for frame, place in zip(frames, ("images", "images_plain"), strict=True):
            _save(folder / place / f"{body.name}.png", frame)
        _save_truth(folder / f"truth/{body.name}.npz", stripes)
        objects[body.name] = _object(body, product)
        images[body.name] = {
            "kind": "object", "object": body.name, "laser": f"images/{body.name}.png",
            "plain": f"images_plain/{body.name}.png", "truth": f"truth/{body.name}.npz",
        }  # fmt: skip
        print(f"{name}: {body.name}, {time.perf_counter() - begin:.0f} s", flush=True)
    told = maker.whole.calibration_truth(seed)
    truth = _truth_json(name, scene, told, images, objects, maker.name, seed)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
    _write_yaml(folder, name, scene, bodies)
    print(f"{folder}: {len(bodies)} products, {time.perf_counter() - begin:.0f} s", flush=True)


class _Maker:
    """What a rig is made by: its images, and their truth as columns of a `truth/*.npz` file."""

    def __init__(self, name: str, scene: dict[str, Any], samples: int) -> None:
        self.name, self.scene, self.samples = name, scene, samples
        self._stage = discover().load(discover().find("simulator", name))
        laser, camera = scene["laser"], scene["camera"]
        white = laser["peak_e_per_ms"] * camera["exposure_ms"] * camera["gain_dn_per_e"] * max(laser["power"])
        exposure_ms = camera["exposure_ms"] * min(1.0, _EXPOSED_GREY / (_BOARD_WHITE * white))
        none = {"product": {"family": "none"}}
        self.whole = self.make(none)
        self.dimmed = self.make(none | {"camera": {**camera, "exposure_ms": exposure_ms}})

    def make(self, change: dict[str, Any]) -> Any:
        """Make the simulator of the scene, changed."""
        options = self.scene | change
        if self.name == "mitsuba":
            return self._stage(self._stage.Options.model_validate(options | {"samples": self.samples}))
        for part, own in _OWN_KEYS.items():
            options[part] = {key: value for key, value in options[part].items() if key not in own}
        return self._stage(self._stage.Options.model_validate(options))

    def calibration_truth(self, kind: str, pose: str, seed: int) -> dict[str, Any]:
        """Give the columns of a calibration image's truth."""
        if self.name == "mitsuba":
            bodies = self.whole.target_bodies(kind, f"{pose}_laser", seed)
            return _columns(self.whole.camera, self.whole.fan, bodies)
        from roemetry_simulate.ray_caster import stripe_centres
        from roemetry_simulate.scene import rig_of
        from roemetry_simulate.targets import target_solid

        rig = rig_of(self.whole.options)
        solid = target_solid(self.whole.options, kind, pose, seed)
        found = stripe_centres(rig.camera, rig.laser, solid)
        return _flat(found.x_px, found.xyz_mm, found.on_product, found.hits)

    def calibration_frame(self, kind: str, view: str, seed: int, *, bright: bool) -> Frame:
        """Take a calibration image; white targets under the laser with a shorter exposure, as users do."""
        frame: Frame = (self.dimmed if bright else self.whole).calibration_frames(seed)[kind][view]
        return frame

    def body(self, body: Body, seed: int) -> tuple[tuple[Frame, ...], ProductTruth, dict[str, Any]]:
        """Take a product's images; give them with its truth and the columns of its stripes."""
        made = self.make({"product": {"family": body.family, "options": dict(body.options)}})
        taken = made.simulate(0, seed)
        if self.name == "mitsuba":
            columns = _columns(made.camera, made.fan, [one.body for one in made.placed(0, seed)])
        else:
            x, seen = taken.truth.stripes.x_px, np.isfinite(taken.truth.stripes.x_px)
            label = np.where(seen, taken.truth.stripes.on_product, -1)
            columns = _flat(x, taken.truth.stripes.xyz_mm, label, seen)
        return taken.frames, taken.truth.products[0], columns


def _columns(camera: Any, fan: Any, bodies: list[Any]) -> dict[str, Any]:
    """The truth of `roemetry_mitsuba.truth`, further solutions of a row beside the first."""
    from roemetry_mitsuba.truth import crossings

    found = crossings(camera, fan, bodies)
    record, rest = found.record(), ~found.first()
    nsol = np.zeros(found.shape, dtype=np.uint8)
    np.add.at(nsol, (found.stripe, found.row), 1)
    columns = _flat(record.x_px, record.xyz_mm, np.minimum(record.product, 1), nsol)
    return columns | {
        "extra_row": found.row[rest].astype(np.int16), "extra_stripe": found.stripe[rest].astype(np.int16),
        "extra_x": found.x_px[rest], "extra_X": found.xyz_mm[rest].astype(np.float32),
        "extra_label": np.minimum(found.label[rest], 1).astype(np.int8),
    }  # fmt: skip


def _flat(x: Floats, xyz: Floats, label: Any, nsol: Any) -> dict[str, Any]:
    """Columns by (row, stripe), without further solutions."""
    return {
        "x": np.ascontiguousarray(x.T), "X": np.ascontiguousarray(xyz.transpose(1, 0, 2), dtype=np.float32),
        "label": np.ascontiguousarray(label.T, dtype=np.int8),
        "nsol": np.ascontiguousarray(nsol.T, dtype=np.uint8),
        "extra_row": np.zeros(0, np.int16), "extra_stripe": np.zeros(0, np.int16), "extra_x": np.zeros(0),
        "extra_X": np.zeros((0, 3), np.float32), "extra_label": np.zeros(0, np.int8),
    }  # fmt: skip


def _object(body: Body, product: ProductTruth) -> dict[str, Any]:
    words = {"dented": "dent", "several-dents": "dent", "bent": "bend", "s-bent": "bend", "twisted": "twist",
             "folded": "fold", "broken": "broken"}  # fmt: skip
    figures = {name: None if math.isnan(value) else value for name, value in product.figures.items()}
    cls = body.cls
    return {
        "volume_mm3": product.true_mm3, "mass_g_at_1p1": 1.1e-3 * product.true_mm3,
        "topview_volume_mm3": product.visible_mm3, "footprint_mm2": figures.get("footprint_mm2"),
        "max_height_mm": figures.get("height_mm"), "cls": cls, "defect": words.get(product.defect),
        "family": body.family,
        "figures": figures,
    }  # fmt: skip


def _truth_json(
    name: str, scene: Mapping[str, Any], told: Mapping[str, Any], images: dict[str, Any],
    objects: dict[str, Any], maker: str, seed: int,
) -> dict[str, Any]:  # fmt: skip
    rig, camera, laser = told["rig"], scene["camera"], scene["laser"]
    to_belt = np.array(rig["T_belt_camera"])
    rotation, centre = to_belt[:3, :3].T, to_belt[:3, 3]
    planes = np.array(rig["planes"]) * [1.0, 1.0, 1.0, -1.0]
    in_camera = np.column_stack([planes[:, :3] @ rotation.T, planes[:, 3] + planes[:, :3] @ centre])
    for label, image in images.items():
        if image["kind"] == "charuco":
            image["kind"] = "board"
            name_there = "on_belt" if label == "board_00" else label.replace("board", "pose")
            pose = np.array(told["charuco"]["T_belt_board"][name_there])
            image |= {"R_board_to_belt": pose[:3, :3].tolist(), "t_board_to_belt": pose[:3, 3].tolist()}
    return {
        "rig": name, "units": "mm", "maker": maker, "seed": seed,
        "frames": {
            "belt": "right handed; x along the image's columns, y up the image, z up; belt at z = 0",
            "camera": "OpenCV: x right, y down, z forward; X_cam = R X_belt + t",
            "pixel": "integer coordinates are pixel centres",
            "plane": "n . X + d = 0, |n| = 1, n_x > 0 in the belt frame",
        },
        "camera": {
            "width": camera["width_px"], "height": camera["height_px"], "K": rig["camera_matrix"],
            "dist_k1k2p1p2k3": rig["distortion"] or [0.0] * 5, "R_belt_to_cam": rotation.tolist(),
            "t_belt_to_cam": (-rotation @ centre).tolist(), "centre_belt": centre.tolist(),
            "psf_sigma_px": camera["blur_sigma_px"],
        },
        "laser": {
            "n_stripes": len(planes), "projector_centre_belt": list(rig["projector_mm"]),
            "planes_belt": planes.tolist(),
            "planes_cam": in_camera.tolist(), "sigma_mm": [0.25 * laser["line_width_mm"]] * len(planes),
            "relative_power": laser["power"],
            "angle_to_vertical_deg": np.degrees(np.arctan(-planes[:, 2] / planes[:, 0])).tolist(),
            "order": "index 0 = smallest belt x",
        },
        "block": dict(told["block"]), "staircase": dict(told["staircase"]), "images": images,
        "objects": objects,
        "scene": dict(scene),
    }  # fmt: skip


def _write_yaml(folder: Path, name: str, scene: Mapping[str, Any], bodies: list[Body]) -> None:
    camera, board, block = scene["camera"], scene["targets"]["board"], scene["targets"]["block"]
    sensor = {
        "gain_grey_per_electron": round(camera["gain_dn_per_e"], 6),
        "read_noise_grey": round(camera["read_noise_e"] * camera["gain_dn_per_e"], 4),
    }
    stripes = len(scene["laser"]["belt_x_mm"])
    listed = [f"calibration/board_{k:02d}_{{}}.png" for k in range(1, board["poses"] + 1)]
    _yaml(folder / "block.yaml", {
        "kind": "block", "name": "block", "length_mm": block["length_mm"], "width_mm": block["width_mm"],
        "height_mm": block["height_mm"], "tolerance_mm": 0.02,
    })  # fmt: skip
    _yaml(folder / "block_rig.yaml", {
        "roemetry_rig": 1, "name": f"{name}, block", "stripes": stripes, "sensor": sensor,
        "working_distance_mm": round(camera["distance_mm"], 1), "target": "block.yaml",
        "images": {"block": ["calibration/block_laser.png"], "belt": ["calibration/empty_laser.png"]},
        "extractor": {"use": "dominant-peak", "options": {"threshold": 15, "start": "lowest"}},
        "calibrator": "block-linear",
    })  # fmt: skip
    _yaml(folder / "boards.yaml", {
        "roemetry_rig": 1, "name": name, "stripes": stripes, "sensor": sensor,
        "board": {
            "kind": "charuco", "name": "board", "columns": board["columns"], "rows": board["rows"],
            "pitch_mm": board["square_mm"], "marker_mm": board["marker_mm"], "dictionary": "DICT_4X4_250",
            "thickness_mm": board["thickness_mm"], "tolerance_mm": 0.05, "flatness_mm": 0.02,
        },
        "images": {
            "belt": ["calibration/empty_laser.png"], "board": [path.format("plain") for path in listed],
            "board_laser": [path.format("laser") for path in listed],
            "board_on_belt": ["calibration/board_00_plain.png"],
            "board_on_belt_laser": ["calibration/board_00_laser.png"],
        },
        "extractor": "maximum-likelihood",
        "calibrator": {"use": "pinhole-plane", "options": {"height_max_mm": 40}},
    })  # fmt: skip
    for file, outliner in (
        ("with_outline.yaml", "edge-contour"),
        ("laser_outline.yaml", {"use": "edge-contour", "options": {"light": "laser"}}),
    ):
        source: dict[str, Any] = {"path": "images", "sensor": sensor}
        if file == "with_outline.yaml":
            source["options"] = {"plain": "../images_plain/{id}.png"}
        _yaml(folder / file, {
            "roemetry": 1, "product": name, "source": source, "calibration": "calibration.yaml",
            "uncertainty": "linear",
            "stages": {
                "extractor": "maximum-likelihood", "coder": "planes", "triangulator": "pinhole-plane",
                "outliner": outliner,
                "volume": {
                    "use": "outline-surface",
                    "options": {"underside": "rounded", "true_share": 0.884, "true_share_std": 0.053},
                },
                "weigher": {"use": "density", "options": {"density_g_per_cm3": 1.1,
                "density_std_g_per_cm3": 0.01}},
                "classifier": {"use": "learned", "options": {"model": "../classifier.json"}},
            },
            "sinks": ["csv", "report"],
        })  # fmt: skip


def _yaml(path: Path, data: dict[str, Any]) -> None:
    path.write_text(dump(data), encoding="utf-8")


def _save(path: Path, frame: Frame) -> None:
    good, data = cv2.imencode(".png", frame.pixels)
    if not good:
        raise OSError(f"{path}: cannot be encoded")
    save_bytes(path, bytes(data.tobytes()))


def _save_truth(path: Path, columns: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **columns)
