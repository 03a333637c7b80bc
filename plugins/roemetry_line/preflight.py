"""Try everything that a line needs, once: each camera gives a frame, each receiver lets itself be reached."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from roemetry.errors import FAULTS, RoemetryError
from roemetry_line.line_file import Line, NamedOutlet, Station

_FRAME_S = 3.0
"""How long a frame is waited for: a line without products gives none, which is no fault."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was tried."""

    what: str
    well: bool
    said: str
    place: str = ""


def preflight(line: Line) -> Iterator[Finding]:
    """Try each camera and each outlet, and say what was found, as soon as it is known.

    Each camera is tried in a process of its own, as it will run: drivers of two makers may clash.
    """
    for station in line.stations:
        command = [sys.executable, "-m", "roemetry_line.preflight", str(line.path), station.name]
        tried = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        if tried.returncode:
            said = f"the driver ended the process with code {tried.returncode}; see what it printed above"
            yield Finding(_called(station), False, said, station.place)
        else:
            yield Finding(**json.loads(tried.stdout.splitlines()[-1]))
    for named in line.outlets:
        yield _outlet(named)


def _called(station: Station) -> str:
    return f"station {station.name}, feed {station.feed.registered.entry.name}"


def _camera(station: Station) -> Finding:
    what = _called(station)
    begin = time.monotonic()
    try:
        with station.feed.make().open() as frames:
            for live in frames:
                if live is not None and live.frame is None:
                    return Finding(what, False, f"a frame that is not whole: {live.fault}", station.place)
                if live is not None and live.frame is not None:
                    rows, columns = live.frame.size
                    return Finding(what, True, f"a frame of {columns} × {rows} pixels", station.place)
                if time.monotonic() - begin > _FRAME_S:
                    break
    except FAULTS as error:
        return Finding(what, False, _said(error), station.place)
    return Finding(what, True, "connected; no frame has come", station.place)


def _outlet(named: NamedOutlet) -> Finding:
    what = f"outlet {named.name} ({named.outlet.registered.entry.name})"
    try:
        with named.outlet.make().open():
            return Finding(what, True, "reached", named.place)
    except FAULTS as error:
        return Finding(what, False, _said(error), named.place)


def _said(error: BaseException) -> str:
    return str(error) if isinstance(error, RoemetryError) else f"{type(error).__name__}: {error}"


def main() -> int:
    """Try one station of a line file; the command line names both. Prints the finding as JSON."""
    line = Line.load(Path(sys.argv[1]), with_recipes=False)
    print(json.dumps(asdict(_camera(line.station(sys.argv[2])))))  # noqa: T201 - what the parent reads
    return 0


if __name__ == "__main__":
    sys.exit(main())
