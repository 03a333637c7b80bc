"""Products on unseen rigs: from exact truth without rendering, and from rendered images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from roemetry.config.scene import Scene
from roemetry.errors import RoemetryError
from roemetry.records import NOTHING, Frame, Outline, Product, Profiles, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.records.view import View
from roemetry.run.open_parts import SHARE_MAX, open_parts, split_products
from roemetry_kernels.compiling import kernel
from roemetry_paper.window_tracking import WindowTracking
from roemetry_peaks.maximum_likelihood import MaximumLikelihood
from roemetry_simulate import scene as scene_rig
from roemetry_simulate.optics import Camera, LaserFan, camera_ray, fan_through, looking_down
from roemetry_simulate.population import in_reach
from roemetry_simulate.products import PRODUCTS, Drawn
from roemetry_simulate.raycast import hit_body
from roemetry_simulate.render import Rig, Sensor, render
from roemetry_simulate.solid import Solid
from roemetry_simulate.truth import StripeTruth, stripe_centres
from roemetry_volume.edge_contour import EdgeContour, EdgeContourOptions

HERRING_ROE = Path(__file__).parents[1] / "recipes" / "herring_roe"

Floats = NDArray[np.float64]

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

    Attributes
    ----------
    product : Product
        With outline and view.
    visible_mm3, true_mm3 : float
        The answer.
    figures : mapping
        What the product's family says of it.
    defect : str
        Its defect.
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
    """Return a rig: seed 0 is the herring roe rig, any other is drawn about it.

    Parameters
    ----------
    seed : int
        0, or what the rig is drawn from: distance, focal length, tilts, projector on either side, fan.
    stripes : int
        Number of planes, over the same 87.5 mm.
    """
    rng = np.random.default_rng([seed, 41])
    if seed == 0:
        shipped = scene_rig.rig_of(Scene.load(HERRING_ROE).simulator.options)  # type: ignore[arg-type]
        fan = _fan((160.0, -4.0, 300.0), stripes, -3.0, 0.6, 0.3)
        return shipped if stripes == 11 else replace(shipped, laser=fan)
    between = rng.uniform
    distance = between(270.0, 420.0)
    camera = looking_down(
        640,
        480,
        pixel_size_mm=0.01,
        focal_length_mm=0.05 * distance,
        distance_mm=distance,
        tilt_x_deg=between(-2.0, 2.0),
        tilt_y_deg=between(-2.0, 2.0),
    )
    side = rng.choice([-1.0, 1.0])
    place = (side * between(130.0, 190.0), between(-15.0, 15.0), between(260.0, 360.0))
    laser = _fan(place, stripes, -side * between(0.0, 5.0), between(-1.5, 1.5), between(-0.5, 0.5))
    return Rig(camera, Sensor(), laser)


def _fan(
    place: tuple[float, float, float], stripes: int, middle_mm: float, yaw_deg: float, pitch_deg: float
) -> LaserFan:
    feet = middle_mm + _REACH_MM * np.linspace(-0.5, 0.5, stripes)
    return fan_through(place, feet, yaw_deg=yaw_deg, pitch_deg=pitch_deg, sigma_mm=0.31, peak_grey=370.0)


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
    count = rig.laser.count
    return Calibration(
        method="exact",
        image_size=(rows, rig.camera.width_px),
        turn_deg=0,
        rest_px=np.array(rest),
        displacement_px_per_mm=np.array(slope),
        height_range_mm=(0.0, 30.0),
        parameters={"stripes": np.array([float(count)])},
        covariance=np.zeros((1, 1)),
        view=view,
    )


def exact(rig: Rig, solid: Solid) -> Exact:
    """Trace the stripes and the silhouette of a product."""
    truth = stripe_centres(rig.camera, rig.laser, solid, step_px=1.0)
    calibration = calibration_of(rig)
    product = Product(
        number=1,
        profiles=profiles_of(truth, calibration.view),
        calibration=calibration,
        acquisition_ids=("exact",),
        outline=Outline(1, silhouette(rig.camera, solid), 0.0),
        view=calibration.view,
    )
    return Exact(product, solid.visible_volume_mm3, solid.true_volume_mm3)


def profiles_of(truth: StripeTruth, view: View | None) -> Profiles:
    """Return the true points of the product as slices; belt points are left out."""
    assert view is not None
    mine = (truth.on_product == 1) & np.isfinite(truth.x_px)
    stripes, rows = mine.shape
    row_px = np.broadcast_to(np.arange(rows, dtype=np.float64), mine.shape)
    return Profiles(
        xyz_mm=np.where(mine[..., None], truth.xyz_mm, np.nan),
        product=np.where(mine, 1, NOTHING),
        seen=mine,
        x_px=np.where(mine, truth.x_px, np.nan),
        row_px=np.where(mine, row_px, np.nan),
        height_std_mm=np.full(mine.shape, np.nan),
        stripe=np.arange(stripes),
        frame=np.zeros(stripes, np.int64),
        plane=view.planes.copy(),
    )


def silhouette(camera: Camera, solid: Solid, points: int = 400) -> Floats:
    """Return the product's contour in the image, exact to a thousandth of a pixel, (points, 2) px."""
    import cv2

    body = solid.body()
    mask = _mask(body, camera.packed(), camera.rotation, (camera.height_px // 2, camera.width_px // 2))
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chain = 2.0 * max(found, key=len)[:, 0, :].astype(np.float64)
    return _refined(body, camera.packed(), camera.rotation, *_even(chain, points))


def _even(chain: Floats, points: int) -> tuple[Floats, Floats]:
    """Resample a closed chain evenly after light smoothing; also outward normals."""
    from scipy.ndimage import gaussian_filter1d

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
    view = calibration.view
    assert view is not None
    count, rows = stripes.x_px.shape
    row_px = np.broadcast_to(np.arange(rows, dtype=np.float64), stripes.x_px.shape)
    number = np.broadcast_to(np.arange(count)[:, None], stripes.x_px.shape)
    return Profiles(
        xyz_mm=view.lift(np.stack([stripes.x_px, row_px], axis=-1), number),
        product=stripes.product,
        seen=stripes.seen,
        x_px=stripes.x_px,
        row_px=row_px,
        height_std_mm=np.full(stripes.x_px.shape, np.nan),
        stripe=np.arange(count),
        frame=np.zeros(count, np.int64),
        plane=view.planes.copy(),
    )


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
