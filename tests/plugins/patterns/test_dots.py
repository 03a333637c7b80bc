"""Dots: centres as good as stated, surfaces of known bodies, refusals of recipes, and drawn truth."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry import Recipe
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, StageError
from roemetry.records import Frame, Sensor
from roemetry.records.light import at_height, meet
from roemetry.records.view import View
from roemetry.testing.patterns import DotRig
from roemetry_kernels.rays import meet_rays
from roemetry_patterns.dot_centres import DotCentres
from roemetry_patterns.epipolar_dots import EpipolarDots
from roemetry_patterns.surface_points import beside_neighbours
from roemetry_pinhole.dot_lattice import followed, on_belt
from roemetry_pinhole.dot_rays import _between_neighbours


def test_centres_scatter_as_their_covariance_says(rng: np.random.Generator) -> None:
    rig, over = DotRig(), []
    places = rig.places_px(rig.hill()).reshape(-1, 2)
    light = rig.spots(places, 90.0)
    for _ in range(4):
        noisy = rng.poisson(light / 0.05) * 0.05 + rng.normal(0.0, 0.8, light.shape)
        pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        peaks = DotCentres().extract(Frame(pixels, sensor=Sensor(0.05, 0.8)))
        assert peaks.dots is not None
        found = np.column_stack([peaks.x_px, peaks.dots.y_px])
        own = np.linalg.norm(found[:, None] - places[None], axis=2).argmin(axis=1)
        std = np.sqrt(np.diagonal(peaks.dots.covariance_px2, axis1=1, axis2=2))
        over.append((found - places[own]) / std)
    # dots cover a fifth of this image: the noise of the dark is told a little too large
    assert 0.7 < np.sqrt((np.concatenate(over) ** 2).mean()) < 1.1


def test_a_turned_matrix_is_followed_and_a_wrong_one_refused() -> None:
    rig = DotRig()
    places = rig.places_px(rig.level())
    at = followed(places.reshape(-1, 2)).reshape(rig.stripes, rig.lines, 2)
    assert (at == np.stack(np.indices((rig.stripes, rig.lines)), axis=2)).all()
    with pytest.raises(Exception, match="swapped"):
        on_belt(places.reshape(-1, 2), rig.lines, rig.stripes, "belt")
    with pytest.raises(Exception, match="155 dots"):
        on_belt(places.reshape(-1, 2)[5:-5], rig.stripes, rig.lines, "belt")


def test_dots_beside_every_ray_are_refused_and_not_guessed() -> None:
    rig = DotRig()
    moved = rig.places_px(rig.level()) + np.array([0.0, 4.0])
    with pytest.raises(StageError, match="lie where a ray"):
        EpipolarDots().code(rig.dots(moved), rig.dot_calibration())


def test_two_dots_that_confirm_each_other_alone_have_no_label() -> None:
    """Cut dots at a rim lay on the rays of others, 28 mm too high; each was the other's only witness."""
    rig = DotRig()
    height_mm = rig.hill()
    alone = np.flatnonzero(height_mm[0, :-1] + height_mm[0, 1:] == 0.0)[0]
    height_mm[0, [alone, alone + 1]] = 12.0
    found = EpipolarDots().code(rig.dots(rig.places_px(height_mm)), rig.dot_calibration())
    there = found.seen[0] & np.isin(found.dots.line[0], [alone, alone + 1])
    assert not there.any()
    assert found.seen.sum() == np.isfinite(height_mm).sum() - 2


@pytest.mark.parametrize("pattern", ["dots", "grid"])
def test_stages_and_simulators_for_lines_alone_are_refused(pattern: str) -> None:
    folder = f"recipes/potato_{pattern}"
    for kind, name in (("coder", "planes"), ("triangulator", "pinhole-plane")):
        with pytest.raises(ConfigurationError, match=f"`{name}` is made for lines"):
            Recipe.load(folder, sets=[f"stages.{kind}={{use: {name}}}", "calibration=null"])
    for simulator in ("moving-belt", "mitsuba"):
        with pytest.raises(ConfigurationError, match=pattern):
            Scene.load(f"{folder}/simulated.yaml", sets=[f"simulator.use={simulator}"]).make()


def test_drawn_dots_are_where_the_truth_says() -> None:
    sets = ["simulator.options.product={family: none}", "simulator.options.laser.speckle_contrast=0"]
    sets += ["pattern={kind: dots, lines_x: 5, lines_y: 4, spacing_x_mm: 6}"]
    made = Scene.load("recipes/potato_dots/simulated.yaml", sets=[*sets, "simulator.options.draft=true"])
    item = made.make().simulate(0, 3)
    truth = item.truth.stripes
    assert truth is not None
    peaks = DotCentres().extract(next(frame for frame in item.frames if frame.role == "laser"))
    assert peaks.dots is not None
    assert len(peaks) == np.isfinite(truth.x_px).sum() == 20
    stripe, row = np.nonzero(np.isfinite(truth.x_px))
    places = np.column_stack([truth.x_px[stripe, row], truth.y_px[stripe, row]])
    found = np.column_stack([peaks.x_px, peaks.dots.y_px])
    off = np.linalg.norm(found[:, None] - places[None], axis=2).min(axis=1)
    assert off.max() < 0.1  # px
    # a dot lies in its plane, on the belt
    assert np.abs(truth.xyz_mm[stripe, row, 2]).max() < 1e-9


def test_rays_that_were_not_seen_are_taken_from_those_around_them(rng: np.random.Generator) -> None:
    column, line = np.mgrid[:12.0, :10.0]
    true = np.stack(
        [6.0 * column + 0.01 * column * line, 5.0 * line + 0.02 * line**2, 0.1 - 0.01 * column, -0.01 * line],
        axis=2,
    )
    std = np.array([0.01, 0.01, 2e-4, 2e-4])
    lines = true + std * rng.standard_normal(true.shape)
    own = np.broadcast_to(np.diag(std**2), (12, 10, 4, 4)).copy()
    by_parameter = np.repeat(true[..., None], 2, axis=3)
    places = [(0, 5), (5, 4), (11, 6)]
    for place in places:
        lines[place], own[place], by_parameter[place] = np.nan, np.nan, np.nan
    found, covariance, followed = _between_neighbours(lines, own, by_parameter)
    for place in places:
        assert np.abs((found[place] - true[place]) / np.sqrt(np.diag(covariance[place]))).max() < 4.0
        assert np.abs(followed[place] - true[place][:, None]).max() < 1e-9
        assert (np.sqrt(np.diag(covariance[place])) / std < 1.8).all()
    assert np.array_equal(found[3, 3], lines[3, 3])
    # of too few around one nothing is made
    alone = np.full_like(lines, np.nan)
    alone[:3, :3] = lines[:3, :3]
    assert np.isnan(_between_neighbours(alone, own, by_parameter)[0][8, 8]).all()


def test_false_light_is_told_by_those_around_it(rng: np.random.Generator) -> None:
    x, y = (one.ravel() for one in np.mgrid[-15.0:16.0:5.0, -15.0:16.0:5.0])
    place = np.column_stack([x, y]) + rng.uniform(-0.5, 0.5, (x.size, 2))
    height = np.sqrt(np.maximum(24.0**2 - (place**2).sum(axis=1), 0.0))
    sound = np.column_stack([place, height])
    assert beside_neighbours(sound).all()
    false = sound.copy()
    false[24, 2] += 7.0  # in the middle
    false[[2, 3], 2] -= 25.0  # two together at the rim
    assert np.array_equal(np.flatnonzero(~beside_neighbours(false)), [2, 3, 24])
    # points of two lines leave the quadratic open: nothing is left out for that
    lines = sound[(np.abs(x) < 6.0) & (x != 0.0)]
    assert beside_neighbours(lines).all()


def test_compiled_rays_are_those_of_the_record(rng: np.random.Generator) -> None:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 320.0
    matrix = np.array([[1600.0, 0.0, 319.5], [0.0, 1590.0, 239.5], [0.0, 0.0, 1.0]])
    view = View((480, 640), matrix, pose, np.empty((0, 4)), distortion=np.array([0.05, -0.1, 1e-3, -1e-3]))
    lines = rng.uniform([-40.0, -30.0, 0.2, -0.3], [40.0, 30.0, 0.8, 0.3], (50, 4))
    xy_px = view.project(at_height(lines, rng.uniform(0.0, 40.0, 50))) + rng.normal(0.0, 0.1, (50, 2))
    own = np.tile(np.diag([1e-4, 1e-4, 1e-8, 1e-8]), (50, 1, 1)) * rng.uniform(0.5, 2.0, (50, 1, 1))
    noise = np.tile([[0.02, 0.006], [0.006, 0.01]], (50, 1, 1))
    noise[3] = np.nan
    lines[5, 0] = np.nan
    given = view, lines, xy_px, noise, own
    for one, other in zip(meet_rays(*given), meet(*given), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11)
