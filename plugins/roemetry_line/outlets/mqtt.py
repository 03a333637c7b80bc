"""Messages to an MQTT broker with quality of service 1: the broker has told that it has each of them."""

from __future__ import annotations

import json
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineControl, LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions

_LOOK_S = 0.25  # between two looks at who is behind
_BEHIND_S = 2.0  # a consumer that has not confirmed for longer is behind
_KEPT = 10_000
"""Products that are remembered while they are not confirmed: a consumer is behind long before."""


class Consumers:
    """What each of some consumers has still to confirm."""

    def __init__(self, names: Sequence[str]) -> None:
        self._waiting: dict[str, dict[str, float]] = {name: {} for name in names}
        self._lock = threading.Lock()

    def sent(self, key: str) -> None:
        """Note that a product goes out."""
        with self._lock:
            for waiting in self._waiting.values():
                waiting.setdefault(key, time.monotonic())
                if len(waiting) > _KEPT:
                    del waiting[next(iter(waiting))]

    def taken(self, name: str, key: str) -> None:
        """Note that a consumer has this product, and so all before it."""
        with self._lock:
            waiting = self._waiting.get(name, {})
            if key in waiting:
                before = list(waiting)
                for one in before[: before.index(key) + 1]:
                    del waiting[one]

    def behind(self) -> str | None:
        """Name those who are behind; None where there are none."""
        with self._lock:
            now = time.monotonic()
            found = [
                name for name, waiting in self._waiting.items()
                if waiting and now - next(iter(waiting.values())) > _BEHIND_S
            ]  # fmt: skip
        return f"consumers that confirm no products: {', '.join(found)}" if found else None

    @contextmanager
    def watched(self, line: LineControl | None) -> Iterator[None]:
        """Tell the operator who is behind, while the block runs."""
        if line is None or not self._waiting:
            yield
            return
        over = threading.Event()
        watching = threading.Thread(target=self._watch, args=(line, over), daemon=True)
        watching.start()
        try:
            yield
        finally:
            over.set()
            watching.join()

    def _watch(self, line: LineControl, over: threading.Event) -> None:
        told: str | None = ""
        while not over.wait(_LOOK_S):
            said = self.behind()
            if said != told:
                with suppress(OutputError):  # the disk is full: it is tried again
                    line.warn(said)
                    told = said


class MqttOptions(StageOptions):
    """Which broker, under which topic."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the broker's address")
    port: int = Field(default=1883, ge=1, le=65535, description="the broker's port; by TLS usually 8883")
    topic: str = Field(
        default="roemetry",
        pattern="^[^#+]+$",
        description="rows go to TOPIC/products and TOPIC/notices; TOPIC/online says 1 or, by the broker's "
        "last will, 0",
    )
    client_id: str = Field(default="", description="the client's name; empty: the broker gives one")
    content: Literal["summary", "all"] = Field(
        default="all", description="`summary`: a few numbers, `all`: the whole row"
    )
    username: str = Field(default="", description="user; empty: none")
    password_file: Path | None = Field(default=None, description="file that holds the password; none: none")
    ca_file: Path | None = Field(
        default=None, description="certificate of the authority that signed the broker's; none: no TLS"
    )
    consumers: tuple[Annotated[str, Field(pattern=r"^[\w-]+$")], ...] = Field(
        default=(),
        description="consumers that confirm: each publishes the key of a product that it has taken to "
        "TOPIC/taken/NAME; the operator is told of who has not for 2 s. Empty: nobody is watched",
    )
    timeout_s: float = Field(default=5.0, gt=0, le=60, description="how long an answer may take, s")


class Mqtt(Outlet[MqttOptions]):
    """Publishes each row and waits until the broker has acknowledged it."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:mqtt")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Connect; OutputError where there is no broker or it refuses."""
        from paho.mqtt import client as paho

        session = _Session()
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, self.options.client_id)
        client.on_connect = session.connected
        client.on_disconnect = session.disconnected
        client.on_publish = session.published
        if self.options.username:
            file = self.options.password_file
            client.username_pw_set(
                self.options.username, None if file is None else file.read_text("utf-8").strip()
            )
        if self.options.ca_file is not None:
            client.tls_set(str(self.options.ca_file), tls_version=ssl.PROTOCOL_TLS_CLIENT)
        client.will_set(f"{self.options.topic}/online", "0", qos=1, retain=True)
        client.max_inflight_messages_set(100)
        client.connect_timeout = self.options.timeout_s
        try:
            client.connect(self.options.host, self.options.port, keepalive=10)
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise self._unreachable(why) from error
        client.loop_start()
        try:
            self._wait(session, lambda: session.is_connected or session.refused)
            if session.refused:
                raise self._unreachable(f"the broker refuses: {session.refused}")
            client.publish(f"{self.options.topic}/online", "1", qos=1, retain=True)
            consumers = Consumers(self.options.consumers)
            confirmed = f"{self.options.topic}/taken/"
            client.message_callback_add(
                f"{confirmed}+",
                lambda _client, _data, message: consumers.taken(
                    message.topic.removeprefix(confirmed), message.payload.decode("utf-8", "replace")
                ),
            )
            if self.options.consumers:
                client.subscribe(f"{confirmed}+", qos=1)
            with consumers.watched(self.line):
                yield lambda rows: self._deliver(client, session, consumers, rows)
            with suppress(RuntimeError, ValueError):  # the connection is gone: the last will says it
                client.publish(f"{self.options.topic}/online", "0", qos=1, retain=True).wait_for_publish(1.0)
        finally:
            client.disconnect()
            client.loop_stop()

    def _deliver(self, client: Any, session: _Session, consumers: Consumers, rows: Sequence[LineRow]) -> None:
        waiting = set()
        for row in rows:
            topic = f"{self.options.topic}/{row.kind}s"
            sent = client.publish(topic, _payload(row, self.options.content), qos=1)
            if sent.rc != 0:
                raise self._unreachable("the connection is lost")
            waiting.add(sent.mid)
            if row.kind == "product":
                consumers.sent(row.key)
        self._wait(session, lambda: session.lost or waiting <= session.acknowledged)
        if session.lost:
            raise self._unreachable("the connection is lost")
        session.acknowledged -= waiting

    def _wait(self, session: _Session, until: Callable[[], Any]) -> None:
        with session.changed:
            if not session.changed.wait_for(until, self.options.timeout_s):
                raise self._unreachable(f"no answer within {self.options.timeout_s:g} s")

    def _unreachable(self, why: str) -> OutputError:
        return OutputError(
            f"MQTT broker {self.options.host}:{self.options.port}: {why}",
            hint="does it run and let this user in?",
        )


class _Session:
    """What the client's thread has been told, for who waits for it."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.is_connected = self.lost = False
        self.refused = ""
        self.acknowledged: set[int] = set()

    def connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self.changed:
            self.is_connected, self.refused = not reason.is_failure, str(reason) if reason.is_failure else ""
            self.changed.notify_all()

    def disconnected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self.changed:
            self.lost = self.is_connected
            self.changed.notify_all()

    def published(self, client: Any, userdata: Any, mid: int, reason: Any, properties: Any) -> None:
        with self.changed:
            self.acknowledged.add(mid)
            self.changed.notify_all()


def _payload(row: LineRow, content: str) -> str:
    if content == "all":
        return f'{{"key": {json.dumps(row.key)}, {row.text[1:]}'
    return json.dumps({"key": row.key, "kind": row.kind, **row.summary}, ensure_ascii=False)
