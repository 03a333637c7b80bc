"""What all heights may be wrong by together: what is stated of each, less what scatters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Product
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry_volume.slice_estimators import SlicePchip, common_height_std_mm
from tests.plugins.volume.test_slices import ELEVEN


def stated(std_mm: float, noise_mm: float, rng: np.random.Generator) -> Product:
    one = product_of(HALF_ELLIPSOID, ELEVEN)
    xyz = one.profiles.xyz_mm.copy()
    xyz[..., 2] += noise_mm * rng.standard_normal(xyz.shape[:2])
    std = np.where(np.isfinite(xyz[..., 2]), std_mm, np.nan)
    return replace(one, profiles=replace(one.profiles, xyz_mm=xyz, height_std_mm=std))


def test_what_is_stated_and_does_not_scatter_is_common(rng: np.random.Generator) -> None:
    smooth = stated(0.06, 0.0, rng)
    assert common_height_std_mm(smooth) == pytest.approx(0.06 / np.sqrt(2.0), abs=0.002)
    found = SlicePchip().estimate(smooth).visible_mm3
    share = found.budget["common height"] / common_height_std_mm(smooth)
    assert share == pytest.approx(np.pi / 4.0 * 60.0 * 30.0, rel=0.05)  # the footprint, mm²


def test_noise_is_not_common(rng: np.random.Generator) -> None:
    assert common_height_std_mm(stated(0.06, 0.06, rng)) < 0.02
    assert common_height_std_mm(stated(0.10, 0.06, rng)) == pytest.approx(0.08 / np.sqrt(2.0), abs=0.015)
    assert common_height_std_mm(stated(np.nan, 0.06, rng)) == 0.0
