"""The command line's entry: gathers the verbs, and turns errors into messages and exit codes.

The core's own verbs are listed here. Those of plugins come through the hook ``roemetry_verbs``: plugins are
asked only when the verb is none of the core's or all are listed; a verb's module is imported when it runs.
"""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from roemetry.cli import calibration, files, learning, plugins, run
from roemetry.errors import FAULTS, PluginError, RoemetryError

if TYPE_CHECKING:
    from roemetry.stages.hookspecs import VerbEntry


# Matrices here are small: BLAS threads for them take more time than they save, and each of several worker
# processes would start as many. Set before numpy is imported; who has set it keeps it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@cache
def plugin_verbs() -> dict[str, VerbEntry]:
    """Return what plugins add to the command line, by name; a core verb cannot be replaced."""
    from roemetry.stages.registry import discover

    return {verb.name: verb for verb in discover().verbs}


def load_verb(entry: VerbEntry) -> Callable[..., Any]:
    """Import the function behind a plugin's verb; raise PluginError where it cannot be imported."""
    module, _, function = entry.target.partition(":")
    try:
        loaded: Callable[..., Any] = getattr(importlib.import_module(module), function)
    except FAULTS as error:
        raise PluginError(
            f"verb `{entry.name}`: `{entry.target}` cannot be imported: {type(error).__name__}: {error}",
            hint="reinstall the plugin, or report this to its author",
        ) from error
    return loaded


class _Verbs(TyperGroup):
    """The core's verbs and those of plugins.

    Contexts and commands are `Any`: newer releases of typer bring a click of their own.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        own = super().list_commands(ctx)
        return own + [name for name in plugin_verbs() if name not in own]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a core verb, or a plugin's by its summary alone: enough for a list."""
        own = super().get_command(ctx, cmd_name)
        if own is not None or (entry := plugin_verbs().get(cmd_name)) is None:
            return own
        listed = typer.Typer(add_completion=False)
        listed.command(cmd_name, help=entry.summary)(lambda: None)
        return typer.main.get_command(listed)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the verb that is to run; a plugin's is imported now."""
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None and name not in self.commands and name in plugin_verbs():
            loaded = load_verb(plugin_verbs()[name])
            if isinstance(loaded, typer.Typer):  # a verb with verbs of its own
                return name, typer.main.get_command(loaded), rest
            single = typer.Typer(
                add_completion=False,
                pretty_exceptions_enable=False,
                context_settings={"help_option_names": ["-h", "--help"]},
            )
            single.command(name)(loaded)
            command = typer.main.get_command(single)
        return name, command, rest


app = typer.Typer(
    cls=_Verbs,
    name="roemetry",
    help="Calibration and metrology for laser-stripe inspection of curved products.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; a fault the user can mend is told without a traceback."""
    for stream in (sys.stdout, sys.stderr):  # a file's name may be no text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with _told_when_stopped():
            app()
    except RoemetryError as error:
        if "--debug" in sys.argv:
            raise
        said = "".join(c if c == "\n" or c.isprintable() else repr(c)[1:-1] for c in str(error))
        sys.stderr.write(f"roemetry: {said}\n")
        sys.exit(error.exit_code)


@contextmanager
def _told_when_stopped() -> Iterator[None]:
    """Say so where the system ends a command that has no way of its own to stop, or has not begun yet."""
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    # nohup ignores SIGHUP: so shall we; signals can be handled in the main thread only
    wanted = [
        signal.Signals[name] for name in names if signal.getsignal(signal.Signals[name]) == signal.SIG_DFL
    ]
    if threading.current_thread() is not threading.main_thread():
        wanted = []
    for number in wanted:
        signal.signal(number, partial(_stopped, os.getpid()))
    try:
        yield
    finally:
        for number in wanted:
            signal.signal(number, signal.SIG_DFL)


def _stopped(started: int, number: int, _: object) -> None:
    """End at once: an exception might surface in an import, which would be blamed on a plugin."""
    if os.getpid() == started:  # not a forked worker, which is told to stop by its own process
        name = signal.Signals(number).name
        said = (
            f"roemetry: stopped by {name}; give the command again, with --resume where it has that option\n"
        )
        os.write(2, said.encode())
    os._exit(130)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # takes as long as the rest of this module

        typer.echo(f"roemetry {version('roemetry')}")
        raise typer.Exit


@app.callback()
def _options(
    show: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and stop."),
    ] = False,
) -> None:
    """Calibration and metrology for laser-stripe inspection of curved products."""


for _verb in (
    run.run,
    calibration.calibrate,
    files.lint,
    plugins.plugins,
    run.report,
    run.export,
    files.simulate,
    plugins.check_plugin,
    calibration.check_calibration,
    learning.check_weight,
    learning.fit_classifier,
    learning.fit_weight,
    calibration.fit_penetration,
    calibration.target,
    plugins.schema,
):
    app.command()(_verb)
