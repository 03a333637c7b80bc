"""What is known to be hard, a small scene each; every scene is the same in every run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.coded.samples import Damage, Sample, sample_from
from benchmarks.coded.scenes import (
    CodingRig,
    Crossings,
    crossings_of,
    dense_rig,
    easy_rig,
    grown,
    side_by_side,
    skein,
)
from roemetry_simulate.products.artefacts import SphereOptions, WedgeOptions, sphere, wedge
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.herring import build, draw
from roemetry_simulate.solid import Block, GriddedSolid, Solid

_SEED = 424242


def broken_stripes() -> Sample:
    """Fourteen breaks of 2–25 rows along the stripes."""
    return _lying(easy_rig(), skein(11, "healthy"), Damage(gaps=14))


def grazed_stripes() -> Sample:
    """A cap 3 mm high whose rim is all slope: one stripe only grazes it."""
    return _lying(easy_rig(), sphere(SphereOptions(radius_mm=60.0, height_mm=3.0), Pose(7.0, 1.0, 0.0)))


def hidden_body() -> Sample:
    """A stripe is interrupted on the belt and nothing of it is seen on the product."""
    return _without(lambda true: (true.stripe == 4) & true.on_product)


def hidden_belt() -> Sample:
    """A stripe is seen on the product only: its belt is covered on both sides."""
    return _without(lambda true: (true.stripe == 4) & ~true.on_product)


def smooth_tail() -> Sample:
    """A wedge that rises from the belt along the stripes, without a step or a break."""
    lying = wedge(WedgeOptions(length_mm=55.0, width_mm=50.0, high_height_mm=15.0), Pose(0.0, 0.0, -90.0))
    return _lying(easy_rig(), lying)


def leaving_the_image() -> Sample:
    """Fifteen stripes that are wider than the image: outer ones run out of it, or are pushed out."""
    return _lying(easy_rig(planes=15), Block(118.0, 30.0, 14.0, yaw_deg=3.0))


def past_the_neighbour() -> Sample:
    """A flat block lifts every stripe by 1.56 spacings, past its neighbour's rest line."""
    return _lying(easy_rig(displacement=1.9, planes=13), Block(70.0, 35.0, 16.4, yaw_deg=4.0))


def on_the_neighbour() -> Sample:
    """A flat block lifts every stripe by one spacing, onto its neighbour's rest line."""
    rig = easy_rig(displacement=1.3)
    height_mm = 20.0 / rig.displacement_spacings(20.0)
    return _lying(rig, Block(70.0, 35.0, height_mm))


def crossing_twice() -> Sample:
    """A skein bent into a C, open to one side: stripes cross both of its arms."""
    record = replace(draw(21, "bent"), bend_deg=165.0, yaw_deg=88.0, length_mm=108.0, width_mm=18.0)
    return _lying(easy_rig(), build(record, 0.25).solid)


def specular_blobs() -> Sample:
    """Six bright spots on the product."""
    return _lying(easy_rig(), skein(14, "twisted"), Damage(blobs=6))


def second_reflections() -> Sample:
    """Three pieces of stripes are seen twice."""
    return _lying(easy_rig(), skein(15, "folded"), Damage(ghosts=3))


def two_products() -> Sample:
    """Two short skeins side by side, a gap of belt between them."""
    return _lying(easy_rig(), side_by_side(_short(31), _short(32), 27.0))


def two_products_on_one_stripe() -> Sample:
    """Two narrow skeins one above the other: every stripe crosses both."""
    one, other = _short(33, yaw_deg=0.0, width_mm=20.0), _short(34, yaw_deg=0.0, width_mm=20.0)
    pair = side_by_side(replace(one, y0_mm=one.y0_mm - 20.0), replace(other, y0_mm=other.y0_mm + 20.0), 4.0)
    return _lying(easy_rig(), pair)


def dirt_on_the_belt() -> Sample:
    """Twelve specks that glow, and forty single false peaks."""
    return _lying(easy_rig(), skein(17, "dented"), Damage(dirt=12, false_peaks=40))


def cut_by_the_image_edge() -> Sample:
    """A skein that reaches out of the image at its side and at its top."""
    lying = skein(18, "healthy")
    assert isinstance(lying, GriddedSolid)
    return _lying(easy_rig(), replace(lying, x0_mm=lying.x0_mm + 40.0, y0_mm=lying.y0_mm + 38.0))


def lost_belt() -> Sample:
    """The belt above the product is missing on four stripes of five."""
    return _lying(easy_rig(4), skein(19, "healthy"), Damage(belt_lost="above"))


def a_dead_stripe() -> Sample:
    """A stripe amid the product has no light."""
    return _without(lambda true: true.stripe == 5)


def dense_and_displaced() -> Sample:
    """Twenty-one stripes displaced by up to 2.2 spacings, wide angle, speckle."""
    return _lying(dense_rig(1), grown(skein(3, "bent"), 1.5))


def a_step_of_one_spacing() -> Sample:
    """A block beside bare belt whose lifted stripes lie where the neighbours' belt ends."""
    rig = easy_rig(7)
    return _lying(rig, Block(44.0, 30.0, 20.0 / rig.displacement_spacings(20.0), centre_x_mm=20.0))


CASES: Mapping[str, Callable[[], Sample]] = {
    case.__name__: case
    for case in (
        broken_stripes, grazed_stripes, hidden_body, hidden_belt, smooth_tail, leaving_the_image,
        past_the_neighbour, on_the_neighbour, crossing_twice, specular_blobs, second_reflections,
        two_products, two_products_on_one_stripe, dirt_on_the_belt, cut_by_the_image_edge,
        lost_belt, a_dead_stripe, dense_and_displaced, a_step_of_one_spacing,
    )
}  # fmt: skip
"""Every case, by name."""


def _lying(rig: CodingRig, solid: Solid, damage: Damage | None = None) -> Sample:
    """Trace a product where it lies; nothing is moved."""
    return sample_from(rig, crossings_of(rig.camera, rig.laser, solid), damage, seed=_SEED)


def _without(lost: Callable[[Crossings], NDArray[np.bool_]]) -> Sample:
    """Lay a skein on the easy rig and take some of its crossings away."""
    rig = easy_rig()
    true = crossings_of(rig.camera, rig.laser, skein(12, "healthy"))
    keep = ~lost(true)
    left = Crossings(*(values[keep] for values in true))
    return sample_from(rig, left, seed=_SEED)


def _short(seed: int, yaw_deg: float = 30.0, width_mm: float = 24.0) -> GriddedSolid:
    """Make a skein of half the usual length."""
    record = replace(
        draw(seed, "healthy"), length_mm=44.0, width_mm=width_mm, yaw_deg=yaw_deg, centre_x_mm=0.0,
        centre_y_mm=0.0, bend_deg=0.0,
    )  # fmt: skip
    return build(record, 0.25).solid
