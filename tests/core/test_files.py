"""Writing: whole lines or none, whole files or the old ones, whatever fails."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from roemetry.errors import OutputError
from roemetry.io.files import LineFile, make_folder, write_whole


def test_a_half_line_is_taken_away(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    path.write_bytes(b'{"a": 1}\n{"b": 2}\n{"c"')
    with LineFile(path) as record:
        record.append('{"d": 4}')
    assert path.read_text(encoding="utf-8") == '{"a": 1}\n{"b": 2}\n{"d": 4}\n'


def test_a_file_that_is_all_one_half_line(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    path.write_bytes(b"x" * 200_000)
    with LineFile(path):
        pass
    assert path.read_bytes() == b""


def test_a_failed_append_leaves_nothing_of_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "record.jsonl"
    real = os.write

    def disk_fills_up(descriptor: int, data: bytes) -> int:
        if b"second" in data:
            real(descriptor, data[:3])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", disk_fills_up)
    with LineFile(path) as record:
        record.append("first")
        with pytest.raises(OutputError, match="No space left"):
            record.append("second")
        record.append("third")
    assert path.read_text(encoding="utf-8") == "first\nthird\n"


def test_a_file_size_limit_of_the_system(tmp_path: Path) -> None:
    """A real refusal by the kernel, in a process of its own: writes past 1 kB fail."""
    path = tmp_path / "record.jsonl"
    program = (
        "import sys, pathlib\n"
        "from roemetry.io.files import LineFile\n"
        "from roemetry.errors import OutputError\n"
        "try:\n"
        "    with LineFile(pathlib.Path(sys.argv[1])) as record:\n"
        "        for _ in range(100): record.append('x' * 99)\n"
        "except OutputError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)),
    )
    assert "cannot be written" in done.stdout
    assert path.read_text(encoding="utf-8") == ("x" * 99 + "\n") * 10


def test_write_whole_keeps_the_old_file_when_it_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    write_whole(path, "old")

    def refuse(self: Path, target: Path) -> Path:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OutputError, match="Input/output error"):
        write_whole(path, "new")
    assert path.read_text(encoding="utf-8") == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(OutputError, match="cannot be written"):
        make_folder(tmp_path / "file" / "results")
