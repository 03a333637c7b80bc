"""Data sets: images by role with what is known of them, in an open folder format.

A data set is a folder with

* ``dataset.yaml``: name, licence, the command that made it, folders of calibration data;
* ``items.jsonl``: a line an item: its id, its files by role with their hashes, the truth of its products, and
  the file that holds the truth of its stripes;
* the files themselves, wherever the lines say (by habit ``images/``, ``truth/``).

An item counts only once its line stands in ``items.jsonl``, and its line is written last. So a set that was
interrupted holds no half item, and can be gone on with.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from roemetry.errors import ConfigurationError, DataError, OutputError
from roemetry.files import LineFile, make_folder, sha256_of, write_whole
from roemetry.records import ProductTruth, Role, StripeTruth, Truth
from roemetry.validation import checked
from roemetry.yaml_source import dump, read

DESCRIPTION = "dataset.yaml"
ITEMS = "items.jsonl"


class Description(BaseModel):
    """What ``dataset.yaml`` says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    roemetry_dataset: Literal[1] = Field(description="version of the format")
    name: str = Field(min_length=1, description="what to call it")
    licence: str = Field(description="under which licence it may be used (SPDX identifier)")
    made_with: str = Field(default="", description="the command that makes it again")
    turn_deg: Literal[0, 90, 180, 270] = Field(default=0, description="turn that recipes apply, degrees")
    calibration: dict[str, str] = Field(
        default_factory=dict, description="calibration data by kind: folder or file, relative to this file"
    )
    notes: str = Field(default="", description="what a user must know, in words")


@dataclass(frozen=True, slots=True)
class Item:
    """One acquisition of a data set.

    Attributes
    ----------
    id
        Unique in the set.
    files
        By role, the image's path relative to the set.
    sha256
        By role, the image's hash.
    products
        Truth of its products.
    stripes
        File (.npz) with the truth of its stripes, relative to the set; None where there is none.
    """

    id: str
    files: Mapping[Role, str]
    sha256: Mapping[str, str] = field(default_factory=dict)
    products: tuple[ProductTruth, ...] = ()
    stripes: str | None = None


class Dataset:
    """A data set to read. Items are read one at a time, so that a long set needs no memory.

    Parameters
    ----------
    folder
        The set's folder.

    Raises
    ------
    ConfigurationError
        There is no ``dataset.yaml``, or it is wrong; every fault with its place.
    """

    def __init__(self, folder: Path) -> None:
        document = read(folder / DESCRIPTION)
        description, faults = checked(Description, document.data, document.place)
        if description is None:
            raise ConfigurationError(faults)
        self.folder = folder
        self.description: Description = description

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
            with np.load(path) as kept:
                stripes = StripeTruth(kept["x_px"], kept["on_product"], kept["xyz_mm"])
        except (OSError, KeyError, ValueError) as error:
            raise DataError(f"{path}: not the truth of stripes: {error}") from error
        return Truth(item.products, stripes)

    def faults(self) -> list[str]:
        """Check every file against its hash; give a sentence for each fault."""
        found: list[str] = []
        seen: set[str] = set()
        for item in self.items():
            if item.id in seen:
                found.append(f"{self.folder / ITEMS}: the id `{item.id}` stands twice")
            seen.add(item.id)
            for role, name in item.files.items():
                path = self.folder / name
                if not path.is_file():
                    found.append(f"{path}: is missing ({item.id}, {role})")
                elif role in item.sha256 and sha256_of(path) != item.sha256[role]:
                    found.append(f"{path}: has changed since the set was made ({item.id}, {role})")
            if item.stripes is not None:
                try:
                    self.truth(item)
                except DataError as error:
                    found.append(str(error))
        for kind, name in self.description.calibration.items():
            if not (self.folder / name).exists():
                found.append(f"{self.folder / name}: is missing (calibration, {kind})")
        return found


class DatasetWriter:
    """A data set to write, or to go on with.

    Parameters
    ----------
    folder
        Where; made if need be.
    description
        What ``dataset.yaml`` will say. A set that is gone on with must have the same.
    """

    def __init__(self, folder: Path, description: Description) -> None:
        make_folder(folder)
        self.folder = folder
        path = folder / DESCRIPTION
        if path.exists():
            if Dataset(folder).description != description:
                raise OutputError(
                    f"{folder}: holds another data set", hint="choose another folder, or empty this one"
                )
        else:
            write_whole(path, dump(description.model_dump(mode="json")))
        self._items = LineFile(folder / ITEMS)
        self.done = frozenset(item.id for item in Dataset(folder).items())

    def add(self, item: Item) -> None:
        """Write an item's line; its files must be there, and their hashes are taken from them."""
        hashes = {role: sha256_of(self.folder / name) for role, name in item.files.items()}
        row = asdict(item) | {"sha256": hashes}
        self._items.append(json.dumps(_null(row), ensure_ascii=False))

    def close(self) -> None:
        """Close the list of items."""
        self._items.__exit__(None, None, None)


def save_stripes(path: Path, stripes: StripeTruth) -> None:
    """Write the truth of stripes, compressed, in float32 (a ten-thousandth of a pixel at 1,000 px)."""
    np.savez_compressed(
        path,
        x_px=stripes.x_px.astype(np.float32),
        on_product=stripes.on_product,
        xyz_mm=stripes.xyz_mm.astype(np.float32),
    )


def _item(line: str, place: str) -> Item:
    try:
        row: dict[str, Any] = json.loads(line)
        products = tuple(_product(product) for product in row["products"])
        return Item(row["id"], row["files"], row["sha256"], products, row["stripes"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{place}: not an item of a data set ({type(error).__name__}: {error})") from error


def _product(row: dict[str, Any]) -> ProductTruth:
    numbers: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
    numbers["figures"] = {name: math.nan if v is None else v for name, v in row["figures"].items()}
    return ProductTruth(**numbers)


def _null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _null(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_null(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
