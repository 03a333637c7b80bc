"""What is delivered arrives, in order, and again where it was not taken."""

from __future__ import annotations

import json
import math
import queue
import shutil
import socket
import struct
import subprocess
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry_line.outlets.database import Database, DatabaseOptions, connect
from roemetry_line.outlets.modbus import Modbus, ModbusOptions, Registers, answered
from roemetry_line.outlets.serial import Serial, SerialOptions
from roemetry_line.outlets.tcp import Tcp, TcpOptions
from roemetry_line.outlets.webhook import Webhook, WebhookOptions


def row(number: int, **summary) -> LineRow:
    told = {"id": f"{number:06d}#1", "status": "measured", "mass_g": 20.0 + number, **summary}
    text = {"station": "s", "kind": "product", "taken": {"time_s": 1000.0 + number}, "latency_ms": 3.5}
    return LineRow(number, f"l/r/{number:06d}#1", "product", told, json.dumps(text))


@pytest.fixture
def receiver():
    """A TCP receiver that says ok to so many lines, then hangs up; gives its port and what it has got."""
    got: list[dict] = []
    server = socket.create_server(("127.0.0.1", 0))
    limits = [10**9]

    def serve() -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            with connection, connection.makefile("rb") as lines:
                for line in lines:
                    got.append(json.loads(line))
                    if len(got) >= limits[0]:
                        limits[0] = 10**9
                        break
                    connection.sendall(f"ok {got[-1]['key']}\n".encode())

    threading.Thread(target=serve, daemon=True).start()
    yield server.getsockname()[1], got, limits
    server.close()


@pytest.mark.parametrize("content", ["summary", "all"])
def test_tcp_waits_for_each_answer(receiver, content) -> None:
    port, got, _ = receiver
    with Tcp(TcpOptions(port=port, content=content)).open() as deliver:
        deliver([row(1), row(2)])
        deliver([row(3)])
    assert [one["key"] for one in got] == ["l/r/000001#1", "l/r/000002#1", "l/r/000003#1"]
    assert ("station" in got[0]) == (content == "all")


def test_tcp_tells_of_a_receiver_that_hangs_up(receiver) -> None:
    port, got, limits = receiver
    limits[0] = 2
    with pytest.raises(OutputError, match=f"127.0.0.1:{port}"), Tcp(TcpOptions(port=port)).open() as deliver:
        deliver([row(1), row(2), row(3)])
    with Tcp(TcpOptions(port=port)).open() as deliver:
        deliver([row(1), row(2), row(3)])
    assert {one["key"] for one in got} == {f"l/r/00000{n}#1" for n in (1, 2, 3)}


@pytest.fixture
def serial():
    """A serial line with a receiver at its other end; gives the device, what came, and how it answers."""
    import os
    import pty
    import tty

    ours, theirs = pty.openpty()
    tty.setraw(ours)
    got: list[dict] = []
    answers = ["ok {}"]

    def serve() -> None:
        with os.fdopen(ours, "r+b", buffering=0) as line:
            rest = b""
            try:
                while True:
                    rest += line.read(4096)
                    *whole, rest = rest.split(b"\n")
                    for text in whole:
                        got.append(json.loads(text))
                        line.write(
                            answers[0].format(got[-1]["key"]).encode() + b"\r\n" if answers[0] else b""
                        )
            except OSError:
                return

    threading.Thread(target=serve, daemon=True).start()
    yield os.ttyname(theirs), got, answers
    os.close(theirs)


def test_a_serial_line_waits_for_each_answer(serial) -> None:
    device, got, answers = serial
    with Serial(SerialOptions(device=device, timeout_s=0.2, content="all")).open() as deliver:
        deliver([row(n, lane="left" * 500) for n in (1, 2, 3)])
        answers[0] = ""
        with pytest.raises(OutputError, match=f"{device}: no answer in time"):
            deliver([row(4)])
        answers[0] = "ok another"
        with pytest.raises(OutputError, match=r"answered 'ok another', expected 'ok l/r/000005#1'"):
            deliver([row(5)])
    assert [one["key"] for one in got] == [f"l/r/00000{n}#1" for n in (1, 2, 3, 4, 5)]


def test_what_is_no_serial_line_is_refused(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(OutputError, match="file: "),
        Serial(SerialOptions(device=str(tmp_path / "file"))).open(),
    ):
        pass


def test_a_webhook_signs_and_takes_200_only(tmp_path) -> None:
    got, status = [], [200]

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            got.append((self.headers["X-Roemetry-Signature"], body))
            self.send_response(status[0])
            self.end_headers()

        def log_message(self, *_) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    (tmp_path / "secret").write_text("key\n")
    url = f"http://127.0.0.1:{server.server_port}/rows"
    with Webhook(WebhookOptions(url=url, secret_file=tmp_path / "secret")).open() as deliver:
        deliver([row(1), row(2)])
        status[0] = 500
        with pytest.raises(OutputError, match="500"):
            deliver([row(3)])
    server.shutdown()
    server.server_close()
    import hashlib
    import hmac

    signature, body = got[1]
    assert signature == hmac.new(b"key", body, hashlib.sha256).hexdigest()
    assert [one["summary"]["mass_g"] for one in json.loads(body)] == [21.0, 22.0]


def test_a_database_keeps_each_row_once(tmp_path) -> None:
    url = f"sqlite:{tmp_path / 'h.sqlite'}"
    for _ in range(2):
        with Database(DatabaseOptions(url=url)).open() as deliver:
            deliver([row(1), row(2, mass_g=None)])
    found = connect(url).ask("select line, run, id, mass_g, station, time_s from roemetry_rows order by id")
    assert found == [("l", "r", "000001#1", 21.0, "s", 1001.0), ("l", "r", "000002#1", None, "s", 1002.0)]


def test_old_rows_are_forgotten(tmp_path) -> None:
    table = connect(f"sqlite:{tmp_path / 'h.sqlite'}")
    from roemetry_line.outlets import database

    table.insert([database._values(row(n)) for n in (1, 2, 3)])
    table.insert([database._values(row(n)) for n in (2, 3, 4)])
    found = table.ask("select id, mass_g, latency_ms from roemetry_rows order by id")
    assert found == [(f"{n:06d}#1", 20.0 + n, 3.5) for n in (1, 2, 3, 4)]
    table.forget("another", 1003.0)
    table.forget("l", 1003.0)
    assert table.ask("select count(*) from roemetry_rows") == [(2,)]


def test_modbus_registers_hold_the_last_results_newest_first() -> None:
    options = ModbusOptions(port=0, classes=("good", "dent"), lanes=("left", "right"))
    registers = Registers()
    outlet = Modbus(options)
    told = {"grade": "dent", "lane": "left", "x_mm": -12.34, "height_mm": 11.956}
    outlet._show(registers, [row(n, gate_count=70_000 + n, **told) for n in range(1, 11)])
    values = registers.read(0, 144)
    assert values is not None
    assert values[1] == 10
    assert [values[16 + 16 * k] for k in range(8)] == [10, 9, 8, 7, 6, 5, 4, 3]
    packed = struct.pack(">16H", *values[16:32])
    *words, x, y, height, mass, volume, count = struct.unpack(">5HhhhffI", packed[:28])
    assert words == [10, 1, 2, 1, 0], "number, status, class, lane, late"
    assert (x, y, height, count) == (-123, -0x8000, 1196, 70_010)
    assert mass == pytest.approx(30.0)
    assert math.isnan(volume)


@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        (struct.pack(">BHH", 3, 177, 1), b"\x03\x02\x00\x00"),
        (struct.pack(">BHH", 3, 177, 2), b"\x83\x02"),
        (struct.pack(">BHH", 3, 0, 126), b"\x83\x03"),
        (struct.pack(">BHH", 6, 2, 7), struct.pack(">BHH", 6, 2, 7)),
        (struct.pack(">BHH", 6, 3, 7), b"\x86\x02"),
        (struct.pack(">BHHBH", 16, 2, 1, 2, 7), struct.pack(">BHH", 16, 2, 1)),
        (struct.pack(">BHHBH", 16, 2, 1, 3, 7), b"\x90\x03"),
        (b"\x2b\x0e", b"\xab\x01"),
        (b"\x03\x00", b"\x83\x03"),
    ],
)
def test_modbus_answers_as_the_protocol_says(request_bytes, answer) -> None:
    assert answered(Registers(), request_bytes) == answer


def test_modbus_waits_for_the_handshake() -> None:
    outlet = Modbus(ModbusOptions(port=0, handshake=True, timeout_s=0.05))
    registers = Registers()
    with pytest.raises(OutputError, match="register 2"):
        outlet._show(registers, [row(1)])
    registers.write(2, [1])
    outlet._show(registers, [row(1)])
    values = registers.read(16, 32)
    assert values is not None
    assert (values[0], values[16]) == (1, 0), "a row that is delivered again stays one result"


def test_modbus_shifts_products_towards_the_gate() -> None:
    outlet = Modbus(ModbusOptions(port=0, classes=("good", "dent"), lanes=("left",), encoder_bits=20))
    registers = Registers()
    end = 1 << 20  # the counter wraps between camera and gate
    told = ((end - 500, 200, "good"), (end - 400, 300, "dent"), (end - 300, 250, "good"), (150, 100, "dent"))
    for n, (encoder, gate, grade) in enumerate(told, start=1):
        outlet._show(
            registers, [row(n, encoder_count=float(encoder), gate_count=gate, grade=grade, lane="left")]
        )
    values = registers.read(144, 14)
    assert values is not None
    assert values[:2] == [3, 1], "on their way, and told after the gate"
    assert values[2:] == [0, 200, 1, 1, 0, 250, 1, 1, 0, 300, 2, 1]
    outlet._show(registers, [row(5, status="frames-lost", encoder_count=260.0)])
    assert registers.read(144, 6) == [1, 1, 0, 300, 2, 1], "two have passed the gate"


def test_modbus_is_understood_by_another_implementation() -> None:
    client = pytest.importorskip("pymodbus.client", reason="the extra test has pymodbus")
    port = free_port()
    with Modbus(ModbusOptions(port=port)).open() as deliver:
        deliver([row(7)])
        plc = client.ModbusTcpClient("127.0.0.1", port=port, timeout=3)
        assert plc.connect()
        assert plc.read_holding_registers(1, count=1).registers == [7]
        assert plc.write_register(2, 7).isError() is False
        assert plc.write_register(5, 7).isError()
        before = plc.read_input_registers(0, count=1).registers[0]
        time.sleep(0.25)
        assert plc.read_input_registers(0, count=1).registers[0] != before, "the heartbeat stands still"
        plc.close()


class Operator:
    """Keeps what an outlet warns of."""

    def __init__(self) -> None:
        self.told: queue.Queue[str | None] = queue.Queue()

    def warn(self, text: str | None) -> None:
        self.told.put(text)

    def told_within(self, seconds: float) -> str | None:
        return self.told.get(timeout=seconds)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_mqtt_survives_its_broker(tmp_path) -> None:
    pytest.importorskip("paho", reason="the extra line has paho-mqtt")
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if program is None:
        pytest.skip("no mosquitto: apt install mosquitto")
    from roemetry_line.outlets.mqtt import Mqtt, MqttOptions

    port = free_port()
    (tmp_path / "m.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")

    def broker() -> subprocess.Popen:
        started = subprocess.Popen([program, "-c", str(tmp_path / "m.conf")], stderr=subprocess.DEVNULL)
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                return started
            except OSError:
                time.sleep(0.05)
        raise AssertionError("mosquitto does not start")

    from paho.mqtt import client as paho

    got: list[str] = []
    stuck = threading.Event()
    running = broker()
    outlet = Mqtt(MqttOptions(port=port, topic="t", timeout_s=2.0, consumers=["sub"]))
    outlet.line = operator = Operator()
    subscriber = paho.Client(paho.CallbackAPIVersion.VERSION2, "sub", clean_session=False)
    subscriber.on_connect = lambda client, *_: client.subscribe("t/products", qos=1)

    def take(client: paho.Client, _data: object, message: paho.MQTTMessage) -> None:
        while stuck.is_set():
            time.sleep(0.05)
        got.append(json.loads(message.payload)["key"])
        client.publish("t/taken/sub", got[-1], qos=1)

    subscriber.on_message = take
    subscriber.reconnect_delay_set(1, 1)
    subscriber.connect("127.0.0.1", port, keepalive=5)
    subscriber.loop_start()
    try:
        time.sleep(0.3)
        with outlet.open() as deliver:
            deliver([row(1), row(2)])
            for _ in range(50):
                if len(got) == 2:
                    break
                time.sleep(0.05)
            assert operator.told_within(1.0) is None
            stuck.set()
            deliver([row(3)])  # the broker takes it, whoever is behind it
            assert operator.told_within(2.8) == "consumers that confirm no products: sub"
            stuck.clear()
            assert operator.told_within(1.0) is None
            running.kill()
            running.wait()
            with pytest.raises(OutputError, match=str(port)):
                deliver([row(4)])
        with pytest.raises(OutputError, match=str(port)), outlet.open():
            pass
        running = broker()
        time.sleep(1.5)  # the subscriber is back
        with outlet.open() as deliver:
            deliver([row(4), row(5)])
        for _ in range(60):
            if len(set(got)) == 5:
                break
            time.sleep(0.05)
    finally:
        subscriber.loop_stop()
        running.kill()
        running.wait()
    assert list(dict.fromkeys(got)) == [f"l/r/00000{n}#1" for n in (1, 2, 3, 4, 5)]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return listening.getsockname()[1]
