"""Scenes rendered anew by both simulators with camera or laser moved, while the calibration stays.

A motion is given its size in pixels: how far it moves the image, or a stripe, at the image's edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.disturbances import Scene
from roemetry.config.scene import Scene as SceneFile

MAKERS = ("ray-caster", "mitsuba")
_PRODUCTS = {
    "ray-caster": ["simulator.options.product.items=[]"],
    "mitsuba": ["simulator.options.product={family: lofted-skein}"],
}
"""The scene's own products, drawn anew; and what the other maker has like herring roe."""
_BODIES = 2
"""Products rendered of a scene; each is rendered unmoved first."""


class Motion(NamedTuple):
    """A motion of the rig with its sizes, px; `made` gives the changed options of the simulator."""

    unit: str
    low: float
    high: float
    harmless: float
    made: Callable[[Mapping[str, Any], float], dict[str, Any]]


class Moved(NamedTuple):
    """A scene with the motion it was rendered under."""

    scene: Scene
    maker: str
    motion: str
    size: float


def moved_scenes(path: Path, count: int, seed: int, skip: int = 0) -> Iterator[Moved]:
    """Render `count` moved scenes by each maker; before each product's the unmoved one, which is none."""
    from roemetry.stages.registry import discover

    stages = discover()
    for number, maker in enumerate(MAKERS):
        own = SceneFile.load(path, sets=[f"simulator.use={maker}", *_PRODUCTS[maker]])
        options = own.simulator.options.model_dump()
        simulator = stages.load(stages.find("simulator", maker))
        rng = np.random.default_rng([seed, number])
        made = 0
        for body in range(_BODIES):
            for k in range(1 + math.ceil(count / _BODIES)):
                if k and made >= count:
                    break
                name = "none" if k == 0 else str(rng.choice(list(MOTIONS)))
                size = 0.0
                told = options
                if k:
                    motion, made = MOTIONS[name], made + 1
                    size = float(np.exp(rng.uniform(np.log(motion.low), np.log(motion.high))))
                    told = motion.made(options, size * float(rng.choice([-1.0, 1.0])))
                taken = simulator(simulator.Options.model_validate(told)).simulate(body, seed)
                frames = {frame.role: frame.pixels for frame in taken.frames}
                product = taken.truth.products[0]
                scene = Scene(f"{maker}_{body}", frames["laser"], frames.get("plain"), product.visible_mm3)
                yield Moved(scene, maker, name, size)


def _camera(turn: Callable[[float, float], tuple[float, float, float]]) -> Callable[..., dict[str, Any]]:
    """Turn the camera about its own axes by angles (x, y, z) that follow from size and focal length, px."""

    def made(options: Mapping[str, Any], size_px: float) -> dict[str, Any]:
        part = options["camera"]
        focal_px = 1e3 * part["focal_length_mm"] / part["pixel_size_um"]
        angles = turn(size_px / focal_px, size_px / (0.5 * part["width_px"]))
        return {**options, "camera": {**part, "T_belt_camera": _pose(part, np.array(angles), 0.0)}}

    return made


def _nearer(options: Mapping[str, Any], size_px: float) -> dict[str, Any]:
    part = options["camera"]
    share = size_px / (0.5 * part["width_px"])
    return {**options, "camera": {**part, "T_belt_camera": _pose(part, np.zeros(3), share)}}


def _pose(part: Mapping[str, Any], angles: NDArray[np.float64], nearer: float) -> list[list[float]]:
    import cv2

    from roemetry.config.scene_parts import CameraPart
    from roemetry_simulate.scene import camera_of

    known = {name: part[name] for name in CameraPart.model_fields}  # a simulator may know more
    pose = np.array(camera_of(CameraPart.model_validate(known)).T_belt_camera)
    pose[:3, 3] += pose[:3, 2] * nearer * (pose[2, 3] / -pose[2, 2])
    pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(angles)[0]
    return [[float(value) for value in row] for row in pose]


def _px_per_mm(options: Mapping[str, Any]) -> float:
    part = options["camera"]
    return float(1e3 * part["focal_length_mm"] / part["pixel_size_um"] / part["distance_mm"])


def _laser_shifted(options: Mapping[str, Any], size_px: float) -> dict[str, Any]:
    part, shift = options["laser"], size_px / _px_per_mm(options)
    x, y, z = part["projector_mm"]
    feet = [foot + shift for foot in part["belt_x_mm"]]
    return {**options, "laser": {**part, "projector_mm": (x + shift, y, z), "belt_x_mm": feet}}


def _laser_turned(options: Mapping[str, Any], size_px: float) -> dict[str, Any]:
    turn = math.degrees(size_px / (0.5 * options["camera"]["height_px"]))
    part = options["laser"]
    return {**options, "laser": {**part, "yaw_deg": part["yaw_deg"] + turn}}


def _plane_moved(options: Mapping[str, Any], size_px: float) -> dict[str, Any]:
    part = options["laser"]
    feet = list(part["belt_x_mm"])
    feet[len(feet) // 2] += size_px / _px_per_mm(options)
    return {**options, "laser": {**part, "belt_x_mm": feet}}


MOTIONS: dict[str, Motion] = {
    "camera panned (rendered)": Motion("px", 0.03, 6.0, 0.05, _camera(lambda angle, _: (0.0, angle, 0.0))),
    "camera tilted (rendered)": Motion("px", 0.03, 6.0, 0.05, _camera(lambda angle, _: (angle, 0.0, 0.0))),
    "camera turned (rendered)": Motion("px", 0.03, 6.0, 0.05, _camera(lambda _, roll: (0.0, 0.0, roll))),
    "camera nearer or farther (rendered)": Motion("px", 0.03, 6.0, 0.05, _nearer),
    "laser shifted (rendered)": Motion("px", 0.03, 6.0, 0.05, _laser_shifted),
    "laser turned (rendered)": Motion("px", 0.03, 6.0, 0.05, _laser_turned),
    "one plane moved (rendered)": Motion("px", 0.03, 6.0, 0.05, _plane_moved),
}
