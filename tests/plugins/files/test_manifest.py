"""Images by URL and by manifest: the rows of a folder, and one plain row for what is not as listed."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, DataError
from roemetry.io import remote
from roemetry.io.remote import path_of, read_ahead
from roemetry.run.batch import run_recipe
from roemetry.run.record import RECORD, read_record
from tests.command import typed


@pytest.fixture
def bucket() -> Iterator[MemoryFileSystem]:
    store = MemoryFileSystem()
    yield store
    store.store.clear()
    remote._ahead.read.clear()


def put(bucket: MemoryFileSystem, recipe: Path) -> None:
    for image in (recipe.parent / "images").iterdir():
        bucket.pipe(f"/plant/images/{image.name}", image.read_bytes())


def listed(recipe: Path, out: Path, source: str) -> None:
    typed("manifest", recipe, out, "--set", f"source.path={source}")


def test_a_bucket_gives_the_rows_of_a_folder(bucket: MemoryFileSystem, line: Any, tmp_path: Path) -> None:
    recipe = line(3)
    put(bucket, recipe)
    run_recipe(Recipe.load(recipe), tmp_path / "folder")
    run_recipe(Recipe.load(recipe, sets=["source.path=memory://plant/images"]), tmp_path / "bucket")
    assert (tmp_path / "bucket" / RECORD).read_bytes() == (tmp_path / "folder" / RECORD).read_bytes()


@pytest.mark.parametrize("ending", ["jsonl", "parquet"])
def test_what_is_not_as_listed_is_one_failed_row(
    bucket: MemoryFileSystem, line: Any, tmp_path: Path, ending: str
) -> None:
    recipe, out = line(4), tmp_path / f"season.{ending}"
    put(bucket, recipe)
    listed(recipe, out, "memory://plant/images")
    bucket.rm("/plant/images/p02.png")
    bucket.pipe("/plant/images/p03.png", bucket.cat("/plant/images/p04.png"))
    remote._ahead.read.clear()
    outcome = run_recipe(
        Recipe.load(recipe, sets=[f"source={{use: manifest, path: {out}}}"]), tmp_path / "out"
    )
    assert outcome.counts == {"measured": 2, "empty": 0, "failed": 2}
    said = [row.reasons[0].text for row in read_record(tmp_path / "out") if row.status == "failed"]
    assert said == [
        "memory://plant/images/p02.png: the laser image cannot be read: there is no such object",
        "memory://plant/images/p03.png: has changed: its bytes have another hash than the manifest says",
    ]


def test_a_manifest_with_a_row_twice_or_damaged_is_refused(line: Any, tmp_path: Path) -> None:
    recipe, out = line(2), tmp_path / "season.jsonl"
    listed(recipe, out, str(recipe.parent / "images"))
    whole = out.read_text("utf-8").splitlines()
    row = json.loads(whole[0])
    for lines, said in (
        ([*whole, whole[0]], "season.jsonl:3: `p01` has a laser image already"),
        ([whole[0], json.dumps(row | {"sha256": "none"})], "season.jsonl:2: not a row of a manifest"),
        ([], "names no file"),
    ):
        out.write_text("\n".join(lines), "utf-8")
        loaded = Recipe.load(recipe, sets=[f"source={{use: manifest, path: {out}}}"])
        with pytest.raises(DataError, match=said):
            run_recipe(loaded, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_bucket_without_permission_is_refused_before_the_first_image(line: Any, tmp_path: Path) -> None:
    class Closed(MemoryFileSystem):
        protocol = "closed"

        def info(self, path: str, **_: Any) -> Any:
            raise PermissionError("Forbidden")

        ls = info

    fsspec.register_implementation("closed", Closed, clobber=True)
    recipe, out = line(1), tmp_path / "season.jsonl"
    listed(recipe, out, str(recipe.parent / "images"))
    row = json.loads(out.read_text("utf-8"))
    out.write_text(json.dumps(row | {"url": "closed://plant/p01.png"}), "utf-8")
    for change in (f"source={{use: manifest, path: {out}}}", "source.path=closed://plant"):
        with pytest.raises(DataError, match=r"closed://plant.*no permission \(Forbidden\)"):
            run_recipe(Recipe.load(recipe, sets=[change]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_objects_are_fetched_while_others_are_worked_on(
    bucket: MemoryFileSystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetch, each_s = remote._fetch, 0.03
    urls = [path_of(f"memory://plant/{number}", Path()) for number in range(40)]
    for number, url in enumerate(urls):
        bucket.pipe(str(url), b"%d" % number)

    def slow(url: Any) -> bytes:
        time.sleep(each_s)
        return fetch(url)

    monkeypatch.setattr(remote, "_fetch", slow)
    begin = time.perf_counter()
    read_ahead(urls)
    assert [url.read_bytes() for url in urls] == [b"%d" % number for number in range(40)]
    assert time.perf_counter() - begin < 0.5 * each_s * len(urls)
    assert urls[-1].read_bytes() == b"39"  # kept, not fetched again


def test_a_url_that_nothing_reads_is_told_with_the_recipe(line: Any) -> None:
    with pytest.raises(ConfigurationError, match="nowhere://: Protocol not known"):
        Recipe.load(line(1), sets=["source.path=nowhere://plant/images"])
