"""A reason in words, with a code that programs can sort by."""

from __future__ import annotations

from typing import NamedTuple


class Reason(NamedTuple):
    """Why a number is missing, doubtful or as it is.

    Attributes
    ----------
    code
        Short kebab-case name, the same for the same cause, for filters and statistics.
    text
        A sentence for people.
    """

    code: str
    text: str
