"""The process that takes rows from the outbox to the outlets: a thread each, none waits for another."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from roemetry.errors import FAULTS, OutputError, RoemetryError
from roemetry.records.live import LineRow
from roemetry_line.control import Control
from roemetry_line.days import HourlyTidying
from roemetry_line.line_file import Line, NamedOutlet
from roemetry_line.log import log, log_libraries
from roemetry_line.outbox import Outbox
from roemetry_line.process import alone, settle, stop_event

_BATCH = 100
"""Rows that are handed to an outlet at once, at most: after an outage they go out by the hundred."""
_TICK_S = 0.25  # between two looks at whether rows or the end have come
_REOPEN_S = (0.5, 1.0, 2.0)
"""How long a receiver that is not there is left alone, the first times and from then on, s."""
_DRAIN_S = 5.0
"""How long, once asked to stop, rows that wait are still delivered, s; the others stay in the outbox."""
_END_S = 12.0
"""How long, once asked to stop, an outlet that is being opened, or hangs, is waited for, s: its rows stay in
the outbox. `serve` would kill this process later."""
_CARE_S = 1.0  # between two rounds of telling the state and of pruning
_PAUSE_S = 0.01
"""What stations that write get of the outbox between two steps of its pruning, s."""
_MARK_S = 0.25
"""How often, while rows come, it is written down how far an outlet has got, s: a write for each row would
keep the stations' writes waiting, and what was delivered since comes again after a death, by the same key."""


class Deliverer:
    """Delivers the rows of one outlet, in order, again and again until they are taken."""

    def __init__(
        self, named: NamedOutlet, line: Line, outbox: Outbox, news: threading.Condition, stop: threading.Event
    ) -> None:
        self.name = named.name
        self._control = Control(line, outbox, named.name)
        self.state = "starting"
        self.delivered = 0
        self.waiting = 0
        self.reconnects = 0
        self._named, self._outbox, self._news, self._stop = named, outbox, news, stop
        self._until_s = 0.0
        self._mark = 0
        self._failures = 0

    def run(self) -> None:
        """Deliver until asked to stop and nothing waits, or until the time for that is over."""
        while not self._over():
            try:
                outlet = self._named.outlet.make()
                outlet.line = self._control
                with outlet.open() as deliver:
                    self._deliver_all(deliver)
                break
            # Whatever an outlet raises, its rows wait in the outbox.
            except FAULTS as error:
                said = (
                    error.message if isinstance(error, RoemetryError) else f"{type(error).__name__}: {error}"
                )
                self.state = f"not delivering: {said}"
                self.reconnects += 1
                self._alarm(said)
                self._stop.wait(_REOPEN_S[min(self._failures, len(_REOPEN_S) - 1)])
                self._failures += 1
        self.state = "stopped"

    def _deliver_all(self, deliver: Callable[[Sequence[LineRow]], None]) -> None:
        marked, marked_s = self._outbox.mark(self.name), 0.0
        mark = self._mark = max(self._mark, marked)
        while True:
            rows = self._outbox.after(mark, _BATCH)
            if rows:
                deliver(rows)
            self._is_well()
            if rows:
                mark = self._mark = rows[-1].number
                self.delivered += len(rows)
            now = time.monotonic()
            if mark > marked and (not rows or now - marked_s > _MARK_S):
                self._outbox.delivered(self.name, mark)
                marked, marked_s = mark, now
            if self._over(nothing_waits=not rows):
                return
            if not rows:
                with self._news:
                    if not self._outbox.after(mark, 1):
                        self._news.wait(_TICK_S)

    def _is_well(self) -> None:
        """Note that the receiver takes rows: one that can be connected to and takes none is not well."""
        if self.state != "connected":
            again = " again" if self._outbox.end_alarm(self.name, "outlet") else ""
            log("info", "outlet", f"the receiver takes rows{again}", outlet=self.name)
            self.state, self._failures = "connected", 0

    def _over(self, *, nothing_waits: bool = False) -> bool:
        if not self._stop.is_set():
            return False
        self._until_s = self._until_s or time.monotonic() + _DRAIN_S
        return nothing_waits or time.monotonic() > self._until_s

    def _alarm(self, said: str) -> None:
        try:
            if self._outbox.raise_alarm(self.name, "outlet", f"rows are not delivered: {said}"):
                log("error", "outlet", said, outlet=self.name)
        except OutputError as error:
            log("error", "outlet", f"{said}; and {error}", outlet=self.name)


def main() -> int:
    """Deliver the rows of the line file that the command line names."""
    log_libraries()
    stop = stop_event()
    line = Line.load(Path(sys.argv[1]), with_recipes=False)
    outbox = Outbox(line.folder)
    with alone(line.folder, "outlets", stop) as mine:
        if mine:
            _deliver(line, outbox, stop)
    return 0


def _deliver(line: Line, outbox: Outbox, stop: threading.Event) -> None:
    news = threading.Condition()
    workers = [Deliverer(named, line, outbox, news, stop) for named in line.outlets]
    threads = [threading.Thread(target=worker.run, daemon=True) for worker in workers]
    for thread in threads:
        thread.start()
    settle()
    threading.Thread(target=_care, args=(line, outbox, workers, stop), daemon=True).start()
    until_s = math.inf
    while (any(thread.is_alive() for thread in threads) and time.monotonic() < until_s) or not stop.is_set():
        if stop.is_set() and until_s == math.inf:
            until_s = time.monotonic() + _END_S
        outbox.listen(_TICK_S)
        with news:
            news.notify_all()


def _care(line: Line, outbox: Outbox, workers: Sequence[Deliverer], stop: threading.Event) -> None:
    """Once a second say how the outlets are, and look after outbox and history; no row waits for it."""
    tidying = HourlyTidying(line, outbox)
    while True:
        try:
            outbox.checkpoint()
            waiting = outbox.waiting([worker.name for worker in workers])
            told = {
                worker.name: {
                    "state": worker.state,
                    "delivered": worker.delivered,
                    "waiting": waiting[worker.name],
                    "reconnects": worker.reconnects,
                }
                for worker in workers
            }
            outbox.beat("outlets", "stopping" if stop.is_set() else "running", told)
            while outbox.prune(list(told)):
                time.sleep(_PAUSE_S)
            tidying.look()
        except OutputError as error:
            log("error", "outbox", str(error))
        time.sleep(_CARE_S)


if __name__ == "__main__":
    sys.exit(main())
