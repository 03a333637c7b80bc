"""Data sets: images by role with what is known of them, in an open folder format.

A data set is a folder with

* ``dataset.yaml``: name, licence, the command that made it, folders of calibration data;
* ``calibration.sha256``: hashes of the calibration data, as ``sha256sum`` writes them;
* ``truth/calibration.yaml``: what is true of the rig and of the calibration targets, where that is known;
* ``items.jsonl``: a line an item: its id, its files by role with their hashes, the truth of its products, and
  the file that holds the truth of its stripes;
* the files themselves, wherever the lines say (by habit ``images/``, ``truth/``).

An item counts only once its line stands in ``items.jsonl``, and its line is written last. So a set that was
interrupted holds no half item, and can be gone on with.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from roemetry.config.recipe_file import SensorFile
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, DataError, OutputError, RecordError
from roemetry.io.files import (
    LineFile,
    first_fault,
    json_values,
    make_folder,
    sha256_of,
    write_bytes,
    write_whole,
)
from roemetry.io.yaml_source import dump, read
from roemetry.records import ProductTruth, Role, Sensor, StripeTruth, Truth
from roemetry.records.arrays import Number

DESCRIPTION = "dataset.yaml"
ITEMS = "items.jsonl"
HASHES = "calibration.sha256"
STRIPES = "stripes"
CALIBRATION_TRUTH = "truth/calibration.yaml"

_LASTING = ("roemetry_dataset", "name", "licence", "made_from", "turn_deg")


class Description(BaseModel):
    """What ``dataset.yaml`` says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    roemetry_dataset: Literal[1] = Field(description="version of the format")
    name: str = Field(min_length=1, description="what to call it")
    licence: str = Field(description="under which licence it may be used (SPDX identifier)")
    made_with: str = Field(default="", description="the command that makes it again")
    made_from: dict[str, str | int] = Field(
        default_factory=dict, description="what decides its bytes: seed, hash of the scene, versions"
    )
    turn_deg: Literal[0, 90, 180, 270] = Field(default=0, description="turn that recipes apply, degrees")
    sensor: SensorFile | None = Field(default=None, description="the camera's noise, as in the recipe")
    calibration: dict[str, str] = Field(
        default_factory=dict, description="calibration data by kind: folder or file, relative to this file"
    )
    notes: str = Field(default="", description="what a user must know, in words")


@dataclass(frozen=True, slots=True)
class Item:
    """One acquisition of a data set."""

    id: str
    files: Mapping[Role, str]
    """By role, the image's path relative to the set."""
    sha256: Mapping[str, str] = field(default_factory=dict)
    products: tuple[ProductTruth, ...] = ()
    stripes: str | None = None
    """File (.npz) with the truth of its stripes, relative to the set; None where there is none."""
    time_s: Number = math.nan
    encoder_count: Number = math.nan
    """time_s, encoder_count: when and where on the belt it was taken; NaN where not known."""
    bit_depth: int | None = None
    """Bits in use of its images; None is all that the files' pixels have."""


_ITEM = TypeAdapter(Item)


class Dataset:
    """A data set to read, item by item, so that a long set needs no memory.

    Where there is no ``dataset.yaml`` in its folder, or it is wrong, ConfigurationError names every fault.
    """

    def __init__(self, folder: Path) -> None:
        document = read(folder / DESCRIPTION)
        description, faults = checked(Description, document.data, document.place)
        if description is None:
            raise ConfigurationError(faults)
        self.folder = folder
        self.description: Description = description

    @property
    def sensor(self) -> Sensor | None:
        """The camera's noise; None where the set does not say it."""
        said = self.description.sensor
        return None if said is None else Sensor(**said.model_dump())

    def calibration_truth(self) -> dict[str, Any]:
        """Read what is true of the rig and of the calibration targets; empty where the set does not know."""
        path = self.folder / CALIBRATION_TRUTH
        return dict(read(path).data) if path.exists() else {}

    def items(self) -> Iterator[Item]:
        """Give the items in order."""
        path = self.folder / ITEMS
        try:
            with path.open(encoding="utf-8") as file:
                for number, line in enumerate(file, start=1):
                    yield _item(line, f"{path}:{number}")
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error

    def truth(self, item: Item) -> Truth:
        """Read what is known of an item."""
        if item.stripes is None:
            return Truth(item.products)
        path = self.folder / item.stripes
        try:
            with path.open("rb") as file, np.load(file) as kept:
                optional = (one for one in ("product", "y_px") if one in kept)
                fields = ("x_px", "on_product", "xyz_mm", *optional)
                stripes = StripeTruth(**{name: kept[name] for name in fields})
        except (OSError, KeyError, ValueError, RecordError) as error:
            raise DataError(f"{path}: not the truth of stripes: {error}") from error
        return Truth(item.products, stripes)

    def faults(self) -> Iterator[str]:
        """Check every file against its hash; give a sentence for each fault, one at a time."""
        seen: set[int] = set()
        try:
            for item in self.items():
                # of a long set the hashes of the ids take less memory than the ids
                mark = hash(item.id)
                if mark in seen:
                    yield f"{self.folder / ITEMS}: the id `{item.id}` stands twice"
                seen.add(mark)
                yield from self._item_faults(item)
        except DataError as error:
            yield str(error)
        for kind, name in self.description.calibration.items():
            if not (self.folder / name).exists():
                yield f"{self.folder / name}: is missing (calibration, {kind})"
        for name, stored in _calibration_hashes(self.folder):
            yield from self._file_faults(name, stored, "calibration")

    def _item_faults(self, item: Item) -> Iterator[str]:
        for role, name in item.files.items():
            yield from self._file_faults(name, item.sha256.get(role), f"{item.id}, {role}")
        if item.stripes is None:
            return
        faults = list(self._file_faults(item.stripes, item.sha256.get(STRIPES), f"{item.id}, truth"))
        yield from faults
        if not faults:
            try:
                self.truth(item)
            except DataError as error:
                yield str(error)

    def _file_faults(self, name: str, stored: str | None, what: str) -> Iterator[str]:
        path = self.folder / name
        if not path.is_file():
            yield f"{path}: is missing ({what})"
        elif stored is not None and sha256_of(path) != stored:
            yield f"{path}: has changed since the set was made ({what})"


class DatasetWriter:
    """A data set to write, or to go on with; `done` holds the ids of the items that are there.

    A set that is gone on with must be of the same name, licence, turn and origin; the command that makes it
    and its calibration data may change as it grows.
    """

    def __init__(self, folder: Path, description: Description) -> None:
        make_folder(folder)
        self.folder = folder
        path = folder / DESCRIPTION
        old = Dataset(folder).description if path.exists() else description
        if any(getattr(old, name) != getattr(description, name) for name in _LASTING):
            raise OutputError(
                f"{folder}: holds another data set", hint="choose another folder, or empty this one"
            )
        if old != description or not path.exists():
            write_whole(path, dump(description.model_dump(mode="json")))
        self._items = LineFile(folder / ITEMS)
        self.done = frozenset(item.id for item in Dataset(folder).items())

    def add(self, item: Item) -> None:
        """Write an item's line; its files must be there, and hashes that it has not are taken from them."""
        hashes: dict[str, str] = {
            role: item.sha256.get(role) or sha256_of(self.folder / name) for role, name in item.files.items()
        }
        if item.stripes is not None:
            hashes[STRIPES] = sha256_of(self.folder / item.stripes)
        row = asdict(item) | {"sha256": hashes}
        self._items.append(json.dumps(json_values(row), ensure_ascii=False))

    def close(self) -> None:
        """Close the list of items."""
        self._items.__exit__(None, None, None)

    def __enter__(self) -> DatasetWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def save_stripes(path: Path, stripes: StripeTruth) -> None:
    """Write the truth of stripes, compressed, in float32 (a ten-thousandth of a pixel at 1,000 px)."""
    kept: dict[str, Any] = {
        "x_px": stripes.x_px.astype(np.float32),
        "on_product": stripes.on_product,
        "product": stripes.product,
        "xyz_mm": stripes.xyz_mm.astype(np.float32),
    }
    if stripes.y_px.size:
        kept["y_px"] = stripes.y_px.astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **kept)
    save_bytes(path, buffer.getvalue())


def save_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, and its folder if need be; raise OutputError where that fails."""
    make_folder(path.parent)
    write_bytes(path, data)


def save_calibration_truth(folder: Path, truth: Mapping[str, Any]) -> str:
    """Write what is true of rig and targets; give the file's name in the set."""
    make_folder((folder / CALIBRATION_TRUTH).parent)
    write_whole(folder / CALIBRATION_TRUTH, dump(dict(truth)))
    return CALIBRATION_TRUTH


def save_calibration_hashes(folder: Path, names: Sequence[str]) -> None:
    """Write the hashes of a set's calibration files, given relative to it."""
    if names:
        lines = [f"{sha256_of(folder / name)}  {name}\n" for name in names]
        write_whole(folder / HASHES, "".join(lines))


def _calibration_hashes(folder: Path) -> Iterator[tuple[str, str]]:
    path = folder / HASHES
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            stored, _, name = line.partition("  ")
            yield name, stored


def _item(line: str, place: str) -> Item:
    try:
        found: Item = _ITEM.validate_json(line)
    except ValueError as error:
        raise DataError(f"{place}: not an item of a data set ({first_fault(error)})") from error
    return found
