"""A reason in words, with a code that programs can sort by."""

from __future__ import annotations

from typing import NamedTuple


class Reason(NamedTuple):
    """Why a number is missing, doubtful or as it is."""

    code: str
    """Short kebab-case name, the same for the same cause, for filters and statistics."""
    text: str
