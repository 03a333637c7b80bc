"""`roemetry calibrate`: from a rig file to a calibration, or a refusal that says what to do."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibrating import calibrate, observe
from roemetry.calibrating.from_rig import _other_scene
from roemetry.config.rig import Rig, pose_of
from roemetry.errors import CalibrationError, ConfigurationError
from roemetry.io.files import shipped
from roemetry.records import Frame, Ruler, SpherePlate
from roemetry.records.calibration import Calibration
from roemetry.stages.registry import discover

RIG = """\
roemetry_rig: 1
name: test
stripes: 7
target: block.yaml
images:
  block: [block.png]
  belt: [belt.png]
extractor: {use: dominant-peak, options: {threshold: 60, start: lowest}}
"""
BLOCK = "kind: block\nname: b\nlength_mm: 100\nwidth_mm: 20\nheight_mm: 10\n"


@pytest.fixture
def rig_file(rig, tmp_path: Path) -> Path:
    heights = np.zeros((rig.stripes, rig.rows))
    cv2.imwrite(str(tmp_path / "belt.png"), rig.image(rig.x_px(heights)))
    heights[:, 80:160] = 10.0
    cv2.imwrite(str(tmp_path / "block.png"), rig.image(rig.x_px(heights)))
    (tmp_path / "block.yaml").write_text(BLOCK, encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    return tmp_path / "rig.yaml"


def test_a_calibration_is_made_and_knows_where_it_comes_from(rig, rig_file: Path) -> None:
    told: list[tuple[int, int, float]] = []
    made = calibrate(Rig.load(rig_file), on_progress=lambda *step: told.append(step))
    done, of, left_s = zip(*told, strict=True)
    assert done == tuple(range(1, of[0] + 1))  # each image, and the adjustment
    assert of[0] == len(made.image_sha256) + 1
    assert left_s[-1] == 0.0
    assert min(left_s[:-1]) > 0.0
    assert made.image_size == (rig.rows, rig.columns)
    assert set(made.image_sha256) == {"block/block.png", "belt/belt.png"}
    assert made.extractor["use"] == "dominant-peak"
    assert made.target["height_mm"] == 10.0
    made.save(rig_file.with_name("c.yaml"))
    assert Calibration.load(rig_file.with_name("c.yaml")).sha256 == made.sha256
    assert Calibration.load(str(rig_file.with_name("c.yaml"))).sha256 == made.sha256


def test_a_laser_off_image_of_a_board_that_moved_is_not_subtracted() -> None:
    checks = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((20, 20))) * 150.0 + 30.0
    line = 60.0 * (np.abs(np.arange(320) - 150.0) < 2.0)
    plain, noise = Frame(checks.astype(np.uint8)), np.random.default_rng(1).normal(0.0, 2.0, checks.shape)
    assert not _other_scene(plain, Frame((checks + line + noise).clip(0, 255).astype(np.uint8)))
    for way_px in (2, 6):
        moved = np.roll(checks, way_px, axis=1) + line + noise
        assert _other_scene(plain, Frame(moved.clip(0, 255).astype(np.uint8)))
    assert _other_scene(plain, Frame((0.3 * checks + line).astype(np.uint8))), "a lamp was on"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("block.png", "no.png"), "rig.yaml:6:11: images.block.0: there is no file"),
        (("target: block.yaml", "target: no.yaml"), "cannot be read"),
        (("stripes: 7", "stripes: 0"), "greater than or equal to 1, found 0"),
        (("dominant-peak", "dominant-pike"), "did you mean `dominant-peak`?"),
        (("name: test", "nome: test"), "did you mean `name`?"),
    ],
)
def test_a_wrong_rig_file(rig_file: Path, change: tuple[str, str], says: str) -> None:
    rig_file.write_text(RIG.replace(*change), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        Rig.load(rig_file)
    assert says in str(caught.value)


def test_a_block_whose_sides_are_unknown(rig_file: Path) -> None:
    text = BLOCK.replace("width_mm: 20\nheight_mm: 10\n", "")
    rig_file.with_name("block.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="has no width_mm and no height_mm") as caught:
        Rig.load(rig_file)
    assert "calliper" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("target: block.yaml\n", "", "its three sides are unknown"),
        ("[block.png]\n  belt: [belt.png]", "[]\n  belt: []", "no images to calibrate from"),
        ("[block.png]", "[block.png, again.png]", "is the same image as another one"),
    ],
)
def test_what_is_missing_or_there_twice_is_named(rig_file: Path, old: str, new: str, says: str) -> None:
    rig_file.with_name("again.png").write_bytes(rig_file.with_name("block.png").read_bytes())
    rig_file.write_text(RIG.replace(old, new), encoding="utf-8")
    with pytest.raises(CalibrationError, match=says):
        calibrate(Rig.load(rig_file))
    rig_file.write_text(RIG.replace("[belt.png]", f"['{rig_file.parent.resolve()}/bel*.png']"), "utf-8")
    cv2.imwrite(str(rig_file.with_name("belt.png")), np.zeros((100, 100), np.uint8))
    with pytest.raises(CalibrationError, match=r"belt.png is 100 × 100 pixels, block.png is 320 × 240"):
        calibrate(Rig.load(rig_file))


def test_a_block_described_the_wrong_way_round(rig_file: Path) -> None:
    text = BLOCK.replace("length_mm: 100", "length_mm: 20").replace("width_mm: 20", "width_mm: 100")
    rig_file.with_name("block.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"the block would be at least 300 mm long(.|\n)*swapped"):
        calibrate(Rig.load(rig_file))


BOARD = """
board: {kind: charuco, name: c, columns: 5, rows: 4, pitch_mm: 8, marker_mm: 6, dictionary: DICT_4X4_50}
"""


@pytest.fixture
def board_rig(rig, rig_file: Path) -> Path:
    """Three poses whose laser-on images carry a bright square that the laser-off partner has too."""
    x_px = rig.x_px(np.zeros((rig.stripes, rig.rows)))
    square = np.zeros((rig.rows, rig.columns), np.uint8)
    square[100:140, 150:190] = 90
    for number in (2, 10, 9):
        plain = square + np.uint8(number)
        cv2.imwrite(str(rig_file.with_name(f"off{number}.png")), plain)
        cv2.imwrite(str(rig_file.with_name(f"on_{number:02d}.png")), cv2.add(plain, rig.image(x_px)))
    text = RIG.replace("  belt: [belt.png]", "  board: [off*.png]\n  board_laser: [on_*.png]")
    rig_file.write_text(text + BOARD, encoding="utf-8")
    return rig_file


def test_poses_are_paired_by_the_numbers_in_their_names(rig, board_rig: Path) -> None:
    observed, hashes = observe(Rig.load(board_rig), discover())
    assert observed.board.marker_mm == 6.0
    names = ("calib07.png", "light_7.png", "set2_pose_010_on.png", "level.png")
    assert [pose_of(Path(name)) for name in names] == ["7", "7", "2-10", "level"]
    boards = observed.showing("board")
    assert [(view.pose, view.frame.role) for view in boards] == [
        (pose, role) for role in ("plain", "laser") for pose in ("2", "9", "10")
    ]
    assert {"board/off2.png", "board_laser/on_10.png"} <= set(hashes)
    for view in boards:
        if view.frame.role == "plain":
            assert len(view.peaks) == 0
        else:
            rows, count = np.unique(view.peaks.row, return_counts=True)
            assert rows.size >= rig.rows - 2, "the partner's square is gone from the difference"
            assert (count == rig.stripes).all()


def test_references_are_described_and_reach_the_calibrator(board_rig: Path) -> None:
    """A sphere plate's file and image, and what a ruler says of the print."""
    text = board_rig.read_text(encoding="utf-8").replace("images:", "images:\n  sphere_plate: [balls.png]")
    described = shipped("calib_targets", "sphere-plate-3x2-30.yaml")
    board_rig.with_name("balls.yaml").write_text(described.read_text("utf-8"), encoding="utf-8")
    lit = cv2.imread(str(board_rig.with_name("on_02.png")), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(board_rig.with_name("balls.png")), np.maximum(lit, 30))
    more = "sphere_plate: balls.yaml\nruler: {printed_mm: 100, measured_mm: 99.6, std_mm: 0.1}\n"
    board_rig.write_text(text + more, encoding="utf-8")
    observed, _ = observe(Rig.load(board_rig), discover())
    assert observed.ruler == Ruler(100.0, 99.6, 0.1)
    assert observed.sphere_plate == SpherePlate("sphere-plate-3x2-30", 3, 2, 30.0, 20.0, 15.0, 0.01)
    assert len(observed.showing("sphere_plate")[0].peaks) > 0
    wrong = (board_rig.with_name("balls.yaml")).read_text("utf-8").replace("pitch_mm: 30", "pitch_mm: 19")
    board_rig.with_name("balls.yaml").write_text(wrong, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="its balls touch each other"):
        Rig.load(board_rig)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((", marker_mm: 6", ""), "needs marker_mm and dictionary"),
        (("marker_mm: 6", "marker_mm: 8"), "marker_mm must be less than pitch_mm"),
        (("kind: charuco", "kind: charukko"), "charuco"),
        (("off*.png", "off*.png, on_02.png"), "off2.png and on_02.png hold the same numbers"),
        (
            ("name: test", "name: test\nencoder_counts: [1, 2]"),
            "2 counts for 0 images in images.board_on_belt",
        ),
    ],
)
def test_a_wrong_board(board_rig: Path, change: tuple[str, str], says: str) -> None:
    text = board_rig.read_text(encoding="utf-8")
    assert change[0] in text
    board_rig.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        Rig.load(board_rig)
    assert says in str(caught.value)
