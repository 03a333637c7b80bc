"""The command line, typed in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from roemetry.cli.main import app


def typed(*words: object, code: int = 0) -> Result:
    """Run a command, which ends with the exit code; a fault that it raises is in `exception`, with code 1."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output or done.exception
    return done
