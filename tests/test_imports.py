"""House rules on imports: cheap where it counts, one way, no plugin in the core."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("numba", "cv2", "scipy", "open3d", "matplotlib", "jinja2")


def test_what_a_user_waits_for_imports_nothing_heavy() -> None:
    program = (
        "import sys\n"
        "from roemetry.cli.main import main\n"
        "for words in (['--help'], ['run', '--help'], ['plugins'], ['--version']):\n"
        "    sys.argv = ['roemetry', *words]\n"
        "    try: main()\n"
        "    except SystemExit as ended: assert not ended.code, words\n"
        f"    found = [name for name in {HEAVY!r} if name in sys.modules]\n"
        "    assert not found, (words, found)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_roemetry_imports_nothing_but_itself() -> None:
    program = (
        "import sys; import roemetry; print([m for m in ('numpy', 'typer', 'pydantic') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    import roemetry

    assert set(roemetry.__all__) == {name for name in dir(roemetry) if not name.startswith("__")}
    for name in roemetry.__all__:
        assert getattr(roemetry, name).__name__ == name
    with pytest.raises(AttributeError):
        _ = roemetry.nothing  # type: ignore[attr-defined]


def test_no_file_holds_two_ideas(root: Path) -> None:
    """One idea may fill a file; past 700 lines it holds two."""
    files = [*root.glob("roemetry/**/*.py"), *root.glob("plugins/**/*.py")]
    assert len(files) > 40
    assert {file.name: n for file in files if (n := len(file.read_text("utf-8").splitlines())) > 700} == {}
