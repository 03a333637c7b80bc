"""House rules on packaging and imports: what is declared is there, imports are cheap and go one way."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import pytest

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


HEAVY = ("numba", "cv2", "scipy", "open3d", "matplotlib", "jinja2")


def test_what_a_user_waits_for_imports_nothing_heavy() -> None:
    program = (
        "import sys\n"
        "from roemetry.cli.main import main\n"
        "for words in (['--help'], ['run', '--help'], ['plugins'], ['--version']):\n"
        "    sys.argv = ['roemetry', *words]\n"
        "    try: main()\n"
        "    except SystemExit as ended: assert not ended.code, words\n"
        f"    found = [name for name in {HEAVY!r} if name in sys.modules]\n"
        "    assert not found, (words, found)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_roemetry_imports_nothing_but_itself() -> None:
    program = (
        "import sys; import roemetry; print([m for m in ('numpy', 'typer', 'pydantic') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    import roemetry

    assert set(roemetry.__all__) == {name for name in dir(roemetry) if not name.startswith("__")}
    for name in roemetry.__all__:
        assert getattr(roemetry, name).__name__ == name
    with pytest.raises(AttributeError):
        _ = roemetry.nothing  # type: ignore[attr-defined]


def test_no_file_holds_two_ideas(root: Path) -> None:
    """One idea may fill a file; past 700 lines it holds two."""
    files = [*root.glob("roemetry/**/*.py"), *root.glob("plugins/**/*.py")]
    assert len(files) > 40
    assert {file.name: n for file in files if (n := len(file.read_text("utf-8").splitlines())) > 700} == {}
