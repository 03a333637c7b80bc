"""Calibration targets in the scene: block, staircase, boards in their poses.

Targets are rendered as products are, but with an even, matt surface. A board is a flat box with its print as
a picture on the upper face. Its poses are drawn from the set's seed: the first one level, the others tilted
in directions spread evenly round, by half of the largest tilt or more, and lifted clear of the
belt. The truth of a set is the rig and each target's place, in the belt frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from roemetry.config.scene_parts import BOARDS, ON_BELT, BoardPart
from roemetry.records import Frame
from roemetry.records import Sensor as Noise
from roemetry.records.cones import touching_planes
from roemetry.stages import Simulator
from roemetry_simulate.optics import LaserFan
from roemetry_simulate.products.artefacts import StaircaseOptions, staircase
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.parts import PartsSolid, plane
from roemetry_simulate.render import Rig, as_stored, render
from roemetry_simulate.scene import RayCasterOptions, rig_of, surface_of
from roemetry_simulate.solid import Block, EmptyBelt, Solid
from roemetry_simulate.surface import Surface

Floats = NDArray[np.float64]

_PX_PER_SQUARE = 80
"""Of the print's raster: finer than any image shows it."""
_BLACK = 0.12
"""Light that ink gives back, of what paper does."""


SceneT = TypeVar("SceneT", bound=RayCasterOptions)


class RigSimulator(Simulator[SceneT]):
    """What simulators of a scene's rig share: the rig, its camera's noise, the still targets."""

    @cached_property
    def rig(self) -> Rig:
        """The rig that the scene describes."""
        return rig_of(self.options)

    def calibration_frames(self, seed: int) -> Mapping[str, Mapping[str, Frame]]:
        """Give the calibration images, by kind and name; each is made when it is asked for."""
        return self.options.targets.views(partial(take_target, self.options, self.rig, seed))

    def sensor(self) -> Noise:
        """Give the noise of the scene's camera."""
        return Noise(self.rig.sensor.grey_per_electron, self.rig.sensor.read_noise_grey)

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Give the true rig and the true places of all targets, as plain values.

        The rig's keys are those of `roemetry.records.view.View`; lengths in mm of the belt frame.
        """
        camera, laser, targets = self.rig.camera, self.rig.laser, self.options.targets
        focal, (cx, cy) = camera.focal_length_px, camera.principal_px.tolist()
        return {
            "rig": {
                "image_size": [camera.height_px, camera.width_px],
                "camera_matrix": [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]],
                "distortion": list(camera.distortion) if camera.distorts else [],
                "T_belt_camera": camera.T_belt_camera.tolist(),
                "projector_mm": laser.projector_mm.tolist(),
                **_light_of(laser),
            },
            **targets.truth(board_poses(targets.board, seed)),
        }


def _light_of(laser: LaserFan) -> dict[str, Any]:
    """Give planes, and cones of circles, as `View` has them."""
    if not len(laser.halves):
        return {"planes": np.column_stack([laser.normals, laser.offsets_mm]).tolist()}
    cones = laser.cones()
    return {"planes": touching_planes(cones, laser.halves[-1, 1:]).tolist(), "cones": cones.tolist()}


def take_target(scene: RayCasterOptions, rig: Rig, seed: int, kind: str, name: str) -> Frame:
    """Take a calibration image by its kind and name; the set's seed is that of noise, texture and poses."""
    plain = kind in BOARDS and name.endswith("plain")
    if kind in BOARDS:
        pose = name.rsplit("_", 1)[0]
        number = 0 if pose == ON_BELT else int(pose.split("_")[1])
        # each image of the set has a noise of its own
        noise_seed = seed + 10 + 2 * number + int(plain)
        surface = _printed(scene, kind, board_poses(scene.targets.board, seed)[pose], seed)
    else:
        noise_seed = seed + ("block", "belt", "staircase").index(kind)
        surface = surface_of(scene, noise_seed) if kind == "belt" else _matt(scene, noise_seed)
    solid = target_solid(scene, kind, name.rsplit("_", 1)[0], seed)
    rays: Any = {"samples": scene.samples, "draft": scene.draft}
    pixels = render(rig, solid, surface, seed=noise_seed, plain=plain, **rays)
    return Frame(
        as_stored(pixels, scene.turn_deg),
        role="plain" if plain else "laser",
        name=name,
        bit_depth=scene.camera.bit_depth,
        sensor=Noise(rig.sensor.grey_per_electron, rig.sensor.read_noise_grey),
    )


def target_solid(scene: RayCasterOptions, kind: str, pose: str, seed: int) -> Solid:
    """Return what lies on the belt in a calibration image; the pose counts for boards alone."""
    targets = scene.targets
    block, stairs = targets.block, targets.staircase
    if kind in BOARDS:
        return board_solid(targets.board, board_poses(targets.board, seed)[pose])
    if kind == "block":
        return Block(*block.model_dump().values())
    if kind == "staircase":
        options = StaircaseOptions.model_validate(stairs.model_dump())
        # it rises along the stripes, so that every stripe meets every step
        return staircase(options, Pose(block.centre_x_mm, block.centre_y_mm, block.yaw_deg + 90.0))
    return EmptyBelt()


def _printed(scene: RayCasterOptions, kind: str, pose: Floats, seed: int) -> Surface:
    """A board's print on its plate, even but for it."""
    matt, part = _matt(scene, seed), scene.targets.board
    # ink gives back some light, paper all
    printed = _BLACK + (1.0 - _BLACK) * part.print_picture(kind, _PX_PER_SQUARE)
    even = np.stack([matt.texture[..., 0], np.ones(matt.texture.shape[:2])], axis=-1)
    return replace(matt, texture=even, picture=(printed, printed, picture_from(part, pose)))


def _matt(scene: RayCasterOptions, seed: int) -> Surface:
    """Belt as it is, target matt and even."""
    surface = surface_of(scene, seed)
    # a target is more even than belt and product: a third of their texture
    texture = 1.0 + 0.35 * (surface.texture - 1.0)
    laser, plain = (surface.laser_albedo[0], 0.60), (surface.plain_albedo[0], 0.62)
    return replace(
        surface, texture=texture, laser_albedo=laser, plain_albedo=plain, gloss=(0.0, 0.0),
        below=(0.0, 0.0, 0.0),
    )  # fmt: skip


def board_poses(part: BoardPart, seed: int) -> dict[str, Floats]:
    """Draw every pose of a board, T_belt_board (4, 4), mm: ``pose_01`` and on, and ``on_belt``.

    The board's own frame is OpenCV's: origin at the outer corner of its first square, x along the columns, y
    along the rows (down in the image), z away from the camera. The first pose is level, the others are tilted
    all ways round; no point of a board lies below the belt. On the belt its middle is at the origin.
    """
    rng = np.random.default_rng([seed, 41])
    size = part.square_mm * np.array([part.columns, part.rows])
    half = 0.5 * part.square_mm * np.array([part.columns + 1.0, part.rows + 1.0])
    found = {}
    for number in range(part.poses):
        # six draws for every pose, used or not: the same seed gives the same poses
        share, turn, jitter, along_x, along_y, up = rng.uniform(-1.0, 1.0, 6)
        tilt_deg = 0.0 if number == 0 else part.tilt_max_deg * (0.75 + 0.25 * share)
        # tilted all ways round, a little off even steps
        way = 2.0 * np.pi * (number + 0.3 * jitter) / max(part.poses - 1, 1)
        # board z looks away from the camera, which is down
        rotation = _turned(tilt_deg, way) @ _about_z(8.0 * turn) @ np.diag([1.0, -1.0, -1.0])
        low, high = part.height_mm
        # so high that its lowest corner clears the belt
        lift_mm = float(np.abs(rotation[2, :2]) @ half) + part.thickness_mm + 0.5
        middle = np.array([4.0 * along_x, 4.0 * along_y, lift_mm + low + 0.5 * (up + 1.0) * (high - low)])
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = middle - rotation[:, :2] @ (0.5 * size)
        found[f"pose_{number + 1:02d}"] = pose
    flat = np.diag([1.0, -1.0, -1.0, 1.0])
    # flat: its middle over the origin
    flat[:3, 3] = -0.5 * size[0], 0.5 * size[1], part.thickness_mm
    return found | {ON_BELT: flat}


def picture_from(part: BoardPart, pose: Floats) -> Floats:
    """Return the (2, 4) matrix that takes a belt point (x, y, z, 1) to the picture's (column, row)."""
    to_board = np.linalg.inv(pose)
    scale = _PX_PER_SQUARE / part.square_mm
    matrix: Floats = np.array(scale * to_board[:2], dtype=np.float64)
    # rows and columns of the print count from the middle of its first pixel; half a square is its margin
    matrix[:, 3] += 0.5 * _PX_PER_SQUARE - 0.5
    return np.ascontiguousarray(matrix)


def board_solid(part: BoardPart, pose: Floats) -> PartsSolid:
    """Return the plate that carries the print on its upper face."""
    x, y, down = pose[:3, 0], pose[:3, 1], pose[:3, 2]
    edge = 0.5 * part.square_mm
    # six planes: both ends along x and y, upper face and back
    limits = [
        (-x, edge), (x, part.columns * part.square_mm + edge), (-y, edge),
        (y, part.rows * part.square_mm + edge), (-down, 0.0), (down, part.thickness_mm),
    ]  # fmt: skip
    origin = pose[:3, 3]
    surfaces = [
        [0.0, *plane((float(n[0]), float(n[1]), float(n[2])), float(n @ origin + limit))]
        for n, limit in limits
    ]
    ends = [
        origin + u * x + v * y + w * down
        for u in (-edge, part.columns * part.square_mm + edge)
        for v in (-edge, part.rows * part.square_mm + edge)
        for w in (0.0, part.thickness_mm)
    ]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    # exact, since a board is a box
    volume = (part.columns + 1) * (part.rows + 1) * part.square_mm**2 * part.thickness_mm
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return PartsSolid(np.array(surfaces), np.nan, volume, np.nan, extent, float(high[2]))


def _turned(tilt_deg: float, way_rad: float) -> Floats:
    """Rotation by a tilt about a level axis in a direction."""
    c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    axis = np.array([np.cos(way_rad), np.sin(way_rad), 0.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turned: Floats = c * np.eye(3) + s * cross + (1.0 - c) * np.outer(axis, axis)
    return turned


def _about_z(angle_deg: float) -> Floats:
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
