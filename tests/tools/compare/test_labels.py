"""Labels by hand, with a data set and without."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from roemetry.calibrating.known_products import read_labels
from roemetry.errors import DataError
from roemetry.stages.registry import discover
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data, labelled
from roemetry_tools.compare.variants import make_variants


def test_labels_count_instead_of_those_of_the_set(
    dataset: Callable[..., Path], tmp_path: Path, roemetry: Callable[..., int]
) -> None:
    table = tmp_path / "labels.csv"
    table.write_text("id,label\np01,good\np02#1,dull\n", encoding="utf-8")
    assert roemetry(dataset(), "--labels", table, "--out", tmp_path / "out") == 0
    told = json.loads((tmp_path / "out" / "comparison.json").read_text("utf-8"))
    assert told["data"]["labels"] == 2
    classes = told["variants"][0]["figures"]["classes"]
    assert (classes["n"], classes["true"]) == (2, ["dull", "good"])


def test_labels_make_classes_known_without_a_data_set(line: Callable[..., Path]) -> None:
    variants = make_variants(line(2), [], registry=discover())
    assert variants[0].recipe is not None
    (found,) = compare(variants, Data(variants[0].recipe, labels={"p01#1": "good"}))
    assert found.figures is not None
    assert found.figures.classes is not None
    assert found.figures.classes.n == 1
    with pytest.raises(DataError, match="labels of what is not there: p77#1"):
        Data(variants[0].recipe, labels={"p77#1": "good"})


def test_labels_without_a_data_set_keep_the_products_numbers() -> None:
    many = labelled(None, "a", {f"a#{number}": f"class {number}" for number in range(1, 12)})
    assert many is not None
    assert [one.label for one in many.products] == [f"class {number}" for number in range(1, 12)]
    second = labelled(None, "a", {"a#2": "dull", "aa#1": "good"})
    assert second is not None
    assert [one.label for one in second.products] == ["", "dull"]
    assert labelled(None, "a", {"b#1": "good"}) is None


@pytest.mark.parametrize("name", ["p01#", "p01#x", "p01#0", "p01#1#1"])
def test_a_label_of_no_products_number_is_told(line: Callable[..., Path], name: str) -> None:
    recipe = make_variants(line(1), [], registry=discover())[0].recipe
    assert recipe is not None
    with pytest.raises(DataError, match=f"labels of what is not there: {name}"):
        Data(recipe, labels={name: "good"})


def test_a_product_that_is_labelled_twice_is_told(tmp_path: Path) -> None:
    table = tmp_path / "labels.csv"
    table.write_text("id,label\np01,good\np01,dull\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"labels.csv:3: p01 stands there a second time"):
        read_labels(table)
