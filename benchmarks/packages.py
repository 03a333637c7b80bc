"""The diagram of the packages in docs/explanation/architecture.md, made from the imports.

``python -m benchmarks packages`` writes docs/images/packages.svg anew; a test compares it with the imports.
"""

from __future__ import annotations

import argparse
import ast
import sys
from pathlib import Path

from roemetry.html.plots import WIDTH, box, line, number, text

ROOT = Path(__file__).parents[1]
DIAGRAM = ROOT / "docs" / "images" / "packages.svg"
PLUGINS, TOOLS, KERNELS = "plugins", "tools", "kernels"

_BOX_WIDTH, _BOX_HEIGHT, _ROW_HEIGHT, _COLUMN_WIDTH = 72.0, 26.0, 60.0, WIDTH / 4
_COLUMNS = {"targets": 0, "testing": 2, "html": 2, PLUGINS: 3, KERNELS: 3}
"""Beside the core's spine, so that no arrow runs behind a box."""
_STYLE = (
    "text{font:12px sans-serif;text-anchor:middle;fill:#222}"
    ".package{fill:#eef3f7;stroke:#4a6b82}.arrow{fill:none;stroke:#8a9aa6;stroke-width:1.1}"
)


def imports_between_packages() -> dict[str, set[str]]:
    """Return, by package, the packages it imports from anywhere in its files, also inside functions."""
    found: dict[str, set[str]] = {}
    for path in sorted([*ROOT.glob("roemetry/*/**/*.py"), *ROOT.glob("plugins/**/*.py")]):
        parts = path.relative_to(ROOT).with_suffix("").parts
        own = _package(parts[1:] if parts[0] == "plugins" else parts)
        found.setdefault(own, set())
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names = [f"{node.module}.{one.name}" for one in node.names]
            elif isinstance(node, ast.Import):
                names = [one.name for one in node.names]
            for name in names:
                if name.startswith("roemetry") and name.count("."):
                    found[own].add(_package(tuple(name.split("."))))
    for own, others in found.items():
        others.discard(own)
        others &= {*found, "errors"}
    found["errors"] = set()
    return found


def _package(parts: tuple[str, ...]) -> str:
    if parts[0] == "roemetry":
        return parts[1]
    family = parts[0].removeprefix("roemetry_")
    return family if family in (TOOLS, KERNELS) else PLUGINS


def direct(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Leave out every arrow that others already imply: what a package reaches through another one."""
    reached: dict[str, set[str]] = {}

    def reach(package: str) -> set[str]:
        if package not in reached:
            reached[package] = set(imports[package]).union(*(reach(other) for other in imports[package]))
        return reached[package]

    return {
        package: {one for one in others if not any(one in reach(other) for other in others - {one})}
        for package, others in imports.items()
    }


def floors_of(imports: dict[str, set[str]]) -> dict[str, int]:
    """Return by package how many floors lie above it: each stands just below the lowest that imports it."""
    floors: dict[str, int] = {}

    def floor(package: str) -> int:
        if package not in floors:
            above = [other for other, used in imports.items() if package in used]
            floors[package] = 1 + max(map(floor, above), default=-1)
        return floors[package]

    return {package: floor(package) for package in imports}


def drawing() -> str:
    """Return the diagram as SVG: a box for each package, an arrow from each down to those it imports."""
    imports = imports_between_packages()
    floors = floors_of(imports)
    places = {
        package: (_COLUMN_WIDTH * (_COLUMNS.get(package, 1) + 0.5), 20.0 + _ROW_HEIGHT * below)
        for package, below in floors.items()
    }
    body = []
    for package, others in sorted(direct(imports).items()):
        x, y = places[package]
        body += [
            line(x, y + _BOX_HEIGHT / 2, places[to][0], places[to][1] - _BOX_HEIGHT / 2, "arrow")
            for to in sorted(others)
        ]
    for package, (x, y) in sorted(places.items()):
        body += [
            box(x - _BOX_WIDTH / 2, y - _BOX_HEIGHT / 2, _BOX_WIDTH, _BOX_HEIGHT, "package"),
            text(x, y + 4, package),
        ]
    height = number(20.0 + _ROW_HEIGHT * (max(floors.values()) + 1) - _BOX_HEIGHT)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {number(WIDTH)} {height}">'
    return head + f"<style>{_STYLE}</style>" + "".join(body) + "</svg>\n"


def main() -> None:
    """Write the drawing."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    DIAGRAM.write_text(drawing(), encoding="utf-8")
    sys.stdout.write(f"{DIAGRAM.relative_to(ROOT)}\n")
