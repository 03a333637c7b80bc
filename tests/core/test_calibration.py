"""The calibration file and its page, against closed forms; products from points of known bodies."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import roemetry
import roemetry.calibrating
from roemetry.calibrating import correlations, coverage, evidence_page, height_uncertainty, level_line_px
from roemetry.errors import ConfigurationError, DataError, RoemetryError
from roemetry.records import Evidence, EvidenceFigure, Residuals
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear
from tests.command import typed


def test_round_trip(rig, tmp_path: Path) -> None:
    target = {"kind": "block", "serial": None}
    made = replace(rig.calibration(), notes=("a: note",), made="2026-01-01T00:00:00+00:00", target=target)
    made.save(tmp_path / "c.yaml")
    back = Calibration.load(tmp_path / "c.yaml")
    assert back.to_dict() == made.to_dict()
    assert back.sha256 == made.sha256 == replace(back, made="later").sha256
    assert back.sha256 != replace(back, turn_deg=90).sha256
    broken = {**made.parameters, "mm_per_px": np.full_like(made.parameters["mm_per_px"], np.nan)}
    replace(made, parameters=broken).save(tmp_path / "c.yaml")
    with pytest.raises(
        RoemetryError, match=r"c\.yaml: parameters\.mm_per_px holds a number that is not finite"
    ):
        Calibration.load(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("roemetry_calibration: 1", "roemetry_calibration: 2", "format 2"),
        ("roemetry_calibration: 1", "something: 1", "not a calibration file"),
        ("method: block-linear", "", "'method' is missing"),
        ("rows: 240", "rows: many", "damaged"),
        ("covariance:", "covarianze:", "'covariance' is missing"),
        ("residuals:", "residuals: {1.5: 2.0}\nother:", "a number where a name"),
        ("rest_px:", "rest_px: [[1, 2], [3]]\nother:", "damaged"),
    ],
)
def test_a_damaged_file_is_named(rig, tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "c.yaml"
    rig.calibration().save(path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(RoemetryError, match=says):
        Calibration.load(path)


@pytest.mark.parametrize(
    ("one", "other", "value", "says"),
    [
        (0, 0, -1e-4, r"the variance of [a-z_]+\[0\] is -0\.0001"),
        (0, 1, 2e-4, r"[a-z_]+\[0\] with [a-z_]+\[1\] is another number"),
        ((0, 1), (1, 0), 2e-4, r"a sum of [a-z_]+\[[01]\], [a-z_]+\[[01]\] and others has the variance -1"),
    ],
    ids=["negative", "uneven", "correlated by 2"],
)
def test_a_covariance_that_is_none_is_refused_by_name(
    rig, tmp_path: Path, one: object, other: object, value: float, says: str
) -> None:
    made = rig.calibration()
    covariance = 1e-4 * np.eye(made.covariance.shape[0])
    replace(made, covariance=covariance).save(tmp_path / "sound.yaml")
    Calibration.load(tmp_path / "sound.yaml")
    covariance[one, other] = value
    replace(made, covariance=covariance).save(tmp_path / "c.yaml")
    with pytest.raises(RoemetryError, match=rf"covariance is not positive semi-definite.*{says}"):
        Calibration.load(tmp_path / "c.yaml")


def test_rest_lines_are_polynomials_about_the_middle_row(rig) -> None:
    made = replace(rig.calibration(), rest_px=np.array([[100.0, 0.5]] * rig.stripes))
    x_px = made.rest_line_px(np.array([0.0, 119.5, 239.0]))
    np.testing.assert_allclose(x_px[0], [100 - 0.5 * 119.5, 100.0, 100 + 0.5 * 119.5], rtol=0, atol=1e-9)


def test_redraws_have_the_stated_covariance(rig, rng: np.random.Generator) -> None:
    size = rig.stripes + 1
    root = rng.normal(size=(size, size)) * 0.01
    covariance = root @ root.T
    made = replace(rig.calibration(), covariance=covariance)
    drawn = [made.redraw(rng).parameters.values() for _ in range(4000)]
    draws = np.array([np.concatenate([np.ravel(values) for values in one]) for one in drawn])
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs((np.cov(draws.T) - covariance) / scale).max() < 0.08


RIG = LinearRig()


def calibration(relative: float = 0.01):
    exact = RIG.calibration()
    omega = exact.parameters["omega_mm_per_px"]
    covariance = np.zeros_like(exact.covariance)
    covariance[: omega.size, : omega.size] = relative**2 * np.outer(omega, omega)
    return replace(exact, covariance=covariance)


@pytest.mark.parametrize("exact", [True, False])
def test_a_scale_known_to_one_per_cent_gives_one_per_cent_of_height(exact: bool) -> None:
    given = replace(calibration(), view=replace(RIG.view(), exact=exact))
    found = height_uncertainty(given, BlockLinear())
    expected = 0.01 * found.height_mm
    middle = found.std_mm[3, :, 1]
    seen = np.isfinite(middle)
    assert seen.sum() >= 4
    # 200 redraws know a standard deviation to 5 %.
    np.testing.assert_allclose(middle[seen], expected[seen], rtol=0.15, atol=1e-9)  # mm


def test_stripes_are_put_where_a_level_surface_shows_them() -> None:
    row = np.arange(RIG.rows, dtype=float)
    np.testing.assert_allclose(
        level_line_px(RIG.calibration(), row, 7.0), RIG.x_px(np.full((RIG.stripes, RIG.rows), 7.0)), atol=1e-6
    )  # px


def residuals(**changes) -> Residuals:
    rng = np.random.default_rng(2)
    xy = rng.uniform([0, 0], [RIG.columns / 2, RIG.rows], (500, 2))
    given = Residuals("corners", "px", xy, rng.normal(0.0, 0.1, 500), np.zeros(500, np.int64), "of 10 boards")
    return replace(given, **changes)


def test_coverage_counts_cells_and_correlations_leave_out_what_is_certain() -> None:
    count = coverage(residuals(), (RIG.rows, RIG.columns))
    assert count.sum() == 500
    assert (count > 0).mean() == pytest.approx(0.5)
    assert (count[:, 4:] == 0).all(), "nothing to the right"
    matrix, names = correlations(calibration())
    assert names[0] == "omega_mm_per_px 1"
    assert "mm_per_px" not in names
    np.testing.assert_allclose(matrix, 1.0, atol=1e-12)


def test_the_page_shows_what_the_calibrator_can_show() -> None:
    evidence = Evidence(
        verdict=("Fit for heights <25 mm.",),
        figures=(EvidenceFigure("reprojection", 0.3, "px", "all boards", 0.2),),
        residuals=(residuals(held_out=True),),
    )
    text = evidence_page(calibration(), evidence, BlockLinear(), name="line & rig")
    assert "Fit for heights &lt;25 mm." in text
    assert "line &amp; rig" in text
    assert re.search(r'class="n over">0.3 px', text), "a figure over its limit is marked"
    assert "held out" in text
    assert text.count('class="point"') == 500
    assert "Hardly told apart" in text
    assert "http" not in re.sub(r"http://www.w3.org|http-equiv", "", text)


def test_what_its_own_checks_refuse_is_written_only_on_demand_and_marked(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Calibration.load(root / "recipes" / "herring_roe" / "calibration.yaml")
    verdict = Evidence(verdict=("Not usable from 0 to 20 mm: heights are off.",), usable=False)
    monkeypatch.setattr(roemetry.calibrating, "calibrate_with_evidence", lambda rig, **_: (made, verdict))
    rig, out = str(root / "recipes" / "herring_roe" / "rig.yaml"), tmp_path / "c.yaml"
    refused = typed("calibrate", rig, "--out", out, code=1)
    assert not out.exists()
    assert "Not usable" in str(refused.exception) + refused.output
    typed("calibrate", rig, "--out", out, "--accept-poor")
    assert Calibration.load(out).poor.startswith("Not usable")
    recipe = roemetry.Recipe.load(root / "recipes" / "herring_roe", sets=[f"calibration={out}"])
    row = next(iter(recipe.run()))
    assert "calibration-poor" in [reason.code for reason in row.reasons]


def ellipsoid(x: Floats, y: Floats) -> Floats:
    """Height of half an ellipsoid of 40 × 20 × 15 mm half axes; NaN beside it."""
    with np.errstate(invalid="ignore"):
        return 15.0 * np.sqrt(1.0 - (x / 40.0) ** 2 - (y / 20.0) ** 2)


TRUE_MM3 = 2.0 / 3.0 * math.pi * 40.0 * 20.0 * 15.0


def test_half_an_ellipsoid_from_slices_within_half_a_percent() -> None:
    slices = []
    for x in np.linspace(-37.0, 37.0, 19):
        y = np.arange(-20.0, 20.01, 0.1)
        z = ellipsoid(np.full(y.size, x), y)
        on = np.isfinite(z)
        slices.append(np.column_stack([np.full(on.sum(), x), y[on], z[on]]))
    product = roemetry.product_from_points(slices[::-1])
    volume = roemetry.make_stage("volume", "slice-pchip").estimate(product)
    assert volume.visible_mm3.value == pytest.approx(TRUE_MM3, rel=0.005)


def test_half_an_ellipsoid_from_a_cloud_within_two_percent(rng: np.random.Generator) -> None:
    xy = rng.uniform((-40.0, -20.0), (40.0, 20.0), (60_000, 2))
    z = ellipsoid(*xy.T)
    cloud = np.column_stack([xy, z])[np.isfinite(z)]
    product = roemetry.product_from_points(cloud, slice_mm=2.0)
    volume = roemetry.make_stage("volume", "slice-pchip").estimate(product)
    assert volume.visible_mm3.value == pytest.approx(TRUE_MM3, rel=0.02)


@pytest.mark.parametrize(
    ("points", "slice_mm", "words"),
    [
        (np.zeros((9, 3)), None, "cloud needs slice_mm"),
        ([np.zeros((9, 2))], None, r"shape \(9, 2\)"),
        ([np.array([[0.0, 0.0, np.nan]] * 4)], None, "finite"),
        ([np.zeros((2, 3))], None, "2 points"),
        (
            [np.column_stack([10.0 * np.arange(9.0), np.zeros(9), np.arange(9.0) % 2])],
            None,
            "no section along Y",
        ),
        (np.zeros((9, 3)), -1.0, "more than 0"),
    ],
)
def test_points_that_are_no_section_are_refused(points: object, slice_mm: float | None, words: str) -> None:
    with pytest.raises(DataError) as told:
        roemetry.product_from_points(points, slice_mm=slice_mm)  # type: ignore[arg-type]

    assert re.search(words, f"{told.value} {told.value.hint}")


def test_a_stage_is_made_by_name_and_says_what_it_does_not_know() -> None:
    assert roemetry.make_stage("extractor", "gaussian", threshold=25).options.threshold == 25
    with pytest.raises(ConfigurationError, match="threshhold"):
        roemetry.make_stage("extractor", "gaussian", threshhold=25)
    with pytest.raises(ConfigurationError, match="gaussian"):
        roemetry.make_stage("extractor", "gausian")


def test_a_recipe_takes_stages_as_objects() -> None:
    recipe = roemetry.Recipe.of(
        {
            "roemetry": 1,
            "product": "skeins",
            "source": {"path": "images"},
            "stages": {
                "extractor": roemetry.make_stage("extractor", "gaussian", threshold=25),
                "coder": "window-tracking",
            },
        },
        folder="recipes/herring_roe",
    )
    assert recipe.stages["extractor"].options.model_dump()["threshold"] == 25
