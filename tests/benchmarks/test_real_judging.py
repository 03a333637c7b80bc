"""How peaks on real images are judged."""

from __future__ import annotations

import sys

import numpy as np
import pytest

wheelset = pytest.importorskip("benchmarks.real_images.wheelset", reason="only in a checkout")

from benchmarks import real  # noqa: E402
from benchmarks.real_images import folder_of, prepared  # noqa: E402


def test_absent_images_are_told(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setenv("ROEMETRY_REAL_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["real", "--extractors", "gaussian"])
    real.main()
    assert capsys.readouterr().err.count("ROEMETRY_REAL_DATA") == len(real.SETS) + 1 == 7
    assert folder_of("weld_mit") is None


def test_the_marks_cover_200_rows_with_every_verdict() -> None:
    across, down = wheelset.marks(0, 672), wheelset.marks(90, 800)
    assert len({each.index for each in across}) + len({each.index for each in down}) == 200
    assert {each.verdict for each in across + down} == {"stripe", "glare", "merged", "grazing"}
    assert all(0 <= each.first <= each.last < 800 for each in across + down)


def test_peaks_are_judged_by_the_marks() -> None:
    marked = [
        wheelset.Marked(5, 10.0, 20.0, "stripe"),
        wheelset.Marked(5, 40.0, 50.0, "glare"),
        wheelset.Marked(5, 60.0, 70.0, "merged"),
        wheelset.Marked(7, 10.0, 20.0, "stripe"),
    ]
    row = np.array([5, 5, 5, 5, 5, 6])
    x_px = np.array([14.8, 18.0, 45.0, 65.0, 90.0, 3.0])
    right, counts = wheelset.judged(marked, row, x_px)
    assert right.tolist() == [True, False, False, True, False, True]
    assert counts.tolist() == [2, 1, 3, 1, 1, 1]


def test_another_programs_points_count_where_steep_and_lit() -> None:
    pixels = np.zeros((100, 60), np.uint8)
    pixels[:, 20:50] = 200
    pixels[20:30] = 0
    drawn = np.zeros((100, 60, 3), np.uint8)
    drawn[:60, 30, 2] = 128
    drawn[80, 22:48, 2] = 128  # runs along the row
    frame = prepared(pixels, turn_deg=0)
    wanted = list(wheelset.lit_centres(drawn, frame, 0))
    assert wanted == [(row, 30.0) for row in [*range(21), *range(29, 60)]]  # light reaches one pixel further
    off = wheelset.distances(frame, wanted[:2], np.array([0]), np.array([31.5]))
    assert off == [1.5, np.inf]


def test_points_judged_by_eye_are_those_of_the_image_as_it_is_turned() -> None:
    """The file holds rows and columns; a column of the image is a row of the turned one, from the last on."""
    upright, turned = wheelset.verdicts(0, 672), wheelset.verdicts(90, 800)
    assert len(upright) + len(turned) == 439
    assert {*upright.values(), *turned.values()} == {"stripe", "beside", "border"}
    assert upright[243, 0.5] == "border" and turned[799 - 401, 0.0] == "beside"
    with wheelset.POINTS.open() as lines:
        assert "column,401,0,beside\n" in lines
    wanted = [(243, 0.5), (799 - 401, 0.0), (300, 400.0)]
    assert wheelset.have_stripe(wanted, upright) == [False, True, True], "what was not judged has a stripe"


def test_turned_marks_lie_where_the_turned_image_has_them() -> None:
    """Turned by 90° counter-clockwise, the last column is the first row, and y stays the place in it."""
    mark = next(each for each in wheelset.marks(90, 800) if each.verdict == "stripe")
    pixels = np.zeros((672, 800), np.uint8)
    pixels[int(mark.first) : int(mark.last) + 1, 799 - mark.index] = 255
    turned = prepared(pixels, turn_deg=90).pixels
    assert (turned[mark.index, int(mark.first) : int(mark.last) + 1] == 255).all()
