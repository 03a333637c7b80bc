"""The calibration file: comes back as it was, says when it is damaged, redraws what it says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import RoemetryError
from roemetry.records.calibration import Calibration


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
