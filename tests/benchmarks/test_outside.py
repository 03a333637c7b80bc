"""The scoring of rendered rigs, on a tiny rig whose images are drawn from its own truth."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from benchmarks import outside
from benchmarks.outside.reading import (
    Crossings,
    RigError,
    camera_and_planes,
    lines_at,
    read_crossings,
    read_rig,
    true_calibration,
)
from benchmarks.outside.scoring import heights, labels
from benchmarks.outside.table import grade_of

ROWS, COLUMNS, STRIPES = 240, 320, 13
LENGTH_MM, WIDTH_MM, HEIGHT_MM = 40.0, 24.0, 8.0  # of a box in the middle of the belt
RECIPE = """\
roemetry: 1
product: box
source: {path: images}
calibration: calibration.yaml
stages: {extractor: gaussian, coder: planes, triangulator: pinhole-plane, volume: slice-pchip}
"""
TETRAHEDRON = """\
ply
format ascii 1.0
element vertex 4
property double x
property double y
property double z
element face {count}
property list uchar int vertex_indices
end_header
0 0 0
9 0 0
0 9 0
0 0 9
3 0 2 1
3 0 1 3
3 1 2 3
"""


@pytest.fixture(scope="module")
def tiny_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Camera 300 mm above the belt, thirteen planes of light from +x, one box."""
    folder = tmp_path_factory.mktemp("tiny")
    focal_px, up_mm, projector = 900.0, 300.0, np.array([140.0, 0.0, 300.0])
    planes = []
    for x in np.linspace(-36.0, 36.0, STRIPES):
        normal = np.cross(projector - [x, 0.0, 0.0], [0.0, 1.0, 0.0])
        normal /= np.linalg.norm(normal)
        planes.append([*normal, -float(normal @ projector)])
    truth: dict[str, Any] = {
        "rig": "tiny",
        "truth_version": 1,
        "camera": {
            "width": COLUMNS, "height": ROWS, "dist_k1k2p1p2k3": [0.0] * 5,
            "K": [[focal_px, 0, 159.5], [0, focal_px, 119.5], [0, 0, 1]],
            "R_belt_to_cam": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_belt_to_cam": [0, 0, up_mm],
        },
        "laser": {"planes_belt": planes, "projector_centre_belt": projector.tolist()},
        "objects": {
            "box": {
                "cls": "reference", "max_height_mm": HEIGHT_MM, "mesh": "box.ply",
                "volume_mm3": LENGTH_MM * WIDTH_MM * HEIGHT_MM,
                "topview_volume_mm3": LENGTH_MM * WIDTH_MM * HEIGHT_MM,
            },
        },
        "images": {
            "box": {"kind": "object", "object": "box", "laser": "images/box.png", "truth": "truth/box.npz"}
        },
    }  # fmt: skip
    view = camera_and_planes(truth)
    rows = np.arange(ROWS, dtype=np.float64)
    belt, top = (lines_at(view, z, rows) for z in (0.0, HEIGHT_MM))

    def belt_xy(x_px: Any, z: float) -> tuple[Any, Any]:
        away = (up_mm - z) / focal_px
        return (x_px - 159.5) * away, (119.5 - rows) * away

    x_mm, y_mm = belt_xy(top, HEIGHT_MM)
    on_top = (np.abs(x_mm) < LENGTH_MM / 2) & (np.abs(y_mm) < WIDTH_MM / 2)
    x_mm, y_mm = belt_xy(belt, 0.0)
    lean = np.abs(projector[0] - x_mm) / up_mm * HEIGHT_MM  # the box's shadow falls to −x
    under = (x_mm < LENGTH_MM / 2) & (x_mm > -LENGTH_MM / 2 - lean) & (np.abs(y_mm) < WIDTH_MM / 2 + 0.5)
    x = np.where(on_top, top, np.where(under, np.nan, belt)).T
    label = np.where(np.isfinite(x), on_top.T.astype(int), -1)
    place = np.full((*x.shape, 3), np.nan)
    place[..., 2] = np.where(label >= 0, HEIGHT_MM * (label == 1), np.nan)
    for name in ("images", "truth"):
        (folder / name).mkdir()
    np.savez(folder / "truth" / "box.npz", x=x, label=label, X=place)
    columns = np.arange(COLUMNS)
    drawn = 180.0 * np.exp(-0.5 * ((columns - np.nan_to_num(x, nan=-99.0)[..., None]) / 1.5) ** 2).sum(axis=1)
    drawn = gaussian_filter1d(drawn, 0.5, axis=0)  # a lens, from row to row
    noise = np.random.default_rng(5).normal(8.0, 1.0, drawn.shape)
    cv2.imwrite(str(folder / "images" / "box.png"), np.clip(np.rint(drawn + noise), 0, 255).astype(np.uint8))
    (folder / "truth.json").write_text(json.dumps(truth), "utf-8")
    (folder / "with_outline.yaml").write_text(RECIPE, "utf-8")
    return folder


def changed(tiny_rig: Path, to: Path, change: dict[str, Any]) -> Path:
    """Copy the rig with other values in its truth.json."""
    shutil.copytree(tiny_rig, to)
    truth = json.loads((to / "truth.json").read_text("utf-8"))
    (to / "truth.json").write_text(json.dumps(truth | change), "utf-8")
    return to


def test_exact_crossings_lifted_by_the_true_calibration_are_level(tiny_rig: Path) -> None:
    rig = read_rig(tiny_rig)
    found = heights(true_calibration(rig.truth, 40.0), rig)
    assert found["max_mm"] < 1e-4  # the truth's lines are interpolated
    assert np.isnan(found["real_over_stated"])  # a calibration without covariance states none


def test_a_rig_goes_from_files_to_a_table_and_bad_ones_are_a_line_each(
    tiny_rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "rigs"
    shutil.copytree(tiny_rig, folder / "tiny")
    changed(tiny_rig, folder / "later", {"truth_version": 2})
    lost = changed(tiny_rig, folder / "lost", {})
    (lost / "images" / "box.png").unlink()
    broken = changed(tiny_rig, folder / "broken", {})
    (broken / "truth" / "box.npz").write_bytes(b"no archive")
    out = tmp_path / "out"
    told = ["--draws", "0", "--extractors", "gaussian", "--chains", "plain outline", "paper"]
    monkeypatch.setattr(sys, "argv", ["outside", str(folder), *told, "--out", str(out)])
    outside.main()
    text = capsys.readouterr().out
    assert "truth_version 2; this benchmark reads 1" in text
    assert "images/box.png missing" in text
    assert "box.npz: cannot be read" in text
    results = {one["rig"]: one for one in json.loads((out / "outside.json").read_text("utf-8"))["rigs"]}
    good = results["tiny"]
    assert "boards.yaml" in good["calibration"]["boards"]["refused"]
    assert good["labels_by_true_calibration"] and "the calibration is the true one" in text
    assert "refused" in good["chains"]["paper"]
    body = good["chains"]["plain outline"]["bodies"]["box"]
    assert body["labels"]["visible"] > 450
    assert body["labels"]["right"] >= 0.98 * body["labels"]["visible"] and body["labels"]["wrong"] == 0
    assert body["labels"]["peaks_wrong"] == 0
    assert abs(body["visible"]["error"]) < 0.3  # against the right truth; how good volume is, other tests say
    assert good["peaks"]["gaussian"]["body_rms_px"] < 0.1
    assert (out / "outside.md").read_text("utf-8").count("| tiny |") > 6


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"truth_version": 2}, "truth_version 2"),
        ({"objects": {}}, "'box' is missing"),
        ({"images": {}}, "no body can be scored"),
        ({"camera": {"width": 9}}, "missing"),
        ({"laser": {"planes_belt": [[1, 2]], "projector_centre_belt": [0]}}, "truth.json: "),
    ],
)
def test_truth_that_cannot_be_used_is_one_sentence(
    tiny_rig: Path, tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    with pytest.raises(RigError, match=says) as caught:
        read_rig(changed(tiny_rig, tmp_path / "rig", change))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("cls", "grade"), [("good", "good"), ("defective", "dent"), ("reference", "no skein")]
)
def test_only_skeins_have_a_skeins_class(tiny_rig: Path, tmp_path: Path, cls: str, grade: str) -> None:
    """A dented egg is not a dented skein."""
    objects = json.loads((tiny_rig / "truth.json").read_text("utf-8"))["objects"]
    objects["box"] |= {"cls": cls, "defect": None if cls == "good" else "dent"}
    rig = read_rig(changed(tiny_rig, tmp_path / "rig", {"objects": objects}))
    assert rig.bodies[0].grade == grade


def test_a_mesh_that_is_not_watertight_is_told_and_its_volume_not_used(
    tiny_rig: Path, tmp_path: Path
) -> None:
    rig = changed(tiny_rig, tmp_path / "rig", {})
    (rig / "box.ply").write_text(TETRAHEDRON.format(count=3), "utf-8")
    read = read_rig(rig)
    assert np.isnan(read.bodies[0].volume_mm3) and read.bodies[0].topview_mm3 > 0
    assert "not watertight: 3 of 6 edges" in read.faults[0]
    (rig / "box.ply").write_text(TETRAHEDRON.format(count=4) + "3 0 3 2\n", "utf-8")
    assert read_rig(rig).faults == ()


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"x": np.zeros((4, 3)), "label": np.zeros((4, 3))}, "the image has 5 rows"),
        ({"x": np.zeros((5, 2)), "label": np.zeros((5, 2))}, "of 2 stripes; truth.json has 3 planes"),
        ({"x": np.zeros((5, 3)), "label": np.full((5, 3), "belt")}, "are not numbers"),
        ({"x": np.zeros((5, 3))}, "label missing"),
    ],
)
def test_truth_arrays_that_contradict_the_rig_are_refused(
    tmp_path: Path, arrays: dict[str, Any], says: str
) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(RigError, match=says):
        read_crossings(tmp_path / "a.npz", (5, 9), 3)


def test_labels_are_judged_as_the_definitions_say() -> None:
    # rows 0 to 5: stripe 0 at 10 px on the belt, stripe 1 at 14 px on the body, but not in row 5
    row = np.array([0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4])
    stripe = np.array([0] * 6 + [1] * 5)
    x_px = np.where(stripe == 0, 10.0, 14.0)
    body = stripe == 1
    true = Crossings(row, stripe, x_px, np.zeros(11), body, np.ones(11, np.bool_))
    peaks = [
        (0, 14.2, 1, "right"),
        (1, 14.2, -1, "refused"),
        (2, 14.2, 0, "wrong"),
        (3, 11.9, 0, "shared: one peak of two lines that meet"),
        (5, 14.0, 1, "at a rim: its stripe's crossing ends in the row above"),
        (5, 20.0, 3, "stray"),
    ]
    trace: Any = SimpleNamespace(
        peaks=SimpleNamespace(row=np.array([p[0] for p in peaks]), x_px=np.array([p[1] for p in peaks])),
        stripes=SimpleNamespace(peak_stripe=np.array([p[2] for p in peaks])),
        profiles=None,
    )
    found = labels(trace, true)
    expected = {"visible": 5, "unseen": 1, "right": 1, "refused": 1, "wrong": 1, "shared": 1}
    expected |= {"peaks": 5, "peaks_wrong": 1, "peaks_stray": 1, "peaks_at_rims": 1}
    assert {key: found[key] for key in expected} == expected


@pytest.mark.parametrize(
    ("said", "true", "judged"),
    [
        (None, "good", "none"), ("good", "good", "right"), ("bend", "good", "wrong"),
        ("unknown", "dent", "unknown"), ("unknown", "no skein", "right"), ("good", "no skein", "wrong"),
        ("henkei", "twist", "right"), ("henkei", "good", "wrong"),
    ],
)  # fmt: skip
def test_grades_are_judged(said: str | None, true: str, judged: str) -> None:
    assert grade_of(said, true) == judged
