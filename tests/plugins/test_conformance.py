"""Every registered stage against every check of its kind, and what the kit says."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from docs.reference_tables import markdown
from roemetry.errors import PluginError
from roemetry.records import Estimate
from roemetry.stages import INTERFACES, Capabilities
from roemetry.stages.hookspecs import StageEntry
from roemetry.stages.registry import Provider, Registered, discover
from roemetry.testing import LinearRig, checks_of, conformance, parametrize_stages, stages_named
from roemetry.testing.checks import name_of
from roemetry.testing.kit import parametrized, run_check
from roemetry.testing.solids import BOX, HALF_CYLINDER, HALF_ELLIPSOID, SPHERICAL_CAP, product_of
from roemetry.testing.verdict import difference
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.density import Density
from roemetry_paper.dominant_peak import DominantPeak
from tests.command import typed

FAULTS: dict[str, str] = {}


SMALL = {"width_px": 96, "height_px": 64, "pixel_size_um": 66.0}
EGG = {"family": "egg"}
OPTIONS = {
    "mitsuba": {"camera": SMALL, "samples": 2, "bounce_rays": 8},
    "mitsuba-belt": {
        "camera": SMALL,
        "bounce_rays": 4,
        "laser": {"planes": 1},
        "product": {"family": "ball"},
        "scan": {"counts_per_line": 500},
    },
    "moving-belt": {"camera": SMALL, "scan": {"counts_per_line": 250}, "product": EGG},
    "ray-caster": {"camera": SMALL, "product": EGG},
}
"""Of stages whose defaults take long: a scene of few pixels, a scan of few lines."""


@parametrized(discover().stages, FAULTS, OPTIONS)
def test_every_stage_keeps_every_check(stage, check) -> None:
    check(stage)


def test_a_declared_failure_must_happen() -> None:
    check = _check(DominantPeak, "check_brightness_does_not_matter")
    assert run_check(DominantPeak(), check, "fixed").outcome == "expected failure"
    right = _check(DominantPeak, "check_centres_are_right")
    result = run_check(DominantPeak(), right, "it is said to be coarse")
    assert result.outcome == "unexpectedly passed"
    assert not result.as_declared
    assert "it is said to be coarse" in result.message


def _check(stage, name: str):
    kind = next(kind for kind, cls in INTERFACES.items() if issubclass(stage, cls))
    return next(check for check in checks_of(kind) if name_of(check) == name)


def registered(kind: str, target: str) -> Registered:
    return Registered(StageEntry(kind, "x", target, "for tests", "our own"), Provider("mine", "1.0", "mine"))


@pytest.mark.parametrize("key", ["dominant-peek/check_centres_are_right", "check_centers_are_right"])
def test_a_declaration_that_fits_nothing_is_refused(key: str) -> None:
    with pytest.raises(PluginError, match="did you mean `.*check_centres_are_right`"):
        parametrize_stages("paper", {key: "typing"})
    stage = registered("extractor", "roemetry_paper.dominant_peak:DominantPeak")
    with pytest.raises(PluginError, match="did you mean `check_dark_rows_give_nothing`"):
        next(iter(conformance(stage, {"check_dark_row_gives_nothing": "typing"})))


def test_a_stage_that_lacks_something_is_skipped_with_the_reason() -> None:
    needs = (("no_such", "pip install no-such"),)
    entry = StageEntry("extractor", "x", "nowhere:X", "for tests", "our own", requires=needs)
    mark = parametrized((Registered(entry, Provider("mine", "1.0", "mine")),))
    (case,) = mark.args[1]
    assert "pip install no-such" in case.marks[0].kwargs["reason"]


@pytest.mark.parametrize(
    ("kind", "target", "says"),
    [
        ("coder", "roemetry_paper.dominant_peak:DominantPeak", r"not inherit from `roemetry.stages.Coder`"),
        ("extractor", "roemetry_paper.dominant_peak:Nothing", "cannot be imported"),
    ],
)
def test_what_cannot_be_made_is_said(kind: str, target: str, says: str) -> None:
    with pytest.raises(PluginError, match=says):
        list(conformance(registered(kind, target)))


def test_a_stage_that_gives_nothing_or_breaks_is_told_so(monkeypatch) -> None:
    stage = registered("extractor", "roemetry_paper.dominant_peak:DominantPeak")
    monkeypatch.setattr(DominantPeak, "extract", lambda self, frame: None)
    _, first = next(iter(conformance(stage)))
    assert first.outcome == "failed"
    assert first.message == "TypeError: it gave nothing (None), expected Peaks"


def test_where_a_stage_breaks_is_told() -> None:
    class Breaks(DominantPeak):
        def extract(self, frame):
            raise ZeroDivisionError("oh")

    said = run_check(Breaks(), _check(Breaks, "check_centres_are_right")).message
    line = Breaks.extract.__code__.co_firstlineno + 1
    assert said == f"ZeroDivisionError: oh (at test_conformance.py:{line})"


def test_a_fixture_gives_what_the_kit_cannot_make(monkeypatch) -> None:
    class Other(BlockLinear):
        capabilities = Capabilities(height_tolerance_mm=1e-9, fixture="kit_fixture:of_rig")

        def triangulate(self, stripes, calibration):
            own = calibration.parameters["mm_per_px_at_belt"]
            known = {"omega_mm_per_px": 1.0 / calibration.displacement_px_per_mm, "mm_per_px": own}
            whole = replace(calibration, parameters=known, covariance=np.zeros((8, 8)))
            return super().triangulate(stripes, whole)

    def of_rig(rig: LinearRig):
        plain = rig.calibration()
        scale = plain.parameters["mm_per_px"]
        return replace(plain, parameters={"mm_per_px_at_belt": scale}, covariance=np.zeros((1, 1)))

    check = _check(Other, "check_points_are_where_the_scene_is")
    assert "fixture" in run_check(Other(), check).message
    monkeypatch.setitem(__import__("sys").modules, "kit_fixture", SimpleNamespace(of_rig=of_rig))
    assert run_check(Other(), check).outcome == "passed"


def test_stages_are_found_by_every_name() -> None:
    whole = [stage.entry.name for stage in stages_named("paper")]
    assert {"dominant-peak", "block-linear", "density"} <= set(whole)
    for name in ("dominant-peak", "extractor/dominant-peak", "paper/dominant-peak"):
        assert [stage.entry.name for stage in stages_named(name)] == ["dominant-peak"]
    assert [stage.entry.kind for stage in stages_named("block-linear")] == ["calibrator", "triangulator"]
    with pytest.raises(PluginError, match="did you mean `dominant-peak`"):
        stages_named("dominant-peek")


@pytest.mark.parametrize("solid", [BOX, HALF_CYLINDER, SPHERICAL_CAP, HALF_ELLIPSOID], ids=lambda s: s.shape)
def test_solids_are_sliced_where_they_are(solid) -> None:
    """Points lie on the surface and on their plane; summed finely they give the closed form."""
    product = product_of(solid)
    xyz, plane = product.profiles.xyz_mm, product.profiles.plane
    on = np.isfinite(xyz[..., 2])
    surface = solid.surface_mm(xyz[..., 0], xyz[..., 1])
    np.testing.assert_allclose(surface[on], xyz[..., 2][on], rtol=0, atol=1e-6)  # mm
    off = np.einsum("spk,sk->sp", xyz, plane[:, :3]) - plane[:, 3:]
    np.testing.assert_allclose(off[on], 0.0, atol=1e-9)  # mm
    x, y = np.meshgrid(np.arange(-40.0, 40.0, 0.05) + 0.025, np.arange(-30.0, 30.0, 0.05) + 0.025)
    assert float(solid.surface_mm(x, y).sum() * 0.05**2) == pytest.approx(solid.volume_mm3, rel=2e-4)


def test_a_mirrored_rig_shows_the_mirrored_image() -> None:
    rig = LinearRig()
    mirrored = rig.mirrored()
    there = rig.columns - 1 - mirrored.x_px(mirrored.dome()[::-1])[::-1]
    np.testing.assert_allclose(there, rig.x_px(rig.dome()), atol=1e-9)  # px


def test_differences_are_named() -> None:
    one = Estimate(1.0, float("nan"), {"scale": 0.5})
    assert difference(one, replace(one)) is None
    assert difference(one, replace(one, budget={"scale": 0.6})) == "budget.scale is 0.5, then 0.6"
    found = difference({"a": np.array([1.0, np.nan])}, {"a": np.array([2.0, np.nan])})
    assert found == "a differs in 1 of 2 elements, first at (0,): 1.0, then 2.0"


def test_the_page_lists_every_check(root) -> None:
    page = (root / "docs" / "reference" / "conformance.md").read_text(encoding="utf-8")
    assert page.endswith(markdown()), "make the list again: the page says how"


def test_the_verb_shows_a_table_and_its_exit_code() -> None:
    done = typed("check-plugin", "density")
    assert "mass is proportional to volume" in done.stdout
    assert f"{len(checks_of('weigher'))} passed" in done.stdout


def test_the_verb_gives_json(monkeypatch) -> None:
    monkeypatch.setattr(Density, "expected_failures", {"check_an_unknown_volume_has_no_mass": "for the test"})
    done = typed("check-plugin", "weigher/density", "--json", code=1)
    rows = {row["check"]: row for row in json.loads(done.stdout)}
    assert rows["check_an_unknown_volume_has_no_mass"]["result"] == "unexpectedly passed"
    assert rows["check_mass_is_proportional_to_volume"]["result"] == "passed"
    assert rows["check_mass_is_proportional_to_volume"]["sentence"].startswith("Two and three times")
