"""Bodies of the other simulator's families, traced exactly on the rigs of `volume_scenes`, without images.

The families are meshes of the plugin `mitsuba`; the estimators were developed on bodies of the plugin
`simulate`. What a plane of light and a line of sight meet is found by casting rays at the mesh (Open3D).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from benchmarks.volume_scenes import Exact, calibration_of, rig_of
from roemetry.records import NOTHING, Outline, Product, Profiles
from roemetry.records.view import View
from roemetry_mitsuba.bodies import Body
from roemetry_mitsuba.products import FAMILIES

Floats = NDArray[np.float64]

_COLUMNS_PER_PX = 10
"""Of the lines of sight along a row: the surface is straight between two of them, to a micrometre."""
_SUBPIXELS = 8
"""Of the silhouette's mask; its smoothed contour is good to about 0.02 px."""
_JUMP_MM = 0.5
"""Two neighbouring lines of sight whose distances from the plane differ by more lie on two surfaces."""
_LIT_MM = 0.1
"""A ray of light that stops so much before the point is another surface's."""


class Mesh:
    """A body for rays to hit."""

    def __init__(self, body: Body) -> None:
        import open3d as o3d

        tensor: Any = o3d.core.Tensor  # its stubs do not know that it takes arrays
        self._tensor = tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            tensor(np.ascontiguousarray(body.points_mm, np.float32)),
            tensor(np.ascontiguousarray(body.faces, np.uint32)),
        )

    def hit(self, origin: Floats, directions: Floats) -> Floats:
        """Give the length of each ray from `origin` (3,) in its directions (…, 3); inf where it misses."""
        rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], axis=-1)
        found = self._scene.cast_rays(self._tensor(rays.astype(np.float32)))["t_hit"].numpy()
        return np.asarray(found, np.float64)


def exact_body(family: str, seed: int, stripes: int = 11) -> Exact:
    """Draw a body of a family of the plugin `mitsuba`, and trace it on the rig of the same seed."""
    made = FAMILIES[family]
    body = made.make(np.random.default_rng(seed), made.Options()).body
    calibration = calibration_of(rig_of(seed, stripes))
    view = calibration.view
    assert view is not None
    mesh, seen = Mesh(body), view.project(body.points_mm)
    low, high = np.floor(seen.min(axis=0) - 4.0).astype(int), np.ceil(seen.max(axis=0) + 5.0).astype(int)
    product = Product(
        number=1,
        profiles=_profiles(mesh, view, low, high),
        calibration=calibration,
        acquisition_ids=("exact",),
        outline=Outline(1, _silhouette(mesh, view, low, high), 0.0),
        view=view,
    )
    return Exact(product, body.visible_mm3, body.true_mm3)


def _sight(view: View, x_px: Floats, y_px: Floats) -> Floats:
    """Directions (rows, columns, 3) of the lines of sight through a grid of pixels, belt frame."""
    k, turn = view.camera_matrix, view.T_belt_camera[:3, :3]
    x, y = np.meshgrid((x_px - k[0, 2]) / k[0, 0], (y_px - k[1, 2]) / k[1, 1])
    directions: Floats = np.stack([x, y, np.ones_like(x)], axis=-1) @ turn.T
    return directions


def _silhouette(mesh: Mesh, view: View, low: NDArray[np.int_], high: NDArray[np.int_]) -> Floats:
    """Contour of the body in the image, (n, 2) px: that of a fine mask, smoothed, with the mask's area."""
    x_px, y_px = (np.arange((high[k] - low[k]) * _SUBPIXELS) / _SUBPIXELS + low[k] for k in (0, 1))
    mask = np.isfinite(mesh.hit(view.T_belt_camera[:3, 3], _sight(view, x_px, y_px))).astype(np.uint8)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chain = max(found, key=len)[:, 0].astype(np.float64)
    xy = gaussian_filter1d(chain, 6.0, axis=0, mode="wrap")
    tangent = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
    ahead = np.roll(xy, -1, axis=0)
    area = 0.5 * float(np.sum(xy[:, 0] * ahead[:, 1] - xy[:, 1] * ahead[:, 0]))
    length = float(np.hypot(*(ahead - xy).T).sum())
    xy += np.sign(area) * outward * (float(mask.sum()) - abs(area)) / length
    return np.asarray(xy[:: max(len(xy) // 800, 1)] / _SUBPIXELS + low)


def _profiles(mesh: Mesh, view: View, low: NDArray[np.int_], high: NDArray[np.int_]) -> Profiles:
    """Points of the body that are lit by each plane and seen in each row; the highest where there are two."""
    camera, rows = view.T_belt_camera[:3, 3], np.arange(low[1], high[1])
    x_px = np.arange(low[0] * _COLUMNS_PER_PX, high[0] * _COLUMNS_PER_PX) / _COLUMNS_PER_PX
    sight = _sight(view, x_px, rows.astype(np.float64))
    reach = mesh.hit(camera, sight)
    on_body = np.isfinite(reach)
    surface = camera + sight * np.where(on_body, reach, 0.0)[..., None]
    shape = (len(view.planes), view.image_size[0])
    xyz, column = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    for number, plane in enumerate(view.planes):
        off = surface @ plane[:3] - plane[3]
        here, there = off[:, :-1], off[:, 1:]
        crossed = on_body[:, :-1] & on_body[:, 1:] & ((here < 0.0) != (there < 0.0))
        row, left = np.nonzero(crossed & (np.abs(there - here) < _JUMP_MM))
        part = here[row, left] / (here[row, left] - there[row, left])
        point = surface[row, left] + part[:, None] * (surface[row, left + 1] - surface[row, left])
        light = point - view.projector_mm
        distance = np.linalg.norm(light, axis=1)
        lit = mesh.hit(view.projector_mm, light / distance[:, None]) > distance - _LIT_MM
        order = np.flatnonzero(lit)[np.argsort(point[lit, 2])]  # the highest is written last
        xyz[number, rows[row[order]]] = point[order]
        column[number, rows[row[order]]] = x_px[left[order]] + part[order] / _COLUMNS_PER_PX
    seen = np.isfinite(column)
    row_px = np.broadcast_to(np.arange(shape[1], dtype=np.float64), shape)
    return Profiles(
        xyz_mm=xyz,
        product=np.where(seen, 1, NOTHING),
        seen=seen,
        x_px=column,
        row_px=np.where(seen, row_px, np.nan),
        height_std_mm=np.full(shape, np.nan),
        stripe=np.arange(shape[0]),
        frame=np.zeros(shape[0], np.int64),
        plane=view.planes.copy(),
    )
