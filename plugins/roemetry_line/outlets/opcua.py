"""An OPC UA server by OPC 40100-1: a ResultReady event a product, and the last result to read.

The nodeset of OPC 40100-1 (Machine Vision) lies beside this file, with its notice. The state machines follow
the line: Preoperational while a station starts, Operational and ContinuousExecution while all measure, Error
while an alarm is open. Of the recipe management, `GetRecipeListFiltered` lists what the line file names,
`PrepareRecipe` lets a station measure with one, for clients with a trusted certificate only; recipes are
files, so that adding, removing and transferring them is answered with `BadNotSupported`, as are jobs and
modes: a line runs from its start to its stop.
"""

from __future__ import annotations

import asyncio
import gc
import gzip
import socket
import tempfile
import threading
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from roemetry.errors import MisfitError, OutputError
from roemetry.records.live import LineControl, LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions
from roemetry_line.process import settle

_NODESET = Path(__file__).parent / "opc_ua" / "machine_vision.xml.gz"
_MACHINE_VISION = "http://opcfoundation.org/UA/MachineVision"
_OWN = "urn:roemetry:line"
_RESULT_READY = 1024
"""Number of ResultReadyEventType in the nodeset."""
_START_S, _TELL_S = 120.0, 10.0
"""So long the server may take to start, and to take rows, s. It starts in 2 s of a processor's time: what
else is to be done on the machine can make half a minute of it."""
_FOLLOW_S = 0.5  # between two looks at the line's state and at its clients
_STUCK_S = 1.5
"""So long a client may leave events of its subscription waiting, s."""
_STATES = {
    "starting": ("Preoperational", "Initialized"),
    "running": ("Operational", "ContinuousExecution"),
    "faulty": ("Error", "Initialized"),
}
"""By the line's state, those of the vision system and of its automatic mode."""
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

        system = _VisionSystem(self.options, self.line)
        try:
            with _much_is_loaded():
                wait(system.start(), _START_S)
            yield lambda rows: wait(system.tell(rows), _TELL_S)
        finally:
            gc.unfreeze()  # else a server that has ended would be kept
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


@contextmanager
def _much_is_loaded() -> Iterator[None]:
    """Keep the collector from looking through the address space.

    While its 550,000 objects are made that costs a good part of the time, and afterwards, again and again,
    a quarter of a second in which no outlet delivers.
    """
    gc.disable()
    try:
        yield
        settle()
    finally:
        gc.enable()


class _VisionSystem:
    """The server and its nodes; all of it runs in one event loop."""

    def __init__(self, options: OpcUaOptions, line: LineControl | None = None) -> None:
        self._options, self._line = options, line
        self._following: asyncio.Task[None] | None = None
        self._server: Any = None
        self._values: dict[str, Any] = {}
        self._running = False

    async def start(self) -> None:
        """Build the address space and listen."""
        from asyncua import Server, ua

        # A port that is taken is told before the work, not after.
        socket.create_server((self._options.host, self._options.port)).close()

        self._server = server = Server()
        await server.init()
        # Else whoever says that his name is `admin` may write.
        server.allow_remote_admin(False)
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
        await self._answer_methods(ua, vision)
        await self._show_state(ua, vision, "starting" if self._line else "running")
        self._last = await self._system.add_object(
            ua.NodeId("LastResult", own), ua.QualifiedName("LastResult", own)
        )
        self._own = own
        self._event = await server.get_event_generator(
            server.get_node(ua.NodeId(_RESULT_READY, vision)), self._system
        )
        await server.start()
        self._running = True
        if self._line is not None:
            self._following = asyncio.create_task(self._follow(ua, vision, self._line))

    async def _follow(self, ua: Any, vision: int, line: LineControl) -> None:
        """Let the state machines follow the line, and tell of clients that take no events."""
        shown, warned = "starting", None
        await asyncio.to_thread(line.warn, None)
        while True:
            with suppress(OutputError, ua.UaError):  # its file cannot be read just now, or the server stops
                state = await asyncio.to_thread(line.state)
                if state != shown:
                    await self._show_state(ua, vision, state)
                    shown = state
                stuck = self._stuck_clients()
                if stuck != warned:
                    await asyncio.to_thread(line.warn, stuck)
                    warned = stuck
            await asyncio.sleep(_FOLLOW_S)

    def _stuck_clients(self) -> str | None:
        """Name the clients whose events wait because they ask for none; None where there are none."""
        names = {
            one.processor.session.session_id: one.peer_name[0]
            for one in self._server.bserver.clients
            if one.processor is not None and one.processor.session is not None
        }
        stuck = {
            names.get(one.session_id, "one that is gone")
            for one in self._server.iserver.subscription_service.subscriptions.values()
            if one._triggered_events
            and 1e-3 * one._publish_cycles_count * one.data.RevisedPublishingInterval > _STUCK_S
        }
        return f"clients that take no events: {', '.join(sorted(stuck))}" if stuck else None

    async def _show_state(self, ua: Any, vision: int, state: str) -> None:
        machine = await self._system.get_child([f"{vision}:VisionStateMachine"])
        automatic = await machine.get_child([f"{vision}:AutomaticModeStateMachine"])
        of_system, of_mode = _STATES[state]
        await self._set_state(ua, machine, of_system, vision)
        await self._set_state(ua, automatic, of_mode, vision)

    async def _answer_methods(self, ua: Any, vision: int) -> None:
        """Answer every method of the system: two of the recipe management, the others with a refusal."""
        answers = {"GetRecipeListFiltered": self._list_recipes, "PrepareRecipe": self._prepare_recipe}

        async def refuse(_parent: Any, *_given: Any) -> Any:
            return ua.StatusCode(ua.StatusCodes.BadNotSupported)

        async def link(node: Any) -> None:
            for child in await node.get_children():
                if await child.read_node_class() == ua.NodeClass.Method:
                    name = (await child.read_browse_name()).Name
                    self._server.link_method(child, answers.get(name, refuse))
                else:
                    await link(child)

        await link(self._system)

    async def _list_recipes(self, _parent: Any, *given: Any) -> Any:
        """Answer GetRecipeListFiltered (OPC 40100-1, 7.5.2.4): IsComplete, count, handle, list, error."""
        from asyncua import ua

        wanted, _, _, most, start, _ = (one.Value for one in given)
        found = [self._recipe(station, recipe) for station, recipe in await self._recipes()]
        if wanted is not None and wanted.Id:
            found = [one for one in found if one.Id == wanted.Id]
        part = found[start : start + most if most else None]
        return [
            ua.Variant(start + len(part) >= len(found), ua.VariantType.Boolean),
            ua.Variant(len(part), ua.VariantType.UInt32),
            ua.Variant(0, ua.VariantType.UInt32),
            ua.Variant(part, ua.VariantType.ExtensionObject, is_array=True),
            ua.Variant(0, ua.VariantType.Int32),
        ]

    async def _prepare_recipe(self, _parent: Any, *given: Any) -> Any:
        """Answer PrepareRecipe (OPC 40100-1, 7.5.2.7): internal id, completed, error."""
        from asyncua import ua

        if self._options.certificate is None or self._line is None:
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        wanted = given[0].Value.Id
        for station, recipe in await self._recipes():
            identity = self._recipe(station, recipe)
            if identity.Id == wanted and await asyncio.to_thread(
                self._line.choose, station, recipe, "OPC UA"
            ):
                return [
                    ua.Variant(identity, ua.VariantType.ExtensionObject),
                    ua.Variant(True, ua.VariantType.Boolean),
                    ua.Variant(0, ua.VariantType.Int32),
                ]
        return ua.StatusCode(ua.StatusCodes.BadNotFound)

    async def _recipes(self) -> list[tuple[str, str]]:
        found = {} if self._line is None else await asyncio.to_thread(self._line.recipes)
        return [(station, recipe) for station, recipes in found.items() for recipe in recipes]

    @staticmethod
    def _recipe(station: str, recipe: str) -> Any:
        """Give a recipe's identity: ``STATION/FOLDER/FILE``, which tells the recipes of a line apart."""
        from asyncua import ua

        path = Path(recipe)
        return ua.RecipeIdInternalDataType(Id=f"{station}/{path.parent.name}/{path.name}")

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
        written = ua.DataValue(ua.Variant(told, kind)) if told is not None else ua.DataValue(None, unknown)
        await self._server.write_attribute_value(node.nodeid, written)

    async def stop(self) -> None:
        """Stop serving."""
        if self._following is not None:
            self._following.cancel()
        if self._running:
            await self._server.stop()
