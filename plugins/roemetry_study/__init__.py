"""Studies of an instrument: gauge studies, acceptance tests, uncertainty, and their certificates.

They work on what runs have recorded and on the user's own tables, by published methods, and use of the core
what every Python program may use. Each command of ``roemetry study`` is a module; `certificate` writes, signs
and verifies what they found.
"""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import VerbEntry, hookimpl


@hookimpl
def roemetry_verbs() -> Iterable[VerbEntry]:
    """Register the commands."""
    yield VerbEntry(
        "study",
        "roemetry_study.commands:study",
        "Gauge studies, acceptance tests, uncertainty budgets, and plans for them.",
    )
    yield VerbEntry(
        "verify", "roemetry_study.commands:verify", "Prove that a certificate is unchanged and who signed it."
    )
