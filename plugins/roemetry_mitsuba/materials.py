"""How surfaces send light on: GGX over a diffuse base, and rough metal, as Dr.Jit expressions.

A food's surface is a rough dielectric film (GGX with Smith's shadowing, Walter et al. 2007; exact Fresnel
equations at index 1.38) over a diffuse base. The base gets and gives what the film lets through, relative to
light straight down, so that a level surface seen from above has the albedo told. A metal reflects by the
conductor's Fresnel equations alone, with indices at 650 nm. Glossy rays are drawn from the visible normals
(Dupuy and Benyoub 2023), so a ray weighs F·G₂/G₁ ≤ 1 and no single ray stands out.

Mitsuba's own materials compute the same, but their minima and maxima cannot be compiled by LLVM 15 (the
process aborts), which many systems still ship; here nothing needs more than comparisons.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
    through = _passed(dr, cos_in) * _passed(dr, cos_out) / _passed(dr, 1.0) ** 2
    through = dr.select(surface.gloss > 0.0, through, 1.0)
    given = surface.albedo * cos_in * through
    return dr.select((cos_in > 0.0) & (cos_out > 0.0) & ~surface.on_metal, given, 0.0)


def glossy(dr: Any, surface: Surface, seen: Any, lit: Any) -> Any:
    """Light sent on by the film or metal, π f cos, for local directions to the eye and to the light."""
    half = dr.normalize(seen + lit)
    a2 = surface.roughness * surface.roughness
    t = half.z * half.z * (a2 - 1.0) + 1.0
    density = a2 / (dr.pi * t * t)
    facing = dr.dot(seen, half)
    g = _smith(dr, a2, seen.z, lit.z)
    found = dr.pi * _fresnel(dr, surface, facing) * density * g / (4.0 * seen.z)
    return dr.select((seen.z > 0.0) & (lit.z > 0.0) & (facing > 0.0), found, 0.0)


def mirrored(mi: Any, surface: Surface, seen: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Draw a glossy direction (local) for the eye's; also give its weight."""
    import drjit as dr

    a = surface.roughness
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
    t = n * n - k * k - s2
    ab = dr.sqrt(t * t + 4.0 * n * n * k * k)
    a = dr.sqrt(0.5 * (ab + t))
    s = (ab + c2 - 2.0 * a * cosine) / (ab + c2 + 2.0 * a * cosine)
    p = s * (c2 * ab + s2 * s2 - 2.0 * a * cosine * s2) / (c2 * ab + s2 * s2 + 2.0 * a * cosine * s2)
    return dr.select(surface.on_metal, 0.5 * (s + p), film)
