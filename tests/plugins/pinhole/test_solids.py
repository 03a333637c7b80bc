"""Planes of light from a block, a staircase or a truncated pyramid, against the geometry that made them."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulated_points import SimulatedRig, shown
from roemetry.errors import CalibrationError
from roemetry.records import Block, Pyramid, Staircase
from roemetry.records.view import write_camera
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.geometry import (
    CAMERA,
    Corners,
    Edges,
    Geometry,
    corner_residuals,
    edge_rows,
    stripe_residuals,
    stripe_rows,
    unknowns_of,
)
from roemetry_pinhole.pinhole_plane import lines_at_height, parameters_of, view_of
from roemetry_pinhole.solids import inside, shape_of
from tests.plugins.pinhole.solids_seen import (
    assert_derivatives,
    crossings,
    height_errors,
    on_belt,
    seen_as,
    set_of,
    step_sizes,
)

SIZE = (400, 400)
STRIPES = 7
RIGS = {
    "gentle": SimulatedRig(1000.0, 320.0, tilt_deg=(1.0, -0.4), image_size=SIZE, stripes=STRIPES),
    "tilted": SimulatedRig(
        500.0,
        220.0,
        tilt_deg=(12.0, -8.0),
        lens=(-0.2, 0.08, 0.001, -0.0005, -0.01),
        image_size=SIZE,
        stripes=STRIPES,
    ),
}
NOISE_PX = 0.1


def wide(rig: SimulatedRig) -> float:
    return SIZE[1] / rig.focal_px * rig.distance_mm


def solid(kind: str, width: float):
    steps = tuple(float(height) for height in np.array([0.03, 0.06, 0.09, 0.12]) * width)
    return {
        "block": Block("b", 2.0 * width, 0.3 * width, 0.12 * width, 0.02),
        "staircase": Staircase("s", steps, 0.1 * width, 2.0 * width, 0.02),
        "pyramid": Pyramid("p", 0.8 * width, 0.3 * width, 0.14 * width, 0.02),
    }[kind]


def truth(name: str, rng) -> Geometry:
    return shown(RIGS[name], rng).geometry


def calibrator(geometry: Geometry, folder: Path) -> PinholeCalibrator:
    path = folder / "camera.yaml"
    write_camera(path, view_of(parameters_of(geometry, travel=False), SIZE))
    return PinholeCalibrator(PinholeCalibratorOptions(camera=path))


@pytest.mark.parametrize(
    ("rig", "kind", "bare"),
    [
        ("gentle", "block", True),
        ("tilted", "block", False),
        pytest.param("tilted", "staircase", True, marks=pytest.mark.thorough),
        pytest.param("gentle", "staircase", False, marks=pytest.mark.thorough),
        ("gentle", "pyramid", False),
        ("tilted", "pyramid", True),
    ],
)
def test_planes_from_a_solid_measure_heights(rig: str, kind: str, bare: bool, rng, tmp_path: Path) -> None:
    """With and without an image of the empty belt; lengths are exact, so peaks' noise alone is left."""
    geometry, width = truth(rig, rng), wide(RIGS[rig])
    known = solid(kind, width)
    lying = on_belt(geometry, 0.01 * width, -0.008 * width, 3.0)
    seen = [seen_as(kind, crossings(lying, shape_of(known), SIZE), SIZE, rng, NOISE_PX)]
    if bare:
        seen.append(seen_as("belt", crossings(geometry, None, SIZE), SIZE, rng, NOISE_PX))
    found = calibrator(geometry, tmp_path).calibrate(set_of(seen, STRIPES, **{kind: known}))
    drawn = islice(found.redraws(np.random.default_rng(1)), 60)
    views = [view_of(one.parameters, SIZE) for one in (found, *drawn)]
    off, std = height_errors(geometry, views, np.array([0.0, 0.06, 0.12]) * width, SIZE)
    assert np.sqrt(np.mean((off / std) ** 2)) < 1.6, "the stated uncertainty holds"
    assert np.median(std) < 0.03, "mm"
    assert np.abs(off[std < 0.02]).max() < 0.05, "mm"
    assert found.residuals["stripes_rms_px"] == pytest.approx(NOISE_PX, rel=0.1)
    away, true = (1.0 / np.linalg.norm(b) for b in (found.parameters["belt_per_mm"], geometry.belt))
    assert away == pytest.approx(true, rel=0.004), "mm"


def test_the_solids_tolerance_is_in_the_covariance(rng, tmp_path: Path) -> None:
    """A block that is 1 % higher than described makes all heights 1 % too small: and that is stated."""
    geometry, width = truth("gentle", rng), wide(RIGS["gentle"])
    known = solid("block", width)
    lying = on_belt(geometry, 0.0, 0.0, 2.0)
    seen = [seen_as("block", crossings(lying, shape_of(known), SIZE), SIZE, rng, 0.02)]
    rough = replace(known, tolerance_mm=0.01 * known.height_mm * np.sqrt(3.0))
    found = calibrator(geometry, tmp_path).calibrate(set_of(seen, STRIPES, block=rough))
    redraws = found.redraws(np.random.default_rng(1))
    row = np.array([200.0])
    x = lines_at_height(found.parameters, row, known.height_mm)[3, 0]
    drawn = [view_of(next(redraws).parameters, SIZE).lift(np.array([x, 200.0]), 3)[2] for _ in range(200)]
    assert np.std(drawn) / known.height_mm == pytest.approx(0.01, rel=0.25)


@pytest.mark.thorough
@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (0.01, True), (0.08, True)])
def test_solids_that_contradict_each_other_are_refused_with_the_ratio(off, refused, rng, tmp_path) -> None:
    """A block that is higher than described by a share, beside a pyramid that is as described."""
    geometry, width = truth("tilted", rng), wide(RIGS["tilted"])
    known = {kind: solid(kind, width) for kind in ("pyramid", "block")}
    lying = on_belt(geometry, 0.01 * width, -0.008 * width, 3.0)
    seen = [
        seen_as(kind, crossings(lying, shape_of(one), SIZE), SIZE, rng, NOISE_PX)
        for kind, one in known.items()
    ]
    known["block"] = replace(known["block"], height_mm=known["block"].height_mm / (1.0 + off))
    method = calibrator(geometry, tmp_path)
    if refused:
        says = rf"pyramid and block contradict .* is {1.0 + off:.2f}\d\d ± 0\.00"
        with pytest.raises(CalibrationError, match=says) as caught:
            method.calibrate(set_of(seen, STRIPES, **known))
        assert "calliper" in (caught.value.hint or "")
        return
    found = method.calibrate(set_of(seen, STRIPES, **known)).residuals
    for kind in known:
        std = found[f"{kind}_height_ratio_std"]
        assert std < 0.003
        assert found[f"{kind}_height_ratio"] == pytest.approx(1.0, abs=3.0 * std)


@pytest.mark.parametrize(
    ("kind", "lies", "stripes", "says"),
    [
        ("block", False, STRIPES, "the block is not seen"),
        ("block", True, STRIPES + 2, "block: all 9 stripes are seen in 0 rows"),
        ("small pyramid", True, STRIPES, r"pyramid: stripe \d is found on one surface only"),
    ],
)
def test_a_solid_that_is_not_there_or_misses_stripes_is_told(
    kind, lies, stripes, says, rng, tmp_path
) -> None:
    geometry, width = truth("gentle", rng), wide(RIGS["gentle"])
    small = Pyramid("p", 0.35 * width, 0.15 * width, 0.1 * width, 0.02)
    known, kind = (small, "pyramid") if kind == "small pyramid" else (solid(kind, width), kind)
    lying = on_belt(geometry, 0.0, 0.0, 2.0) if lies else geometry
    seen = [seen_as(kind, crossings(lying, shape_of(known) if lies else None, SIZE), SIZE, rng, NOISE_PX)]
    with pytest.raises(CalibrationError, match=says) as caught:
        calibrator(geometry, tmp_path).calibrate(set_of(seen, stripes, **{kind: known}))
    assert caught.value.hint


def corners_of(geometry: Geometry, block: Block) -> Edges:
    """Four places on the edges of a block's top, where a camera sees them."""
    top = shape_of(block).faces[0]
    corners = np.column_stack([0.2 * top.corners_mm[:, 0], top.corners_mm[:, 1], np.full(4, top.plane[3])])
    zero, first = np.zeros(4), np.zeros(4, np.int64)
    at = corner_residuals(geometry, Corners(first, corners, np.zeros((4, 2)), zero, first))
    planes = np.tile(top.plane, (4, 1)), top.walls[[0, 0, 1, 1]]
    return Edges(first, *planes, at.reshape(-1, 2), zero + 1.0)


def test_derivatives_on_faces_and_edges_are_those_of_the_equations(rng) -> None:
    geometry = on_belt(truth("tilted", rng), 2.0, -1.0, 5.0)
    every = unknowns_of(geometry, free_camera=np.ones(CAMERA, bool), planes=True, belt=True, travel=False)
    exact = shown(RIGS["tilted"], rng).points
    face = np.tile(shape_of(solid("pyramid", 100.0)).faces[2].plane, (exact.pose.size, 1))
    points = replace(exact, pose=np.zeros_like(exact.pose), face=face)
    points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
    edges = corners_of(geometry, solid("block", 40.0))
    for rows, seen in ((stripe_rows, points), (edge_rows, edges)):
        assert_derivatives(rows, geometry, every, seen, step_sizes(every), 2e-4)


def test_a_corner_of_a_face_is_seen_on_its_edge(rng) -> None:
    """Edges against marks at the same corners: two ways to say where the image of a corner is."""
    geometry = on_belt(truth("tilted", rng), 2.0, -1.0, 5.0)
    edges = corners_of(geometry, solid("block", 60.0))
    free = unknowns_of(geometry, free_camera=np.zeros(CAMERA, bool), planes=True, belt=True, travel=False)
    assert np.abs(edge_rows(geometry, free, edges).residual).max() < 1e-8, "px"


def test_outlines_of_faces() -> None:
    pyramid = shape_of(Pyramid("p", 60.0, 20.0, 20.0, 0.02))
    to_right = pyramid.faces[1]
    assert to_right.plane @ [25.0, 0.0, 5.0, -1.0] == pytest.approx(0.0), "half way between 30 and 20"
    assert inside(to_right, np.array([[25.0, 0.0], [0.0, 0.0], [12.0, 11.9]])) == pytest.approx(
        [5.0, -10.0, 0.0707], abs=1e-3
    )
