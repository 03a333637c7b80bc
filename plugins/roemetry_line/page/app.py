"""The page's addresses: each says who may ask for it, and what it gives.

What is shown, and what Prometheus reads (its text format 0.0.4), is taken from the outbox.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from roemetry.errors import DataError, RoemetryError
from roemetry.records import Frame
from roemetry_line import control_charts, history, runs
from roemetry_line.control import Control
from roemetry_line.feeds.image import decoded
from roemetry_line.line_file import Line
from roemetry_line.live_view import jpeg_of, picture_file, watch
from roemetry_line.log import log
from roemetry_line.outbox import Outbox
from roemetry_line.page.users import MAY, Role, Session, Users
from roemetry_line.station import LATENCY_MS

_SILENT_S = 3.0
"""A process that has said nothing for so long is shown as silent."""
_REJECTS = 12  # newest that the page shows
_FULL_GB = 0.02


def snapshot_of(line: Line, outbox: Outbox) -> dict[str, Any]:
    """Give the state of a line, as plain values."""
    now = time.time()
    health = outbox.health()
    rows = outbox.last_rows(200)
    return {
        "line": line.name,
        "time_s": now,
        "stations": [
            _station(one.name, health.get(f"station {one.name}"), rows, now)
            | {
                "deadline_ms": one.section.deadline_ms,
                "recipes": [str(path) for path in one.recipes],
                "recipe": outbox.requested_recipe(one.name) or str(one.recipes[0]),
                "check": outbox.last_check(one.name),
            }
            for one in line.stations
        ],
        "outlets": _outlets(line, health.get("outlets"), now),
        "alarms": [*_disk_full(line.folder, now), *outbox.alarms()],
    }


def _disk_full(folder: Path, now: float) -> list[dict[str, Any]]:
    """Give an alarm where the disk is full: then none can be written that would say so."""
    free_gb = runs.disk_free(folder)
    if not free_gb < _FULL_GB:
        return []
    left = f"{1e3 * free_gb:.0f} MB are free for {folder}"
    said = f"the disk is full: {left}; frames wait until there is room"
    return [
        {
            "n": 0,
            "at": now,
            "station": "disk",
            "code": "disk-full",
            "text": said,
            "level": "alarm",
            "ended": None,
            "acknowledged": now,
            "acknowledged_by": "nobody: it cannot be written",
        }
    ]


def _station(
    name: str, told: Mapping[str, Any] | None, rows: list[dict[str, Any]], now: float
) -> dict[str, Any]:
    own = [row for row in rows if row["station"] == name]
    products = [row for row in own if row["kind"] == "product"]
    rejects = [row for row in products if _is_reject(row["summary"])][:_REJECTS]
    figures = {} if told is None else dict(told["figures"])
    silent_s = None if told is None else now - told["at"]
    state = "not started" if told is None else str(told["state"])
    if silent_s is not None and silent_s > _SILENT_S and state != "stopped":
        state = f"silent for {silent_s:.0f} s"
    return {
        "name": name,
        "state": state,
        "figures": figures,
        "frame_age_s": now - figures["last_frame_s"] if "last_frame_s" in figures else None,
        "last": products[0] if products else None,
        "rejects": rejects,
    }


def _is_reject(told: Mapping[str, Any]) -> bool:
    """Say whether a person will want to look: not measured, undecided, or of no good class."""
    word = told.get("decision") or told.get("grade")
    return told.get("status") == "failed" or (word is not None and word not in ("good", "A", "ok"))


def _outlets(line: Line, told: Mapping[str, Any] | None, now: float) -> list[dict[str, Any]]:
    figures = {} if told is None else told["figures"]
    silent = told is None or now - told["at"] > _SILENT_S
    return [
        {"name": one.name, "kind": one.outlet.registered.entry.name}
        | dict(figures.get(one.name, {"state": "not started", "delivered": 0, "waiting": 0}))
        | ({"state": "silent"} if silent else {})
        for one in line.outlets
    ]


_STATION = (
    ("frames", "frames_total", "counter", "Frames taken"),
    ("products", "products_total", "counter", "Rows told of products"),
    ("lost", "frames_lost_total", "counter", "Frames that the camera took and that did not arrive"),
    ("incomplete", "frames_incomplete_total", "counter", "Frames that did not arrive whole"),
    ("late", "frames_late_total", "counter", "Frames that were measured after their deadline"),
    ("reconnects", "camera_reconnects_total", "counter", "How often the camera was gone"),
    ("waited_s", "camera_waited_seconds_total", "counter", "How long taking frames waited for measuring"),
    ("queue", "queue_frames", "gauge", "Frames that wait to be measured"),
    ("disk_free_gb", "disk_free_gigabytes", "gauge", "Free space for the line's folder"),
)


def metrics_of(line: Line, outbox: Outbox) -> str:
    """Give all figures as text."""
    return "".join(f"{text}\n" for text in _lines(line, outbox))


def _lines(line: Line, outbox: Outbox) -> Iterator[str]:
    health = outbox.health()
    told = {one.name: health.get(f"station {one.name}") for one in line.stations}
    stations = {name: one["figures"] for name, one in told.items() if one is not None}
    for key, name, kind, meaning in _STATION:
        yield from _head(name, kind, meaning)
        for station, figures in stations.items():
            if key in figures:
                yield f'roemetry_{name}{{line="{line.name}",station="{station}"}} {figures[key]}'
    yield from _head("station_silent_seconds", "gauge", "Time since the station's process said something")
    for station, one in told.items():
        if one is not None:
            at = f'{{line="{line.name}",station="{station}"}}'
            yield f"roemetry_station_silent_seconds{at} {time.time() - one['at']:.3f}"
    yield from _head("results_total", "counter", "Products by decision, grade or status")
    for station, figures in stations.items():
        for result, count in figures.get("results", {}).items():
            label = f'{{line="{line.name}",station="{station}",result="{_escaped(result)}"}}'
            yield f"roemetry_results_total{label} {count}"
    yield from _head("latency_seconds", "histogram", "From a frame's arrival to its rows in the outbox")
    for station, figures in stations.items():
        yield from _histogram(f'line="{line.name}",station="{station}"', figures)
    for key, kind, meaning in (
        ("delivered", "counter", "Rows delivered since the process started"),
        ("waiting", "gauge", "Rows that wait to be delivered"),
        ("reconnects", "counter", "How often the receiver was not there"),
    ):
        name = f"outlet_{key}" + ("_total" if kind == "counter" else "")
        yield from _head(name, kind, meaning)
        for outlet, figures in health.get("outlets", {"figures": {}})["figures"].items():
            yield f'roemetry_{name}{{line="{line.name}",outlet="{outlet}"}} {figures[key]}'


def _head(name: str, kind: str, meaning: str) -> Iterator[str]:
    yield f"# HELP roemetry_{name} {meaning}"
    yield f"# TYPE roemetry_{name} {kind}"


def _histogram(labels: str, figures: dict[str, object]) -> Iterator[str]:
    counts = figures.get("latency_counts")
    if not isinstance(counts, list):
        return
    so_far = 0
    for upper_ms, count in zip((*LATENCY_MS, None), counts, strict=True):
        so_far += count
        upper = "+Inf" if upper_ms is None else f"{upper_ms / 1e3:g}"
        yield f'roemetry_latency_seconds_bucket{{{labels},le="{upper}"}} {so_far}'
    yield f"roemetry_latency_seconds_sum{{{labels}}} {float(str(figures['latency_ms_sum'])) / 1e3:.6f}"
    yield f"roemetry_latency_seconds_count{{{labels}}} {so_far}"


def _escaped(label: str) -> str:
    return label.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


_STATIC = Path(__file__).parent / "static"
_COOKIE = "roemetry_session"
_BODY_MAX, _BODY_S = 10_000, 5.0  # bytes of a request, and how long it may take to come, s
_EVERY_S = 0.5
"""How often what is shown is read anew, s."""
_BEAT_S = 1.0  # as the other processes: what is written once a second is enough to see a death
_STREAMS_MAX = 50  # pages that are kept up to date at once
_TREND_HOURS_MAX = 24.0 * 31

_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; "
    "form-action 'self'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_MISFIT = 400  # HTTP: bad request
_UNKNOWN = 404  # HTTP: not found
_WORD = re.compile(r"[a-zA-Z0-9_-]+")


class RefusedError(Exception):
    """A request that is answered with a status and a sentence."""

    def __init__(self, status: int, said: str) -> None:
        super().__init__(said)
        self.status = status


class LinePage:
    """The page of one line."""

    def __init__(self, line: Line, outbox: Outbox, users: Users) -> None:
        self._line, self._outbox, self._users = line, outbox, users
        self._stations = {one.name: one for one in line.stations}
        self._state: dict[str, Any] = {}
        self._changed = asyncio.Condition()
        self._streams = 0
        self._ended = False

    def app(self, hosts: list[str]) -> Starlette:
        """Make the application; `hosts` are the names under which it may be asked for."""
        do = ["POST"]
        return Starlette(
            routes=[
                Route("/", self._page),
                Route("/events", self._events),
                Route("/picture/{station}", self._picture),
                Route("/spooled/{station}/{run}/{acquisition}.jpg", self._spooled),
                Route("/trend/{station}", self._trend),
                Route("/metrics", self._metrics),
                Route("/who", self._who),
                Route("/log-in", self._log_in, methods=do),
                Route("/log-out", self._log_out, methods=do),
                Route("/acknowledge/{number:int}", self._acknowledge, methods=do),
                Route("/recipe/{station}", self._recipe, methods=do),
                Route("/check/{station}", self._check, methods=do),
                Route("/checks/{station}", self._checks),
                Mount("/static", StaticFiles(directory=_STATIC)),
            ],
            # A page of another site can send requests here under a name of its own (DNS rebinding).
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=hosts), Middleware(_Headers)],
            exception_handlers={RefusedError: _refused, RoemetryError: _refused},
        )

    async def poll(self) -> None:
        """Read what is shown, again and again, while somebody looks, and wake who waits for it."""
        beaten = -math.inf
        while True:
            if time.monotonic() - beaten > _BEAT_S:
                beaten, figures = time.monotonic(), {"looked_at_by": self._streams}
                try:
                    await run_in_threadpool(self._outbox.beat, "page", "running", figures)
                except RoemetryError as error:
                    log("error", "health-not-written", str(error))
            if self._streams:
                try:
                    self._state = await run_in_threadpool(snapshot_of, self._line, self._outbox)
                    await run_in_threadpool(watch, self._line.folder)
                except (RoemetryError, OSError) as error:
                    log("error", "page", str(error))
                async with self._changed:
                    self._changed.notify_all()
            await asyncio.sleep(_EVERY_S)

    async def end(self) -> None:
        """End the streams: who looks connects again, and sees that nobody answers."""
        self._ended = True
        async with self._changed:
            self._changed.notify_all()

    # --- shown to everybody -----------------------------------------------------------------------------

    async def _page(self, _: Request) -> Response:
        return FileResponse(_STATIC / "index.html")

    async def _events(self, request: Request) -> Response:
        if self._streams >= _STREAMS_MAX:
            raise RefusedError(503, "too many look at this page")

        async def stream() -> AsyncIterator[bytes]:
            self._streams += 1
            try:
                while True:
                    # Who reads slowly misses states, and keeps nobody waiting.
                    async with self._changed:
                        await self._changed.wait()
                    if self._ended:
                        return
                    if self._state:
                        yield f"data: {json.dumps(self._state)}\n\n".encode()
            finally:
                self._streams -= 1

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def _picture(self, request: Request) -> Response:
        path = picture_file(self._line.folder, self._known(request))
        try:
            return Response(path.read_bytes(), media_type="application/json")
        except OSError:
            return Response(status_code=204)  # none yet

    async def _spooled(self, request: Request) -> Response:
        given = request.path_params
        if not (_WORD.fullmatch(given["run"]) and given["acquisition"].isdigit()):
            raise RefusedError(_UNKNOWN, "there is no such picture")
        run = self._line.folder / "runs" / self._known(request) / given["run"]
        return Response(
            await run_in_threadpool(_jpeg_of, runs.image_of(run, given["acquisition"])),
            media_type="image/jpeg",
        )

    async def _trend(self, request: Request) -> Response:
        station = self._known(request)
        figure: Any = request.query_params.get("figure", "mass_g")
        hours = request.query_params.get("hours", "8")
        if figure not in history.FIGURES:
            raise RefusedError(_MISFIT, "there is no such figure")
        try:
            since_s = 3600.0 * min(float(hours), _TREND_HOURS_MAX)
        except ValueError as error:
            raise RefusedError(_MISFIT, "hours must be a number") from error
        return JSONResponse(await run_in_threadpool(self._charted, station, figure, since_s))

    def _charted(self, station: str, figure: history.Figure, back_s: float) -> dict[str, Any]:
        if not self._line.history_begun:
            return control_charts.told({}, {})
        table = history.history_of(self._line)
        try:
            since_s = time.time() - back_s
            of = self._line.name, station, since_s
            return control_charts.told(history.counts_of(table, *of), history.charts_of(table, figure, *of))
        finally:
            table.close()

    async def _checks(self, request: Request) -> Response:
        """Give the checks of the station's calibration, for the chart of its drift."""
        station = self._stations[self._known(request)]
        checks = await run_in_threadpool(history.checks_of, self._line, station)
        plots = control_charts.drift_plots(checks) if checks else []
        return JSONResponse({"checks": len(checks), "plots": [[words, str(plot)] for words, plot in plots]})

    async def _metrics(self, _: Request) -> Response:
        text = await run_in_threadpool(metrics_of, self._line, self._outbox)
        return Response(text, media_type="text/plain; version=0.0.4")

    async def _who(self, request: Request) -> Response:
        session = self._users.session(request.cookies.get(_COOKIE))
        if session is None:
            return JSONResponse({"name": None, "role": "viewer"})
        return JSONResponse({"name": session.name, "role": session.role, "csrf": session.csrf})

    # --- what is done -----------------------------------------------------------------------------------

    async def _log_in(self, request: Request) -> Response:
        _same_origin(request)
        given = await _body(request)
        name, password = str(given.get("name", "")), str(given.get("password", ""))
        key = await run_in_threadpool(self._users.log_in, name, password)
        if key is None:
            log("warning", "log-in-refused", f"for the name {name[:40]!r}")
            raise RefusedError(403, "name or password is wrong")
        self._users.log_out(request.cookies.get(_COOKIE))
        log("info", "logged-in", name)
        # Another key for every login: one that somebody put into the browser before is worth nothing.
        answer = JSONResponse({"name": name})
        answer.set_cookie(
            _COOKIE, key, httponly=True, samesite="strict", secure=request.url.scheme == "https"
        )
        return answer

    async def _log_out(self, request: Request) -> Response:
        await self._allowed(request, "viewer")
        self._users.log_out(request.cookies.get(_COOKIE))
        answer = JSONResponse({})
        answer.delete_cookie(_COOKIE)
        return answer

    async def _acknowledge(self, request: Request) -> Response:
        session = await self._allowed(request, "operator")
        if not self._outbox.acknowledge(request.path_params["number"], session.name):
            raise RefusedError(_UNKNOWN, "there is no such alarm, or it was acknowledged before")
        return JSONResponse({})

    async def _recipe(self, request: Request) -> Response:
        session = await self._allowed(request, "engineer")
        station, wanted = self._known(request), str((await _body(request)).get("recipe", ""))
        if not Control(self._line, self._outbox).choose(station, wanted, session.name):
            raise RefusedError(_MISFIT, "this recipe is none of the station's `recipe` and `choices`")
        return JSONResponse({})

    async def _check(self, request: Request) -> Response:
        session = await self._allowed(request, "operator")
        self._outbox.ask_check(self._known(request), session.name)
        return JSONResponse({})

    async def _allowed(self, request: Request, role: Role) -> Session:
        """Give the session of who asks; refuse who is not logged in, may not, or was sent by another page."""
        _same_origin(request)
        session = self._users.session(request.cookies.get(_COOKIE))
        if session is None:
            raise RefusedError(401, "log in first")
        told = request.headers.get("X-CSRF-Token", "")
        if not secrets.compare_digest(told.encode(), session.csrf.encode()):
            raise RefusedError(403, "the request does not come from this page")
        if MAY[session.role] < MAY[role]:
            raise RefusedError(403, f"{session.role}s may not do this, {role}s may")
        return session

    def _known(self, request: Request) -> str:
        name = str(request.path_params["station"])
        if name not in self._stations:
            raise RefusedError(_UNKNOWN, "there is no such station")
        return name


def _same_origin(request: Request) -> None:
    origin = request.headers.get("Origin")
    if origin is not None and origin.partition("://")[2] != request.headers.get("Host"):
        raise RefusedError(403, "the request comes from another page")


async def _body(request: Request) -> dict[str, Any]:
    if request.headers.get("Content-Type", "").partition(";")[0] != "application/json":
        raise RefusedError(415, "expected application/json")
    content = b""
    try:
        async with asyncio.timeout(_BODY_S):
            async for part in request.stream():
                content += part
                if len(content) > _BODY_MAX:
                    raise RefusedError(413, f"at most {_BODY_MAX} bytes are read")
    except TimeoutError as error:
        raise RefusedError(408, f"the body did not come within {_BODY_S:g} s") from error
    try:
        found = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise RefusedError(_MISFIT, "the body is not JSON") from error
    if not isinstance(found, dict):
        raise RefusedError(_MISFIT, "the body is no object")
    return found


def _jpeg_of(path: Path) -> bytes:
    try:
        return jpeg_of(Frame(decoded(path)))
    except DataError as error:
        raise RefusedError(_UNKNOWN, "this picture is not kept any more") from error


def _refused(_: Request, error: Exception) -> Response:
    status = error.status if isinstance(error, RefusedError) else 503
    return JSONResponse({"said": str(error)}, status)


class _Headers:
    """Adds the headers that keep other pages out to every answer."""

    def __init__(self, app: Callable[..., Awaitable[None]]) -> None:
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                added = [(name.lower().encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *added]
            await send(message)

        await self._app(scope, receive, with_headers)
