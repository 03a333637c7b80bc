"""Points, views and rest lines of a known rig, moved or not, and where its lengths come from."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulated_points import SimulatedRig, shown
from roemetry import Recipe
from roemetry.errors import CalibrationError, DataError
from roemetry.records import Block, CalibrationSet, Frame, Observation, Ruler, SpherePlate, StripeMap
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.light import at_height
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import _image, _peaks, _pose
from roemetry_pinhole.dot_rays import PinholeDots
from roemetry_pinhole.grid import PinholeGrid
from roemetry_pinhole.known_files import plane_from, read_camera
from roemetry_pinhole.pinhole_plane import (
    METHOD,
    PinholePlane,
    displacements,
    lines_at_height,
    parameters_of,
    projector_of,
    rest_polynomials,
    view_of,
)
from roemetry_pinhole.prints import tolerance_of
from roemetry_pinhole.scale import by_scale, check_scale
from tests.plugins.pinhole.solids_seen import over_balls

SIZE = (480, 640)
RIGS = {
    "gentle": SimulatedRig(1600.0, 320.0, image_size=SIZE),
    "strong": SimulatedRig(
        600.0, 200.0, tilt_deg=(12.0, -9.0), lens=(-0.3, 0.12, 0.001, -0.0005, -0.02), image_size=SIZE
    ),
}


@pytest.fixture(params=RIGS)
def calibration(request, rng) -> Calibration:
    geometry = shown(RIGS[request.param], rng).geometry
    parameters = parameters_of(geometry, travel=False)
    count = sum(array.size for array in parameters.values())
    root = rng.normal(0.0, 1e-7, (count, count))
    return Calibration(
        METHOD,
        SIZE,
        0,
        rest_polynomials(parameters, SIZE),
        displacements(parameters, SIZE),
        (0.0, 30.0),
        parameters,
        root @ root.T,
        view=view_of(parameters, SIZE),
    )


def stripes_at(calibration: Calibration, z_mm: float, shift_px: float = 0.0) -> StripeMap:
    rows = np.arange(SIZE[0], dtype=np.float64)
    x = lines_at_height(calibration.parameters, rows, z_mm) + shift_px
    x[(x < 0) | (x > SIZE[1] - 1)] = np.nan
    seen = np.isfinite(x)
    return StripeMap(
        x_px=x,
        x_std_px=np.where(seen, 0.1, np.nan),
        product=np.where(seen, 1, -1).astype(np.int16),
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(x.shape, np.bool_),
        rest_px=calibration.rest_line_px(rows),
        peak_stripe=np.empty(0, np.int16),
    )


def test_points_are_where_the_view_says(calibration) -> None:
    stripes = stripes_at(calibration, 9.0, 0.7)
    profiles = PinholePlane().triangulate(stripes, calibration)
    view = PinholePlane().view(calibration)
    xy = np.stack([profiles.x_px, profiles.row_px], axis=2)
    lifted = view.lift(xy, np.arange(stripes.stripe_count)[:, None])
    seen = profiles.seen
    assert np.abs(lifted[seen] - profiles.xyz_mm[seen]).max() < 1e-8, "mm"
    assert np.abs(view.project(profiles.xyz_mm)[seen] - xy[seen]).max() < 1e-8, "px"


def test_the_random_part_is_what_a_peak_does_to_its_height(calibration) -> None:
    step = 1e-4
    one = PinholePlane().triangulate(stripes_at(calibration, 9.0), calibration)
    other = PinholePlane().triangulate(stripes_at(calibration, 9.0, step), calibration)
    both = one.seen & other.seen
    slope = np.abs(other.xyz_mm[..., 2] - one.xyz_mm[..., 2])[both] / step
    assert np.abs(0.1 * slope - one.height_std_mm[both]).max() < 1e-5, "mm"


def test_rest_lines_and_displacements_are_those_of_the_planes(calibration) -> None:
    rows = np.arange(SIZE[0], dtype=np.float64)
    lines = lines_at_height(calibration.parameters, rows, 0.0)
    inside = (lines > 0) & (lines < SIZE[1] - 1)
    assert np.abs(calibration.rest_line_px(rows) - lines)[inside].max() < 0.02, "px"
    middle = np.array([(SIZE[0] - 1) / 2.0])
    moved = lines_at_height(calibration.parameters, middle, 0.5) - lines_at_height(
        calibration.parameters, middle, -0.5
    )
    assert np.abs(moved[:, 0] - calibration.displacement_px_per_mm).max() < 1e-3, "px/mm"


def test_a_redrawn_calibration_moves_points_and_view_together(calibration, rng) -> None:
    drawn = calibration.redraw(rng, PinholePlane().view)
    assert calibration.redraw(rng).view is None, "the view of other parameters is not kept"
    stripes = stripes_at(calibration, 9.0)
    profiles = PinholePlane().triangulate(stripes, drawn)
    seen = profiles.seen
    assert np.abs(profiles.xyz_mm[seen][:, 2] - 9.0).max() > 1e-6, "mm"
    xy = np.stack([profiles.x_px, profiles.row_px], axis=2)
    lifted = drawn.view.lift(xy, np.arange(stripes.stripe_count)[:, None])
    assert np.abs(lifted[seen] - profiles.xyz_mm[seen]).max() < 1e-8, "mm"


def test_redraws_have_the_stated_covariance_whatever_the_units(calibration, rng) -> None:
    size = len(calibration.covariance)
    own = 10.0 ** rng.uniform(-9.0, 0.0, size)
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    wanted = own[:, None] * (root @ root.T + 0.1 * np.eye(size)) * own[None, :]
    stated = replace(calibration, covariance=wanted)
    draws = stated.redraws(rng)
    drawn = np.array(
        [
            np.concatenate([a.ravel() for a in draw.parameters.values()])
            for _, draw in zip(range(3000), draws, strict=False)
        ]
    )
    found = np.cov(drawn.T) / own[:, None] / own[None, :]
    assert np.abs(found - wanted / own[:, None] / own[None, :]).max() < 0.2


def test_a_camera_file_without_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "no.yaml"
    path.write_text("%YAML:1.0\n---\nnumber: 3\n", encoding="utf-8")
    with pytest.raises(DataError, match="no 3 × 3 camera matrix"):
        read_camera(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_camera(tmp_path / "none.yaml")


def test_planes_in_either_sign() -> None:
    point = np.array([3.0, -4.0, 200.0])
    a, b, c = 0.6, 0.1, 0.8
    d = a * point[0] + b * point[1] + c * point[2]
    assert plane_from(a, b, c, -d, sign=1) @ point == pytest.approx(1.0)
    assert plane_from(a, b, c, d, sign=-1) @ point == pytest.approx(1.0)
    with pytest.raises(DataError, match="camera's centre"):
        plane_from(1.0, 0.0, 0.0, 0.0, sign=1)


def fan(projector_mm: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Give (stripe, 4) planes through a projector and points 12 mm apart on the belt, each along its axis."""
    at = np.column_stack([np.arange(len(axes)) * 12.0 - 40.0, np.zeros(len(axes)), np.zeros(len(axes))])
    normal = np.cross(at - projector_mm, axes)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.column_stack([normal, normal @ projector_mm])


def test_a_fan_about_one_line_leaves_the_projector_beside_the_camera(rng) -> None:
    true = np.array([120.0, -4.0, 310.0])
    planes = fan(true, np.tile([0.01, 1.0, 0.005], (11, 1)))
    planes[:, 3] += rng.normal(0.0, 0.02, 11)
    found = projector_of(planes)
    assert abs(found[1]) < 1.0  # mm; the noise alone would put it anywhere
    assert np.linalg.norm((found - true)[[0, 2]]) < 2.0


def test_planes_turned_against_each_other_show_where_the_projector_is(rng) -> None:
    true = np.array([120.0, 60.0, 310.0])
    axes = np.column_stack([np.linspace(-0.5, 0.5, 11) ** 2, np.ones(11), np.zeros(11)])
    planes = fan(true, axes)
    planes[:, 3] += rng.normal(0.0, 0.02, 11)
    assert np.abs(projector_of(planes) - true).max() < 1.5  # mm


NOTHING = np.zeros((4, 4))
MOTIONS = {
    "shift": np.array([0.8, 0.0, 0.0, 0.0]),
    "roll": np.array([0.0, 4e-3, 0.0, 0.0]),
    "zoom": np.array([0.0, 0.0, 3e-3, 0.0]),
    "tilt": np.array([0.0, 0.0, 0.0, 6e-4]),
}


def expected(xy_px: np.ndarray, motion: np.ndarray, focal_px: float, middle_px: np.ndarray) -> np.ndarray:
    """Where a camera that has turned and zoomed shows what was seen at xy (n, 2), to first order."""
    pan_px, roll, zoom, tilt = motion
    x, y = ((xy_px - middle_px) / focal_px).T
    right = pan_px / focal_px * (1.0 + x * x) - tilt * x * y - roll * y + zoom * x
    down = pan_px / focal_px * x * y - tilt * (1.0 + y * y) + roll * x + zoom * y
    return xy_px + focal_px * np.column_stack([right, down])


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("height_mm", [0.0, 25.0])
def test_dots_are_shown_where_the_moved_camera_sees_them(name: str, height_mm: float) -> None:
    calibration = Recipe.load("recipes/potato_dots").calibration
    assert calibration is not None and calibration.rays is not None and calibration.view is not None
    moved = PinholeDots().moved(calibration, Alignment(MOTIONS[name], NOTHING))
    view = PinholeDots().view(moved)
    assert view is not None and moved.rays is not None
    points = at_height(moved.rays.moved(moved.parameters).reshape(-1, 4), height_mm)
    known = np.isfinite(points).all(axis=1)
    camera = calibration.view.camera_matrix
    before = calibration.view.project(points[known])
    after = expected(before, MOTIONS[name], camera[0, 0], camera[:2, 2])
    assert np.abs(view.project(points[known]) - after).max() < 0.02  # px; the lens is not in the expectation


@pytest.mark.parametrize("name", MOTIONS)
def test_both_families_are_shown_where_the_moved_camera_sees_them(name: str) -> None:
    calibration = Recipe.load("recipes/potato_grid").calibration
    assert calibration is not None and calibration.across is not None and calibration.view is not None
    alignment = Alignment(MOTIONS[name], 1e-8 * np.eye(4))
    moved = PinholeGrid().moved(calibration, alignment)
    # the stripes alone are what pinhole-plane makes of them
    alone = PinholePlane().moved(calibration, alignment)
    assert np.allclose(moved.rest_px, alone.rest_px, atol=1e-9)
    assert np.allclose(moved.covariance, alone.covariance, rtol=1e-12)
    assert np.trace(moved.covariance) > np.trace(calibration.covariance)
    assert moved.across is not None
    camera, columns = calibration.view.camera_matrix, calibration.image_size[1]
    rows = np.arange(40.0, columns - 40.0, 20.0)
    for line, rest in enumerate(calibration.across.rest_line_px(rows)):
        before = np.column_stack([columns - 1.0 - rows, rest])
        after = expected(before, MOTIONS[name], camera[0, 0], camera[:2, 2])
        inside = (after[:, 1] > 0.0) & (after[:, 1] < calibration.image_size[0])
        shown = np.array(
            [moved.across.rest_line_px(np.array([columns - 1.0 - x]))[line, 0] for x in after[:, 0]]
        )
        assert np.abs(shown - after[:, 1])[inside].max(initial=0.0) < 0.02  # px


def test_single_lines_of_both_families_are_shifted() -> None:
    calibration = Recipe.load("recipes/potato_grid").calibration
    assert calibration is not None and calibration.across is not None
    stripes, lines = calibration.stripe_count, calibration.across.stripe_count
    planes_px = np.zeros(stripes + lines)
    planes_px[2], planes_px[stripes + 3] = 0.5, -0.4
    moved = PinholeGrid().moved(
        calibration, Alignment(np.zeros(4), NOTHING, planes_px=planes_px, planes_std_px=0.05)
    )
    assert moved.across is not None
    for one, other, shift in (
        (calibration, moved, planes_px[:stripes]),
        (calibration.across, moved.across, planes_px[stripes:]),
    ):
        middle = np.array([0.5 * (one.image_size[0] - 1)])
        off = (other.rest_line_px(middle) - one.rest_line_px(middle))[:, 0]
        assert np.abs(off - shift).max() < 0.01  # px
    assert np.trace(moved.covariance) > np.trace(calibration.covariance)


FREE = PinholeCalibrator(PinholeCalibratorOptions(scale="free"))
BLOCK = Block("block", 100.0, 30.0, 10.0, tolerance_mm=0.01)
BALLS = SpherePlate("balls", 3, 2, pitch_mm=18.0, diameter_mm=14.0, centre_height_mm=9.0, tolerance_mm=0.01)
WAY_MM = 0.05
"""Per encoder count, straight up in the image."""


@pytest.fixture(scope="module")
def seen(observed, calibrated) -> CalibrationSet:
    """Boards, the empty belt, a level of 10 mm as block and as staircase, and a board on the moving belt."""
    rig = LinearRig()
    rows = np.arange(rig.rows, dtype=np.float64)
    top = lines_at_height(calibrated.parameters, rows, 10.0)
    x_px = np.where((rows > 60) & (rows < 140), top, lines_at_height(calibrated.parameters, rows, 0.0))
    belt = next(one for one in observed.observations if one.shows == "belt")
    levels = [
        replace(belt, shows=shows, peaks=rig.peaks(x_px, scatter_px=0.03).peaks)
        for shows in ("block", "staircase")
    ]
    rotation, shift = _pose(0)
    carried = []
    for count in (0.0, 40.0, 80.0):
        image = _image(rig, rotation, shift + np.array([0.0, -WAY_MM * count, 0.0]))
        frame = Frame(image, role="plain", name=f"carried {count:g}", encoder_count=count)
        carried.append(
            Observation("board_on_belt", frame, _peaks(rig, np.empty((0, 2))), f"carried {count:g}")
        )
    board = replace(observed.board, thickness_mm=6.0, flatness_mm=0.02)
    return replace(observed, observations=(*observed.observations, *levels, *carried), board=board)


def smaller(seen: CalibrationSet, factor: float) -> CalibrationSet:
    """The same with a board that is described smaller than it is."""
    return replace(seen, board=replace(seen.board, pitch_mm=seen.board.pitch_mm / factor))


@pytest.fixture(scope="module")
def right(seen) -> Calibration:
    return PinholeCalibrator().calibrate(seen)


@pytest.fixture(scope="module")
def by_block(seen) -> Calibration:
    """The scale from a block; the board is 3 % larger than described."""
    return FREE.calibrate(replace(smaller(seen, 1.03), block=BLOCK))


def test_the_belt_tells_its_way_per_count(right) -> None:
    made = right
    assert made.residuals["mm_per_count"] == pytest.approx(WAY_MM, rel=2e-3)
    off = made.residuals["mm_per_count"] - WAY_MM
    assert abs(off) < 4.0 * made.residuals["mm_per_count_std"] + 1e-4 * WAY_MM
    assert any("mm per count" in note for note in made.notes)


@pytest.mark.parametrize("by", ["block", "encoder", "ruler", "sphere plate"])
def test_the_scale_comes_from_the_reference(seen, right, by_block, by: str) -> None:
    """A board printed 3 % larger than described; heights and distances come out right again."""
    plates = [balls_on_belt(seen, right, 1.0, x_mm) for x_mm in (1.5, -2.0)]
    given = {
        "encoder": {"mm_per_count": (WAY_MM, 1e-5)},
        "ruler": {"ruler": Ruler(100.0, 103.0, 0.1)},
        "sphere plate": {"sphere_plate": BALLS, "observations": (*seen.observations, *plates)},
    }
    made = by_block if by == "block" else FREE.calibrate(replace(smaller(seen, 1.03), **given[by]))
    assert made.residuals["pitch_ratio"] == pytest.approx(1.03, abs=4.0 * made.residuals["pitch_ratio_std"])
    assert made.residuals["pitch_ratio_std"] < 0.004
    assert made.target["pitch_mm"] == pytest.approx(seen.board.pitch_mm, rel=0.004)
    away, found = (1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (right, made))
    assert found == pytest.approx(away, rel=0.005)
    assert any("scale: looked for" in note and by in note for note in made.notes)
    assert not any("from the board's pitch" in note for note in made.notes)
    assert (np.linalg.eigvalsh(made.covariance) > -1e-9 * np.abs(made.covariance).max()).all()
    if by == "ruler":
        assert made.residuals["pitch_ratio_std"] == pytest.approx(0.1 / 103.0, rel=1e-3)
        way, std = by_scale(made.parameters), np.sqrt(np.diag(made.covariance))
        beyond = (made.covariance - (0.1 / 103.0) ** 2 * np.outer(way, way))[np.ix_(std > 0.0, std > 0.0)]
        least = np.linalg.eigvalsh(beyond / np.outer(std[std > 0.0], std[std > 0.0])).min()
        assert least > -1e-6, "no combination of the parameters may be surer of lengths than the ruler"


def way_std(made: Calibration) -> float:
    """Relative standard deviation of the belt's way per count, as the covariance has it."""
    names = [name for name, array in made.parameters.items() for _ in np.ravel(array)]
    at = names.index("belt_per_mm") + 2
    return float(np.sqrt(made.covariance[at, at]) / abs(made.parameters["belt_per_mm"][2]))


@pytest.mark.thorough
def test_the_covariance_holds_the_references_length(seen, by_block) -> None:
    """A block known to a tenth as well gives distances that are uncertain by as much more."""
    rough = replace(BLOCK, tolerance_mm=0.2)
    stds = [way_std(made) for made in (by_block, FREE.calibrate(replace(smaller(seen, 1.03), block=rough)))]
    assert stds[1] == pytest.approx(np.hypot(0.2 / np.sqrt(3.0) / 10.0, stds[0]), rel=0.05)


def test_a_free_scale_without_reference_is_refused(seen) -> None:
    with pytest.raises(CalibrationError, match="needs a reference besides the board") as caught:
        FREE.calibrate(seen)
    assert "encoder_mm_per_count" in (caught.value.hint or "")


@pytest.mark.thorough
@pytest.mark.parametrize("known", [True, False])
def test_references_that_contradict_are_refused_with_the_ratio(seen, right, known: bool) -> None:
    both = replace(seen, block=BLOCK, mm_per_count=(1.04 * WAY_MM, 1e-5))
    with pytest.raises(CalibrationError, match=r"contradict each other.* (0\.96|1\.0[34])\d\d ± 0\.0"):
        check_scale(right, both) if known else FREE.calibrate(both)


def test_a_ruler_checks_the_print(seen, right) -> None:
    """A print of which 100 mm measure 103 ± 0.1; and one that is right."""
    with pytest.raises(CalibrationError, match=r"board and ruler contradict each other.* 0\.9709 ± 0\.001"):
        check_scale(right, replace(seen, ruler=Ruler(100.0, 103.0, 0.1)))
    fine = check_scale(right, replace(seen, ruler=Ruler(100.0, 100.05, 0.1)))["residuals"]
    assert fine["ruler_ratio"] == pytest.approx(1.0 / 1.0005, abs=1e-6)
    std = np.hypot(0.1 / 100.05, tolerance_of(seen.board))
    assert fine["ruler_ratio_std"] == pytest.approx(std, rel=1e-3)


def balls_on_belt(seen: CalibrationSet, right: Calibration, size: float, x_mm: float = 1.5) -> Observation:
    """What the rig of the boards sees of six balls that are larger than described by a factor."""
    rig = LinearRig()
    belt = lines_at_height(right.parameters, np.arange(rig.rows, dtype=np.float64), 0.0)
    view = view_of(right.parameters, right.image_size)
    x_px = over_balls(view, BALLS, np.array([x_mm, -0.8, np.radians(4.0), size]), belt)
    bare = next(one for one in seen.observations if one.shows == "belt")
    return replace(bare, shows="sphere_plate", peaks=rig.peaks(x_px, scatter_px=0.03).peaks)


def test_a_sphere_plate_is_measured(seen, right) -> None:
    """1 % off is told with the ratio; nothing is measured where nothing lies."""
    bare = next(one for one in seen.observations if one.shows == "belt")
    images = {
        "right": balls_on_belt(seen, right, 1.0),
        "small": balls_on_belt(seen, right, 0.99),
        "none": replace(bare, shows="sphere_plate"),
    }
    said = {}
    for name, image in images.items():
        observed = replace(seen, observations=(image,), sphere_plate=BALLS)
        try:
            said[name] = check_scale(right, observed)
        except CalibrationError as error:
            assert name == "small"
            assert re.search(r"board and sphere plate contradict .* 0\.9[89]\d\d ± 0\.00", error.message)
    std = said["right"]["residuals"]["sphere_plate_ratio_std"]
    assert said["right"]["residuals"]["sphere_plate_ratio"] == pytest.approx(1.0, abs=3.0 * std)
    assert std < 0.004
    assert any("on 6 balls lie 0.0" in note for note in said["right"]["notes"])
    assert "sphere_plate_ratio" not in said["none"]["residuals"]
    assert any("sphere plate was not found" in note for note in said["none"]["notes"])
    assert set(said) == {"right", "none"}
