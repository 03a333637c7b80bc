"""The weigher that reads a scale: the right mass for the right product; every slip in its table told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import RoemetryError, StageError
from roemetry.records import Estimate
from roemetry.testing.runs import volume_of
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry_files.scale import Scale, ScaleOptions


def scale(folder: Path, text: str, **options: float) -> Scale:
    path = folder / "masses.csv"
    path.write_text(text, encoding="utf-8")
    return Scale(ScaleOptions(masses=path, **options))


def test_the_product_s_own_mass_goes_before_its_acquisition_s(tmp_path: Path) -> None:
    product, volume = product_of(HALF_ELLIPSOID), volume_of(8000.0)
    weigher = scale(tmp_path, "id,mass_g\nscene,20\nscene#1,16\n")
    assert weigher.weigh(product, volume).mass_g.value == 16.0
    assert weigher.weigh(replace(product, number=2), volume).mass_g.value == 20.0
    with pytest.raises(StageError, match=r"masses.csv has no mass of scene#1") as refused:
        scale(tmp_path, "id,mass_g\nother,30\n").weigh(product, volume)
    assert "scene#1,MASS" in str(refused.value.hint)


def test_the_specific_volume_is_of_the_true_volume_where_that_is_known(tmp_path: Path) -> None:
    product, volume = product_of(HALF_ELLIPSOID), volume_of(8000.0)
    weigher = scale(tmp_path, "id,mass_g\nscene,2.5\n", std_g=0.1)
    seen = weigher.weigh(product, volume)
    assert seen.features["specific_volume_ml_per_g"] == pytest.approx(3.2)
    assert [reason.code for reason in seen.reasons] == ["specific-volume-visible"]
    true = weigher.weigh(product, replace(volume, true_mm3=Estimate(7000.0)))
    assert true.features["specific_volume_ml_per_g"] == pytest.approx(2.8)
    assert true.reasons == ()
    assert true.mass_g.std == 0.1


def test_draws_scatter_as_the_scale_does(tmp_path: Path, rng: np.random.Generator) -> None:
    product = product_of(HALF_ELLIPSOID)
    weigher = scale(tmp_path, "id,mass_g\nscene,30\n", std_g=0.2)
    drawn = [weigher.weigh(product, volume_of(8000.0), rng=rng).mass_g.value for _ in range(400)]
    assert abs(np.mean(drawn) - 30.0) < 0.05
    assert 0.17 < np.std(drawn) < 0.23


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the table is empty"),
        ("id,weight\na,1\n", "no column `mass_g`"),
        ("id,mass_g\na,1\nb,heavy\n", "masses.csv:3: mass_g: found 'heavy'"),
        ("id,mass_g\na,0\n", "masses.csv:2:"),
        ("id,mass_g\na,12,5\n", "masses.csv:2: this line has another number of cells"),
        ("id,mass_g\na,1\na,2\n", "masses.csv:3: a stands there a second time"),
    ],
)
def test_a_slip_in_the_table_is_told_with_its_line(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(RoemetryError) as refused:
        scale(tmp_path, text).weigh(product_of(HALF_ELLIPSOID), volume_of(8000.0))
    assert says in str(refused.value)
