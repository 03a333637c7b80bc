"""What every source keeps."""

from __future__ import annotations

import pickle
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from roemetry.errors import DataError
from roemetry.records import AcquisitionReference
from roemetry.stages import Source
from roemetry.testing.comparing import difference
from roemetry.testing.fixtures import readable_path
from roemetry.testing.verdict import refused, require


def check_acquisitions_are_found_and_read(source: Source[Any]) -> None:
    """Two acquisitions are listed in order, each with an id of its own, and read under it."""
    with tempfile.TemporaryDirectory() as folder:
        references = source.references(readable_path(source, Path(folder)))
        require(len(references) == 2, f"{len(references)} acquisitions are listed, 2 are there")
        ids = [reference.id for reference in references]
        require(len(set(ids)) == 2, f"both have the id `{ids[0]}`")
        for reference in references:
            acquisition = source.read(reference)
            require(acquisition.id == reference.id, f"`{reference.id}` is read as `{acquisition.id}`")
            require(acquisition.frames, f"`{reference.id}` has no frame")


def check_reading_order_does_not_matter(source: Source[Any]) -> None:
    """Acquisitions can be read in any order, as worker processes do, and their references pickled."""
    with tempfile.TemporaryDirectory() as folder:
        references = source.references(readable_path(source, Path(folder)))
        first, second = (source.read(reference) for reference in references)
        again = [source.read(pickle.loads(pickle.dumps(reference))) for reference in references[::-1]]
        found = difference([second, first], again)
    require(found is None, f"read in another order, {found}")


def check_a_missing_path_is_named(source: Source[Any]) -> None:
    """A path where there is nothing is a `DataError` that names it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nowhere"
        with refused("a path that is not there", DataError) as caught:
            source.references(path)
    require("nowhere" in str(caught[0]), f"the error does not name the path: {caught[0]}")


def check_an_unreadable_file_is_named(source: Source[Any]) -> None:
    """A file that is missing, empty or damaged is a `DataError` that names it."""
    for content in (None, b"", b"not what it should be\n" * 9):
        with tempfile.TemporaryDirectory() as folder:
            references = source.references(readable_path(source, Path(folder)))
            broken = _broken(references[0], Path(folder), content)
            what = "a missing file" if content is None else f"a file of {len(content)} damaged bytes"
            with refused(what, DataError) as caught:
                source.read(broken)
        name = next(iter(broken.files.values())).name
        require(name in str(caught[0]), f"the error does not name {name}: {caught[0]}")


CHECKS = (
    check_acquisitions_are_found_and_read,
    check_reading_order_does_not_matter,
    check_a_missing_path_is_named,
    check_an_unreadable_file_is_named,
)


def _broken(reference: AcquisitionReference, folder: Path, content: bytes | None) -> AcquisitionReference:
    """Give the reference with its first file missing (None) or holding something else."""
    role, whole = next(iter(reference.files.items()))
    path = folder / f"broken{whole.suffix}"
    if content is not None:
        path.write_bytes(content)
    return replace(reference, files={**reference.files, role: path})
