"""Every command in README and in the pages is typed, page by page, in the order in which a reader would.

What costs minutes is made smaller (`SMALLER`); what a test must not do (install, measure for hours) is not
run but looked at otherwise, and says why (`NOT_RUN`).
"""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from docs.reference_tables import rewritten
from roemetry.cli.main import app
from roemetry.stages import StageOptions
from roemetry.stages.registry import discover
from tests.docs.reading import (
    PAGES,
    ROOT,
    VERBS,
    blocks,
    coded,
    commands,
    page,
    section,
    stands_for_something,
    table,
    titled,
)
from tests.docs.world import make_world, multiply, scale

SMALLER = (
    (r"^(roemetry simulate (?!.*--count).*)$", r"\1 --count 1 --calibration none"),
    (r"--count \d+", "--count 1"),
    (r"--calibration all", "--calibration none"),
    (r"--jobs \d+|-j \d+", "--jobs 1"),
    (r"--draws \d+", "--draws 5"),
    (r" --simulate\b", ""),
)

NOT_RUN = {
    r"pip install -e (\S+)$": "makes the package known without pip",
    r"pip ": "installs",
    r"pytest |python -m pytest": "tests of a test",
    r"python -m benchmarks ": "takes minutes to hours; name and options are held in test_what_pages_name.py",
    r"roemetry init (?!.*--image 320x240)": "renders for a minute: smaller in test_init_project.py",
    r"roemetry tune ": "serves until it is stopped",
    r"roemetry (serve|history) ": "serves until it is stopped: whole lines run in tests/plugins/line",
    r"roemetry doctor line.yaml": "tries a camera and a broker: tested in tests/plugins/line",
    r"roemetry run .*--cluster tcp:": "needs a scheduler: tested with one in test_cluster.py",
    r"roemetry run \S+ --out \S+ --resume": "goes on with a run that was stopped: tested with real kills",
    r"roemetry simulate .*--resume": "goes on with a set that was stopped: tested with real kills",
    r"roemetry simulate .*--out skeins": "a set of that name lies there already, in full size",
    r"roemetry fit-penetration ": "needs a step target's two images: tested with simulated ones",
    r"roemetry (register-heads|two-sides) ": "needs two heads: what it calls is in test_two_sides.py",
    r"roemetry check-plugin my-plugin": "`my-plugin` is the reader's",
}
EXPECTED_EXIT = {
    r"roemetry compare .*--data more": (1,),  # the world's smaller camera is none that was calibrated
    r"roemetry run .*threshold=100": (1,),  # the page says that skeins are refused, and why
}

ONCE = r"roemetry (doctor|check-plugin dominant-peak|study plan|plan recipes/|study uncertainty recipes/)"
"""What these say hangs on the shipped files alone and no later command needs it: once is enough."""

WITH_COMMANDS = [page for page in PAGES if commands(page)]
RUN_ON = {
    command: page
    for page in reversed(WITH_COMMANDS)
    for command in commands(page)
    if re.match(ONCE, command) and "--out" not in command
}
"""The first page with each command of `ONCE`: it is run there, whichever pages are asked for."""


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("docs") / "clone"
    make_world(folder)
    return folder


@pytest.fixture
def clone(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "clone"
    shutil.copytree(kept, folder)
    monkeypatch.chdir(folder)
    yield folder
    # a plugin that the reader wrote is installed for this page only
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "/").is_relative_to(folder):
            del sys.modules[name]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_run(
    page: Path, clone: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in titled(page).items():
        (clone / "my-plugin" / name).parent.mkdir(parents=True, exist_ok=True)
        (clone / "my-plugin" / name).write_text(text, "utf-8")
    for command in commands(page):
        if stands_for_something(command) or RUN_ON.get(command, page) != page:
            continue
        for name, text in titled(page).items():
            if name in command.split() and (clone / name).parent.is_dir():
                (clone / name).write_text(text, "utf-8")
        skipped = next((pattern for pattern in NOT_RUN if re.match(pattern, command)), None)
        if skipped is None:
            fault = _type(command, clone, rng, monkeypatch)
            assert fault is None, f"{command}: {fault}"
        elif command.startswith("roemetry "):
            _parse(command)
        elif (found := re.match(r"pip install -e '?([\w./-]+)'?$", command)) and (clone / found[1]).is_dir():
            _make_known(clone / found[1], clone, monkeypatch)


def _parse(command: str) -> None:
    """Parse words and types; run nothing."""
    _, verb, *words = shlex.split(command.removesuffix(" &"))
    if verb not in VERBS:
        verb, words = f"{verb} {words[0]}", words[1:]
    VERBS[verb].make_context(verb, words)


def _type(command: str, clone: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> str | None:
    """Type a command, and give what it says where it does not end as the page lets one expect."""
    for pattern, smaller in SMALLER:
        command = re.sub(pattern, smaller, command)
    words = shlex.split(command)
    _prepare(words, clone)
    if words[:2] == ["python", "-m"]:
        monkeypatch.setattr(sys, "argv", words[2:])
        monkeypatch.delitem(sys.modules, words[2], raising=False)  # another test may have imported it
        with pytest.raises(SystemExit) as ended:
            runpy.run_module(words[2], run_name="__main__")
        code, said, allowed = ended.value.code or 0, "", (0,)
    else:
        done = CliRunner().invoke(app, words[1:])
        allowed = next(
            (codes for pattern, codes in EXPECTED_EXIT.items() if re.match(pattern, command)), (0,)
        )
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise AssertionError(f"{command}: {done.exception}") from done.exception
        code, said = done.exit_code, done.output
    for name in ("weighed", "features"):
        if f"results/{name}" in words and words[1] == "run":
            multiply(clone / "results" / name, rng)
    return None if code in allowed else f"ended with {code}\n{said}"


def _prepare(words: list[str], clone: Path) -> None:
    """What the page takes for granted: yesterday's folder is not in the way, the scale stands there."""
    if "roemetry_peaks.measure_noise" in words:
        recipe = clone / words[words.index("roemetry_peaks.measure_noise") + 1]
        begun, _, rest = recipe.read_text("utf-8").partition("  extractor:\n")
        rest = rest[rest.index("  coder:") :]
        recipe.write_text(f"{begun}  extractor: maximum-likelihood\n{rest}", "utf-8")
    if "--out" in words:
        out = clone / words[words.index("--out") + 1]
        if words[1] in ("run", "compare", "simulate") and out.exists():
            shutil.rmtree(out)
    if "scale.csv" in words:
        scale(clone / "results" / "today")


def _make_known(folder: Path, clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Do what `pip install -e` does, for this test only."""
    project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["project"]
    known = clone / ".installed"
    info = known / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n", "utf-8"
    )
    points = project["entry-points"]["roemetry"]
    (info / "entry_points.txt").write_text(
        "[roemetry]\n" + "".join(f"{name} = {module}\n" for name, module in points.items()), "utf-8"
    )
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.syspath_prepend(str(known))


def test_the_tables_of_the_command_line_are_the_options() -> None:
    assert VERBS
    for verb, command in VERBS.items():
        part = section(page("command-line.md"), f"## `roemetry {verb}`")
        told = {word for row in table(part) if row[0].startswith("`-") for word in coded(row[0])}
        options = {o for p in command.params if p.param_type_name == "option" for o in p.opts}
        assert told == options | {"--help", "-h"}, verb
        assert f"roemetry {verb} " in "".join(content for _, content in blocks(part, "")), "no example"


@pytest.mark.parametrize("name", ["command-line.md", "recipe.md"])
def test_what_a_page_takes_from_the_code_is_what_the_code_says(name: str) -> None:
    again = rewritten(page(name))
    assert again == page(name), "write them again: python -m docs.reference_tables docs/reference"
    assert again.count("<!-- from the code:") == again.count("<!-- to here -->") > 3


def test_every_exit_code_is_told() -> None:
    rows = section(page("command-line.md"), "## Exit codes")
    assert re.findall(r"^\| (\d+) \|", rows, flags=re.MULTILINE) == ["0", "1", "2", "130"]


def test_the_plugin_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "how-to" / "write-a-plugin.md").read_text("utf-8")
    files = {title: content for language in ("toml", "python") for title, content in blocks(text, language)}
    assert set(files) == {
        "pyproject.toml",
        "roemetry_centroid/__init__.py",
        "roemetry_centroid/extractor.py",
        "tests/test_run_centroid.py",
        "tests/test_contract.py",
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    try:
        registry = discover([EntryPoint("centroid", "roemetry_centroid", "roemetry")])
        assert registry.broken == ()
        stage = registry.load(registry.find("extractor", "run-centroid"))
        assert issubclass(stage.Options, StageOptions)
        tests = runpy.run_path(str(tmp_path / "tests" / "test_run_centroid.py"))
        found = [tests[name] for name in tests if name.startswith("test_")]
        assert len(found) == 3
        for test in found:
            test()
    finally:
        for name in [name for name in sys.modules if name.startswith("roemetry_centroid")]:
            del sys.modules[name]
