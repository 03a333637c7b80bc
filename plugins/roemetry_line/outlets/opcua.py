"""An OPC UA server by OPC 40100-1: a ResultReady event a product, and the last result to read.

The nodeset of OPC 40100-1 (Machine Vision) lies beside this file, with its notice. Its methods (recipes,
jobs, modes) are refused with `BadNothingToDo`: a line is run by its file and its page.
"""

from __future__ import annotations

import asyncio
import gzip
import tempfile
import threading
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from roemetry.errors import MisfitError, OutputError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions

_NODESET = Path(__file__).parent / "opc_ua" / "machine_vision.xml.gz"
_MACHINE_VISION = "http://opcfoundation.org/UA/MachineVision"
_OWN = "urn:roemetry:line"
_RESULT_READY = 1024
"""Number of ResultReadyEventType in the nodeset."""
_START_S, _TELL_S = 30.0, 10.0
_COMPLETED, _ABORTED = 1, 3
"""ResultState of OPC 40100-1, 12.11: completed; aborted, where a frame gave no measurement."""


class OpcUaOptions(StageOptions):
    """Where the server listens, and who may connect."""

    host: str = Field(default="127.0.0.1", min_length=1, description="address to listen at")
    port: int = Field(default=4840, ge=1, le=65535, description="port to listen at")
    certificate: Path | None = Field(
        default=None,
        description="the server's certificate (DER): only encrypted connections are then taken",
    )
    private_key: Path | None = Field(default=None, description="the certificate's key (PEM)")
    trusted: str = Field(
        default="",
        description="folder with the certificates (DER) of the clients that may connect",
    )

    @model_validator(mode="after")
    def _both_or_none(self) -> Self:
        if (self.certificate is None) != (self.private_key is None):
            raise MisfitError((("private_key",), "certificate and private_key go together"))
        if (self.certificate is not None) != bool(self.trusted):
            raise MisfitError(
                (
                    ("trusted",),
                    "a certificate and a folder of trusted clients go together",
                )
            )
        return self


class OpcUa(Outlet[OpcUaOptions]):
    """Serves results to OPC UA clients; nobody may write, or add nodes."""

    Options = OpcUaOptions
    capabilities = Capabilities(fixture="roemetry_line.conformance:opcua")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Serve; OutputError where this machine cannot listen there."""
        loop = asyncio.new_event_loop()
        thread = threading.Thread(target=loop.run_forever, daemon=True)
        thread.start()

        def wait(work: Coroutine[Any, Any, Any], at_most_s: float) -> None:
            future = asyncio.run_coroutine_threadsafe(work, loop)
            try:
                future.result(at_most_s)
            except TimeoutError as error:
                future.cancel()
                raise self._fault(f"it did not answer within {at_most_s:g} s") from error
            except OSError as error:
                raise self._fault(error.strerror or str(error)) from error

        system = _VisionSystem(self.options)
        try:
            wait(system.start(), _START_S)
            yield lambda rows: wait(system.tell(rows), _TELL_S)
        finally:
            with suppress(OutputError):
                wait(system.stop(), _TELL_S)
            loop.call_soon_threadsafe(loop.stop)
            thread.join(_TELL_S)
            loop.close()

    def _fault(self, why: str) -> OutputError:
        return OutputError(
            f"OPC UA server at {self.options.host}:{self.options.port}: {why}",
            hint="is the address this machine's, and the port free?",
        )


class _VisionSystem:
    """The server and its nodes; all of it runs in one event loop."""

    def __init__(self, options: OpcUaOptions) -> None:
        self._options = options
        self._server: Any = None
        self._values: dict[str, Any] = {}
        self._running = False

    async def start(self) -> None:
        """Build the address space and listen."""
        from asyncua import Server, ua

        self._server = server = Server()
        await server.init()
        await server.set_application_uri(_OWN)
        server.set_server_name("roemetry")
        server.set_endpoint(f"opc.tcp://{self._options.host}:{self._options.port}/roemetry")
        await self._secure(ua)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "nodeset.xml"
            path.write_bytes(gzip.decompress(_NODESET.read_bytes()))
            await server.import_xml(str(path))
        await server.load_data_type_definitions()
        vision = await server.get_namespace_index(_MACHINE_VISION)
        own = await server.register_namespace(_OWN)
        kind = await server.nodes.base_object_type.get_child([f"{vision}:VisionSystemType"])
        self._system = await server.nodes.objects.add_object(
            ua.NodeId("VisionSystem", own),
            ua.QualifiedName("VisionSystem", own),
            objecttype=kind.nodeid,
            instantiate_optional=True,
        )
        machine = await self._system.get_child([f"{vision}:VisionStateMachine"])
        automatic = await machine.get_child([f"{vision}:AutomaticModeStateMachine"])
        await self._set_state(ua, machine, "Operational", vision)
        await self._set_state(ua, automatic, "ContinuousExecution", vision)
        self._last = await self._system.add_object(
            ua.NodeId("LastResult", own), ua.QualifiedName("LastResult", own)
        )
        self._own = own
        self._event = await server.get_event_generator(
            server.get_node(ua.NodeId(_RESULT_READY, vision)), self._system
        )
        await server.start()
        self._running = True

    async def _secure(self, ua: Any) -> None:
        server = self._server
        if self._options.certificate is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
            return
        from asyncua.crypto.truststore import TrustStore
        from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions

        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        await server.load_certificate(str(self._options.certificate))
        await server.load_private_key(str(self._options.private_key))
        store = TrustStore([Path(self._options.trusted)], [])
        await store.load()
        checks = CertificateValidatorOptions.TRUSTED_VALIDATION | CertificateValidatorOptions.PEER_CLIENT
        server.set_certificate_validator(CertificateValidator(checks, store))

    async def _set_state(self, ua: Any, machine: Any, name: str, vision: int) -> None:
        of_kind = self._server.get_node(await machine.read_type_definition())
        state = await of_kind.get_child([f"{vision}:{name}"])
        current = await machine.get_child(["0:CurrentState"])
        await current.write_value(ua.LocalizedText(name))
        identity = await current.get_child(["0:Id"])
        await identity.write_value(state.nodeid)

    async def tell(self, rows: Sequence[LineRow]) -> None:
        """Send an event for each row, and keep the last one's numbers to be read."""
        from asyncua import ua

        for row in rows:
            for name, value in row.summary.items():
                await self._write(ua, name, value)
            event = self._event.event
            event.Message = ua.LocalizedText(str(row.summary.get("status")))
            event.CreationTime = datetime.now(UTC).replace(tzinfo=None)
            event.IsPartial = event.IsSimulated = False
            event.ResultId = ua.ResultIdDataType(Id=row.key)
            event.MeasId = ua.MeasIdDataType(Id=str(row.summary.get("id")))
            event.ResultState = _COMPLETED if row.kind == "product" else _ABORTED
            # In any other form the list arrives empty, without a word.
            event.ResultContent = ua.Variant([row.text], ua.VariantType.String)
            await self._event.trigger()

    async def _write(self, ua: Any, name: str, value: str | float | int | None) -> None:
        """Write a number or word of the last result; its node is made when it is first known."""
        kind = ua.VariantType.String if isinstance(value, str) else ua.VariantType.Double
        told = value if isinstance(value, str) or value is None else float(value)
        if name not in self._values:
            if told is None:
                return
            identity = ua.NodeId(f"LastResult.{name}", self._own)
            called = ua.QualifiedName(name, self._own)
            self._values[name] = await self._last.add_variable(identity, called, told, kind), kind
            return
        node, kind = self._values[name]
        unknown = ua.StatusCode(ua.StatusCodes.BadNoData)
        written = (
            ua.DataValue(ua.Variant(told, kind)) if told is not None else ua.DataValue(StatusCode_=unknown)
        )
        await self._server.write_attribute_value(node.nodeid, written)

    async def stop(self) -> None:
        """Stop serving."""
        if self._running:
            await self._server.stop()
