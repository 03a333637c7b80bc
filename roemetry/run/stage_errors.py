"""Whose fault it was: a stage that broke is named, with the line of its code."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from roemetry.config.resolve import ResolvedStage
from roemetry.errors import FAULTS, PluginError, RecordError, RoemetryError


def describe_failure(error: BaseException, kind: str, chosen: ResolvedStage | None) -> str:
    """Say which stage (None: none of a recipe's) failed, with what, and where in its code.

    `error` is no `RoemetryError`: by these a stage refuses.
    """
    whose = f"the {kind}" if chosen is None else f"the {kind} `{chosen.registered.entry.name}`"
    place = None if chosen is None else plugin_frame(error, chosen.stage.__module__)
    where = "" if place is None else f", at {place}"
    return f"{whose} failed with {type(error).__name__}: {error} (a plugin's fault{where}; see --debug)"


@contextmanager
def wrap_stage_error(kind: str, chosen: ResolvedStage) -> Iterator[None]:
    """Turn what a stage raises, unless it refuses, into a `PluginError` that names the stage."""
    try:
        yield
    except FAULTS as error:
        if is_refusal(error):
            raise
        raise PluginError(describe_failure(error, kind, chosen)) from error


def is_refusal(error: BaseException) -> bool:
    """Tell a stage that says why it cannot do its work from one that is broken."""
    return isinstance(error, RoemetryError) and not isinstance(error, RecordError)


def plugin_frame(error: BaseException, module: str) -> str | None:
    """Give file and line, ``extractor.py:33``, of the innermost call in a plugin that an error came through.

    The plugin's package is that of `module`; None where the error did not pass through it.
    """
    package = module.partition(".")[0]
    place = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        if str(frame.f_globals.get("__name__")).partition(".")[0] == package:
            place = f"{Path(frame.f_code.co_filename).name}:{line}"
    return place
