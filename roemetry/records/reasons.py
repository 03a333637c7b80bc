"""A reason in words, with a code that programs can sort by."""

from __future__ import annotations

from typing import NamedTuple, Self

from roemetry.errors import RecordError


class _Words(NamedTuple):
    code: str
    """Short kebab-case name, the same for the same cause, for filters and statistics."""
    text: str


class Reason(_Words):
    """Why a number is missing, doubtful or as it is; RecordError where it says nothing."""

    __slots__ = ()

    def __new__(cls, code: str, text: str) -> Self:
        """Refuse a reason without words."""
        if not (code.strip() and text.strip()):
            raise RecordError(f"Reason: the code is {code!r}, the text {text!r}; expected words in both")
        return super().__new__(cls, code, text)
