"""Images as files, by URL and by manifest: what is damaged or not as listed is one row that says so."""

from __future__ import annotations

import json
import os
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import fsspec
import numpy as np
import pytest
import tifffile
from fsspec.implementations.memory import MemoryFileSystem

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, DataError
from roemetry.io import remote
from roemetry.io.remote import path_of, read_ahead
from roemetry.records import Acquisition, Frame
from roemetry.run.batch import run_recipe
from roemetry.run.preprocess import prepare
from roemetry.run.record import RECORD, read_record
from roemetry_files.image_files import ImageFiles, read_image
from roemetry_line.feeds.image import decoded
from roemetry_volume.edge_contour import _read as belt_image
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


@pytest.fixture
def pixels(rng: np.random.Generator) -> np.ndarray:
    drawn = cv2.GaussianBlur(rng.integers(0, 256, (240, 320)).astype(np.uint8), (5, 5), 0)
    return cv2.merge([drawn, drawn[::-1], drawn[:, ::-1]])


def encoded(pixels: np.ndarray, suffix: str) -> bytes:
    return cv2.imencode(suffix, pixels)[1].tobytes()


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_tiff_file_is_not_turned_as_viewers_would(
    orientation: int, pixels: np.ndarray, tmp_path: Path
) -> None:
    path = tmp_path / "turned.tif"
    tag = (274, "H", 1, orientation, True)
    tifffile.imwrite(path, pixels[..., ::-1], photometric="rgb", extratags=[tag], metadata=None)
    for read in (lambda path: read_image(path).pixels, belt_image, decoded):
        np.testing.assert_array_equal(read(path), pixels)


DAMAGE = {
    "1024 bytes lost": lambda data: data[: len(data) // 2] + data[len(data) // 2 + 1024 :],
    "half": lambda data: data[: len(data) // 2],
    "half, and its end": lambda data: data[: len(data) // 2] + data[-16:],
    "empty": lambda data: b"",
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".bmp", ".webp"])
def test_a_damaged_file_is_refused(suffix: str, damage: str, pixels: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / f"image{suffix}"
    path.write_bytes(DAMAGE[damage](encoded(pixels, suffix)))
    with pytest.raises(DataError, match="image"):
        read_image(path)


@pytest.mark.parametrize("colours", [1, 3])
def test_a_jpeg_is_what_opencv_makes_of_it(colours: int, pixels: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "image.jpg"
    path.write_bytes(encoded(pixels if colours == 3 else pixels[:, :, 0], ".jpg"))
    np.testing.assert_array_equal(read_image(path).pixels, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def test_a_header_that_asks_for_a_gigapixel_is_refused_before_decoding(tmp_path: Path) -> None:
    whole = bytearray(encoded(np.zeros((4, 4), np.uint8), ".png"))
    whole[16:24] = (32_000).to_bytes(4, "big") * 2
    whole[29:33] = zlib.crc32(whole[12:29]).to_bytes(4, "big")
    path = tmp_path / "bomb.png"
    path.write_bytes(bytes(whole))
    with pytest.raises(DataError, match="32000 × 32000 pixels"):
        read_image(path)


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_odd_names_and_things_that_are_no_file_are_listed_and_told(
    pixels: np.ndarray, tmp_path: Path
) -> None:
    for name in (b"a", b"b\xff", b"c\x1b[31m"):
        Path(os.fsdecode(bytes(tmp_path) + b"/" + name + b".png")).write_bytes(encoded(pixels, ".png"))
    (tmp_path / "d.png").symlink_to("nowhere")
    (tmp_path / "e.png").mkdir()
    os.mkfifo(tmp_path / "f.png")
    source = ImageFiles()
    found = {reference.id: reference for reference in source.references(tmp_path)}
    assert sorted(found) == ["a", r"b\xff", r"c\x1b[31m", "d", "e", "f"]
    for name in ("a", r"b\xff", r"c\x1b[31m"):
        assert source.read(found[name]).frames[0].name == f"{name}.png"
    for name in "def":
        with pytest.raises(DataError, match=f"{name}.png"):
            source.read(found[name])


@pytest.mark.parametrize(("top", "bits"), [(4095, 12), (900, 10), (16383, 14)])
def test_bits_that_are_not_in_use_are_asked_for(top: int, bits: int) -> None:
    pixels = np.full((4, 6), 7, np.uint16)
    pixels[1, 2] = top
    acquisition = Acquisition("one", (Frame(pixels, bit_depth=16, name="one.png"),))
    with pytest.raises(DataError, match="brightest pixel is") as refused:
        prepare(acquisition, channel="grey", turn_deg=0, subtract="none")
    assert f"source.bit_depth: {bits}" in str(refused.value)
    for stated in (bits, 16):
        frame = prepare(acquisition, channel="grey", turn_deg=0, subtract="none", bit_depth=stated)
        assert frame.bit_depth == stated
