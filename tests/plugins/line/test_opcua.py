"""Results by OPC UA, to a real client on loopback."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from roemetry.errors import OutputError
from roemetry_line.outlets.opcua import OpcUa, OpcUaOptions
from tests.plugins.line.loopback import free_port, keys, row

asyncua = pytest.importorskip("asyncua", reason="the extra line has asyncua")
from asyncua import Client, ua  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")
VISION = "http://opcfoundation.org/UA/MachineVision"


@pytest.fixture(autouse=True)
def quiet() -> None:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)


def ran(told: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine in a thread of its own: another test may have left a loop running in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, told).result()


async def until(condition) -> None:
    for _ in range(200):
        if condition():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it does not come")


async def said(call) -> Any:
    """Give the answer, or the name of what a client is told in its place."""
    try:
        return await call
    except ua.UaStatusCodeError as error:
        return type(error).__name__


class Desk:
    """A line with two recipes, whose state a test says."""

    def __init__(self) -> None:
        self.now = "running"
        self.chosen: list[tuple[str, str, str]] = []
        self.warned: list[str | None] = []

    def state(self):
        return self.now

    def recipes(self):
        return {"one": ["/r/roe/recipe.yaml", "/r/cod/recipe.yaml"]}

    def choose(self, station, recipe, who):
        self.chosen.append((station, recipe, who))
        return True

    def warn(self, text):
        self.warned.append(text)


class Session:
    """What a client sees of the line: its places, and the events since it subscribed."""

    def __init__(self, client) -> None:
        self.client, self.events = client, []

    def event_notification(self, event) -> None:
        self.events.append(event)

    async def begin(self):
        await self.client.load_data_type_definitions()
        self.vision = await self.client.get_namespace_index(VISION)
        self.own = await self.client.get_namespace_index("urn:roemetry:line")
        self.system = self.client.get_node(ua.NodeId("VisionSystem", self.own))
        self.machine = await self.system.get_child([f"{self.vision}:VisionStateMachine"])
        self.state = await self.machine.get_child(["0:CurrentState"])
        return self

    async def subscribe(self) -> None:
        subscription = await self.client.create_subscription(20, self)
        kind = self.client.get_node(ua.NodeId(1024, self.vision))
        await subscription.subscribe_events(self.system, kind)

    async def managed(self) -> dict[str, Any]:
        """List the recipes, ask for one, and for what is not there."""
        management = await self.system.get_child([f"{self.vision}:RecipeManagement"])
        counts = [ua.Variant(n, ua.VariantType.UInt32) for n in (0, 0)]
        state, timeout = (ua.Variant(n, ua.VariantType.Int32) for n in (2, 0))
        given = [ua.RecipeIdExternalDataType(), ua.ProductIdDataType(), state, *counts, timeout]
        listed = await management.call_method(f"{self.vision}:GetRecipeListFiltered", *given)
        found: dict[str, Any] = {"recipes": [one.Id for one in listed[3]]}
        for name in ("one/cod/recipe.yaml", "one/eel/recipe.yaml"):
            wanted = [ua.RecipeIdExternalDataType(Id=name), ua.RecipeIdInternalDataType()]
            found[name] = await said(management.call_method(f"{self.vision}:PrepareRecipe", *wanted))
        return found


async def followed(url: str, deliver, desk: Desk) -> None:
    """As somebody who only says that he is the administrator."""
    client = Client(url, timeout=10)
    client.set_user("admin")
    client.set_password("admin")
    async with client:
        one = await Session(client).begin()
        await one.subscribe()
        await asyncio.to_thread(deliver, [row(2), row(3, mass_g=None), row(4)])
        await until(lambda: len(one.events) == 3)
        assert [event.ResultId.Id for event in one.events] == keys(2, 3, 4)
        assert json.loads(one.events[0].ResultContent[0])["latency_ms"] == 3.5
        mass = client.get_node(ua.NodeId("LastResult.mass_g", one.own))
        assert await mass.read_value() == 24.0
        halt = [ua.Variant(0, ua.VariantType.Int32), ua.LocalizedText("why not")]
        assert await said(one.machine.call_method(f"{one.vision}:Halt", *halt)) == "BadNotSupported"
        for attempt in (
            mass.write_value(99.0),
            client.nodes.objects.add_object(one.own, "intruder"),
            one.state.write_value(ua.LocalizedText("Halted")),
        ):
            assert isinstance(await said(attempt), str)
        found = await one.managed()
        assert found["recipes"] == ["one/roe/recipe.yaml", "one/cod/recipe.yaml"]
        assert found["one/cod/recipe.yaml"] == "BadUserAccessDenied"
        assert desk.chosen == []
        for desk.now, expected in (("running", "Operational"), ("faulty", "Error")):
            for _ in range(40):
                if (shown := (await one.state.read_value()).Text) == expected:
                    break
                await asyncio.sleep(0.05)
            assert shown == expected


async def stuck(url: str, deliver, desk: Desk) -> list[str]:
    """Subscribe, ask for no events until the line is told of it, then ask again; give what came."""
    async with Client(url, timeout=5) as client:
        one = await Session(client).begin()
        await one.subscribe()
        client.uaclient._publish_task.cancel()
        for number in range(1, 6):
            await asyncio.to_thread(deliver, [row(number)])
            await asyncio.sleep(0.03)
        await until(lambda: desk.warned[-1] is not None)
        client.uaclient.session.ensure_publish_loop()
        await until(lambda: desk.warned[-1] is None and one.events[-1].MeasId.Id == "000005#1")
        return [event.MeasId.Id for event in one.events]


def test_a_client_follows_the_line_changes_nothing_and_is_told_of_where_it_sticks(monkeypatch) -> None:
    monkeypatch.setattr("roemetry_line.outlets.opcua._FOLLOW_S", 0.05)
    monkeypatch.setattr("roemetry_line.outlets.opcua._STUCK_S", 0.2)
    port = free_port()
    outlet, desk = OpcUa(OpcUaOptions(port=port)), Desk()
    outlet.line = desk
    with outlet.open() as deliver:
        deliver([row(1)])
        ran(followed(f"opc.tcp://127.0.0.1:{port}/roemetry", deliver, desk))
        told = ran(stuck(f"opc.tcp://127.0.0.1:{port}/roemetry", deliver, desk))
    assert told == [f"00000{n}#1" for n in range(1, 6)][-len(told) :], "what waited comes, in order"
    assert len(told) >= 3, "two answers were on their way when it stopped asking"
    assert desk.warned == [None, "clients that take no events: 127.0.0.1", None]


def test_only_trusted_clients_that_encrypt_get_in(tmp_path) -> None:
    from asyncua.crypto.cert_gen import setup_self_signed_certificate
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
    from cryptography.x509.oid import ExtendedKeyUsageOID

    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    trusted = tmp_path / "trusted"
    trusted.mkdir()

    async def certificates() -> None:
        for name in ("roemetry:line", "friend", "stranger"):
            key, folder = tmp_path / f"{name}.pem", trusted if name == "friend" else tmp_path
            certificate = folder / f"{name}.der"
            about = {"commonName": name}
            await setup_self_signed_certificate(key, certificate, f"urn:{name}", "127.0.0.1", usages, about)

    ran(certificates())
    port, server = free_port(), tmp_path / "roemetry:line.der"
    options = OpcUaOptions(
        port=port, certificate=server, private_key=server.with_suffix(".pem"), trusted=str(trusted)
    )

    async def gets_in(name: str | None) -> dict[str, Any] | None:
        client = Client(f"opc.tcp://127.0.0.1:{port}/roemetry", timeout=5)
        try:
            if name is not None:
                client.application_uri = f"urn:{name}"
                folder = trusted if name == "friend" else tmp_path
                own = {
                    "certificate": str(folder / f"{name}.der"),
                    "private_key": str(tmp_path / f"{name}.pem"),
                }
                policy = SecurityPolicyBasic256Sha256
                await client.set_security(policy, **own, server_certificate=str(server))
            async with client:
                return await (await Session(client).begin()).managed()
        except (ua.UaError, OSError, TimeoutError):  # however a client is turned away
            return None

    outlet, desk = OpcUa(options), Desk()
    outlet.line = desk
    with outlet.open():
        told = ran(gets_in("friend"))
        assert (told["one/cod/recipe.yaml"][1:], told["one/eel/recipe.yaml"]) == ([True, 0], "BadNotFound")
        assert desk.chosen == [("one", "/r/cod/recipe.yaml", "OPC UA")]
        assert not ran(gets_in("stranger"))
        assert not ran(gets_in(None))


def test_a_port_that_is_taken_is_told_before_anything_is_built(monkeypatch) -> None:
    async def built(*_: Any) -> None:
        raise AssertionError("the address space was built")

    monkeypatch.setattr(asyncua.Server, "init", built)
    with socket.create_server(("127.0.0.1", 0)) as other:
        outlet = OpcUa(OpcUaOptions(port=other.getsockname()[1]))
        with pytest.raises(OutputError, match="already in use"), outlet.open():
            pass
