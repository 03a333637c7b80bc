"""A run into a bucket: the same record, in parts; what is lost is measured again, and nothing twice."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import fsspec
import pytest

from roemetry.config.recipe import Recipe
from roemetry.errors import DataError, OutputError
from roemetry.io.remote import Url, folder_for
from roemetry.run import record
from roemetry.run.batch import derive, run_recipe
from roemetry.run.record import read_record, recipe_of, rows_of
from tests.command import exit_code


class StoppedError(Exception):
    """As a machine that is gone: nothing is closed after it."""


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Url:
    """A folder in a bucket that takes a part for every two rows."""
    monkeypatch.setattr(record, "_ROWS", 2)
    system = fsspec.filesystem("memory")
    if system.exists("/plant"):
        system.rm("/plant", recursive=True)
    return Url("memory://plant/monday")


@pytest.fixture
def recipe(line) -> Recipe:
    return Recipe.load(line(5), sets=["sinks=[csv]"])


def record_in(bucket: Url) -> bytes:
    return b"".join(record.bytes_of(bucket, part) for part in record.parts_of(bucket))


def stop_after(count: int):
    def on_progress(done: int, of: int) -> None:
        if done == count:
            raise StoppedError

    return on_progress


def test_the_record_in_parts_is_that_of_a_folder(recipe, bucket, tmp_path) -> None:
    run_recipe(recipe, tmp_path / "here")
    outcome = run_recipe(recipe, bucket)
    assert record_in(bucket) == (tmp_path / "here" / "measurements.jsonl").read_bytes()
    assert [(one.rows, one.lowest, one.highest) for one in record.parts_of(bucket)] == [
        (2, "p01", "p02"),
        (2, "p03", "p04"),
        (1, "p05", "p05"),
    ]
    assert outcome.folder == bucket
    assert bucket / "results.csv" in outcome.files
    assert (bucket / "results.csv").read_bytes() == (tmp_path / "here" / "results.csv").read_bytes()
    told = json.loads((bucket / "provenance.json").read_text())
    assert told["counts"] == outcome.counts
    assert sum(1 for _ in read_record(bucket)) == 5
    with pytest.raises(OutputError, match="there is a run in this folder already"):
        run_recipe(recipe, bucket)


@pytest.mark.parametrize("machine_is_gone", [False, True])
def test_a_run_that_was_stopped_goes_on_from_its_last_part(
    recipe, bucket, tmp_path, monkeypatch, machine_is_gone: bool
) -> None:
    run_recipe(recipe, tmp_path / "here")
    with monkeypatch.context() as patch, pytest.raises(StoppedError):
        if machine_is_gone:
            patch.setattr(record, "_ROWS", 3)
            patch.setattr(record.Parts, "close", lambda self: None)
        run_recipe(recipe, bucket, on_progress=stop_after(3))
    assert sum(one.rows for one in record.parts_of(bucket)) == (0 if machine_is_gone else 3)
    run_recipe(recipe, bucket, resume=True)
    assert record_in(bucket) == (tmp_path / "here" / "measurements.jsonl").read_bytes()


def test_what_reads_runs_reads_parts(recipe, bucket, tmp_path) -> None:
    run_recipe(recipe, bucket)
    (row,) = rows_of(bucket, "p03#1")
    assert row.acquisition == "p03"
    read = list(record.parts_of(bucket))
    (bucket / read[0].file).put(_file(tmp_path / "damaged", b"{}\n"))
    assert [one.id for one in rows_of(bucket, "p03")] == ["p03#1"]  # no other part is read
    with pytest.raises(OutputError, match="there is no product `p09`"):
        rows_of(bucket, "p09")
    with pytest.raises(DataError, match=r"monday/parts/000001\.jsonl: damaged: its bytes have another hash"):
        list(read_record(bucket))
    again, provenance = recipe_of(bucket)
    files, faults, _ = derive(again, bucket, provenance, product="p04")
    assert files == (bucket / "product-p04" / "results.csv",)
    assert not faults
    assert "p04#1" in files[0].read_text()


def test_a_copy_of_the_bucket_is_a_run_s_folder(recipe, bucket, tmp_path) -> None:
    run_recipe(recipe, tmp_path / "here")
    with pytest.raises(StoppedError):
        run_recipe(recipe, bucket, on_progress=stop_after(4))
    copy = tmp_path / "copy"
    fsspec.filesystem("memory").get("/plant/monday", str(copy), recursive=True)
    assert [row.id for row in read_record(copy)] == ["p01#1", "p02#1", "p03#1", "p04#1"]
    run_recipe(recipe, copy, resume=True)
    assert (copy / "measurements.jsonl").read_bytes() == (
        tmp_path / "here" / "measurements.jsonl"
    ).read_bytes()


def test_two_runs_in_one_folder_are_noticed(recipe, bucket) -> None:
    def interferes(done: int, of: int) -> None:
        if done == 3:
            fsspec.filesystem("memory").pipe("/plant/monday/index.json", b'{"roemetry_index":1,"parts":[]}')

    with pytest.raises(OutputError, match="another run is writing into this folder"):
        run_recipe(recipe, bucket, on_progress=interferes)


def test_a_bucket_that_takes_nothing_is_known_before_the_first_image(recipe, bucket, monkeypatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError("Access Denied")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "put_file", refused)
    with pytest.raises(OutputError, match="monday/provenance.json: cannot be written: no permission"):
        run_recipe(recipe, bucket, on_progress=stop_after(1))


class Gone:
    """Executes nothing."""

    def in_order(self, *_: object) -> Iterator[object]:
        raise OutputError("no scheduler")
        yield


def test_rows_of_images_that_are_gone_stay_where_a_run_does_not_go_on(recipe, tmp_path) -> None:
    out = tmp_path / "here"
    run_recipe(recipe, out)
    before = (out / "measurements.jsonl").read_bytes()
    for image in (recipe.path.parent / "images").iterdir():
        image.rename(image.with_name(f"new_{image.name}"))
    with pytest.raises(OutputError, match="no scheduler"):
        run_recipe(recipe, out, executor=Gone(), resume=True)
    assert (out / "measurements.jsonl").read_bytes() == before


def test_what_a_bucket_does_not_take_stays_here(bucket, monkeypatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError("Access Denied")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "put_file", refused)
    refusal = pytest.raises(OutputError, match="cannot be written: no permission")
    with refusal as caught, folder_for(bucket) as folder:
        (folder / "tables").mkdir()
        (folder / "tables" / "a.csv").write_text("a\n1\n")
    assert str(folder) in str(caught.value)
    assert (folder / "tables" / "a.csv").read_text() == "a\n1\n"


@pytest.mark.parametrize("where", ["bucket", "folder"])
def test_a_run_that_never_begins_leaves_nothing(recipe, bucket, tmp_path, where) -> None:
    with pytest.raises(OutputError, match="no scheduler"):
        run_recipe(recipe, bucket if where == "bucket" else tmp_path / "here", executor=Gone())
    assert not fsspec.filesystem("memory").find("/plant")
    assert not [path for path in tmp_path.glob("here/*") if not path.name.startswith(".")]


def test_the_verbs_take_a_url(line, bucket, monkeypatch, capsys) -> None:
    roemetry = partial(exit_code, monkeypatch)
    assert roemetry("run", line(3), "--set", "sinks=[csv]", "--out", "memory://plant/monday") == 0
    assert (
        "  memory://plant/monday/index.json\n  memory://plant/monday/results.csv" in capsys.readouterr().out
    )
    assert roemetry("report", "memory://plant/monday", "--product", "p02#1") == 0
    assert capsys.readouterr().out.strip() == "memory://plant/monday/product-p02%231/results.csv"
    assert roemetry("export", "memory://plant/monday", "parquet") == 0
    assert capsys.readouterr().out.strip() == "memory://plant/monday/results.parquet"
    assert roemetry("query", "memory://plant/monday", "select count(*) as n from products", "--csv") == 0
    assert capsys.readouterr().out == "n\n3\n"


def _file(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path
