"""The files of a comparison: items as they are scored, then JSON, CSV and the page.

What was scored is kept until a comparison is finished: one that was stopped goes on where it was. It is JSON,
compressed line by line: a folder may come from somebody else, and reading it runs no code.
"""

from __future__ import annotations

import base64
import hashlib
import json
import platform
import shlex
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from datetime import datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from roemetry.errors import OutputError
from roemetry.io.files import LineFile, first_fault, json_values, make_folder, write_whole
from roemetry_tools.compare.agreement import RESAMPLES, Interval, Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared, Standing, choices_of
from roemetry_tools.compare.score import Errors, Figures, Pair, Scored, estimates_of
from roemetry_tools.compare.stripes import CentreScore
from roemetry_tools.compare.tables import GROUPS, centre_figures, coding_shares, first_lines_of, to_csv
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


ITEMS, SUMMARY, TABLE, PAGE = "items.jsonl", "comparison.json", "comparison.csv", "comparison.html"


class ItemsFile:
    """``items.jsonl``: a line for each variant and product, written as it is scored.

    The comparison's folder is created if needed; one that holds a comparison already is refused, but for one
    that was stopped, if it is to be gone on with: its lines are written anew from what was kept.
    """

    def __init__(self, folder: Path, *, resume: bool = False) -> None:
        make_folder(folder)
        path = folder / ITEMS
        if path.exists() and path.stat().st_size:
            stopped = (folder / KEPT).exists()
            if not (resume and stopped):
                raise OutputError(
                    f"{folder}: there is a comparison in this folder already",
                    hint="go on with it by --resume, or choose another folder with --out"
                    if stopped
                    else "choose another folder with --out",
                )
            path.unlink()
        self._file = LineFile(path)

    def __enter__(self) -> ItemsFile:
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)

    def add(self, variant: Variant, scored: Scored) -> None:
        """Write what a variant made of an acquisition."""
        lines = [
            json.dumps(json_values(_line(variant, scored, pair)), ensure_ascii=False, allow_nan=False)
            for pair in scored.pairs
        ]
        if lines:
            self._file.append("\n".join(lines))


def write_comparison(
    folder: Path, compared: Sequence[Compared], data: Data, *, terms: Terms, command: Sequence[str] = (),
    began: datetime,
) -> tuple[Path, ...]:  # fmt: skip
    """Write table, JSON and page, and give the files; `command` is without the program's name."""
    from roemetry_tools.compare.page import page

    base = compared[0].variant.recipe
    assert base is not None
    libraries = ("numpy", "numba", "opencv-contrib-python-headless")
    told: dict[str, Any] = json_values(
        {
            "roemetry_comparison": 1,
            "answer": first_lines_of(compared, terms, data.without_truth),
            "roemetry_version": version("roemetry"),
            "began": began.isoformat(timespec="seconds"),
            "command": shlex.join(["roemetry", *command]) if command else "",
            "recipe": str(base.path),
            "product": base.product,
            "sets": list(base.sets),
            "data": data.described(),
            "terms": {**asdict(terms), "resamples": RESAMPLES},
            "choices": [asdict(choice) for choice in choices_of(compared, terms)],
            "libraries": {name: version(name) for name in libraries},
            "python": platform.python_version(),
            "platform": platform.platform(),
            "variants": [_variant(one) for one in compared],
        }
    )
    write_whole(folder / SUMMARY, json.dumps(told, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    write_whole(folder / TABLE, to_csv(compared))
    write_whole(folder / PAGE, page(compared, told))
    return tuple(folder / name for name in (PAGE, TABLE, SUMMARY, ITEMS))


def _variant(one: Compared) -> dict[str, Any]:
    variant, recipe, figures = one.variant, one.variant.recipe, one.figures
    calibration = None if recipe is None else recipe.calibration
    stages = None if recipe is None else {kind: stage.described() for kind, stage in recipe.stages.items()}
    return {
        "variant": variant.number,
        "name": variant.name,
        "settings": dict(variant.settings),
        "status": one.status,
        "reason": one.failure,
        "stopped": _named(one.stopped),
        "recipe_sha256": None if recipe is None else recipe.sha256,
        "calibration_sha256": None if calibration is None else calibration.sha256,
        "stages": stages,
        "figures": None if figures is None else {**_figures(figures), **_standing(one.standing)},
    }


def _figures(figures: Figures) -> dict[str, Any]:
    classes, centres, on_product = figures.classes, figures.centres, figures.centres_on_product
    return {
        "acquisitions": figures.acquisitions,
        "refused": figures.refused,
        "refused_because": [asdict(cause) for cause in figures.causes],
        "said_of_the_others": [asdict(cause) for cause in figures.warnings],
        **{group: _errors(figures.errors[quantity], unit) for group, quantity, unit in GROUPS},
        "volume_true_from_visible_n": figures.true_from_visible,
        "classes": None if classes is None else {"n": classes.n, **asdict(classes)},
        "coding": None if figures.coding is None else coding_shares(figures.coding),
        "centres": None if centres is None else centre_figures("centre", centres),
        "centres_on_product": None if on_product is None else centre_figures("centre_on_product", on_product),
        "seconds": {step: quartiles._asdict() for step, quartiles in figures.seconds.items()},
        "absent": dict(figures.absent),
    }


def _standing(standing: Standing) -> dict[str, Any]:
    """Tell how a variant stands beside truth and recipe; intervals as [low, high]."""

    def by_group(found: Mapping[str, Any]) -> dict[str, Any]:
        return {group: _named(found[name]) for group, name, _ in GROUPS if name in found}

    return {
        "to_truth": by_group(standing.truth),
        "to_recipe": by_group(standing.recipe),
        "nearer_pct": by_group(standing.nearer),
        "recalls": _named(standing.recalls),
        "balanced_interval": standing.balanced_interval,
        "balanced_shift": _named(standing.balanced_shift),
        "reliability": _named(standing.reliability),
    }


def _named(found: Any) -> Any:
    """Give a record's fields by name, those of the records in it too; but an interval stays [low, high]."""
    if is_dataclass(found):
        return {one.name: _named(getattr(found, one.name)) for one in fields(found)}
    if isinstance(found, Interval) or not isinstance(found, tuple):
        return found
    if hasattr(found, "_asdict"):
        return {name: _named(value) for name, value in found._asdict().items()}
    return [_named(one) for one in found]


def _errors(errors: Errors | None, unit: str) -> dict[str, Any] | None:
    if errors is None:
        return None
    return {f"rmse_{unit}" if name == "rmse" else name: value for name, value in asdict(errors).items()}


def _line(variant: Variant, scored: Scored, pair: Pair) -> dict[str, Any]:
    row, true = pair.measured, pair.true
    return {
        "variant": variant.number,
        "name": variant.name,
        "item": scored.item,
        "product": pair.product,
        "status": "failed" if row is None else row.status,
        "measured": None
        if row is None
        else {
            **estimates_of(pair),
            "visible_std_mm3": None if row.volume is None else row.volume.visible_mm3.std,
            "mass_std_g": None if row.weight is None else row.weight.mass_g.std,
            "height_max_mm": row.height_max_mm.value,
            "height_max_std_mm": row.height_max_mm.std,
            "label": None if row.grade is None else row.grade.label,
            "probability": None if row.grade is None else row.grade.probability,
        },
        "true": None if true is None else asdict(true),
        "reasons": [reason._asdict() for reason in pair.reasons],
    }
