"""Data sets: written in order, whole or not at all; read item by item; every fault found."""

from __future__ import annotations

import errno
import json
import os
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.config.dataset import ITEMS, Dataset, DatasetWriter, Description, Item, save_bytes, save_stripes
from roemetry.errors import DataError, OutputError
from roemetry.io.files import LineFile, write_whole
from roemetry.records import ProductTruth, StripeTruth

DESCRIPTION = Description(roemetry_dataset=1, name="trial", licence="CC0-1.0", made_from={"seed": 1})


def write(folder: Path, names: list[str], description: Description = DESCRIPTION) -> None:
    with DatasetWriter(folder, description) as writer:
        for name in names:
            if name in writer.done:
                continue
            good, data = cv2.imencode(".png", np.full((6, 8), 7, np.uint8))
            assert good
            save_bytes(folder / "images" / f"{name}.png", data.tobytes())
            x_px = np.array([[1.5, np.nan]])
            stripes = StripeTruth(x_px, np.array([[True, False]]), np.full((1, 2, 3), 0.25))
            save_stripes(folder / "truth" / f"{name}.npz", stripes)
            product = ProductTruth(
                label="good", visible_mm3=12.5, figures={"length_mm": 3.0, "gap_mm": np.nan}
            )
            files = {"laser": f"images/{name}.png"}
            writer.add(Item(name, files, products=(product,), stripes=f"truth/{name}.npz", time_s=0.5))


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b"])
    data = Dataset(tmp_path)
    items = list(data.items())
    assert [item.id for item in items] == ["a", "b"]
    assert items[0].time_s == 0.5
    assert np.isnan(items[0].encoder_count)
    truth = data.truth(items[1])
    assert truth.products[0].visible_mm3 == 12.5
    assert np.isnan(truth.products[0].figures["gap_mm"])
    np.testing.assert_array_equal(truth.stripes.x_px, [[1.5, np.nan]])
    assert list(data.faults()) == []


def test_a_half_line_is_taken_away_and_the_set_goes_on(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b"])
    before = (tmp_path / ITEMS).read_bytes()
    (tmp_path / ITEMS).write_bytes(before[:-25])
    write(tmp_path, ["a", "b", "c"])
    lines = (tmp_path / ITEMS).read_text("utf-8").splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["a", "b", "c"]
    assert (tmp_path / ITEMS).read_bytes().startswith(before)


def test_another_set_s_folder_is_refused_and_a_longer_one_is_not(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    longer = DESCRIPTION.model_copy(update={"made_with": "again, but longer"})
    write(tmp_path, ["b"], longer)
    assert Dataset(tmp_path).description.made_with == "again, but longer"
    with pytest.raises(OutputError, match="another data set"):
        write(tmp_path, ["c"], DESCRIPTION.model_copy(update={"made_from": {"seed": 2}}))


def test_faults_are_told_with_file_and_item(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b", "c", "d"])
    (tmp_path / "images" / "a.png").unlink()
    (tmp_path / "images" / "b.png").write_bytes(b"other")
    (tmp_path / "truth" / "c.npz").write_bytes(b"other")
    lines = (tmp_path / ITEMS).read_text("utf-8").splitlines()
    (tmp_path / ITEMS).write_text("\n".join([*lines, lines[3], '{"id": 1}']) + "\n", "utf-8")
    faults = list(Dataset(tmp_path).faults())
    words = (
        "a.png missing a,laser",
        "b.png changed b,laser",
        "c.npz changed c,truth",
        "`d` twice",
        "items.jsonl:6 item",
    )
    assert len(faults) == len(words)
    for said, expected in zip(faults, words, strict=True):
        assert all(word.replace(",", ", ") in said for word in expected.split()), said


def test_a_line_that_is_no_item_is_refused_with_its_place(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    sound = (tmp_path / ITEMS).read_text("utf-8")
    for line in ("{}", "[]", "not json", '{"id": "a", "files": 3}'):
        (tmp_path / ITEMS).write_text(sound + line + "\n", "utf-8")
        with pytest.raises(DataError, match=r"items\.jsonl:2: not an item"):
            list(Dataset(tmp_path).items())


def test_many_items_need_no_memory(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    line = json.loads((tmp_path / ITEMS).read_text("utf-8")) | {"stripes": None}
    rows = [json.dumps(line | {"id": f"i{number}"}) + "\n" for number in range(5000)]
    (tmp_path / ITEMS).write_text("".join(rows), "utf-8")
    tracemalloc.start()
    count = sum(1 for _ in Dataset(tmp_path).items())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 5000
    assert peak < 1_000_000


def test_a_failed_append_leaves_nothing_of_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "record.jsonl"
    real = os.write

    def disk_fills_up(descriptor: int, data: bytes) -> int:
        if b"second" in data:
            real(descriptor, data[:3])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", disk_fills_up)
    path.write_bytes(b"x" * 200_000)  # half a line of another time
    with LineFile(path) as record:
        record.append("first")
        with pytest.raises(OutputError, match="No space left"):
            record.append("second")
        record.append("third")
    assert path.read_text(encoding="utf-8") == "first\nthird\n"


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


def test_a_line_that_the_system_writes_in_parts_is_whole_or_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, real = tmp_path / "record.jsonl", os.write
    with LineFile(path) as record:
        monkeypatch.setattr(os, "write", lambda descriptor, data: real(descriptor, data[:3]))
        record.append("hello")
        with pytest.raises(OutputError, match="only in part"):
            record.append("longer than two parts")
        assert path.read_text("utf-8") == "hello\n"
        monkeypatch.undo()
        record.append("whole")
    assert path.read_text("utf-8") == "hello\nwhole\n"
