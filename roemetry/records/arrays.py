"""Shape, type and read-only checks that the records share."""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeGuard

import numpy as np
from numpy.typing import NDArray
from pydantic import GetPydanticSchema

from roemetry.errors import RecordError


def _any_schema(source: Any, handler: Any) -> Any:
    """Let pydantic take any value: the record that holds the array makes it one, and checks it."""
    from pydantic_core import core_schema

    return core_schema.any_schema()


def _number_schema(source: Any, handler: Any) -> Any:
    """Let pydantic read null as NaN, and numbers without a call of Python for each."""
    from pydantic_core import core_schema

    nothing = core_schema.no_info_after_validator_function(lambda _: math.nan, core_schema.none_schema())
    return core_schema.union_schema([handler(source), nothing], mode="left_to_right")


_Array = GetPydanticSchema(_any_schema)

Floats = Annotated[NDArray[np.float64], _Array]
Integers = Annotated[NDArray[np.int64], _Array]
Labels = Annotated[NDArray[np.int16], _Array]
Flags = Annotated[NDArray[np.bool_], _Array]
Number = Annotated[float, GetPydanticSchema(_number_schema)]
"""A number of a record's file: NaN, which JSON does not know, stands there as null."""


class Checker:
    """Collects every fault of one record, so that all are reported at once."""

    def __init__(self, record: object) -> None:
        self._record = record
        self._faults: list[str] = []

    def array(self, field: str, dtype: type[np.generic], shape: tuple[int | None, ...]) -> NDArray[Any]:
        """Replace a field by a read-only view of the wanted type; ``None`` in `shape` means any length."""
        given: object = getattr(self._record, field)
        # every stage of every frame comes by here, nearly always with just what is wanted
        value = given if _is_already(given, dtype) else self._converted(field, given, dtype)
        if value.shape != shape and (value.ndim != len(shape) or any(map(_differ, value.shape, shape))):
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            self._faults.append(f"{field} has shape {value.shape}, expected {wanted}")
        if given is value and not value.flags.writeable:
            return value
        view = value.view()
        view.setflags(write=False)
        object.__setattr__(self._record, field, view)
        return view

    def _converted(self, field: str, given: object, dtype: type[np.generic]) -> NDArray[Any]:
        try:
            value: NDArray[Any] = np.asarray(given, dtype=dtype)
        except (OverflowError, TypeError, ValueError) as error:
            kind = type(self._record).__name__
            raise RecordError(f"{kind}: {field} cannot be made {np.dtype(dtype)}: {error}") from error
        if np.issubdtype(dtype, np.integer) and _has_fractions(given, value):
            self._faults.append(f"{field} holds what is no whole number, expected {np.dtype(dtype)}")
        return value

    def require(self, condition: bool, fault: str) -> None:
        """Note a fault unless the condition holds."""
        if not condition:
            self._faults.append(fault)

    def finish(self) -> None:
        """Raise one error that names every fault, if there is one."""
        if self._faults:
            raise RecordError(f"{type(self._record).__name__}: " + "; ".join(self._faults))


def _is_already(given: object, dtype: type[np.generic]) -> TypeGuard[NDArray[Any]]:
    return type(given) is np.ndarray and given.dtype.type is dtype and given.dtype.isnative


def _differ(have: int, want: int | None) -> bool:
    return want is not None and have != want


def _has_fractions(given: object, whole: NDArray[Any]) -> bool:
    found: NDArray[Any] = np.asarray(given)
    return found.dtype.kind == "f" and not np.array_equal(found, whole)
