"""The history in a real PostgreSQL that crashes."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

from roemetry.errors import OutputError
from roemetry_line.history import charts_of, counts_of
from roemetry_line.outlets.database import Database, DatabaseOptions, connect
from tests.plugins.line.loopback import free_port, row

pytest.importorskip("psycopg", reason="the extra line has psycopg")
BIN = next((path.parent for path in sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))), None)


@pytest.fixture
def server():
    """A PostgreSQL of its own, not as root; gives its URL and what starts and crashes it."""
    as_user = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
    if BIN is None or (as_user and shutil.which("runuser") is None):
        pytest.skip("no PostgreSQL: apt install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="roemetry-pg-"))
    folder.chmod(0o777)
    data, port = folder / "data", free_port()

    def run(*command: str) -> None:
        subprocess.run([*as_user, *command], check=True, stdout=subprocess.DEVNULL, cwd=folder)

    def start() -> None:
        options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1"
        run(str(BIN / "pg_ctl"), "-D", str(data), "-l", str(folder / "log"), "-o", options, "-w", "start")

    def stop() -> None:
        run(str(BIN / "pg_ctl"), "-D", str(data), "-m", "immediate", "stop")  # as in a crash

    run(str(BIN / "initdb"), "-D", str(data), "-U", "roemetry", "-A", "trust", "--no-sync")
    start()
    yield f"postgresql://roemetry@127.0.0.1:{port}/postgres", start, stop
    stop()
    shutil.rmtree(folder, ignore_errors=True)


def test_rows_are_kept_once_across_a_crash(server) -> None:
    url, start, stop = server
    outlet = Database(DatabaseOptions(url=url))
    with outlet.open() as deliver:
        deliver([row(n) for n in range(1, 51)])
        stop()
        with pytest.raises(OutputError, match=r"PostgreSQL 127\.0\.0\.1"):
            deliver([row(n) for n in range(51, 61)])
    with pytest.raises(OutputError, match="does the server run"), outlet.open():
        pass
    start()
    time.sleep(0.2)
    with outlet.open() as deliver:
        deliver([row(n) for n in range(41, 61)])
    table = connect(url)
    assert table.ask("select count(*), count(distinct id) from roemetry_rows") == [(60, 60)]
    assert counts_of(table, "l", "s", 0.0) == {"measured": 60}
    assert charts_of(table, "mass_g", "l", "s", 0.0)[""].values.tolist() == [20.0 + n for n in range(1, 61)]
    table.close()
