"""The projector: a fan of light planes from one point, each a stripe on the belt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LaserFan:
    """N planes of light through one projector point.

    Attributes
    ----------
    projector_mm : ndarray, shape (3,)
        Where the light comes from, belt frame, millimetres.
    normals : ndarray, shape (N, 3)
        Unit normals n of the planes n·X = d in the belt frame, stripes ordered along belt X.
    offsets_mm : ndarray, shape (N,)
        Their d, millimetres.
    line_axis : ndarray, shape (3,)
        Unit direction which all planes share (the lines' run), belt frame.
    sigma_mm : float
        Standard deviation of the light's Gaussian profile across a plane, where it is thinnest.
    peak_grey : ndarray, shape (N,)
        Grey levels in a plane's middle on a white (albedo 1) surface that faces the projector.
    line_sigma_deg : float
        Gaussian fall of the power with the angle along the line.
    waist_distance_mm, divergence_mrad : float
        Where the planes are thinnest, from the projector, and how the standard deviation grows away from
        there: sqrt(sigma² + (divergence · (distance − waist))²). A plane that is wider is less bright.
    """

    projector_mm: Floats
    normals: Floats
    offsets_mm: Floats
    line_axis: Floats
    sigma_mm: float
    peak_grey: Floats
    line_sigma_deg: float = 25.0
    waist_distance_mm: float = 0.0
    divergence_mrad: float = 0.0

    def __post_init__(self) -> None:
        if self.sigma_mm <= 0.0 or self.line_sigma_deg <= 0.0:
            raise ValueError("a laser line needs a positive width and a positive fan angle")
        for name in ("projector_mm", "normals", "offsets_mm", "line_axis", "peak_grey"):
            value = np.array(getattr(self, name), dtype=np.float64)
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        count = len(self.normals)
        if self.normals.shape != (count, 3) or {self.offsets_mm.shape, self.peak_grey.shape} != {(count,)}:
            raise ValueError("normals must be (N, 3), offsets_mm and peak_grey (N,)")

    def packed(self) -> Floats:
        """Return what the kernels take: waist (mm), fall (rad), its distance (mm), divergence (rad)."""
        return np.array(
            [
                self.sigma_mm,
                np.deg2rad(self.line_sigma_deg),
                self.waist_distance_mm,
                1e-3 * self.divergence_mrad,
            ]
        )

    @property
    def count(self) -> int:
        """Number of planes."""
        return len(self.normals)

    def distance_mm(self, points_mm: ArrayLike) -> Floats:
        """Signed distances of points to all planes.

        Parameters
        ----------
        points_mm : array_like, shape (..., 3)
            Belt frame, millimetres.

        Returns
        -------
        ndarray, shape (..., N)
            n·X - d, millimetres.
        """
        distances: Floats = np.asarray(points_mm, dtype=np.float64) @ self.normals.T - self.offsets_mm
        return distances

    def x_mm(self, y_mm: ArrayLike, z_mm: ArrayLike) -> Floats:
        """Where the planes are at given Y and Z.

        Parameters
        ----------
        y_mm, z_mm : array_like
            Belt frame, millimetres; they broadcast to a common shape S.

        Returns
        -------
        ndarray, shape S + (N,)
            X of each plane, millimetres.
        """
        y, z = np.broadcast_arrays(np.asarray(y_mm, dtype=np.float64), np.asarray(z_mm, dtype=np.float64))
        rest = self.offsets_mm - y[..., None] * self.normals[:, 1] - z[..., None] * self.normals[:, 2]
        x: Floats = rest / self.normals[:, 0]
        return x

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for a YAML file."""
        return {
            "projector_mm": [float(v) for v in self.projector_mm],
            "line_axis": [float(v) for v in self.line_axis],
            "sigma_mm": self.sigma_mm,
            "line_sigma_deg": self.line_sigma_deg,
            "peak_grey": [float(v) for v in self.peak_grey],
            "planes": [
                {"n": [float(v) for v in n], "d_mm": float(d)}
                for n, d in zip(self.normals, self.offsets_mm, strict=True)
            ],
        }


def fan_through(
    projector_mm: ArrayLike,
    belt_x_mm: ArrayLike,
    *,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    sigma_mm: float,
    peak_grey: ArrayLike,
    line_sigma_deg: float = 25.0,
) -> LaserFan:
    """Return the fan whose planes meet the belt's X axis at given places.

    Parameters
    ----------
    projector_mm : array_like, shape (3,)
        Projector point, belt frame, millimetres.
    belt_x_mm : array_like, shape (N,)
        X of each stripe at Y = 0, Z = 0, increasing, millimetres.
    yaw_deg : float
        Turn of the lines about Z, counter-clockwise seen from above; 0 is parallel to Y.
    pitch_deg : float
        Rise of the lines' common direction out of the belt plane.
    sigma_mm, peak_grey, line_sigma_deg
        See `LaserFan`; a single `peak_grey` serves all planes.

    Returns
    -------
    LaserFan
        Normals point towards +X.
    """
    projector = np.asarray(projector_mm, dtype=np.float64)
    feet = np.atleast_1d(np.asarray(belt_x_mm, dtype=np.float64))
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    axis = np.array([-np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    towards = np.stack([feet, np.zeros_like(feet), np.zeros_like(feet)], axis=-1) - projector
    normals = np.cross(towards, axis)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= np.sign(normals[:, :1])
    peak = np.broadcast_to(np.asarray(peak_grey, dtype=np.float64), feet.shape)
    return LaserFan(projector, normals, normals @ projector, axis, sigma_mm, peak, line_sigma_deg)
