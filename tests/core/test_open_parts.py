"""What is open of a product; a rig that moves in the course of a run; frames with faults of transport."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry import Recipe
from roemetry.errors import DataError
from roemetry.records import AMBIGUOUS, Estimate, Frame, Outline, Peaks, Shares, StripeMap, Volume
from roemetry.run.open_parts import open_parts, widened
from roemetry.run.record import MotionTrend
from roemetry.run.transport_faults import check_joins, check_lines

REST_PX = np.linspace(50.0, 450.0, 9)[:, None] + np.zeros(200)
"""(stripe, row) rest lines 50 px apart."""
LIFTED_PX = 20.0


def scene(
    refused: tuple[tuple[int, int], ...], belt_refused: tuple[int, ...] = (), hidden: tuple[int, ...] = ()
) -> tuple[Peaks, StripeMap]:
    """Products on stripes 1–3 and 5–7, rows 60–139; refused: (stripe, row), and whole belt stripes.

    Where stripes are `hidden`, the two are the ends of one body, refused between.
    """
    x_px = REST_PX.copy()
    on = np.zeros(x_px.shape, np.int16)
    for number, stripes in enumerate((slice(1, 4), slice(5, 8)), start=1):
        x_px[stripes, 60:140] += LIFTED_PX
        on[stripes, 60:140] = number
    x_px[list(hidden), 60:140] = REST_PX[list(hidden), 60:140] + LIFTED_PX
    row, stripe = np.nonzero(np.ones(x_px.shape[::-1], bool))
    verdict = stripe.astype(np.int16)
    for one, at in refused:
        verdict[(stripe == one) & (row == at)] = AMBIGUOUS
    verdict[np.isin(stripe, belt_refused) & (on[stripe, row] == 0)] = AMBIGUOUS
    verdict[np.isin(stripe, hidden) & (row >= 60) & (row < 140)] = AMBIGUOUS
    seen = np.zeros(x_px.shape, bool)
    seen[stripe, row] = verdict >= 0
    one, whole = np.ones(row.size), np.where(seen, 1.0, np.nan)
    peaks = Peaks(
        image_size=(200, 500), row=row, x_px=x_px[stripe, row], x_std_px=0.05 * one, amplitude=100.0 * one,
        background=10.0 * one, width_px=4.0 * one, flags=np.zeros(row.size, np.uint8),
    )  # fmt: skip
    return peaks, StripeMap(
        x_px=np.where(seen, x_px, np.nan), x_std_px=0.05 * whole, product=np.where(seen, on, -1), seen=seen,
        margin=whole, ambiguous=np.zeros(seen.shape, bool), rest_px=REST_PX, peak_stripe=verdict, reasons=(),
    )  # fmt: skip


def test_refused_belt_leaves_no_product_open() -> None:
    found = open_parts(*scene((), belt_refused=(1, 2, 3, 4)))
    assert [part.points for part in found.values()] == [0, 0]


def test_each_refused_peak_counts_against_its_own_product_only() -> None:
    lost = tuple((2, row) for row in range(90, 100))
    first, second = open_parts(*scene(lost)).values()
    assert (first.points, second.points) == (10, 0)
    assert first.share == pytest.approx(10 / 240)
    assert first.rows == (90, 99)
    assert first.x_px == (170.0, 170.0)


def test_open_points_widen_in_quadrature() -> None:
    stated = Estimate(1000.0, 3.0, {"peaks": 3.0}, (994.0, 1006.0))
    volume, _ = widened(Volume(stated, None, Shares(1.0, 0.0, 0.0)), None, 0.004)
    assert volume.visible_mm3.std == pytest.approx(5.0)
    assert volume.visible_mm3.budget["open points"] == pytest.approx(4.0)
    low, high = volume.visible_mm3.interval
    assert high - 1000.0 == pytest.approx(np.hypot(6.0, 1.959964 * 4.0))
    assert 1000.0 - low == pytest.approx(high - 1000.0)


def test_what_is_open_between_two_pieces_counts_for_both() -> None:
    """A body on stripes 1 to 7, of which 3 to 5 are refused: its two ends are no products."""
    found = open_parts(*scene((), hidden=(3, 4, 5)))
    assert [part.points for part in found.values()] == [240, 240]


ANY = "stages.grader={use: grade-table, options: {classes: [{label: any}]}}"
ALONE = ("stages.volume=null", "stages.weigher=null", "stages.classifier=null")


@pytest.mark.parametrize("sets", [(), ALONE], ids=["with other stages", "the only stage"])
def test_a_product_that_is_cut_by_the_images_edge_is_not_decided_upon(
    line: Callable[..., Path], rig, sets: tuple[str, ...]
) -> None:
    path = line(count=1)
    cut = rig.image(rig.x_px(rig.dome(first=170, last=270)))
    cv2.imwrite(str(path.parent / "images" / "p02.png"), cut)
    whole, at_the_edge = Recipe.load(path, sets=[ANY, *sets]).run()
    assert whole.decision is not None and whole.decision.label == "any"
    assert at_the_edge.decision is None
    assert at_the_edge.absent["grader"].code == "cut-by-edge"


def test_what_an_outline_holds_is_the_products_also_on_a_rest_line() -> None:
    """The top of a flat body one spacing of displacement high lies where the belt's lines would be."""
    peaks, stripes = scene((), belt_refused=(4,))
    left, right = REST_PX[3, 0], REST_PX[5, 0]
    square = np.array([[left, 0.5], [right, 0.5], [right, 179.5], [left, 179.5]])
    found = open_parts(peaks, stripes, (Outline(product=1, xy_px=square),))
    deep = range(26, 155)  # half a spacing of 50 px inside
    assert (found[1].points, found[1].rows) == (len(deep), (deep[0], deep[-1]))
    assert found[2].points == 0


def test_belt_outside_a_bent_products_outline_is_not_the_products() -> None:
    """A stripe's belt lies between the product's points to both sides, on its rest line."""
    lost = tuple((2, row) for row in range(60, 140))
    peaks, stripes = scene(lost)
    on_belt = np.where(peaks.x_px == REST_PX[2, 0] + LIFTED_PX, REST_PX[2, 0], peaks.x_px)
    peaks = replace(peaks, x_px=on_belt)
    (left, _), (right, _) = REST_PX[1:4:2, :2] + LIFTED_PX
    bent = np.array([[left - 9, 59], [right + 9, 59], [right + 9, 141], [right - 9, 141],
                     [right - 9, 61], [left + 9, 61], [left + 9, 141], [left - 9, 141]])  # fmt: skip
    assert open_parts(peaks, stripes)[1].points == 80
    assert open_parts(peaks, stripes, (Outline(product=1, xy_px=bent.astype(np.float64)),))[1].points <= 2


def told(motion_px: np.ndarray) -> str:
    trend = MotionTrend()
    for number, motion in enumerate(motion_px):
        trend.add(f"image_{number:03d}", tuple(motion.tolist()))
        trend.add(f"image_{number:03d}", tuple(motion.tolist()))  # a second product's row
    return "" if trend.reason is None else trend.reason.text


def test_a_rig_that_stands_still_is_not_told(rng: np.random.Generator) -> None:
    assert all(told(rng.normal(0.3, 0.03, (400, 4))) == "" for _ in range(20))


@pytest.mark.parametrize(("part", "said"), [(0, "shifts along x"), (1, "turns"), (2, "grows"), (3, "tilts")])
def test_a_rig_that_creeps_is_told_from_its_beginning(part: int, said: str, rng: np.random.Generator) -> None:
    motion_px = rng.normal(0.0, 0.03, (120, 4))
    motion_px[60:, part] -= 0.01 * np.arange(60)
    text = told(motion_px)
    since = int(text.split("image_")[1][:3])
    assert said in text and " -0." in text
    assert 55 <= since <= 75


def test_few_images_say_nothing(rng: np.random.Generator) -> None:
    assert told(np.linspace(0.0, 3.0, 8)[:, None] * np.ones(4)) == ""


ROWS, COLUMNS = 1280, 400


def line_at(x_px: float, rng: np.random.Generator) -> np.ndarray:
    """Give a frame with one upright line on ground with noise."""
    columns = np.arange(COLUMNS)
    light = 11.0 + 180.0 * np.exp(-0.5 * ((columns - x_px) / 1.8) ** 2)
    return np.clip(np.rint(light + rng.normal(0.0, 1.2, (ROWS, COLUMNS))), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("x_px", [150.0, 199.5, 200.25])
def test_a_whole_frame_with_a_line_is_no_join(x_px: float, rng: np.random.Generator) -> None:
    frame = line_at(x_px, rng)
    check_joins(Frame(frame))
    frame[500:, 200:] = line_at(x_px, rng)[500:, 200:]
    check_joins(Frame(frame))  # the same line goes on: nothing breaks off


def test_noise_in_a_dark_frame_is_no_join(rng: np.random.Generator) -> None:
    """Noise as large as a step has to be; black clips half of it."""
    for _ in range(20):
        light = 4.0 + 95.0 * np.exp(-0.5 * ((np.arange(200) - 99.3) / 1.6) ** 2)
        grey = np.clip(np.rint(light + rng.normal(0.0, 7.0, (200, 200))), 0, 255).astype(np.uint8)
        check_joins(Frame(grey))
    grey[:, 99:] = np.roll(grey, 40, axis=1)[:, 99:]
    with pytest.raises(DataError, match="between the columns|between the rows"):
        check_joins(Frame(grey))


@pytest.mark.parametrize("share", [0.06, 0.2, 1.0])
@pytest.mark.parametrize("together", [True, False])
def test_columns_that_are_joined_in_some_rows_are_found(
    share: float, together: bool, rng: np.random.Generator
) -> None:
    """A part of another frame, in rows one after the other or here and there, begins in its line."""
    frame, other = line_at(100.0, rng), line_at(200.0, rng)
    many = round(share * ROWS)
    rows = np.arange(many) if together else rng.choice(ROWS, many, replace=False)
    frame[rows, 200:] = other[rows, 200:]
    with pytest.raises(DataError, match="between the columns 199 and 200|between the rows"):
        check_joins(Frame(frame))


@pytest.mark.parametrize("rows", [slice(1, None, 2), slice(0, None, 2), slice(1, None, 4), slice(3, None, 4)])
@pytest.mark.parametrize("height", [600, ROWS])
def test_columns_that_are_joined_in_every_so_many_rows_are_found(
    rows: slice, height: int, rng: np.random.Generator
) -> None:
    """One field of an interlaced frame is another frame's."""
    frame, other = line_at(100.0, rng)[:height], line_at(200.0, rng)[:height]
    frame[rows, 200:] = other[rows, 200:]
    with pytest.raises(DataError, match="between the columns 199 and 200"):
        check_joins(Frame(frame))


def test_a_speck_in_the_dark_beside_one_line_is_no_end_of_filled_columns(rng: np.random.Generator) -> None:
    """Little read noise leaves all columns but those of the line at one level."""
    columns = np.arange(200.0)
    lit = 90.0 * np.exp(-0.5 * ((columns - 60.0) / 2.0) ** 2) * rng.uniform(0.9, 1.1, (160, 1))
    pixels = (4.0 + lit).astype(np.uint8)
    check_lines(Frame(pixels, name="dark"))
    pixels[80, 137] = 255
    check_lines(Frame(pixels, name="a speck"))
