"""What was scored, kept until a comparison is finished: one that was stopped goes on where it was."""

from __future__ import annotations

import base64
import hashlib
import json
import pickle
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType

from roemetry.errors import OutputError
from roemetry.io.files import LineFile
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import Scored
from roemetry_tools.compare.variants import Variant, recipe_of

KEPT = ".scored"

Found = tuple[bool, list[Scored]]
"""Whether its times hold what is done once, and what each variant made of an acquisition."""


class KeptScores:
    """A file in the comparison's folder: a line for each acquisition, in order; the first says of what.

    OutputError where it is to be gone on with and is of another comparison.
    """

    def __init__(
        self, folder: Path, variants: Sequence[Variant], data: Data, terms: Terms, *, resume: bool
    ) -> None:
        self._path = folder / KEPT
        if not resume:
            self._path.unlink(missing_ok=True)
        of = _identity(variants, data, terms)
        with LineFile(self._path):
            pass  # opening it takes a half line away
        with self._path.open(encoding="ascii") as file:
            first = file.readline().rstrip("\n")
        if first and first != of:
            raise OutputError(
                f"{folder}: the comparison in this folder is of other variants, data or terms",
                hint="give the command that was stopped, or choose another folder with --out",
            )
        self._file = LineFile(self._path)
        if not first:
            self._file.append(of)

    def found(self) -> Iterator[Found]:
        """Give what was kept before, in order."""
        with self._path.open(encoding="ascii") as file:
            file.readline()
            for line in file:
                yield pickle.loads(zlib.decompress(base64.b64decode(line)))

    def add(self, found: Found) -> None:
        """Keep what was scored of the next acquisition."""
        self._file.append(base64.b64encode(zlib.compress(pickle.dumps(found, protocol=5), 1)).decode())

    def __enter__(self) -> KeptScores:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.__exit__(kind, error, trace)


def _identity(variants: Sequence[Variant], data: Data, terms: Terms) -> str:
    """Hash what decides the scores, and which variants are measured."""
    whole = hashlib.sha256(json.dumps(data.described().get("sha256")).encode())
    for told in (*map(recipe_of, variants), sorted(data.labels.items()), terms.stop_early):
        whole.update(f"{told}\n".encode())
    for unit in data.units():
        whole.update(f"{unit.reference.id}\n".encode())
    return whole.hexdigest()
