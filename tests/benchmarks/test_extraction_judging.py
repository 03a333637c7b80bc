"""The judges of extractors, judged: the bound against a closed form, drawing, scoring, real images."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from benchmarks import real
from benchmarks.extraction import drawing, judging, methods, peers
from benchmarks.extraction.drawing import bound_px
from benchmarks.real_images import folder_of, prepared, wheelset

SIZE = (60, 400)


def straight(x_px: float = 200.0, sigma: float = 2.5, amplitude: float = 120.0):
    ones = np.ones((1, SIZE[0]))
    return drawing.Stripes(x_px * ones, sigma * ones, amplitude * ones, ones.astype(bool))


def test_the_bound_is_the_closed_form_where_there_is_one(rng) -> None:
    """White noise on a Gaussian: variance 2 σ v / (√π A²), whatever else is unknown."""
    light = drawing.Light(ambient=(10.0, 0.0, 0.0), grey_per_electron=1e-9, read_noise=3.0)
    drawn = drawing.draw(straight(), SIZE, rng, light)
    variance = 3.0**2 + 1.0 / 12.0
    expected = math.sqrt(2.0 * 2.5 * variance / (math.sqrt(math.pi) * 120.0**2))
    # pixels average over their width: 2 % of the slope of a stripe of σ 2.5 px
    np.testing.assert_allclose(bound_px(drawn), expected, rtol=0.03)


def test_speckle_saturation_and_darkness_raise_the_bound(rng) -> None:
    def bound(contrast: float = 0.0, **stripe: float) -> float:
        return float(
            bound_px(drawing.draw(straight(**stripe), SIZE, rng, drawing.Light(contrast=contrast))).mean()
        )

    assert bound() < bound(contrast=0.05) < bound(contrast=0.2)
    assert bound(amplitude=230.0) < bound(amplitude=120.0) < bound(amplitude=40.0)
    photons = 2000.0 * 2.5 * math.sqrt(2.0 * math.pi) / drawing.GREY_PER_ELECTRON
    assert bound(amplitude=2000.0) > 2.0 * 2.5 / math.sqrt(photons), "white pixels carry nothing"
    # speckle's part goes with its contrast, the sensor's part stays
    assert 1.5 < bound(contrast=0.2) / bound(contrast=0.1) < 2.0


def test_a_fit_to_many_rows_scatters_by_the_bound(rng) -> None:
    """Least squares is efficient for white noise: the drawing and the bound speak of the same noise."""
    from scipy.optimize import least_squares

    light = drawing.Light(ambient=(10.0, 0.0, 0.0), grey_per_electron=1e-9, read_noise=3.0)
    drawn = drawing.draw(straight(200.3), SIZE, rng, light)
    off = np.arange(180, 221)

    def fitted(row: np.ndarray) -> float:
        def model(p: np.ndarray) -> np.ndarray:
            return p[1] * drawing.pixel_profile(off - p[0], p[2]) + p[3] - row[off]

        return float(least_squares(model, [200.0, 100.0, 2.0, 10.0]).x[0])

    error = np.array([fitted(row.astype(float)) for row in drawn.pixels]) - 200.3
    assert error.std() == pytest.approx(float(bound_px(drawn).mean()), rel=0.25)  # 60 rows: ± 9 %
    assert abs(error.mean()) < 4.0 * error.std() / math.sqrt(error.size)


def test_drawn_light_is_what_was_asked_for(rng) -> None:
    stripes = straight(200.4)
    light = drawing.laser_light(stripes, SIZE)
    columns = np.arange(SIZE[1])
    np.testing.assert_allclose((light * columns).sum(axis=1) / light.sum(axis=1), 200.4, atol=1e-3)  # px
    np.testing.assert_allclose(light.sum(axis=1), 120.0 * 2.5 * math.sqrt(2.0 * math.pi), rtol=1e-5)
    many = drawing.draw(straight(amplitude=100.0), SIZE, rng, drawing.Light(contrast=0.2))
    assert many.contrast == pytest.approx(0.2)
    tops = many.pixels[:, 200].astype(float) - many.background[0]
    assert tops.std() / tops.mean() == pytest.approx(0.2, abs=0.06)


def test_hard_images_have_gaps_and_hot_pixels(rng) -> None:
    drawn = drawing.drawn_set("hard", (240, 640), rng)
    assert (~drawn.stripes.lit).sum() == 6 * 20
    dark = drawing.laser_light(drawn.stripes, (240, 640)) < 1e-3
    assert (drawn.pixels[dark] > 80).sum() >= 5


def test_peaks_are_matched_as_described() -> None:
    truth = straight(100.0)
    truth.lit[0, 10:20] = False
    row = np.array([0, 0, 1, 2, 12, 30.5])
    x_px = np.array([100.5, 101.5, 103.0, 98.5, 100.0, 100.1])
    found = drawing.hits(truth, drawing.Found(row, x_px, np.full(6, 0.1)))
    assert found.error_px[0, 0] == pytest.approx(0.5), "the nearer of two"
    assert np.isnan(found.error_px[0, 1]), "3 px away is another thing"
    assert found.error_px[0, 2] == pytest.approx(-1.5)
    assert np.isnan(found.error_px[0, 12]), "a peak in a gap"
    assert found.false == 3
    assert found.missed == found.lit - 3 == 47
    empty = drawing.hits(truth, drawing.Found(*(np.empty(0),) * 3))
    assert (empty.missed, empty.false) == (50, 0)


@pytest.mark.parametrize("recipe", ["opencv_log_parabola", "scipy_log_parabola", "opencv_centre_of_gravity"])
def test_recipes_of_others_are_given_their_best(recipe: str, rng) -> None:
    """The peers find everything on clean images: a weak rival would flatter ours."""
    drawn = drawing.drawn_set("clean", drawing.SIZES["VGA"], rng)
    found = drawing.hits(drawn.stripes, getattr(peers, recipe)(drawn.pixels))
    assert found.missed == 0
    assert found.false <= 2
    judged = ~drawn.saturated
    limit = 5.0 if recipe.startswith("scipy") else 2.0
    assert drawing.rms(found.error_px[judged]) < limit * drawing.rms(bound_px(drawn)[judged])


def test_the_papers_rivals_do_what_the_paper_says(rng) -> None:
    """Middles of runs above the level; a pixel higher than the next and not lower than the one before."""
    pixels = rng.integers(0, 90, (300, 24), dtype=np.uint8)
    runs, maxima = peers.numpy_runs(pixels), peers.numpy_maxima(pixels)
    for y, levels in enumerate(pixels.tolist()):
        bright = [x for x, level in enumerate(levels) if level > peers.LEVEL]
        begins, ends = ([x for x in bright if x + step not in bright] for step in (-1, 1))
        expected = [0.5 * (begin + end) for begin, end in zip(begins, ends, strict=True)]
        assert runs.x_px[runs.row == y].tolist() == expected
        tops = [x for x in range(1, 23) if levels[x - 1] <= levels[x] > levels[x + 1]]
        assert maxima.x_px[maxima.row == y].tolist() == [x for x in tops if levels[x] >= peers.LEVEL]


@pytest.mark.skipif(peers.COMPILER is None, reason="no C++ compiler")
@pytest.mark.parametrize(("reach", "weighted"), [(2, False), (4, True)])
def test_the_first_try_in_cpp_finds_what_it_should(reach: int, weighted: bool, rng) -> None:
    drawn = drawing.drawn_set("clean", drawing.SIZES["VGA"], rng)
    found = drawing.hits(drawn.stripes, peers.compiled(reach, weighted=weighted)(drawn.pixels))
    assert found.missed <= 5
    assert found.false <= 5
    judged = ~drawn.saturated
    assert drawing.rms(found.error_px[judged]) < 2.0 * drawing.rms(bound_px(drawn)[judged])


def test_bias_is_the_largest_mean_with_its_sign() -> None:
    by_image = np.zeros((4, 3, 3, judging.PHASES))
    by_image[:, 1, 2, 3] = -0.02
    by_image[:, 0, 0, 0] = [0.01, 0.02, 0.01, 0.02]
    largest, error = judging.summary(by_image)
    assert largest == "−0.0200"
    assert float(error) > 0.0


def test_every_extractor_is_compared_and_the_absent_is_told(monkeypatch) -> None:
    monkeypatch.setattr(methods.importlib.util, "find_spec", lambda name: None)
    found, left_out = methods.methods()
    names = {method.name for method in found if method.ours}
    assert {each for each, stage in methods.extractors() if not isinstance(stage, str)} == names
    assert "pip install" in left_out["ridge-detector"]


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
