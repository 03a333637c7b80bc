"""The kit: every check of a kind against a stage, with what it is expected to fail; in pytest too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from roemetry.config.resolve import misfit_of
from roemetry.errors import FAULTS, PluginError, did_you_mean
from roemetry.run.stage_errors import plugin_frame
from roemetry.stages import Stage
from roemetry.stages.registry import Registered, Registry, discover, not_installed
from roemetry.testing.cases import make_stage
from roemetry.testing.checks import OF_PATTERN, Check, checks_of, name_of

if TYPE_CHECKING:
    import pytest

Outcome = Literal["passed", "failed", "expected failure", "unexpectedly passed"]


@dataclass(frozen=True, slots=True)
class Result:
    """What a check found."""

    outcome: Outcome
    """``unexpectedly passed``: the stage declares that it fails, and it does not."""
    message: str = ""
    """What was found; of an expected failure the declared reason."""

    @property
    def as_declared(self) -> bool:
        """Whether the stage does what it says it does."""
        return self.outcome in ("passed", "expected failure")


def conformance(
    registered: Registered,
    expected_failures: Mapping[str, str] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Iterator[tuple[Check, Result]]:
    """Hold a stage to every check of its kind; give each check with what it found.

    Parameters
    ----------
    expected_failures
        Checks that it fails by its method, with the reason, besides those its class declares.
    options
        The options to make it with; not given: those its fixture gives, else its default ones.

    Raises
    ------
    PluginError
        The stage cannot be imported or made, or a failure of a check is declared that its kind has not.
    """
    stage, expected = prepare_stage(registered, expected_failures, options)
    for check in checks_of(registered.entry.kind, stage.capabilities.pattern):
        yield check, run_check(stage, check, expected.get(name_of(check)))


def run_check(stage: Stage[Any], check: Check, reason: str | None = None) -> Result:
    """Run one check; `reason` says why it is expected to fail."""
    try:
        check(stage)
    # Whatever a plugin's stage raises is a result, not the end of the kit.
    except FAULTS as error:
        if reason is not None:
            return Result("expected failure", reason)
        return Result("failed", _told(error, type(stage).__module__))
    if reason is not None:
        return Result("unexpectedly passed", f"declared to fail ({reason}), but it passes")
    return Result("passed")


def _told(error: BaseException, module: str) -> str:
    """Say what a check found, or what the stage raised and where in its code."""
    if isinstance(error, AssertionError):
        return str(error)
    place = plugin_frame(error, module)
    return f"{type(error).__name__}: {error}" + ("" if place is None else f" (at {place})")


def prepare_stage(
    registered: Registered,
    expected_failures: Mapping[str, str] | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[Stage[Any], Mapping[str, str]]:
    """Make a stage, and gather what it is expected to fail: check name → reason. Raises as `conformance`."""
    entry = registered.entry
    if registered.missing is not None:
        raise PluginError(f"{entry.kind} `{entry.name}` {registered.missing}")
    cls = Registry((registered,), ()).load(registered)
    misfit = misfit_of(cls, entry.kind)
    if misfit is not None:
        raise PluginError(f"{entry.target} of {registered.provider} cannot be used: {misfit}")
    try:
        stage = make_stage(cls, options)
    except PluginError:
        raise
    except FAULTS as error:
        raise PluginError(
            f"{entry.kind} `{entry.name}` cannot be made: {type(error).__name__}: {error}",
            hint="give every option a default, or name a fixture in its capabilities",
        ) from error
    expected = {**cls.expected_failures, **(expected_failures or {})}
    known = [name_of(check) for check in checks_of(entry.kind, stage.capabilities.pattern)]
    for name in expected:
        if name not in known:
            raise PluginError(
                f"{entry.kind} `{entry.name}` declares to fail `{name}`, which is no check of its kind",
                hint=did_you_mean(name, known) or "docs/reference/conformance.md lists them",
            )
    return stage, expected


def stages_named(name: str) -> tuple[Registered, ...]:
    """Give the installed stages of a name, or raise PluginError with a close match.

    A stage (``dominant-peak``, ``extractor/dominant-peak``, ``paper/dominant-peak``), or whose stages: an
    entry point or a distribution.
    """
    registry = discover()
    found = tuple(stage for stage in registry.stages if name in _names(stage))
    if found:
        return found
    for broken in registry.broken:
        if name in (broken.provider.name, broken.provider.distribution, broken.provider.entry_point):
            raise PluginError(str(broken))
    install = not_installed(name)
    if install is not None:
        raise PluginError(f"there is no stage or plugin `{name}` yet", hint=install)
    known = sorted({each for stage in registry.stages for each in _names(stage)})
    raise PluginError(
        f"there is no stage or plugin `{name}`",
        hint=did_you_mean(name, known) or "`roemetry plugins` lists what is installed",
    )


def _names(stage: Registered) -> tuple[str, ...]:
    entry, provider = stage.entry, stage.provider
    return (
        entry.name,
        f"{entry.kind}/{entry.name}",
        f"{provider.name}/{entry.name}",
        provider.name,
        provider.entry_point,
        provider.distribution,
    )


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
        stage, expected = prepare_stage(registered, mine, (options or {}).get(entry.name))
        for check in checks_of(entry.kind, stage.capabilities.pattern):
            reason = expected.get(name_of(check))
            marks = () if reason is None else pytest.mark.xfail(strict=True, reason=reason)
            cases.append(pytest.param(stage, check, id=f"{of_stage}-{name_of(check)}", marks=marks))
    return pytest.mark.parametrize(("stage", "check"), cases)


def _keys(registered: Registered) -> set[str]:
    """Give the names by which a failure of a check of this stage may be declared."""
    kind = registered.entry.kind
    names = {name_of(check) for pattern in ("lines", *OF_PATTERN) for check in checks_of(kind, pattern)}
    return names | {f"{registered.entry.name}/{name}" for name in names}


def _refuse_unknown(expected_failures: Mapping[str, str], stages: tuple[Registered, ...]) -> None:
    known = set().union(*(_keys(registered) for registered in stages))
    for key in expected_failures:
        if key not in known:
            raise PluginError(
                f"`{key}` is no check of any of these stages",
                hint=did_you_mean(key, known) or "docs/reference/conformance.md lists them",
            )
