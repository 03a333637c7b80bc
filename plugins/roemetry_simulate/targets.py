"""Images for calibration: empty belt, block, staircase, and flat boards with the laser on and off."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from roemetry.records import Frame
from roemetry_simulate.boards import board_picture, board_solid, picture_from, poses
from roemetry_simulate.products.artefacts import StaircaseOptions, staircase
from roemetry_simulate.products.family import Pose
from roemetry_simulate.render import Rig, render
from roemetry_simulate.scene_file import RayCasterOptions
from roemetry_simulate.scene_rig import surface_of
from roemetry_simulate.solid import Block, EmptyBelt, Solid
from roemetry_simulate.surface import Surface

BOARDS = ("charuco", "chessboard")


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
            self._names[kind] = tuple(
                f"pose_{number:02d}_{light}"
                for number in range(1, boards + 1)
                for light in ("plain", "laser")
            )

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
            number, plain = int(name.split("_")[1]), name.endswith("plain")
            seed = self._seed + 10 + 2 * number + int(plain)
            solid, surface = self._board(kind, number - 1)
        else:
            solid, surface = self._lying(kind), self._matt(seed)
            if kind == "belt":
                surface = surface_of(self._scene, seed)
        pixels = render(self._rig, solid, surface, seed=seed, plain=plain, samples=self._scene.samples)
        return Frame(
            pixels, role="plain" if plain else "laser", name=name, bit_depth=self._scene.camera.bit_depth
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

    def _board(self, kind: str, number: int) -> tuple[Solid, Surface]:
        part = self._scene.targets.board
        pose = poses(part, self._seed)[number]
        matt = self._matt(self._seed)
        decal = (board_picture(part, kind), picture_from(part, pose))
        even = np.stack([matt.texture[..., 0], np.ones(matt.texture.shape[:2])], axis=-1)
        return board_solid(part, pose), replace(matt, texture=even, decal=decal)

    def _matt(self, seed: int) -> Surface:
        """Belt as it is, target matt and even."""
        surface = surface_of(self._scene, seed)
        texture = 1.0 + 0.35 * (surface.texture - 1.0)
        laser, plain = (surface.laser_albedo[0], 0.60), (surface.plain_albedo[0], 0.62)
        return replace(
            surface, texture=texture, laser_albedo=laser, plain_albedo=plain, gloss=(0.0, 0.0),
            below=(0.0, 0.0, 0.0),
        )  # fmt: skip


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
