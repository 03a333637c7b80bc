"""The operator's page: who may do what, and what other pages and strangers cannot."""

from __future__ import annotations

import asyncio
import json
import shutil
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roemetry_line.line_file import Line
from roemetry_line.outbox import NewRow, Outbox
from roemetry_line.outlets.database import COLUMNS, connect
from roemetry_line.page import app as page_app
from roemetry_line.page.app import LinePage, snapshot_of
from roemetry_line.page.users import Users, read_users, set_password
from roemetry_line.runs import tiff_of

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # some releases ask for a package that takes the place of httpx
    starlette_requests = pytest.importorskip("starlette.requests")
    starlette = pytest.importorskip("starlette.testclient", reason="httpx is not installed")


@pytest.fixture(scope="module")
def users_file(tmp_path_factory) -> Path:
    """Three users: hashing their passwords takes long on purpose."""
    folder = tmp_path_factory.mktemp("users")
    for name, role in (("vera", "viewer"), ("otto", "operator"), ("erika", "engineer")):
        path = set_password(folder, name, role, f"{name}'s word")
    return path


@pytest.fixture
def at(line_file, users_file):
    path = line_file(("recipe: recipe.yaml", "recipe: recipe.yaml\n    choices: [other.yaml]"))
    shutil.copy(path.parent / "recipe.yaml", path.parent / "other.yaml")
    loaded = Line.load(path)
    outbox = Outbox(loaded.folder)
    shutil.copy(users_file, loaded.folder)  # with its mode
    page = LinePage(loaded, outbox, Users(loaded.folder)).app(["127.0.0.1", "localhost"])
    return loaded, outbox, starlette.TestClient(page, base_url="http://127.0.0.1")


def log_in(client: Any, name: str) -> dict[str, str]:
    answer = client.post("/log-in", json={"name": name, "password": f"{name}'s word"})
    assert answer.status_code == 200
    return {"X-CSRF-Token": client.get("/who").json()["csrf"], "Content-Type": "application/json"}


def test_roles_may_do_what_they_may(at) -> None:
    loaded, outbox, client = at
    outbox.raise_alarm("one", "camera", "gone")
    number = outbox.alarms()[0]["n"]
    other = str(loaded.stations[0].recipes[1])
    expected = {
        None: (401, 401, 401),
        "vera": (403, 403, 403),
        "otto": (200, 200, 403),
        "erika": (404, 200, 200),
    }
    for name, (acknowledged, checked, chosen) in expected.items():
        client.cookies.clear()
        headers = {} if name is None else log_in(client, name)
        assert client.post(f"/acknowledge/{number}", headers=headers).status_code == acknowledged, name
        assert client.post("/check/one", headers=headers).status_code == checked, name
        assert (outbox.last_check("one") is None) == (name in (None, "vera")), name
        asked = client.post("/recipe/one", headers=headers, content=json.dumps({"recipe": other}))
        assert asked.status_code == chosen, name
    assert outbox.requested_recipe("one") == other
    (alarm,) = (one for one in outbox.alarms() if one["n"] == number)
    assert alarm["acknowledged_by"] == "otto"


def test_neither_another_page_nor_an_unknown_recipe_gets_through(at) -> None:
    _, outbox, client = at
    outbox.raise_alarm("one", "camera", "gone")
    headers = log_in(client, "erika")
    number = outbox.alarms()[0]["n"]
    for without in (
        {"X-CSRF-Token": ""},
        {"X-CSRF-Token": "guessed"},
        {"X-CSRF-Token": b"gu\xe4ssed"},
        {"Origin": "http://elsewhere.example"},
        {"Origin": "null"},
    ):
        assert client.post(f"/acknowledge/{number}", headers=headers | without).status_code == 403, without
    assert client.post(f"/acknowledge/{number}", headers=headers).status_code == 200
    for host in ("elsewhere.example", "127.0.0.1.elsewhere.example", ""):
        assert client.get("/who", headers={"Host": host}).status_code == 400, host
    answer = client.post("/recipe/one", headers=headers, content=json.dumps({"recipe": "/etc/passwd"}))
    assert answer.status_code == 400
    assert outbox.requested_recipe("one") is None


def test_a_login_makes_a_new_session(at) -> None:
    _, _, client = at
    planted = {"Cookie": "roemetry_session=planted-by-somebody"}
    password = {"name": "otto", "password": "otto's word"}
    answer = client.post("/log-in", json=password, headers=planted)
    assert answer.status_code == 200
    client.cookies.clear()
    assert client.get("/who", headers=planted).json()["role"] == "viewer"
    first = answer.cookies["roemetry_session"]
    assert first != "planted-by-somebody"
    again = client.post("/log-in", json=password, headers={"Cookie": f"roemetry_session={first}"})
    client.cookies.clear()
    assert again.cookies["roemetry_session"] != first
    old = client.get("/who", headers={"Cookie": f"roemetry_session={first}"})
    assert old.json()["role"] == "viewer", "the session before has ended"
    told = answer.headers["set-cookie"].lower()
    assert "httponly" in told
    assert "samesite=strict" in told


def test_passwords_are_hashed_and_a_name_is_locked_after_five_wrong_ones(at) -> None:
    loaded, _, client = at
    assert "word" not in (loaded.folder / "users.yaml").read_text("utf-8").replace("password", "")
    assert (loaded.folder / "users.yaml").stat().st_mode & 0o077 == 0
    assert read_users(loaded.folder / "users.yaml")["otto"].role == "operator"
    for _ in range(5):
        assert client.post("/log-in", json={"name": "otto", "password": "wrong"}).status_code == 403
    assert client.post("/log-in", json={"name": "otto", "password": "otto's word"}).status_code == 403
    assert client.post("/log-in", json={"name": "nobody", "password": ""}).status_code == 403


def test_no_path_leads_outside(at) -> None:
    loaded, _, client = at
    picture = tiff_of(np.zeros((8, 8), np.uint8))
    for run in ("one/r-1", "."):  # a picture that may be asked for, and one that must not
        images = loaded.folder / "runs" / run / "images"
        images.mkdir(parents=True)
        (images / "000001.tif").write_bytes(picture)
    assert client.get("/spooled/one/r-1/000001.jpg").status_code == 200
    for path in (
        "/picture/../../etc/passwd",
        "/picture/..%2f..%2fusers",
        "/picture/other",
        "/spooled/one/..%2f..%2f../users.jpg",
        "/spooled/one/%2e%2e/000001.jpg",
        "/spooled/one/run/..%2fx.jpg",
        "/static/../app.py",
        "/static/%2e%2e/app.py",
        "/trend/other",
        "/checks/other",
    ):
        assert client.get(path).status_code in (400, 404), path


def test_bodies_that_are_none_are_refused_and_every_answer_keeps_other_pages_out(at) -> None:
    for content, kind, status in (
        (b"x" * 20_000, "application/json", 413),
        (b"[" * 9_000, "application/json", 400),
        (b"[]", "application/json", 400),
        (b"\xff", "application/json", 400),
        (b"{}", "text/plain", 415),
    ):
        answer = at[2].post("/log-in", content=content, headers={"Content-Type": kind})
        assert answer.status_code == status, content[:9]
    for path in ("/", "/who", "/static/page.js", "/nothing"):
        headers = at[2].get(path).headers
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"


def test_a_body_that_does_not_come_is_not_waited_for(monkeypatch) -> None:
    monkeypatch.setattr(page_app, "_BODY_S", 0.01)
    head = {"type": "http", "headers": [(b"content-type", b"application/json")]}
    body = page_app._body(starlette_requests.Request(head, lambda: asyncio.sleep(60)))
    # in a thread: a browser of another test may have a loop running in this one
    with ThreadPoolExecutor(1) as thread, pytest.raises(page_app.RefusedError, match="did not come within"):
        thread.submit(asyncio.run, body).result()


def test_metrics_are_what_prometheus_reads(at) -> None:
    _, outbox, client = at
    outbox.beat("station one", "running", {"frames": 7, "latency_counts": [1] * 11, "latency_ms_sum": 55.0,
                                           "results": {'odd "one"\n': 2}})  # fmt: skip
    text = client.get("/metrics").text
    assert 'roemetry_frames_total{line="line-1",station="one"} 7' in text
    assert 'roemetry_latency_seconds_bucket{line="line-1",station="one",le="+Inf"} 11' in text
    assert r'result="odd \"one\"\n"' in text
    for line in text.splitlines():
        assert line.startswith("# ") or line.rpartition(" ")[2].replace(".", "", 1).isdigit(), line


def test_what_is_shown_is_what_the_outbox_says_and_a_full_disk(at, monkeypatch) -> None:
    loaded, outbox, _ = at
    outbox.put([NewRow("l/r/000001#1", "one", "r", "product", {"id": "000001#1", "status": "failed"}, "{}")])
    outbox.beat("station one", "running", {"last_frame_s": 0.0})
    outbox.raise_alarm("one", "camera", "no frames from the camera: unplugged")
    shown = snapshot_of(loaded, outbox)
    assert shown["stations"][0]["last"]["summary"]["status"] == "failed"
    assert len(shown["stations"][0]["rejects"]) == 1
    assert [alarm["text"] for alarm in shown["alarms"]] == ["no frames from the camera: unplugged"]
    json.dumps(shown, allow_nan=False)
    monkeypatch.setattr("roemetry_line.runs.disk_free", lambda _: 0.004)  # nothing can be written then
    (alarm,) = (one for one in snapshot_of(loaded, outbox)["alarms"] if one["code"] == "disk-full")
    assert alarm["text"].startswith(f"the disk is full: 4 MB are free for {loaded.folder}")
    assert alarm["ended"] is None


def test_charts_and_checks_are_drawn(at) -> None:
    loaded, _, client = at
    assert client.get("/trend/one").json() == {"counts": {}, "charts": []}, "nothing is measured yet"
    table = connect(loaded.history_url)
    rows = []
    for n in range(40):
        found = dict.fromkeys(COLUMNS) | {
            "line": "line-1" if n < 30 else "another", "run": "r", "id": str(n), "station": "one",
            "kind": "product", "text": "{}", "time_s": time.time() - 60.0 * n, "mass_g": 20.0 + n % 3,
            "status": "measured", "product": "<b>roe</b>",
        }  # fmt: skip
        rows.append([found[name] for name in COLUMNS])
    table.insert(rows)
    table.close()
    told = client.get("/trend/one?figure=mass_g&hours=24").json()
    (chart,) = told["charts"]
    assert chart["product"] == "<b>roe</b>", "the page writes it as text"
    assert chart["means"].startswith("<svg")
    assert chart["ewma"].startswith("<svg")
    assert "30 products" in chart["said"]
    assert client.get("/checks/one").json() == {"checks": 0, "plots": []}
