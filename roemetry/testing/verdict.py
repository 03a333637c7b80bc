"""How a check says no."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from roemetry.errors import FAULTS, RoemetryError


class NotKeptError(AssertionError):
    """A stage does not keep the contract; the message says what was found and what was expected."""


def require(condition: bool | object, found: str) -> None:
    """Go on if the condition holds, else say what was found."""
    if not condition:
        raise NotKeptError(found)


@contextmanager
def refused(what: str, *kinds: type[RoemetryError]) -> Iterator[list[RoemetryError]]:
    """Require that the block raises one of these errors; gives a list that then holds it.

    Parameters
    ----------
    what
        What is to be refused, for the message.
    kinds
        Kinds of `RoemetryError`; none means any.
    """
    wanted = kinds or (RoemetryError,)
    caught: list[RoemetryError] = []
    try:
        yield caught
    except wanted as error:
        caught.append(error)
        return
    except FAULTS as error:
        raise NotKeptError(f"{what}: {type(error).__name__} ({error}), expected {_names(wanted)}") from error
    raise NotKeptError(f"{what} was taken, expected {_names(wanted)}")


def _names(kinds: tuple[type[RoemetryError], ...]) -> str:
    return " or ".join(f"a {kind.__name__}" for kind in kinds)
