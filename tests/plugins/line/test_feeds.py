"""Frames as cameras give them: whole or not, lost by their numbers, of several lights; what feeds refuse."""

from __future__ import annotations

import ctypes
import re
import threading
import time
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.records import Acquisition, Frame
from roemetry.records.live import LiveFrame
from roemetry.run.api import Recipe
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of
from roemetry.stages import Feed
from roemetry.stages.registry import discover
from roemetry_line import preflight
from roemetry_line.feeds.aravis import LIBRARY, Aravis, AravisOptions
from roemetry_line.feeds.camera import FrameNumbers
from roemetry_line.line_file import Line, PageSection
from roemetry_line.outbox import Outbox
from roemetry_line.station import Exposures, StationProcess


def basler(folder: Path, **nodes):
    pytest.importorskip("pypylon", reason="the extra basler has pypylon")
    from roemetry_line.feeds.basler import Basler, BaslerOptions

    files = {"ImageFileMode": "On", "TestImageSelector": "Off", "ImageFilename": str(folder)}
    options = {"Width": 40, "Height": 30, "PixelFormat": "Mono8", **files, **nodes}
    return Basler(BaslerOptions(emulated=True, trigger="software", rate_hz=500.0, nodes=options))


def taken(feed: Feed, many: int):
    with feed.open() as frames:
        return list(islice((live for live in frames if live is not None), many))


def test_an_emulated_camera_plays_images_bit_by_bit_and_tells_what_is_not_whole(tmp_path, rng) -> None:
    images = [rng.integers(0, 256, (30, 40)).astype(np.uint8) for _ in range(3)]
    for number, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    for live, image in zip(taken(basler(tmp_path), 3), images, strict=True):
        np.testing.assert_array_equal(live.frame.pixels, image)
    (broken,) = taken(basler(tmp_path / "nowhere"), 1)
    assert broken.frame is None
    assert "image file" in broken.fault


def test_a_frame_of_another_size_is_measured_as_a_failure(tmp_path, line) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((20, 24), np.uint8))
    (live,) = taken(basler(tmp_path / "small.png"), 1)
    assert live.frame.size == (20, 24)
    recipe = Recipe.load(line())
    trace = Pipeline(recipe).trace(Acquisition("small", (live.frame,)))
    (row,) = measurements_of(trace, recipe, {}, ())
    assert row.status == "failed"
    assert {reason.code for reason in row.reasons} & {"other-camera", "triangulator-refused"}


@pytest.fixture(scope="module")
def aravis():
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        pytest.skip(f"no {LIBRARY}: apt install libaravis-0.8-0")


def test_aravis_numbers_wrap_without_a_loss(aravis) -> None:
    nodes = {"Width": 64, "Height": 48, "AcquisitionFrameRate": 1000.0}
    live = taken(Aravis(AravisOptions(emulated=True, counting="16-bit", nodes=nodes)), 160)
    numbers = [one.number for one in live]
    assert {65_535, 1} <= set(numbers), "the fake camera begins at 65401"
    assert 0 not in numbers
    first, last = numbers[0], numbers[-1]
    assert sum(one.lost_before for one in live) == (last - first) % 65_535 - 159
    assert {one.frame.size for one in live if one.frame is not None} == {(48, 64)}


FEED = "feed: {use: folder-watch, options: {path: FOLDER/in}}"


@pytest.mark.parametrize(
    ("feed", "options", "found", "remedy"),
    [
        ("basler", "emulated: true\n        nodes:\n          Widht: 3",
         r"line\.yaml:12:11: the camera has no node `Widht`", "did you mean `Width`"),
        ("basler", "emulated: true\n        nodes: {Width: 9999999}",
         r"line\.yaml:11:17: the camera refuses Width", ""),
        ("basler", "emulated: true\n        serial: none-such",
         r"line\.yaml:7:5: there is no camera none-such", "plugged"),
        ("aravis", "emulated: true\n        nodes: {Widht: 3}",
         r"line\.yaml:11:17: the camera has no node `Widht`", "did you mean `Width`"),
        ("genicam", "producer: other.cti",
         r"line\.yaml:10:9: .*other\.cti: cannot be loaded: it is for 64-bit ARM", "processor"),
        ("folder-watch", "path: /nowhere", r"line\.yaml:7:5: /nowhere: cannot be looked into", "path"),
    ],
)  # fmt: skip
def test_a_camera_that_refuses_is_named_at_its_place(
    line_file, tmp_path, request, feed, options, found, remedy
) -> None:
    if feed == "aravis":
        request.getfixturevalue("aravis")
    for module, _ in discover().find("feed", feed).entry.requires:
        if not module.startswith("lib"):
            pytest.importorskip(module)
    # a producer for another processor: a sound header of a library for a 64-bit ARM
    other = tmp_path / "other.cti"
    other.write_bytes(b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x03\x00\xb7\x00\x01\x00\x00\x00" + bytes(100))
    options = options.replace("other.cti", str(other))
    loaded = Line.load(line_file((FEED, f"feed:\n      use: {feed}\n      options:\n        {options}")))
    told = preflight._camera(loaded, loaded.stations[0])
    assert told.verdict == "wrong"
    assert re.search(found, told.found), told.found
    assert remedy in told.remedy


def test_a_driver_that_does_not_answer_is_told_within_three_seconds(line_file) -> None:
    loaded = Line.load(line_file())
    outbox = Outbox(loaded.folder)
    station = StationProcess(loaded, "one", outbox, threading.Event())
    station._taking, station._opened, station._last_try_s = True, True, time.time() - 2.1
    station._beat(now=True)
    (alarm,) = outbox.alarms()
    assert alarm["text"] == "the camera's driver has not answered for 2 s"
    station._last_try_s = time.time()
    station._beat(now=True)
    assert outbox.open_alarms("one") == set()


def test_everything_listens_on_this_machine_only_unless_told() -> None:
    hosts = {"page": PageSection().host}
    registry = discover()
    for stage in registry.of_kind("outlet"):
        if stage.missing is None and "host" in (options := registry.load(stage).Options).model_fields:
            hosts[stage.entry.name] = options().host
    assert {"page", "modbus", "opcua", "tcp"} <= set(hosts)
    assert set(hosts.values()) == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("counting", "numbers", "lost"),
    [
        ("64-bit", [7, 8, 16, 26], [0, 0, 7, 9]),
        ("64-bit", [0, 1, 2], [0, 0, 0]),
        ("64-bit", [900, 1, 2], [0, 0, 0]),  # the camera was started again
        ("16-bit", [65534, 65535, 1, 2], [0, 0, 0, 0]),
        ("16-bit", [65534, 1, 3], [0, 1, 1]),
        ("16-bit", [65535, 65535], [0, 0]),
        ("16-bit", [200, 100], [0, 0]),
    ],
)
def test_gaps_wraps_and_restarts(counting, numbers, lost) -> None:
    count = FrameNumbers(counting)
    assert [count.lost_before(number) for number in numbers] == lost


@given(st.integers(1, 10**6), st.lists(st.integers(0, 5000), min_size=1, max_size=50))
def test_a_16_bit_counter_that_leaves_0_out_is_followed_across_its_end(first, gaps) -> None:
    count = FrameNumbers("16-bit")
    index = first
    count.lost_before(1 + index % 65535)
    for gap in gaps:
        index += gap + 1
        assert count.lost_before(1 + index % 65535) == gap


@given(
    st.sampled_from([("laser",), ("laser", "plain"), ("plain", "laser", "dark")]),
    st.lists(st.sampled_from(["whole", "whole", "whole", "not whole", "lost"]), max_size=40),
)
def test_a_product_has_the_frames_that_were_taken_of_it(lights, fates) -> None:
    exposures, lost, found = Exposures(lights), 0, []
    for number, fate in enumerate(fates):
        if fate == "lost":
            lost += 1
            continue
        frame = Frame(np.full((2, 2), number, np.uint8)) if fate == "whole" else None
        frames = exposures.add(LiveFrame(frame, number, lost, fault="" if frame else "half of it"))
        lost = 0
        if frames is not None:
            found.append([(frame.role, int(frame.pixels[0, 0])) for frame in frames])
    many = len(lights)
    assert found == [
        [(role, begin + index) for index, role in enumerate(lights)]
        for begin in range(0, len(fates) - many + 1, many)
        if set(fates[begin : begin + many]) == {"whole"}
    ]
