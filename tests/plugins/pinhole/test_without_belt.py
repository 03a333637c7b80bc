"""Calibrations without a belt, with known camera and planes, and of one line before a board in the hand."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.spoil import TURNTABLE
from roemetry import Recipe
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.errors import CalibrationError, ConfigurationError, DataError
from roemetry.io.yaml_source import dump, read
from roemetry.records import CalibrationSet
from roemetry.records.calibration import ON_BELT, ON_BOARD, Calibration
from roemetry.records.view import write_camera
from roemetry.testing import LinearRig
from roemetry_pinhole.boards import find_marks, plain_is_under
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.known_files import read_camera, read_planes
from roemetry_pinhole.pinhole_plane import camera_of, lines_at_height, points_of, view_of
from tests.command import typed
from tests.plugins.pinhole.board_set import FOCAL_PX, lit, load, pose, save, written


@pytest.fixture(scope="module")
def from_pose(boards: CalibrationSet) -> Calibration:
    return PinholeCalibrator(PinholeCalibratorOptions(reference_pose="pose 0")).calibrate(boards)


def test_without_belt_and_reference_it_is_refused(boards: CalibrationSet) -> None:
    with pytest.raises(CalibrationError, match="nothing shows where the belt is"):
        PinholeCalibrator().calibrate(boards)
    with pytest.raises(CalibrationError, match="not where they begin"):
        PinholeCalibrator(PinholeCalibratorOptions(gravity=(0.0, 0.0, 1.0))).calibrate(boards)
    with pytest.raises(CalibrationError, match="not seen in the pose '99'"):
        PinholeCalibrator(PinholeCalibratorOptions(reference_pose="99")).calibrate(boards)


def test_heights_count_from_the_named_board(from_pose: Calibration, calibrated: Calibration) -> None:
    assert from_pose.reference == ON_BOARD
    assert calibrated.reference == ON_BELT
    assert "reference" not in calibrated.to_dict()
    # the first pose lies level, 6 mm above the belt: the same points are 6 mm lower from there
    stripe, row = np.repeat(np.arange(7), 3), np.tile([40.0, 100.0, 160.0], 7)
    x_px = LinearRig().rest_px()[stripe, row.astype(int)] + 20.0
    low = points_of(from_pose.parameters, stripe, x_px, row)[:, 2]
    high = points_of(calibrated.parameters, stripe, x_px, row)[:, 2]
    assert high - low == pytest.approx(6.0, abs=0.1)


def test_heights_count_along_gravity_from_the_board_s_middle(
    boards: CalibrationSet, from_pose: Calibration
) -> None:
    # the camera looks straight down on boards that lie level: gravity is its z, or 10° beside it
    options = {"reference_pose": "pose 0", "gravity_std_deg": 0.2}

    def with_gravity(tilt_deg: float, sign: float = 1.0) -> Calibration:
        down = (float(np.sin(np.radians(tilt_deg))), 0.0, sign * float(np.cos(np.radians(tilt_deg))))
        return PinholeCalibrator(PinholeCalibratorOptions(**options, gravity=down)).calibrate(boards)

    flat, tilted = with_gravity(0.0), with_gravity(10.0)
    assert flat.parameters["belt_per_mm"] == pytest.approx(from_pose.parameters["belt_per_mm"], abs=5e-5)
    normal = tilted.parameters["belt_per_mm"] / np.linalg.norm(tilted.parameters["belt_per_mm"])
    assert np.degrees(np.arcsin(normal[0])) == pytest.approx(10.0, abs=1e-6)
    # heights begin at the board's middle, whose image is the mean of its marks'
    middle_px = find_marks(boards.observations[0].frame, boards.boards[0]).xy_px.mean(axis=0)
    ray = (middle_px - flat.parameters["principal_px"]) / flat.parameters["focal_px"]
    depth_mm = 1.0 / (np.append(ray, 1.0) @ tilted.parameters["belt_per_mm"])
    assert depth_mm == pytest.approx(1.0 / flat.parameters["belt_per_mm"][2], abs=0.1)
    assert depth_mm == pytest.approx(
        1.0 / (np.append(ray, 1.0) @ from_pose.parameters["belt_per_mm"]), abs=0.1
    )
    # a direction that is uncertain by 0.2° makes the plane uncertain by that
    at = slice(-3, None)
    angle = np.sqrt(tilted.covariance[at, at].diagonal()) / np.linalg.norm(tilted.parameters["belt_per_mm"])
    assert np.degrees(angle[1]) == pytest.approx(0.2, abs=0.1)
    with pytest.raises(CalibrationError, match="does not look down"):
        with_gravity(10.0, sign=-1.0)


def test_the_camera_of_a_calibration_is_known_to_another(
    from_pose: Calibration, boards: CalibrationSet, tmp_path: Path
) -> None:
    from_pose.save(tmp_path / "first.yaml")
    assert Calibration.load(tmp_path / "first.yaml").reference == ON_BOARD
    assert read_camera(tmp_path / "first.yaml") == pytest.approx(camera_of(from_pose.parameters))
    options = PinholeCalibratorOptions(reference_pose="pose 0", camera=tmp_path / "first.yaml")
    again = PinholeCalibrator(options).calibrate(boards)
    assert again.parameters["focal_px"] == pytest.approx(from_pose.parameters["focal_px"], abs=1e-9)


def test_the_camera_alone(boards: CalibrationSet) -> None:
    rig = LinearRig()
    plain = replace(boards, observations=tuple(o for o in boards.observations if o.frame.role == "plain"))
    found = PinholeCalibrator(PinholeCalibratorOptions(lens="none")).camera(plain)
    true_px = 300.0 / rig.mm_per_px
    assert found.images == 8
    assert (np.abs(found.focal_px - true_px) < 4.0 * found.std[:2]).all()
    assert (found.std[:2] < 0.005 * true_px).all()
    assert found.rms_px < 0.1


def test_a_camera_whose_focus_drifts_is_less_certain(boards: CalibrationSet) -> None:
    """Each image is larger than the one before by 0.4 %: no single focal length is that of all."""
    plain = [one for one in boards.observations if one.frame.role == "plain"]
    plain += [replace(one, pose=f"again {one.pose}") for one in plain]

    def focal_std(step: float) -> float:
        drifting = []
        for number, one in enumerate(plain):
            rows, columns = one.frame.size
            scale = 1.0 + step * (number - 7.5)
            move = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), 0.0, scale)
            how = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
            pixels = cv2.warpAffine(one.frame.pixels, move, (columns, rows), **how)
            drifting.append(replace(one, frame=replace(one.frame, pixels=pixels)))
        found = PinholeCalibrator(PinholeCalibratorOptions(lens="none")).camera(
            replace(boards, observations=tuple(drifting))
        )
        return float(found.std[0])

    assert focal_std(0.004) > 2.0 * focal_std(0.0)


def test_a_board_that_moved_between_its_images_makes_two_poses(boards: CalibrationSet) -> None:
    observations = list(boards.observations)
    last = max(n for n, one in enumerate(observations) if one.frame.role == "plain")
    moved = np.roll(observations[last].frame.pixels, 6, axis=1)
    observations[last] = replace(observations[last], frame=replace(observations[last].frame, pixels=moved))
    set_of = replace(boards, observations=tuple(observations))
    made = PinholeCalibrator(PinholeCalibratorOptions(reference_pose="pose 0")).calibrate(set_of)
    said = [note for note in made.notes if "taken for two poses" in note]
    assert len(said) == 1, made.notes
    assert "moved by 6.0 px" in said[0]


@pytest.mark.parametrize("way", [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_a_board_that_moved_by_a_pixel_darkens_some_of_its_edges(
    boards: CalibrationSet, way: tuple[int, int]
) -> None:
    plain, laser = (one.frame for one in boards.observations[-2:])
    assert (plain.role, laser.role) == ("plain", "laser")
    marks = find_marks(plain, boards.boards[0])
    assert plain_is_under(plain, laser, marks)
    assert not plain_is_under(replace(plain, pixels=np.roll(plain.pixels, way, (0, 1))), laser, marks)


def test_camera_only_writes_a_file_of_opencvs(boards: CalibrationSet, tmp_path: Path) -> None:
    for number, one in enumerate(o for o in boards.observations if o.frame.role == "plain"):
        cv2.imwrite(str(tmp_path / f"board_{number}.png"), one.frame.pixels)
    (tmp_path / "rig.yaml").write_text(
        "roemetry_rig: 1\nname: no laser at all\nimages: {board: ['board_*.png']}\n"
        "board: {kind: chessboard, name: b, columns: 9, rows: 6, pitch_mm: 5.5}\n"
        "calibrator: {use: pinhole-plane, options: {lens: none}}\n",
        "utf-8",
    )
    done = typed("calibrate", tmp_path / "rig.yaml", "--camera-only")
    assert "camera from 8 images" in done.output
    assert read_camera(tmp_path / "camera.yaml")[:2] == pytest.approx(1200.0, rel=0.005)


def write_planes(path: Path, planes: np.ndarray) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("planes", planes)
    storage.release()


def files(calibrated: Calibration, folder: Path, *, sign: float = 1.0) -> dict[str, object]:
    """The camera, and planes with D = −sign, written by OpenCV itself."""
    camera, planes = folder / "camera.yaml", folder / "planes.yaml"
    assert calibrated.view is not None
    write_camera(camera, calibrated.view)
    p = calibrated.parameters["planes_per_mm"]
    size = np.linalg.norm(p, axis=1)[:, None]
    write_planes(planes, np.column_stack([p / size, -sign / size]))
    return {"camera": camera, "planes": planes, "height_max_mm": 20.0}


@pytest.mark.parametrize(("sign", "form"), [(1.0, "Ax+By+Cz+D=0"), (-1.0, "Ax+By+Cz-D=0")])
def test_the_belt_is_found_in_either_form(calibrated, belt, tmp_path: Path, sign: float, form: str) -> None:
    options = PinholeCalibratorOptions(**files(calibrated, tmp_path, sign=sign), planes_form=form)
    found = PinholeCalibrator(options).calibrate(belt)
    assert found.parameters["planes_per_mm"] == pytest.approx(
        calibrated.parameters["planes_per_mm"], rel=1e-9
    )
    away = [1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (found, calibrated)]
    assert away[0] == pytest.approx(away[1], rel=2e-3)
    assert found.height_range_mm == (0.0, 20.0)
    assert any("taken as exact" in note for note in found.notes)
    size = found.covariance.shape[0]
    assert not found.covariance[: size - 3, : size - 3].any(), "nothing is stated of what was read"
    assert (np.diag(found.covariance)[-3:] > 0).all()


def test_what_the_planes_are_uncertain_by_is_in_the_heights(calibrated, belt, tmp_path: Path, rng) -> None:
    """Each plane leaned or moved by its standard uncertainty, in a file; squares of heights' changes."""
    angle_deg, offset_mm = 0.004, 0.003
    given = files(calibrated, tmp_path)
    options = {**given, "planes_angle_std_deg": angle_deg, "planes_offset_std_mm": offset_mm}
    stated = PinholeCalibrator(PinholeCalibratorOptions(**options)).calibrate(belt)
    assert any("each uncertain by 0.003 mm" in note for note in stated.notes)
    exact = PinholeCalibrator(PinholeCalibratorOptions(**given)).calibrate(belt)
    row = np.array([60.0, 140.0])
    x = lines_at_height(exact.parameters, row, 10.0)
    stripe, at = np.nonzero(np.isfinite(x))
    places = np.column_stack([x[stripe, at], row[at]])

    def heights(one: Calibration) -> np.ndarray:
        return view_of(one.parameters, one.image_size).lift(places, stripe)[:, 2]

    squares = np.zeros(stripe.size)
    true = calibrated.parameters["planes_per_mm"]
    middle = lines_at_height(calibrated.parameters, np.array([99.5]), 0.0)[:, 0]
    for moved in range(len(true)):
        place = in_camera(calibrated, middle[moved], 99.5)
        place -= (true[moved] @ place - 1.0) / (true[moved] @ true[moved]) * true[moved]
        normal = true[moved] / np.linalg.norm(true[moved])
        ways = np.linalg.svd(normal[None])[2][1:]
        for lean, off in ((ways[0], 0.0), (ways[1], 0.0), (0.0 * normal, offset_mm)):
            rows = np.column_stack([true, np.full(len(true), -1.0)])
            leaned = normal + np.radians(angle_deg) * lean
            rows[moved] = [*leaned, -(leaned @ place + off)]
            write_planes(given["planes"], rows)
            other = PinholeCalibrator(PinholeCalibratorOptions(**given)).calibrate(belt)
            squares += (heights(other) - heights(exact)) ** 2
    only = replace(stated, covariance=stated.covariance - exact.covariance)
    redraws = only.redraws(rng)
    std = np.std([heights(next(redraws)) for _ in range(600)], axis=0)
    assert np.median(std / np.sqrt(squares)) == pytest.approx(1.0, abs=0.05)
    assert std / np.sqrt(squares) == pytest.approx(1.0, abs=0.2)


def in_camera(calibrated: Calibration, x_px: float, row_px: float) -> np.ndarray:
    """Where a place on the belt is, camera frame, mm."""
    ray = np.array([x_px, row_px, 1.0])
    ray[:2] = (ray[:2] - calibrated.parameters["principal_px"]) / calibrated.parameters["focal_px"]
    return ray / (ray @ calibrated.parameters["belt_per_mm"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"planes_form": "Ax+By+Cz-D=0"}, "behind the camera"),
        ({"camera": None}, "without the camera"),
        ({"height_max_mm": None}, "up to which height"),
    ],
)
def test_what_cannot_be_is_refused(
    calibrated, belt, tmp_path: Path, change: dict[str, object], says: str
) -> None:
    options = PinholeCalibratorOptions(**(files(calibrated, tmp_path) | change))
    with pytest.raises(CalibrationError, match=says) as caught:
        PinholeCalibrator(options).calibrate(belt)
    assert caught.value.hint


def test_another_number_of_planes_and_no_belt(calibrated, belt, boards, tmp_path: Path) -> None:
    method = PinholeCalibrator(PinholeCalibratorOptions(**files(calibrated, tmp_path)))
    with pytest.raises(CalibrationError, match="planes holds"):
        method.calibrate(replace(belt, stripe_count=belt.stripe_count + 1))
    with pytest.raises(CalibrationError, match="where the belt is"):
        method.calibrate(boards)
    path = tmp_path / "through.yaml"
    write_planes(path, np.array([[1.0, 0.0, 0.2, 0.0]]))
    with pytest.raises(DataError, match=r"through\.yaml: the plane goes through"):
        read_planes(path)


def test_the_command_line_writes_what_is_read_back(calibrated, belt, tmp_path: Path) -> None:
    """From a calibration file to OpenCV's and back: the same camera, the same planes."""
    calibrated.save(tmp_path / "line.yaml")
    done = typed("export", tmp_path / "line.yaml", "opencv")
    written = tmp_path / "line-opencv.yaml"
    assert str(written) in done.output
    assert read_camera(written) == pytest.approx(camera_of(calibrated.parameters), rel=1e-12)
    assert read_planes(written) == pytest.approx(calibrated.parameters["planes_per_mm"], rel=1e-9)
    options = PinholeCalibratorOptions(camera=written, planes=written, height_max_mm=20.0)
    again = PinholeCalibrator(options).calibrate(belt).parameters["planes_per_mm"]
    assert again == pytest.approx(calibrated.parameters["planes_per_mm"], rel=1e-9)
    typed("export", tmp_path / "line.yaml", "opencv", "-o", tmp_path / "c.xml")
    assert read_camera(tmp_path / "c.xml") == pytest.approx(camera_of(calibrated.parameters), rel=1e-12)


def test_what_cannot_be_written_is_told(calibrated, tmp_path: Path) -> None:
    calibrated.save(tmp_path / "line.yaml")
    LinearRig().calibration().save(tmp_path / "block.yaml")
    replace(calibrated, view=replace(calibrated.view, exact=False)).save(tmp_path / "rough.yaml")
    for words, kind, says in (
        (["line.yaml", "parquet"], ConfigurationError, "only `opencv` can be written, not `parquet`"),
        (["block.yaml", "opencv"], CalibrationError, "knows no camera"),
        (["rough.yaml", "opencv"], CalibrationError, "knows no camera"),
        (["line.yaml", "opencv", "-o", str(tmp_path / "c.txt")], DataError, "cannot be written"),
        (["line.yaml", "opencv", "-o", str(tmp_path / "no" / "c.yaml")], DataError, "cannot be written"),
    ):
        done = typed("export", tmp_path / words[0], *words[1:], code=1)
        assert isinstance(done.exception, kind), words
        assert says in str(done.exception)


TURNTABLE_SET = Path(os.environ.get("ROEMETRY_REAL_DATA", "../shared/real")).resolve() / "turntable_green"
RECIPE = """
roemetry: 1
product: one line
source: {path: scan}
calibration: calibration.yaml
stages:
  extractor: centre-of-gravity
  coder: single
  triangulator: pinhole-plane
"""


def test_a_tilted_board_is_measured_from_the_plane_of_another_pose(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    rig_file = written(tmp_path, poses=6, count=3)
    data = dict(read(rig_file).data)
    del data["images"]["belt"]
    data["calibrator"]["options"]["reference_pose"] = "0"
    rig_file.write_text(dump(data | {"stripes": 1}), encoding="utf-8")
    for number in range(6):  # of the three lines only the middle one
        rotation, shift = pose(number)
        off = cv2.imread(str(tmp_path / f"off_{number}.png"), cv2.IMREAD_GRAYSCALE).astype(np.float64)
        save(tmp_path / f"on_{number}.png", lit(off, 0.5, rotation, shift, range(1, 2), 3), rng)
    calibration = calibrate(Rig.load(rig_file))
    assert calibration.reference == ON_BOARD
    calibration.save(tmp_path / "calibration.yaml")
    rotation, shift = pose(3)
    (tmp_path / "scan").mkdir()
    # a grey sheet where the fourth board was
    sheet = lit(np.full((300, 400), 20.0), 0.5, rotation, shift, range(1, 2), 3)
    save(tmp_path / "scan" / "sheet.png", sheet, rng)
    (tmp_path / "recipe.yaml").write_text(RECIPE, encoding="utf-8")
    recipe = Recipe.load(tmp_path / "recipe.yaml")
    trace = recipe.trace(load(tmp_path / "scan" / "sheet.png").astype(np.uint8), name="sheet")
    assert trace.stripes is not None
    assert trace.profiles is not None
    assert np.isnan(trace.stripes.rest_px).all(), "without a belt there is no rest line"
    seen = np.isfinite(trace.profiles.xyz_mm).all(axis=-1)
    ray = np.column_stack([trace.profiles.x_px[seen] - 199.5, trace.profiles.row_px[seen] - 149.5])
    ray = np.column_stack([ray / FOCAL_PX, np.ones(len(ray))])
    on_sheet = ray * (rotation[:, 2] @ shift) / (ray @ rotation[:, 2:])
    reference, at = pose(0)
    height_mm = (at - on_sheet) @ reference[:, 2]
    assert np.ptp(height_mm) > 5.0, "the sheet is tilted against the first board"
    assert trace.profiles.xyz_mm[seen][:, 2] == pytest.approx(height_mm, abs=0.1)


@pytest.mark.skipif(not TURNTABLE_SET.is_dir(), reason=f"{TURNTABLE_SET} is absent: set ROEMETRY_REAL_DATA")
def test_the_turntable_is_measured_by_a_recipe(tmp_path: Path) -> None:
    images = {
        shows: [f"{TURNTABLE_SET}/{one}" for one in paths] for shows, paths in TURNTABLE["images"].items()
    }
    (tmp_path / "rig.yaml").write_text(dump(TURNTABLE | {"images": images}), encoding="utf-8")
    calibrate(Rig.load(tmp_path / "rig.yaml")).save(tmp_path / "calibration.yaml")
    recipe = RECIPE.replace("path: scan", f"path: {TURNTABLE_SET}/scan/*4.jpg, contrast: green")
    recipe = recipe.replace("centre-of-gravity", "maximum-likelihood")
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    rows = list(Recipe.load(tmp_path / "recipe.yaml").run())
    assert len(rows) == 5
    assert {row.status for row in rows} == {"measured"}
