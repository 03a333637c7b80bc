"""Closed meshes: known bodies, gaps, files that other programs read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry import Recipe
from roemetry.records import Surface
from roemetry.run.batch import run_recipe
from roemetry.testing.scenes import LinearRig
from roemetry.testing.solids import HALF_CYLINDER, HALF_ELLIPSOID, outlined, product_of
from roemetry_files import mesh_files
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
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.slice_estimators import SlicePchip

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
