"""The command line, typed in this process."""

from __future__ import annotations

import sys

import pytest
from typer.testing import CliRunner, Result

from roemetry.cli.main import app, main


def typed(*words: object, code: int = 0) -> Result:
    """Run a command, which ends with the exit code; a fault that it raises is in `exception`, with code 1."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output or done.exception
    return done


def exit_code(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """Run the command as its entry point does, which says faults in words; give the exit code."""
    monkeypatch.setattr(sys, "argv", ["roemetry", *map(str, words)])
    with pytest.raises(SystemExit) as caught:
        main()
    return int(caught.value.code or 0)
