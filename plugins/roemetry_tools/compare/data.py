"""What variants are compared on: acquisitions, with their truth where a data set has it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.config.dataset import DESCRIPTION, ITEMS, STRIPES, Dataset, Item
from roemetry.config.recipe import Recipe
from roemetry.errors import DataError
from roemetry.io.files import sha256_of
from roemetry.records import Acquisition, AcquisitionReference, ProductTruth, Sensor, Truth


@dataclass(frozen=True, slots=True)
class Unit:
    """One acquisition and its item in the data set; None where it has none."""

    reference: AcquisitionReference
    item: Item | None


class Data:
    """What to compare on: the images of the recipe's source, or all items of a data set's folder.

    True classes of `labels`, by product (``acquisition#1``), count instead of those of the data set.
    `dataset` is None where there is none; `without_truth` then says why nothing is known.

    Raises
    ------
    ConfigurationError
        `folder` is no data set, or its ``dataset.yaml`` is wrong.
    DataError
        There is nothing to compare on, or a label is of what is not there.
    """

    def __init__(
        self, recipe: Recipe, folder: Path | None = None, *, labels: Mapping[str, str] | None = None
    ) -> None:
        self.without_truth = ""
        self.labels: Mapping[str, str] = {} if labels is None else labels
        self.part = ""
        """Which part of the acquisitions these are; "" for all."""
        self._in_part: Set[str] | None = None
        self._references: Sequence[AcquisitionReference] | None = None
        if folder is not None:
            self.dataset: Dataset | None = Dataset(folder)
            self.count = sum(1 for _ in self.dataset.items())
            if self.count == 0:
                raise DataError(
                    f"{folder / ITEMS}: there is no item", hint="make the data set, or name another"
                )
            self._check_labels({item.id for item in self.dataset.items()})
            return
        self._references = recipe.references()
        self.count = len(self._references)
        self._check_labels({reference.id for reference in self._references})
        found = _folder_of(recipe.source_path)
        self.dataset = None if found is None else Dataset(found)
        if self.dataset is None:
            self.without_truth = (
                f"nothing is known of the images: there is no {DESCRIPTION} beside or above them; "
                "name a data set with --data"
            )

    def _check_labels(self, ids: Set[str]) -> None:
        strange = sorted(
            name
            for name in self.labels
            if name not in ids and not (_NUMBERED.search(name) and _NUMBERED.sub("", name) in ids)
        )
        if strange:
            more = f" and {len(strange) - 1} more" if len(strange) > 1 else ""
            raise DataError(
                f"labels of what is not there: {strange[0]}{more}",
                hint=f"ids are those of the acquisitions, such as {min(ids)}, or of a product, {min(ids)}#1",
            )

    def parted(self, held_out: float, seed: int) -> tuple[Data, Data]:
        """Part the acquisitions in two at random, the second of them a share of `held_out` of all.

        What is measured several times is in one part only. DataError where one part has nothing.
        """
        groups: dict[str, list[str]] = {}
        for unit, group in zip(self.units(), _connected(list(self.units())), strict=True):
            groups.setdefault(group, []).append(unit.reference.id)
        shuffled = np.random.default_rng([seed, len(groups)]).permutation(sorted(groups)).tolist()
        late: set[str] = set()
        while shuffled and len(late) < round(held_out * self.count):
            late |= set(groups[shuffled.pop()])
        if not late or not shuffled:
            raise DataError(
                f"{self.count} acquisitions of {len(groups)} specimens are too few to hold some of them out",
                hint="make the data set larger",
            )
        every = {unit.reference.id for unit in self.units()}
        return self._of(every - late, "to choose by"), self._of(late, "held out")

    def _of(self, names: Set[str], part: str) -> Data:
        one = copy(self)
        one._in_part, one.part, one.count = names, part, len(names)
        return one

    def units(self) -> Iterator[Unit]:
        """Give the acquisitions in order, one at a time."""
        wanted = self._in_part
        return (unit for unit in self._every_unit() if wanted is None or unit.reference.id in wanted)

    def _every_unit(self) -> Iterator[Unit]:
        if self._references is None:
            assert self.dataset is not None
            for item in self.dataset.items():
                files = {role: self.dataset.folder / name for role, name in item.files.items()}
                yield Unit(AcquisitionReference(item.id, files), item)
            return
        items: dict[Path, Item] = {}
        if self.dataset is not None:
            for item in self.dataset.items():
                if "laser" in item.files:
                    items[(self.dataset.folder / item.files["laser"]).resolve()] = item
        for reference in self._references:
            laser = reference.files.get("laser")
            yield Unit(reference, None if laser is None else items.get(laser.resolve()))

    def described(self) -> dict[str, Any]:
        """Everything a reader must know of the data."""
        told: dict[str, Any] = {"acquisitions": self.count, "part": self.part}
        told["without_truth"] = self.without_truth
        told["labels"] = sum("#" in name for name in self.labels)
        if self.dataset is None:
            return told | dict.fromkeys(_UNKNOWN)
        description, folder = self.dataset.description, self.dataset.folder
        return told | {
            "name": description.name,
            "folder": str(folder),
            "licence": description.licence,
            "made_with": description.made_with,
            "made_from": dict(description.made_from),
            "notes": description.notes,
            "turn_deg": description.turn_deg,
            "seeds": self._seeds(),
            "sha256": {name: sha256_of(folder / name) for name in (DESCRIPTION, ITEMS)},
        }

    def _seeds(self) -> list[int] | None:
        """Give the lowest and the highest seed of the products, where the truth knows them."""
        assert self.dataset is not None
        seeds = [
            int(seed)
            for item in self.dataset.items()
            for product in item.products
            if math.isfinite(seed := product.figures.get("seed", math.nan))
        ]
        return [min(seeds), max(seeds)] if seeds else None


_UNKNOWN = ("name", "folder", "licence", "made_with", "made_from", "notes", "turn_deg", "seeds", "sha256")
"""What is told of a data set, and null without one."""


def specimen_of(true: ProductTruth | None, product: str) -> str:
    """Name the thing itself: by what the truth says of it, else every product is one of its own."""
    figures = {} if true is None else true.figures
    for name in ("specimen", "seed"):
        if name in figures and math.isfinite(figures[name]):
            return f"{name} {figures[name]:.0f} {'' if true is None else true.defect}".strip()
    return product


def _connected(units: Sequence[Unit]) -> list[str]:
    """Name for each acquisition the group of all that share a specimen with it, or with one that does."""
    above: dict[str, str] = {}

    def top(name: str) -> str:
        while (up := above.setdefault(name, name)) != name:
            above[name] = name = above[up]  # halves the way for the next one
        return name

    for unit in units:
        own = f"of {unit.reference.id}"
        top(own)
        for number, true in enumerate(() if unit.item is None else unit.item.products, start=1):
            above[top(own)] = top(specimen_of(true, f"{unit.reference.id}#{number}"))
    return [top(f"of {unit.reference.id}") for unit in units]


def changed_file(item: Item, files: Mapping[Any, Path], folder: Path) -> str | None:
    """Name the first file that is not the one the item was written for: an image, or the stripes' truth."""
    every: dict[str, Path] = dict(files)
    if item.stripes is not None:
        every[STRIPES] = folder / item.stripes
    for role, path in every.items():
        if role in item.sha256 and sha256_of(path) != item.sha256[role]:
            return str(path)
    return None


_NUMBERED = re.compile(r"#[1-9]\d{0,2}$")


def labelled(truth: Truth | None, acquisition: str, labels: Mapping[str, str]) -> Truth | None:
    """Put other classes into the truth; where nothing is known, they are all that is."""
    if truth is None:
        begin = f"{acquisition}#"
        numbers = [int(name.removeprefix(begin)) for name in labels if name.startswith(begin)]
        known = tuple(
            ProductTruth(label=labels.get(f"{begin}{number}", ""))
            for number in range(1, max(numbers, default=0) + 1)
        )
        return Truth(known) if known else None
    if not labels:
        return truth
    products = tuple(
        replace(one, label=labels.get(f"{acquisition}#{number}", ""))
        for number, one in enumerate(truth.products, start=1)
    )
    return replace(truth, products=products)


def as_taken(acquisition: Acquisition, item: Item | None, sensor: Sensor | None = None) -> Acquisition:
    """Add what the data set knows and the image files do not say: bits in use, noise, time, place."""
    if item is None:
        return acquisition
    frames = tuple(
        replace(
            frame,
            bit_depth=frame.bit_depth if item.bit_depth is None else item.bit_depth,
            sensor=frame.sensor if sensor is None else sensor,
            time_s=frame.time_s if math.isnan(item.time_s) else item.time_s,
            encoder_count=frame.encoder_count if math.isnan(item.encoder_count) else item.encoder_count,
        )
        for frame in acquisition.frames
    )
    return replace(acquisition, frames=frames)


def _folder_of(path: Path) -> Path | None:
    """Give the nearest folder at or above the images that holds a data set."""
    near = (path, path.parent, path.parent.parent)
    return next((folder for folder in near if (folder / DESCRIPTION).is_file()), None)
