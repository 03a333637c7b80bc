"""Scans by the second simulator: the same light as of one image, lines where truth says, both heads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roemetry.errors import StageError

pytest.importorskip("mitsuba", reason='pip install "roemetry[mitsuba]"')
drjit = pytest.importorskip("drjit")
pytestmark = pytest.mark.skipif(
    not drjit.has_backend(drjit.JitBackend.LLVM), reason="the LLVM library is not found"
)

from roemetry_mitsuba.light import Lamps, Lens, Material, Tracer  # noqa: E402
from roemetry_mitsuba.materials import dipole_of  # noqa: E402
from roemetry_mitsuba.moving_belt import MitsubaBelt, MitsubaBeltOptions, MovingTracer  # noqa: E402

RIG: dict[str, Any] = {
    "camera": {
        "width_px": 140, "height_px": 100, "pixel_size_um": 20, "focal_length_mm": 12, "distance_mm": 300,
        "tilt_x_deg": 0, "tilt_y_deg": 35, "exposure_ms": 5, "read_noise_e": 5,
    },
    "light": {"ambient_e_per_ms": 0.2},
    "laser": {
        "projector_mm": [0, 0, 400], "planes": 1, "centre_x_mm": 0, "line_width_mm": 1.6,
        "speckle_contrast": 0.0,
    },
    "product": {
        "family": "box", "options": {"length_mm": [20, 21], "width_mm": [20, 21], "height_mm": [9, 10]},
    },
    "bounce_rays": 4,
}  # fmt: skip


def belt(**scan: Any) -> MitsubaBelt:
    told = {"counts_per_line": 100, "lead_mm": 6, **scan}
    return MitsubaBelt(MitsubaBeltOptions.model_validate(RIG | {"scan": told}))


def matt(albedo: float) -> Material:
    return Material(np.full((2, 2), albedo), np.zeros((2, 4)))


def test_a_frame_of_a_scan_is_the_image_of_a_product_that_lies_there() -> None:
    sim = belt()
    body = sim.placed(0, 3)[0].body
    below = dipole_of(0.5, 0.8), 0.4
    rest = (sim.camera, Lens(), sim.fan, matt(0.6))
    there = np.array([-4.0, 0.5, 0.0])
    laser, other = next(
        MovingTracer(*rest, [body], matt(0.5), below, 2, 1).frames(there[None], Lamps(3.0), bounce_rays=64)
    )
    moved = Tracer(*rest, [body.moved(*there[:2])], matt(0.5), below, 2, 1)
    as_image, rest_of_it = moved.image(Lamps(3.0), laser=True, bounce_rays=64)
    assert as_image.max() > 50.0
    # light between surfaces is drawn anew, and edges of belt and body lie between nodes beside the line
    assert np.abs(laser - as_image).max() < 0.02 * as_image.max()
    assert np.quantile(np.abs(other - rest_of_it), 0.95) < 0.1


@pytest.mark.parametrize("below_mm", [None, 30.0])
def test_lines_lie_where_truth_says(below_mm: float | None) -> None:
    sim = belt(below_mm=below_mm, line_y_mm=(-14.0, 13.0))
    made = sim.simulate(0, 3)
    assert made.counts is not None
    rows = sim.options.camera.height_px
    frames = made.frames[0].pixels.reshape(len(made.counts), rows, -1)
    found = list(sim.crossings(sim.placed(0, 3), 3))
    off = []
    for frame, crossed in zip(frames, found, strict=True):
        for row, x_px, label in zip(crossed.row, crossed.x_px, crossed.label, strict=True):
            near = np.arange(round(x_px) - 7, round(x_px) + 8)
            if label > 0 and near[0] >= 0 and near[-1] < frame.shape[1] and 3 <= row < rows - 3:
                light = np.maximum(frame[row, near].astype(float) - 5.0, 0.0)
                if light.sum() > 80.0:
                    off.append(light @ near / light.sum() - x_px)
    assert len(off) > 300
    assert abs(float(np.median(off))) < 0.05
    assert made.truth.products[0].visible_mm3 == pytest.approx(20.5**2 * 9.5, rel=0.1)
    on_belt = np.concatenate([crossed.xyz_mm[crossed.label == 0, 1] for crossed in found])
    if below_mm is None:
        assert -14.0 <= on_belt.min() < -13.2 and 12.2 < on_belt.max() <= 13.0
        row = np.flatnonzero(frames[0].max(axis=1) > 40)  # a bare belt: Y runs against the rows
        ends = sim.camera.project(np.array([[0.0, 13.0, 0.0], [0.0, -14.0, 0.0]]))[:, 1]
        assert np.abs(row[[0, -1]] - ends).max() < 1.6
    assert (below_mm is None) == any((crossed.label == 0).any() for crossed in found)


def test_counts_and_motion_are_those_of_the_scene() -> None:
    sim = belt(mm_per_count=(-0.02, 0.001), first_count=65500, wrap_bits=16)
    counts, moved = sim.belt(sim.placed(0, 3), 3)
    assert np.diff(moved[:, :2], axis=0) == pytest.approx(np.broadcast_to([-2.0, 0.1], (len(counts) - 1, 2)))
    assert sim.options.scan.shown(counts).max() < 1 << 16
    assert sim.calibration_truth(0)["mm_per_count"] == [-0.02, 0.001, 0.0]


def test_a_product_wider_than_the_view_is_refused() -> None:
    told = RIG | {"product": {"family": "box", "options": {"width_mm": [150, 160], "turn_range_deg": 0}}}
    with pytest.raises(StageError, match="the view is Y"):
        MitsubaBelt(MitsubaBeltOptions.model_validate(told))
