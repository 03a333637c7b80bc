"""Log lines as JSON, one an event, to the standard error: what systemd's journal and every collector read."""

from __future__ import annotations

import json
import logging
import sys
import threading
import traceback
from datetime import UTC, datetime
from typing import Any

_lock = threading.Lock()


def log(level: str, code: str, text: str, **context: Any) -> None:
    """Write one line: time, level, code, what happened in words, and run, acquisition, frame where known."""
    line = {
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "level": level,
        "code": code,
        "text": text,
        **{name: value for name, value in context.items() if value is not None},
    }
    with _lock:
        sys.stderr.write(json.dumps(line, ensure_ascii=False) + "\n")
        sys.stderr.flush()


def log_libraries() -> None:
    """Write what libraries warn of in the same form, however many lines it has."""
    logging.captureWarnings(True)
    logging.basicConfig(level=logging.WARNING, handlers=[_AsLine()], force=True)


class _AsLine(logging.Handler):
    """Hands the records of Python's own logging on."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, with what was raised."""
        raised = "".join(traceback.format_exception(*record.exc_info)) if record.exc_info else None
        log(record.levelname.lower(), "library", record.getMessage(), logger=record.name, raised=raised)
