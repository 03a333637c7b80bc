"""Questions to the tables of a run and of many, and one product's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

from roemetry.cli.main import app
from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, OutputError
from roemetry.run.batch import run_recipe
from roemetry_files import product_table


def said(*words: str | Path) -> str:
    found = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert found.exit_code == 0
    return found.output


def test_runs_become_one_table_by_day_and_run(
    line: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(product_table, "_BLOCK", 2)
    recipe = Recipe.load(line(3))
    for name in ("one", "two"):
        run_recipe(recipe, tmp_path / name)
        said("export", tmp_path / name, "parquet", "--set", f"folder={tmp_path / 'season'}")
    whole = pd.read_parquet(tmp_path / "season")
    assert len(whole) == 6
    assert set(whole["run"]) == {"one", "two"}
    assert whole["day"].nunique() == 1
    told = said(
        "query", tmp_path / "season", "select run, count(*) from products group by run order by run", "--csv"
    )
    assert told.splitlines()[1:] == ["one,3", "two,3"]
    assert "p02#1" in said("query", tmp_path / "season", "--product", "p02#1")


def test_a_table_that_is_missing_and_a_wrong_question_are_told(line: Any, tmp_path: Path) -> None:
    run_recipe(Recipe.load(line(2)), tmp_path / "out")
    with pytest.raises(OutputError, match="is not there") as error:
        said("query", tmp_path / "out")
    assert "export" in str(error.value)
    said("export", tmp_path / "out", "parquet")
    with pytest.raises(ConfigurationError, match="nothing_such"):
        said("query", tmp_path / "out", "select nothing_such from products")
    with pytest.raises(OutputError, match="no such product"):
        said("query", tmp_path / "out", "--product", "p77")


def test_one_product_has_files_of_its_own(line: Any, tmp_path: Path) -> None:
    run_recipe(Recipe.load(line(3)), tmp_path / "out")
    (table,) = said("report", tmp_path / "out", "--product", "p02").split()
    rows = Path(table).read_text("utf-8").splitlines()
    assert Path(table).parent.parent == tmp_path / "out"
    assert [row.split(",")[0] for row in rows] == ["id", "p02#1"]
    with pytest.raises(OutputError, match="there is no product `p77`"):
        said("report", tmp_path / "out", "--product", "p77")
