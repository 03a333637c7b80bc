"""The one error class that reaches users, and its children.

Whatever a user can mend is a :class:`RoemetryError`: a sentence that says what, where, found and
expected, and a hint that says what to do. Anything else is our fault and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence


class RoemetryError(Exception):
    """A fault the user can mend: `message` says what is wrong and where, `hint` what to do about it.

    `at` holds the keys, below the options of the stage that raises it, of what is at fault.
    """

    exit_code = 1

    def __init__(self, message: str, *, hint: str | None = None, at: Sequence[str | int] = ()) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.at: tuple[str | int, ...] = tuple(at)

    def __str__(self) -> str:
        return self.message if self.hint is None else f"{self.message}\n  → {self.hint}"

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.args, self.__dict__.copy()))


class ConfigurationError(RoemetryError):
    """A recipe, rig or calibration file, or a command line, is wrong; carries every fault found at once."""

    exit_code = 2

    def __init__(
        self, faults: Sequence[str] | str, *, hint: str | None = None, at: Sequence[str | int] = ()
    ) -> None:
        self.faults = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__("\n".join(self.faults), hint=hint, at=at)


class MisfitError(ValueError):
    """Values that may each stand alone and do not go together, for the validators of options.

    For each fault: the keys that lead to it from where the validator stands, and what is wrong.
    """

    def __init__(self, *faults: tuple[Sequence[str | int], str]) -> None:
        super().__init__("; ".join(f"{'.'.join(map(str, at))}: {said}" for at, said in faults))
        self.faults = tuple((tuple(at), said) for at, said in faults)


class PluginError(RoemetryError):
    """A plugin is unknown, broken, claimed twice, or lacks something it needs."""

    exit_code = 2


class CalibrationError(RoemetryError):
    """A calibration cannot be made, read, or used with this data."""

    exit_code = 2


class DataError(RoemetryError):
    """An image or a record is not what it must be."""


class RecordError(DataError):
    """A record was made of arrays that do not go together: the fault of the stage that made it."""


class StageError(RoemetryError):
    """A stage could not do its work on this acquisition."""


FAULTS = (Exception, SystemExit)
"""What a plugin may break with and the rest goes on: ``sys.exit`` in a stage is no wish of the user's."""


class OutputError(RoemetryError):
    """Results cannot be written."""


class InterruptedRunError(RoemetryError):
    """The user, or the system, stopped a run; what was measured is whole."""

    exit_code = 130


def _rebuild(kind: type[RoemetryError], args: tuple[object, ...], state: dict[str, object]) -> RoemetryError:
    """Make an error again in another process (a worker's error crosses to the parent)."""
    error = kind.__new__(kind)
    Exception.__init__(error, *args)
    error.__dict__.update(state)
    return error


def did_you_mean(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str:
    """Ask whether the known name most like a wrong one was meant; "" where none is as like as `cutoff`."""
    import difflib  # only an error needs it

    close = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return f"did you mean `{close[0]}`?" if close else ""
