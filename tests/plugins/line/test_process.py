"""A process of a line has its place to itself, and has a turn even if it is asked to stop first."""

from __future__ import annotations

import threading
from pathlib import Path

from roemetry_line.process import alone


def test_who_is_told_to_stop_before_it_begins_drains_what_waits(tmp_path: Path) -> None:
    stop = threading.Event()
    stop.set()
    with alone(tmp_path, "outlets", stop) as mine:
        assert mine
        with alone(tmp_path, "outlets", stop) as other:
            assert not other, "one of the line before drains"
    with alone(tmp_path, "outlets", stop) as again:
        assert again
