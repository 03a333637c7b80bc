"""The page's server: one process, this machine only, nothing from elsewhere."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError

from roemetry.errors import ConfigurationError, RoemetryError
from roemetry_tools.tune.request import TuneRequest
from roemetry_tools.tune.session import Session

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

LOOPBACK = "127.0.0.1"
_PAGE = Path(__file__).parent / "page"
_LARGEST_REQUEST = 1_000_000
"""Bytes; a whole recipe has some thousand."""

_HEADERS = {
    # The page may load nothing that this process does not serve, and no other page may hold it in a frame.
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class SaveRequest(BaseModel):
    """What to save, and under which name."""

    wish: TuneRequest
    name: str = ""


def app_of(session: Session, token: str = "") -> Starlette:
    """Make the application for one recipe.

    - `token`: First part of every address: what does not know it is answered with 404. Empty: there is none.
    """
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.responses import JSONResponse, Response
    from starlette.routing import Mount, Route
    from starlette.staticfiles import StaticFiles

    def page(_: Request) -> Response:
        text = (_PAGE / "index.html").read_text(encoding="utf-8")
        return Response(text, media_type="text/html", headers=_HEADERS)

    def recipe(_: Request) -> Response:
        return JSONResponse(session.recipe(), headers=_HEADERS)

    def picture(request: Request) -> Response:
        """Give a kept picture by its key, or 404 with a word of why."""
        found = session.picture(request.path_params["key"])
        if found is None:
            return JSONResponse({"said": "this picture is not kept any more"}, 404, headers=_HEADERS)
        kept = {**_HEADERS, "Cache-Control": "private, max-age=3600, immutable"}  # its name is its hash
        return Response(found, media_type="image/png", headers=kept)

    async def answer(request: Request) -> Response:
        wish = await _read(request, TuneRequest)
        data = await run_in_threadpool(session.answer, wish)
        return Response(data, media_type="application/octet-stream", headers=_HEADERS)

    async def save(request: Request) -> Response:
        given = await _read(request, SaveRequest)
        saved = await run_in_threadpool(session.save, given.wish, given.name)
        return JSONResponse(saved, headers=_HEADERS)

    def refused(_: Request, error: Exception) -> Response:
        return JSONResponse({"said": str(error)}, 403 if str(error) == _FOREIGN else 400, headers=_HEADERS)

    routes = [
        Route("/", page),
        Route("/recipe", recipe),
        Route("/picture/{key}.png", picture),
        Route("/answer", answer, methods=["POST"]),
        Route("/save", save, methods=["POST"]),
        Mount("/page", StaticFiles(directory=_PAGE)),
    ]
    return Starlette(
        routes=[Mount(f"/{token}", routes=routes)] if token else routes,
        # A page of another site can send requests here under a name of its own (DNS rebinding).
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[LOOPBACK, "localhost"])],
        exception_handlers={RoemetryError: refused},
    )


def serve(session: Session, port: int, on_ready: Callable[[str], None]) -> None:
    """Serve the page until the user stops it.

    - `port`: 0: any that is free.
    - `on_ready`: Called with the page's address once it can be opened.

    Raises
    ------
    ConfigurationError
        The port is taken.
    """
    token = secrets.token_urlsafe(16)  # 128 bits: other users of this machine reach the port, too
    app = app_of(session, token)
    import uvicorn

    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK, port))
        except OSError as error:
            raise ConfigurationError(
                f"--port {port}: cannot be used: {error.strerror or error}",
                hint="leave --port out to take any that is free",
            ) from error
        listening.listen()
        on_ready(f"http://{LOOPBACK}:{listening.getsockname()[1]}/{token}/")
        config = uvicorn.Config(app, log_level="warning", access_log=False, lifespan="off")
        uvicorn.Server(config).run(sockets=[listening])


_FOREIGN = "asked by a page that is not this server's"


async def _read(request: Request, model: type[Any]) -> Any:
    """Read a request's body.

    A page of another site cannot send this content type without asking first, and nobody answers it; where a
    browser says which site asks, it must be this one.
    """
    origin = request.headers.get("origin")
    if origin is not None and origin != f"http://{request.headers.get('host', '')}":
        raise RoemetryError(_FOREIGN)
    kind = request.headers.get("content-type", "").partition(";")[0].strip()
    if kind != "application/json":
        raise RoemetryError("expected content of the type application/json")
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST_REQUEST:
            raise RoemetryError(f"more than {_LARGEST_REQUEST} bytes were sent")
    try:
        return model.model_validate_json(bytes(body))
    except ValidationError as error:
        first = error.errors()[0]
        raise RoemetryError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
