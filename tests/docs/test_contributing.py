"""CONTRIBUTING names files that exist, and fits on a page; the glossary defines each term once."""

from __future__ import annotations

import re
from collections import Counter

from reading import ROOT


def test_contributing_names_files_that_exist() -> None:
    """Every path in backticks is there; a move that forgets the page breaks this."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    paths = re.findall(r"`((?:[\w.-]+/)+[\w.-]*)`", text)
    assert len(paths) > 15
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_glossary_defines_each_term_once() -> None:
    """Each first cell of a table is one or several terms; none stands twice, none without a meaning."""
    text = (ROOT / "docs/reference/glossary.md").read_text("utf-8")
    terms = text[text.index("## The image") :]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|", terms, flags=re.MULTILINE)
    counts = Counter(term.strip() for cell, _ in rows if cell != "term" for term in cell.split(","))
    assert len(counts) > 80
    assert not [term for term, times in counts.items() if times > 1]
    assert not [cell for cell, meaning in rows if not meaning.strip()]
