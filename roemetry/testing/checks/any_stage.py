"""What every stage keeps, whatever its kind."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

from pydantic import ValidationError

from roemetry.errors import RoemetryError
from roemetry.stages import Stage, StageOptions
from roemetry.testing.cases import cases_for
from roemetry.testing.verdict import CheckFailedError, difference, require

_THREADS = 4  # at once: enough to meet each other on two cores


def check_same_input_gives_same_result(stage: Stage[Any]) -> None:
    """The same input gives the same result, to the last bit."""
    case = cases_for(stage).ordinary
    _agree(case.call(stage), case.call(stage), "the second call gives another result")


def check_keeps_nothing_between_calls(stage: Stage[Any]) -> None:
    """A stage has no state: earlier calls do not change a result."""
    cases = cases_for(stage)
    fresh = type(stage)(stage.options)
    cases.other.call(stage)
    used = cases.ordinary.call(stage)
    _agree(cases.ordinary.call(fresh), used, "after another input the result is another one")


def check_leaves_its_input_alone(stage: Stage[Any]) -> None:
    """A stage accepts read-only arrays and does not change its input."""
    case = cases_for(stage).ordinary
    before = copy.deepcopy(case.inputs)
    case.call(stage)
    _agree(before, case.inputs, "the input was changed")


def check_threads_agree(stage: Stage[Any]) -> None:
    """Four threads that use one stage at the same time get the same results as one."""
    cases = cases_for(stage)
    both = cases.ordinary, cases.other
    alone = [case.call(stage) for case in both]
    together = Barrier(_THREADS)

    def call(number: int) -> Any:
        together.wait()
        return both[number % 2].call(stage)

    with ThreadPoolExecutor(_THREADS) as pool:
        at_once = list(pool.map(call, range(_THREADS)))
    for number, result in enumerate(at_once):
        _agree(alone[number % 2], result, "a thread gets another result")


def check_crosses_to_another_process(stage: Stage[Any]) -> None:
    """A stage can be pickled, as worker processes require, and gives the same results afterwards."""
    try:
        other = pickle.loads(pickle.dumps(stage))
    except Exception as error:
        raise CheckFailedError(f"it cannot be pickled: {type(error).__name__}: {error}") from error
    case = cases_for(stage).ordinary
    _agree(case.call(stage), case.call(other), "the pickled stage gives another result")


def check_nothing_in_gives_nothing_out(stage: Stage[Any]) -> None:
    """Empty input gives an empty result or a named `RoemetryError`, never another exception."""
    case = cases_for(stage).empty
    if case is None:
        return
    try:
        result = case.call(stage)
    except RoemetryError as error:
        require(error.message.strip(), f"it raises a {type(error).__name__} that says nothing")
        return
    require(case.is_empty(result), f"out of nothing it makes {result!r:.200}")


def check_options_come_back_from_their_dump(stage: Stage[Any]) -> None:
    """Options can be dumped and read again, so that a run can be repeated from its stored options."""
    options = stage.options
    _agree(options, type(options).model_validate(options.model_dump()), "read again, options are others")
    as_json = type(options).model_validate_json(options.model_dump_json())
    _agree(options, as_json, "read again from JSON, options are others")


def check_options_are_frozen_and_closed(stage: Stage[Any]) -> None:
    """Options cannot be changed, and an unknown option is refused."""
    options = stage.options
    require(type(options).model_config.get("frozen"), "options are not frozen")
    try:
        type(options).model_validate({**options.model_dump(), "no_such_option": 1})
    except ValidationError:
        return
    raise CheckFailedError("an option that does not exist is accepted without an error")


def check_every_option_is_described(stage: Stage[Any]) -> None:
    """Every option has a description."""
    schema = type(stage.options).model_json_schema()
    bare = [
        f"{model}.{name}"
        for model, properties in _models(type(stage.options), schema)
        for name, field in properties.items()
        if not field.get("description", "").strip()
    ]
    require(not bare, f"options without a description: {', '.join(bare)}")


def check_every_number_is_bounded(stage: Stage[Any]) -> None:
    """Every numeric option has a bound, so that absurd values are refused before anything runs."""
    schema = type(stage.options).model_json_schema()
    loose = [
        f"{model}.{name}"
        for model, properties in _models(type(stage.options), schema)
        for name, field in properties.items()
        if any(_is_loose(choice) for choice in field.get("anyOf", [field]))
    ]
    require(not loose, f"numbers without a bound: {', '.join(loose)}")


OF_CALLS = (
    check_same_input_gives_same_result,
    check_keeps_nothing_between_calls,
    check_leaves_its_input_alone,
    check_threads_agree,
    check_crosses_to_another_process,
    check_nothing_in_gives_nothing_out,
)
OF_OPTIONS = (
    check_options_come_back_from_their_dump,
    check_options_are_frozen_and_closed,
    check_every_option_is_described,
    check_every_number_is_bounded,
)
CHECKS = OF_CALLS + OF_OPTIONS

_BOUNDS = {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "enum", "const"}


def _agree(one: Any, other: Any, otherwise: str) -> None:
    found = difference(one, other)
    require(found is None, f"{otherwise}: {found}")


def _models(options: type[StageOptions], schema: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Give the properties of the option model and of every model within it."""
    nested = schema.get("$defs", {})
    both = {options.__name__: schema, **nested}
    return [(name, model.get("properties", {})) for name, model in both.items()]


def _is_loose(field: dict[str, Any]) -> bool:
    return field.get("type") in ("number", "integer") and not _BOUNDS & set(field)
