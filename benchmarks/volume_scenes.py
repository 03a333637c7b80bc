"""Products on unseen rigs: traced exactly, of either simulator, and from rendered images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from roemetry.config.scene import Scene
from roemetry.config.target_file import SpherePlateFile, read_sphere_plate, read_target
from roemetry.errors import RoemetryError
from roemetry.io.files import shipped
from roemetry.records import NOTHING, Frame, Outline, Product, Profiles, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.observations import SpherePlate
from roemetry.records.view import View
from roemetry.run.open_parts import SHARE_MAX, open_parts, split_products
from roemetry.targets.solids import solid_triangles
from roemetry_kernels.compiling import kernel
from roemetry_mitsuba.bodies import Body
from roemetry_mitsuba.products import FAMILIES
from roemetry_paper.window_tracking import WindowTracking
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_simulate import scene as scene_rig
from roemetry_simulate.optics import Camera, LaserFan, camera_ray, fan_through, looking_down
from roemetry_simulate.population import in_reach
from roemetry_simulate.products import PRODUCTS, Drawn
from roemetry_simulate.products.mesh import Triangles, close
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.raycast import hit_body
from roemetry_simulate.render import Rig, Sensor, render
from roemetry_simulate.solid import Solid
from roemetry_volume.edge_contour import EdgeContour, EdgeContourOptions

HERRING_ROE = Path(__file__).parents[1] / "recipes" / "herring_roe"

_REACH_MM = 87.5


class HasLight(Protocol):
    """A camera and its planes of light."""

    @property
    def camera(self) -> Camera: ...  # noqa: D102
    @property
    def laser(self) -> LaserFan: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Exact:
    """What a perfect extractor, coder, triangulator and outliner would give, and what is true.

    `product` has an outline and a view; `figures` and `defect` are what the product's family says of it.
    """

    product: Product
    visible_mm3: float
    true_mm3: float
    figures: Mapping[str, float] = field(default_factory=dict)
    defect: str = "none"


def skein(seed: int, stripes: int = 11) -> tuple[Rig, Drawn]:
    """Draw a skein and the rig of the same seed, and keep it within 1.2 spacings of eleven stripes."""
    rig, family = rig_of(seed, stripes), PRODUCTS["herring-roe"]
    return rig, in_reach(family.draw(seed, family.Options()), rig_of(seed, 11), 1.2)


def exact_skein(seed: int, stripes: int = 11) -> Exact:
    """Trace a skein on the rig of the same seed."""
    rig, drawn = skein(seed, stripes)
    return replace(exact(rig, drawn.solid), figures=drawn.truth.figures, defect=drawn.truth.defect)


def thinned(one: Exact, step: int) -> Exact:
    """Keep every so many of the stripes."""
    profiles = one.product.profiles
    names = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm", "frame", "plane")
    kept = {name: getattr(profiles, name)[::step] for name in names}
    count = np.arange(kept["frame"].size)
    return replace(one, product=replace(one.product, profiles=replace(profiles, stripe=count, **kept)))


def rig_of(seed: int, stripes: int = 11) -> Rig:
    """Return a rig of so many planes over 87.5 mm: seed 0 is the herring roe rig, others are drawn about it.

    Drawn are distance, focal length, tilts, projector on either side, fan.
    """
    rng = np.random.default_rng([seed, 41])
    if seed == 0:
        shipped = scene_rig.rig_of(Scene.load(HERRING_ROE).simulator.options)  # type: ignore[arg-type]
        fan = _fan((160.0, -4.0, 300.0), stripes, -3.0, 0.6, 0.3)
        return shipped if stripes == 11 else replace(shipped, laser=fan)
    between = rng.uniform
    distance = between(270.0, 420.0)
    camera = looking_down(
        640, 480, pixel_size_mm=0.01, focal_length_mm=0.05 * distance, distance_mm=distance,
        tilt_x_deg=between(-2.0, 2.0), tilt_y_deg=between(-2.0, 2.0),
    )  # fmt: skip
    side = rng.choice([-1.0, 1.0])
    place = (side * between(130.0, 190.0), between(-15.0, 15.0), between(260.0, 360.0))
    laser = _fan(place, stripes, -side * between(0.0, 5.0), between(-1.5, 1.5), between(-0.5, 0.5))
    return Rig(camera, Sensor(), laser)


def _fan(
    place: tuple[float, float, float], stripes: int, middle_mm: float, yaw_deg: float, pitch_deg: float
) -> LaserFan:
    lines_x = middle_mm + _REACH_MM * np.linspace(-0.5, 0.5, stripes)
    return fan_through(place, lines_x, yaw_deg=yaw_deg, pitch_deg=pitch_deg, sigma_mm=0.31, peak_grey=370.0)


def view_of(rig: HasLight) -> View:
    """Return the rig's geometry as the project's record of it."""
    camera = rig.camera
    f, (cx, cy) = camera.focal_length_px, camera.principal_px
    return View(
        image_size=(camera.height_px, camera.width_px),
        camera_matrix=np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]]),
        T_belt_camera=camera.T_belt_camera.copy(),
        planes=np.column_stack([rig.laser.normals, rig.laser.offsets_mm]),
        projector_mm=rig.laser.projector_mm.copy(),
    )


def calibration_of(rig: Rig) -> Calibration:
    """Return a calibration that carries the true view; its linear parameters are of belt level only."""
    view = view_of(rig)
    rows = rig.camera.height_px
    y_mm = np.linspace(-60.0, 60.0, 9)
    rest, slope = [], []
    for normal, offset in zip(rig.laser.normals, rig.laser.offsets_mm, strict=True):
        at = []
        for z in (0.0, 1.0):
            x = (offset - normal[1] * y_mm - normal[2] * z) / normal[0]
            seen = view.project(np.column_stack([x, y_mm, np.full_like(x, z)]))
            at.append(np.polynomial.polynomial.polyfit(seen[:, 1] - (rows - 1) / 2.0, seen[:, 0], 2))
        rest.append(at[0])
        slope.append(at[1][0] - at[0][0])
    return Calibration(
        method="exact", image_size=(rows, rig.camera.width_px), turn_deg=0, rest_px=np.array(rest),
        displacement_px_per_mm=np.array(slope), height_range_mm=(0.0, 30.0),
        parameters={"stripes": np.array([float(rig.laser.count)])}, covariance=np.zeros((1, 1)), view=view,
    )  # fmt: skip


def exact(rig: Rig, solid: Solid) -> Exact:
    """Trace the stripes and the silhouette of a product; belt points are left out."""
    truth, calibration = stripe_centres(rig.camera, rig.laser, solid, step_px=1.0), calibration_of(rig)
    assert calibration.view is not None
    mine = (truth.on_product == 1) & np.isfinite(truth.x_px)
    xyz_mm = np.where(mine[..., None], truth.xyz_mm, np.nan)
    profiles = profiles_of(np.where(mine, truth.x_px, np.nan), mine, xyz_mm, calibration.view)
    product = _product(profiles, silhouette(rig.camera, solid), calibration)
    return Exact(product, solid.visible_volume_mm3, solid.true_volume_mm3)


def _product(profiles: Profiles, contour_px: Floats, calibration: Calibration) -> Product:
    return Product(
        number=1, profiles=profiles, calibration=calibration, acquisition_ids=("exact",),
        outline=Outline(1, contour_px, 0.0), view=calibration.view,
    )  # fmt: skip


def profiles_of(
    x_px: Floats, on_product: Flags, xyz_mm: Floats, view: View, row_px: Floats | None = None
) -> Profiles:
    """Return (stripe, row) places as slices; what is not NaN was seen, on the product or on the belt.

    The rows of what was not seen are NaN, too, unless `row_px` gives them.
    """
    seen, (stripes, rows) = np.isfinite(x_px), x_px.shape
    if row_px is None:
        row_px = np.where(seen, np.arange(rows, dtype=np.float64), np.nan)
    return Profiles(
        xyz_mm=xyz_mm, product=np.where(seen, on_product.astype(np.int64), NOTHING), seen=seen, x_px=x_px,
        row_px=row_px, height_std_mm=np.full(x_px.shape, np.nan), stripe=np.arange(stripes),
        frame=np.zeros(stripes, np.int64), plane=view.planes.copy(),
    )  # fmt: skip


def sphere_plate() -> tuple[SpherePlate, Triangles]:
    """Return the shipped sphere plate, and its closed mesh."""
    path = shipped("calib_targets", "sphere-plate-3x2-30.yaml")
    described = read_target(path)
    assert isinstance(described, SpherePlateFile)
    plate = read_sphere_plate(described, path.parent)
    assert plate is not None
    corners = solid_triangles(described).reshape(-1, 3).round(9)
    points, number = np.unique(corners, axis=0, return_inverse=True)
    return plate, close(Triangles(points, number.reshape(-1, 3)))


def silhouette(camera: Camera, solid: Solid) -> Floats:
    """Return the product's contour in the image, exact to a thousandth of a pixel, (400, 2) px."""
    body = solid.body()
    mask = _mask(body, camera.packed(), camera.rotation, (camera.height_px // 2, camera.width_px // 2))
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chain = 2.0 * max(found, key=len)[:, 0, :].astype(np.float64)
    return _refined(body, camera.packed(), camera.rotation, *_even(chain, 400))


def _even(chain: Floats, points: int) -> tuple[Floats, Floats]:
    """Resample a closed chain evenly after light smoothing; also outward normals."""
    smooth = gaussian_filter1d(chain, 2.0, axis=0, mode="wrap")
    closed = np.vstack([smooth, smooth[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at = np.linspace(0.0, along[-1], points, endpoint=False)
    xy = np.column_stack([np.interp(at, along, closed[:, k]) for k in (0, 1)])
    tangent = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    area = 0.5 * np.sum(xy[:, 0] * np.roll(xy[:, 1], -1) - xy[:, 1] * np.roll(xy[:, 0], -1))
    normal *= np.sign(area) / np.hypot(*normal.T)[:, None]
    return xy, normal


def images(seed: int, cache: Path) -> tuple[Frame, Frame]:
    """Render a skein in laser and in plain light, or take both from the cache."""
    path = cache / f"{seed}_images.npz"
    if not path.exists():
        rig, drawn = skein(seed)
        scene = Scene.load(HERRING_ROE).simulator.options
        surface = scene_rig.surface_of(scene, seed)  # type: ignore[arg-type]
        kept = {
            name: render(rig, drawn.solid, surface, seed=seed, plain=name == "plain")
            for name in ("laser", "plain")
        }
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, **kept)
        part.replace(path)
    with np.load(path) as found:
        return Frame(found["laser"]), Frame(found["plain"], role="plain")


def measured(laser: Frame, plain: Frame, calibration: Calibration, outline: str) -> Product:
    """Take the images of one product through extraction, coding, true planes and outline."""
    peaks = MaximumLikelihood().extract(laser)
    stripes = WindowTracking().code(peaks, calibration)
    if any(part.share > SHARE_MAX for part in open_parts(peaks, stripes).values()):  # as a run has it
        raise RoemetryError("more than a third of the product's points could not be given to a stripe")
    outliner = EdgeContour(EdgeContourOptions(light="plain" if outline == "plain" else "laser"))
    contours = outliner.outline(laser, plain, stripes, calibration)
    found = split_products(
        lifted(stripes, calibration), contours, calibration, "images", view=calibration.view
    )
    if len(found) != 1:
        raise RoemetryError(f"{len(found)} products were found, expected 1")
    return found[0]


def lifted(stripes: StripeMap, calibration: Calibration) -> Profiles:
    """Meet the rays of labelled peaks with the true planes."""
    view, x_px = calibration.view, stripes.x_px
    assert view is not None
    row_px = np.broadcast_to(np.arange(x_px.shape[1], dtype=np.float64), x_px.shape)
    number = np.broadcast_to(np.arange(len(x_px))[:, None], x_px.shape)
    xyz_mm = view.lift(np.stack([x_px, row_px], axis=-1), number)
    found = profiles_of(x_px, stripes.product > 0, xyz_mm, view, row_px)
    return replace(found, product=stripes.product, seen=stripes.seen)


@kernel
def _is_hit(body, pinhole, rotation, x_px, y_px, view, tol_mm):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    camera_ray(pinhole, rotation, x_px, y_px, view)
    return hit_body(body, pinhole[:3], view, -pinhole[2] / view[2], tol_mm) >= 0.0


@kernel
def _mask(body, pinhole, rotation, shape):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    mask = np.zeros(shape, np.uint8)
    view = np.zeros(3)
    for row in range(shape[0]):
        for column in range(shape[1]):
            if _is_hit(body, pinhole, rotation, 2 * column, 2 * row, view, 1e-2):
                mask[row, column] = 1
    return mask


@kernel
def _refined(body, pinhole, rotation, xy, normal):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    out = np.empty_like(xy)
    view = np.zeros(3)
    for k in range(xy.shape[0]):
        low, high = -3.0, 3.0
        for _ in range(14):
            middle = 0.5 * (low + high)
            x, y = xy[k, 0] + middle * normal[k, 0], xy[k, 1] + middle * normal[k, 1]
            if _is_hit(body, pinhole, rotation, x, y, view, 1e-3):
                low = middle
            else:
                high = middle
        out[k, 0] = xy[k, 0] + low * normal[k, 0]
        out[k, 1] = xy[k, 1] + low * normal[k, 1]
    return out


# Bodies of the other simulator's families, meshes that the estimators were not developed on: what a plane of
# light and a line of sight meet is found by casting rays (Open3D).

_COLUMNS_PER_PX = 10
"""Of the lines of sight along a row: the surface is straight between two of them, to a micrometre."""
_SUBPIXELS = 8
"""Of the silhouette's mask; its smoothed contour is good to about 0.02 px."""
_JUMP_MM = 0.5
"""Two neighbouring lines of sight whose distances from the plane differ by more lie on two surfaces."""
_LIT_MM = 0.1
"""A ray of light that stops so much before the point is another surface's."""


class _Mesh:
    """A body for rays to hit."""

    def __init__(self, body: Body) -> None:
        import open3d as o3d

        self._tensor: Any = o3d.core.Tensor  # its stubs do not know that it takes arrays
        self._scene = o3d.t.geometry.RaycastingScene()
        points, faces = body.points_mm.astype(np.float32), body.faces.astype(np.uint32)
        self._scene.add_triangles(self._tensor(points), self._tensor(faces))

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
    mesh, seen = _Mesh(body), view.project(body.points_mm)
    low, high = np.floor(seen.min(axis=0) - 4.0).astype(int), np.ceil(seen.max(axis=0) + 5.0).astype(int)
    profiles, contour = _mesh_profiles(mesh, view, low, high), _mesh_silhouette(mesh, view, low, high)
    return Exact(_product(profiles, contour, calibration), body.visible_mm3, body.true_mm3)


def _sight(view: View, x_px: Floats, y_px: Floats) -> Floats:
    """Directions (rows, columns, 3) of the lines of sight through a grid of pixels, belt frame."""
    k, turn = view.camera_matrix, view.T_belt_camera[:3, :3]
    x, y = np.meshgrid((x_px - k[0, 2]) / k[0, 0], (y_px - k[1, 2]) / k[1, 1])
    directions: Floats = np.stack([x, y, np.ones_like(x)], axis=-1) @ turn.T
    return directions


def _mesh_silhouette(mesh: _Mesh, view: View, low: NDArray[np.int_], high: NDArray[np.int_]) -> Floats:
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


def _mesh_profiles(mesh: _Mesh, view: View, low: NDArray[np.int_], high: NDArray[np.int_]) -> Profiles:
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
    return profiles_of(column, np.isfinite(column), xyz, view)
