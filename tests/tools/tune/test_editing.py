"""A YAML text is changed where it is wanted and nowhere else."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from roemetry.io.yaml_source import parse
from roemetry_tools.tune.editing import differences, edited, inline
from roemetry_tools.tune.request import value_of

TEXT = """\
# what this is for
roemetry: 1
product:   "eel"      # odd blanks and quotes stay
source: {path: images, turn_deg: 90}   # one line

stages:
  # first of all
  extractor:
    use: dominant-peak   # the paper's
    options:
      threshold: 15      # grey levels
      start: lowest
  # between two stages
  coder: window-tracking   # short form
  weigher:
    use: density
    options: {density_g_per_cm3: 1.1}
sinks:
- csv     # a list at the key's own indent
- report
"""
BASE = parse(TEXT, "recipe.yaml").data


def changed(**paths: Any) -> Any:
    """Give the base with values set at paths whose steps are joined by two underscores."""
    data = copy.deepcopy(BASE)
    for path, value in paths.items():
        *steps, last = path.split("__")
        node = data
        for step in steps:
            node = node[step]
        if value is ...:
            del node[last]
        else:
            node[last] = value
    return data


def lines_that_differ(text: str) -> tuple[list[str], list[str]]:
    """Give the lines of the old text that are gone, and those of the new one that are new."""
    old, new = TEXT.splitlines(), text.splitlines()
    return [line for line in old if line not in new], [line for line in new if line not in old]


def test_nothing_wanted_changes_not_a_byte() -> None:
    assert edited(TEXT, "recipe.yaml", copy.deepcopy(BASE)) == TEXT


ODD = "      # odd blanks and quotes stay"
INDENT = "# a list at the key's own indent"
EXTRACTOR = "stages__extractor__options__"
WEIGHER = "    options: {density_g_per_cm3: 1.1}"
THRESHOLD = "threshold: 15      # grey levels"
CASES = {
    "a number": (
        {EXTRACTOR + "threshold": 22.5}, f"      {THRESHOLD}", f"      {THRESHOLD.replace('15', '22.5')}"
    ),
    "a value on one line": (
        {"source__turn_deg": 0},
        "source: {path: images, turn_deg: 90}   # one line",
        "source: {path: images, turn_deg: 0}   # one line",
    ),
    "a quoted word": ({"product": "a: b"}, f'product:   "eel"{ODD}', f'product:   "a: b"{ODD}'),
    "a new option behind the others": (
        {EXTRACTOR + "region": [0, 480, 0, 640]}, "", "      region: [0, 480, 0, 640]"
    ),
    "a new option within braces": (
        {"stages__weigher__options__density_std_g_per_cm3": 0.02},
        WEIGHER,
        "    options: {density_g_per_cm3: 1.1, density_std_g_per_cm3: 0.02}",
    ),
    "an option of a stage in its short form": (
        {"stages__coder": {"use": "window-tracking", "options": {"margin_min": 0.3}}},
        "  coder: window-tracking   # short form",
        "  coder: {use: window-tracking, options: {margin_min: 0.3}}   # short form",
    ),
    "an option taken away, nothing said of it": ({EXTRACTOR + "start": ...}, "      start: lowest", ""),
    "an option taken away with what was said of it": (
        {EXTRACTOR + "threshold": ...}, f"      {THRESHOLD}", f"      # {THRESHOLD}"
    ),
    "all options taken away": (
        {"stages__extractor": {"use": "steger"}},
        f"    use: dominant-peak   # the paper's\n    options:\n      {THRESHOLD}\n      start: lowest",
        f"    use: steger   # the paper's\n    # options:\n    #   {THRESHOLD}\n    #   start: lowest",
    ),
    "the only option within braces": ({"stages__weigher__options": {}}, WEIGHER, "    options: {}"),
    "a stage taken away": ({"stages__weigher": ...}, f"  weigher:\n    use: density\n{WEIGHER}", ""),
    "a list with comments in it": (
        {"sinks": ["csv"]},
        f"sinks:\n- csv     {INDENT}\n- report",
        f"{INDENT}\nsinks: [csv]",
    ),
    "a new key at the end": ({"draws": 200}, "", "draws: 200"),
}  # fmt: skip
"""What is wanted, the lines that go, and those that come."""


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_only_the_lines_that_are_wanted_change(case: tuple[dict[str, Any], str, str]) -> None:
    paths, gone, new = case
    wanted = changed(**paths)
    text = edited(TEXT, "recipe.yaml", wanted)
    assert parse(text, "recipe.yaml").data == wanted
    assert lines_that_differ(text) == (gone.splitlines(), new.splitlines())


def test_a_new_stage_stands_in_the_order_of_the_chain() -> None:
    stages = {**BASE["stages"]}
    after = {
        "extractor": stages.pop("extractor"),
        "coder": stages.pop("coder"),
        "smoother": "local-polynomial",
    }
    text = edited(TEXT, "recipe.yaml", {**BASE, "stages": after | stages})
    lines = text.splitlines()
    assert lines[lines.index("  smoother: local-polynomial") - 1] == "  coder: window-tracking   # short form"


def test_line_ends_of_another_system_stay() -> None:
    text = TEXT.replace("\n", "\r\n")
    wanted = changed(stages__extractor__options__threshold=22)
    assert edited(text, "r", wanted) == text.replace("threshold: 15 ", "threshold: 22 ")


@pytest.mark.parametrize(
    ("text", "wanted", "new"),
    [("a: 1", {"a": 1, "b": 2}, "a: 1\nb: 2\n"), ("a: 1\n", {"a": True}, "a: true\n")],
)
def test_a_text_without_a_last_line_end_can_grow_and_truth_is_not_one(text, wanted, new) -> None:
    assert edited(text, "r", wanted) == new


def test_differences_are_told_with_both_values() -> None:
    wanted = changed(stages__extractor__options__threshold=20, draws=5, sinks=...)
    assert differences(BASE, wanted) == [
        ("stages.extractor.options.threshold", "15", "20"),
        ("draws", "", "5"),
        ("sinks", "[csv, report]", ""),
    ]


WORDS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=12)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
) | WORDS
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.from_regex(r"[a-z_]{1,6}", fullmatch=True), inner, max_size=3)
    ),
    max_leaves=6,
)


@example("NULL")
@example(["~", "no", "1e3", "a: b"])
@settings(deadline=None, max_examples=60)
@given(VALUES)
def test_a_value_on_one_line_is_read_as_what_it_was(value: Any) -> None:
    assert parse(f"a: {inline(value)}\n", "r").data == {"a": value}
    if not isinstance(value, list | dict):
        assert value_of(inline(value)) == value, "a field reads what a recipe has"


@settings(deadline=None, max_examples=60)
@given(
    st.dictionaries(st.sampled_from(["extractor", "coder", "weigher", "volume"]), VALUES, max_size=4), VALUES
)
def test_any_wanted_values_come_out_and_full_lines_of_comment_stay(stages: Any, draws: Any) -> None:
    wanted = {**BASE, "stages": {"extractor": "x", **stages}, "draws": draws}
    text = edited(TEXT, "recipe.yaml", wanted)
    assert parse(text, "recipe.yaml").data == wanted
    for comment in ("# what this is for", "# odd blanks and quotes stay", "# one line", "# first of all"):
        assert comment in text
