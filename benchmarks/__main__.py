"""``python -m benchmarks NAME``: what the documentation states, measured again."""

from __future__ import annotations

import ast
import importlib
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, before numpy is imported


def _benchmarks() -> dict[str, str]:
    """Give the first line of each module with a ``main``, by name."""
    here, found = Path(__file__).parent, {}
    for path in sorted([*here.glob("*.py"), *here.glob("*/__init__.py")]):
        tree = ast.parse(path.read_text("utf-8"))
        name = path.parent.name if path.stem == "__init__" else path.stem
        functions = {one.name for one in tree.body if isinstance(one, ast.FunctionDef)}
        if "main" in functions and name != "__main__":
            found[name] = (ast.get_docstring(tree) or "").splitlines()[0].rpartition("``: ")[2]
    return found


BENCHMARKS = _benchmarks()


def main() -> int:
    """Run the benchmark that the command line names."""
    if len(sys.argv) < 2 or sys.argv[1] not in BENCHMARKS:
        print("python -m benchmarks NAME [options]")
        for name, what in BENCHMARKS.items():
            print(f"  {name:16} {what}")
        return 2
    name = sys.argv.pop(1)
    sys.argv[0] = f"python -m benchmarks {name}"
    importlib.import_module(f"benchmarks.{name}").main()
    return 0


if __name__ == "__main__":
    sys.exit(main())
