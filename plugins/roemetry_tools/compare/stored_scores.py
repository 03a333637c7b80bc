"""What was scored, kept until a comparison is finished: one that was stopped goes on where it was.

Stored is JSON, compressed line by line: a folder may come from somebody else, and reading it runs no code.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from roemetry.errors import OutputError
from roemetry.io.files import LineFile, first_fault
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import Scored
from roemetry_tools.compare.stripes import CentreScore
from roemetry_tools.compare.variants import Variant, recipe_of

KEPT = ".scored"
T = TypeVar("T")

Found = tuple[bool, list[Scored]]
"""Whether its times hold what is done once, and what each variant made of an acquisition."""


class StoredLines:
    """A file that keeps what was done, line by line, until all is done; the first line says of what.

    OutputError, with the `other` that it is of, where its first line is not `of`.
    """

    def __init__(self, path: Path, of: str, other: str) -> None:
        self.path = path
        with LineFile(path):
            pass  # opening it takes a half line away
        with path.open(encoding="utf-8", errors="replace") as file:
            first = file.readline().rstrip("\n")
        if first and first != of:
            raise OutputError(
                f"{path.parent}: the {other}",
                hint="give the command that was stopped, or choose another folder with --out",
            )
        self._file = LineFile(path)
        if not first:
            self._file.append(of)

    def read(self, as_what: Callable[[str], T], again: str) -> Iterator[T]:
        """Give what was kept before, in order; OutputError where a line is damaged says to begin `again`."""
        # a byte that is no UTF-8 is damage as any other, and told with its line
        with self.path.open(encoding="utf-8", errors="replace") as file:
            file.readline()
            for number, line in enumerate(file, start=2):
                try:
                    found = as_what(line)
                except (ValueError, TypeError, RecursionError, zlib.error) as error:
                    raise OutputError(
                        f"{self.path}:{number}: damaged, or of another roemetry ({first_fault(error)})",
                        hint=f"begin the {again} again in another folder",
                    ) from error
                yield found

    def append(self, line: str) -> None:
        """Keep one more."""
        self._file.append(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)


class StoredScores(StoredLines):
    """A line in the comparison's folder for each acquisition, in order.

    OutputError where it is to be gone on with and is of another comparison.
    """

    def __init__(
        self, folder: Path, variants: Sequence[Variant], data: Data, terms: Terms, *, resume: bool
    ) -> None:
        if not resume:
            (folder / KEPT).unlink(missing_ok=True)
        other = "comparison in this folder is of other variants, data or terms"
        super().__init__(folder / KEPT, identity_of(variants, data, terms), other)

    def found(self) -> Iterator[Found]:
        """Give what was kept before, in order."""
        return self.read(_unpacked, "comparison")

    def add(self, found: Found) -> None:
        """Keep what was scored of the next acquisition."""
        plain = json.dumps(found, default=_plain, separators=(",", ":"))
        self.append(base64.b64encode(zlib.compress(plain.encode(), 1)).decode())


def _unpacked(line: str) -> Found:
    found: Found = _reader().validate_python(json.loads(zlib.decompress(base64.b64decode(line))))
    return found


_NOT_SCORED = ("marks", "relief", "solution", "slice_stripe", "slice_area_mm2", "slice_spacing_mm")
"""What of a grade is drawn, what an estimator goes on from, and a volume's slices: no figure needs them."""


def _plain(value: Any) -> Any:
    """Make a record, an array or a mapping what JSON knows; NaN and infinity stay what they are."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    kind: type[Any] = type(value)
    if is_dataclass(kind):
        plain = {name: getattr(value, name) for name in _names(kind)}
        return plain | {"counts": value.held} if isinstance(value, CentreScore) else plain
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be kept as JSON")


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind) if f.name not in _NOT_SCORED)


@cache
def _reader() -> Any:
    """Make pydantic's reader of a line when the first one is read: it takes a while."""
    from pydantic import TypeAdapter

    return TypeAdapter(Found)


def identity_of(variants: Sequence[Variant], data: Data, terms: Terms) -> str:
    """Hash what decides the scores, and which variants are measured."""
    whole = hashlib.sha256(json.dumps(data.described().get("sha256")).encode())
    for told in (*map(recipe_of, variants), sorted(data.labels.items()), terms.stop_early):
        whole.update(f"{told}\n".encode())
    for unit in data.units():
        whole.update(f"{unit.reference.id}\n".encode())
    return whole.hexdigest()
