"""The checks: functions whose parameter names a kind and whose docstring says what its stages must keep."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from roemetry.stages.hookspecs import KINDS
from roemetry.testing.checks import (
    aligners,
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

_MODULES = (extractor, aligners, stripes, points, volume, weigher, classes, files)
_CALLED = {"estimator": "volume"}
_CONNECTED = ("feed", "outlet")
"""Kinds that talk to the world: no call of theirs is like another."""
_LONG = ("calibrator", "grid")
"""It calibrates each family as lines, by a stage that is held to every check: a dozen calls take minutes."""


def _kind_of(check: Check) -> str:
    """Give the kind a check holds for: its only parameter is named for it."""
    called = inspect.getfullargspec(check).args[0]
    return _CALLED.get(called, called)


def _is_check(found: Any, kind: str) -> bool:
    return getattr(found, "__name__", "").startswith("check_") and _kind_of(found) == kind


_CHECKS: tuple[Check, ...] = tuple(
    check for module in _MODULES for name, check in vars(module).items() if name.startswith("check_")
)
ANY: tuple[Check, ...] = any_stage.CHECKS
OF_KIND: Mapping[str, tuple[Check, ...]] = {
    kind: found for kind in KINDS if (found := tuple(check for check in _CHECKS if _kind_of(check) == kind))
}
_OF_ANY_LIGHT = (
    extractor.check_dark_gives_nothing,
    extractor.check_a_colour_frame_is_refused,
    extractor.check_the_smallest_frames_are_taken,
)
"""What extractors of every pattern keep."""
OF_PATTERN: Mapping[str, Mapping[str, tuple[Check, ...]]] = {
    pattern: {
        kind: tuple(check for check in (*vars(module).values(), *_OF_ANY_LIGHT) if _is_check(check, kind))
        for kind in ("extractor", "coder", "calibrator", "triangulator")
    }
    for pattern, module in (("dots", dots), ("grid", grids), ("circles", circles))
}
"""Of stages that are made for other light than lines, instead; aligners of all light keep the same."""


def checks_of(kind: str, pattern: str = "lines") -> tuple[Check, ...]:
    """Give the checks that a stage of this kind must pass: every stage's, then its kind's.

    Stages that see the light are held to the checks of the pattern that they are made for.

    Of a kind that the kit has no scenes for, that holds a connection, or whose calls take long, only those of
    options are taken of every stage's.
    """
    whole = kind in OF_KIND and kind not in _CONNECTED and (kind, pattern) != _LONG
    every = ANY if whole else any_stage.OF_OPTIONS
    return every + OF_PATTERN.get(pattern, {}).get(kind, OF_KIND.get(kind, ()))


def name_of(check: Check) -> str:
    """Name of a check, as results and expected failures use it."""
    return str(check.__name__)


def sentence_of(check: Check) -> str:
    """What a stage must keep, in one sentence."""
    return " ".join((check.__doc__ or "").split())
