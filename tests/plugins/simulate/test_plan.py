"""The plan of a rig, or of one over a moving belt: closed forms where there are any, else images."""

import json
import re

import numpy as np
import pytest

from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, PluginError, StageError
from roemetry.stages.registry import Registry, discover
from roemetry_simulate.belt_planner import BeltPlanner, enough_mm
from roemetry_simulate.moving_belt import MovingBeltOptions
from roemetry_simulate.optics import fan_through, looking_down
from roemetry_simulate.plan_model import (
    Stripe,
    highest_in_view_mm,
    in_view,
    meeting_height_mm,
    peak_std,
    plane_points,
    scale_at,
    spacing_heights_mm,
    steepest_slopes_deg,
)
from roemetry_simulate.plan_tables import ellipsoid
from roemetry_simulate.planner import RigPlanner, as_lines, simulated_scatter, space_of
from roemetry_simulate.render import Sensor
from roemetry_simulate.scene import RayCasterOptions, rig_of
from roemetry_tools.plan.page import plan_of
from tests.command import typed

H_MM, BESIDE_MM, FOCAL_PX, SPACING_MM = 300.0, 150.0, 1500.0, 10.0
CAMERA = looking_down(640, 480, pixel_size_mm=0.01, focal_length_mm=15.0, distance_mm=H_MM)
FEET_MM = SPACING_MM * np.arange(-3.0, 4.0)
FAN = fan_through([BESIDE_MM, 0.0, H_MM], FEET_MM, sigma_mm=0.3, peak_grey=200.0)
"""A camera straight above, a projector at the same height: everything has a closed form."""

SHORT = {"camera": {"height_px": 96}}


@pytest.mark.parametrize("z_mm", [0.0, 12.5, 60.0])
def test_scales_are_those_of_the_closed_form(z_mm):
    scale = scale_at(CAMERA, FAN, plane_points(FAN, 0.0, np.array([z_mm]))[0])
    np.testing.assert_allclose(scale.height_px_per_mm, FOCAL_PX * BESIDE_MM / (H_MM - z_mm) ** 2, rtol=1e-7)
    np.testing.assert_allclose(scale.x_mm_per_px, (H_MM - z_mm) / FOCAL_PX, rtol=1e-7)
    np.testing.assert_allclose(scale.y_mm_per_px, (H_MM - z_mm) / FOCAL_PX, rtol=1e-7)
    lean = np.hypot(H_MM, BESIDE_MM - FEET_MM)
    np.testing.assert_allclose(scale.across_mm_per_px, (H_MM - z_mm) / FOCAL_PX * H_MM / lean, rtol=1e-7)


def test_a_turned_rig_moves_its_stripes_as_its_images_do():
    """The displacement within a row, where neither rows nor lines nor camera are straight."""
    camera, laser = {"distortion": {"k1": -0.2}, "tilt_x_deg": 9.0}, {"yaw_deg": 12.0, "pitch_deg": 3.0}
    rig = rig_of(RayCasterOptions.model_validate({"camera": camera, "laser": laser}))
    points = plane_points(rig.laser, 4.0, np.array([10.0]))[0]
    scale = scale_at(rig.camera, rig.laser, points)
    before = rig.camera.project(points)
    for i, (u, v) in enumerate(before):
        y = np.linspace(-20.0, 20.0, 40001)
        x = rig.laser.x_mm(y, 10.5)[:, i]
        there = rig.camera.project(np.stack([x, y, np.full_like(x, 10.5)], axis=-1))
        same_row = np.argmin(np.abs(there[:, 1] - v))
        assert (there[same_row, 0] - u) / 0.5 == pytest.approx(scale.height_px_per_mm[i], rel=0.01)


def test_one_spacing_height_is_that_of_the_closed_form():
    found = spacing_heights_mm(CAMERA, FAN, 0.0)
    np.testing.assert_allclose(found[:-1], SPACING_MM * H_MM / (BESIDE_MM + SPACING_MM), rtol=1e-12)
    assert np.isnan(found[-1])
    none = meeting_height_mm(CAMERA, FAN, FEET_MM[1:], FEET_MM[:-1], 0.0)
    assert np.isnan(none).all()


def test_a_stripe_leaves_the_view_where_the_closed_form_says():
    half_px = 320.0
    at_rest = FOCAL_PX * FEET_MM / H_MM
    room = half_px - at_rest  # = f B z / (H (H − z))
    expected = room * H_MM**2 / (FOCAL_PX * BESIDE_MM + room * H_MM)
    np.testing.assert_allclose(highest_in_view_mm(CAMERA, FAN, 0.0), expected, atol=0.08)


def test_slopes_are_those_of_the_closed_form():
    slopes = steepest_slopes_deg(CAMERA, FAN, plane_points(FAN, 0.0, np.zeros(1))[0])
    np.testing.assert_allclose(slopes[:, 0], np.rad2deg(np.arctan2(H_MM, BESIDE_MM - FEET_MM)))
    away = np.rad2deg(np.arctan2(H_MM, np.maximum(FEET_MM, 0.0)))
    np.testing.assert_allclose(slopes[:, 1], away)
    np.testing.assert_allclose(slopes[:, 2:], 90.0)


@pytest.mark.parametrize("stripes", [3, 5, 11, 41])
def test_the_sum_of_slices_of_an_ellipsoid_errs_as_its_closed_form(stripes):
    found = ellipsoid(50.0).sampling_pct(50.0 / stripes)
    assert found == pytest.approx(100.0 / np.sqrt(5.0) / stripes**2, rel=0.01)


def test_the_bound_of_a_wide_bright_stripe_is_the_textbook_one():
    """Constant noise n, a Gaussian of height A and deviation s: n / A · sqrt(2 s / √π) (no background)."""
    quiet = {"grey_per_electron": 1e-9, "psf_sigma_px": 0.0, "speckle_contrast": 0.0}
    sensor = Sensor(**quiet, read_noise_grey=2.0, bit_depth=16)
    found = peak_std(Stripe(500.0, 6.0, 0.0, 0.0), sensor)
    noise = np.sqrt(4.0 + 1.0 / 12.0)
    assert found.bound_px == pytest.approx(noise / 500.0 * np.sqrt(2.0 * 6.0 / np.sqrt(np.pi)), rel=0.01)
    assert found.bound_px == pytest.approx(found.noise_bound_px)
    assert found.centre_of_gravity_px > found.bound_px
    assert not found.is_saturated


@pytest.mark.parametrize(
    ("changes", "height_mm"),
    [
        ({}, 0.0),
        ({}, 25.0),
        ({"laser": {"speckle_contrast": 0.0}}, 10.0),
        ({"laser": {"speckle_contrast": 0.3, "speckle_sigma_px": 1.5}}, 10.0),
        ({"camera": {"focus": {"distance_mm": 350.0, "f_number": 4.0}}}, 12.0),
    ],
    ids=["belt", "high", "no-speckle", "coarse-speckle", "out-of-focus"],
)
def test_simulated_peaks_scatter_as_predicted(changes, height_mm):
    scene = {**SHORT, **changes, "camera": {**SHORT["camera"], **changes.get("camera", {})}}
    found = simulated_scatter(space_of(RayCasterOptions.model_validate(scene)), height_mm, seed=3)
    assert found.centres >= 500
    assert found.measured_px == pytest.approx(found.predicted_px, rel=0.2)
    assert found.bound_px < found.predicted_px
    assert abs(found.offset_px) < 0.03


def test_the_plan_of_the_herring_roe_rig():
    plan = RigPlanner().plan(simulate=False)
    assert plan.value("stripes") == 11
    assert plan.value("spacing") == pytest.approx(8.75, abs=0.01)
    assert 15.0 < plan.value("spacing-height") < 16.5
    assert 0.3 < plan.value("height-per-px-belt") < 0.45
    assert 0.0 < plan.value("std-noise-belt") < plan.value("std-bound-belt") < plan.value("std-gravity-belt")
    for one in plan.maps:
        assert np.isfinite(one.values).mean() > 0.8
    belt = plan.column("stripes", "height-per-px-belt")
    middle = plan.maps[0].values[0, len(plan.maps[0].x_mm) // 2]
    assert belt.min() < middle < belt.max()
    assert {reason.code for reason in plan.reasons} == {"depth-of-field", "matt"}
    assert np.isnan(plan.value("sharp-from"))
    with pytest.raises(KeyError):
        plan.value("nothing")
    with pytest.raises(KeyError):
        plan.column("stripes", "nothing")


@pytest.mark.thorough
def test_an_aperture_gives_depth_of_field_and_speckle_limit():
    focus = {"distance_mm": 310.0, "f_number": 4.0}
    plan = RigPlanner(RayCasterOptions.model_validate({"camera": {"focus": focus}})).plan(simulate=False)
    assert plan.value("sharp-from") < 10.0 < plan.value("sharp-to")
    from roemetry_simulate.plan_model import defocus_px

    rig = rig_of(RayCasterOptions.model_validate({"camera": {"focus": focus}}))
    ends = np.array([plan.value("sharp-from"), plan.value("sharp-to")])
    middle = plane_points(rig.laser, 0.0, ends)[:, 5]
    np.testing.assert_allclose(defocus_px(rig, middle), 0.5, rtol=0.02)
    assert plan.value("speckle-limit") > 0.0
    assert "defocus" in {one.name for one in plan.curves}
    assert "depth-of-field" not in {reason.code for reason in plan.reasons}


@pytest.mark.parametrize(
    ("laser", "code"),
    [
        ({"planes": 1}, "spacing-height"),
        ({"peak_e_per_ms": 5000.0}, "saturated"),
        ({"planes": 20, "spacing_mm": 1.2}, "crowded"),
        ({"power": [1, 1, 0, 1, 1, 1, 1, 0.01, 1, 1, 1], "speckle_contrast": 1.0}, "speckle"),
    ],
)
def test_what_cannot_be_said_is_told(laser, code):
    plan = RigPlanner(RayCasterOptions.model_validate({"laser": laser, **SHORT})).plan(simulate=False)
    said = {reason.code: reason.text for reason in plan.reasons}
    assert code in said
    if code == "speckle":
        assert said["dark-stripe"].startswith("stripe 3, 8: dead, or")  # as reports number them
    if code == "spacing-height":
        assert np.isnan(plan.value("spacing-height"))
        assert "numbers" not in {table.name for table in plan.tables}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"camera": {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0},
             "laser": {"projector_mm": [0.0, 0.0, 320.0], "yaw_deg": 0.0, "pitch_deg": 0.0}},
            "projector_mm: a height of 1 mm moves no stripe",
        ),
        (
            {"camera": {"T_belt_camera": [[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 320], [0, 0, 0, 1]]}},
            "along the image rows",
        ),
    ],
)  # fmt: skip
def test_a_rig_that_shows_no_heights_is_refused(options, says):
    with pytest.raises(StageError, match=says):
        RigPlanner(RayCasterOptions.model_validate(options)).plan(simulate=False)


PLUMS = {"family": "potato", "options": {"length_range_mm": [42.5, 50.0], "width_range_mm": [34.0, 40.0],
         "thickness_range_mm": [30.0, 35.0]}}  # fmt: skip


def plum_rig(stripes=9, beside_mm=35.0, height=1.0, **more):
    laser = {"planes": stripes, "spacing_mm": 55.0 / (stripes - 1), "centre_x_mm": 0.0,
             "projector_mm": [beside_mm, 0.0, 288.0], "line_width_mm": 0.95}  # fmt: skip
    options = {**PLUMS["options"], "thickness_range_mm": [30.0 * height, 35.0 * height]}
    product = {**PLUMS, "options": options}
    return RayCasterOptions.model_validate(
        {"camera": {"distance_mm": 300.0}, "laser": laser, "product": product, **more}
    )


def test_the_answer_says_how_well_and_what_limits_it():
    """A product that a rig measures: what helps more, and that less is expected of fewer stripes."""
    answer = RigPlanner(plum_rig()).plan(simulate=False).answer
    assert answer.fits
    assert answer.text.startswith("your product: yes; expected volume ± ")
    assert "stripes on a product" in answer.limiting
    assert any("plain light" in change for change in answer.changes)
    assert any("for finer heights" in change and "now 7°" in change for change in answer.changes)
    outlined = RigPlanner(plum_rig(light={"images": ["laser", "plain"]})).plan(simulate=False).answer
    assert outlined.volume_pct < 0.4 * answer.volume_pct
    few = RigPlanner(plum_rig(stripes=5)).plan(simulate=False).answer
    assert few.volume_pct > 1.5 * answer.volume_pct
    assert answer.weight_pct > answer.volume_pct


@pytest.mark.parametrize(
    ("rig", "why"),
    [
        ({"stripes": 3}, "fewer than three stripes on a product"),
        ({"beside_mm": 200.0, "height": 1.5}, "displaces a stripe by more than 2.5 spacings"),
    ],
)
def test_a_product_that_does_not_fit_is_refused_with_a_rig_that_does(rig, why):
    answer = RigPlanner(plum_rig(**rig)).plan(simulate=False).answer
    assert answer.text.startswith(f"your product: no: {why}") or why in answer.limiting
    assert "; change: " in answer.text
    assert "stripes" in answer.changes[0]


SCENE = "\n".join(
    [
        "roemetry_scene: 1",
        "name: a rig",
        "licence: CC0-1.0",
        "simulator:",
        "  use: ray-caster",
        "  options: {laser: {centre_x_mm: CENTRE}}",
    ]
)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("CENTRE", "0.0"), "utf-8")
    return path


def test_what_cannot_be_planned_is_refused_with_its_place(scene, tmp_path):
    registry = discover()
    without = Registry(tuple(one for one in registry.stages if one.entry.kind != "planner"), ())
    with pytest.raises(PluginError, match="there is no planner"):
        plan_of(Scene.load(scene), simulate=False, registry=without)
    scene.write_text(SCENE.replace("CENTRE", "500.0"), "utf-8")
    done = typed("plan", scene, "--out", tmp_path / "plan.html", code=1)
    assert isinstance(done.exception, ConfigurationError)
    assert re.search(r"scene\.yaml:6:\d+: .*the laser misses the view", str(done.exception))
    assert not (tmp_path / "plan.html").exists()


def test_the_command_writes_one_page_that_needs_nothing_or_json(scene, tmp_path, monkeypatch):
    out = tmp_path / "new" / "plan.html"
    done = typed("plan", scene, "--out", out, "--simulate")
    assert "Height for one pixel, belt" in done.output
    assert "Predicted and simulated" in done.output
    page = out.read_text("utf-8")
    assert "How many stripes are enough?" in page
    assert "Predicted and simulated" in page
    assert page.count("<svg") == page.count("</svg>") == 7
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)
    assert "nan" not in re.sub(r"<pre>.*?</pre>", "", page, flags=re.S).replace("finance", "")
    monkeypatch.chdir(tmp_path)
    args = ["plan", str(scene), "--json", "--set", "simulator.options.laser.planes=15"]
    told = json.loads(typed(*args).output, parse_constant=lambda word: pytest.fail(word))
    assert told["figures"]["spacing-height"]["unit"] == "mm"
    assert told["figures"]["sharp-from"]["value"] is None
    assert len(told["tables"]["stripes"]["columns"][0]["values"]) == 15
    assert len(told["maps"]["height-per-px"]["values"]) == len(told["maps"]["height-per-px"]["z_mm"])
    assert not (tmp_path / "plan.html").exists()


def test_maps_hold_the_worst_along_y():
    wide = RayCasterOptions.model_validate({"camera": {"tilt_x_deg": 20.0}})
    space = space_of(wide)
    one = space.maps()[0]
    assert f"Y = {space.ys_mm[0]:.1f}" in one.basis
    points = np.stack(np.broadcast_arrays(one.x_mm[None, :], space.y_mm, one.z_mm[:, None]), axis=-1)
    middle = 1.0 / np.abs(scale_at(space.rig.camera, space.rig.laser, points).height_px_per_mm)
    seen = in_view(space.rig.camera, points)
    assert (one.values[seen] >= middle[seen] - 1e-12).all()
    # on the belt all three are in view, and the farthest is 5 % coarser
    assert (one.values[0][seen[0]] > 1.02 * middle[0][seen[0]]).all()


def test_other_light_than_lines_is_planned_as_the_lines_of_the_middle_row() -> None:
    for pattern, count in (("circles", 22), ("grid", 15), ("dots", 20)):
        scene = Scene.load(f"recipes/potato_{pattern}/simulated.yaml").simulator.options
        lines, said = as_lines(scene)
        assert [reason.code for reason in said] == ["pattern-as-lines"]
        assert lines.laser.count == count
        assert getattr(lines.laser, pattern) is None
    # a half leaves the projector at its angle from an axis that leans by 109 mm on 470 mm
    lines, _ = as_lines(Scene.load("recipes/potato_circles/simulated.yaml").simulator.options)
    angle = np.arctan(8.0 * (np.arange(-11, 11) + 0.5) / np.hypot(109.0, 470.0))
    true_mm = 105.0 - 470.0 * np.tan(np.arctan(109.0 / 470.0) - angle)
    assert np.abs(np.array(lines.laser.lines_x_mm) - true_mm).max() < 0.2  # Y of row and axis differ by 1 mm
    assert as_lines(lines) == (lines, ())


BELT_SCENE = {
    "camera": {"width_px": 200, "height_px": 230, "pixel_size_um": 10, "focal_length_mm": 12,
               "distance_mm": 300, "tilt_x_deg": 0, "tilt_y_deg": 35, "exposure_ms": 4},
    "laser": {"projector_mm": [0, 0, 400], "planes": 1, "centre_x_mm": 0},
    "scan": {"mm_per_count": [0.02, 0.0], "counts_per_line": 40},
}  # fmt: skip


def test_of_an_ellipsoid_the_spacing_is_that_of_the_closed_form():
    """It errs by 1 / (√5 N²): 0.1 % at N = 21.1 slices."""
    assert enough_mm(ellipsoid(80.0)) == pytest.approx(80.0 / 21.15, rel=0.03)


def test_the_plan_says_which_spacing_and_speed_are_enough():
    rolls = {"family": "bread-roll", "options": {"length_range_mm": [45, 55], "width_range_mm": [34, 40]}}
    plan = BeltPlanner(MovingBeltOptions.model_validate(BELT_SCENE | {"product": rolls})).plan(simulate=False)
    assert plan.value("line-spacing") == pytest.approx(0.8)
    assert plan.value("belt-speed") == pytest.approx(0.8 / 4e-3)
    enough = plan.value("spacing-enough")
    assert plan.value("speed-enough") == pytest.approx(enough / 4e-3)
    spacing, error = plan.column("line-spacing", "spacing"), plan.column("line-spacing", "error")
    assert (np.diff(error[spacing >= enough]) > 0).all()
    assert (error[spacing > 2 * enough] > 0.1).all()
    assert plan.answer is not None
    assert plan.answer.fits
    assert f"a line every {enough:g} mm is enough" in plan.answer.text


def test_a_product_higher_than_the_line_is_seen_is_told():
    high = {"family": "truncated-pyramid", "options": {"height_mm": 60, "length_mm": 40, "width_mm": 40}}
    plan = BeltPlanner(MovingBeltOptions.model_validate(BELT_SCENE | {"product": high})).plan(simulate=False)
    assert plan.answer is not None
    assert not plan.answer.fits
    assert "leaves the view" in plan.answer.limiting


def test_an_empty_belt_has_spacing_and_speed_and_no_answer():
    plan = BeltPlanner(MovingBeltOptions.model_validate(BELT_SCENE)).plan(simulate=False)
    assert plan.answer is None or plan.answer.fits
    assert plan.value("belt-speed") == pytest.approx(200.0)
