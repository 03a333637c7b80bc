"""Where two results differ, said in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel


def difference(one: Any, other: Any, at: str = "") -> str | None:
    """Say where two records first differ; None where they are alike to the last bit (NaN equals NaN).

    Parameters
    ----------
    one, other
        Records, arrays, numbers, words, or mappings and sequences of these. Functions are not compared.
    at
        Where they stand, for the sentence.
    """
    if isinstance(one, BaseModel):
        one, other = one.model_dump(), other.model_dump() if isinstance(other, BaseModel) else other
    if type(one) is not type(other):
        return f"{at or 'the result'} is a {type(one).__name__}, then a {type(other).__name__}"
    if isinstance(one, np.ndarray):
        return _arrays(one, other, at)
    if is_dataclass(one):
        parts = ((getattr(one, f.name), getattr(other, f.name), f.name) for f in fields(one))
        return _first(parts, at)
    if isinstance(one, Mapping):
        if list(one) != list(other):
            return f"{at or 'the result'} has the keys {list(one)}, then {list(other)}"
        return _first(((one[key], other[key], str(key)) for key in one), at)
    if isinstance(one, Sequence) and not isinstance(one, str | bytes):
        if len(one) != len(other):
            return f"{at or 'the result'} has {len(one)} items, then {len(other)}"
        return _first(((a, b, str(i)) for i, (a, b) in enumerate(zip(one, other, strict=True))), at)
    if callable(one):
        return None
    alike = one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))
    return None if alike else f"{at or 'the result'} is {_short(one)}, then {_short(other)}"


def _first(parts: Any, at: str) -> str | None:
    for one, other, name in parts:
        found = difference(one, other, f"{at}.{name}" if at else name)
        if found is not None:
            return found
    return None


def _arrays(one: np.ndarray, other: np.ndarray, at: str) -> str | None:
    if one.shape != other.shape or one.dtype != other.dtype:
        return f"{at or 'the array'} is {one.dtype} {one.shape}, then {other.dtype} {other.shape}"
    unlike = one != other
    if one.dtype.kind == "f":
        unlike &= ~(np.isnan(one) & np.isnan(other))
    if not unlike.any():
        return None
    first = tuple(int(i) for i in np.argwhere(unlike)[0])
    return (
        f"{at or 'the array'} differs in {int(unlike.sum())} of {one.size} elements, "
        f"first at {first}: {one[first]}, then {other[first]}"
    )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:59]}…"
