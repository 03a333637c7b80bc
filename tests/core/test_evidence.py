"""The page of a calibration: height uncertainty against closed forms, residuals where they arose."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import roemetry
import roemetry.calibrating
from roemetry.calibrating import correlations, coverage, evidence_page, height_uncertainty, level_line_px
from roemetry.records import Evidence, EvidenceFigure, Residuals
from roemetry.records.calibration import Calibration
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear
from tests.command import typed

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
