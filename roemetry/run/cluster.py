"""Work that the workers of a dask cluster share out: many machines, or processes of this one.

Workers are warmed by their first task and keep what they made; whatever dies is started again by the
cluster, and what it was at is given to another worker. A task that kills every worker that tries it is lost.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import math
import pickle
import platform
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

from roemetry.errors import ConfigurationError, InterruptedRunError, PluginError
from roemetry.run.executors import Lost, Result, Task, Tasks, results_of

LOCAL = "local"
"""The address of a cluster that is started on this machine for the run."""

QUIET = {
    "distributed.admin.tick.interval": "2s",
    "distributed.admin.tick.limit": "30s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
}
"""dask's settings for scheduler and workers that leave the cores to the work.

By default every process looks fifty times a second whether its event loop is late, ten times a second at its
memory, twice at the machine's, and a hundred times a second at what its threads are doing: a scheduler and
two workers that have nothing to do take 96 ms of processor time a second, with these settings 9 ms.
"""

_CHUNK_S = 1.0
"""Work that is handed over at once, s: long beside the 10 ms that a chunk costs scheduler and client."""
_CHUNK_S_LATER = 6.0
"""The same once a run is long, s: scheduler and client then take half the time a product that they took."""
_CHUNK_SHARE = 0.05
"""A chunk's share of the time a run has taken, at most: for so much of it a worker may be idle at the end."""
_CHUNK_S_PER_THREAD = 0.08
"""Of many threads, a chunk is longer: the client, at 6 of those 10 ms, then works a twelfth of the time."""
_CHUNK_MAX = 200
"""Tasks at once, at most: what is done again where a worker dies."""
_WAITING_PER_THREAD = 4
"""Chunks that wait for each thread of the cluster: tens of thousands at once would slow the scheduler."""
_LOOK_S = 2.0
"""How often is looked at which workers there are, s."""
_PATIENCE_S = 60.0
"""How long a run waits for a worker when there is none, s."""
_CONNECT_S = 5.0
"""How long a scheduler may take to answer, s."""
_DEATHS_MAX = 1
"""On a local cluster: workers that may die of a chunk before its tasks are tried one by one."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """An `Executor` on dask.distributed.

    The workers need the same roemetry, plugins and libraries, and the images under the same paths.
    """

    address: str
    """The scheduler's, such as ``tcp://10.0.0.5:8786``; or `LOCAL`."""
    workers: int = 1
    """Processes of a local cluster."""

    def in_order(
        self, make: Callable[..., Callable[[Task], Result]], given: tuple[Any, ...], tasks: Tasks[Task]
    ) -> Iterator[Result | Lost[Task]]:
        """See `Executor.in_order`.

        ConfigurationError where there is no cluster or no worker, PluginError where a worker has other
        software; InterruptedRunError where the scheduler or all workers went away.
        """
        with ExitStack() as stack:
            client = stack.enter_context(_connected(self))
            with _reachable(self.address):
                _refuse_other_software(client)
                software_sha256 = _sha256_of(software())
                payload = client.submit(bytes, pickle.dumps((software_sha256, make, given)), pure=False)
            yield from _in_order(client, self.address, payload, tasks)


@cache
def software() -> dict[str, str]:
    """Say what this process measures with: the hash of each package's code, the version of each library.

    Of roemetry, of every package that provides a stage, and of what numbers are worked out with.
    """
    from roemetry.stages.registry import discover

    packages = {stage.entry.target.partition(":")[0].partition(".")[0] for stage in discover().stages}
    told = {name: _code_of(name)[:12] for name in sorted({"roemetry", *packages})}
    for library in ("numpy", "scipy", "numba", "opencv-contrib-python-headless"):
        told[library] = version(library)
    return told | {"python": platform.python_version(), "processor": platform.machine()}


def _code_of(package: str) -> str:
    """Hash a package's source files, by their names."""
    found = importlib.util.find_spec(package)
    folders = [] if found is None else list(found.submodule_search_locations or ())
    files = [(file.relative_to(folder).as_posix(), file) for folder in folders for file in _sources(folder)]
    if not folders and found is not None and found.origin is not None:
        files = [(package, Path(found.origin))]
    whole = hashlib.sha256()
    for name, file in sorted(files):
        whole.update(f"{name}\0".encode() + file.read_bytes() + b"\0")
    return whole.hexdigest()


def _sources(folder: str) -> Iterator[Path]:
    return Path(folder).rglob("*.py")


def _sha256_of(told: dict[str, str]) -> str:
    return hashlib.sha256(repr(sorted(told.items())).encode()).hexdigest()


@contextmanager
def _connected(cluster: Cluster) -> Iterator[Any]:
    """Give a client of the cluster; a local one is started, and ends with the block."""
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.comm.addressing import parse_address, parse_host_port
    except ImportError as error:
        raise PluginError(
            f"--cluster needs the module {error.name}; install it with `pip install 'roemetry[cluster]'`"
        ) from error
    with ExitStack() as stack:
        # What distributed logs of dying workers and lost connections is told as one message.
        for name in ("", ".client", ".nanny", ".scheduler", ".core", ".batched", ".worker"):
            logger = logging.getLogger(f"distributed{name}")
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        address: Any = cluster.address
        if address == LOCAL:
            settings = QUIET | {"distributed.scheduler.allowed-failures": _DEATHS_MAX}
            stack.enter_context(dask.config.set(settings))
            address = stack.enter_context(
                LocalCluster(
                    n_workers=cluster.workers,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                )
            )
        try:
            if address == cluster.address:  # a client that cannot connect is slow to say so, and to go
                socket.create_connection(parse_host_port(parse_address(address)[1]), _CONNECT_S).close()
            client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"{cluster.address}: there is no dask scheduler: {error}",
                hint="start one with `dask scheduler`, or use --cluster local",
            ) from error
        yield stack.enter_context(client)


@contextmanager
def _reachable(address: str) -> Iterator[None]:
    """Turn what distributed raises when the scheduler goes away into one message."""
    try:
        yield
    except (OSError, CancelledError) as error:
        raise InterruptedRunError(
            f"{address}: the cluster's scheduler is gone",
            hint="what was done is whole; go on when it is back, with --resume where offered",
        ) from error


def _refuse_other_software(client: Any) -> None:
    mine = software()
    answers = client.run(software, on_error="return")
    if not answers:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
        answers = client.run(software, on_error="return")
    faults = []
    for worker, theirs in sorted(answers.items()):
        if isinstance(theirs, OSError):  # it has just died; what takes its place is checked when it is warmed
            continue
        if not isinstance(theirs, dict):
            faults.append(f"{worker}: cannot load roemetry: {theirs}")
            continue
        names = [name for name in sorted({*mine, *theirs}) if mine.get(name) != theirs.get(name)]
        faults += [f"{worker}: {name} is {theirs.get(name)}, here it is {mine.get(name)}" for name in names]
    if faults:
        raise PluginError(
            "workers of the cluster have other software:\n" + "\n".join(faults),
            hint="install the same on all machines, then start the workers again",
        )


def _in_order(client: Any, address: str, payload: Any, tasks: Tasks[Task]) -> Iterator[Any]:
    """Keep a bounded window of chunks at work, and give their results in the order of the tasks."""
    waiting: deque[tuple[Any, list[Task]]] = deque()
    coming, together, threads, looked, begin = iter(tasks), 1, 1, -math.inf, time.monotonic()

    def submit(chunk: list[Task]) -> Any:
        # One value for the scheduler to carry, not a graph of them.
        return client.submit(_work, payload, pickle.dumps(chunk), pure=False)

    while True:
        with _reachable(address):
            if time.monotonic() - looked > _LOOK_S:
                threads = max(1, _threads(client))
                looked = time.monotonic()
            while len(waiting) < _WAITING_PER_THREAD * threads and (chunk := list(islice(coming, together))):
                waiting.append((submit(chunk), chunk))
            if not waiting:
                return
            _wait_for(client, waiting[0][0])
            finished = [future for future, _ in takewhile(lambda one: one[0].status == "finished", waiting)]
            gathered = client.gather(finished)
        for results, mean_s in gathered:
            waiting.popleft()
            later_s = min(_CHUNK_S_LATER, _CHUNK_SHARE * (time.monotonic() - begin))
            chunk_s = max(_CHUNK_S, later_s, _CHUNK_S_PER_THREAD * threads)
            together = max(1, min(_CHUNK_MAX, math.ceil(chunk_s / max(mean_s, 1e-6))))
            yield from results
        if not gathered and waiting[0][0].status == "error":
            future, chunk = waiting.popleft()
            _raise_unless_killed(future)
            for future, _ in waiting:  # with nothing else at work, who dies dies of this task
                _wait_for(client, future)
            for task in chunk:
                yield from _alone(client, address, task, submit)


def _alone(
    client: Any, address: str, task: Task, submit: Callable[[list[Task]], Any]
) -> Iterator[Any | Lost[Task]]:
    """Give the result of a task whose chunk killed workers, or say that it is lost."""
    with _reachable(address):
        future = submit([task])
        while future.status != "error":  # a result is lost again with the worker that has it
            _wait_for(client, future)
            if future.status == "finished":
                results, _ = future.result()
                yield from results
                return
    _raise_unless_killed(future)
    yield Lost(task, "every worker of the cluster that tried it died (a crash, or want of memory)")


def _raise_unless_killed(future: Any) -> None:
    """Raise what a task raised on its worker; return where it killed its worker."""
    from distributed import KilledWorker

    error = future.exception()
    if not isinstance(error, KilledWorker):
        raise error


def _threads(client: Any) -> int:
    return sum(client.nthreads().values())


def _wait_for(client: Any, future: Any) -> None:
    """Wait until a chunk is done; InterruptedRunError where there has been no worker for long."""
    from distributed import wait

    alone_since = math.inf
    while True:
        try:
            with client.as_current():
                wait(future, timeout=_LOOK_S)
            return
        except TimeoutError as error:
            alone_since = math.inf if _threads(client) else min(alone_since, time.monotonic())
            if time.monotonic() - alone_since > _PATIENCE_S:
                raise InterruptedRunError(
                    f"the cluster has had no worker for {_PATIENCE_S:.0f} s",
                    hint="what was done is whole; start workers and go on, with --resume where offered",
                ) from error


_making = threading.Lock()
"""Threads of a worker are warmed one after another: what the first one loads is there for the others."""


class _Made(threading.local):
    """What a thread of a worker does its tasks with, and from what it was made; nothing knows of others."""

    payload: bytes | None = None
    worker: Callable[[Any], Any] | None = None


_made = _Made()


def _work(payload: bytes, chunk: bytes) -> tuple[list[Any], float]:
    """Give the results of a chunk, and the mean time of a task, s; on a worker."""
    if _made.worker is None or _made.payload != payload:
        with _making:
            _made.payload, _made.worker = payload, _warm(payload)
    tasks = pickle.loads(chunk)
    begin = time.perf_counter()
    results = list(results_of(_made.worker, tasks))
    return results, (time.perf_counter() - begin) / len(tasks)


def _warm(payload: bytes) -> Callable[[Any], Any]:
    """Make what a thread does its tasks with: once for a run."""
    software_sha256, make, given = pickle.loads(payload)
    if _sha256_of(software()) != software_sha256:
        raise PluginError(
            f"a worker on {platform.node()} that came later has other software than the run",
            hint="take it out of the cluster, and go on, with --resume where offered",
        )
    worker: Callable[[Any], Any] = make(*given)
    return worker
