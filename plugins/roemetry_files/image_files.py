"""Acquisitions from image files."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import DataError
from roemetry.io.files import printable
from roemetry.io.remote import Url
from roemetry.io.tiff import as_stored
from roemetry.records import Acquisition, AcquisitionReference, Frame, Role
from roemetry.stages import Source, StageOptions

SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".ppm", ".webp")


class ImageFilesOptions(StageOptions):
    """Where partner images are; ``{id}`` stands for the laser image's name without its suffix."""

    plain: str | None = Field(
        default=None,
        description="plain-light partner, e.g. ../images_plain/{id}.png, relative to the laser image",
    )
    dark: str | None = Field(default=None, description="laser-off partner, as for plain")


class ImageFiles(Source[ImageFilesOptions]):
    """Reads one file, all image files of a folder (by name), or a pattern such as ``images/*.png``.

    The acquisition's id is the file's name without its suffix (with it, where two files differ only there).
    Grey, colour and colour-with-alpha images of 8 or 16 bit are legal; alpha is left out.
    """

    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the images, sorted by name; raise DataError where there is none."""
        files = _files(path)
        if not files:
            absent = "" if path.exists() or _is_pattern(path) else ": no such file or folder"
            raise DataError(
                f"{path}: there is no image here{absent}",
                hint=f"source.path is a file, a folder or a pattern of {', '.join(SUFFIXES)}",
            )
        stems = Counter(file.stem for file in files)
        return in_turn(
            self._reference(file, printable(file.stem if stems[file.stem] == 1 else file.name))
            for file in files
        )

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Decode the files of one acquisition; raise DataError for one that is missing or damaged."""
        return read_acquisition(reference)

    def _reference(self, file: Path, name: str) -> AcquisitionReference:
        files: dict[Role, Path] = {"laser": file}
        partners: Mapping[Role, str | None] = {"plain": self.options.plain, "dark": self.options.dark}
        for role, pattern in partners.items():
            if pattern is not None:
                files[role] = file.parent / pattern.replace("{id}", file.stem)
        return AcquisitionReference(name, files)


def read_acquisition(reference: AcquisitionReference) -> Acquisition:
    """Decode the files of one acquisition; raise DataError for one that is missing or damaged."""
    before = pixels_before(reference)
    frames = tuple(read_image(path, role) for role, path in reference.files.items())
    keep_for_next(reference, frames)
    return Acquisition(reference.id, frames, before=before)


def in_turn(references: Iterable[AcquisitionReference]) -> list[AcquisitionReference]:
    """Say in each which laser image was taken before it: that of the one before in the list."""
    listed: list[AcquisitionReference] = []
    for one in references:
        listed.append(replace(one, before=listed[-1].files.get("laser")) if listed else one)
    return listed


_last: dict[Path, NDArray[Any]] = {}
"""The laser image that was read last: most often the one before the next."""


def keep_for_next(reference: AcquisitionReference, frames: Sequence[Frame]) -> None:
    """Keep a laser image that was read, so that it need not be read again as the one before."""
    _last.clear()
    _last.update({reference.files[frame.role]: frame.pixels for frame in frames if frame.role == "laser"})


def pixels_before(reference: AcquisitionReference) -> NDArray[Any] | None:
    """Give the pixels of the laser image before a reference's; None where it cannot be read."""
    path = reference.before
    if path is None:
        return None
    kept = _last.get(path)
    try:
        return read_image(path).pixels if kept is None else kept
    except DataError:  # what is wrong with it stands in its own row
        return None


PIXELS_MAX = 2**28
"""Largest image that is read, pixels: four times a 64-megapixel camera. A file of a megabyte can ask for more
memory than there is."""


def read_image(path: Path, role: Role = "laser") -> Frame:
    """Decode one image file, as the sensor gave it: no orientation that a file asks viewers for is applied.

    Raises
    ------
    DataError
        The file is missing, cut off, damaged, too large, or no image; or its pixels are neither 8 nor 16 bit.
    """
    shown = printable(str(path))
    try:
        if not isinstance(path, Url) and path.exists() and not path.is_file():
            raise DataError(f"{shown}: not a file", hint="a folder, a pipe or a device has an image's name")
        data = path.read_bytes()
    except OSError as error:
        raise DataError(
            f"{shown}: the {role} image cannot be read: {error.strerror or error}",
            hint="partner images are named in source.options" if role != "laser" else "check the file",
        ) from error
    if not data:
        raise DataError(f"{shown}: the file is empty")
    pixels = _jpeg(data, shown) if data.startswith(_JPEG) else _by_opencv(data, shown)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[:, :, :3]
    if pixels.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{shown}: pixels are {pixels.dtype}; 8 or 16 bit unsigned are read")
    return Frame(pixels, role=role, name=printable(path.name), bit_depth=8 * pixels.dtype.itemsize)


_JPEG = b"\xff\xd8"
_PNG = b"\x89PNG\r\n\x1a\n"


def _jpeg(data: bytes, shown: str) -> NDArray[Any]:
    """Decode a JPEG file strictly: OpenCV fills what is missing with grey, and goes on."""
    import simplejpeg

    try:
        rows, columns, space, _ = simplejpeg.decode_jpeg_header(data)
        _check_size(rows, columns, shown)
        grey = space == "Gray"
        pixels = simplejpeg.decode_jpeg(data, colorspace="GRAY" if grey else "BGR")
    except ValueError as error:
        raise DataError(f"{shown}: the file is cut off or damaged: {error}", hint="copy it again") from error
    return np.asarray(pixels[:, :, 0] if grey else pixels)


def _by_opencv(data: bytes, shown: str) -> NDArray[Any]:
    import cv2

    if data.startswith(_PNG):
        if b"IEND" not in data[-4096:].rstrip(b"\0")[-64:]:  # some cameras pad their files
            raise DataError(f"{shown}: the file is cut off", hint="copy it again")
        columns, rows = struct.unpack(">II", data[16:24])
        _check_size(rows, columns, shown)
    data = as_stored(data)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we say what is wrong, with the file
    try:
        pixels: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise DataError(f"{shown}: not an image that can be read, or damaged", hint="open it in a viewer")
    return pixels


def _check_size(rows: int, columns: int, shown: str) -> None:
    if rows * columns > PIXELS_MAX:
        raise DataError(
            f"{shown}: {columns} × {rows} pixels; at most {PIXELS_MAX // 10**6} million are read",
            hint="if the image is really so large, cut it into frames",
        )


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    elif _is_pattern(path):
        found = list(path.parent.glob(path.name))
    else:
        found = [path] if path.is_file() else []
    return sorted(found)


def _is_pattern(path: Path) -> bool:
    return any(mark in path.name for mark in "*?[")
