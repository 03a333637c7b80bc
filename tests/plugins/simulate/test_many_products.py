"""Several products in one frame: each with its own truth, shading the others, none touching."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_simulate.optics import fan_through, looking_down
from roemetry_simulate.population import Group, moved
from roemetry_simulate.products.artefacts import SphereOptions, sphere
from roemetry_simulate.products.family import Pose
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.solid import Block
from tests.plugins.simulate.gridded import on_grid

CAMERA = looking_down(160, 120, pixel_size_mm=0.04, focal_length_mm=16.0, distance_mm=320.0)
LASER = fan_through((160.0, 0.0, 300.0), np.arange(-40.0, 41.0, 8.0), sigma_mm=0.3, peak_grey=300.0)


def dome(x_mm: float, y_mm: float, radius_mm: float):
    def u(x, y):
        return radius_mm**2 - (x - x_mm) ** 2 - (y - y_mm) ** 2

    reach = radius_mm + 2.0
    return on_grid(
        (x_mm - reach, x_mm + reach, y_mm - reach, y_mm + reach), 0.25,
        lambda x, y: np.full_like(x, radius_mm), u, u,
    )  # fmt: skip


MEMBERS = {
    "gridded": lambda: (dome(-20.0, 5.0, 12.0), dome(15.0, -8.0, 15.0)),
    "parts": lambda: tuple(sphere(SphereOptions(), Pose(x, y, 0.0)) for x, y in ((-22.0, 5.0), (18.0, -8.0))),
    "blocks": lambda: (Block(30, 20, 8, -20, 5, 10), Block(20, 30, 14, 22, -5, -20)),
}


@pytest.mark.parametrize(
    "kind", ["gridded", *(pytest.param(kind, marks=pytest.mark.thorough) for kind in ("parts", "blocks"))]
)
def test_a_group_is_what_its_members_are(kind: str) -> None:
    members = MEMBERS[kind]()
    group = Group(members)
    together = stripe_centres(CAMERA, LASER, group)
    on_product = together.on_product == 1
    label = np.zeros(on_product.shape, int)
    label[on_product] = group.member_at(together.xyz_mm[on_product])
    for number, member in enumerate(members, start=1):
        mine, alone = label == number, stripe_centres(CAMERA, LASER, member)
        assert mine.sum() > 60
        # where neither hides the other, every centre is that of the member alone
        both = mine & (alone.on_product == 1)
        assert both.sum() > 0.97 * mine.sum()
        np.testing.assert_allclose(together.x_px[both], alone.x_px[both], rtol=0, atol=1e-6)
    assert group.visible_volume_mm3 == pytest.approx(sum(one.visible_volume_mm3 for one in members))
    x, y = np.meshgrid(np.linspace(-50, 50, 81), np.linspace(-40, 40, 81))
    expected = np.fmax(members[0].heights_mm(x, y)[0], members[1].heights_mm(x, y)[0])
    np.testing.assert_array_equal(group.heights_mm(x, y)[0], expected)


def test_one_product_shades_the_other() -> None:
    low, high = Block(20, 30, 5, 0, 0, 0), Block(10, 30, 40, 20, 0, 0)
    alone = stripe_centres(CAMERA, LASER, low)
    shaded = stripe_centres(CAMERA, LASER, Group((low, high)))
    # the projector stands at the right: the tall block keeps its light from the low one
    lit = [np.sum((one.on_product == 1) & (one.xyz_mm[..., 2] < 6.0)) for one in (alone, shaded)]
    assert 0.05 < lit[1] / lit[0] < 0.7


def test_moving_a_solid_moves_its_heights() -> None:
    x, y = np.meshgrid(np.linspace(-40, 40, 41), np.linspace(-40, 40, 41))
    for solid in (
        dome(0.0, 0.0, 12.0),
        sphere(SphereOptions(), Pose(1.0, 2.0, 30.0)),
        Block(20, 12, 5, 1, 2, 30),
    ):
        there = moved(solid, 7.0, -4.0)
        for one, other in zip(there.heights_mm(x + 7.0, y - 4.0), solid.heights_mm(x, y), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
        ends = np.add(solid.footprint_extent_mm(), [7.0, 7.0, -4.0, -4.0])
        np.testing.assert_allclose(there.footprint_extent_mm(), ends, rtol=0, atol=1e-9)


def test_a_frame_of_three(scene) -> None:
    product = {"family": "egg", "in_frame": 3, "gap_mm": 4}
    camera = {"width_px": 200, "height_px": 150, "pixel_size_um": 50}
    stage = scene(camera=camera, laser={"planes": 15}, product=product).make()
    made, again = stage.simulate(2, 5), stage.simulate(2, 5)
    np.testing.assert_array_equal(made.frames[0].pixels, again.frames[0].pixels)
    products, stripes = made.truth.products, made.truth.stripes
    assert len(products) == 3
    middles = [0.5 * (one.figures["x_min_mm"] + one.figures["x_max_mm"]) for one in products]
    assert middles == sorted(middles)
    assert len({one.figures["seed"] for one in products}) == 1
    assert set(np.unique(stripes.product)) == {-1, 0, 1, 2, 3}
    for number, one in enumerate(products, start=1):
        x, y = stripes.xyz_mm[stripes.product == number][:, :2].T
        assert one.figures["x_min_mm"] - 1e-6 <= x.min() <= x.max() <= one.figures["x_max_mm"] + 1e-6
        assert one.figures["y_min_mm"] - 1e-6 <= y.min() <= y.max() <= one.figures["y_max_mm"] + 1e-6
        assert one.figures["left_stripe"] >= 1
