"""House rules on packaging: what is declared is there, and what is there is declared."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

from roemetry.stages import INTERFACES
from roemetry.stages.registry import discover
from roemetry_tools.doctor import REFERENCE_VALUES, reference_values

LIBRARIES = {"roemetry_kernels"}


def test_entry_points_equal_folders_equal_what_is_installed(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    declared = set(project["entry-points"]["roemetry"].values())
    folders = {folder.name for folder in (root / "plugins").iterdir() if (folder / "__init__.py").exists()}
    installed = {point.value for point in entry_points(group="roemetry") if point.dist.name == "roemetry"}
    assert declared == folders - LIBRARIES
    assert installed == declared, "reinstall: pip install -e ."


def test_every_registered_stage_can_be_imported_and_is_of_its_kind() -> None:
    registry = discover()
    assert registry.broken == ()
    for stage in registry.stages:
        found = registry.load(stage)
        assert issubclass(found, INTERFACES[stage.entry.kind])
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", stage.entry.name)
        for name, field in found.Options.model_fields.items():
            assert field.description, f"{stage.entry.name}.{name} has no description"


def test_every_package_is_typed(root: Path) -> None:
    packages = [root / "roemetry", *(f for f in (root / "plugins").iterdir() if (f / "__init__.py").exists())]
    assert [package.name for package in packages if not (package / "py.typed").exists()] == []


def test_all_that_the_doctor_needs_lies_in_the_package(root: Path) -> None:
    build = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]
    included = build["targets"]["wheel"]["force-include"]
    folder = root / "recipes" / "herring_roe"
    names = {row.partition("#")[0] for row in reference_values(folder)}
    needed = ["recipe.yaml", "calibration.yaml", REFERENCE_VALUES, *(f"images/{name}.png" for name in names)]
    for name in (f"recipes/herring_roe/{name}" for name in needed):
        assert any(name == path or name.startswith(f"{path}/") for path in included), name


def test_every_product_line_can_be_begun_from_a_wheel(root: Path) -> None:
    """Its small files lie in the package; its images do not."""
    build = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]
    included = build["targets"]["wheel"]["force-include"]
    assert included["calib_targets"] == "roemetry/calib_targets"
    lines = [folder for folder in (root / "recipes").iterdir() if (folder / "scene.yaml").is_file()]
    for line in lines:
        recipe = (line / "recipe.yaml").read_text("utf-8")
        tables = [path.name for path in line.glob("*.csv") if path.name in recipe]
        for name in ("recipe.yaml", "rig.yaml", "scene.yaml", "calibration.yaml", *tables):
            path = f"recipes/{line.name}/{name}"
            assert included.get(path) == f"roemetry/{path}", path
    assert len(lines) == 5
    texts = [path for path in included if path.startswith("recipes/") and "." in path and ".png" not in path]
    assert sum((root / path).stat().st_size for path in texts) < 400_000
