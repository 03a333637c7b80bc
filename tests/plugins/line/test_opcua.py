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
from tests.plugins.line.test_outlets import free_port, row

asyncua = pytest.importorskip("asyncua", reason="the extra line has asyncua")
pytestmark = pytest.mark.filterwarnings("ignore")
VISION = "http://opcfoundation.org/UA/MachineVision"


def ran(told: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine in a thread of its own: another test may have left a loop running in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, told).result()


class Listener:
    def __init__(self) -> None:
        self.events: list = []

    def event_notification(self, event) -> None:
        self.events.append(event)


async def listened(url: str, tell) -> dict:
    """Subscribe, let rows be told, and give what the client has seen and what it was refused."""
    from asyncua import Client, ua

    found: dict = {}
    async with Client(url, timeout=10) as client:
        await client.load_data_type_definitions()
        vision = await client.get_namespace_index(VISION)
        own = await client.get_namespace_index("urn:roemetry:line")
        listener = Listener()
        subscription = await client.create_subscription(20, listener)
        system = client.get_node(ua.NodeId("VisionSystem", own))
        await subscription.subscribe_events(system, client.get_node(ua.NodeId(1024, vision)))
        await asyncio.to_thread(tell)
        for _ in range(100):
            if len(listener.events) >= 3:
                break
            await asyncio.sleep(0.05)
        found["events"] = [(one.ResultId.Id, one.ResultContent) for one in listener.events]
        state = await system.get_child([f"{vision}:VisionStateMachine", "0:CurrentState"])
        found["state"] = (await state.read_value()).Text
        mass = client.get_node(ua.NodeId("LastResult.mass_g", own))
        found["mass_g"] = await mass.read_value()
        for what, attempt in (
            ("write", mass.write_value(99.0)),
            ("add", client.nodes.objects.add_object(own, "intruder")),
            ("halt", state.write_value(ua.LocalizedText("Halted"))),
        ):
            try:
                await attempt
                found[what] = "done"
            except ua.UaStatusCodeError:
                found[what] = "refused"
    return found


def test_a_client_gets_every_result_and_may_change_nothing() -> None:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    port = free_port()
    with OpcUa(OpcUaOptions(port=port)).open() as deliver:
        deliver([row(1)])
        found = ran(
            listened(
                f"opc.tcp://127.0.0.1:{port}/roemetry", lambda: deliver([row(2), row(3, mass_g=None), row(4)])
            )
        )
    assert [key for key, _ in found["events"]] == [f"l/r/00000{n}#1" for n in (2, 3, 4)]
    assert json.loads(found["events"][0][1][0])["latency_ms"] == 3.5
    assert found["state"] == "Operational"
    assert found["mass_g"] == 24.0
    assert {found[what] for what in ("write", "add", "halt")} == {"refused"}


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


async def managed(client, desk: Desk) -> dict[str, Any]:
    """List the recipes, ask for one, ask for what is not there, and follow the state; give what came."""
    from asyncua import ua

    found: dict[str, Any] = {}
    await client.load_data_type_definitions()
    vision = await client.get_namespace_index(VISION)
    own = await client.get_namespace_index("urn:roemetry:line")
    system = client.get_node(ua.NodeId("VisionSystem", own))
    management = await system.get_child([f"{vision}:RecipeManagement"])
    empty, product = ua.RecipeIdExternalDataType(), ua.ProductIdDataType()
    counts = [ua.Variant(n, ua.VariantType.UInt32) for n in (0, 0)]
    any_state = ua.Variant(2, ua.VariantType.Int32)
    listed = await management.call_method(
        f"{vision}:GetRecipeListFiltered",
        empty,
        product,
        any_state,
        *counts,
        ua.Variant(0, ua.VariantType.Int32),
    )
    found["recipes"] = [one.Id for one in listed[3]]
    for name in ("one/cod/recipe.yaml", "one/eel/recipe.yaml"):
        try:
            wanted = ua.RecipeIdExternalDataType(Id=name)
            answer = await management.call_method(
                f"{vision}:PrepareRecipe", wanted, ua.RecipeIdInternalDataType()
            )
            found[name] = answer[1:]
        except ua.UaStatusCodeError as error:
            found[name] = type(error).__name__
    machine = await system.get_child([f"{vision}:VisionStateMachine"])
    try:
        halt = [ua.Variant(0, ua.VariantType.Int32), ua.LocalizedText("why not")]
        await machine.call_method(f"{vision}:Halt", *halt)
    except ua.UaStatusCodeError as error:
        found["Halt"] = type(error).__name__
    state = await machine.get_child(["0:CurrentState"])
    for now in ("running", "faulty"):
        desk.now = now
        for _ in range(40):
            found[now] = (await state.read_value()).Text
            if found[now] in ("Operational", "Error")[now == "faulty" :]:
                break
            await asyncio.sleep(0.05)
    return found


async def until(condition) -> None:
    for _ in range(200):
        if condition():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it does not come")


async def stuck(url: str, deliver, desk: Desk) -> list[str]:
    """Subscribe, ask for no events until the line is told of it, then ask again; give what came."""
    from asyncua import Client, ua

    async with Client(url, timeout=5) as client:
        vision = await client.get_namespace_index(VISION)
        own = await client.get_namespace_index("urn:roemetry:line")
        listener = Listener()
        subscription = await client.create_subscription(20, listener)
        system = client.get_node(ua.NodeId("VisionSystem", own))
        await subscription.subscribe_events(system, client.get_node(ua.NodeId(1024, vision)))
        client.uaclient._publish_task.cancel()
        for number in range(1, 6):
            await asyncio.to_thread(deliver, [row(number)])
            await asyncio.sleep(0.03)
        await until(lambda: desk.warned[-1] is not None)
        client.uaclient.session.ensure_publish_loop()
        await until(lambda: desk.warned[-1] is None and listener.events[-1].MeasId.Id == "000005#1")
        return [one.MeasId.Id for one in listener.events]


def test_a_line_is_followed_strangers_choose_no_recipe_and_a_stuck_client_is_told(monkeypatch) -> None:
    from asyncua import Client

    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    monkeypatch.setattr("roemetry_line.outlets.opcua._FOLLOW_S", 0.05)
    monkeypatch.setattr("roemetry_line.outlets.opcua._STUCK_S", 0.2)
    port = free_port()
    outlet, desk = OpcUa(OpcUaOptions(port=port)), Desk()
    outlet.line = desk

    async def asked() -> tuple[dict[str, Any], bool]:
        client = Client(f"opc.tcp://127.0.0.1:{port}/roemetry", timeout=5)
        client.set_user("admin")  # who says so is nobody
        client.set_password("admin")
        async with client:
            found = await managed(client, desk)
            own = await client.get_namespace_index("urn:roemetry:line")
            try:
                await client.nodes.objects.add_object(own, "intruder")
            except ua.UaStatusCodeError:
                return found, True
            return found, False

    from asyncua import ua

    with outlet.open() as deliver:
        found, refused = ran(asked())
        told = ran(stuck(f"opc.tcp://127.0.0.1:{port}/roemetry", deliver, desk))
    assert found["recipes"] == ["one/roe/recipe.yaml", "one/cod/recipe.yaml"]
    assert found["one/cod/recipe.yaml"] == "BadUserAccessDenied"
    assert found["Halt"] == "BadNotSupported"
    assert (found["running"], found["faulty"]) == ("Operational", "Error")
    assert desk.chosen == []
    assert refused
    waited = [f"00000{n}#1" for n in range(1, 6)]
    assert told == waited[-len(told) :], "what waited comes, in order"
    assert len(told) >= 3, "two answers were on their way when it stopped asking"
    assert desk.warned == [None, "clients that take no events: 127.0.0.1", None]


def test_only_trusted_clients_that_encrypt_get_in(tmp_path) -> None:
    from asyncua import Client
    from asyncua.crypto.cert_gen import setup_self_signed_certificate
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
    from cryptography.x509.oid import ExtendedKeyUsageOID

    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]

    async def certificates() -> None:
        for name, uri in (
            ("server", "urn:roemetry:line"),
            ("friend", "urn:friend"),
            ("stranger", "urn:stranger"),
        ):
            await setup_self_signed_certificate(
                tmp_path / f"{name}.pem",
                tmp_path / f"{name}.der",
                uri,
                "127.0.0.1",
                usages,
                {"commonName": name},
            )

    ran(certificates())
    trusted = tmp_path / "trusted"
    trusted.mkdir()
    (tmp_path / "friend.der").rename(trusted / "friend.der")
    port = free_port()
    options = OpcUaOptions(
        port=port,
        certificate=tmp_path / "server.der",
        private_key=tmp_path / "server.pem",
        trusted=str(trusted),
    )

    from asyncua import ua

    async def gets_in(name: str | None) -> dict[str, Any] | None:
        client = Client(f"opc.tcp://127.0.0.1:{port}/roemetry", timeout=5)
        try:
            if name is not None:
                client.application_uri = f"urn:{name}"
                folder = trusted if name == "friend" else tmp_path
                await client.set_security(
                    SecurityPolicyBasic256Sha256,
                    certificate=str(folder / f"{name}.der"),
                    private_key=str(tmp_path / f"{name}.pem"),
                    server_certificate=str(tmp_path / "server.der"),
                )
            async with client:
                return await managed(client, desk)
        except (ua.UaError, OSError, TimeoutError):  # however a client is turned away
            return None

    outlet, desk = OpcUa(options), Desk()
    outlet.line = desk
    with outlet.open():
        told = ran(gets_in("friend"))
        assert told["one/cod/recipe.yaml"] == [True, 0]
        assert told["one/eel/recipe.yaml"] == "BadNotFound"
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
