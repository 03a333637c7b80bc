"""What is exported, surfaces and tables, can be read by other programs and says what was measured."""

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

from roemetry import Recipe
from roemetry.calibrating.known_products import features_in
from roemetry.records import Profiles, Surface
from roemetry.run.batch import derive, run_recipe
from roemetry.run.record import read_record, recipe_of
from roemetry.testing.scenes import LinearRig
from roemetry.testing.solids import HALF_CYLINDER, HALF_ELLIPSOID, outlined, product_of
from roemetry_files import mesh_files
from roemetry_files.height_map import INTERPOLATED, SEEN, raster
from roemetry_files.mesh_files import (
    ASSUMED,
    BRIDGED,
    MEASURED,
    bridges_miss,
    certainty_of,
    colours,
    edges_of,
    mesh_of,
    ply,
    stl,
)
from roemetry_files.product_table import COLUMNS, rounded
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.slice_estimators import SlicePchip


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


COARSE = LinearRig(rows=240, columns=480, stripes=13, first_px=95.5, spacing_px=24.0, fan=0.0)
"""Stripes 6 mm apart: bridges are what lies between."""


def box(gap: bool = False) -> Surface:
    """A level top, 4 × 3 × 2 mm; with a gap of the four cells around one point."""
    x, y = np.meshgrid(np.linspace(0.0, 4.0, 9), np.linspace(0.0, 3.0, 7), indexing="ij")
    xyz = np.stack([x, y, np.full(x.shape, 2.0)], axis=-1)
    if gap:
        xyz[4, 3] = np.nan
    return Surface(xyz, np.zeros(x.shape, np.bool_))


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("gap", "volume_mm3"), [(False, 24.0), (True, 22.0)])
def test_a_box_is_closed_and_has_its_volume_without_its_gaps(gap, volume_mm3, turned) -> None:
    surface = box(gap)
    if turned:
        surface = Surface(surface.xyz_mm[::-1].copy(), surface.assumed)
    mesh = mesh_of(surface)
    assert mesh.volume_mm3 == pytest.approx(volume_mm3)
    ways = {tuple(edge) for edge in edges_of(mesh.triangles).tolist()}
    assert len(ways) == 3 * len(mesh.triangles), "an edge that two triangles run through in one way"
    assert all((end, begin) in ways for begin, end in ways), "an edge of one triangle alone"
    assert np.isfinite(mesh.vertices).all()


@pytest.mark.parametrize("solid", [HALF_ELLIPSOID, HALF_CYLINDER], ids=lambda given: str(given)[:24])
def test_a_mesh_holds_what_the_estimator_states(solid) -> None:
    """Facets cut corners."""
    product = product_of(solid)
    stated = SlicePchip().estimate(product).visible_mm3.value
    assert mesh_of(SlicePchip().surface(product)).volume_mm3 / stated == pytest.approx(1.0, abs=0.015)


@pytest.fixture(scope="module")
def made():
    product = product_of(HALF_ELLIPSOID, COARSE)
    mesh = mesh_of(SlicePchip().surface(product))
    return mesh, product, certainty_of(mesh, product)


def test_uncertainty_grows_between_stripes_and_is_not_stated_on_what_is_assumed(made) -> None:
    mesh, product, certainty = made
    assert set(np.unique(certainty.support)) == {MEASURED, ASSUMED}, "slices joined straight have no others"
    assert np.isnan(certainty.std_mm[certainty.support == ASSUMED]).all()
    assert (certainty.support[mesh.vertices[:, 2] == 0.0] == ASSUMED).all()
    spacing_mm, miss_mm = bridges_miss(product.profiles, 1)
    assert spacing_mm == pytest.approx(6.0, abs=0.1)
    assert miss_mm > 0.0


def test_bridged_vertices_are_as_sure_as_stated() -> None:
    """Of a body whose surface is known, nine tenths of the bridged vertices lie within two of their stds."""
    bare, outlined_one = product_of(HALF_ELLIPSOID, COARSE), outlined(HALF_ELLIPSOID)
    product = replace(bare, view=outlined_one.view, outline=outlined_one.outline)
    mesh = mesh_of(OutlineSurface().surface(product))
    certainty = certainty_of(mesh, product)
    bridged = certainty.support == BRIDGED
    on_line, between = (np.median(certainty.std_mm[certainty.support == k]) for k in (MEASURED, BRIDGED))
    assert on_line < between < bridges_miss(product.profiles, 1)[1]
    x, y, z = mesh.vertices[bridged].T
    # across the surface: the level set of the ellipsoid over its gradient
    a = 30.0 * np.where(x < 0.0, 0.8, 1.2)
    q = (x / a) ** 2 + (y / 15.0) ** 2 + (z / 12.0) ** 2
    slope = 2.0 * np.sqrt((x / a**2) ** 2 + (y / 15.0**2) ** 2 + (z / 12.0**2) ** 2)
    assert np.mean(np.abs(q - 1.0) / slope < 2.0 * certainty.std_mm[bridged]) > 0.9


def test_other_programs_read_the_files(made, tmp_path: Path) -> None:
    """Open3D's own readers, which are not ours: places, triangles, scalar, colours."""
    import open3d as o3d

    mesh, _, certainty = made
    (tmp_path / "a.ply").write_bytes(ply(mesh, certainty, "Größe\nx"))
    (tmp_path / "a.stl").write_bytes(stl(mesh, certainty, "a"))
    read = o3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    assert np.asarray(read.vertices) == pytest.approx(mesh.vertices, abs=1e-4)
    assert (np.asarray(read.triangles) == mesh.triangles).all()
    assert np.asarray(read.vertex_colors) * 255.0 == pytest.approx(colours(certainty), abs=0.6)
    points = o3d.t.io.read_point_cloud(str(tmp_path / "a.ply"))
    quality = points.point["quality"].numpy()[:, 0]
    assert quality == pytest.approx(certainty.std_mm, abs=1e-5, nan_ok=True)
    flat = o3d.io.read_triangle_mesh(str(tmp_path / "a.stl"))
    assert len(flat.triangles) == len(mesh.triangles)
    corners = np.asarray(flat.vertices)[np.asarray(flat.triangles)]
    inside = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert inside == pytest.approx(mesh.volume_mm3, rel=1e-4)


def test_an_estimator_without_a_surface_leaves_a_word_instead_of_files(line, tmp_path: Path) -> None:
    run_recipe(Recipe.load(line(2), sets=["sinks=[mesh-files]"]), tmp_path / "out")
    (only,) = (tmp_path / "out" / "meshes").iterdir()
    told = only.read_text("utf-8").splitlines()
    assert only.name == "not-made.txt"
    assert [text.split(":")[0] for text in told] == ["p01#1", "p02#1"]
    assert all("has no surface" in text for text in told)


def test_a_surface_without_a_whole_cell_leaves_a_word_too(line, tmp_path: Path, monkeypatch) -> None:
    def of_scattered_points(surface: Surface):
        return mesh_of(Surface(np.full_like(surface.xyz_mm, np.nan), surface.assumed))

    monkeypatch.setattr(mesh_files, "mesh_of", of_scattered_points)
    sets = ["sinks=[mesh-files]", "stages.volume=slice-pchip"]
    run_recipe(Recipe.load(line(2), sets=sets), tmp_path / "out")
    (only,) = (tmp_path / "out" / "meshes").iterdir()
    assert only.name == "not-made.txt"
    assert "p01#1: no four neighbouring points" in only.read_text("utf-8")
