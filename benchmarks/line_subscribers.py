"""Subscribers of a line in processes of their own, which can be stopped: each key goes into a file.

``python -m benchmarks.line_subscribers mqtt|opcua PORT FILE``
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any, TextIO


def mqtt(port: int, file: TextIO) -> None:
    """Subscribe at a broker under a name, so that it keeps what comes while this process is not there."""
    from paho.mqtt import client as paho

    def keep(client: Any, _data: Any, message: Any) -> None:
        """Write a product's key down, then confirm it."""
        key = json.loads(message.payload)["key"]
        file.write(key + "\n")
        file.flush()
        client.publish("bench/taken/bench", key, qos=1)

    client = paho.Client(paho.CallbackAPIVersion.VERSION2, "bench", clean_session=False)
    client.on_connect = lambda client, *_: client.subscribe("bench/products", qos=1)
    client.on_message = keep
    client.reconnect_delay_set(1, 1)
    client.connect_async("127.0.0.1", port, keepalive=5)
    client.loop_forever(retry_first_connection=True)


class _Events:
    """Takes events as asyncua gives them."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def event_notification(self, event: Any) -> None:
        """Keep the key of a product."""
        if "!" not in event.ResultId.Id:
            self._file.write(event.ResultId.Id + "\n")
            self._file.flush()


async def opcua(port: int, file: TextIO) -> None:
    """Subscribe to the results of a server, again whenever it is back."""
    from asyncua import Client, ua

    loaded = False  # once for a process: asyncua cannot do it twice
    while True:
        try:
            async with Client(f"opc.tcp://127.0.0.1:{port}/roemetry", timeout=10) as client:
                loaded = loaded or bool(await client.load_data_type_definitions())
                vision = await client.get_namespace_index("http://opcfoundation.org/UA/MachineVision")
                own = await client.get_namespace_index("urn:roemetry:line")
                subscription = await client.create_subscription(100, _Events(file))
                system = client.get_node(ua.NodeId("VisionSystem", own))
                await subscription.subscribe_events(system, client.get_node(ua.NodeId(1024, vision)))
                while True:
                    await client.check_connection()
                    await asyncio.sleep(0.5)
        except (ua.UaError, OSError, TimeoutError) as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
            await asyncio.sleep(0.5)


if __name__ == "__main__":
    with Path(sys.argv[3]).open("a") as kept:
        if sys.argv[1] == "mqtt":
            mqtt(int(sys.argv[2]), kept)
        else:
            asyncio.run(opcua(int(sys.argv[2]), kept))
