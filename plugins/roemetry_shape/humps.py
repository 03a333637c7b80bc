"""Humps: regions where the surface stands above the smooth body that fits most of it."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_shape.regions import Region, regions_of
from roemetry_shape.sections import SAMPLES, Sections

_LEAST_MM = 0.8
"""Lower is relief, or a body that is not as smooth as the fit."""

_INNER = 0.85
_ROUNDS = 6
_STEP = 2
_SECTIONS_MIN = 5
_SPREAD_LEAST_MM2 = 4.0


def humps_of(sections: Sections) -> tuple[Floats, tuple[Region, ...]]:
    """Give (section, sample) heights above the smooth body, mm, and the humps, the highest first.

    The squared height of a dome is nearly a polynomial of low order over its footprint (of a half-ellipsoid
    it is one of second order): that is fitted, quadratic across and cubic along, with weights that let single
    regions go their own way (Cauchy). At the outer 15 % of the width, where a dome is steep, nothing is said.
    """
    height: Floats = np.zeros((len(sections.stripe), SAMPLES))
    if len(sections.stripe) < _SECTIONS_MIN:
        return height, ()
    inner = np.abs(np.linspace(-1.0, 1.0, SAMPLES)) <= _INNER
    height[:, inner] = np.maximum(sections.height_mm - dome_of(sections), 0.0)[:, inner]
    return height, regions_of(height, sections, _LEAST_MM)


def dome_of(sections: Sections) -> Floats:
    """(section, sample) heights of the smooth body that fits most of the surface, mm; see `humps_of`."""
    t: Floats = np.linspace(-1.0, 1.0, SAMPLES)
    along = sections.along_mm / max(float(sections.along_mm[-1]), 1e-9) * 2.0 - 1.0
    inner = np.abs(t) <= _INNER
    design = _basis(along, t)
    squared = sections.height_mm**2
    chosen = np.flatnonzero(inner)[::_STEP]
    rows = design[:, chosen].reshape(-1, design.shape[-1])
    wanted = squared[:, chosen].ravel()
    weight: Floats = np.ones(wanted.size)
    fit: Floats = np.zeros(rows.shape[1])
    for _ in range(_ROUNDS):
        normal = rows.T @ (weight[:, None] * rows) + 1e-9 * np.eye(rows.shape[1])
        fit = np.asarray(np.linalg.solve(normal, rows.T @ (weight * wanted)), np.float64)
        off = wanted - rows @ fit
        spread = max(1.4826 * float(np.median(np.abs(off))), _SPREAD_LEAST_MM2)
        weight = 1.0 / (1.0 + (off / (2.0 * spread)) ** 2)
    return np.sqrt(np.maximum(design @ fit, 0.0))


def _basis(along: Floats, t: Floats) -> Floats:
    """(section, sample, 12) products of 1, s, s², s³ and 1, t, t²."""
    of_s = np.stack([along**k for k in range(4)], axis=-1)
    of_t = np.stack([t**k for k in range(3)], axis=-1)
    return np.asarray(np.einsum("ik,jl->ijkl", of_s, of_t).reshape(along.size, t.size, 12))
