"""Every shipped recipe says what it said when its golden records were written."""

from __future__ import annotations

import json

import pytest

from benchmarks import golden


@pytest.mark.parametrize("name", golden.RECIPES)
def test_a_shipped_recipe_says_what_it_said(name: str) -> None:
    """`python -m benchmarks golden --write` writes them anew, where numbers are meant to change."""
    expected = json.loads(golden.file_of(name).read_text("utf-8"))
    found = json.loads(json.dumps(golden.records(name)))
    assert list(golden.differences(expected, found, name)) == []


def test_every_shipped_recipe_has_golden_records() -> None:
    """A new recipe is frozen, too."""
    paths = (golden.ROOT / "recipes").glob("*/*.yaml")
    recipes = {f"{p.parent.name}/{p.stem}" for p in paths if "\nstages:" in p.read_text("utf-8")}
    assert recipes == set(golden.RECIPES)


@pytest.mark.parametrize(
    ("expected", "found", "many"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-9}, 0),
        ({"a": 1.0}, {"a": 1.0 + 1e-5}, 1),
        ({"a": None}, {"a": 1.0}, 1),
        ({"a": 1.0}, {"b": 1.0}, 2),
        (["good"], ["dent"], 1),
        ([1.0, 2.0], [1.0], 1),
    ],
)
def test_differences_are_seen(expected: object, found: object, many: int) -> None:
    """The comparison itself."""
    assert len(list(golden.differences(expected, found, "x"))) == many
