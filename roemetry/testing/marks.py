"""The kit in pytest: one test a stage and check."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from roemetry.errors import PluginError
from roemetry.stages.registry import Registered
from roemetry.testing.checks import checks_of, name_of
from roemetry.testing.kit import prepared, stages_named

if TYPE_CHECKING:
    import pytest


def parametrize_stages(
    name: str,
    expected_failures: Mapping[str, str] | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
) -> pytest.MarkDecorator:
    """Parametrize a test over a plugin's stages and every check of their kinds.

    A plugin author's whole test file::

        from roemetry.testing import parametrize_stages

        @parametrize_stages("my-plugin", expected_failures={"check_dark_rows_give_nothing": "why"})
        def test_contract(stage, check):
            check(stage)

    Parameters
    ----------
    name
        A distribution, an entry point, or a stage, as for `roemetry check-plugin`.
    expected_failures
        Check name → reason, for every stage of the plugin that has the check; ``stage/check`` for one of
        them. They are added to what the stages declare themselves. A check that passes in spite of it fails.
    options
        Stage name → options to make the stage with; the others are made as `conformance` says.

    Raises
    ------
    PluginError
        There is no such plugin, a stage of it cannot be made, or a declared check is not there.
    """
    return parametrized(stages_named(name), expected_failures, options)


def parametrized(
    stages: tuple[Registered, ...],
    expected_failures: Mapping[str, str] | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
) -> pytest.MarkDecorator:
    """Parametrize a test over these stages; one whose requirements are missing is skipped with the reason."""
    import pytest

    _refuse_unknown(expected_failures or {}, stages)
    cases = []
    for registered in stages:
        entry = registered.entry
        of_stage = f"{entry.kind}/{entry.name}"
        if registered.missing is not None:
            skip = pytest.mark.skip(reason=f"{of_stage} {registered.missing}")
            cases.append(pytest.param(None, None, id=of_stage, marks=skip))
            continue
        mine = {
            key.rpartition("/")[2]: reason
            for key, reason in (expected_failures or {}).items()
            if key in _keys(registered)
        }
        stage, expected = prepared(registered, mine, (options or {}).get(entry.name))
        for check in checks_of(entry.kind):
            reason = expected.get(name_of(check))
            marks = () if reason is None else pytest.mark.xfail(strict=True, reason=reason)
            cases.append(pytest.param(stage, check, id=f"{of_stage}-{name_of(check)}", marks=marks))
    return pytest.mark.parametrize(("stage", "check"), cases)


def _keys(registered: Registered) -> set[str]:
    """Give the names by which a failure of a check of this stage may be declared."""
    names = {name_of(check) for check in checks_of(registered.entry.kind)}
    return names | {f"{registered.entry.name}/{name}" for name in names}


def _refuse_unknown(expected_failures: Mapping[str, str], stages: tuple[Registered, ...]) -> None:
    known = set().union(*(_keys(registered) for registered in stages))
    for key in expected_failures:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            raise PluginError(
                f"`{key}` is no check of any of these stages",
                hint=f"did you mean `{close[0]}`?" if close else "docs/reference/conformance.md lists them",
            )
