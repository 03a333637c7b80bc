"""What every feed and outlet keeps: frames come and are counted; a receiver that is not there is named."""

from __future__ import annotations

import math
import time
from typing import Any

from roemetry.errors import OutputError
from roemetry.records.live import LineRow, LiveFrame
from roemetry.stages import Feed, Outlet
from roemetry.testing.verdict import refused, require

_WAIT_S = 10.0  # longer than any feed takes for its first frames


def check_frames_come_in_order(feed: Feed[Any]) -> None:
    """Two frames come within ten seconds, whole, each with a higher number and the host's time."""
    first, second = _taken(feed, 2)
    require(second.number > first.number, f"frame {second.number} comes after frame {first.number}")
    for live in (first, second):
        require(live.frame is not None, f"frame {live.number} is not whole: {live.fault}")
        known = live.frame is not None and not math.isnan(live.frame.time_s)
        require(known, f"frame {live.number} has no time")


def check_it_can_be_opened_again(feed: Feed[Any]) -> None:
    """A feed that was closed gives frames again when it is opened again."""
    _taken(feed, 1)
    _taken(feed, 1)


def _taken(feed: Feed[Any], many: int) -> list[LiveFrame]:
    found: list[LiveFrame] = []
    until_s = time.monotonic() + _WAIT_S
    with feed.open() as frames:
        for live in frames:
            found += [] if live is None else [live]
            if len(found) == many or time.monotonic() > until_s:
                break
    require(len(found) == many, f"{len(found)} frames came within {_WAIT_S:g} s, expected {many}")
    return found


def check_a_receiver_that_is_not_there_is_refused(outlet: Outlet[Any]) -> None:
    """Made with its fixture's options, at which nobody is, delivering is an `OutputError` with an address."""
    row = LineRow(1, "line/run/000001#1", "product", {"id": "000001#1", "status": "measured"}, "{}")
    with refused("a receiver that is not there", OutputError) as caught, outlet.open() as deliver:
        deliver([row])
    told = str(caught[0])
    require(any(mark in told for mark in ":/@"), f"the error names no address: {told}")
