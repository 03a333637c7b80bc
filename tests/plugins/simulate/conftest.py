"""Small scenes of the ray caster, written to a file and loaded as a user's are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from roemetry.config.scene import Scene
from roemetry.io.yaml_source import dump


@pytest.fixture
def scene(tmp_path: Path) -> Callable[..., Scene]:
    """Load a scene of these options of the simulator; 160 by 120 pixels, where they do not say."""

    def load(**options: Any) -> Scene:
        camera = {"width_px": 160, "height_px": 120, "pixel_size_um": 40} | options.pop("camera", {})
        told = {
            "roemetry_scene": 1,
            "name": "trial",
            "licence": "CC0-1.0",
            "simulator": {"use": "ray-caster", "options": {"camera": camera, **options}},
        }
        (tmp_path / "scene.yaml").write_text(dump(told), encoding="utf-8")
        return Scene.load(tmp_path)

    return load
