"""``roemetry serve``: starts a line's processes, watches them, and stops them in the order of the data."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from roemetry.errors import ConfigurationError, OutputError
from roemetry.io.files import exclusive, make_folder
from roemetry_line.line_file import Line
from roemetry_line.log import log
from roemetry_line.outbox import Outbox
from roemetry_line.page.users import Role, set_password
from roemetry_line.preflight import preflight
from roemetry_line.process import runs_now, set_by

UNIT = """\
[Unit]
Description=roemetry line {name}
After=network-online.target
Wants=network-online.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={python} -m roemetry serve {path} --start-anyway
WorkingDirectory={home}
Environment=NUMBA_CACHE_DIR={folder}/kernels
TimeoutStartSec=600
WatchdogSec=20
Restart=always
RestartSec=2
CPUWeight=1000
KillMode=mixed
TimeoutStopSec=60
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths={folder}
PrivateTmp=yes
NoNewPrivileges=yes

[Install]
WantedBy=multi-user.target
"""


def notify_systemd(what: str) -> None:
    """Send a word such as ``READY=1``; nothing where systemd has not started this process."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.sendto(what.encode(), "\0" + address[1:] if address[0] == "@" else address)


_TICK_S = 0.2  # between two looks at the processes
_RESTART_S = 0.5
"""How long a process that died is left before it is started again, s."""
_STUCK_S = 10.0
"""A station that has not said anything for so long is stuck: systemd then starts the line again."""
_STOP_S = 20.0
"""How long a process may take to stop, s; then it is killed."""
_CHECK_S = 120.0
"""Longer than a station waits for the frame of a check, and measures it."""


def serve(
    line: Annotated[Path, typer.Argument(help="A line file.")],
    start_anyway: Annotated[
        bool,
        typer.Option(
            "--start-anyway", help="Start even if a camera or a receiver is missing, and keep trying."
        ),
    ] = False,
    unit: Annotated[
        bool, typer.Option("--unit", help="Only print a systemd unit that runs this line.")
    ] = False,
    user: Annotated[
        str | None,
        typer.Option("--user", help="Only set this user's password for the page; you are asked for it."),
    ] = None,
    role: Annotated[
        Role,
        typer.Option("--role", help="What that user may do."),
    ] = "viewer",
    check_block: Annotated[
        str | None,
        typer.Option(
            "--check-block",
            help="Only let this station of the running line measure its known block, which lies before the "
            "camera now, and say what it found.",
        ),
    ] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Measure live camera images and send the results on, until stopped; log one line of JSON per event.

    Exit code: 0 stopped when asked; 1 the block is out or was not found (--check-block); 2 the line file is
    wrong, or a camera or receiver is not there.
    """
    loaded = Line.load(line)
    make_folder(loaded.folder)
    if unit:
        typer.echo(
            UNIT.format(
                name=loaded.name,
                path=loaded.path,
                home=loaded.path.parent,
                python=sys.executable,
                folder=loaded.folder,
            ),
            nl=False,
        )
        return
    if user is not None:
        password = typer.prompt("password", hide_input=True, confirmation_prompt=True)
        typer.echo(str(set_password(loaded.folder, user, role, password)))
        return
    if check_block is not None:
        verdict, said = _check_block(loaded, check_block)
        typer.echo(said)
        if verdict in ("out", "failed"):
            raise typer.Exit(1)
        return
    with exclusive(loaded.folder):
        if not start_anyway:
            faults = [one for one in preflight(loaded) if one.verdict == "wrong"]
            if faults:
                raise ConfigurationError(
                    [
                        f"{one.found} ({one.what})" + (f": {one.remedy}" if one.remedy else "")
                        for one in faults
                    ],
                    hint="fix it, or use --start-anyway: the line starts and keeps trying what is missing",
                )
        Supervisor(loaded).run()


def _check_block(line: Line, station: str) -> tuple[str, str]:
    """Ask a line that runs for a check of a station's known block, and wait; give verdict and words."""
    names = [one.name for one in line.stations]
    if station not in names:
        hint = f"it has {', '.join(names)}"
        raise ConfigurationError(f"{line.path}: there is no station {station}", hint=hint)
    if not runs_now(line.folder):
        raise ConfigurationError(f"{line.path}: the line does not run", hint=f"roemetry serve {line.path}")
    outbox = Outbox(line.folder)
    number = outbox.ask_check(station, "command line")
    begin = time.monotonic()
    while time.monotonic() - begin < _CHECK_S:
        time.sleep(_TICK_S)
        found = outbox.last_check(station)
        if found is not None and found["n"] >= number and found["ended"] is not None:
            return found["verdict"], found["text"]
        if not runs_now(line.folder):
            raise OutputError(f"{line.path}: the line has stopped", hint="start it, and ask again")
    raise OutputError(
        f"{line.path}: station {station} has not checked its block in {_CHECK_S:g} s",
        hint=f"roemetry doctor {line.path}",
    )


class Supervisor:
    """Keeps a line's processes running."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._outbox = Outbox(line.folder)
        self._stop = set_by([signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
        stations = [[f"station {one.name}", "station", one.name] for one in line.stations]
        others = [["outlets", "deliver"], *([["page", "page.server"]] if line.page is not None else [])]
        self._commands = {name: (module, rest) for name, module, *rest in [*stations, *others]}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._died: dict[str, float] = {}

    def run(self) -> None:
        """Run until SIGTERM or ^C; then stop the stations, then the outlets, then the page."""
        log("info", "starting", f"line {self._line.name}", pid=os.getpid())
        for name in self._commands:
            self._start(name)
        ready_sent = False
        while not self._stop.wait(_TICK_S):
            self._watch()
            well = self._all_work()
            if well and not ready_sent:
                ready_sent = True
                log("info", "ready", "every station measures")
                notify_systemd("READY=1")
            if well:
                notify_systemd("WATCHDOG=1")
        notify_systemd("STOPPING=1")
        log("info", "stopping", "frames that wait are measured, rows that wait are delivered")
        for group in ("station", "outlets", "page"):
            self._end([name for name in self._running if name.startswith(group)])
        self._outbox.close()
        log("info", "stopped", f"line {self._line.name}")

    def _start(self, name: str) -> None:
        module, rest = self._commands[name]
        command = [sys.executable, "-m", f"roemetry_line.{module}", str(self._line.path), *rest]
        self._running[name] = subprocess.Popen(command, stdin=subprocess.PIPE)

    def _watch(self) -> None:
        for name, process in self._running.items():
            code = process.poll()
            if code is None:
                if name in self._died and time.monotonic() - self._died[name] > 5.0:
                    del self._died[name]
                    self._tell(name, None)
                continue
            if name not in self._died:
                how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
                self._tell(name, f"the process of {name} died ({how}) and is started again")
            self._died[name] = time.monotonic()
            self._stop.wait(_RESTART_S)
            if not self._stop.is_set():
                self._start(name)

    def _tell(self, name: str, died: str | None) -> None:
        try:
            if died is None:
                self._outbox.end_alarm(name, "process-died")
            else:
                self._outbox.raise_alarm(name, "process-died", died)
        except OutputError as error:
            log("error", "outbox", str(error))
        log(
            "info" if died is None else "error", "process-died", died or f"{name} works again", component=name
        )

    def _all_work(self) -> bool:
        """Say whether each station works: its main thread, and the one that takes frames or tries to."""
        try:
            health = self._outbox.health()
        except OutputError:
            return False
        for station in self._line.stations:
            told = health.get(f"station {station.name}")
            process = self._running[f"station {station.name}"]
            if told is None or told["pid"] != process.pid or told["state"] != "running":
                return False
            if time.time() - min(told["at"], told["figures"]["last_try_s"]) > _STUCK_S:
                return False
        return True

    def _end(self, names: list[str]) -> None:
        for name in names:
            if self._running[name].poll() is None:
                self._running[name].terminate()
        for name in names:
            process = self._running.pop(name)
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                log("error", "killed", f"{name} did not stop within {_STOP_S:g} s", component=name)
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()
