"""How well a stripe's place can be known in one image row: what light and sensor allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.defocus import Focus, blur_sigma_px
from roemetry_simulate.plan_geometry import scale_at
from roemetry_simulate.render import Rig
from roemetry_simulate.sensor import Sensor

Floats = NDArray[np.float64]

WINDOW_SIGMAS = 3.0
"""The centre of gravity counts pixels this many standard deviations to both sides."""

_REACH_SIGMAS = 5.0
_NO_INFORMATION = 1e12
_WIDEST_PX = 100.0


@dataclass(frozen=True, eq=False)
class Stripe:
    """A stripe on a level surface as its image row has it.

    Attributes
    ----------
    peak_grey : float
        Light in its middle before any blur, grey levels.
    line_sigma_px : float
        Standard deviation of the light's profile on the sensor before any blur.
    defocus_sigma_px : float
        Blur of the lens at this depth.
    background_grey : float
        Light beside it.
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

    Attributes
    ----------
    bound_px : float
        Cramér-Rao bound with shot noise, read noise, rounding and speckle.
    noise_bound_px : float
        The same without speckle.
    centre_of_gravity_px : float
        Of the centre of gravity, all of that counted.
    peak_grey : float
        Highest grey level of the mean image, black level counted.
    is_saturated : bool
        Whether the sensor's white or its full well cuts the stripe.
    """

    bound_px: float
    noise_bound_px: float
    centre_of_gravity_px: float
    peak_grey: float
    is_saturated: bool


def stripes_at(rig: Rig, points_mm: Floats, albedo: float, peak_grey: Floats) -> list[Stripe]:
    """Return the stripes that level, matt surfaces show.

    The light's width on the sensor is its width across the plane over the millimetres across the plane that
    a pixel steps; its brightness falls with its growth in width, with the angle along the line and with the
    cosine at which it comes in. This is the simulator's own model of light; gloss and light from below the
    surface are left out.

    Parameters
    ----------
    rig : Rig
        The rig.
    points_mm : ndarray, shape (n, 3)
        Belt frame.
    albedo : float
        Share of the laser's light that comes back.
    peak_grey : ndarray, shape (n,)
        Of the plane, as `LaserFan` has it.

    Returns
    -------
    list of Stripe
        One for each point.
    """
    fan = rig.laser
    beam = fan.projector_mm - points_mm
    away = np.linalg.norm(beam, axis=-1)
    beam = beam / away[:, None]
    sigma = np.hypot(fan.sigma_mm, 1e-3 * fan.divergence_mrad * (away - fan.waist_distance_mm))
    angle = np.rad2deg(np.arcsin(np.clip(-beam @ fan.line_axis, -1.0, 1.0))) / fan.line_sigma_deg
    grey = peak_grey * fan.sigma_mm / sigma * np.exp(-0.5 * angle**2) * albedo * beam[:, 2]
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
    """Return how well one row tells a stripe's place.

    The mean image is a pixel-integrated Gaussian, blurred as the sensor blurs it; unknown are its centre,
    height, width and background. With J the derivatives by these four and Σ the covariance of the pixels,
    the bound is the root of the first element of (Jᵀ Σ⁻¹ J)⁻¹ (Cramér-Rao). Σ holds shot noise
    (gain · light), read noise, rounding (1/12) and speckle: contrast² · m mᵀ times the correlation of the
    grain, blurred along the row and averaged over the rows the blur mixes. The centre of gravity over
    ± 3 standard deviations, background known, has the variance wᵀ Σ w with w = (position − centre) / sum of
    light. Saturated pixels carry no information to the bound, and no noise to the centre of gravity.

    Holds for one row; neighbouring rows share speckle grains, so the mean of n rows gains less than √n.

    Parameters
    ----------
    stripe : Stripe
        What is seen.
    sensor : Sensor
        Gain, noise, blur and speckle.
    phase_px : float
        Place of the stripe's middle within its pixel.

    Returns
    -------
    PeakStd
        NaN for a stripe whose pixels do not tell four unknowns, that is wider than 100 px, or dead.
    """
    width = stripe.width_px(sensor)
    if not (width < _WIDEST_PX and stripe.peak_grey > 0.0):
        return PeakStd(math.nan, math.nan, math.nan, math.nan, False)
    reach = max(math.ceil(_REACH_SIGMAS * width), 6)
    at = np.arange(-reach, reach + 1, dtype=np.float64) - np.float64(phase_px)
    blur = _filter(at.size, stripe.defocus_sigma_px) @ _filter(at.size, sensor.psf_sigma_px)
    sharp, by_centre, by_width = _profile(at, max(stripe.line_sigma_px, 1e-3))
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
        sensor.grey_per_electron * (light + stripe.background_grey) + sensor.read_noise_grey**2 + 1.0 / 12.0
    )
    speckle = _speckle(stripe.peak_grey * sharp, blur, stripe, sensor)

    white = min(
        2.0**sensor.bit_depth - 1.0, sensor.full_well_e * sensor.grey_per_electron + sensor.black_level_grey
    )
    grey = light + stripe.background_grey + sensor.black_level_grey
    lost = grey > white - 0.5
    covariance = np.diag(np.where(lost, _NO_INFORMATION, noise))
    kept = np.where(np.logical_or.outer(lost, lost), 0.0, 1.0)
    bound = _bound(jacobian, covariance + speckle * kept)

    window = np.abs(np.arange(-reach, reach + 1)) <= math.ceil(WINDOW_SIGMAS * width)
    clipped = np.where(
        window, np.minimum(light, white - stripe.background_grey - sensor.black_level_grey), 0.0
    )
    weight = np.where(window & ~lost, at - (at @ clipped) / clipped.sum(), 0.0) / clipped.sum()
    variance = weight @ (np.diag(noise) + speckle) @ weight
    return PeakStd(
        bound, _bound(jacobian, covariance), float(np.sqrt(variance)), float(grey.max()), bool(lost.any())
    )


def speckle_limit_px(
    focus: Focus, *, focal_length_mm: float, pixel_size_mm: float, wavelength_nm: float, contrast: float
) -> float:
    """Return the speckle limit of a stripe's place.

    contrast · λ / (2π sin u), in the image, with sin u = 1 / (2 N (1 + magnification)) for the f-number N
    (Dorsch, Häusler, Herrmann 1994). For a line as fine as the lens resolves; a wider one does worse, and
    averaging along the line is not counted.
    """
    magnification = focal_length_mm / (focus.distance_mm - focal_length_mm)
    sine = 1.0 / (2.0 * focus.f_number * (1.0 + magnification))
    return contrast * 1e-6 * wavelength_nm / (2.0 * math.pi * sine) / pixel_size_mm


def _profile(at: Floats, sigma: float) -> tuple[Floats, Floats, Floats]:
    """Pixel-integrated Gaussian of height 1, and its derivatives by centre and by sigma."""
    from scipy.special import erf

    high, low = (at + 0.5) / sigma, (at - 0.5) / sigma
    g_high, g_low = np.exp(-0.5 * high**2), np.exp(-0.5 * low**2)
    profile: Floats = sigma * math.sqrt(math.pi / 2.0) * (erf(high / math.sqrt(2)) - erf(low / math.sqrt(2)))
    return profile, g_low - g_high, profile / sigma - (high * g_high - low * g_low)


def _filter(count: int, sigma: float) -> Floats:
    """The Gaussian filter of a row as a matrix, shape (count, count)."""
    if sigma <= 0.0:
        return np.eye(count)
    from scipy.ndimage import gaussian_filter1d

    matrix: Floats = gaussian_filter1d(np.eye(count), sigma, axis=0, mode="constant")
    return matrix


def _speckle(light: Floats, blur: Floats, stripe: Stripe, sensor: Sensor) -> Floats:
    """Covariance of the speckle along a row, from the light before the blur."""
    if sensor.speckle_contrast <= 0.0:
        return np.zeros((light.size, light.size))
    grain = _grain(light.size, sensor.speckle_sigma_px)
    tall = 2 * math.ceil(4.0 * (stripe.defocus_sigma_px + sensor.psf_sigma_px) + 2.0) + 1
    rows = (_filter(tall, stripe.defocus_sigma_px) @ _filter(tall, sensor.psf_sigma_px))[tall // 2]
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
    correlation = np.convolve(filtered, filtered)
    correlation /= correlation.max()
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    table = np.zeros(max(count, 2 * pad + 1))
    table[: 2 * pad + 1] = correlation[2 * pad :]
    return table[apart]


def _bound(jacobian: Floats, covariance: Floats) -> float:
    information = jacobian.T @ np.linalg.solve(covariance, jacobian)
    if not np.isfinite(information).all() or np.linalg.cond(information) > 1e15:
        return math.nan
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))
