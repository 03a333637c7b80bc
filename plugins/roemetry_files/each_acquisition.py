"""A file for each acquisition of a run, from what happened to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from roemetry.errors import RoemetryError
from roemetry.io.files import make_folder, write_bytes
from roemetry.records import Trace
from roemetry.stages import Run
from roemetry_files.names import file_name


def write_each(
    run: Run, folder: str, ending: str, content: Callable[[Trace], bytes | None]
) -> Sequence[Path]:
    """Write ``folder/<acquisition>ending`` for each acquisition of which `content` gives anything.

    What cannot be read again is passed over: its row in the record says why.
    """
    place = run.folder / folder
    make_folder(place)
    written = []
    for name in dict.fromkeys(row.acquisition for row in run.measurements()):
        try:
            made = content(run.replay(name))
        except RoemetryError:
            continue
        if made is None:
            continue
        path = place / f"{file_name(name)}{ending}"
        write_bytes(path, made)
        written.append(path)
    return written
