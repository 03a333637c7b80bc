"""A sphere plate among stripes: found where it lies, with the size it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import Shown, shown
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Frame, Observation, SpherePlate
from roemetry.testing import LinearRig
from roemetry_pinhole.bundle import Adjusted, Measured
from roemetry_pinhole.calibrator import PinholeCalibrator
from roemetry_pinhole.conformance import _image, _peaks, _pose, observed_of
from roemetry_pinhole.from_solids import from_solids
from roemetry_pinhole.geometry import CAMERA, BeltContacts, Geometry, StripePoints, unknowns_of
from roemetry_pinhole.pinhole_plane import lines_at_height, parameters_of, view_of
from roemetry_pinhole.plates import find_plate, from_plate
from roemetry_pinhole.solids import shape_of
from tests.plugins.pinhole.solids_seen import (
    crossings,
    height_errors,
    on_belt,
    over_balls,
    seen_as,
    set_of,
)  # fmt: skip
from tests.plugins.pinhole.test_solids import RIGS, SIZE, STRIPES, solid, wide


def plate_of(width: float) -> SpherePlate:
    return SpherePlate("p", 3, 2, 0.26 * width, 0.18 * width, 0.13 * width, 0.01)


@pytest.mark.parametrize("name", list(RIGS))
def test_place_and_size_are_found_within_what_is_stated(name: str, rng) -> None:
    """Twelve plates, anywhere and turned by up to 12°, up to 3 % larger or smaller than described."""
    geometry, width = shown(RIGS[name], rng).geometry, wide(RIGS[name])
    plate = plate_of(width)
    parameters = parameters_of(geometry, travel=False)
    belt, view = crossings(geometry, None, SIZE), view_of(parameters, SIZE)
    over = []
    for _ in range(12):
        x, y = rng.uniform(-0.06, 0.06, 2) * width
        true = np.array([x, y, np.radians(rng.uniform(-12.0, 12.0)), rng.uniform(0.97, 1.03)])
        seen = seen_as("sphere_plate", over_balls(view, plate, true, belt), SIZE, rng, 0.1)
        found = find_plate(parameters, seen.peaks, plate)
        assert found.balls >= 4, "two may lie beside the stripes"
        assert np.abs(found.pose[:2] - true[:2]).max() < 0.02, "mm"
        assert found.pose[2] == pytest.approx(true[2], abs=5e-4), "rad"
        assert found.random_std() < 2e-4
        over.append((np.log(found.pose[3]) - np.log(true[3])) / found.random_std())
    assert np.sqrt(np.mean(np.square(over))) < 1.8


def test_an_empty_belt_and_a_block_are_no_sphere_plate(rng) -> None:
    geometry, width = shown(RIGS["gentle"], rng).geometry, wide(RIGS["gentle"])
    parameters = parameters_of(geometry, travel=False)
    belt = crossings(geometry, None, SIZE)
    for x_px in (belt, np.full_like(belt, np.nan)):
        seen = seen_as("sphere_plate", x_px, SIZE, rng, 0.1)
        assert find_plate(parameters, seen.peaks, plate_of(width)) is None


def boards_of(exact: Shown) -> Measured:
    """Boards with the laser off, the first one lying on the belt; the camera is known."""
    none, whole, first = np.empty(0), np.empty(0, np.int64), np.zeros(3, np.int64)
    start = replace(exact.geometry, planes=np.empty((0, 3)), belt=np.full(3, np.nan))
    far = exact.corners.board_mm.max(axis=0)
    under = far * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    unknowns = unknowns_of(start, free_camera=np.zeros(CAMERA, bool), planes=False, belt=False, travel=False)
    points, contacts = (
        StripePoints(whole, whole, none, none, none, none),
        BeltContacts(first, under, np.zeros(3)),
    )
    return Measured(start, unknowns, exact.corners, points, contacts, 0.01)


def plates_on(geometry: Geometry, plate: SpherePlate, width: float, places, rng) -> CalibrationSet:
    """The empty belt, and the plate at places across the stripes."""
    view, belt = view_of(parameters_of(geometry, travel=False), SIZE), crossings(geometry, None, SIZE)
    seen = [seen_as("belt", belt, SIZE, rng, 0.1)]
    for place in places:
        pose = np.array([place * width, -0.02 * width, np.radians(rng.uniform(-8.0, 8.0)), 1.0])
        seen.append(seen_as("sphere_plate", over_balls(view, plate, pose, belt), SIZE, rng, 0.1))
    return set_of(seen, STRIPES, sphere_plate=plate)


def errors_of(adjusted: Adjusted, true: Geometry, levels) -> tuple[np.ndarray, np.ndarray]:
    """Heights of exact stripes on levels less the true ones, and what the covariance states, mm."""
    factor = np.linalg.cholesky(adjusted.covariance + 1e-24 * np.eye(len(adjusted.covariance)))
    drawn = np.random.default_rng(5).normal(size=(60, len(factor))) @ factor.T
    geometries = [adjusted.geometry, *(adjusted.unknowns.moved(adjusted.geometry, one) for one in drawn)]
    return height_errors(
        true, [view_of(parameters_of(one, travel=False), SIZE) for one in geometries], levels, SIZE
    )


@pytest.mark.parametrize("name", ["tilted", pytest.param("gentle", marks=pytest.mark.thorough)])
def test_planes_from_a_sphere_plate_measure_heights(name: str, rng) -> None:
    """Five images of it; the belt is known from a board that lies on it."""
    exact, width = shown(RIGS[name], rng), wide(RIGS[name])
    plate = replace(plate_of(width), tolerance_mm=0.0)
    observed = plates_on(exact.geometry, plate, width, (-0.2, -0.1, 0.0, 0.1, 0.2), rng)
    boards = boards_of(exact)
    found = from_plate(observed, plate, boards, np.zeros(CAMERA, bool), exact.geometry.belt)
    off, std = errors_of(found.adjusted, exact.geometry, np.array([0.0, 0.06, 0.12, 0.2]) * width)
    assert np.abs(off).max() < 0.03, "mm"
    assert np.median(std) < 0.01, "mm"
    assert np.sqrt(np.mean((off / std) ** 2)) < 1.8, "the stated uncertainty holds"
    used = found.adjusted.stripe_px[found.adjusted.stripe_used]
    assert np.sqrt((used**2).mean()) == pytest.approx(0.1, rel=0.1), "px"
    few = plates_on(exact.geometry, plate, width, (0.0,), rng)
    with pytest.raises(CalibrationError, match=r"stripe .*\d lies on no ball: that determines no plane"):
        from_plate(few, plate, boards, np.zeros(CAMERA, bool), exact.geometry.belt)


@pytest.mark.thorough
def test_a_sphere_plate_calibrates_with_boards_that_the_laser_never_met(rng) -> None:
    """Through the calibrator; without a board on the belt it is refused, and on an empty belt."""
    rig = LinearRig()
    whole = observed_of(rig)
    right = PinholeCalibrator().calibrate(whole)
    plate = SpherePlate(
        "balls", 3, 2, pitch_mm=18.0, diameter_mm=14.0, centre_height_mm=9.0, tolerance_mm=0.01
    )
    belt = next(one for one in whole.observations if one.shows == "belt")
    rest = lines_at_height(right.parameters, np.arange(rig.rows, dtype=np.float64), 0.0)
    plates = []
    for place in (-12.0, -6.0, 0.0, 6.0, 12.0):
        x_px = over_balls(right.view, plate, np.array([place, -0.8, 0.05, 1.0]), rest)
        peaks = rig.peaks(x_px, scatter_px=0.03).peaks
        plates.append(replace(belt, shows="sphere_plate", peaks=peaks))
    dark = [one for one in whole.observations if one.frame.role == "plain"]
    lying = Frame(_image(rig, *_pose(0)), role="plain", name="lying")
    lying_board = Observation("board_on_belt", lying, _peaks(rig, np.empty((0, 2))), "lying")
    board = replace(whole.board, thickness_mm=6.0)
    given = replace(whole, board=board, sphere_plate=plate)
    made = PinholeCalibrator().calibrate(replace(given, observations=(belt, lying_board, *dark, *plates)))
    assert made.target["kind"] == "sphere-plate"
    assert any("planes of light: from sphere-plate balls" in note for note in made.notes)
    ratio = made.displacement_px_per_mm / right.displacement_px_per_mm
    assert ratio == pytest.approx(1.0, abs=0.004)
    assert made.height_range_mm[1] == pytest.approx(16.0)
    with pytest.raises(CalibrationError, match="does not tell where the belt is") as caught:
        PinholeCalibrator().calibrate(replace(given, observations=(belt, *dark, *plates)))
    assert "board_on_belt" in (caught.value.hint or "")
    empty = replace(belt, shows="sphere_plate")
    with pytest.raises(CalibrationError, match="the sphere plate is not seen"):
        PinholeCalibrator().calibrate(replace(given, observations=(belt, lying_board, *dark, empty)))


@pytest.mark.parametrize(("name", "kind"), [("gentle", "block"), ("tilted", "staircase")])
def test_a_scan_through_one_stripe_gives_its_plane(name: str, kind: str, rng) -> None:
    """The belt is known from a board that lies on it; the solid in five places."""
    rig, width = replace(RIGS[name], stripes=1), wide(RIGS[name])
    exact, known = shown(rig, rng), solid(kind, wide(RIGS[name]))
    true = exact.geometry
    seen = [seen_as("belt", crossings(true, None, SIZE), SIZE, rng, 0.1)]
    for place in range(5):
        lying = on_belt(true, 0.1 * (place - 2) * width, 0.005 * place * width, 3.0)
        seen.append(seen_as(kind, crossings(lying, shape_of(known), SIZE), SIZE, rng, 0.1))
    observed = set_of(seen, 1, **{kind: known})
    found = from_solids(observed, boards_of(exact), np.zeros(CAMERA, bool), true.belt)
    off, std = errors_of(found.adjusted, true, np.array([0.0, 0.06, 0.12]) * width)
    assert np.abs(off).max() < 0.02, "mm"
    assert np.sqrt(np.mean((off / std) ** 2)) < 2.0, "the stated uncertainty holds"
