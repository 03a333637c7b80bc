"""Acquisitions from a data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roemetry.dataset import DESCRIPTION, ITEMS, Dataset, Item
from roemetry.errors import DataError
from roemetry.records import Acquisition, AcquisitionReference, Frame
from roemetry.stages import Source, StageOptions
from roemetry_files.image_files import read_image


class DatasetSource(Source[StageOptions]):
    """Reads the items of a data set: a folder with a ``dataset.yaml``, or that file itself.

    The acquisition's id is the item's. Truth, where the set has it, is not read. The set's bit depth holds;
    time and encoder count come along.
    """

    Options = StageOptions

    def __init__(self, options: StageOptions | None = None) -> None:
        super().__init__(options)
        self._items: dict[Path, dict[str, Item]] = {}

    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the items; raise DataError where there is none, or where an id stands twice."""
        data = _open(path)
        found: dict[str, AcquisitionReference] = {}
        for item in data.items():
            if item.id in found:
                raise DataError(
                    f"{data.folder / ITEMS}: the id `{item.id}` stands twice", hint="see `roemetry lint`"
                )
            files = {role: data.folder / name for role, name in item.files.items()}
            found[item.id] = AcquisitionReference(item.id, files)
        if not found:
            raise DataError(f"{data.folder / ITEMS}: the data set has no item")
        return list(found.values())
