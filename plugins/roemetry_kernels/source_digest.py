"""A hash of a source file and of all of ours that it imports: what a compiled kernel was made from."""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

_IMPORT = re.compile(
    r"^[ \t]*(?:from|import)[ \t]+(roemetry_[\w.]*)(?:[ \t]+import[ \t]+(?:([^(\n]+)|\(([^)]*)\)))?",
    re.MULTILINE,
)
"""An import of ours, one to a line. Reading whole files as programs takes longest of all at the start."""


@cache
def digest(file: Path) -> str:
    """Return a hash of a source file and of every file of ours that it imports, directly or not."""
    found: dict[Path, bytes] = {}
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path] = path.read_bytes()
            waiting.extend(_imported(path))
    summed = hashlib.sha256()
    for path in sorted(found):
        summed.update(path.name.encode() + b"\0" + found[path] + b"\0")
    return summed.hexdigest()


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """Give the files of our modules that a file imports, wherever in it."""
    root = path.parent
    while (root / "__init__.py").exists():
        root = root.parent
    files = []
    for module, one_line, in_brackets in _IMPORT.findall(path.read_text("utf-8")):
        listed = re.sub(r"#.*", "", in_brackets or one_line).split(",")
        for name in (module, *(f"{module}.{words[0]}" for part in listed if (words := part.split()))):
            place = root.joinpath(*name.split("."))
            files += [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.exists()]
    return tuple(files)
