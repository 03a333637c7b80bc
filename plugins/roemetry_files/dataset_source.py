"""Acquisitions from a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from roemetry.config.dataset import DESCRIPTION, ITEMS, Dataset
from roemetry.errors import DataError
from roemetry.io.remote import Url
from roemetry.records import Acquisition, AcquisitionReference, Sensor
from roemetry.stages import Source, StageOptions
from roemetry_files.image_files import in_turn, keep_for_next, pixels_before, read_image


class DatasetSource(Source[StageOptions]):
    """Reads the items of a data set: a folder with a ``dataset.yaml``, or that file itself.

    The acquisition's id is the item's. Truth, where the set has it, is not read. The set's bit depth holds;
    time, encoder count and what the set says of the camera's noise come along.
    """

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
        return in_turn(found.values())

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Read the images of one item; raise DataError for one that is missing or damaged."""
        folder = _folder_of(next(iter(reference.files.values())).parent)
        changed_ns = 0 if isinstance(folder, Url) else (folder / ITEMS).stat().st_mtime_ns
        taken, sensor = _taken(folder, changed_ns)[reference.id], _sensor(folder, changed_ns)
        before, frames = pixels_before(reference), []
        for role, path in reference.files.items():
            frame = read_image(path, role)
            bits = frame.bit_depth if taken.bit_depth is None else taken.bit_depth
            frames.append(
                replace(
                    frame,
                    bit_depth=bits,
                    time_s=taken.time_s,
                    encoder_count=taken.encoder_count,
                    sensor=sensor,
                )
            )
        keep_for_next(reference, frames)
        return Acquisition(reference.id, tuple(frames), before=before)


class _Taken(NamedTuple):
    """What an item's line says of how its images were taken."""

    bit_depth: int | None
    time_s: float
    encoder_count: float


def _open(path: Path) -> Dataset:
    folder = path.parent if path.name == DESCRIPTION else path
    if not (folder / DESCRIPTION).is_file():
        raise DataError(
            f"{folder}: there is no {DESCRIPTION} here", hint="source.path is a data set's folder"
        )
    return Dataset(folder)


@lru_cache(maxsize=16)
def _folder_of(path: Path) -> Path:
    for folder in (path, *path.parents):
        if (folder / ITEMS).is_file() and (folder / DESCRIPTION).is_file():
            return folder
    raise DataError(f"{path}: does not lie in a data set")


@lru_cache(maxsize=2)
def _taken(folder: Path, changed_ns: int) -> Mapping[str, _Taken]:
    """Read how the items of a set were taken; `changed_ns` makes a set that has grown be read again."""
    items = Dataset(folder).items()
    return {item.id: _Taken(item.bit_depth, item.time_s, item.encoder_count) for item in items}


@lru_cache(maxsize=2)
def _sensor(folder: Path, changed_ns: int) -> Sensor | None:
    """Read what a set says of its camera's noise, once."""
    return Dataset(folder).sensor
