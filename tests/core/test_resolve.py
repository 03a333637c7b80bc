"""Options that name files: beside the recipe, named where they are missing, hashed in the record."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import Field

from roemetry.config.recipe_file import StageChoice
from roemetry.config.resolve import Chooser, misfit_of
from roemetry.io.files import sha256_of
from roemetry.records import Product, Volume, Weight
from roemetry.stages import StageOptions, Weigher
from roemetry.stages.hookspecs import StageEntry
from roemetry.stages.registry import Provider, Registered


class TableOptions(StageOptions):
    table: Path = Field(description="weighed samples")


class FromTable(Weigher[TableOptions]):
    Options = TableOptions

    def weigh(self, product: Product, volume: Volume, *, rng: object = None) -> Weight:
        raise NotImplementedError


class OneStage:
    """A registry with one stage."""

    def find(self, kind: str, name: str) -> Registered:
        entry = StageEntry(kind, name, "somewhere:FromTable", "by a table", "our own")
        return Registered(entry, Provider("test", "1", "test"))

    def load(self, registered: Registered) -> type[FromTable]:
        return FromTable


def chooser(folder: Path) -> Chooser:
    return Chooser(OneStage(), lambda at: "recipe.yaml:3:5", folder)  # type: ignore[arg-type]


def test_a_file_is_looked_for_beside_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "weighed.csv").write_text("a,b\n", encoding="utf-8")
    choice = StageChoice(use="from-table", options={"table": "weighed.csv"})
    chosen = chooser(tmp_path).choose("weigher", choice, "stages", "weigher")
    assert chosen is not None
    assert chosen.make().options.table == tmp_path / "weighed.csv"
    told = chosen.described()["options"]["table"]
    assert told == f"weighed.csv sha256 {sha256_of(tmp_path / 'weighed.csv')}"
    assert str(tmp_path) not in str(chosen.described())


def test_a_missing_file_is_a_fault_with_its_place(tmp_path: Path) -> None:
    asked = chooser(tmp_path)
    asked.choose("weigher", StageChoice(use="from-table", options={"table": "no.csv"}), "stages", "weigher")
    (fault,) = asked.faults
    assert fault.startswith("recipe.yaml:3:5: stages.weigher.options.table: there is no file")
    assert fault.endswith("no.csv")


class NoVerb(Weigher[TableOptions]):
    Options = TableOptions


class NoOptions(Weigher[TableOptions]):
    def weigh(self, product: Product, volume: Volume, *, rng: object = None) -> Weight:
        raise NotImplementedError


@pytest.mark.parametrize(
    ("cls", "kind", "says"),
    [
        (FromTable, "extractor", "class FromTable does not inherit from `roemetry.stages.Extractor`"),
        (int, "volume", "class int does not inherit from `roemetry.stages.VolumeEstimator`"),
        (NoVerb, "weigher", "class NoVerb does not define `weigh`"),
        (NoOptions, "weigher", "class NoOptions has no options: write `Options = TableOptions` in its body"),
    ],
)
def test_a_class_that_cannot_be_a_stage_is_told_why(cls: type, kind: str, says: str) -> None:
    assert misfit_of(cls, kind) == says


def test_a_class_that_can_be_a_stage() -> None:
    assert misfit_of(FromTable, "weigher") is None
    assert misfit_of(type("Inherits", (FromTable,), {}), "weigher") is None


def test_a_class_without_its_verb_is_a_fault_of_the_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OneStage, "load", lambda self, registered: NoVerb)
    asked = chooser(tmp_path)
    assert asked.choose("weigher", StageChoice(use="from-table"), "stages", "weigher") is None
    (fault,) = asked.faults
    assert fault.endswith("from-table of test 1 (test) cannot be used: class NoVerb does not define `weigh`")
