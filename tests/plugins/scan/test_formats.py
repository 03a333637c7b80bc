"""Heights and points in files: read back as written, and refused where they are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roemetry.config.recipe import Recipe
from roemetry.errors import DataError, RoemetryError
from roemetry.run.open_parts import split_products
from roemetry.run.pipeline import Pipeline
from roemetry.run.scan import measured_by_another
from roemetry_scan.dense import DenseSlices
from roemetry_scan.formats import read, write
from roemetry_scan.formats.points import Measured, measured_of, profiles_of
from roemetry_scan.placing import BeltMotion

CLOUDS, GRIDS = ("ply", "pcd", "las", "csv"), ("tif", "npy", "png", "x3p")


def dome() -> Measured:
    """A dome of 12 mm on a belt, in slices of 0.5 mm, with a place where nothing is known."""
    x, y = np.meshgrid(np.arange(0.0, 40.0, 0.5), np.arange(30.0, 0.0, -0.25), indexing="ij")
    z = 12.0 - ((x - 20.0) / 4.0) ** 2 - ((y - 15.0) / 3.0) ** 2
    xyz = np.stack([x, y, np.maximum(z, 0.0)], axis=-1)
    xyz[3:5, 7] = np.nan
    return Measured(xyz)


def volume(path: Path, **options: object) -> float:
    recipe = Recipe.of(
        {
            "roemetry": 1,
            "product": "a dome",
            "source": {"use": "height-files", "path": path.name, "options": options},
            "stages": {"volume": "dense-slices"},
        },
        folder=path.parent,
    )
    trace = Pipeline(recipe, draws=0, debug=True).trace(recipe.source.make().read(recipe.references()[0]))
    assert len(trace.products) == 1
    found = trace.products[0].volume
    assert found is not None
    return found.visible_mm3.value


TRUE_MM3 = 0.5 * np.pi * (4.0 * np.sqrt(12.0)) * (3.0 * np.sqrt(12.0)) * 12.0
"""An elliptic paraboloid: half of base area times height."""


@pytest.mark.parametrize("suffix", CLOUDS)
def test_clouds_keep_their_slices(tmp_path: Path, suffix: str) -> None:
    path, given = tmp_path / f"a.{suffix}", dome().xyz_mm
    write(path, dome())
    again = read(path).xyz_mm
    assert again.ndim == 3
    known = np.isfinite(again).all(axis=2)
    assert np.abs(again[known] - given[np.isfinite(given).all(axis=2)]).max() < 1e-4


def test_the_volume_of_a_file_is_that_of_the_body_also_turned(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write(path, dome())
    found = volume(path)
    assert abs(found / TRUE_MM3 - 1.0) < 2e-3
    assert abs(volume(path, turn=90) / found - 1.0) < 5e-3


@pytest.mark.parametrize("suffix", CLOUDS + GRIDS)
def test_a_file_has_the_volume_that_was_written(tmp_path: Path, suffix: str) -> None:
    """Slices that lie aslant, as those of a rig do, keep their volume to 0.02 % in every format."""
    lean = dome().xyz_mm.copy()
    lean[..., 0] += 0.1 * lean[..., 2] + 0.01 * lean[..., 1]
    first, again = tmp_path / "first.ply", tmp_path / f"again.{suffix}"
    write(first, Measured(lean))
    write(again, Measured(lean))
    assert abs(volume(again) / volume(first) - 1.0) < 2e-4


@pytest.mark.parametrize("suffix", CLOUDS + GRIDS)
def test_a_flank_that_nobody_saw_is_followed_in_a_file_as_in_the_scan(tmp_path: Path, suffix: str) -> None:
    """A shadow behind the dome, and a line that was lost: the sink leaves out what was added there."""
    xyz = dome().xyz_mm.copy()
    xyz[(xyz[..., 0] > 30.0) & (xyz[..., 0] < 36.0) & (np.abs(xyz[..., 1] - 15.0) < 11.0)] = np.nan
    xyz[40] = np.nan
    scan = BeltMotion().label(profiles_of(Measured(xyz), None, "scan"))
    (product,) = split_products(scan, (), measured_by_another(scan), "scan")
    first = DenseSlices().estimate(product)
    assert first.shares.seen < 0.99
    path = tmp_path / f"a.{suffix}"
    write(path, measured_of(scan))
    assert abs(volume(path) / first.visible_mm3.value - 1.0) < 2e-4
    again = profiles_of(read(path), None, "again")
    assert np.array_equal(again.stripe - again.stripe[0], scan.stripe - scan.stripe[0])


@pytest.mark.parametrize("suffix", CLOUDS + GRIDS)
def test_a_file_that_is_cut_off_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write(path, dome())
    data = path.read_bytes()
    for share in (0.0, 0.01, 0.5, 0.97):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(RoemetryError, match="a\\."):
            read(path)


def test_metres_are_noticed_by_the_extent_and_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write(path, Measured(dome().xyz_mm / 1000.0))
    with pytest.raises(DataError, match="metres"):
        volume(path)
    assert abs(volume(path, unit="m") / TRUE_MM3 - 1.0) < 2e-3
    with pytest.raises(DataError, match="not known"):
        profiles_of(Measured(np.full((10, 20, 3), np.nan)), None, "map")
    with pytest.raises(DataError, match="lie at one place"):  # zeros for what is not known
        profiles_of(Measured(np.zeros((10, 20, 3))), None, "map")


def test_a_cloud_without_slices_is_laid_on_a_grid(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    points = dome().xyz_mm.reshape(-1, 3)
    points = points[np.isfinite(points[:, 0])]
    path.write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in points))
    assert abs(volume(path, pixel_mm=0.5) / TRUE_MM3 - 1.0) < 0.01


def test_coord3d_frames_are_read_by_their_sidecar(tmp_path: Path) -> None:
    xyz = np.nan_to_num(dome().xyz_mm.transpose(1, 0, 2), nan=-1.0)
    np.save(tmp_path / "a.npy", ((xyz + 5.0) / 0.01).astype(np.uint16))
    axis = "{scale: 0.01, offset: -5}"
    (tmp_path / "a.yaml").write_text(
        f"pixel_format: Coord3D_ABC16\nx: {axis}\ny: {axis}\nz: {axis}\nno_data: 400\n"
    )
    found = read(tmp_path / "a.npy").xyz_mm
    known = np.isfinite(dome().xyz_mm)
    assert np.abs(found - dome().xyz_mm)[known].max() < 0.01
    assert np.isnan(found[3, 7]).all()
