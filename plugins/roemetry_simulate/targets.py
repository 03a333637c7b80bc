"""Images for calibration: empty belt, block, staircase, and flat boards with the laser on and off."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.records import Frame
from roemetry.records import Sensor as Noise
from roemetry_simulate.boards import BoardPose, board_picture, board_solid, on_belt, picture_from, poses
from roemetry_simulate.products.artefacts import StaircaseOptions, staircase
from roemetry_simulate.products.family import Pose
from roemetry_simulate.render import Rig, render, turned_back
from roemetry_simulate.scene_file import BoardPart, RayCasterOptions
from roemetry_simulate.scene_rig import surface_of
from roemetry_simulate.solid import Block, EmptyBelt, Solid
from roemetry_simulate.surface import Surface

BOARDS = ("charuco", "chessboard")
ON_BELT = "on_belt"


class TargetViews(Mapping[str, Mapping[str, Frame]]):
    """All calibration images by kind, then name; an image is made when it is asked for.

    Parameters
    ----------
    scene : RayCasterOptions
        Its `targets` say what is seen.
    rig : Rig
        The scene's rig.
    seed : int
        Of noise, texture and the boards' poses.
    """

    def __init__(self, scene: RayCasterOptions, rig: Rig, seed: int) -> None:
        self._scene, self._rig, self._seed = scene, rig, seed
        boards = scene.targets.board.poses
        self._names: dict[str, tuple[str, ...]] = {
            "block": ("block",),
            "belt": ("belt",),
            "staircase": ("staircase",),
        }
        for kind in BOARDS:
            names = [*(f"pose_{number:02d}" for number in range(1, boards + 1)), ON_BELT]
            self._names[kind] = tuple(f"{name}_{light}" for name in names for light in ("plain", "laser"))

    def __getitem__(self, kind: str) -> Mapping[str, Frame]:
        return _Views(self._names[kind], lambda name: self._take(kind, name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def _take(self, kind: str, name: str) -> Frame:
        seed = self._seed + list(self._names).index(kind)
        plain = False
        if kind in BOARDS:
            pose, plain = name.rsplit("_", 1)[0], name.endswith("plain")
            part = self._scene.targets.board
            number = 0 if pose == ON_BELT else int(pose.split("_")[1])
            seed = self._seed + 10 + 2 * number + int(plain)
            solid, surface = self._board(kind, board_poses(part, self._seed)[pose])
        else:
            solid, surface = self._lying(kind), self._matt(seed)
            if kind == "belt":
                surface = surface_of(self._scene, seed)
        pixels = render(self._rig, solid, surface, seed=seed, plain=plain, samples=self._scene.samples)
        sensor = self._rig.sensor
        return Frame(
            turned_back(pixels, self._scene.turn_deg),
            role="plain" if plain else "laser",
            name=name,
            bit_depth=self._scene.camera.bit_depth,
            sensor=Noise(sensor.grey_per_electron, sensor.read_noise_grey),
        )

    def _lying(self, kind: str) -> Solid:
        targets = self._scene.targets
        block, stairs = targets.block, targets.staircase
        if kind == "block":
            return Block(*block.model_dump().values())
        if kind == "staircase":
            options = StaircaseOptions.model_validate(stairs.model_dump())
            # it rises along the stripes, so that every stripe meets every step
            return staircase(options, Pose(block.centre_x_mm, block.centre_y_mm, block.yaw_deg + 90.0))
        return EmptyBelt()

    def _board(self, kind: str, pose: BoardPose) -> tuple[Solid, Surface]:
        part = self._scene.targets.board
        matt = self._matt(self._seed)
        printed = board_picture(part, kind)
        picture = (printed, printed, picture_from(part, pose))
        even = np.stack([matt.texture[..., 0], np.ones(matt.texture.shape[:2])], axis=-1)
        return board_solid(part, pose), replace(matt, texture=even, picture=picture)

    def _matt(self, seed: int) -> Surface:
        """Belt as it is, target matt and even."""
        surface = surface_of(self._scene, seed)
        texture = 1.0 + 0.35 * (surface.texture - 1.0)
        laser, plain = (surface.laser_albedo[0], 0.60), (surface.plain_albedo[0], 0.62)
        return replace(
            surface, texture=texture, laser_albedo=laser, plain_albedo=plain, gloss=(0.0, 0.0),
            below=(0.0, 0.0, 0.0),
        )  # fmt: skip


def board_poses(part: BoardPart, seed: int) -> dict[str, BoardPose]:
    """Give every pose of a board by name: ``pose_01`` and on, and ``on_belt``."""
    drawn = {f"pose_{number:02d}": pose for number, pose in enumerate(poses(part, seed), start=1)}
    return {**drawn, ON_BELT: on_belt(part)}


def known_beforehand(scene: RayCasterOptions, rig: Rig, seed: int) -> dict[str, Any]:
    """Give the true rig and the true places of all targets, as plain values.

    The rig's keys are those of `roemetry.records.view.View`; lengths in mm of the belt frame.
    """
    camera, laser, targets = rig.camera, rig.laser, scene.targets
    focal, (cx, cy) = camera.focal_length_px, camera.principal_px.tolist()
    planes = np.column_stack([laser.normals, laser.offsets_mm])
    board = targets.board.model_dump(mode="json", exclude={"poses", "tilt_max_deg", "height_mm"})
    lay = {name: pose.T_belt_board.tolist() for name, pose in board_poses(targets.board, seed).items()}
    return {
        "rig": {
            "image_size": [camera.height_px, camera.width_px],
            "camera_matrix": [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]],
            "distortion": list(camera.distortion) if camera.distorts else [],
            "T_belt_camera": camera.T_belt_camera.tolist(),
            "planes": planes.tolist(),
            "projector_mm": laser.projector_mm.tolist(),
        },
        "block": targets.block.model_dump(mode="json"),
        "staircase": targets.staircase.model_dump(mode="json"),
        **{kind: {**board, "T_belt_board": lay} for kind in BOARDS},
    }


class _Views(Mapping[str, Frame]):
    """Images of one kind by name, each made when it is asked for."""

    def __init__(self, names: tuple[str, ...], take: Callable[[str], Frame]) -> None:
        self._names, self._make = names, take

    def __getitem__(self, name: str) -> Frame:
        if name not in self._names:
            raise KeyError(name)
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
