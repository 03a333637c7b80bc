"""What code a result was made by, so that a kept result is used only where the same code would make it."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_OURS = ("roemetry", "benchmarks")


@cache
def made_by(module: str) -> str:
    """Give twelve digits of a hash over the code of a module and of all of ours that it imports.

    Imports inside functions count; comments, layout, and what other projects bring do not.

    Parameters
    ----------
    module
        Full name.
    """
    sources: dict[str, ast.Module] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = _path_of(name)
        if name in sources or path is None:
            continue
        sources[name] = ast.parse(path.read_bytes())
        waiting += _imported(sources[name], name if path.name == "__init__.py" else name.rpartition(".")[0])
    told = hashlib.sha256()
    for name in sorted(sources):
        told.update(name.encode() + b"\0" + ast.dump(sources[name]).encode() + b"\0")
    return told.hexdigest()[:12]


def _imported(source: ast.Module, package: str) -> Iterator[str]:
    """Give modules that may be meant: ``from a import b`` is `a`, and perhaps ``a.b``."""
    for node in ast.walk(source):
        if isinstance(node, ast.Import):
            yield from (found for alias in node.names for found in _with_packages(alias.name))
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            where = ".".join([*above, *([node.module] if node.module else [])])
            yield from _with_packages(where)
            yield from (f"{where}.{alias.name}" for alias in node.names)


def _with_packages(name: str) -> Iterator[str]:
    """Give a module and the packages it lies in: their code runs with it."""
    parts = name.split(".")
    yield from (".".join(parts[:end]) for end in range(1, len(parts) + 1))


def _path_of(name: str) -> Path | None:
    """Find a module's file without importing anything above it but its outermost package's place."""
    outermost, *inner = name.split(".")
    if not outermost.startswith(_OURS):
        return None
    spec = find_spec(outermost)
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        place = Path(folder, *inner)
        for path in (place / "__init__.py", place.with_suffix(".py")):
            if path.is_file():
                return path
    return None
