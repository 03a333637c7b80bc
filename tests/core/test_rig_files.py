"""Rig, pattern and data set files: from `roemetry calibrate` to a calibration; every fault is told."""

from __future__ import annotations

import errno
import json
import os
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibrating import calibrate, observe
from roemetry.calibrating.from_rig import _other_scene
from roemetry.config.dataset import ITEMS, Dataset, DatasetWriter, Description, Item, save_bytes, save_stripes
from roemetry.config.rig import Rig, pose_of
from roemetry.config.scene import Scene
from roemetry.errors import CalibrationError, ConfigurationError, DataError, OutputError
from roemetry.io.files import LineFile, shipped, write_whole
from roemetry.records import Frame, ProductTruth, Ruler, SpherePlate, StripeTruth
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


GRID, DOTS = Path("recipes/potato_grid"), Path("recipes/potato_dots")
_RIG, _SCENE = "rig.yaml", "simulated.yaml"


def test_one_file_tells_rig_and_scene() -> None:
    for folder, lines, columns in ((GRID, 11, 15), (DOTS, 20, 20)):
        rig = Rig.load(folder / _RIG)
        assert rig.file.stripes == columns
        assert rig.calibrator.options.lines == lines
        laser = Scene.load(folder / _SCENE).simulator.options.laser
        assert laser.planes == columns
        assert (laser.grid or laser.dots).lines == lines


def test_a_cross_hair_is_a_grid_of_one_line_and_one() -> None:
    sets = ["pattern={kind: cross-hair}"]
    assert Rig.load(GRID / _RIG, sets=sets).calibrator.options.lines == 1
    laser = Scene.load(GRID / _SCENE, sets=sets).simulator.options.laser
    assert (laser.planes, laser.grid.lines) == (1, 1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("stripes=11", "the pattern has 15 lines along X, `stripes` says 11"),
        ("calibrator.options.lines=9", "the pattern has 11 lines along Y, `lines` says 9"),
        (
            "pattern={kind: dots, lines_x: 15, lines_y: 11}",
            "`grid-lines` is made for grid, the pattern is dots",
        ),
        ("pattern={kind: grid, lines_x: 15}", "grid need lines_y"),
        ("pattern={kind: lines, lines_x: 15, lines_y: 2}", "along X alone"),
        ("pattern={kind: cross-hair, lines_x: 2}", "one line along each side"),
        ("pattern=none.yaml", "cannot be read"),
    ],
)
def test_a_rig_that_contradicts_its_pattern_is_refused(change: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Rig.load(GRID / _RIG, sets=[change])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("simulator.options.laser.planes=9", "the pattern says planes: 15, and laser.planes 9"),
        ("simulator.options.laser.dots={lines: 4}", "the pattern says dots: None"),
        ("pattern={kind: grid, lines_x: 3, lines_y: 3}", "needs spacing_x_mm"),
    ],
)
def test_a_scene_that_contradicts_its_pattern_is_refused(change: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Scene.load(GRID / _SCENE, sets=[change])


DESCRIPTION = Description(roemetry_dataset=1, name="trial", licence="CC0-1.0", made_from={"seed": 1})


def write(folder: Path, names: list[str], description: Description = DESCRIPTION) -> None:
    with DatasetWriter(folder, description) as writer:
        for name in names:
            if name in writer.done:
                continue
            good, data = cv2.imencode(".png", np.full((6, 8), 7, np.uint8))
            assert good
            save_bytes(folder / "images" / f"{name}.png", data.tobytes())
            x_px = np.array([[1.5, np.nan]])
            stripes = StripeTruth(x_px, np.array([[True, False]]), np.full((1, 2, 3), 0.25))
            save_stripes(folder / "truth" / f"{name}.npz", stripes)
            product = ProductTruth(
                label="good", visible_mm3=12.5, figures={"length_mm": 3.0, "gap_mm": np.nan}
            )
            files = {"laser": f"images/{name}.png"}
            writer.add(Item(name, files, products=(product,), stripes=f"truth/{name}.npz", time_s=0.5))


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b"])
    data = Dataset(tmp_path)
    items = list(data.items())
    assert [item.id for item in items] == ["a", "b"]
    assert items[0].time_s == 0.5
    assert np.isnan(items[0].encoder_count)
    truth = data.truth(items[1])
    assert truth.products[0].visible_mm3 == 12.5
    assert np.isnan(truth.products[0].figures["gap_mm"])
    np.testing.assert_array_equal(truth.stripes.x_px, [[1.5, np.nan]])
    assert list(data.faults()) == []


def test_a_half_line_is_taken_away_and_the_set_goes_on(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b"])
    before = (tmp_path / ITEMS).read_bytes()
    (tmp_path / ITEMS).write_bytes(before[:-25])
    write(tmp_path, ["a", "b", "c"])
    lines = (tmp_path / ITEMS).read_text("utf-8").splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["a", "b", "c"]
    assert (tmp_path / ITEMS).read_bytes().startswith(before)


def test_another_set_s_folder_is_refused_and_a_longer_one_is_not(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    longer = DESCRIPTION.model_copy(update={"made_with": "again, but longer"})
    write(tmp_path, ["b"], longer)
    assert Dataset(tmp_path).description.made_with == "again, but longer"
    with pytest.raises(OutputError, match="another data set"):
        write(tmp_path, ["c"], DESCRIPTION.model_copy(update={"made_from": {"seed": 2}}))


def test_faults_are_told_with_file_and_item(tmp_path: Path) -> None:
    write(tmp_path, ["a", "b", "c", "d"])
    (tmp_path / "images" / "a.png").unlink()
    (tmp_path / "images" / "b.png").write_bytes(b"other")
    (tmp_path / "truth" / "c.npz").write_bytes(b"other")
    lines = (tmp_path / ITEMS).read_text("utf-8").splitlines()
    (tmp_path / ITEMS).write_text("\n".join([*lines, lines[3], '{"id": 1}']) + "\n", "utf-8")
    faults = list(Dataset(tmp_path).faults())
    words = (
        "a.png missing a,laser",
        "b.png changed b,laser",
        "c.npz changed c,truth",
        "`d` twice",
        "items.jsonl:6 item",
    )
    assert len(faults) == len(words)
    for said, expected in zip(faults, words, strict=True):
        assert all(word.replace(",", ", ") in said for word in expected.split()), said


def test_a_line_that_is_no_item_is_refused_with_its_place(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    sound = (tmp_path / ITEMS).read_text("utf-8")
    for line in ("{}", "[]", "not json", '{"id": "a", "files": 3}'):
        (tmp_path / ITEMS).write_text(sound + line + "\n", "utf-8")
        with pytest.raises(DataError, match=r"items\.jsonl:2: not an item"):
            list(Dataset(tmp_path).items())


def test_many_items_need_no_memory(tmp_path: Path) -> None:
    write(tmp_path, ["a"])
    line = json.loads((tmp_path / ITEMS).read_text("utf-8")) | {"stripes": None}
    rows = [json.dumps(line | {"id": f"i{number}"}) + "\n" for number in range(5000)]
    (tmp_path / ITEMS).write_text("".join(rows), "utf-8")
    tracemalloc.start()
    count = sum(1 for _ in Dataset(tmp_path).items())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 5000
    assert peak < 1_000_000


def test_a_failed_append_leaves_nothing_of_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "record.jsonl"
    real = os.write

    def disk_fills_up(descriptor: int, data: bytes) -> int:
        if b"second" in data:
            real(descriptor, data[:3])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", disk_fills_up)
    path.write_bytes(b"x" * 200_000)  # half a line of another time
    with LineFile(path) as record:
        record.append("first")
        with pytest.raises(OutputError, match="No space left"):
            record.append("second")
        record.append("third")
    assert path.read_text(encoding="utf-8") == "first\nthird\n"


def test_write_whole_keeps_the_old_file_when_it_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    write_whole(path, "old")

    def refuse(self: Path, target: Path) -> Path:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OutputError, match="Input/output error"):
        write_whole(path, "new")
    assert path.read_text(encoding="utf-8") == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]


def test_a_line_that_the_system_writes_in_parts_is_whole_or_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, real = tmp_path / "record.jsonl", os.write
    with LineFile(path) as record:
        monkeypatch.setattr(os, "write", lambda descriptor, data: real(descriptor, data[:3]))
        record.append("hello")
        with pytest.raises(OutputError, match="only in part"):
            record.append("longer than two parts")
        assert path.read_text("utf-8") == "hello\n"
        monkeypatch.undo()
        record.append("whole")
    assert path.read_text("utf-8") == "hello\nwhole\n"
