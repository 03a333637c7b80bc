"""Acquisitions from image files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from roemetry.errors import DataError
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

    Options = ImageFilesOptions

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
        return [self._reference(file, file.stem if stems[file.stem] == 1 else file.name) for file in files]

    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Decode the files of one acquisition; raise DataError for one that is missing or damaged."""
        return Acquisition(
            reference.id, tuple(read_image(path, role) for role, path in reference.files.items())
        )

    def _reference(self, file: Path, name: str) -> AcquisitionReference:
        files: dict[Role, Path] = {"laser": file}
        partners: Mapping[Role, str | None] = {"plain": self.options.plain, "dark": self.options.dark}
        for role, pattern in partners.items():
            if pattern is not None:
                files[role] = file.parent / pattern.replace("{id}", file.stem)
        return AcquisitionReference(name, files)


def read_image(path: Path, role: Role = "laser") -> Frame:
    """Decode one image file.

    Raises
    ------
    DataError
        The file is missing, cut off, or no image; or its pixels are neither 8 nor 16 bit.
    """
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise DataError(
            f"{path}: the {role} image cannot be read: {error.strerror or error}",
            hint="partner images are named in source.options" if role != "laser" else "check the file",
        ) from error
    if data.size == 0:
        raise DataError(f"{path}: the file is empty")
    if _cut_off(data):
        raise DataError(f"{path}: the file is cut off", hint="copy it again")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we say what is wrong, with the file
    try:
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise DataError(f"{path}: not an image that can be read, or damaged", hint="open it in a viewer")
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[:, :, :3]
    if pixels.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{path}: pixels are {pixels.dtype}; 8 or 16 bit unsigned are read")
    return Frame(pixels, role=role, name=path.name, bit_depth=8 * pixels.dtype.itemsize)


def _cut_off(data: np.ndarray) -> bool:
    """Tell a PNG or JPEG without its end: decoders fill such images with grey and say nothing."""
    head = bytes(data[:8])
    tail = bytes(data[-4096:]).rstrip(b"\0")[-64:]  # some cameras pad their files
    if head.startswith(b"\x89PNG"):
        return b"IEND" not in tail
    if head.startswith(b"\xff\xd8"):
        return b"\xff\xd9" not in tail
    return False


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    elif _is_pattern(path):
        found = list(path.parent.glob(path.name))
    else:
        found = [path] if path.is_file() else []
    return sorted(file for file in found if file.is_file())


def _is_pattern(path: Path) -> bool:
    return any(mark in path.name for mark in "*?[")
