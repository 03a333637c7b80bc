"""What a rig does to a height, and how well a stripe's place can be known in one image row.

Every function of geometry takes belt-frame points (mm) and works on the fan's own plane through each of them:
the one that holds the projector and the lines' common axis. So a map over the volume needs no stripe to be
there. What light and sensor allow follows from the simulator's own model of both (`roemetry_simulate.render`)
by the Cramér-Rao bound, and for the centre of gravity by propagation of the same noise. It holds for level,
matt surfaces and stripes that do not overlap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.optics import Camera, LaserFan, blur_sigma_px
from roemetry_simulate.render import Rig, Sensor

Floats = NDArray[np.float64]

_RELATIVE_STEP = 3e-5
"""Of the depth: half of the central differences, whose error is about its square, 1e-9."""
_RANGE_STEPS = 4001
"""Heights that are tried: the highest in view is right to 1/4000."""


@dataclass(frozen=True, eq=False)
class Scale:
    """How belt-frame millimetres become pixels at points of one shape S.

    - `x_mm_per_px`, `y_mm_per_px`, shape S: On a level surface, for one pixel along the image row and along
      the column, mm.
    - `height_px_per_mm`, shape S: Displacement of the stripe along its image row for one millimetre of
      height; signed.
    - `across_mm_per_px`, shape S: Distance from the light plane, along its normal, for one pixel along the
      row on a level surface, mm.
    """

    x_mm_per_px: Floats
    y_mm_per_px: Floats
    height_px_per_mm: Floats
    across_mm_per_px: Floats


def scale_at(camera: Camera, fan: LaserFan, points_mm: Floats) -> Scale:
    """Return the local scales of projection at belt-frame points (mm), shape S + (3,).

    From central differences of the camera's full model (distortion too). With (u, v) the image point and n
    the light plane's normal, a step dz within the plane and within the row (dv = 0) moves the stripe by
    du/dz = U_z − U_y V_z / V_y, where U and V are derivatives along the plane. For a camera that looks
    straight down from height H with focal length f (px) and a projector at the same height and distance B
    beside it, this is f B / (H − z)².
    """
    # a step in proportion to the depth moves every place by about as much in the image
    depth = (points_mm - camera.centre_mm) @ camera.rotation[:, 2]
    step = _RELATIVE_STEP * depth[..., None]
    gradient = []
    for axis in np.eye(3):
        change = camera.project(points_mm + step * axis) - camera.project(points_mm - step * axis)
        gradient.append(change / (2.0 * step))
    # derivatives of image x and y by X, Y, Z
    (ux, vx), (uy, vy), (uz, vz) = ((g[..., 0], g[..., 1]) for g in gradient)
    n = plane_normals(fan, points_mm)
    # along the plane a step in Y or Z brings one in X with it: n·dX = 0
    ny, nz = n[..., 1] / n[..., 0], n[..., 2] / n[..., 0]
    along_y, row_y = uy - ux * ny, vy - vx * ny
    along_z, row_z = uz - ux * nz, vz - vx * nz
    # determinant of the level derivatives: mm² for a pixel²
    area = ux * vy - uy * vx
    return Scale(
        np.hypot(vy, vx) / np.abs(area),
        np.hypot(uy, ux) / np.abs(area),
        # the row is kept: what Z moves the point down the image, Y moves it back
        along_z - along_y * row_z / row_y,
        np.abs((n[..., 0] * vy - n[..., 1] * vx) / area),
    )


def plane_normals(fan: LaserFan, points_mm: Floats) -> Floats:
    """Return unit normals, towards +X, of the fan's planes through points; shape of `points_mm`."""
    # the plane that holds the point, the projector and the lines' direction
    normals = np.cross(points_mm - fan.projector_mm, fan.line_axis)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    towards: Floats = normals * np.where(normals[..., :1] < 0.0, -1.0, 1.0)
    return towards


def middle_y_mm(camera: Camera) -> float:
    """Return the belt Y at which the plan is made: where the image's middle sees the belt."""
    ray = camera.ray(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1))
    return float(camera.centre_mm[1] - camera.centre_mm[2] / ray[2] * ray[1])


def plane_points(fan: LaserFan, y_mm: float, z_mm: Floats) -> Floats:
    """Return where N planes are at one belt Y and M heights, shape (M, N, 3), mm."""
    x = fan.x_mm(y_mm, z_mm)
    return np.stack([x, np.full_like(x, y_mm), np.broadcast_to(z_mm[:, None], x.shape)], axis=-1)


def in_view(camera: Camera, points_mm: Floats) -> NDArray[np.bool_]:
    """Say which points lie in the image."""
    pixels = camera.project(points_mm)
    size = np.array([camera.width_px, camera.height_px])
    with np.errstate(invalid="ignore"):
        inside = (pixels > -0.5) & (pixels < size - 0.5)
    return inside[..., 0] & inside[..., 1]


def highest_in_view_mm(camera: Camera, fan: LaserFan, y_mm: float) -> Floats:
    """Return for each plane the height (mm) up to which it stays in the image; NaN if not on the belt.

    At most 95 % of the way up to the lower one of camera and projector; found to 1/4000 of that.
    """
    ceiling = 0.95 * min(float(camera.centre_mm[2]), float(fan.projector_mm[2]))
    heights = np.linspace(0.0, ceiling, _RANGE_STEPS)
    seen = in_view(camera, plane_points(fan, y_mm, heights))
    # the first height at which it is out of view; one more row of False, so that one is always found
    leaves = np.argmin(np.vstack([seen, np.zeros((1, fan.count), dtype=bool)]), axis=0)
    return np.where(leaves > 0, heights[np.maximum(leaves, 1) - 1], np.nan)


def meeting_height_mm(
    camera: Camera, fan: LaserFan, own_x_mm: Floats, other_x_mm: Floats, y_mm: float
) -> Floats:
    """Return the height (mm) at which a stripe appears where another one lies on the belt.

    The camera's ray through the other stripe's place on the belt (its X at `y_mm`) meets the stripe's own
    plane there. For a camera straight above and a projector beside it at the same height H and distance B,
    two stripes a spacing s apart on the belt: s H / (B + s). NaN where they meet nowhere between belt and
    camera.
    """
    own, other = (np.stack([x, np.full_like(x, y_mm), np.zeros_like(x)], -1) for x in (own_x_mm, other_x_mm))
    normals = plane_normals(fan, own)
    ray = other - camera.centre_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        # along the ray to where it meets the plane, as a share of the way to the belt
        reach = np.sum(normals * (fan.projector_mm - camera.centre_mm), -1) / np.sum(normals * ray, -1)
    height = camera.centre_mm[2] + reach * ray[..., 2]
    return np.where((height > 0.0) & (height < camera.centre_mm[2]), height, np.nan)


def spacing_heights_mm(camera: Camera, fan: LaserFan, y_mm: float) -> Floats:
    """Return for each stripe the height at which it appears on its neighbour's place on the belt.

    Below it, order alone tells the stripes apart even in a row that shows one of them. Shape (N,), mm; NaN
    for the last one on the side that heights displace to.
    """
    x = fan.x_mm(y_mm, 0.0)
    found = np.full(fan.count, np.nan)
    if fan.count > 1:
        up = meeting_height_mm(camera, fan, x[:-1], x[1:], y_mm)
        down = meeting_height_mm(camera, fan, x[1:], x[:-1], y_mm)
        # each stripe's neighbour on one side and on the other; the lower height counts
        found[:-1] = up
        found[1:] = np.fmin(found[1:], down)
    return found


def steepest_slopes_deg(camera: Camera, fan: LaserFan, points_mm: Floats) -> Floats:
    """Return the steepest slopes (degrees) still lit and seen at points, shape S + (3,): shape S + (4,).

    For surfaces that rise towards +X, −X, +Y, −Y; 90 where a wall is lit and seen. A surface that rises by
    the angle α towards a unit direction e on the belt has the normal (−e sin α, cos α); it faces a place
    that lies in the direction (h, z) from it while tan α < z / (h · e), and always where h · e ≤ 0. Both
    the projector and the camera must be faced. Holds for a slope by itself; what stands beside it may shade
    it as well.
    """
    limits = []
    for place in (camera.centre_mm, fan.projector_mm):
        to = place - points_mm
        towards = np.stack([to[..., 0], -to[..., 0], to[..., 1], -to[..., 1]], axis=-1)
        # direction of a wall's top edge over the place: arctan of height over distance; 90° where it is
        # behind
        limits.append(np.rad2deg(np.arctan2(to[..., 2:], np.maximum(towards, 0.0))))
    return np.minimum(limits[0], limits[1])


WINDOW_SIGMAS = 3.0
"""The centre of gravity counts pixels this many standard deviations to both sides."""

_REACH_SIGMAS = 5.0
"""Half of the row that is looked at; beyond it a Gaussian holds 6e-7 of its light."""
_NO_INFORMATION = 1e12
"""Variance (grey levels²) of a saturated pixel: it tells nothing."""
_WIDEST_PX = 100.0
"""A wider stripe would need matrices of more than a thousand pixels, and is of no use."""


@dataclass(frozen=True, eq=False)
class Stripe:
    """A stripe on a level surface as its image row has it.

    - `peak_grey`: Light in its middle before any blur, grey levels.
    - `line_sigma_px`: Standard deviation of the light's profile on the sensor before any blur.
    - `defocus_sigma_px`: Blur of the lens at this depth.
    - `background_grey`: Light beside it.
    """

    peak_grey: float
    line_sigma_px: float
    defocus_sigma_px: float
    background_grey: float

    def width_px(self, sensor: Sensor) -> float:
        """Return the standard deviation in the image."""
        return math.sqrt(self.line_sigma_px**2 + self.defocus_sigma_px**2 + sensor.psf_sigma_px**2)


@dataclass(frozen=True)
class PeakStd:
    """Standard uncertainties of a stripe's place in one row, px.

    - `bound_px`: Cramér-Rao bound with shot noise, read noise, rounding and speckle.
    - `noise_bound_px`: The same without speckle.
    - `centre_of_gravity_px`: Of the centre of gravity, all of that counted.
    - `peak_grey`: Highest grey level of the mean image, black level counted.
    - `is_saturated`: Whether the sensor's white or its full well cuts the stripe.
    """

    bound_px: float
    noise_bound_px: float
    centre_of_gravity_px: float
    peak_grey: float
    is_saturated: bool


def stripes_at(rig: Rig, points_mm: Floats, albedo: float, peak_grey: Floats) -> list[Stripe]:
    """Return the stripes that level, matt surfaces of an albedo show at belt-frame points, shape (n, 3), mm.

    The light's width on the sensor is its width across the plane over the millimetres across the plane that
    a pixel steps; its brightness (`peak_grey`, shape (n,), as `LaserFan` has it) falls with its growth in
    width, with the angle along the line and with the cosine at which it comes in. This is the simulator's
    own model of light; gloss and light from below the surface are left out.
    """
    fan = rig.laser
    beam = fan.projector_mm - points_mm
    away = np.linalg.norm(beam, axis=-1)
    beam = beam / away[:, None]
    # Gaussian beam: the deviation at the distance of the point
    sigma = np.hypot(fan.sigma_mm, 1e-3 * fan.divergence_mrad * (away - fan.waist_distance_mm))
    angle = np.rad2deg(np.arcsin(np.clip(-beam @ fan.line_axis, -1.0, 1.0))) / fan.line_sigma_deg
    # brightness falls with width, along the line, and with the angle at which light comes in
    grey = peak_grey * fan.sigma_mm / sigma * np.exp(-0.5 * angle**2) * albedo * beam[:, 2]
    # across the plane in mm, over mm across the plane for a pixel
    width = sigma / scale_at(rig.camera, fan, points_mm).across_mm_per_px
    defocus = defocus_px(rig, points_mm)
    return [
        Stripe(float(g), float(w), float(d), rig.ambient_grey * albedo)
        for g, w, d in zip(grey, width, defocus, strict=True)
    ]


def defocus_px(rig: Rig, points_mm: Floats) -> Floats:
    """Return the lens's blur at points (standard deviation, px); 0 where the scene gives no aperture."""
    depth = (points_mm - rig.camera.centre_mm) @ rig.camera.rotation[:, 2]
    return np.zeros_like(depth) if rig.focus is None else blur_sigma_px(rig.camera, rig.focus, depth)


def peak_std(stripe: Stripe, sensor: Sensor, phase_px: float = 0.2) -> PeakStd:
    """Return how well one row tells a stripe's place, its middle `phase_px` off a pixel's.

    The mean image is a pixel-integrated Gaussian, blurred as the sensor blurs it; unknown are its centre,
    height, width and background. With J the derivatives by these four and Σ the covariance of the pixels,
    the bound is the root of the first element of (Jᵀ Σ⁻¹ J)⁻¹ (Cramér-Rao). Σ holds shot noise (gain ·
    light), read noise, rounding (1/12) and speckle: contrast² · m mᵀ times the correlation of the grain,
    blurred along the row and averaged over the rows the blur mixes. The centre of gravity over ± 3 standard
    deviations, background known, has the variance wᵀ Σ w with w = (position − centre) / sum of light.
    Saturated pixels carry no information to the bound, and no noise to the centre of gravity. Neighbouring
    rows share speckle grains, so the mean of n rows gains less than √n.

    NaN for a stripe whose pixels do not tell four unknowns, that is wider than 100 px, or dead.
    """
    width = stripe.width_px(sensor)
    # no four unknowns from so little, or matrices too large
    if not (width < _WIDEST_PX and stripe.peak_grey > 0.0):
        return PeakStd(math.nan, math.nan, math.nan, math.nan, False)
    reach = max(math.ceil(_REACH_SIGMAS * width), 6)
    at = np.arange(-reach, reach + 1, dtype=np.float64) - np.float64(phase_px)
    # lens and sensor blur one after the other, each a matrix over the row
    blur = _filter(at.size, stripe.defocus_sigma_px) @ _filter(at.size, sensor.psf_sigma_px)
    sharp, by_centre, by_width = _profile(at, max(stripe.line_sigma_px, 1e-3))
    # derivatives by centre, height, width and background
    jacobian = np.column_stack(
        [
            stripe.peak_grey * blur @ by_centre,
            blur @ sharp,
            stripe.peak_grey * blur @ by_width,
            np.ones_like(at),
        ]
    )
    light = stripe.peak_grey * blur @ sharp
    noise = (
        # shot noise has the variance gain · light; rounding that of a uniform distribution
        sensor.grey_per_electron * (light + stripe.background_grey) + sensor.read_noise_grey**2 + 1.0 / 12.0
    )
    speckle = _speckle(stripe.peak_grey * sharp, blur, stripe, sensor)

    # white, or a well that is full before it
    white = min(
        2.0**sensor.bit_depth - 1.0, sensor.full_well_e * sensor.grey_per_electron + sensor.black_level_grey
    )
    grey = light + stripe.background_grey + sensor.black_level_grey
    # within half a grey level of white a pixel tells nothing
    lost = grey > white - 0.5
    covariance = np.diag(np.where(lost, _NO_INFORMATION, noise))
    kept = np.where(np.logical_or.outer(lost, lost), 0.0, 1.0)
    bound = _bound(jacobian, covariance + speckle * kept)

    # whole pixels, as a program would count them
    window = np.abs(np.arange(-reach, reach + 1)) <= math.ceil(WINDOW_SIGMAS * width)
    clipped = np.where(
        window, np.minimum(light, white - stripe.background_grey - sensor.black_level_grey), 0.0
    )
    # derivative of the centre of gravity by each pixel
    weight = np.where(window & ~lost, at - (at @ clipped) / clipped.sum(), 0.0) / clipped.sum()
    variance = weight @ (np.diag(noise) + speckle) @ weight
    return PeakStd(
        bound, _bound(jacobian, covariance), float(np.sqrt(variance)), float(grey.max()), bool(lost.any())
    )


def speckle_limit_px(rig: Rig, wavelength_nm: float, contrast: float) -> float:
    """Return the speckle limit of a stripe's place; NaN where the scene gives no aperture.

    contrast · λ / (2π sin u), in the image, with sin u = 1 / (2 N (1 + magnification)) for the f-number N
    (Dorsch, Häusler, Herrmann 1994). For a line as fine as the lens resolves; a wider one does worse, and
    averaging along the line is not counted.
    """
    if rig.focus is None:
        return math.nan
    focal_mm = rig.camera.focal_length_mm
    magnification = focal_mm / (rig.focus.distance_mm - focal_mm)
    # half the opening angle in the image: aperture over twice the image distance
    sine = 1.0 / (2.0 * rig.focus.f_number * (1.0 + magnification))
    return contrast * 1e-6 * wavelength_nm / (2.0 * math.pi * sine) / rig.camera.pixel_size_mm


def _profile(at: Floats, sigma: float) -> tuple[Floats, Floats, Floats]:
    """Pixel-integrated Gaussian of height 1, and its derivatives by centre and by sigma."""
    from scipy.special import erf

    # a pixel's own integral, not its middle: stripes may be narrower than a pixel
    high, low = (at + 0.5) / sigma, (at - 0.5) / sigma
    g_high, g_low = np.exp(-0.5 * high**2), np.exp(-0.5 * low**2)
    profile: Floats = sigma * math.sqrt(math.pi / 2.0) * (erf(high / math.sqrt(2)) - erf(low / math.sqrt(2)))
    return profile, g_low - g_high, profile / sigma - (high * g_high - low * g_low)


def _filter(count: int, sigma: float) -> Floats:
    """The Gaussian filter of a row as a matrix, shape (count, count)."""
    if sigma <= 0.0:
        return np.eye(count)
    from scipy.ndimage import gaussian_filter1d

    # the filter of each unit vector, column by column
    matrix: Floats = gaussian_filter1d(np.eye(count), sigma, axis=0, mode="constant")
    return matrix


def _speckle(light: Floats, blur: Floats, stripe: Stripe, sensor: Sensor) -> Floats:
    """Covariance of the speckle along a row, from the light before the blur."""
    if sensor.speckle_contrast <= 0.0:
        return np.zeros((light.size, light.size))
    grain = _grain(light.size, sensor.speckle_sigma_px)
    # rows that the blur mixes, either way, four deviations far
    tall = 2 * math.ceil(4.0 * (stripe.defocus_sigma_px + sensor.psf_sigma_px) + 2.0) + 1
    rows = (_filter(tall, stripe.defocus_sigma_px) @ _filter(tall, sensor.psf_sigma_px))[tall // 2]
    # of the mean over those rows, so much of the grain's variance is left
    mixed = float(rows @ _grain(tall, sensor.speckle_sigma_px) @ rows)
    spread = blur * light
    covariance: Floats = sensor.speckle_contrast**2 * mixed * spread @ grain @ spread.T
    return covariance


def _grain(count: int, sigma: float) -> Floats:
    """Correlation of the speckle between the pixels of a row, shape (count, count)."""
    if sigma <= 0.0:
        return np.eye(count)
    pad = math.ceil(8.0 * sigma) + 1
    filtered = _filter(2 * pad + 1, sigma)[pad]
    # correlation of filtered white noise: the filter with itself
    correlation = np.convolve(filtered, filtered)
    correlation /= correlation.max()
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    table = np.zeros(max(count, 2 * pad + 1))
    table[: 2 * pad + 1] = correlation[2 * pad :]
    return table[apart]


def _bound(jacobian: Floats, covariance: Floats) -> float:
    # the information matrix (Fisher); its inverse is the bound
    information = jacobian.T @ np.linalg.solve(covariance, jacobian)
    # pixels do not tell the four apart
    if not np.isfinite(information).all() or np.linalg.cond(information) > 1e15:
        return math.nan
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))
