"""The checks: functions whose parameter names a kind and whose docstring says what its stages must keep."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from roemetry.stages.hookspecs import KINDS
from roemetry.testing.checks import (
    any_stage,
    classes,
    extractor,
    files,
    points,
    stripes,
    volume,
    weigher,
)

Check = Callable[[Any], None]

_MODULES = (extractor, stripes, points, volume, weigher, classes, files)
_CALLED = {"estimator": "volume"}


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


def checks_of(kind: str) -> tuple[Check, ...]:
    """Give the checks that a stage of this kind must pass: every stage's, then its kind's.

    Of a kind that the kit has no scenes for, the options alone are checked.
    """
    return ANY + OF_KIND[kind] if kind in OF_KIND else any_stage.OF_OPTIONS


def name_of(check: Check) -> str:
    """Name of a check, as results and expected failures use it."""
    return str(check.__name__)


def sentence_of(check: Check) -> str:
    """What a stage must keep, in one sentence."""
    return " ".join((check.__doc__ or "").split())
