"""The drawing of the rooms in docs/explanation/architecture.md, made from the imports.

``python -m benchmarks rooms`` writes docs/images/rooms.svg anew; a test compares it with the imports.
"""

from __future__ import annotations

import argparse
import ast
import sys
from pathlib import Path

from roemetry.html.plots import WIDTH, box, line, number, text

ROOT = Path(__file__).parents[1]
DRAWING = ROOT / "docs" / "images" / "rooms.svg"
PLUGINS, TOOLS, KERNELS = "plugins", "tools", "kernels"

_BOX_WIDTH, _BOX_HEIGHT, _ROW_HEIGHT, _COLUMN_WIDTH = 72.0, 26.0, 60.0, WIDTH / 4
_COLUMNS = {"targets": 0, "testing": 2, "html": 2, PLUGINS: 3, KERNELS: 3}
"""Beside the core's spine, so that no arrow runs behind a box."""
_STYLE = (
    "text{font:12px sans-serif;text-anchor:middle;fill:#222}"
    ".room{fill:#eef3f7;stroke:#4a6b82}.arrow{fill:none;stroke:#8a9aa6;stroke-width:1.1}"
)


def imports_between_rooms(root: Path = ROOT) -> dict[str, set[str]]:
    """Return, by room, the rooms it imports from anywhere in its files, also inside functions."""
    found: dict[str, set[str]] = {}
    for path in sorted([*root.glob("roemetry/*/**/*.py"), *root.glob("plugins/**/*.py")]):
        parts = path.relative_to(root).with_suffix("").parts
        own = _room(parts[1:] if parts[0] == "plugins" else parts)
        found.setdefault(own, set())
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names = [f"{node.module}.{one.name}" for one in node.names]
            elif isinstance(node, ast.Import):
                names = [one.name for one in node.names]
            for name in names:
                if name.startswith("roemetry") and name.count("."):
                    found[own].add(_room(tuple(name.split("."))))
    for own, others in found.items():
        others.discard(own)
        others &= {*found, "errors"}
    found["errors"] = set()
    return found


def _room(parts: tuple[str, ...]) -> str:
    if parts[0] == "roemetry":
        return parts[1]
    family = parts[0].removeprefix("roemetry_")
    return family if family in (TOOLS, KERNELS) else PLUGINS


def direct(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Leave out every arrow that others already imply: what a room reaches through another one."""
    reached: dict[str, set[str]] = {}

    def reach(room: str) -> set[str]:
        if room not in reached:
            reached[room] = set(imports[room]).union(*(reach(other) for other in imports[room]))
        return reached[room]

    return {
        room: {one for one in others if not any(one in reach(other) for other in others - {one})}
        for room, others in imports.items()
    }


def floors_of(imports: dict[str, set[str]]) -> dict[str, int]:
    """Return by room how many floors lie above it: each stands just below the lowest that imports it."""
    floors: dict[str, int] = {}

    def floor(room: str) -> int:
        if room not in floors:
            above = [other for other, used in imports.items() if room in used]
            floors[room] = 1 + max(map(floor, above), default=-1)
        return floors[room]

    return {room: floor(room) for room in imports}


def drawing() -> str:
    """Return the drawing as SVG: a box for each room, an arrow from each room down to those it builds on."""
    imports = imports_between_rooms()
    floors = floors_of(imports)
    places = {
        room: (_COLUMN_WIDTH * (_COLUMNS.get(room, 1) + 0.5), 20.0 + _ROW_HEIGHT * below)
        for room, below in floors.items()
    }
    body = []
    for room, others in sorted(direct(imports).items()):
        x, y = places[room]
        body += [
            line(x, y + _BOX_HEIGHT / 2, places[to][0], places[to][1] - _BOX_HEIGHT / 2, "arrow")
            for to in sorted(others)
        ]
    for room, (x, y) in sorted(places.items()):
        body += [
            box(x - _BOX_WIDTH / 2, y - _BOX_HEIGHT / 2, _BOX_WIDTH, _BOX_HEIGHT, "room"),
            text(x, y + 4, room),
        ]
    height = number(20.0 + _ROW_HEIGHT * (max(floors.values()) + 1) - _BOX_HEIGHT)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {number(WIDTH)} {height}">'
    return head + f"<style>{_STYLE}</style>" + "".join(body) + "</svg>\n"


def main() -> None:
    """Write the drawing."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    DRAWING.write_text(drawing(), encoding="utf-8")
    sys.stdout.write(f"{DRAWING.relative_to(ROOT)}\n")
