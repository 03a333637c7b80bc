"""A line on loopback whose parts die, hang, go away and come back, round by round, with real components.

Each round breaks one thing while frames come, notes after how many seconds the operator's page shows it, and
mends it. After the last round every row must be in the record, in the history, at the TCP receiver and at the
MQTT subscriber, once after taking duplicates out, and in order; and every spooled frame must have its row.
An OPC UA client must get every event that was sent while it was stopped, once it goes on.
A round that is done is written down: the same command goes on where it was broken off.

The line: pylon's emulated camera and, where it is installed, Aravis' fake camera over the network; the
folder is a small tmpfs where it may be mounted; a PostgreSQL and a mosquitto of its own where installed.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.command import keep, kept
from roemetry_line.outlets.database import connect

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "recipes" / "herring_roe" / "images"
DISK_MB = 500
SEEN_S = 3.0
"""How soon the operator is to see a fault."""

CAMERA = """\
    feed:
      use: basler
      options:
        emulated: true
        trigger: software
        rate_hz: {rate}
        nodes:
          {{ImageFileMode: "On", TestImageSelector: "Off", ImageFilename: {images},
           Width: 640, Height: 480, PixelFormat: Mono8}}
"""
LINE = f"""\
roemetry_line: 1
name: bench
folder: {{folder}}
stations:
  - name: cam
    recipe: {{recipe}}
    deadline_ms: 1000
    spool_gb: 0.1
{CAMERA}{{net}}outlets:
  - {{{{name: gate, use: tcp, options: {{{{port: {{tcp}}, timeout_s: 1}}}}}}}}
  - {{{{name: scada, use: opcua, options: {{{{port: {{opcua}}}}}}}}}}
{{broker}}history: {{{{url: "{{history}}"}}}}
page: {{{{port: {{page}}}}}}
"""
NETWORK_CAMERA = """\
  - name: net
    recipe: {}
    spool_gb: 0.1
    feed:
      use: aravis
      options: {{device: 127.0.0.1, nodes: {{Width: 640, Height: 480, AcquisitionFrameRate: 2.0}}}}
"""
BROKER = """\
  - {{name: broker, use: mqtt, options: {{port: {}, topic: bench, timeout_s: 2, consumers: [bench]}}}}
"""


def serve(folder: Path, log: Path) -> Process:
    """Start a line as it is described in a folder."""
    command = (sys.executable, "-m", "roemetry", "serve", str(folder / "line.yaml"), "--start-anyway")
    return Process(*command, log=log)


def asked(database: Path, query: str) -> list[tuple[Any, ...]]:
    """Give the rows of a query to a line's database."""
    with contextlib.closing(sqlite3.connect(database, timeout=10.0)) as db:
        return db.execute(query).fetchall()


class Process:
    """A program that can be killed and started again."""

    def __init__(self, *command: str, log: Path | None = None) -> None:
        self._command, self._log = command, log
        self.start()

    def start(self) -> None:
        """Start it."""
        with Path(self._log or os.devnull).open("a") as log:
            self.process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=log)

    def stop(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        """Let it drain, and end."""
        self.process.terminate()
        self.process.wait(90)


class Receiver:
    """A TCP receiver that can be gone, or be there and not answer."""

    def __init__(self, port: int, take: Callable[[dict[str, Any]], None]) -> None:
        """Listen at a port (0: any that is free); `take` is given each row."""
        self.port, self._take = port, take
        self.answers = True
        self._open: list[socket.socket] = []
        self.start()

    def start(self) -> None:
        """Listen, at the port of the last time."""
        self._server = socket.create_server(("127.0.0.1", self.port))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._serve, args=(self._server,), daemon=True).start()

    def stop(self) -> None:
        """Be gone, in the middle of whatever is being told."""
        for one in (self._server, *self._open):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._open.clear()

    def _serve(self, server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = server.accept()
                self._open.append(connection)
                threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError), connection.makefile("rb") as lines:
            for line in lines:
                row = json.loads(line)
                if not self.answers:
                    return
                self._take(row)
                connection.sendall(f"ok {row['key']}\n".encode())


class Broker(Process):
    """A mosquitto that keeps its messages on disk; it is stopped as an update of the machine would."""

    def __init__(self, folder: Path, port: int) -> None:
        self._port = port
        # Root's mosquitto becomes another user, who may not write here and forgets its subscribers.
        user = "user root\n" if os.getuid() == 0 else ""
        (folder / "mosquitto.conf").write_text(
            f"{user}listener {port} 127.0.0.1\nallow_anonymous true\npersistence true\n"
            f"max_queued_messages 0\npersistence_location {folder}/\n"
            "autosave_on_changes true\nautosave_interval 1\n"
        )
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin") or "mosquitto"
        super().__init__(program, "-c", str(folder / "mosquitto.conf"))

    def start(self) -> None:
        """Start it, and wait until it listens."""
        super().start()
        for _ in range(100):
            with contextlib.suppress(OSError):
                socket.create_connection(("127.0.0.1", self._port), 1.0).close()
                return
            time.sleep(0.05)

    stop = Process.end


class Postgres:
    """A PostgreSQL of its own that can crash."""

    def __init__(self, folder: Path, port: int) -> None:
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
        self._bin, self._folder, self._port = found[-1].parent, folder, port
        self._as = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
        self.url = f"postgresql://roemetry@127.0.0.1:{port}/postgres"
        if not (folder / "data").exists():
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o777)
            self._run("initdb", "-U", "roemetry", "-A", "trust", "--no-sync")
        self.start()

    def start(self) -> None:
        """Start it."""
        (self._folder / "data" / "postmaster.pid").unlink(missing_ok=True)
        options = f"-p {self._port} -k {self._folder} -c listen_addresses=127.0.0.1"
        self._run("pg_ctl", "-l", str(self._folder / "log"), "-o", options, "-w", "start")

    def stop(self) -> None:
        """Let it crash."""
        self._run("pg_ctl", "-m", "immediate", "stop")

    def _run(self, name: str, *given: str) -> None:
        command = [*self._as, str(self._bin / name), "-D", str(self._folder / "data"), *given]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=self._folder)


class Operator:
    """What the page shows: its stream of states, read as a browser does."""

    def __init__(self, port: int) -> None:
        self._url = f"http://127.0.0.1:{port}/events"
        self.state: dict[str, Any] | None = None
        self.heard_s = 0.0
        threading.Thread(target=self._look, daemon=True).start()

    def _look(self) -> None:
        while True:
            with (
                contextlib.suppress(OSError, ValueError),
                urllib.request.urlopen(self._url, timeout=5) as lines,
            ):
                for line in lines:
                    if line.startswith(b"data: "):
                        self.state, self.heard_s = json.loads(line[6:]), time.monotonic()
            self.state = None  # a browser says that there is no connection to the line
            time.sleep(0.2)

    def alarms(self) -> list[str]:
        """Give what the page says is wrong now."""
        if self.state is None or time.monotonic() - self.heard_s > 2.5:
            return ["no connection to the line"]
        return [f"{one['station']}: {one['text']}" for one in self.state["alarms"] if one["ended"] is None]

    def well(self) -> bool:
        """Say whether all measures and everything is delivered to."""
        state = self.state
        return (
            state is not None
            and all(one["state"] == "running" for one in state["stations"])
            and all(one["state"] == "connected" for one in state["outlets"])
        )

    def wait(self, seconds: float) -> bool:
        """Wait until all is well, at most so long."""
        until_s = time.monotonic() + seconds
        while not self.well() and time.monotonic() < until_s:
            time.sleep(0.1)
        return self.well()


class Rounds:
    """The line, what is around it, and the faults."""

    def __init__(self, folder: Path, rate: float, recipe: Path, outage_s: float) -> None:
        self.folder, self.data, self.log = folder, folder / "disk", folder / "log.jsonl"
        self.data.mkdir(parents=True, exist_ok=True)
        port = _ports(folder / "ports.json")
        mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "line", str(self.data)]
        mounted = os.path.ismount(self.data) or not subprocess.run(mount, capture_output=True).returncode
        arrived = (folder / "tcp.txt").open("a")

        def take(row: dict[str, Any]) -> None:
            arrived.write(row["key"] + "\n")
            arrived.flush()

        self.receiver = Receiver(port["tcp"], take)
        there = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
        self.broker = Broker(folder, port["mqtt"]) if there else None
        there_too = any(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
        place = Path("/tmp") / f"roemetry-{port['database']}"
        self.database = Postgres(place, port["database"]) if there_too else None
        camera = shutil.which("arv-fake-gv-camera-0.8")
        self.camera = Process(camera, "-i", "127.0.0.1", "-s", "GV01") if camera else None
        text = LINE.format(
            folder=self.data / "line", recipe=recipe, rate=rate, images=IMAGES, **port,
            net=NETWORK_CAMERA.format(recipe) if self.camera else "",
            broker=BROKER.format(port["mqtt"]) if self.broker else "",
            history=self.database.url if self.database else "sqlite:history.sqlite",
        )  # fmt: skip
        (folder / "line.yaml").write_text(text, "utf-8")
        self.serve = serve(folder, self.log)
        self.operator = Operator(port["page"])
        module = (sys.executable, "-m", "benchmarks.line_subscribers")
        self.subscribers = {
            kind: Process(
                *module, kind, f"{port[kind]}", str(folder / f"{kind}.txt"), log=folder / f"{kind}.log"
            )
            for kind in ("opcua", *(["mqtt"] if self.broker else []))
        }
        with contextlib.suppress(OSError):  # a client that reads nothing, the whole time
            self.idle = socket.create_connection(("127.0.0.1", port["page"]), 30.0)
        self.faults = self._faults(outage_s - 3.5, mounted)  # a round's own length, 3.5 to 5 s, comes to it

    def _faults(self, longer_s: float, mounted: bool) -> dict[str, tuple[str, Callable[[float], object]]]:
        """Give, by fault, what the page is to say, and what breaks it for so many seconds."""
        all_of: dict[str, tuple[Any, str, Callable[[float], object]]] = {
            "kill station": (True, "process of station cam died", lambda _: self.kill("station cam")),
            "kill outlets": (True, "process of outlets died", lambda _: self.kill("outlets")),
            "kill page": (True, "no connection|process of page died", lambda _: self.kill("page")),
            "kill serve": (True, "no connection", lambda _: self.gone(self.serve, 2.5)),
            "receiver gone": (True, "gate: rows are not delivered", lambda s: self.gone(self.receiver, s)),
            "receiver stuck": (True, "gate: rows are not delivered", self.stuck_receiver),
            "OPC UA stuck": (
                True, "scada: clients that take no", lambda s: self.stuck("opcua", s + longer_s)
            ),
            "broker gone": (
                self.broker, "broker: rows are not delivered", lambda s: self.gone(self.broker, s + longer_s)
            ),
            "MQTT stuck": (
                self.broker, "broker: consumers that confirm no products",
                lambda s: self.stuck("mqtt", s + longer_s),
            ),
            "database gone": (
                self.database, "history: rows are not", lambda s: self.gone(self.database, s + longer_s)
            ),
            "camera gone": (
                self.camera, "driver has not answered|no frames from", lambda s: self.gone(self.camera, s)
            ),
            "disk full": (mounted, "disk is full", self.fill),
        }  # fmt: skip
        return {name: (words, breaks) for name, (there, words, breaks) in all_of.items() if there}

    def ask(self, query: str) -> list[tuple[Any, ...]]:
        """Give the rows of a query to the outbox."""
        return asked(self.data / "line" / "line.sqlite", query)

    def kill(self, name: str) -> None:
        """Kill one of the line's processes."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(dict(self.ask("select component, pid from health"))[name], signal.SIGKILL)

    def gone(self, what: Any, seconds: float) -> None:
        """Take something away for a while."""
        what.stop()
        time.sleep(seconds)
        what.start()

    def stuck_receiver(self, seconds: float) -> None:
        """Let the receiver take connections and answer nothing."""
        self.receiver.answers = False
        time.sleep(seconds)
        self.receiver.answers = True

    def stuck(self, kind: str, seconds: float) -> None:
        """Stop a subscriber, which stays connected, and let it go on; note which rows came meanwhile."""
        process = self.subscribers[kind].process
        process.send_signal(signal.SIGSTOP)
        begin_s = time.time()
        time.sleep(seconds)
        told = self.ask(f"select key from rows where kind = 'product' and at > {begin_s} order by n")
        process.send_signal(signal.SIGCONT)
        with (self.folder / f"{kind}-stuck.txt").open("a") as file:
            file.write("".join(f"{key}\n" for (key,) in told))

    def fill(self, seconds: float) -> None:
        """Fill the disk, and make room again."""
        filler = self.data / "filler"
        with filler.open("wb") as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(1 << 16))
                file.flush()
        self.begin_s = time.monotonic()  # from now on it is full
        until_s = self.begin_s + seconds
        with filler.open("ab") as file:
            while time.monotonic() < until_s:  # what the line frees meanwhile
                with contextlib.suppress(OSError):
                    os.write(file.fileno(), bytes(1 << 12))
                time.sleep(0.02)
        filler.unlink()

    def round(self, fault: str, seconds: float) -> dict[str, Any]:
        """Break something; give after how long the page showed it, and when all was well again."""
        words, break_it = self.faults[fault]
        self.begin_s = begin = time.monotonic()
        seen: list[float] = []

        def watch() -> None:
            while not seen and time.monotonic() - begin < seconds + 5.0:
                if any(word in said for said in self.operator.alarms() for word in words.split("|")):
                    seen.append(max(0.0, time.monotonic() - self.begin_s))
                time.sleep(0.02)

        watching = threading.Thread(target=watch)
        watching.start()
        break_it(seconds)
        watching.join()
        mended = time.monotonic()
        well = self.operator.wait(60.0)
        return {"fault": fault, "seen_s": round(seen[0], 2) if seen else None, "well_again": well,
                "mended_s": round(time.monotonic() - mended, 1)}  # fmt: skip

    def end(self) -> None:
        """Stop the line, so that it drains."""
        time.sleep(4.0)  # what a process said before it was killed is old then
        self.operator.wait(56.0)
        self.serve.end()
        time.sleep(2.0)

    def close(self) -> None:
        """Stop everything, for good or until the benchmark goes on."""
        if self.serve.process.poll() is None:
            self.serve.end()
        around = (self.receiver, self.camera, self.database, *self.subscribers.values(), self.broker)
        for one in around:
            # what a round has just taken away cannot be stopped once more
            with contextlib.suppress(OSError, subprocess.CalledProcessError):
                if one is not None:
                    one.stop()

    def _recorded(self, file: str) -> list[str]:
        """Give the keys of the lines of a file of all runs."""
        stations = [self.data / "line" / "runs" / station for station in ("cam", "net")]
        runs = [run for station in stations for run in sorted(station.glob("*"))]
        return [f"bench/{run.name}/{row['id']}" for run in runs for row in kept(run / file)]

    def judged(self) -> dict[str, int]:
        """Count what is missing, doubled or out of order."""
        # the outbox keeps the last rows only
        last = {key for (key,) in self.ask("select key from rows where kind = 'product'")}
        record, spooled = self._recorded("measurements.jsonl"), set(self._recorded("items.jsonl"))
        table = connect(self.database.url if self.database else f"sqlite:{self.data}/line/history.sqlite")
        rows = table.ask("select line, run, id from roemetry_rows where kind = 'product'")
        table.close()
        there, history = set(record), ["/".join(key) for key in rows]
        found = {
            "rows of products": len(record),
            "spooled frames without a row": len(spooled - {key.partition("#")[0] for key in record}),
            "rows not in the record": len(last - there),
            "rows twice in the record": len(record) - len(there),
            "rows not in the history": len(there - set(history)),
            "rows twice in the history": len(history) - len(set(history)),
        }
        for name, file in (("receiver", "tcp"), *([("broker", "mqtt")] if self.broker else [])):
            keys = [key for key in self._arrived(file) if "!" not in key]
            once = list(dict.fromkeys(keys))
            found[f"duplicates at the {name}, taken out"] = len(keys) - len(once)
            found[f"rows missing at the {name}"] = len(there - set(once))
            found[f"rows at the {name} that nobody told"] = len(set(once) - there)
            by_station = sorted(once, key=lambda key: key.split("/")[1].partition("-")[0])
            wrong = sum(one != other for one, other in zip(by_station, record, strict=False))
            found[f"rows out of order at the {name}"] = wrong
        meanwhile = self._arrived("opcua-stuck")
        missing = set(meanwhile) - set(self._arrived("opcua"))
        told = f"rows missing at the OPC UA client, of {len(meanwhile)} told while it was stopped"
        return found | {told: len(missing)}

    def _arrived(self, name: str) -> list[str]:
        path = self.folder / f"{name}.txt"
        return path.read_text().split() if path.exists() else []


def _ports(path: Path) -> dict[str, int]:
    """Give ports that are free, the same whenever the benchmark goes on."""
    if not path.exists():
        names = ("tcp", "page", "mqtt", "database", "opcua")
        with contextlib.ExitStack() as open_ones:
            servers = [open_ones.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in names]
            numbers = [server.getsockname()[1] for server in servers]
        path.write_text(json.dumps(dict(zip(names, numbers, strict=True))))
    found: dict[str, int] = json.loads(path.read_text())
    return found


def faults(rounds: int, rate: float, recipe: Path, seed: int, folder: Path, outage_s: float) -> int:
    """Break the line so many times; print what was seen and found, give the number of faults.

    Broker and database are gone, and subscribers stuck, for `outage_s` and up to 1 s longer.
    """
    notes, line = folder / "rounds.jsonl", Rounds(folder.resolve(), rate, recipe, outage_s)
    try:
        names, counts = list(line.faults), _broken(line, rounds, seed, notes)
    finally:
        line.close()
    told = kept(notes)
    print(f"\n{len(told)} rounds, seed {seed}, {rate:g} frames/s")
    for name in names:
        of = [one for one in told if one["fault"] == name]
        seen = [one["seen_s"] for one in of if one["seen_s"] is not None]
        within, again = sum(second <= SEEN_S for second in seen), sum(one["well_again"] for one in of)
        print(
            f"{name:16} {len(of):3} rounds, seen within {SEEN_S:g} s in {within}, "
            f"at most {max(seen, default=0):.1f} s, well again in {again}"
        )
    for what, count in counts.items():
        print(f"{what}: {count}")
    return sum(n for what, n in counts.items() if "taken out" not in what and what != "rows of products")


def _broken(line: Rounds, rounds: int, seed: int, notes: Path) -> dict[str, int]:
    """Break what is to be broken, round by round; give what is wrong with the rows then."""
    if not line.operator.wait(300.0):
        raise SystemExit(line.log.read_text())
    names = list(line.faults)
    for number in range(len(kept(notes)), rounds):
        draw = random.Random(1000 * seed + number)
        time.sleep(draw.uniform(0.5, 1.5))
        found = line.round(names[number % len(names)], draw.uniform(3.5, 5.0))
        print(f"{number + 1}/{rounds} {found}", flush=True)
        keep(notes, found)
    line.end()
    return line.judged()
