"""Rendered rigs with their truth, read from files; what cannot be used is said in one sentence.

A rig folder holds ``truth.json``, ``truth/NAME.npz``, the rig files and recipes of a user, and the images
they name. ``truth_version`` in ``truth.json`` is 1; a file without it is taken for version 1.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.errors import DataError, RoemetryError
from roemetry.io.meshes import check_closed, read_mesh
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.view import View

TRUTH_VERSION = 1
NO_SKEIN = "no skein"
"""The grade of a body that none of a skein's classes describes."""
EDGE_PX = 3.0
"""Crossings nearer than this to the image's left or right border are not scored: half a stripe is outside."""


class RigError(DataError):
    """What is wrong with a rendered set: one sentence that names the file."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """True crossings of stripes (0 at the smallest belt x) and image rows that are lit and seen.

    `x_px` is the exact column, `z_mm` the height above the belt (NaN where the truth does not give it);
    `on_body`, not on the belt; `sure`, neither an end of a run of rows (an edge pixel) nor beside the image's
    border. All of shape (crossing,).
    """

    row: Integers
    stripe: Integers
    x_px: Floats
    z_mm: Floats
    on_body: Flags
    sure: Flags


@dataclass(frozen=True)
class Body:
    """One body: its name, true volumes in mm³ (NaN where they cannot be trusted), and its grade in words."""

    name: str
    laser: str
    plain: str
    truth: str
    topview_mm3: float
    volume_mm3: float
    grade: str


@dataclass(frozen=True, eq=False)
class RenderedRig:
    """A rig folder whose truth has been read; `faults` are the bodies that had to be left out, and why."""

    name: str
    folder: Path
    truth: Mapping[str, Any]
    bodies: tuple[Body, ...]
    faults: tuple[str, ...] = field(default=())

    @property
    def image_size(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.truth["camera"]["height"]), int(self.truth["camera"]["width"])


def rig_folders(folders: Iterable[Path]) -> list[Path]:
    """Give the rig folders among the given folders and directly below them."""
    found: list[Path] = []
    for folder in folders:
        below = sorted(path.parent for path in folder.glob("*/truth.json"))
        found += [folder] if (folder / "truth.json").exists() or not below else below
    return found


def read_rig(folder: Path) -> RenderedRig:
    """Read ``truth.json`` and see which bodies can be scored; raise RigError where it is no truth."""
    path = folder / "truth.json"
    try:
        truth = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise RigError(f"{path}: missing; a rig folder has its truth there") from None
    except (OSError, ValueError) as error:
        raise RigError(f"{path}: cannot be read: {error}") from None
    if not isinstance(truth, dict):
        raise RigError(f"{path}: is not a table of named values")
    version = truth.get("truth_version", TRUTH_VERSION)
    if version != TRUTH_VERSION:
        raise RigError(f"{path}: truth_version {version}; this benchmark reads {TRUTH_VERSION}")
    faults: list[str] = []
    bodies: list[Body] = []
    try:
        camera_and_planes(truth)
        objects = truth["objects"]
        wanted = {name: one for name, one in truth["images"].items() if one.get("kind") == "object"}
        for name, one in sorted(wanted.items()):
            missing = [one[role] for role in ("laser", "truth") if not (folder / one[role]).is_file()]
            if missing:
                faults.append(f"{name}: {' and '.join(missing)} missing; the body is left out")
                continue
            about = objects[one.get("object", name)]
            volume = float(about["volume_mm3"])
            leak = _open_mesh(folder, about)
            if leak:
                faults.append(f"{name}: {leak}; its volume_mm3 is not used")
                volume = float("nan")
            # a dented egg is no skein either
            grades = {"good": "good", "defective": str(about.get("defect") or NO_SKEIN)}
            grade = grades.get(str(about.get("cls")), NO_SKEIN)
            topview = float(about["topview_volume_mm3"])
            plain = one.get("plain", "")
            bodies.append(Body(name, one["laser"], plain, one["truth"], topview, volume, grade))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RoemetryError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise RigError(f"{path}: {what}") from None
    if not bodies:
        raise RigError(f"{folder}: no body can be scored" + "".join(f"; {fault}" for fault in faults))
    return RenderedRig(str(truth.get("rig", folder.name)), folder, truth, tuple(bodies), tuple(faults))


def read_crossings(path: Path, image_size: tuple[int, int], stripes: int | None = None) -> Crossings:
    """Read one image's true crossings of so many stripes (None: any number).

    Raises
    ------
    RigError
        The file is no npz, arrays are missing, or their shapes contradict the rig's.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise RigError(f"{path}: cannot be read: {error}") from None
    missing = [name for name in ("x", "label") if name not in arrays]
    if missing:
        raise RigError(f"{path}: {' and '.join(missing)} missing")
    try:
        x, label = (np.asarray(arrays[name], np.float64) for name in ("x", "label"))
    except (TypeError, ValueError) as error:
        raise RigError(f"{path}: x and label are not numbers: {error}") from None
    rows, columns = image_size
    if stripes is not None and x.ndim == 2 and x.shape[1] != stripes:
        raise RigError(f"{path}: x is of {x.shape[1]} stripes; truth.json has {stripes} planes")
    if x.ndim != 2 or x.shape[0] != rows or label.shape != x.shape:
        raise RigError(f"{path}: x is {x.shape} and label {label.shape}; the image has {rows} rows")
    place = arrays.get("X")
    if place is not None and place.shape != (*x.shape, 3):
        raise RigError(f"{path}: X is {place.shape}, expected {(*x.shape, 3)}")
    known = np.isfinite(x) & (label >= 0)
    body = known & (label == 1)
    inner = np.zeros_like(known)  # the crossings above and below are on the same surface
    for surface in (body, known & ~body):
        inner[1:-1] |= surface[1:-1] & surface[:-2] & surface[2:]
    row, stripe = np.nonzero(known)
    z = np.full(x.shape, np.nan) if place is None else np.asarray(place[..., 2], np.float64)
    parts = [(row, stripe, x[known], z[known], body[known], inner[known])]
    if "extra_row" in arrays:
        try:
            more = {n: arrays[f"extra_{n}"] for n in ("row", "stripe", "x", "label")}
            more_z = np.asarray(arrays["extra_X"], np.float64).reshape(-1, 3)[:, 2]
            none = np.zeros(len(more["row"]), np.bool_)
            parts.append((more["row"], more["stripe"], more["x"], more_z, more["label"] == 1, none))
            row, stripe, x_px, z_mm, on_body, sure = (np.concatenate(a) for a in zip(*parts, strict=True))
        except (KeyError, ValueError) as error:
            raise RigError(f"{path}: the extra solutions cannot be read: {error}") from None
    else:
        row, stripe, x_px, z_mm, on_body, sure = parts[0]
    sure &= (x_px >= EDGE_PX) & (x_px <= columns - 1 - EDGE_PX)
    return Crossings(
        row.astype(np.int64), stripe.astype(np.int64), x_px.astype(np.float64), z_mm, on_body, sure
    )


def camera_and_planes(truth: Mapping[str, Any]) -> View:
    """Give the true camera and planes of light in the belt frame."""
    camera, laser = truth["camera"], truth["laser"]
    turn = np.array(camera["R_belt_to_cam"], np.float64)
    shift = np.array(camera["t_belt_to_cam"], np.float64)
    u, _, v = np.linalg.svd(turn)  # written with twelve digits: made a rotation again
    pose = np.eye(4)
    pose[:3, :3] = (u @ v).T
    pose[:3, 3] = -pose[:3, :3] @ shift
    planes = np.array(laser["planes_belt"], np.float64)
    planes[:, 3] *= -1.0  # n·X + d = 0 in the file, n·X = d here
    planes /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    return View(
        image_size=(int(camera["height"]), int(camera["width"])), T_belt_camera=pose, planes=planes,
        camera_matrix=np.array(camera["K"], np.float64),
        distortion=np.array(camera["dist_k1k2p1p2k3"], np.float64),
        projector_mm=np.array(laser["projector_centre_belt"], np.float64),
    )  # fmt: skip


def true_calibration(truth: Mapping[str, Any], height_max_mm: float) -> Calibration:
    """Give the calibration that `pinhole-plane` would make of perfect images; its covariance is zero."""
    view = camera_and_planes(truth)
    matrix, pose = view.camera_matrix, view.T_belt_camera
    normal = view.planes[:, :3] @ pose[:3, :3]  # n·(R X + c) = d
    away = view.planes[:, 3] - view.planes[:, :3] @ pose[:3, 3]
    up = pose[2, :3]
    parameters = {
        "focal_px": np.array([matrix[0, 0], matrix[1, 1]]),
        "principal_px": matrix[:2, 2],
        "distortion": np.concatenate([view.distortion, np.zeros(8 - view.distortion.size)]),
        "planes_per_mm": normal / away[:, None],
        "belt_per_mm": up / -pose[2, 3],
    }
    rows = view.image_size[0]
    row_px = np.arange(rows, dtype=np.float64)
    rest, lifted = lines_at(view, 0.0, row_px), lines_at(view, 1.0, row_px)
    size = sum(np.size(value) for value in parameters.values())
    rest_px = np.polynomial.polynomial.polyfit(row_px - 0.5 * (rows - 1), rest.T, 6).T
    return Calibration(
        method="pinhole-plane", image_size=view.image_size, turn_deg=0, rest_px=rest_px.astype(np.float64),
        displacement_px_per_mm=(lifted - rest)[:, rows // 2], height_range_mm=(0.0, height_max_mm),
        parameters=parameters, covariance=np.zeros((size, size)), extractor={"use": "exact"}, view=view,
    )  # fmt: skip


def lines_at(view: View, height_mm: float, row_px: Floats) -> Floats:
    """Give (stripe, row) where the planes meet a level, px."""
    y = np.linspace(-250.0, 250.0, 4001)
    lines = []
    for number, plane in enumerate(view.planes):
        points = np.column_stack(
            [(plane[3] - plane[1] * y - plane[2] * height_mm) / plane[0], y, np.full(y.size, height_mm)]
        )
        xy = view.project(points)
        near = (np.abs(xy - 0.5 * np.array(view.image_size[::-1])) < 0.75 * max(view.image_size)).all(axis=1)
        # far outside the image the lens model folds back: only points whose ray comes home count
        near &= np.abs(view.lift(xy, np.full(y.size, number)) - points).max(axis=1) < 1e-3
        order = np.argsort(xy[near, 1])
        lines.append(np.interp(row_px, xy[near, 1][order], xy[near, 0][order]))
    return np.array(lines)


def _open_mesh(folder: Path, about: Mapping[str, Any]) -> str:
    """Say why a body's mesh has no volume; "" where nothing speaks against it."""
    if about.get("watertight") is False:
        return "its mesh is not watertight (truth.json says so)"
    path = folder / str(about.get("mesh", ""))
    if not path.is_file():  # the volume stands in truth.json: the mesh is a check only
        return ""
    try:
        mesh = read_mesh(path)
        check_closed(mesh._replace(points=np.round(mesh.points, 6)), path.name)
    except DataError as error:
        return error.message
    return ""
