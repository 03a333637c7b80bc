"""What is delivered arrives, in order, and again where it was not taken."""

from __future__ import annotations

import hashlib
import hmac
import json
import math
import os
import queue
import shutil
import socket
import struct
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from roemetry.errors import OutputError
from roemetry_line.outlets.acknowledged_lines import Serial, SerialOptions, Tcp, TcpOptions
from roemetry_line.outlets.database import Database, DatabaseOptions, connect
from roemetry_line.outlets.modbus import Modbus, ModbusOptions, Registers, answered
from roemetry_line.outlets.webhook import Webhook, WebhookOptions
from tests.plugins.line.loopback import free_port, keys, row, wait_for


@pytest.mark.parametrize("content", ["summary", "all"])
def test_tcp_waits_for_each_answer_and_tells_of_a_receiver_that_hangs_up(receiver, content) -> None:
    options = TcpOptions(port=receiver.port, content=content)
    with Tcp(options).open() as deliver:
        deliver([row(1), row(2)])
        deliver([row(3)])
    assert receiver.keys == keys(1, 2, 3)
    assert ("station" in receiver.got[0]) == (content == "all")
    receiver.limit = 5
    with pytest.raises(OutputError, match=f"127.0.0.1:{receiver.port}"), Tcp(options).open() as deliver:
        deliver([row(4), row(5), row(6)])
    with Tcp(options).open() as deliver:
        deliver([row(4), row(5), row(6)])
    assert receiver.keys == keys(1, 2, 3, 4, 5, 4, 5, 6)


@pytest.fixture
def serial():
    """A serial line with a receiver at its other end; gives the device, what came, and how it answers."""
    import pty
    import tty

    ours, theirs = pty.openpty()
    tty.setraw(ours)
    got: list[str] = []
    answers = ["ok {}"]

    def serve() -> None:
        with os.fdopen(ours, "r+b", buffering=0) as line:
            rest = b""
            try:
                while True:
                    rest += line.read(4096)
                    *whole, rest = rest.split(b"\n")
                    for text in whole:
                        got.append(json.loads(text)["key"])
                        line.write(answers[0].format(got[-1]).encode() + b"\r\n" if answers[0] else b"")
            except OSError:
                return

    threading.Thread(target=serve, daemon=True).start()
    yield os.ttyname(theirs), got, answers
    os.close(theirs)


def test_a_serial_line_waits_for_each_answer(serial, tmp_path) -> None:
    device, got, answers = serial
    with Serial(SerialOptions(device=device, timeout_s=0.2, content="all")).open() as deliver:
        deliver([row(n, lane="left" * 500) for n in (1, 2, 3)])
        answers[0] = ""
        with pytest.raises(OutputError, match=f"{device}: no answer in time"):
            deliver([row(4)])
        answers[0] = "ok another"
        with pytest.raises(OutputError, match=r"answered 'ok another', expected 'ok l/r/000005#1'"):
            deliver([row(5)])
    assert got == keys(1, 2, 3, 4, 5)
    (tmp_path / "file").write_text("")
    none = Serial(SerialOptions(device=str(tmp_path / "file")))
    with pytest.raises(OutputError, match="file: "), none.open():
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
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    (tmp_path / "secret").write_text("key\n")
    url = f"http://127.0.0.1:{server.server_port}/rows"
    with Webhook(WebhookOptions(url=url, secret_file=tmp_path / "secret")).open() as deliver:
        deliver([row(1), row(2)])
        status[0] = 500
        with pytest.raises(OutputError, match="500"):
            deliver([row(3)])
    server.shutdown()
    server.server_close()
    signature, body = got[1]
    assert signature == hmac.new(b"key", body, hashlib.sha256).hexdigest()
    assert [one["summary"]["mass_g"] for one in json.loads(body)] == [21.0, 22.0]


def test_a_database_keeps_each_row_once_and_forgets_old_ones(tmp_path) -> None:
    url = f"sqlite:{tmp_path / 'h.sqlite'}"
    for numbers in ((1, 2, 3), (2, 3, 4)):
        with Database(DatabaseOptions(url=url)).open() as deliver:
            deliver([row(n, **({"mass_g": None} if n == 2 else {})) for n in numbers])
    table = connect(url)
    found = table.ask(
        "select line, run, id, mass_g, station, time_s, latency_ms from roemetry_rows order by id"
    )
    masses = [21.0, None, 23.0, 24.0]
    assert found == [("l", "r", f"{n:06d}#1", masses[n - 1], "s", 1000.0 + n, 3.5) for n in (1, 2, 3, 4)]
    table.forget("another", 1003.0)
    table.forget("l", 1003.0)
    assert table.ask("select id from roemetry_rows order by id") == [("000003#1",), ("000004#1",)]


def test_modbus_registers_hold_the_last_results_newest_first() -> None:
    options = ModbusOptions(port=0, classes=("good", "dent"), lanes=("left", "right"))
    registers = Registers()
    told = {"grade": "dent", "lane": "left", "x_mm": -12.34, "height_mm": 11.956}
    Modbus(options)._show(registers, [row(n, gate_count=70_000 + n, **told) for n in range(1, 11)])
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
        given = row(n, encoder_count=float(encoder), gate_count=gate, grade=grade, lane="left")
        outlet._show(registers, [given])
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
        wait_for(lambda: plc.read_input_registers(0, count=1).registers[0] != before, "no heartbeat", 0.25)
        plc.close()


class Operator:
    """Keeps what an outlet warns of."""

    def __init__(self) -> None:
        self.told: queue.Queue[str | None] = queue.Queue()
        self.warn = self.told.put

    def told_within(self, seconds: float) -> str | None:
        return self.told.get(timeout=seconds)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_mqtt_survives_its_broker(tmp_path) -> None:
    pytest.importorskip("paho", reason="the extra line has paho-mqtt")
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if program is None:
        pytest.skip("no mosquitto: apt install mosquitto")
    from paho.mqtt import client as paho

    from roemetry_line.outlets.mqtt import Mqtt, MqttOptions

    port = free_port()
    (tmp_path / "m.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")

    def listens() -> bool:
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", port)) == 0

    def broker() -> subprocess.Popen:
        started = subprocess.Popen([program, "-c", str(tmp_path / "m.conf")], stderr=subprocess.DEVNULL)
        wait_for(listens, "mosquitto does not start", 5.0)
        return started

    got: list[str] = []
    goes_on, subscribed = threading.Event(), threading.Event()
    goes_on.set()
    running = broker()
    outlet = Mqtt(MqttOptions(port=port, topic="t", timeout_s=2.0, consumers=["sub"]))
    outlet.line = operator = Operator()
    subscriber = paho.Client(paho.CallbackAPIVersion.VERSION2, "sub", clean_session=False)
    subscriber.on_connect = lambda client, *_: client.subscribe("t/products", qos=1)
    subscriber.on_subscribe = lambda *_: subscribed.set()

    def take(client: paho.Client, _data: object, message: paho.MQTTMessage) -> None:
        goes_on.wait()
        got.append(json.loads(message.payload)["key"])
        client.publish("t/taken/sub", got[-1], qos=1)

    subscriber.on_message = take
    subscriber.reconnect_delay_set(1, 1)
    subscriber.connect("127.0.0.1", port, keepalive=5)
    subscriber.loop_start()
    try:
        assert subscribed.wait(5.0)
        with outlet.open() as deliver:
            deliver([row(1), row(2)])
            wait_for(lambda: len(got) == 2, "two rows do not come", 2.5)
            assert operator.told_within(1.0) is None
            goes_on.clear()
            deliver([row(3)])  # the broker takes it, whoever is behind it
            assert operator.told_within(2.8) == "consumers that confirm no products: sub"
            goes_on.set()
            assert operator.told_within(1.0) is None
            subscribed.clear()
            running.kill()
            running.wait()
            with pytest.raises(OutputError, match=str(port)):
                deliver([row(4)])
        with pytest.raises(OutputError, match=str(port)), outlet.open():
            pass
        running = broker()
        assert subscribed.wait(5.0), "the subscriber does not come back"
        with outlet.open() as deliver:
            deliver([row(4), row(5)])
        wait_for(lambda: len(set(got)) == 5, "what was not taken is not told again", 3.0)
    finally:
        goes_on.set()
        subscriber.loop_stop()
        running.kill()
        running.wait()
    assert list(dict.fromkeys(got)) == keys(1, 2, 3, 4, 5)
