"""Records from and to others: results as tables and arrays of other libraries, products from their points."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import ConfigurationError, DataError
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.records.measurement import Measurement
from roemetry.records.product import Product
from roemetry.records.profiles import Profiles


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


_POINTS_MIN = 3  # of a slice: fewer lie on any plane
_OFF_PLANE_MM = 1.0
"""Points of one slice may leave its plane by so much, rms: more is no section."""
_ROWS_BESIDE = 4
"""Empty image rows on either side, so that no stage takes the product for cut off."""
_SAMPLES = 2.0
"""Points of a slice made from a cloud: two for each slice's thickness."""


def product_from_points(
    points_mm: NDArray[np.floating] | Sequence[NDArray[np.floating]],
    *,
    slice_mm: float | None = None,
    height_std_mm: float = float("nan"),
    name: str = "points",
) -> Product:
    """Make a product of points, for any stage that measures one: volume, weigher, classifier, grader.

    Parameters
    ----------
    points_mm
        Slices, each (n, 3): X, Y and Z of the points along one section, mm, in any order; sections run along
        Y, Z is the height over the belt (Z = 0). Or one cloud, (n, 3), which is cut into slices of `slice_mm`
        along X. All points are taken for the product: leave the belt's out. Each point stands for its part of
        the section: half the way to its neighbours, and as far outwards at both ends.
    slice_mm
        Thickness of a cloud's slices; only with a cloud.
    height_std_mm
        Standard uncertainty of single heights; NaN where it is not known.
    name
        What to call the acquisition.

    Returns
    -------
    Product
        Without view and outline: estimators that need an outline work from the slices alone.

    Raises
    ------
    DataError
        Fewer than three points in a slice, an array of another shape or with numbers that are not finite, or
        points that lie in no section along Y.

    Examples
    --------
    >>> import numpy as np, roemetry
    >>> y = np.linspace(-19.75, 19.75, 80)
    >>> slices = [np.column_stack([np.full(80, x), y, np.full(80, 10.0)]) for x in range(0, 65, 5)]
    >>> product = roemetry.product_from_points(slices)
    >>> volume = roemetry.make_stage("volume", "slice-pchip", ends="none").estimate(product)
    >>> print(f"{volume.visible_mm3.value / 1000:.1f} cm³")
    24.0 cm³
    """
    slices = _slices(points_mm, slice_mm)
    order = np.argsort([float(one[:, 0].mean()) for one in slices], kind="stable")
    slices = [one[np.argsort(-one[:, 1], kind="stable")] for one in (slices[k] for k in order)]
    count, longest = len(slices), max(map(len, slices))
    xyz = np.full((count, longest, 3), np.nan)
    for k, one in enumerate(slices):
        xyz[k, : len(one)] = one
    there = np.isfinite(xyz[..., 2])
    row = np.where(there, np.arange(longest) + float(_ROWS_BESIDE), np.nan)
    profiles = Profiles(
        xyz_mm=xyz,
        product=np.where(there, 1, -1).astype(np.int16),
        seen=there,
        x_px=np.where(there, np.arange(count)[:, None].astype(np.float64), np.nan),
        row_px=row,
        height_std_mm=np.where(there, height_std_mm, np.nan),
        stripe=np.arange(count),
        frame=np.zeros(count, np.int64),
        plane=np.array([_plane(one, k) for k, one in enumerate(slices)]),
    )
    calibration = Calibration(
        method="points",
        image_size=(longest + 2 * _ROWS_BESIDE, count),
        turn_deg=0,
        rest_px=np.arange(count, dtype=np.float64)[:, None],
        displacement_px_per_mm=np.ones(count),
        height_range_mm=(0.0, max(0.0, float(np.nanmax(xyz[..., 2])))),
        parameters={},
        covariance=np.zeros((0, 0)),
    )
    return Product(1, profiles, calibration, (name,))


def _slices(points_mm: object, slice_mm: float | None) -> list[Floats]:
    cloud = isinstance(points_mm, np.ndarray) and points_mm.ndim == 2
    if cloud != (slice_mm is not None):
        raise DataError(
            "one array (n, 3) is a cloud" if cloud else "slice_mm was given with slices",
            hint="a cloud needs slice_mm, the thickness of the slices it is cut into; slices need none",
        )
    given = [points_mm] if cloud else list(points_mm)  # type: ignore[call-overload]
    found = []
    for number, one in enumerate(given):
        array = np.asarray(one, np.float64)
        if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
            raise DataError(
                f"slice {number + 1} has shape {array.shape}, expected (points, 3) finite numbers",
                hint="leave out what was not seen: NaN is no point",
            )
        if len(array) < _POINTS_MIN:
            raise DataError(f"slice {number + 1} has {len(array)} points, expected {_POINTS_MIN} or more")
        found.append(array)
    return found if slice_mm is None else _cut(found[0], slice_mm)


def _cut(cloud: Floats, slice_mm: float) -> list[Floats]:
    """Cut a cloud into slices across X; in each, the median height of the points close together along Y."""
    if not slice_mm > 0.0:
        raise DataError(f"slice_mm is {slice_mm:g}, expected more than 0")
    low = float(cloud[:, 0].min())
    slab = np.floor((cloud[:, 0] - low) / slice_mm).astype(np.int64)
    found = []
    for number in np.unique(slab):
        mine = cloud[slab == number]
        cell = np.floor(mine[:, 1] * (_SAMPLES / slice_mm)).astype(np.int64)
        centre = low + (number + 0.5) * slice_mm
        points = [(centre, *np.median(mine[cell == one, 1:], axis=0)) for one in np.unique(cell)]
        if len(points) >= _POINTS_MIN:
            found.append(np.array(points))
    if not found:
        raise DataError(
            f"no slice of {slice_mm:g} mm holds points at three places along Y",
            hint="is X across the slices, and are lengths in mm?",
        )
    return found


def _plane(points: Floats, number: int) -> Floats:
    """Fit X = a + b·Y + c·Z: a section that runs along Y; give its normal and distance (4,)."""
    design = np.column_stack([np.ones(len(points)), points[:, 1:]])
    a, b, c = np.linalg.lstsq(design, points[:, 0], rcond=None)[0].tolist()
    off_mm = float(np.sqrt(np.mean((points[:, 0] - design @ [a, b, c]) ** 2)))
    if off_mm > _OFF_PLANE_MM or abs(b) > 1.0:
        raise DataError(
            f"slice {number + 1} is no section along Y: its points lie {off_mm:.2g} mm (rms) off a plane"
            + (f" that runs {abs(b):.1f} mm along X for each along Y" if abs(b) > 1.0 else ""),
            hint="give a section at a time, with Y along it; or one cloud with slice_mm",
        )
    size = float(np.sqrt(1.0 + b * b + c * c))
    return np.array([1.0, -b, -c, a]) / size
