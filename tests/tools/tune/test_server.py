"""The server answers this machine's own page and nobody else's."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from roemetry.errors import ConfigurationError
from roemetry_tools.tune import server
from roemetry_tools.tune.session import Session
from tests.tools.tune.unpacking import unpacked

starlette = pytest.importorskip("starlette.testclient", reason="httpx is not installed")


JSON = {"content-type": "application/json"}


@pytest.fixture
def client(line: Callable[..., Path]) -> Any:
    return starlette.TestClient(server.app_of(Session(line()), "key"), base_url="http://127.0.0.1:8000/key")


def test_the_page_and_all_it_names_are_served_from_here(client: Any) -> None:
    page = client.get("/")
    assert page.status_code == 200
    assert "default-src 'self'" in page.headers["content-security-policy"]
    for name in re.findall(r'(?:src|href)="([^"]+)"', page.text):
        assert client.get(name).status_code == 200, name
    folder = Path(server.__file__).parent / "page"
    for file in folder.iterdir():
        text = file.read_text("utf-8").replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|//cdn|@import", text), file.name
        for name in re.findall(r'from "\./([^"]+)"', text):
            assert (folder / name).is_file()
    for other in ("/page/../session.py", "/page/%2e%2e/session.py", "/page/%2e%2e%2fsession.py"):
        assert client.get(other).status_code == 404
    told = client.get("/recipe").json()
    assert told["product"] == "test dome"
    assert [stage["kind"] for stage in told["stages"]][:3] == ["extractor", "aligner", "coder"]
    extractor = told["stages"][0]
    assert extractor["chosen"] == {"use": "dominant-peak", "options": {"threshold": "60"}}
    assert {"dominant-peak", "steger"} <= {choice["use"] for choice in extractor["choices"]}


def test_a_wish_is_answered_and_its_picture_is_there(client: Any) -> None:
    answer = client.post("/answer", json={"acquisition": "p03"})
    header, arrays = unpacked(answer.content)
    assert header["acquisition"] == "p03"
    assert arrays["peaks.x_px"].size > 500
    picture = client.get(f"/picture/{header['image']['key']}.png")
    assert picture.content.startswith(b"\x89PNG")
    assert client.get("/picture/0.png").status_code == 404


def test_saving_answers_with_the_new_recipe_or_the_reason(client: Any) -> None:
    wish = {"stages": {"extractor": {"use": "dominant-peak", "options": {"threshold": "70"}}}}
    saved = client.post("/save", json={"wish": wish})
    assert saved.json()["recipe"]["stages"][0]["chosen"]["options"]["threshold"] == "70"
    for name in ("../x", "a\0b", "x" * 300, "\x1b[2J", "a\n"):
        refused = client.post("/save", json={"wish": wish, "name": name})
        assert refused.status_code == 400
        assert "not a file name" in refused.json()["said"]
    lone = client.post("/save", content=b'{"wish": {}, "name": "\\ud800"}', headers=JSON)
    assert lone.status_code == 400


@pytest.mark.parametrize(
    "sent",
    [
        {"content": b"{", "headers": {"content-type": "application/json"}},
        {"json": {"bogus": 1}},
        {"json": {"stages": {"extractor": {"use": ""}}}},
        {"content": b" " * 1_000_001, "headers": {"content-type": "application/json"}},
        {"content": json.dumps({"acquisition": ""}).encode(), "headers": {"content-type": "text/plain"}},
    ],
    ids=["no JSON", "unknown key", "empty name", "too long", "as another site's form would send it"],
)
def test_what_the_page_would_not_send_is_refused_in_words(sent: dict[str, Any], client: Any) -> None:
    answer = client.post("/answer", **sent)
    assert answer.status_code == 400
    assert len(answer.json()["said"]) > 10
    assert "Traceback" not in answer.text


def test_a_request_under_another_name_is_refused(client: Any) -> None:
    assert client.get("/recipe", headers={"host": "evil.example:8000"}).status_code == 400
    assert client.get("/recipe", headers={"host": "localhost:8000"}).status_code == 200
    assert client.get("http://127.0.0.1:8000/recipe").status_code == 404  # without the token
    for origin, status in (("http://evil.example", 403), ("null", 403), ("http://127.0.0.1:8000", 200)):
        assert client.post("/answer", json={}, headers={"origin": origin}).status_code == status


def test_a_value_nested_too_deeply_is_a_fault_of_its_field(client: Any) -> None:
    wish = {"stages": {"extractor": {"use": "dominant-peak", "options": {"threshold": "[" * 50_000}}}}
    assert unpacked(client.post("/answer", json=wish).content)[0]["faults"]
    assert client.post("/save", json={"wish": wish}).status_code == 400


def test_the_verb_serves_this_machine_alone_and_stops_in_peace(line: Callable[..., Path]) -> None:
    recipe = line()
    command = [sys.executable, "-m", "roemetry", "tune", str(recipe)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stderr is not None
            said = process.stdout.readline()
            address = re.search(r"http://127\.0\.0\.1:\d+/[\w-]{22}/", said)
            assert address, said
            with urllib.request.urlopen(address[0] + "recipe", timeout=30) as answer:
                assert json.load(answer)["product"] == "test dome"
            port = int(address[0].split(":")[2].split("/")[0])
            with pytest.raises(ConfigurationError, match=f"--port {port}: cannot be used"):
                server.serve(Session(recipe), port, print)
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
            assert process.stderr.read() == ""
        finally:
            if process.poll() is None:
                os.kill(process.pid, signal.SIGKILL)


def test_images_are_served_from_the_recipes_folder_alone(client: Any, tmp_path_factory: Any) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for path in (str(elsewhere), "../../../..", "/etc"):
        wish = {"source": {"path": json.dumps(path)}}
        (fault,) = unpacked(client.post("/answer", json=wish).content)[0]["faults"]
        assert fault["path"] == ["source", "path"]
        assert client.post("/save", json={"wish": wish}).status_code == 400
