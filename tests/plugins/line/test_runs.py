"""Spooled frames are read again bit by bit, and a record is completed from the outbox."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from roemetry.records import Frame
from roemetry_files.dataset_source import DatasetSource
from roemetry_line import runs
from roemetry_line.feeds.image import decoded
from roemetry_line.outbox import NewRow, Outbox

SHAPES = st.tuples(st.integers(1, 20), st.integers(1, 20)) | st.tuples(
    st.integers(1, 20), st.integers(1, 20), st.just(3)
)
IMAGES = st.sampled_from([np.uint8, np.uint16]).flatmap(lambda kind: arrays.arrays(kind, SHAPES))


@given(IMAGES)
def test_a_tiff_comes_back_bit_by_bit(tmp_path_factory, pixels) -> None:
    path = tmp_path_factory.getbasetemp() / "spooled.tif"
    path.write_bytes(runs.tiff_of(pixels))
    found = decoded(path)
    assert found.dtype == pixels.dtype
    np.testing.assert_array_equal(found, pixels)


def test_another_reader_agrees(tmp_path, rng) -> None:
    tifffile = pytest.importorskip("tifffile")
    pixels = rng.integers(0, 65536, (7, 5, 3)).astype(np.uint16)
    (tmp_path / "one.tif").write_bytes(runs.tiff_of(pixels))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "one.tif")[:, :, ::-1], pixels)


def test_a_spool_is_a_data_set(tmp_path, rng) -> None:
    run = runs.new_run(tmp_path, "s")
    spool = runs.Spool(run, runs.KeptImages(tmp_path, "s", 1.0))
    taken = [Frame(rng.integers(0, 4096, (6, 8)).astype(np.uint16), bit_depth=12, time_s=5.5 + n,
                   encoder_count=100.0 + n) for n in range(3)]  # fmt: skip
    given_on = [spool.add((frame,)) for frame in taken]
    spool.close()
    source = DatasetSource()
    references = source.references(run)
    for reference, frame, (acquisition, hashes) in zip(references, taken, given_on, strict=True):
        (read,) = source.read(reference).frames
        np.testing.assert_array_equal(read.pixels, frame.pixels)
        assert (read.bit_depth, read.time_s, read.encoder_count) == (12, frame.time_s, frame.encoder_count)
        assert acquisition.id == reference.id
        assert len(hashes["laser_sha256"]) == 64


def test_the_oldest_images_go_first(tmp_path) -> None:
    image = (Frame(np.zeros((100, 100), np.uint8)),)  # 10 kB, and a head
    first, second = runs.new_run(tmp_path, "s"), runs.new_run(tmp_path, "s")
    assert first != second, "runs of one second have names of their own"

    def left() -> list[list[str]]:
        return [[path.stem for path in sorted(run.glob("images/*"))] for run in (first, second)]

    spool = runs.Spool(first, runs.KeptImages(tmp_path, "s", 2.5e-5))
    for _ in range(4):
        spool.add(image)
    assert left()[0] == ["000003", "000004"]
    spool = runs.Spool(second, runs.KeptImages(tmp_path, "s", 4.5e-5))  # as after a restart
    for _ in range(3):
        spool.add(image)
    assert left() == [["000004"], ["000001", "000002", "000003"]]
    (first / "images" / "000004.tif").unlink()  # by hand
    for _ in range(3):
        spool.add(image)
    assert left() == [[], ["000003", "000004", "000005", "000006"]]


def test_a_record_is_completed_from_the_outbox(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    run = runs.new_run(tmp_path, "s")
    lines = [f'{{"id": "00000{n}#1", "acquisition": "00000{n}"}}' for n in (1, 2, 3)]
    (run / "measurements.jsonl").write_text(lines[0] + "\n" + lines[1][:9])  # killed within a line
    for number, line in enumerate(lines):
        outbox.put([NewRow(f"l/{run.name}/{number}", "s", run.name, "product", {}, "{}", line)])
    assert runs.complete_record(run, outbox) == {"000001", "000002", "000003"}
    assert (run / "measurements.jsonl").read_text() == "".join(line + "\n" for line in lines)
    runs.complete_record(run, outbox)
    assert len((run / "measurements.jsonl").read_text().splitlines()) == 3
