"""Grids: crossings, labels that the other family tells, one camera of two families, a recipe, refusals."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry import Recipe
from roemetry.config.scene import Scene
from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Sensor
from roemetry.records.calibration import Calibration
from roemetry.testing.scenes import GridRig, frame_of
from roemetry_coding.grid import GridPlanes, _asked_again, _Families, _followed, _with_thin_parts
from roemetry_coding.planes import PlanesOptions, coded_by_planes
from roemetry_patterns.dot_surface import DotSurface
from roemetry_patterns.surface_points import points_of as surface_points_of
from roemetry_patterns.surface_points import pooled, rows_pooled, same_points_of
from roemetry_peaks import grid_lines
from roemetry_peaks.grid_lines import GridLines
from roemetry_pinhole.grid import ACROSS, _turning, turned_parameters
from roemetry_pinhole.pinhole_plane import points_of, view_of
from roemetry_simulate.optics import turned
from roemetry_simulate.scene import camera_of

GRID = Path("recipes/potato_grid")


def test_peaks_at_crossings_scatter_no_more_than_they_say(rng: np.random.Generator) -> None:
    rig = GridRig()
    heights = rig.hill()
    light = rig.grid_light(heights, 100.0)
    speckled = light * (1.0 + 0.05 * rng.standard_normal(light.shape))
    peaks = GridLines().extract(replace(frame_of(speckled, noise=1.0), sensor=Sensor(0.02, 1.0)))
    assert peaks.across is not None
    crossing = np.abs(rig.across.x_px(heights[1]).mean(axis=1)[:, None] - peaks.row).min(axis=0) < 3.0
    off = peaks.x_px - rig.x_px(heights[0])[:, peaks.row]
    off = off[np.abs(off).argmin(axis=0), np.arange(len(peaks))]
    assert np.abs(off).max() < 1.0  # px
    assert np.sqrt((off[crossing] ** 2).mean()) < 0.2
    # a peak at a crossing is said to be less sure
    assert np.median(peaks.x_std_px[crossing]) > 1.5 * np.median(peaks.x_std_px[~crossing])


def test_a_run_that_was_refused_is_labelled_by_the_lines_it_crosses() -> None:
    rig = GridRig()
    heights, calibration = rig.hill(), rig.grid_calibration()
    peaks, true = rig.grid_peaks(heights, 0.0), rig.grid_map(heights)
    assert calibration.across is not None and true.across is not None
    gone = np.zeros(true.x_px.shape, np.bool_)
    gone[3] = True
    label = np.where(true.peak_stripe == 3, AMBIGUOUS, true.peak_stripe).astype(np.int16)
    nan = np.where(gone, np.nan, 1.0)
    open_ = replace(
        true,
        x_px=true.x_px * nan,
        product=np.where(gone, -1, true.product).astype(np.int16),
        seen=true.seen & ~gone,
        ambiguous=gone,
        peak_stripe=label,
    )
    again = _asked_again(open_, peaks, true.across, _Families(calibration, calibration.across))
    assert (again.peak_stripe == true.peak_stripe).all()
    assert np.abs(again.x_px - true.x_px).max() < 1e-9
    assert (again.product[3] == 1).all() and not again.ambiguous.any()
    # one crossing alone decides nothing
    one = (np.arange(rig.lines) == 2)[:, None]
    product = np.where(one, true.across.product, -1).astype(np.int16)
    x_px = np.where(one, true.across.x_px, np.nan)
    single = replace(true.across, x_px=x_px, product=product, seen=true.across.seen & one)
    kept = _asked_again(open_, peaks, single, _Families(calibration, calibration.across))
    assert (kept.peak_stripe == label).all()


def test_refused_peaks_that_go_on_where_a_line_ends_are_its_own_up_to_the_rest_line() -> None:
    rig = GridRig()
    heights = rig.hill()
    peaks, true = rig.grid_peaks(heights, 0.0), rig.grid_map(heights)
    off_px = np.abs(true.x_px[3] - true.rest_px[3])
    first = int(np.flatnonzero(off_px > 1.5)[0])
    gone = np.zeros(true.x_px.shape, np.bool_)
    gone[3, : first + 8] = True
    label = true.peak_stripe.copy()
    label[(label == 3) & (peaks.row < first + 8)] = AMBIGUOUS
    nan = np.where(gone, np.nan, 1.0)
    open_ = replace(
        true,
        x_px=true.x_px * nan,
        product=np.where(gone, -1, true.product).astype(np.int16),
        seen=true.seen & ~gone,
        peak_stripe=label,
    )
    found = _followed(open_, peaks)
    assert np.array_equal(np.flatnonzero(found.seen[3] & ~open_.seen[3]), np.arange(first, first + 8))
    assert np.nanmax(np.abs(found.x_px - true.x_px)) < 1e-9
    # another peak as near could be meant as well
    row, beside = int(first + 7), true.x_px[3, first + 7] + 2.0
    at = int(np.searchsorted(peaks.row * 1e4 + peaks.x_px, row * 1e4 + beside))
    names = ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags")
    two = {name: np.insert(getattr(peaks, name), at, getattr(peaks, name)[at - 1]) for name in names}
    two["x_px"][at] = beside
    doubtful = replace(open_, peak_stripe=np.insert(label, at, AMBIGUOUS).astype(np.int16))
    kept = _followed(doubtful, replace(peaks, **two))
    assert not kept.seen[3, row]


def test_a_line_that_ends_behind_a_crossing_is_taken_away_there() -> None:
    rig = GridRig()
    flat = np.zeros((rig.stripes, rig.rows)), np.zeros((rig.lines, rig.columns))
    light = rig.grid_light(flat, 100.0)
    alone = rig.light(rig.x_px(flat[0]), 100.0)
    line_px = rig.across.x_px(flat[1])[2].mean()
    end = int(rig.x_px(flat[0])[3].mean()) + 2  # the line across ends two pixels behind the stripe
    rows = slice(int(line_px) - 12, int(line_px) + 13)
    light[rows, end:] = alone[rows, end:]
    peaks = GridLines().extract(frame_of(light, noise=0.5))
    near = (np.abs(peaks.row - line_px) < 6.0) & (np.abs(peaks.x_px - end + 2) < 4.0)
    assert near.sum() == np.count_nonzero(np.abs(np.arange(rig.rows) - line_px) < 6.0)  # one in each row
    assert np.abs(peaks.x_px[near] - rig.x_px(flat[0])[3, peaks.row[near]]).max() < 0.3


@pytest.mark.parametrize("lines_apart", [2, 3])
def test_lines_farther_apart_label_nearly_all_peaks_and_none_wrongly(lines_apart: int) -> None:
    rig = GridRig()
    heights = rig.hill()
    peaks, calibration = rig.grid_peaks(heights, 0.0), rig.grid_calibration()
    found = coded_by_planes(peaks, calibration, PlanesOptions(), lines_apart=lines_apart)
    labelled = found.peak_stripe >= 0
    true = rig.grid_map(heights).peak_stripe
    assert labelled.mean() > 0.99
    assert np.array_equal(found.peak_stripe[labelled], true[labelled])


def test_a_grid_under_another_calibration_is_refused() -> None:
    rig = GridRig()
    calibration = rig.grid_calibration()
    assert calibration.across is not None
    across = replace(calibration.across, rest_px=calibration.across.rest_px + np.array([9.0, 0.0]))
    with pytest.raises(StageError, match="lines across: "):
        GridPlanes().code(rig.grid_peaks(rig.hill()), replace(calibration, across=across))


def test_turned_parameters_say_the_same_of_the_turned_image() -> None:
    calibration = Calibration.load(GRID / "calibration.yaml")
    columns, lines = calibration.image_size[1], len(calibration.parameters[ACROSS])
    parameters = {**calibration.parameters, "distortion": np.array([-0.1, 0.2, 3e-3, -2e-3, 0.1, 0, 0, 0])}
    line, x, y = np.array([0, 4, 10]), np.array([100.0, 320.0, 500.0]), np.array([50.0, 200.0, 400.0])
    upright = {**parameters, "planes_per_mm": parameters[ACROSS]}
    other = turned_parameters(parameters, columns)
    one, two = points_of(upright, line, x, y), points_of(other, line, y, columns - 1.0 - x)
    assert np.abs(one[:, 2] - two[:, 2]).max() < 1e-9  # mm
    back = _turning(lines, columns)
    flat = np.concatenate([other[name].ravel() for name in upright if name in other])
    given = np.concatenate([upright[name].ravel() for name in upright if name != ACROSS])
    assert np.abs(back[:, :-1] @ flat + back[:, -1] - given).max() < 1e-9


def test_the_drawn_camera_turns_with_its_image() -> None:
    scene = Scene.load(GRID / "simulated.yaml").make()
    camera = camera_of(scene.options.camera)
    camera = replace(camera, distortion=(-0.1, 0.2, 3e-3, -2e-3, 0.1), principal_point_px=(300.0, 250.0))
    points = np.array([[20.0, -10.0, 5.0], [-40.0, 30.0, 25.0]])
    x, y = camera.project(points).T
    assert np.abs(turned(camera).project(points) - np.column_stack([y, 639.0 - x])).max() < 1e-9


def test_the_recipe_finds_the_volume() -> None:
    laser, plain = (
        cv2.imread(str(GRID / folder / "potato_02.png"), cv2.IMREAD_UNCHANGED)
        for folder in ("images", "images_plain")
    )
    assert laser is not None
    (product,) = Recipe.load(GRID, sets=["uncertainty=none"]).measure(laser, plain=plain)
    assert product.volume is not None
    # the truth of the item, to 0.5 %
    assert product.volume.visible_mm3.value == pytest.approx(105597.0, rel=0.005)


def test_a_cross_hair_shows_a_position_and_no_volume(tmp_path: Path) -> None:
    sets = ["pattern={kind: cross-hair}", "simulator.options.draft=true"]
    scene = Scene.load(GRID / "simulated.yaml", sets=sets).make()
    truth = scene.simulate(0, 41)
    path = tmp_path / "calibration.yaml"
    _of_one_and_one(Calibration.load(GRID / "calibration.yaml")).save(path)
    recipe = Recipe.load(GRID, sets=["uncertainty=none", f"calibration={path}"])
    laser, plain = (
        next(frame.pixels for frame in truth.frames if frame.role == role) for role in ("laser", "plain")
    )
    (product,) = recipe.measure(laser, plain=plain)
    assert product.volume is None
    said = str(product.absent["volume"])
    assert "2 of the lines lie on the product" in said and "its position is" in said
    assert truth.truth.stripes is not None
    place, on = truth.truth.stripes.xyz_mm, truth.truth.stripes.on_product
    low, high = place[on].min(axis=0), place[on].max(axis=0)
    found = [float(number) for number in re.findall(r"Y = (\S+) to (\S+) mm, up to Z = (\S+) mm", said)[0]]
    assert found == pytest.approx([low[1], high[1], high[2]], abs=1.0)  # mm


def _of_one_and_one(grid: Calibration) -> Calibration:
    """Leave of the calibration of a grid of 15 × 11 lines the middle line of each family, without errors."""
    assert grid.across is not None
    both = {**grid.parameters, "planes_per_mm": grid.parameters["planes_per_mm"][7:8]}
    both[ACROSS] = both[ACROSS][5:6]

    def left(one: Calibration, parameters: dict[str, Any], at: int) -> Calibration:
        many = sum(array.size for array in parameters.values())
        return replace(
            one,
            rest_px=one.rest_px[at : at + 1],
            displacement_px_per_mm=one.displacement_px_per_mm[at : at + 1],
            parameters=parameters,
            covariance=np.zeros((many, many)),
            view=view_of(parameters, one.image_size),
        )

    across = left(grid.across, turned_parameters(both, grid.image_size[1]), 5)
    return replace(left(grid, both, 7), across=across)


def test_points_of_a_line_are_pooled_and_dots_are_not(rng: np.random.Generator) -> None:
    row = np.arange(600)
    line = np.column_stack([np.zeros(600), 0.3 * row, 20.0 + 0.05 * rng.standard_normal(600)])
    place = np.column_stack([np.zeros(600, np.int64), row])
    mean, std, group = pooled(line, np.full(600, 0.05), place, rows_pooled(600))
    assert (group == row // 4).all()
    assert len(mean) == 150 and np.allclose(std, 0.05 / 2.0)
    assert np.allclose(mean[:, 2], line[:, 2].reshape(150, 4).mean(axis=1))
    apart, _, _ = pooled(line, np.full(600, 0.05), place * np.array([1, 16]), rows_pooled(600))
    assert len(apart) == 600


def test_a_pooled_point_lies_on_a_surface_that_bulges() -> None:
    row = np.arange(1800)
    along = 0.3 * (row % 60) - 9.0  # mm
    line = np.column_stack([0.1 * along, along, 20.0 - along**2 / 50.0])
    std = np.full(1800, 0.05)
    place = np.column_stack([row // 60, row % 60])
    found, stated, _ = pooled(line, std, place, rows_pooled(1800))
    assert len(found) == 150
    assert np.abs(found[:, 2] - 20.0 + found[:, 1] ** 2 / 50.0).max() < 1e-9  # mm; means lie 0.02 mm below
    assert np.allclose(stated, 1.5 * 0.05 / np.sqrt(12.0))
    # where single points are of different weight, too
    found, _, _ = pooled(line, std * (1.0 + row % 7), place, rows_pooled(1800))
    assert np.abs(found[:, 2] - 20.0 + found[:, 1] ** 2 / 50.0).max() < 1e-6


def test_what_has_not_moved_rests_on_the_points_that_were_chosen() -> None:
    laser, plain = (
        cv2.imread(str(GRID / folder / "potato_02.png"), cv2.IMREAD_UNCHANGED)
        for folder in ("images", "images_plain")
    )
    assert laser is not None
    trace = Recipe.load(GRID, sets=["uncertainty=none"]).trace(laser, plain=plain)
    product, volume = trace.products[0].product, trace.products[0].volume
    assert volume is not None
    xyz, std, every_xy, chosen = surface_points_of(product.profiles, product.number, 3)
    again = same_points_of(product.profiles, chosen)
    assert again is not None and len(xyz) == 150 < len(every_xy)
    assert (again[0] == xyz).all() and (again[1] == std).all()
    assert DotSurface().redraw(product, volume).visible_mm3.value == volume.visible_mm3.value
    # a little higher: no other points
    higher = product.profiles.xyz_mm + np.array([0.0, 0.0, 0.2])
    moved = same_points_of(replace(product.profiles, xyz_mm=higher), chosen)
    assert moved is not None and np.allclose(moved[0] - xyz, [0.0, 0.0, 0.2])
    # a point that has no place any more: they are chosen anew
    gone = product.profiles.xyz_mm.copy()
    gone[tuple(chosen.place[0])] = np.nan
    without = replace(product, profiles=replace(product.profiles, xyz_mm=gone))
    assert same_points_of(without.profiles, chosen) is None
    found = DotSurface().redraw(without, volume).visible_mm3.value
    assert found == pytest.approx(volume.visible_mm3.value, rel=2e-3) and found != volume.visible_mm3.value


def test_thin_parts_of_a_product_are_not_belt() -> None:
    rig = GridRig()
    heights, calibration = rig.hill(), rig.grid_calibration()
    true = rig.grid_map(heights)
    low = (true.product > 0) & (np.abs(true.x_px - true.rest_px) < 1.0)
    called = replace(true, product=np.where(low, 0, true.product).astype(np.int16))
    found = _with_thin_parts(called, calibration)
    off_px = true.x_px - true.rest_px
    assert (found.product[np.abs(off_px) > 0.35] == 1).all()
    assert (found.product[np.abs(off_px) < 0.25] == called.product[np.abs(off_px) < 0.25]).all()
    assert low[[1, 5]].sum() > 300  # of two stripes nothing was called a product


@pytest.mark.parametrize("shape", [(1, 1), (1, 48), (5, 3), (24, 1), (30, 40)])
def test_means_around_places_mirror_the_image_however_small_it_is(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    along, down = rng.normal(size=(2, *shape)).astype(np.float32)
    row, column = (place.ravel() for place in np.indices(shape))
    found = grid_lines._squares_around(along, down, row, column)
    half = grid_lines._AROUND_PX // 2
    for one, image in zip(found, (along, down), strict=True):
        wide = image**2
        for axis, size in enumerate(shape):  # a side of one pixel mirrors itself
            at = np.abs(np.arange(-half, size + half)) % max(2 * (size - 1), 1)
            wide = wide.take(np.minimum(at, max(2 * (size - 1), 1) - at) if size > 1 else 0 * at, axis=axis)
        expected = np.lib.stride_tricks.sliding_window_view(wide, (2 * half + 1, 2 * half + 1)).mean((-1, -2))
        np.testing.assert_allclose(one.reshape(shape), expected, atol=1e-4)
