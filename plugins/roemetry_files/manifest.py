"""Manifests: a list of files by URL, each with its hash, instead of a folder that is listed.

A manifest is a file of JSON lines or, by its ending, of Parquet. A row is a file: ``id`` of the acquisition,
``url`` (or a path relative to the manifest), ``sha256``, ``size`` in bytes, and ``role``, ``laser`` where it
is left out. Listing a bucket of a million images takes a thousand requests, a manifest one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field, TypeAdapter

from roemetry.cli.options import set_option
from roemetry.errors import DataError, OutputError
from roemetry.io.files import first_fault, write_bytes, write_whole
from roemetry.io.remote import Url, path_of
from roemetry.records import Acquisition, AcquisitionReference, Role
from roemetry.stages import Capabilities, Source, StageOptions
from roemetry_files.image_files import in_turn, read_acquisition

_TOGETHER = 32
"""Files that are hashed at once: reading from a bucket is waiting."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One file of a manifest."""

    id: Annotated[str, Field(min_length=1)]
    url: Annotated[str, Field(min_length=1)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    size: Annotated[int, Field(ge=0)]
    role: Role = "laser"


class Manifest(Source[StageOptions]):
    """Reads the images that a manifest names; one whose bytes have another hash than it says is refused."""

    capabilities = Capabilities(fixture="roemetry_files.conformance:two_images")

    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the acquisitions in the manifest's order.

        DataError for a row that is damaged or stands twice, and where a bucket may not be read at all.
        """
        files: dict[str, dict[Role, Path]] = {}
        hashes: dict[str, dict[Role, str]] = {}
        stores: set[tuple[str, ...]] = set()
        for number, entry in enumerate(_entries(path), start=1):
            place = path_of(entry.url, path.parent)
            mine = files.setdefault(entry.id, {})
            if entry.role in mine:
                raise DataError(
                    f"{path}:{number}: `{entry.id}` has a {entry.role} image already: {mine[entry.role]}",
                    hint="each row needs an id and role of its own; write the manifest again",
                )
            mine[entry.role] = place
            hashes.setdefault(entry.id, {})[entry.role] = entry.sha256
            if isinstance(place, Url) and (store := place.parts[:2]) not in stores:
                stores.add(store)
                place.is_file()  # whether it may be read, before a million others are tried
        if not files:
            raise DataError(f"{path}: the manifest names no file")
        return in_turn(AcquisitionReference(name, of, sha256=hashes[name]) for name, of in files.items())

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Decode the files of one acquisition; DataError for one that is missing or damaged."""
        return read_acquisition(reference)


def _entries(path: Path) -> Iterator[Entry]:
    """Read the rows of a manifest, one at a time; DataError where one is damaged."""
    reader = TypeAdapter(Entry)
    try:
        if path.suffix == ".parquet":
            import pyarrow.parquet as pq

            with path.open("rb") as file:
                for batch in pq.ParquetFile(file).iter_batches():
                    yield from map(reader.validate_python, batch.to_pylist())
            return
        with path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                try:
                    yield reader.validate_json(line)
                except ValueError as error:
                    raise DataError(
                        f"{path}:{number}: not a row of a manifest ({first_fault(error)})"
                    ) from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # pyarrow's faults are such, too
        raise DataError(f"{path}: not a manifest ({first_fault(error)})") from error


def manifest(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, or a folder with a recipe.yaml in it.")],
    out: Annotated[Path, typer.Argument(help="Manifest to write: .jsonl or .parquet.")],
    sets: Annotated[
        list[str] | None, set_option("Change the recipe, e.g. source.path=s3://plant/images")
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Write a manifest of the images a recipe reads: of each its id, URL, hash and size.

    Every image is read once. The recipe then reads them by `source: {use: manifest, path: FILE}`.
    """
    from roemetry.config.recipe import Recipe

    if out.suffix not in (".jsonl", ".parquet"):
        raise OutputError(f"{out}: a manifest is a .jsonl or .parquet file")
    found = [
        (reference.id, role, path)
        for reference in Recipe.load(recipe, sets=sets or ()).references()
        for role, path in reference.files.items()
    ]
    with ThreadPoolExecutor(_TOGETHER) as threads:
        rows = list(threads.map(_row, found))
    _write(out, rows)
    typer.echo(f"{out}: {len(rows)} files, {sum(row['size'] for row in rows) / 1e6:.1f} MB")


def _row(found: tuple[str, Role, Path]) -> dict[str, Any]:
    name, role, path = found
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    return asdict(Entry(name, str(path.absolute()), hashlib.sha256(data).hexdigest(), len(data), role))


def _write(out: Path, rows: Sequence[dict[str, Any]]) -> None:
    if out.suffix == ".jsonl":
        write_whole(out, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows))
        return
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(list(rows)), sink)
    write_bytes(out, sink.getvalue().to_pybytes())
