"""Every method that can be right or wrong has measured figures on its page, with the command for them."""

from __future__ import annotations

import re

import pytest
from reading import ROOT

from roemetry.stages.registry import discover

METHODS = ("extractor", "coder", "smoother", "triangulator", "volume", "classifier")
_OWN = [stage.entry for stage in discover().stages if stage.provider.distribution == "roemetry"]


@pytest.mark.parametrize("name", sorted({entry.name for entry in _OWN if entry.kind in METHODS}))
def test_a_method_has_its_measured_figures(name: str) -> None:
    page = (ROOT / "docs" / "reference" / "plugins" / f"{name}.md").read_text("utf-8")
    parts = [part for part in re.split(r"^## ", page, flags=re.MULTILINE) if "python -m benchmarks" in part]
    assert any(re.search(r"\d[.\d]* ?(%|ms|px|mm|σ)|\d\.\d", part) for part in parts)
