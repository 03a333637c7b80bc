"""Images as files: damaged ones are refused, whatever the decoder says; odd names do not end a batch."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from roemetry.errors import DataError
from roemetry.records import Acquisition, Frame
from roemetry.run.preprocess import prepare
from roemetry_files.image_files import ImageFiles, read_image
from roemetry_line.feeds.image import decoded
from roemetry_volume.edge_contour import _read as belt_image


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
