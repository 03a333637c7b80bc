"""The checks: functions whose parameter names a kind and whose docstring says what its stages must keep."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from roemetry.stages.hookspecs import KINDS
from roemetry.testing.checks import (
    any_stage,
    circles,
    classes,
    dots,
    extractor,
    files,
    grids,
    points,
    stripes,
    volume,
    weigher,
)

Check = Callable[[Any], None]

_MODULES = (extractor, stripes, points, volume, weigher, classes, files)
_CALLED = {"estimator": "volume"}
_CONNECTED = ("feed", "outlet")
"""Kinds that talk to the world: no call of theirs is like another."""
_LONG = ("calibrator", "grid")
"""It calibrates each family as lines, by a stage that is held to every check: a dozen calls take minutes."""


def _kind_of(check: Check) -> str:
    """Give the kind a check holds for: its only parameter is named for it."""
    called = inspect.getfullargspec(check).args[0]
    return _CALLED.get(called, called)


_CHECKS: tuple[Check, ...] = tuple(
    check for module in _MODULES for name, check in vars(module).items() if name.startswith("check_")
)
ANY: tuple[Check, ...] = any_stage.CHECKS
OF_KIND: Mapping[str, tuple[Check, ...]] = {
    kind: found for kind in KINDS if (found := tuple(check for check in _CHECKS if _kind_of(check) == kind))
}
OF_PATTERN: Mapping[str, Mapping[str, tuple[Check, ...]]] = {
    pattern: {
        kind: tuple(
            check
            for name, check in vars(module).items()
            if name.startswith("check_") and _kind_of(check) == kind
        )
        for kind in ("extractor", "aligner", "coder", "calibrator", "triangulator")
    }
    for pattern, module in (("dots", dots), ("grid", grids), ("circles", circles))
}
"""Of stages that are made for other light than lines, instead."""


def checks_of(kind: str, pattern: str = "lines") -> tuple[Check, ...]:
    """Give the checks that a stage of this kind must pass: every stage's, then its kind's.

    Stages that see the light are held to the checks of the pattern that they are made for.

    Of a kind that the kit has no scenes for, that holds a connection, or whose calls take long, only those of
    options are taken of every stage's.
    """
    whole = kind in OF_KIND and kind not in _CONNECTED and (kind, pattern) != _LONG
    every = ANY if whole else any_stage.OF_OPTIONS
    return every + OF_PATTERN.get(pattern, OF_KIND).get(kind, ())


def name_of(check: Check) -> str:
    """Name of a check, as results and expected failures use it."""
    return str(check.__name__)


def sentence_of(check: Check) -> str:
    """What a stage must keep, in one sentence."""
    return " ".join((check.__doc__ or "").split())
