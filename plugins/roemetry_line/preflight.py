"""Try everything that a line needs, once: each camera gives a frame, each receiver lets itself be reached."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from roemetry.errors import FAULTS, RoemetryError
from roemetry.io.files import make_folder
from roemetry.run.control_chart import calibration_doubts
from roemetry.stages.hookspecs import Finding
from roemetry_line import history, line_file
from roemetry_line.line_file import Line, NamedOutlet, Station
from roemetry_line.outbox import FILE, Outbox
from roemetry_line.process import runs_now

_FRAME_S = 3.0
"""How long a frame is waited for: a line without products gives none, which is no fault."""
_SILENT_S = 5.0  # several beats of a process that is alive
_DRIVER_S = 60.0  # GigE cameras take up to 15 s to be given up


def examine(path: Path) -> Iterator[Finding]:
    """Do what ``roemetry doctor LINE`` does: try what the line names, or, where it runs, say how it is."""
    line = Line.load(path)
    yield Finding("line file", "ok", f"{line.name}: recipes and calibrations load, every stage is installed")
    for station in line.stations:
        recipe = history.recipe_at_work(line, station)
        for doubt in calibration_doubts(recipe):
            yield Finding(f"station {station.name}, calibration", "wrong", doubt.text)
    if (line.folder / FILE).exists() and runs_now(line.folder):
        yield from _running(line)
    else:
        make_folder(line.folder)
        yield from preflight(line)


def preflight(line: Line) -> Iterator[Finding]:
    """Try each camera, each outlet and the page's port, and give what was found, as soon as it is known.

    Each camera is tried in a process of its own, as it will run: drivers of two makers may clash.
    """
    for station in line.stations:
        command = [sys.executable, "-m", "roemetry_line.preflight", str(line.path), station.name]
        try:
            tried = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, timeout=_DRIVER_S)
        except subprocess.TimeoutExpired:
            said = f"the driver has not answered for {_DRIVER_S:g} s"
            yield Finding(_called(station), "wrong", f"{line.place(*station.at, 'feed')}: {said}")
            continue
        if tried.returncode:
            said = f"the driver ended the process with code {tried.returncode}; see what it printed above"
            yield Finding(_called(station), "wrong", f"{line.place(*station.at, 'feed')}: {said}")
        else:
            yield Finding(**json.loads(tried.stdout.splitlines()[-1]))
    for named in line.outlets:
        yield _outlet(line, named)
    if line.page is not None:
        yield _page(line, line.page)


def _called(station: Station) -> str:
    return f"station {station.name}, feed {station.feed.registered.entry.name}"


def _camera(line: Line, station: Station) -> Finding:
    what, at = _called(station), (*station.at, "feed")
    begin = time.monotonic()
    try:
        with station.feed.make().open() as frames:
            for live in frames:
                if live is not None and live.frame is None:
                    return Finding(what, "wrong", f"{line.place(*at)}: a frame is not whole: {live.fault}")
                if live is not None and live.frame is not None:
                    rows, columns = live.frame.size
                    return Finding(what, "ok", f"a frame of {columns} × {rows} pixels")
                if time.monotonic() - begin > _FRAME_S:
                    break
    except FAULTS as error:
        return _wrong(line, what, error, *at)
    return Finding(what, "ok", "connected; no frame has come")


def _outlet(line: Line, named: NamedOutlet) -> Finding:
    what = f"outlet {named.name} ({named.outlet.registered.entry.name})"
    try:
        with named.outlet.make().open():
            return Finding(what, "ok", "reached")
    except FAULTS as error:
        return _wrong(line, what, error, *named.at)


def _page(line: Line, page: line_file.PageSection) -> Finding:
    from roemetry_line.page.server import listening

    try:
        with listening(page):
            return Finding("page", "ok", f"{page.host}:{page.port} is free")
    except RoemetryError as error:
        return _wrong(line, "page", error, "page")


def _wrong(line: Line, what: str, error: BaseException, *at: str | int) -> Finding:
    """Name the fault at its place: that of the option that the stage says is at fault, where it says one."""
    if not isinstance(error, RoemetryError):
        return Finding(what, "wrong", f"{line.place(*at)}: {type(error).__name__}: {error}")
    below = ("options", *error.at) if error.at else ()
    return Finding(what, "wrong", f"{line.place(*at, *below)}: {error.message}", error.hint or "")


def _running(line: Line) -> Iterator[Finding]:
    """Give what a line that runs says of itself: its cameras and ports are taken, by itself."""
    outbox = Outbox(line.folder)
    yield Finding("line", "ok", "it runs: cameras and receivers are its own, and this is what it says")
    now = time.time()
    own = {f"station {one.name}" for one in line.stations} | {"outlets"} | ({"page"} if line.page else set())
    for component, told in sorted(outbox.health().items()):
        if component not in own:
            continue  # of a line file before this one
        silent_s = now - told["at"]
        well = silent_s < _SILENT_S
        yield Finding(
            component, "ok" if well else "wrong", told["state"] if well else f"silent for {silent_s:.0f} s"
        )
    for one in outbox.alarms():
        if one["ended"] is None:
            yield Finding(one["station"], "wrong", one["text"])
    outbox.close()


def main() -> int:
    """Try one station of a line file; the command line names both. Prints the finding as JSON."""
    line = Line.load(Path(sys.argv[1]), with_recipes=False)
    print(json.dumps(asdict(_camera(line, line.station(sys.argv[2])))))  # noqa: T201 - the parent reads it
    return 0


if __name__ == "__main__":
    sys.exit(main())
