"""Log lines as JSON, one an event, to the standard error: what systemd's journal and every collector read."""

from __future__ import annotations

import json
import sys
import threading
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
