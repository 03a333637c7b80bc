"""What was tried, kept until a search is finished: one that was stopped goes on where it was.

Optuna's own storages keep trials, but not where its sampler's random numbers are. So the search is begun
again with what is kept here in place of measuring: with the same figures it proposes the same recipes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from roemetry.errors import OutputError
from roemetry.io.files import LineFile, first_fault, make_folder
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.kept import KEPT, KeptScores, identity_of
from roemetry_tools.compare.variants import Space, Variant, recipe_of

TRIED = ".tried"

TrialFigures = tuple[float, int, float, str]
"""Of a trial: error, %; products missing; time, ms; and its fault."""


class KeptTrials:
    """A file in the search's folder: a line for each recipe that was tried; the first says of what search.

    Parameters
    ----------
    folder
        Of the search.
    told
        What decides the proposals besides the space: seed, quantity.
    resume
        Whether to go on with a search that was stopped.

    Raises
    ------
    OutputError
        The folder holds a search that was stopped and is not to be gone on with, or another one.
    """

    def __init__(
        self, folder: Path, space: Space, data: Data, told: Sequence[object], *, resume: bool
    ) -> None:
        make_folder(folder)
        self._folder, self._data, self._resume = folder, data, resume
        path = folder / TRIED
        if path.exists() and not resume:
            raise OutputError(
                f"{folder}: there is a search in this folder that was stopped",
                hint="go on with it by --resume, or choose another folder with --out",
            )
        axes = [(axis.key, axis.values) for axis in space.axes]
        decides = f"{identity_of([space.as_it_is], data, Terms())} {axes} {[*told]}"
        of = hashlib.sha256(decides.encode()).hexdigest()
        self._file = LineFile(path)
        try:
            with path.open(encoding="utf-8") as file:
                first = file.readline().rstrip("\n")
                self._known = dict(map(_read, file))
        except (ValueError, TypeError, RecursionError) as error:
            self._file.__exit__(None, None, None)
            raise OutputError(
                f"{path}: damaged ({first_fault(error)})", hint="begin the search again in another folder"
            ) from error
        if first and first != of:
            self._file.__exit__(None, None, None)
            raise OutputError(
                f"{folder}: the search in this folder is of another recipe, space, seed or data",
                hint="give the command that was stopped, or choose another folder with --out",
            )
        if not first:
            self._file.append(of)

    def figures_of(self, variant: Variant) -> TrialFigures | None:
        """Give what a recipe came to before; None where it was not tried."""
        return self._known.get(str(recipe_of(variant)))

    def scores(self, variants: Sequence[Variant]) -> KeptScores:
        """Give the file that keeps what acquisitions score while these recipes are tried."""
        return KeptScores(self._folder, variants, self._data, Terms(), resume=self._resume)

    def add(self, tried: Sequence[tuple[Variant, TrialFigures]]) -> None:
        """Keep what recipes came to, instead of what acquisitions scored."""
        (self._folder / KEPT).unlink(missing_ok=True)
        self._file.append("\n".join(json.dumps([str(recipe_of(one)), of]) for one, of in tried))

    def __enter__(self) -> KeptTrials:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.__exit__(kind, error, trace)


def _read(line: str) -> tuple[str, TrialFigures]:
    name, (error_pct, missing, time_ms, fault) = json.loads(line)
    return str(name), (float(error_pct), int(missing), float(time_ms), str(fault))
