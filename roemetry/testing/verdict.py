"""How a check fails, and where two results differ, said in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from roemetry.errors import FAULTS, RoemetryError
from roemetry.records.arrays import Floats


class CheckFailedError(AssertionError):
    """A stage does not keep the contract; the message says what was found and what was expected."""


def require(condition: bool | object, found: str) -> None:
    """Go on if the condition holds, else say what was found."""
    if not condition:
        raise CheckFailedError(found)


def within(off: Floats | float, limit: float, what: str, unit: str = "px") -> None:
    """Require that no error exceeds what the stage declares; NaN is none that does not."""
    worst = float(np.max(off, initial=0.0))
    require(worst <= limit, f"{what} up to {worst:.3g} {unit}, {limit:g} {unit} are declared")


@contextmanager
def refused(what: str, *kinds: type[RoemetryError]) -> Iterator[list[RoemetryError]]:
    """Require that the block raises one of these errors (none named: any); give a list that holds it."""
    wanted = kinds or (RoemetryError,)
    caught: list[RoemetryError] = []
    try:
        yield caught
    except wanted as error:
        caught.append(error)
        return
    except FAULTS as error:
        raise CheckFailedError(
            f"{what}: {type(error).__name__} ({error}), expected {_names(wanted)}"
        ) from error
    raise CheckFailedError(f"{what} was taken, expected {_names(wanted)}")


def _names(kinds: tuple[type[RoemetryError], ...]) -> str:
    return " or ".join(f"a {kind.__name__}" for kind in kinds)


def difference(one: Any, other: Any, at: str = "") -> str | None:
    """Say where two records first differ; None where they are alike to the last bit (NaN equals NaN).

    They may be records, arrays, numbers, words, or mappings and sequences of these; functions are not
    compared. `at` says where they stand, for the sentence.
    """
    if isinstance(one, BaseModel):
        one, other = one.model_dump(), other.model_dump() if isinstance(other, BaseModel) else other
    if type(one) is not type(other):
        return f"{at or 'the result'} is a {type(one).__name__}, then a {type(other).__name__}"
    if isinstance(one, np.ndarray):
        return _arrays(one, other, at)
    if callable(one):
        return None
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
