"""What receivers and the page may know and ask of a line: its state, and which recipes measure."""

from __future__ import annotations

from typing import Literal

from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox


class Control:
    """What an outlet may know and ask of the line."""

    def __init__(self, line: Line, outbox: Outbox, outlet: str = "") -> None:
        self._line, self._outbox, self._outlet = line, outbox, outlet

    def state(self) -> Literal["starting", "running", "faulty"]:
        """Say whether every station measures."""
        names = [one.name for one in self._line.stations]
        if any(one["ended"] is None and one["level"] == "alarm" for one in self._outbox.alarms(20)
               if one["station"].removeprefix("station ") in names):  # fmt: skip
            return "faulty"
        health = self._outbox.health()
        told = [health.get(f"station {name}") for name in names]
        return "running" if all(one and one["state"] == "running" for one in told) else "starting"

    def recipes(self) -> dict[str, list[str]]:
        """Give each station's recipes, the one that measures first."""
        found = {}
        for station in self._line.stations:
            known = [str(path) for path in station.recipes]
            chosen = self._outbox.requested_recipe(station.name) or known[0]
            found[station.name] = sorted(known, key=lambda path: path != chosen)
        return found

    def choose(self, station: str, recipe: str, who: str) -> bool:
        """Let a station measure with another of its recipes; False where it has no such recipe."""
        if recipe not in self.recipes().get(station, ()):
            return False
        self._outbox.wish(station, recipe, who)
        self._outbox.raise_alarm(station, "recipe-chosen", f"{who} chose {recipe}", "note")
        return True

    def warn(self, text: str | None) -> None:
        """Show the operator what is wrong with a receiver; None: nothing any more."""
        if text is None:
            self._outbox.end_alarm(self._outlet, "receiver")
        else:
            self._outbox.raise_alarm(self._outlet, "receiver", text, "warning")
