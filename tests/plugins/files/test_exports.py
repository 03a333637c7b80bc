"""What is exported can be read by other programs, and says what was measured."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import tifffile

from roemetry.calibrating.known_products import features_in
from roemetry.config.recipe import Recipe
from roemetry.records import Profiles
from roemetry.run.batch import derive, run_recipe
from roemetry.run.record import read_record, recipe_of
from roemetry_files.height_map import INTERPOLATED, SEEN, raster
from roemetry_files.product_table import COLUMNS, rounded


@pytest.fixture
def out(line: Callable[..., Path], tmp_path: Path) -> Path:
    recipe = Recipe.load(line(), sets=["sinks=[parquet, point-cloud, height-map, points]"])
    outcome = run_recipe(recipe, tmp_path / "out")
    assert outcome.sink_faults == ()
    return tmp_path / "out"


def plane(heights: np.ndarray, *, stripes: list[int]) -> Profiles:
    """Slices 4 mm apart along X by their stripe, with a point each mm along Y."""
    slices, points = heights.shape
    xyz = np.empty((slices, points, 3))
    xyz[..., 0] = 4.0 * np.array(stripes)[:, None]
    xyz[..., 1] = -np.arange(points)[None, :]
    xyz[..., 2] = heights
    many = (slices, points)
    return Profiles(
        xyz_mm=xyz,
        product=np.ones(many, dtype=np.int16),
        seen=np.ones(many, dtype=bool),
        x_px=np.zeros(many),
        row_px=np.tile(np.arange(points, dtype=float), (slices, 1)),
        height_std_mm=np.full(many, np.nan),
        stripe=np.array(stripes, dtype=np.int64),
        frame=np.zeros(slices, dtype=np.int64),
        plane=np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (slices, 1)),
    )


def test_parquet_has_the_numbers_of_the_record(out: Path) -> None:
    table = pq.read_table(out / "results.parquet")
    rows = list(read_record(out))
    assert table.num_rows == len(rows)
    masses = [None if row.weight is None else row.weight.mass_g.value for row in rows]
    assert table["weight_g"].to_pylist() == masses
    assert any(mass is not None for mass in masses)
    assert table.schema.field("weight_g").metadata[b"unit"] == b"g"
    assert table.schema.field("visible_volume_cm3").metadata[b"heading"] == "visible volume (cm³)".encode()
    # an uncertainty that is not stated is nothing, not a word in a column of numbers
    assert str(table.schema.field("weight_standard_uncertainty_g").type) == "double"


def test_parquet_has_the_features_of_classifier_and_weigher(
    line: Callable[..., Path], tmp_path: Path
) -> None:
    sets = ["sinks=[parquet]", "stages.weigher={use: fitted}"]
    outcome = run_recipe(Recipe.load(line(count=1), sets=sets), tmp_path / "out")
    assert outcome.sink_faults == ()
    (row,) = read_record(tmp_path / "out")
    assert row.weight is not None and row.grade is not None
    table = pq.read_table(tmp_path / "out" / "results.parquet")
    for name, value in {**row.grade.features, **row.weight.features}.items():
        (column,) = [one for one in table.schema if one.metadata[b"heading"] == f"feature {name}".encode()]
        assert table[column.name].to_pylist() == [None if math.isnan(value) else value], name
    assert "visible_cm3" in row.weight.features


def test_cloud_and_table_of_points_have_the_points_of_the_profiles(out: Path) -> None:
    file = next((out / "point_clouds").glob("*.ply"))
    header, _, body = file.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    kinds = {"double": "<f8", "float": "<f4", "int": "<i4", "uchar": "u1"}
    fields = [(words[2], kinds[words[1]]) for words in map(str.split, lines) if words[0] == "property"]
    points = np.frombuffer(body, dtype=np.dtype(fields))
    assert f"element vertex {len(points)}" in lines
    (highest,) = (row.height_max_mm.value for row in read_record(out) if row.acquisition == file.stem)
    assert points["z"][points["product"] == 1].max() == pytest.approx(highest, abs=1e-9)
    assert set(points["stripe"]) <= set(range(1, 8))
    with (out / "points" / f"{file.stem}.csv").open(encoding="utf-8", newline="") as table:
        lines = list(csv.DictReader(table))
    on_product = [line for line in lines if line["product"] == "1" and line["Z (mm)"]]
    assert max(float(line["Z (mm)"]) for line in on_product) == pytest.approx(highest, abs=1e-4)  # mm
    for line in on_product:
        if line["x standard uncertainty (px)"]:
            assert 0.0 < float(line["random part of Z standard uncertainty (mm)"]) < 1.0


def test_a_height_map_has_the_heights_of_the_record(out: Path) -> None:
    file = next((out / "height_maps").glob("*.tif"))
    with tifffile.TiffFile(file) as pages:
        said = json.loads(pages.pages[0].description)
        grey, known = pages.pages[0].asarray(), pages.pages[1].asarray()
    assert grey.dtype == np.uint16
    assert ((grey == 0) == (known == 0)).all()
    heights = said["offset_mm"] + said["scale_mm"] * grey[known > 0]
    highest = max(row.height_max_mm.value for row in read_record(out) if row.acquisition == file.stem)
    assert heights.max() == pytest.approx(highest, abs=0.1)  # the grid need not meet the very top


def test_between_stripes_a_plane_stays_a_plane() -> None:
    heights = 1.0 + 0.5 * np.arange(5)[:, None] - 0.1 * np.arange(21)[None, :]
    found = raster(plane(heights, stripes=[0, 1, 2, 3, 4]), 0.5)
    rows, columns = found.height_mm.shape
    x = found.x_mm + 0.5 * np.arange(columns)[None, :]
    y = found.y_mm - 0.5 * np.arange(rows)[:, None]
    expected = 1.0 + 0.125 * x + 0.1 * y
    inside = np.isfinite(found.height_mm)
    assert inside.mean() > 0.9
    assert np.abs(found.height_mm - expected)[inside].max() < 1e-9
    assert set(np.unique(found.known[inside])) == {SEEN, INTERPOLATED}


def test_nothing_is_put_over_a_missing_stripe_a_gap_or_between_products() -> None:
    found = raster(plane(np.ones((3, 11)), stripes=[0, 1, 3]), 0.5)
    assert (found.known[5, 1:8] == INTERPOLATED).all()
    assert (found.known[5, 9:24] == 0).all()
    heights = np.ones((2, 31))
    heights[0, 10:20] = np.nan
    found = raster(plane(heights, stripes=[0, 1]), 0.5)
    assert (found.known[24:36, 1:8] == 0).all()
    both = plane(np.ones((2, 11)), stripes=[0, 1])
    apart = raster(replace(both, product=np.array([[1], [2]], np.int16) * np.ones_like(both.product)), 0.5)
    assert INTERPOLATED not in apart.known
    assert raster(plane(np.full((2, 5), np.nan), stripes=[0, 1]), 0.5) is None


@pytest.mark.parametrize(("sink", "folder"), [("point-cloud", "point_clouds"), ("height-map", "height_maps")])
def test_a_full_disk_leaves_no_half_file(
    sink: str, folder: str, line: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_recipe(Recipe.load(line(count=1), sets=["sinks=[]"]), tmp_path / "out")
    recipe, provenance = recipe_of(tmp_path / "out", sets=[f"sinks=[{sink}]"])

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", full)
        _, (fault,), _ = derive(recipe, tmp_path / "out", provenance)
    assert "No space left" in fault
    assert list((tmp_path / "out" / folder).iterdir()) == []
    files, faults, _ = derive(recipe, tmp_path / "out", provenance)
    assert faults == () and len(files) == 1, "with room again it is written"


def test_no_column_of_its_own_is_taken_for_a_feature() -> None:
    """Numbers in all of them, as where classes and lanes are called 1, 2, 3."""
    header = [*COLUMNS, "length_mm"]
    assert features_in(header, [(2, dict.fromkeys(header, "1"))]) == ["length_mm"]


def test_small_numbers_keep_five_digits_and_large_ones_four_decimals() -> None:
    """A curvature of 0.0123 per mm with four decimals would be off by up to half a per cent."""
    given = [22395.31234, 24.63481, 1.000049, 0.123456, -0.0123456, 4.56789e-7, 0.0, float("inf")]
    kept = [22395.3123, 24.6348, 1.0, 0.12346, -0.012346, 4.5679e-7, 0.0, float("inf")]
    assert [rounded(value) for value in given] == kept
