"""How surfaces send light on: GGX over a diffuse base, rough metal, and scattering inside the product.

A food's surface is a rough dielectric film (GGX with Smith's shadowing, Walter et al. 2007; exact Fresnel
equations at index 1.38) over a diffuse base. The base gets and gives what the film lets through, relative to
light straight down, so that a level surface seen from above has the albedo told. A metal reflects by the
conductor's Fresnel equations alone, with indices at 650 nm. Glossy rays are drawn from the visible normals
(Dupuy and Benyoub 2023), so a ray weighs F·G₂/G₁ ≤ 1 and no single ray stands out.

Mitsuba's own materials compute the same, but their minima and maxima cannot be compiled by LLVM 15 (the
process aborts), which many systems still ship; here nothing needs more than comparisons.

Light that goes into a translucent product comes out beside the stripe by the classical dipole (Farrell,
Patterson, Wilson 1992; Jensen et al. 2001), gathered over the stripe.
Each thin beam of a laser sheet enters at P, is refracted, and stands for one isotropic source a transport
mean free path ℓ along the refracted beam, and its negative mirror image above the surface at the height
4 A D + ℓ, with D = ℓ/3 and A from the index 1.38 of watery tissue. A point X of the surface gives back

    R(X) = [z_r (1 + σ d_r) e^(−σ d_r) / d_r³ + z_v (1 + σ d_v) e^(−σ d_v) / d_v³] / (4π),

d_r and d_v its distances from source and image, straight through space. As the source lies along the
refracted beam, light is displaced away from the projector, and a stripe is lopsided beside an edge.
Beams are cast from the projector 0.15 mm apart along each plane and at three Gauss–Hermite nodes across, so
the gathered light has no Monte Carlo noise. R is scaled so that a level surface gives back all that is told.

Assumes homogeneous tissue, and a surface flat over a few ℓ about the point of entry; single scattering and
light that crosses a thin edge and leaves it again are not modelled. ℓ and the spread σ follow from the
scene's `depth_mm` and `blur_mm`: σ is found such that a thin line's image has the deviation `blur_mm`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_mitsuba.scene import Fan

Floats = NDArray[np.float64]

INDEX = 1.38
"""Refractive index of watery tissue (1.36 to 1.41); gloss at normal incidence is 2.5 % (2.3 to 2.9 %)."""

METALS = {
    "Al": (1.49, 7.82), "Cr": (3.11, 3.32), "Cu": (0.21, 3.67), "Au": (0.16, 3.44), "Ag": (0.05, 4.48),
}  # fmt: skip
"""Refractive index n and extinction k at 650 nm (Rakić et al. 1998; Johnson and Christy 1972)."""


class Surface(NamedTuple):
    """What a ray met, lane by lane: albedo, scale of the gloss, GGX α; n and k of a metal (k = 0: none)."""

    albedo: Any
    gloss: Any
    roughness: Any
    metal: tuple[float, float] | None
    on_metal: Any


def diffuse(dr: Any, surface: Surface, cos_in: Any, cos_out: Any) -> Any:
    """Light sent on diffusely, of white's: albedo × cos_in × film. 0 below the surface."""
    # relative to light that comes straight down and is seen from above
    through = _passed(dr, cos_in) * _passed(dr, cos_out) / _passed(dr, 1.0) ** 2
    through = dr.select(surface.gloss > 0.0, through, 1.0)
    given = surface.albedo * cos_in * through
    return dr.select((cos_in > 0.0) & (cos_out > 0.0) & ~surface.on_metal, given, 0.0)


def glossy(dr: Any, surface: Surface, seen: Any, lit: Any) -> Any:
    """Light sent on by the film or metal, π f cos, for local directions to the eye and to the light."""
    half = dr.normalize(seen + lit)
    a2 = surface.roughness * surface.roughness
    # GGX's density of microfacet normals
    t = half.z * half.z * (a2 - 1.0) + 1.0
    density = a2 / (dr.pi * t * t)
    facing = dr.dot(seen, half)
    g = _smith(dr, a2, seen.z, lit.z)
    # F D G / (4 cos cos'), of which the light's cosine cancels
    found = dr.pi * _fresnel(dr, surface, facing) * density * g / (4.0 * seen.z)
    return dr.select((seen.z > 0.0) & (lit.z > 0.0) & (facing > 0.0), found, 0.0)


def sample_glossy(mi: Any, surface: Surface, seen: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Draw a glossy direction (local) for the eye's; also give its weight."""
    import drjit as dr

    a = surface.roughness
    # stretched to a smooth hemisphere, where visible normals are drawn from a cap
    tall = dr.normalize(mi.Vector3f(a * seen.x, a * seen.y, seen.z))
    z = (1.0 - v) * (1.0 + tall.z) - tall.z
    r2 = 1.0 - z * z
    r = dr.sqrt(dr.select(r2 > 0.0, r2, 0.0))
    s, c = dr.sincos(2.0 * dr.pi * u)
    cap = mi.Vector3f(r * c, r * s, z) + tall
    normal = dr.normalize(mi.Vector3f(a * cap.x, a * cap.y, cap.z))
    facing = dr.dot(seen, normal)
    way = 2.0 * facing * normal - seen
    a2 = a * a
    # Smith's masking of the eye alone
    one = 2.0 * seen.z / (seen.z + dr.sqrt(a2 + (1.0 - a2) * seen.z * seen.z))
    weight = _fresnel(dr, surface, facing) * _smith(dr, a2, seen.z, way.z) / one
    return way, dr.select((seen.z > 0.0) & (way.z > 0.0) & (facing > 0.0), weight, 0.0)


def _smith(dr: Any, a2: Any, cos_a: Any, cos_b: Any) -> Any:
    """Smith's height-correlated masking and shadowing G₂."""
    p = cos_b * dr.sqrt(a2 + (1.0 - a2) * cos_a * cos_a)
    q = cos_a * dr.sqrt(a2 + (1.0 - a2) * cos_b * cos_b)
    return 2.0 * cos_a * cos_b / (p + q)


def _passed(dr: Any, cosine: Any) -> Any:
    """Share of unpolarised light that enters watery tissue."""
    # Snell's cosine inside, then Fresnel's amplitudes of both polarisations
    inside = dr.sqrt(1.0 - (1.0 - cosine * cosine) / INDEX**2)
    s = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    p = (inside - INDEX * cosine) / (inside + INDEX * cosine)
    return 1.0 - 0.5 * (s * s + p * p)


def _fresnel(dr: Any, surface: Surface, cosine: Any) -> Any:
    film = surface.gloss * (1.0 - _passed(dr, cosine))
    if surface.metal is None:
        return film
    n, k = surface.metal
    c2 = cosine * cosine
    s2 = 1.0 - c2
    # the conductor's |r|² of both polarisations, without complex numbers
    t = n * n - k * k - s2
    ab = dr.sqrt(t * t + 4.0 * n * n * k * k)
    a = dr.sqrt(0.5 * (ab + t))
    s = (ab + c2 - 2.0 * a * cosine) / (ab + c2 + 2.0 * a * cosine)
    p = s * (c2 * ab + s2 * s2 - 2.0 * a * cosine * s2) / (c2 * ab + s2 * s2 + 2.0 * a * cosine * s2)
    return dr.select(surface.on_metal, 0.5 * (s + p), film)


STEP_MM = 0.15
"""Distance of beams along a plane: a third of the least ℓ, below which their grain would show."""
_LEAST_MFP_MM = 0.25  # a shorter free path would need beams closer than STEP_MM
_BINS = 4096  # of the dipole's table over d², interpolated linearly


class Dipole(NamedTuple):
    """Depths of source and image (mm), reach (mm), and (1 + σd)e^(−σd)/d³ over d².

    The table runs from 0 to reach² in even steps; its scale makes a level surface give back all.
    """

    source_mm: float
    image_mm: float
    reach_mm: float
    table: Floats


class Beams(NamedTuple):
    """Beams that entered the product: (planes, along, across, …).

    source_mm and image_mm have shape (N, A, 3, 3); flux, shape (N, A, 3), is in grey levels × mm², 0 where
    a beam missed. The angle along the line of entry (., k, .) is first_rad + k · step_rad.
    """

    source_mm: Floats
    image_mm: Floats
    flux: Floats
    first_rad: float
    step_rad: float


def dipole_of(depth_mm: float, blur_mm: float) -> Dipole:
    """Make the dipole whose line image has a deviation; the depth is the transport mean free path."""
    source = max(depth_mm, _LEAST_MFP_MM)
    # internal diffuse reflection (Egan and Hilgeman's fit, as in Jensen et al. 2001)
    inside = -1.440 / INDEX**2 + 0.710 / INDEX + 0.668 + 0.0636 * INDEX
    image = source * (1.0 + 4.0 / 3.0 * (1.0 + inside) / (1.0 - inside))
    # bisection of the logarithm: the deviation falls while σ grows
    low, high = 1e-2 / max(blur_mm, 0.1), 50.0 / max(blur_mm, 0.1)
    for _ in range(60):
        middle = math.sqrt(low * high)
        _, spread = _level(source, image, middle)
        low, high = (middle, high) if spread > blur_mm else (low, middle)
    sigma = math.sqrt(low * high)
    total, _ = _level(source, image, sigma)
    # beyond six deviations nothing is left; 12 mm limit the time
    reach = min(max(6.0 * blur_mm, 4.0 * source), 12.0)
    d = np.sqrt(np.linspace(0.0, reach**2, _BINS))
    d = np.maximum(d, 0.3 * source)  # nearer than this a point lies in a crevice, where no dipole holds
    return Dipole(source, image, reach, (1.0 + sigma * d) * np.exp(-sigma * d) / d**3 / (4.0 * np.pi * total))


def _level(source: float, image: float, sigma: float) -> tuple[float, float]:
    """Sum of R over a level surface, and the deviation of a thin line's image, for a beam straight down."""
    from scipy.integrate import trapezoid

    r = np.geomspace(1e-3, 200.0, 4000)
    given = np.zeros_like(r)
    for depth in (source, image):
        d = np.sqrt(r * r + depth * depth)
        given += depth * (1.0 + sigma * d) * np.exp(-sigma * d) / d**3 / (4.0 * np.pi)
    total, second = (float(trapezoid(2.0 * np.pi * r**power * given, r)) for power in (1, 3))
    # of the mean r² half lies across the line
    return total, math.sqrt(0.5 * second / total)


def enter_tissue(
    hit_mm: Floats, normal: Floats, on_body: NDArray[np.bool_], way: Floats, flux: Floats, dipole: Dipole
) -> tuple[Floats, Floats, Floats]:
    """Give sources, images and flux of beams that met a surface; arrays (..., 3), flux (...,)."""
    cosine = -np.einsum("...i,...i->...", way, normal)
    across = way + cosine[..., None] * normal
    # refraction by Snell's law
    inside = np.sqrt(1.0 - (1.0 - np.clip(cosine, 0.0, 1.0) ** 2) / INDEX**2)
    bent = across / INDEX - inside[..., None] * normal
    source = hit_mm + dipole.source_mm * bent
    image = source + (dipole.source_mm * inside + dipole.image_mm)[..., None] * normal
    # Fresnel's loss at entry, unpolarised, relative to that of a beam straight down
    s = (cosine - INDEX * inside) / (cosine + INDEX * inside)
    q = (inside - INDEX * cosine) / (inside + INDEX * cosine)
    passed = (1.0 - 0.5 * (s * s + q * q)) / (1.0 - ((INDEX - 1.0) / (INDEX + 1.0)) ** 2)
    return source, image, np.where(on_body & (cosine > 0.01), flux * passed, 0.0)


def gather_scattered(points_mm: Floats, fan: Fan, beams: Beams, dipole: Dipole) -> Floats:
    """Give the scattered light that leaves points of the product, shape (N, 3), grey levels on white."""
    planes = np.column_stack([fan.normals, fan.offsets_mm])
    found: Floats = _gather(
        np.ascontiguousarray(points_mm), planes, fan.origin_mm, fan.axis, beams.source_mm, beams.image_mm,
        beams.flux, beams.first_rad, beams.step_rad, dipole.source_mm, dipole.image_mm, dipole.reach_mm,
        dipole.table,
    )  # fmt: skip
    return found


@kernel
def _gather(
    points: Floats, planes: Floats, origin: Floats, axis: Floats, source: Floats, image: Floats, flux: Floats,
    first_rad: float, step_rad: float, source_mm: float, image_mm: float, reach_mm: float, table: Floats,
) -> Floats:  # fmt: skip
    out = np.zeros(points.shape[0])
    # from d² to a place in the table
    scale = (table.size - 1) / (reach_mm * reach_mm)
    last = table.size - 1
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        bx, by, bz = x - origin[0], y - origin[1], z - origin[2]
        away = math.sqrt(bx * bx + by * by + bz * bz)
        # only beams within reach along their plane
        angle = math.asin((bx * axis[0] + by * axis[1] + bz * axis[2]) / away)
        span = int(reach_mm / (away * step_rad)) + 1
        middle = round((angle - first_rad) / step_rad)
        j0, j1 = max(middle - span, 0), min(middle + span, flux.shape[1] - 1)
        summed = 0.0
        for i in range(planes.shape[0]):
            # and only planes within reach
            side = planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z - planes[i, 3]
            if abs(side) > reach_mm:
                continue
            for j in range(j0, j1 + 1):
                for k in range(flux.shape[2]):
                    f = flux[i, j, k]
                    if f == 0.0:
                        continue
                    s, v = source[i, j, k], image[i, j, k]
                    d = ((x - s[0]) ** 2 + (y - s[1]) ** 2 + (z - s[2]) ** 2) * scale
                    if d >= last:
                        continue
                    n = int(d)
                    t = d - n
                    given = source_mm * ((1.0 - t) * table[n] + t * table[n + 1])
                    d = ((x - v[0]) ** 2 + (y - v[1]) ** 2 + (z - v[2]) ** 2) * scale
                    if d < last:
                        n = int(d)
                        t = d - n
                        given += image_mm * ((1.0 - t) * table[n] + t * table[n + 1])
                    summed += f * given
        out[p] = summed
    return out
