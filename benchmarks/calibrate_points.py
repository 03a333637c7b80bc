"""Calibrations of simulated points, over and over; spread against stated uncertainty.

``python -m benchmarks calibrate_points [--repeats 100] [--rigs gentle,wide] [--stripes 1,11,21] [--seed 1]``
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace

import numpy as np

from benchmarks.command import parser_of
from benchmarks.simulated_points import Shown, SimulatedRig, noisy, shown
from benchmarks.tables import table
from roemetry.records.arrays import Floats
from roemetry_pinhole.bundle import Problem, Weights, adjust, inverse
from roemetry_pinhole.geometry import CAMERA, Geometry, Unknowns, undistort, unknowns_of
from roemetry_pinhole.pinhole_plane import belt_pose

RIGS = {
    "gentle": SimulatedRig(2000.0, 400.0),
    "long lens": SimulatedRig(5000.0, 900.0, tilt_deg=(1.0, 1.0)),
    "mild": SimulatedRig(1500.0, 350.0, tilt_deg=(3.0, 2.0), lens=(-0.1, 0.05, 0.0005, -0.0005, 0.0)),
    "tilted": SimulatedRig(1600.0, 350.0, tilt_deg=(20.0, -12.0), lens=(-0.12, 0.06, 0.001, 0.0005, 0.0)),
    "barrel": SimulatedRig(1100.0, 280.0, tilt_deg=(3.0, 4.0), lens=(-0.28, 0.11, 0.001, -0.001, -0.02)),
    "wide": SimulatedRig(800.0, 220.0, tilt_deg=(4.0, -5.0), lens=(-0.30, 0.12, 0.001, -0.0005, -0.02)),
    "wide tilted": SimulatedRig(
        800.0, 240.0, tilt_deg=(15.0, 10.0), lens=(-0.25, 0.09, -0.001, 0.0005, -0.012)
    ),
}
MARK_PX, STRIPE_PX, CONTACT_MM = 0.08, 0.15, 0.03
FREE = np.arange(CAMERA) < 9


def main() -> None:
    """Print a row for each rig and number of stripes."""
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--rigs", default=",".join(RIGS))
    parser.add_argument("--stripes", default="1,11,21")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print(f"{given.repeats} calibrations each, seed {given.seed}")
    pairs = [(name, int(stripes)) for name in given.rigs.split(",") for stripes in given.stripes.split(",")]
    rows = [_row(name, stripes, given.repeats, given.seed) for name, stripes in pairs]
    head = ["rig", "stripes", "χ²/3", "plane std / bound, median and most", "heights: scatter / stated", "ms"]
    print(table(head, rows), end="")


def _row(name: str, stripes: int, repeats: int, seed: int) -> list[str]:
    rng = np.random.default_rng([seed, stripes, list(RIGS).index(name)])
    exact = shown(replace(RIGS[name], stripes=stripes), rng)
    free = unknowns_of(exact.geometry, free_camera=FREE, planes=True, belt=True, travel=False)
    at = _chosen(exact, stripes)
    slopes = _slopes(exact.geometry, free, exact, at)
    truth = _heights(exact.geometry, exact, at)
    squares, planes, heights, stated, seconds = [], [], [], [], []
    for _ in range(repeats):
        seen = noisy(exact, rng, MARK_PX, STRIPE_PX, CONTACT_MM)
        begin = time.perf_counter()
        found = adjust(
            exact.geometry, free, seen.corners, seen.points, seen.contacts, contact_std_mm=CONTACT_MM
        )
        seconds.append(time.perf_counter() - begin)
        off = found.geometry.planes - exact.geometry.planes
        covariance = found.covariance[free.planes[:, :, None], free.planes[:, None, :]]
        squares.append(np.einsum("si,sij,sj->s", off, np.linalg.inv(covariance), off) / 3.0)
        planes.append(off)
        heights.append(_heights(found.geometry, exact, at) - truth)
        stated.append(np.einsum("ij,jk,ik->i", slopes, found.covariance, slopes))
    bound = np.sqrt(np.diag(_bound(exact, free))[free.planes])
    spread = np.std(planes, axis=0) / bound
    ratio = np.std(heights, axis=0) / np.sqrt(np.mean(stated, axis=0))
    return [
        name, f"{stripes}", f"{np.mean(squares):.2f}", f"{np.median(spread):.2f} {spread.max():.2f}",
        f"{np.median(ratio):.2f} ({ratio.min():.2f}–{ratio.max():.2f})",
        f"{1e3 * statistics.median(seconds):.0f}",
    ]  # fmt: skip


def _bound(exact: Shown, free: Unknowns) -> Floats:
    """Covariance that the Jacobian at the truth and the true noise give."""
    weights = Weights(
        MARK_PX, STRIPE_PX, np.ones(exact.corners.pose.size), np.ones(exact.points.pose.size), robust=False
    )
    problem = Problem(free, exact.corners, exact.points, exact.contacts, CONTACT_MM, weights)
    return inverse(problem.normal(exact.geometry)[0])


def _chosen(exact: Shown, stripes: int) -> np.ndarray:
    """Five points along each of up to five stripes, at whatever heights the boards had."""
    chosen = []
    for stripe in np.unique(np.linspace(0, stripes - 1, 5).astype(int)):
        mine = np.flatnonzero(exact.points.stripe == stripe)
        by_row = mine[np.argsort(exact.points.row_px[mine], kind="stable")]
        chosen.append(by_row[np.linspace(0, by_row.size - 1, 5).astype(int)])
    return np.concatenate(chosen)


def _heights(geometry: Geometry, exact: Shown, at: np.ndarray) -> Floats:
    """Heights over the belt, mm, of chosen stripe points without noise."""
    seen = np.column_stack([exact.points.x_px[at], exact.points.row_px[at]])
    xy = undistort((seen - geometry.camera[2:4]) / geometry.camera[:2], geometry.camera[4:])
    ray = np.column_stack([xy, np.ones(len(xy))])
    points = ray / (ray * geometry.planes[exact.points.stripe[at]]).sum(axis=1)[:, None]
    pose = belt_pose(geometry.belt)
    return np.asarray(points @ pose[2, :3] + pose[2, 3])


def _slopes(geometry: Geometry, free: Unknowns, exact: Shown, at: np.ndarray) -> Floats:
    """∂height/∂unknown by central differences."""
    slopes = np.zeros((at.size, free.count))
    steps = [*[1e-3] * 4, *[1e-6] * 5, *[1e-8] * (free.poses.min() - 9)]
    for number, size in enumerate(steps):
        step = np.zeros(free.count)
        step[number] = size
        up, down = (_heights(free.moved(geometry, s * step), exact, at) for s in (1.0, -1.0))
        slopes[:, number] = (up - down) / (2.0 * size)
    return slopes
