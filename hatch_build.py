"""Compiled kernels in a wheel: what a recipe needs, compiled while the wheel is built, installed with it.

``ROEMETRY_KERNELS=recipes/herring_roe/with_outline.yaml pip wheel . --no-deps --no-build-isolation``, in an
environment that has roemetry's dependencies and hatchling. The wheel then carries the tag of its platform,
and its first run compiles nothing on machines with the same Python and numba whose processors have AVX2; on
others the kernels stand aside and the first run compiles as ever (`roemetry_kernels.kernel_cache`). Without
the variable the wheel holds sources alone.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

VARIABLE = "ROEMETRY_KERNELS"


class CompiledKernels(BuildHookInterface[Any]):
    """Runs the recipe on a copy of the sources, beside which numba puts what it compiles."""

    PLUGIN_NAME = "custom"
    work: Path | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and add what was compiled to the wheel's files."""
        recipe = os.environ.get(VARIABLE)
        if not recipe or version == "editable":
            return
        self.work = Path(tempfile.mkdtemp(prefix="roemetry-wheel-"))
        for folder in ("roemetry", "plugins"):
            shutil.copytree(
                Path(self.root, folder), self.work / folder, ignore=shutil.ignore_patterns("__pycache__")
            )
        self._register()
        paths = os.pathsep.join(map(str, (self.work, self.work / "plugins")))
        environment = os.environ | {"PYTHONPATH": paths}
        environment.pop("NUMBA_CACHE_DIR", None)
        command = [sys.executable, "-m", "roemetry", "run", str(Path(self.root, recipe))]
        subprocess.run([*command, "--out", str(self.work / "run")], check=True, env=environment)
        for path in self.work.rglob("__pycache__/*.nb[ic]"):
            place = path.relative_to(self.work)
            installed = place.relative_to("plugins") if place.parts[0] == "plugins" else place
            build_data["force_include"][str(path)] = str(installed)
        build_data["pure_python"], build_data["infer_tag"] = False, True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Take the copy away."""
        if self.work is not None:
            shutil.rmtree(self.work)

    def _register(self) -> None:
        """Let the copy's plugins be found as those of an installed package are: by its entry points."""
        assert self.work is not None
        info = self.work / f"roemetry-{self.metadata.version}.dist-info"
        info.mkdir()
        info.joinpath("METADATA").write_text(
            f"Metadata-Version: 2.1\nName: roemetry\nVersion: {self.metadata.version}\n", encoding="utf-8"
        )
        points = self.metadata.core.entry_points["roemetry"]
        lines = ["[roemetry]", *(f"{name} = {value}" for name, value in points.items())]
        info.joinpath("entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
