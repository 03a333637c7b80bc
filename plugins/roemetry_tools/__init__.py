"""Tools around measuring: they plan, begin, tune and compare; the core knows nothing of them.

They use what every Python program may use of the core. Each command is a module or a folder
of its name.
"""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import VerbEntry, hookimpl


@hookimpl
def roemetry_verbs() -> Iterable[VerbEntry]:
    """Register the commands."""
    for name, summary in (
        ("init", "Write a folder to start from: recipe, rig, calibration, simulated images."),
        ("plan", "Predict what a rig will measure before it is built."),
        ("compare", "Compare variants of a recipe on the same data: trueness and time."),
        ("optimise", "Search the options of a recipe for those nearest to the truth and fastest."),
        ("tune", "Adjust a recipe's options on a local web page and see at once what changes."),
        ("new-plugin", "Write an installable plugin package: a working stage and its tests."),
        ("doctor", "Say what is installed, and whether this machine gives the numbers it should."),
    ):
        word = name.replace("-", "_")
        yield VerbEntry(name, f"roemetry_tools.{word}:{word}", summary)
