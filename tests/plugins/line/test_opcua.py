"""Results by OPC UA, to a real client on loopback."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

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
            listened(f"opc.tcp://127.0.0.1:{port}/roemetry", lambda: deliver([row(2), row(3), row(4)]))
        )
    assert [key for key, _ in found["events"]] == [f"l/r/00000{n}#1" for n in (2, 3, 4)]
    assert json.loads(found["events"][0][1][0])["latency_ms"] == 3.5
    assert found["state"] == "Operational"
    assert found["mass_g"] == 24.0
    assert {found[what] for what in ("write", "add", "halt")} == {"refused"}


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

    async def gets_in(name: str | None) -> bool:
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
                await client.get_namespace_array()
                return True
        except Exception:  # however a client is turned away
            return False

    with OpcUa(options).open():
        assert ran(gets_in("friend"))
        assert not ran(gets_in("stranger"))
        assert not ran(gets_in(None))
