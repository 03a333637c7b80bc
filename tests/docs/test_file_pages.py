"""Recipe, rig, target and calibration: their keys, and examples that load."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import StageChoice
from roemetry.config.rig import Rig, RigFile
from roemetry.config.target_file import BlockFile, BoardFile, StaircaseFile
from roemetry.io.yaml_source import parse
from roemetry.records.calibration import Calibration
from tests.docs.reading import REFERENCE, ROOT, blocks, coded, firsts, page, section, table, text_of


def keys_of(model: type[BaseModel], before: str = "") -> dict[str, Any]:
    """Field by its dotted path; a chosen stage is one key."""
    found = {}
    for name, field in model.model_fields.items():
        found[before + name] = field
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel) and not issubclass(part, StageChoice):
                found |= keys_of(part, f"{before}{name}.")
    return found


def test_the_keys_of_a_rig_and_a_target_are_those_of_their_models() -> None:
    rows = {coded(row[0])[0]: row for row in table(page("rig.md")) if re.fullmatch("`[a-z_.]+`", row[0])}
    # a further board's keys are those of the first
    fields = {key: one for key, one in keys_of(RigFile).items() if not key.startswith("more_boards.board.")}
    for before, model in (("target", BlockFile), ("board", BoardFile), ("staircase", StaircaseFile)):
        assert {f"{before}.{name}" for name in model.model_fields} <= set(fields)
    assert set(rows) == set(fields)
    for key, field in fields.items():
        default = field.get_default(call_default_factory=True)
        default = default.use if isinstance(default, StageChoice) else default
        assert rows[key][1] == ("required" if field.is_required() else text_of(default)), key


def complete(first: str) -> list[str]:
    paths = [*REFERENCE.rglob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")]
    texts = [text for path in paths for _, text in blocks(path.read_text("utf-8"), "yaml")]
    found = [text for text in texts if text.startswith(first)]
    assert found
    return found


def test_every_complete_recipe_in_the_pages_loads(tmp_path: Path, rig: Any) -> None:
    for content in complete("roemetry: 1\n"):
        data = parse(content, "the page").data
        if "calibration" in data:
            rig.calibration().save(tmp_path / data["calibration"])
        path = tmp_path / "recipe.yaml"
        path.write_text(content, "utf-8")
        assert set(Recipe.load(path).stages) - {"aligner"} == set(data["stages"]) - {"aligner"}, content


def test_every_complete_rig_in_the_pages_loads(tmp_path: Path) -> None:
    for content in complete("roemetry_rig: 1\n"):
        data = parse(content, "the page").data
        for name in (name for names in data["images"].values() for name in names):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name.replace("*", "1")).touch()
        (tmp_path / "rig.yaml").write_text(content, "utf-8")
        for target in complete("kind: block") if "target" in data else [""]:
            if target:
                (tmp_path / data["target"]).write_text(target, "utf-8")
            rig = Rig.load(tmp_path / "rig.yaml")
            assert (rig.block is not None) == bool(target)
            assert sum(map(len, rig.images.values())) >= 2


def test_the_keys_of_a_calibration_are_those_that_are_written(rig: Any) -> None:
    text = page("calibration-file.md")
    drawn = rig.calibration().to_dict()
    shipped = Calibration.load(ROOT / "recipes" / "herring_roe" / "calibration.yaml").to_dict()
    assert set(shipped) == set(drawn)
    rows = section(text, "## Keys").split("### ")[0]
    assert set(firsts(rows)) == set(shipped)
    # the shipped calibration was made before the lens was taken out; readers take a missing one for 0
    parameters = set(firsts(section(text, "### Parameters of `block-linear`")))
    assert parameters - {"bow_per_px2"} == set(shipped["parameters"]) - {"bow_per_px2"}
    assert set(firsts(section(text, "### Residuals of `block-linear`"))) == set(shipped["residuals"])
    assert set(coded(section(text, "### Target"))) == set(shipped["target"])
    for key in ("image_size", "extractor"):
        (row,) = [row for row in table(rows) if coded(row[0]) == [key]]
        assert set(coded(row[-1])) == set(shipped[key])
