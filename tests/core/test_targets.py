"""Targets: what is printed is what is described, OpenCV finds it, and solids are closed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.config.target_file import (
    BlockFile,
    BoardFile,
    PyramidFile,
    SpherePlateFile,
    StaircaseFile,
    read_target,
)
from roemetry.errors import ConfigurationError
from roemetry.targets.sheets import Disc, Rectangle, Sheet, Words, board_shapes, lay_out, pdf_of, svg_of
from roemetry.targets.solids import solid_triangles, stl_of
from tests.command import typed

PX_PER_MM = 10
CHARUCO = BoardFile(
    kind="charuco", name="board", columns=11, rows=8, pitch_mm=8.0, marker_mm=6.0, dictionary="DICT_4X4_250"
)


def drawn(sheet: Sheet) -> np.ndarray:
    """Draw a sheet's shapes with OpenCV, 10 px a millimetre; pixel (0, 0) is at 0.05 mm, 0.05 mm."""
    size = round(sheet.height_mm * PX_PER_MM), round(sheet.width_mm * PX_PER_MM)
    image = np.full(size, 255, np.uint8)
    for shape in sheet.shapes:
        x, y = (round(v * PX_PER_MM) for v in (shape.x_mm, shape.y_mm))
        if isinstance(shape, Rectangle):
            right = round((shape.x_mm + shape.width_mm) * PX_PER_MM)
            image[y : round((shape.y_mm + shape.height_mm) * PX_PER_MM), x:right] = 0
        elif isinstance(shape, Disc):
            cv2.circle(image, (x, y), round(shape.radius_mm * PX_PER_MM), 0, -1, cv2.LINE_AA)
    return image


@pytest.mark.parametrize("layout", ["new", "old"])
@pytest.mark.parametrize(("columns", "rows"), [(11, 8), (8, 11), (7, 5)])
def test_opencv_finds_every_corner_where_it_was_drawn(layout: str, columns: int, rows: int) -> None:
    board = CHARUCO.model_copy(update={"layout": layout, "columns": columns, "rows": rows})
    sheet = lay_out(board, "0", None)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    expected = cv2.aruco.CharucoBoard((columns, rows), 8.0, 6.0, dictionary)
    expected.setLegacyPattern(layout == "old")
    corners, ids, _, _ = cv2.aruco.CharucoDetector(expected).detectBoard(drawn(sheet))
    assert len(ids) == (columns - 1) * (rows - 1)
    found_mm = (corners.reshape(-1, 2) + 0.5) / PX_PER_MM
    true_mm = np.asarray(expected.getChessboardCorners())[ids.ravel(), :2]
    offset = found_mm - true_mm
    np.testing.assert_allclose(offset - offset.mean(axis=0), 0.0, atol=0.02)  # mm


def test_the_chessboard_and_the_circles_are_found() -> None:
    board = BoardFile(kind="chessboard", name="b", columns=11, rows=8, pitch_mm=8.0)
    found, corners = cv2.findChessboardCornersSB(drawn(lay_out(board, "0", None)), (10, 7))
    assert found
    steps = np.diff(corners.reshape(7, 10, 2), axis=1)
    np.testing.assert_allclose(np.abs(steps).max(axis=2), 80.0, atol=0.1)  # px
    grid = BoardFile(kind="circle-grid", name="g", columns=6, rows=4, pitch_mm=20.0)
    image = drawn(lay_out(grid, "0", None))
    # OpenCV's default detector takes spots of less than 5,000 px.
    image = cv2.resize(image[: -24 * PX_PER_MM], None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    found, centres = cv2.findCirclesGrid(image, (6, 4))
    assert found
    steps = np.diff(centres.reshape(4, 6, 2), axis=1)
    np.testing.assert_allclose(np.abs(steps).max(axis=2), 50.0, atol=0.1)  # px


def test_a_sheet_has_a_ruler_a_name_and_nothing_beside_the_page() -> None:
    sheet = lay_out(CHARUCO, "1a2b3c4d", None)
    words = " ".join(shape.text for shape in sheet.shapes if isinstance(shape, Words))
    for expected in ("board", "11 × 8", "8 mm", "DICT_4X4_250", "id 1a2b3c4d", "100 %"):
        assert expected in words
    numbers = [int(s.text.split()[0]) for s in sheet.shapes if isinstance(s, Words) and s.text[0].isdigit()]
    marks = {shape.text: shape.x_mm for shape in sheet.shapes if isinstance(shape, Words)}
    assert max(numbers) >= 100
    assert marks["100"] - marks["0 mm"] == pytest.approx(100.0, abs=1e-9)  # mm
    for shape in sheet.shapes:
        assert 0 < shape.x_mm < sheet.width_mm
        assert 0 < shape.y_mm < sheet.height_mm


def test_pages() -> None:
    assert (lay_out(CHARUCO, "0", None).width_mm, lay_out(CHARUCO, "0", "a3").width_mm) == (210.0, 297.0)
    wide = CHARUCO.model_copy(update={"columns": 30})
    assert lay_out(wide, "0", None).width_mm == 297.0


def test_svg_and_pdf_have_the_true_size() -> None:
    sheet = lay_out(CHARUCO, "0", None)
    svg = svg_of(sheet)
    assert 'width="210mm" height="297mm" viewBox="0 0 210 297"' in svg
    assert svg.count("<rect") == 1 + sum(isinstance(shape, Rectangle) for shape in sheet.shapes)
    pdf = pdf_of(sheet)
    left, low, right, high = map(float, re.findall(rb"/MediaBox \[([^]]*)", pdf)[0].split())
    assert (right - left) * 25.4 / 72 == pytest.approx(210.0, abs=0.01)  # mm
    assert (high - low) * 25.4 / 72 == pytest.approx(297.0, abs=0.01)  # mm
    assert pdf == pdf_of(sheet)


def volume_mm3(triangles: np.ndarray) -> float:
    return float(np.einsum("ni,ni->n", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6)


def open_edges(triangles: np.ndarray) -> int:
    """Edges that are not met by their reverse as often as they stand."""
    corners = np.round(triangles, 6)
    ahead = Counter(
        (tuple(a), tuple(b)) for t in corners for a, b in zip(t, np.roll(t, -1, axis=0), strict=True)
    )
    return sum(abs(count - ahead[b, a]) for (a, b), count in ahead.items())


STAIRS = StaircaseFile(kind="staircase", name="s", heights_mm=[4, 12, 8, 8, 2], tread_mm=15, width_mm=100)
BLOCK = BlockFile(kind="block", name="b", length_mm=105, width_mm=40, height_mm=16.5)
PYRAMID = PyramidFile(kind="truncated-pyramid", name="p", base_mm=60, top_mm=20, height_mm=20)
TWO = {"kind": "sphere-plate", "name": "b", "columns": 2, "rows": 1, "diameter_mm": 20}
BALLS = SpherePlateFile(**TWO, pitch_mm=30, centre_height_mm=15)
SOLIDS = {
    "block": (BLOCK, 105 * 40 * 16.5, 1e-9),
    "stairs": (STAIRS, 34 * 15 * 100.0, 1e-9),
    "pyramid": (PYRAMID, 20 / 3 * (3600 + 400 + 1200), 1e-9),
    "balls": (BALLS, 60 * 30 * 7.0 + 2 * 4 / 3 * np.pi * 1000, 0.003),
}


@pytest.mark.parametrize(("target", "expected_mm3", "relative"), SOLIDS.values(), ids=SOLIDS)
def test_solids_are_closed_and_have_their_volume(target, expected_mm3: float, relative: float) -> None:
    triangles = solid_triangles(target)
    assert open_edges(triangles) == 0
    assert volume_mm3(triangles) == pytest.approx(expected_mm3, rel=relative)
    assert triangles[:, :, 2].min() == 0.0
    data = stl_of(triangles, "p")
    assert int.from_bytes(data[80:84], "little") == len(triangles)
    assert len(data) == 84 + 50 * len(triangles)
    first = np.frombuffer(data[84 + 12 : 84 + 48], "<f4").reshape(3, 3)
    np.testing.assert_allclose(first, triangles[0], atol=1e-5)


def board(**changed: object) -> BoardFile:
    return CHARUCO.model_copy(update=changed)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: lay_out(board(pitch_mm=30.0), "0", "a4"), "needs a page of .* a4 is 210"),
        (lambda: lay_out(CHARUCO, "0", "b4"), "there is no page size `b4`"),
        (lambda: board_shapes(board(dictionary="DICT_9X9")), "no dictionary DICT_9X9"),
        (
            lambda: board_shapes(board(dictionary="DICT_4X4_50", columns=20, rows=20)),
            "takes 200 markers, DICT_4X4_50 has 50",
        ),
        (lambda: solid_triangles(BLOCK.model_copy(update={"height_mm": None})), "lacks a side"),
        (
            lambda: solid_triangles(SpherePlateFile(**TWO, pitch_mm=20, centre_height_mm=15)),
            "touch each other",
        ),
        (
            lambda: solid_triangles(SpherePlateFile(**TWO, pitch_mm=30, centre_height_mm=5)),
            "no room for a plate",
        ),
    ],
)
def test_what_cannot_be_made_is_named(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        make()


def test_the_verb_makes_shipped_and_own_targets(tmp_path: Path) -> None:
    listed = typed("target")
    assert "staircase-4x4" in listed.stdout
    names = [line.split()[0] for line in listed.stdout.splitlines()]
    typed("target", *names, "--out", tmp_path)
    assert {path.stem for path in tmp_path.iterdir()} == set(names)
    own = tmp_path / "own.yaml"
    own.write_text("kind: cube\nname: x\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"own.yaml:1:1: kind: found 'cube', expected one of block"):
        read_target(own)
    wrong = typed("target", "starcase-4x4", code=1)
    assert isinstance(wrong.exception, ConfigurationError)
    assert "did you mean `staircase-4x4`" in str(wrong.exception)
