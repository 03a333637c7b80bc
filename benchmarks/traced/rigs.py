"""Families of rigs that a skein is traced on; each seed draws its own rig of the family."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from benchmarks.coded import CodingRig, dense_rig, easy_rig
from benchmarks.volume_scenes import rig_of

_NOISE_PX = 0.08
_HEIGHTS_MM = (-1.0, 26.0)


def recipe_like(seed: int) -> CodingRig:
    """About the rig of the recipe `herring_roe`: distance 300 to 340 mm, laser on either side."""
    return easy_rig(seed)


def farther(seed: int) -> CodingRig:
    """Another design: camera 270 to 420 mm above the belt, other lenses, tilts, and projector places."""
    rig = rig_of(seed)
    return CodingRig("farther", rig.camera, rig.laser, _NOISE_PX, _HEIGHTS_MM)


def dense(seed: int) -> CodingRig:
    """Quite another: 21 stripes 5 mm apart, wide angle, near, with three times the noise."""
    return dense_rig(seed)


RIGS: Mapping[str, Callable[[int], CodingRig]] = {
    "recipe-like": recipe_like,
    "farther": farther,
    "dense": dense,
}
