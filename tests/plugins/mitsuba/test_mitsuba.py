"""The second simulator: truth, light and bodies against formulas and the other simulator."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, DataError, PluginError, StageError
from roemetry.io.meshes import Triangles, check_closed
from roemetry.run.simulate import simulate

pytest.importorskip("mitsuba", reason='pip install "roemetry[mitsuba]"')
drjit = pytest.importorskip("drjit")
needs_llvm = pytest.mark.skipif(
    not drjit.has_backend(drjit.JitBackend.LLVM), reason="the LLVM library is not found"
)

from roemetry_mitsuba import light as light_module  # noqa: E402
from roemetry_mitsuba.light import Lamps, Lens, Material, Tracer, mitsuba  # noqa: E402
from roemetry_mitsuba.materials import Beams, Surface, dipole_of, gather_scattered, glossy, sample_glossy  # noqa: E402
from roemetry_mitsuba.products import DEFECTS, FAMILIES, SkeinOptions, ball, block, skein, stairs  # noqa: E402
from roemetry_mitsuba.scene import (  # noqa: E402
    Camera,
    Fan,
    MitsubaOptions,
    camera_of,
    fan_of,
)
from roemetry_mitsuba.simulator import MitsubaSimulator  # noqa: E402
from roemetry_mitsuba.truth import crossings  # noqa: E402

TILTED = {
    "camera": {
        "width_px": 320, "height_px": 240, "pixel_size_um": 20.0, "tilt_x_deg": 9, "tilt_y_deg": 6,
        "distortion": {"k1": -0.1, "k2": 0.06, "p1": -0.0004, "p2": 0.0005},
    },
}  # fmt: skip
SMALL: dict[str, Any] = {
    "camera": {"width_px": 160, "height_px": 120, "pixel_size_um": 40.0},
    "laser": {"belt_x_mm": [-30.0, 0.0, 30.0]},
    "samples": 2,
    "bounce_rays": 8,
}


def rig(options: dict[str, Any]) -> tuple[Camera, Fan]:
    told = MitsubaOptions.model_validate(options)
    return camera_of(told.camera), fan_of(told.laser, 0.255)


def matt(albedo: float) -> Material:
    return Material(np.full((2, 2), albedo), np.zeros((2, 4)))


def test_both_simulators_find_the_same_stripe_centres_on_the_same_body(rng: np.random.Generator) -> None:
    from roemetry_simulate.products.mesh import MeshSolid
    from roemetry_simulate.ray_caster import stripe_centres
    from roemetry_simulate.scene import RayCasterOptions, rig_of

    body = skein(rng, SkeinOptions(kinds={"folded": 1.0})).body.moved(1.3, -2.1, 7.0)
    mine = crossings(*rig(TILTED), [body]).record()
    other = rig_of(RayCasterOptions.model_validate(TILTED))
    theirs = stripe_centres(other.camera, other.laser, MeshSolid(body.corners_mm, 0.0, 0.0, 0.0))
    assert np.array_equal(np.isfinite(mine.x_px), np.isfinite(theirs.x_px))
    assert mine.on_product.sum() > 400
    # the other one halves an interval down to 1e-7 px
    assert np.nanmax(np.abs(mine.x_px - theirs.x_px)) < 1e-7
    assert np.array_equal(mine.on_product, theirs.on_product == 1)


def test_truth_lies_on_its_plane_its_row_and_its_ball(rng: np.random.Generator) -> None:
    camera, fan = rig(TILTED)
    body = ball(rng, FAMILIES["ball"].Options()).body
    found = crossings(camera, fan, [body])
    off_mm = np.einsum("ti,ti->t", found.xyz_mm, fan.normals[found.stripe]) - fan.offsets_mm[found.stripe]
    assert np.abs(off_mm).max() < 1e-9
    seen = camera.project(found.xyz_mm)
    assert np.abs(seen - np.stack([found.x_px, found.row], axis=-1)).max() < 1e-8
    radius = 0.5 * body.height_mm
    away = np.linalg.norm(found.xyz_mm[found.label == 1] - [0.0, 0.0, radius], axis=1)
    assert np.abs(away - radius).max() < 0.005  # the facets' height under the sphere
    hidden = np.linalg.norm(found.xyz_mm[found.label == 0, :2], axis=1) < 0.5 * radius
    assert not hidden.any()


def test_volumes_of_shapes_with_a_formula(rng: np.random.Generator) -> None:
    brick = block(40.0, 30.0, 10.0)
    assert brick.true_mm3 == pytest.approx(12000.0, rel=1e-12)
    assert brick.visible_mm3 == pytest.approx(12000.0, rel=1e-12)
    steps = stairs(4, 15.0, 4.0, 100.0)
    check_closed(Triangles(steps.points_mm, steps.faces), "stairs")
    assert steps.true_mm3 == pytest.approx(60000.0, rel=1e-12)
    sphere = ball(rng, FAMILIES["ball"].Options()).body
    r = 0.5 * sphere.height_mm
    assert sphere.true_mm3 == pytest.approx(4.0 / 3.0 * math.pi * r**3, rel=1e-3)
    under = math.pi * r**3 + 2.0 / 3.0 * math.pi * r**3  # a cylinder up to the equator, half a ball on it
    assert sphere.visible_mm3 == pytest.approx(under, rel=2e-3)


@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "mesh"])
def test_a_family_draws_closed_bodies_that_stand_on_the_belt(family: str) -> None:
    for seed in range(3):
        body, again = (
            FAMILIES[family].make(np.random.default_rng(seed), FAMILIES[family].Options()).body
            for _ in range(2)
        )
        check_closed(Triangles(body.points_mm, body.faces), family)
        assert body.points_mm[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        assert 0.0 < body.true_mm3 < 1.002 * body.visible_mm3
        assert np.array_equal(body.points_mm, again.points_mm)


@pytest.mark.parametrize("kind", DEFECTS[1:])
def test_a_defect_changes_the_skein_where_it_is(kind: str, rng: np.random.Generator) -> None:
    drawn = skein(rng, SkeinOptions(kinds={kind: 1.0}))
    assert drawn.reference is not None
    check_closed(Triangles(drawn.body.points_mm, drawn.body.faces), kind)
    x, y = np.meshgrid(np.arange(-45.0, 45.0, 0.5), np.arange(-20.0, 20.0, 0.5))
    missing = np.nan_to_num(drawn.reference.heights.at(x, y)) - np.nan_to_num(drawn.body.heights.at(x, y))
    assert missing.max() > 1.5


@needs_llvm
def test_a_matt_level_belt_shows_what_the_light_says() -> None:
    camera, fan = rig(SMALL)
    tracer = Tracer(camera, Lens(), fan, matt(0.5), [], matt(0.5), None, 2, 1)
    laser, other = tracer.image(Lamps(30.0), laser=True, bounce_rays=16)
    assert np.abs(other - 15.0).max() < 1e-3  # half of the sky's light, everywhere
    # in a line's middle: peak × albedo × cosine × fall along the line × 1 / distance
    row = 60
    x = crossings(camera, fan, []).record().x_px[1, row]
    at = camera.centre_mm + camera.directions(np.array(x), np.array(float(row))) * (
        camera.centre_mm[2] / -camera.directions(np.array(x), np.array(float(row)))[2]
    )
    beam = at - fan.origin_mm
    away = np.linalg.norm(beam)
    fall = math.exp(-0.5 * (math.asin(beam @ fan.axis / away) / fan.fall_rad) ** 2)
    expected = 0.5 * fan.peak_grey[1] * (-beam[2] / away) * fall
    # over the row: a Gaussian's integral, its width stretched by the slant of plane against belt
    per_px = abs(
        camera.directions(np.array(x + 1), np.array(60.0))[0]
        - camera.directions(np.array(x), np.array(60.0))[0]
    )
    per_px *= camera.centre_mm[2] / -camera.directions(np.array(x), np.array(60.0))[2]
    across = fan.sigma_mm / abs(fan.normals[1, 0]) / per_px
    line = laser[row, int(x) - 12 : int(x) + 13].sum()
    assert line == pytest.approx(expected * across * math.sqrt(2.0 * math.pi), rel=0.01)


@needs_llvm
def test_a_white_body_in_a_white_room_is_hardly_seen(rng: np.random.Generator) -> None:
    camera, fan = rig(SMALL)
    body = ball(rng, FAMILIES["ball"].Options()).body
    tracer = Tracer(camera, Lens(), fan, matt(1.0), [body], matt(1.0), None, 2, 1)
    _, other = tracer.image(Lamps(100.0), laser=False, bounce_rays=64)
    # all light comes back in the end; two bounces bring all but a little of it, and none too much
    assert other.max() < 101.0
    assert np.percentile(other, 1) > 85.0


@needs_llvm
def test_the_middle_of_a_rendered_stripe_is_where_truth_says(rng: np.random.Generator) -> None:
    camera, fan = rig({**SMALL, "camera": {"width_px": 320, "height_px": 240, "pixel_size_um": 20.0}})
    body = ball(rng, FAMILIES["ball"].Options()).body
    tracer = Tracer(camera, Lens(), fan, matt(0.5), [body], matt(0.5), None, 8, 1)
    laser, _ = tracer.image(Lamps(0.0), laser=True, bounce_rays=0)
    truth = crossings(camera, fan, [body]).record()
    off = []
    for row in range(5, 235, 5):
        for stripe in range(3):
            x = truth.x_px[stripe, row]
            if (truth.product[stripe, row - 3 : row + 4] == 0).all():
                near = slice(round(x) - 6, round(x) + 7)
                off.append(np.average(np.arange(near.start, near.stop), weights=laser[row, near]) - x)
    # perspective and the cosine over a line's width move its centroid by some thousandths
    assert len(off) > 80
    assert np.abs(off).max() < 0.02


@needs_llvm
def test_gloss_drawn_and_gloss_evaluated_are_the_same_light() -> None:
    mi = mitsuba()
    import drjit as dr

    n = 400_000
    rng = np.random.default_rng(7)
    u, v = (mi.Float(rng.random(n, dtype=np.float32)) for _ in range(2))
    surface = Surface(mi.Float(0.5), mi.Float(1.0), mi.Float(0.3), None, mi.Bool(False))
    seen = dr.normalize(mi.Vector3f(0.5, 0.2, 0.8))
    _, weight = sample_glossy(mi, surface, seen, u, v)
    assert float(dr.max(weight)[0]) <= 1.0
    z, turn = mi.Float(rng.random(n, dtype=np.float32)), 2 * dr.pi * u
    lit = mi.Vector3f(dr.sqrt(1 - z * z) * dr.cos(turn), dr.sqrt(1 - z * z) * dr.sin(turn), z)
    whole = 2.0 * float(dr.mean(glossy(dr, surface, seen, lit))[0])  # ∫ f cos dω, even over the half sphere
    assert float(dr.mean(weight)[0]) == pytest.approx(whole, rel=0.02)
    down = mi.Vector3f(0.0, 0.0, 1.0)
    _, straight = sample_glossy(mi, surface._replace(roughness=mi.Float(1e-3)), down, u, v)
    assert float(dr.mean(straight)[0]) == pytest.approx(((1.38 - 1) / (1.38 + 1)) ** 2, rel=1e-3)


def test_scattering_gives_back_what_entered_with_the_spread_that_was_told() -> None:
    dipole = dipole_of(0.5, 0.8)
    _, fan = rig(
        {"laser": {"belt_x_mm": [0.0], "projector_mm": [0.0, 0.0, 300.0], "yaw_deg": 0.0, "pitch_deg": 0.0}}
    )
    # one straight line of beams from above, 1 grey mm² per 0.1 mm
    step = 0.1 / 300.0
    first = -math.asin(20.0 / math.hypot(20.0, 300.0))
    y = 300.0 * np.tan(first + step * np.arange(401))
    source = np.stack([0 * y, y, 0 * y - dipole.source_mm], axis=-1)[None, :, None]
    image = np.stack([0 * y, y, 0 * y + dipole.image_mm], axis=-1)[None, :, None]
    flux = np.gradient(y)[None, :, None]
    x = np.arange(-12.0, 12.0, 0.02)
    points = np.stack([x, 0 * x, 0 * x], axis=-1)
    found = gather_scattered(points, fan, Beams(source, image, flux, first, step), dipole)
    total = found.sum() * 0.02
    assert total == pytest.approx(1.0, rel=0.04)  # what lies beyond the reach of the gathering is lost
    assert math.sqrt((found * x**2).sum() / found.sum()) == pytest.approx(0.8, rel=0.12)


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(
        "roemetry_scene: 1\nname: small\nlicence: CC0-1.0\nsimulator:\n  use: mitsuba\n  options:\n"
        "    camera: {width_px: 160, height_px: 120, pixel_size_um: 40}\n    samples: 2\n"
        "    light: {images: [laser, plain]}\n",
        "utf-8",
    )
    return path


@needs_llvm
def test_a_data_set_is_whole_and_its_stripes_are_the_truth(scene_file: Path, tmp_path: Path) -> None:
    from roemetry.config.dataset import Dataset

    simulate(Scene.load(scene_file), tmp_path / "set", count=2, seed=3)
    made = Dataset(tmp_path / "set")
    assert list(made.faults()) == []
    items = list(made.items())
    assert [item.products[0].figures["seed"] for item in items] == [3.0, 4.0]
    stripes = made.truth(items[0]).stripes
    assert stripes is not None and stripes.on_product.sum() > 100
    assert len(made.calibration_truth()["rig"]["planes"]) == 11


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("product={family: herring-roe}", "no product family `herring-roe`"),
        ("product={family: lofted-skein, options: {kinds: {squashed: 1}}}", "there is no kind `squashed`"),
        ("product={family: ball, options: {diametre_mm: [2, 3]}}", "diameter_mm"),
        ("laser.centre_x_mm=900", "the laser misses the view"),
        ("camera.distortion={k1: -5}", "folds the image over"),
    ],
)
def test_a_scene_that_cannot_be_is_refused_by_place(scene_file: Path, change: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Scene.load(scene_file, sets=[f"simulator.options.{change}"])


@needs_llvm
@pytest.mark.parametrize(
    ("product", "says"),
    [
        ("{{family: mesh, options: {{file: {folder}/open.obj}}}}", r"open\.obj: the mesh is not watertight"),
        ("{{family: box, options: {{length_mm: [400, 401]}}}}", "the view is X"),
    ],
)
def test_a_product_that_cannot_be_is_refused(
    scene_file: Path, tmp_path: Path, product: str, says: str
) -> None:
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 3 2\nf 1 2 4\n", "utf-8")
    sets = [f"simulator.options.product={product.format(folder=tmp_path)}"]
    with pytest.raises((ConfigurationError, DataError, StageError), match=says):
        Scene.load(scene_file, sets=sets).make()


def test_without_llvm_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    import mitsuba as mi

    from roemetry_tools import doctor

    monkeypatch.setattr(mi, "variant", lambda: "scalar_rgb")
    monkeypatch.setattr(drjit, "has_backend", lambda _: False)
    with pytest.raises(PluginError, match="LLVM") as caught:
        light_module.mitsuba()
    assert caught.value.hint is not None and "libllvm" in caught.value.hint
    assert [finding.verdict for finding in doctor._llvm()] == ["missing"]


@needs_llvm
def test_products_side_by_side_have_labels_of_their_own() -> None:
    box = {"length_mm": [20, 30], "width_mm": [10, 12], "height_mm": [6, 7]}
    options = {**SMALL, "product": {"family": "box", "in_frame": 3, "options": box}}
    made = MitsubaSimulator(MitsubaOptions.model_validate(options)).simulate(0, 4)
    stripes = made.truth.stripes
    assert stripes is not None and len(made.truth.products) == 3
    for label, product in enumerate(made.truth.products, start=1):
        at = stripes.xyz_mm[stripes.product == label]
        assert len(at) > 0
        assert product.figures["x_min_mm"] <= at[:, 0].min() and at[:, 0].max() <= product.figures["x_max_mm"]
        assert product.figures["y_min_mm"] <= at[:, 1].min() and at[:, 1].max() <= product.figures["y_max_mm"]


@pytest.mark.thorough
@needs_llvm
def test_the_shipped_recipe_measures_what_the_other_simulator_never_drew(tmp_path: Path) -> None:
    """Same rig, other light, other skeins: the shipped calibration holds, and no label is wrong."""
    from roemetry.io.files import shipped
    from roemetry.stages.registry import discover
    from roemetry_tools.compare.comparison import compare
    from roemetry_tools.compare.data import Data
    from roemetry_tools.compare.tables import flat
    from roemetry_tools.compare.variants import make_variants

    folder = shipped("recipes", "herring_roe")
    sets = ["simulator.use=mitsuba", "simulator.options.product={family: lofted-skein}"]
    scene = Scene.load(folder / "scene.yaml", sets=[*sets, "simulator.options.samples=2"])
    simulate(scene, tmp_path / "set", count=1, seed=3)
    variants = make_variants(folder / "with_outline.yaml", (), sets=["draws=0"], registry=discover())
    base = variants[0].recipe
    assert base is not None
    row = flat(compare(variants, Data(base, tmp_path / "set"))[0])
    assert row["coding_wrong_pct"] == 0.0
    assert isinstance(row["coding_right_pct"], float) and row["coding_right_pct"] > 90.0
    # tissue that scatters is seen lower than it is, by some tenths of a millimetre of 15
    assert isinstance(row["volume_visible_bias_pct"], float) and abs(row["volume_visible_bias_pct"]) < 3.0
