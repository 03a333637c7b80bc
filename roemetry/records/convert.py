"""Results as the tables and arrays of other libraries, each in one call."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import import_module
from typing import Any

import numpy as np

from roemetry.errors import ConfigurationError
from roemetry.records.measurement import Measurement
from roemetry.records.product import Profiles


def to_pandas(measurements: Iterable[Measurement]) -> Any:
    """Give measurements as a pandas data frame: a row a product, a column a number.

    Parameters
    ----------
    measurements
        As `Recipe.run` and `Recipe.measure` give them, or read from a record.

    Returns
    -------
    pandas.DataFrame
        Columns are named as in the record's lines with a dot between levels: ``volume.visible_mm3.value``,
        ``volume.visible_mm3.std``, ``weight.mass_g.value``, ``grade.label``. What is not stated is NaN.

    Raises
    ------
    ConfigurationError
        pandas is not installed.
    """
    pandas = _library("pandas")
    return pandas.json_normalize([json.loads(one.to_json()) for one in measurements])


def to_xarray(profiles: Profiles) -> Any:
    """Give profiles as an xarray data set over (slice, point).

    Returns
    -------
    xarray.Dataset
        ``x_mm``, ``y_mm``, ``z_mm`` in the belt frame, ``height_std_mm``, ``product``, ``seen``, ``x_px``,
        ``row_px`` over (slice, point), with the coordinate ``stripe``; NaN where nothing is known.

    Raises
    ------
    ConfigurationError
        xarray is not installed.
    """
    xarray = _library("xarray")
    over = ("slice", "point")
    values: dict[str, Any] = {
        f"{name}_mm": (over, profiles.xyz_mm[:, :, axis], {"units": "mm"}) for axis, name in enumerate("xyz")
    }
    values["height_std_mm"] = (over, profiles.height_std_mm, {"units": "mm"})
    values |= {name: (over, getattr(profiles, name)) for name in ("product", "seen", "x_px", "row_px")}
    return xarray.Dataset(values, coords={"stripe": ("slice", profiles.stripe)})


def to_point_cloud(profiles: Profiles) -> Any:
    """Give the seen points of products as an Open3D point cloud, mm in the belt frame.

    Returns
    -------
    open3d.geometry.PointCloud
        Points that a stripe was seen at; neither the belt nor what was bridged.

    Raises
    ------
    ConfigurationError
        Open3D is not installed.
    """
    open3d = _library("open3d")
    on = (profiles.product > 0) & profiles.seen & np.isfinite(profiles.xyz_mm).all(axis=2)
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(profiles.xyz_mm[on]))


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"{name} is not installed", hint="pip install 'roemetry[notebook]', or the library itself"
        ) from error
