"""What leaning light sees behind the end of a quadric, in the end's own shadow."""

from __future__ import annotations

import math

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel

_LINES = 16
_ROUNDS = 4


@float_kernel
def shadow_of(c: Floats, m: float, q: float, fanning: float) -> float:
    """What leaning light sees of the end in its own shadow, less than nothing; nothing if it leans outwards.

    Line by line along x: behind the place where the ray grazes, the slices count the triangle below the ray;
    of that the product fills a part, and the same rim on the near side, which no camera above sees, another.
    Beside the product's middle the ray grazes nearer to the projector, and leans less there.

    Parameters
    ----------
    c : ndarray, shape (7,)
        (z − c₀)² = c₁ + c₂x + c₃y + c₄x² + c₅xy + c₆y².
    m, q, fanning
        The outer slice's plane of light is x = q·y + m·z; how m changes along x.

    Returns
    -------
    float
        Volume, in the units of the quadric.
    """
    if not m < 0.0:
        return 0.0
    r, low, k = c[0], max(c[0], 0.0), -c[4]
    u0, u1, u2 = c[1] + c[2] * c[2] / (4.0 * k), c[3] + 0.5 * c[2] * c[5] / k, c[6] + 0.25 * c[5] * c[5] / k
    if not u2 < 0.0:
        return 0.0
    middle = -0.5 * u1 / u2
    top = u0 + 0.5 * u1 * middle
    if not top > 0.0:
        return 0.0
    half, root = math.sqrt(top / -u2), math.sqrt(k)
    total = 0.0
    for node in range(_LINES):
        turn = math.pi * ((node + 0.5) / _LINES - 0.5)
        s, y = math.sqrt(top) * math.cos(turn), middle + half * math.sin(turn)
        centre = 0.5 * (c[2] + c[5] * y) / k
        lean, along, up = -m, 0.0, 0.0
        for _ in range(_ROUNDS):
            # where the ray grazes, as sine and cosine of the ellipse's angle from its top
            up = lean * root / math.sqrt(1.0 + lean * lean * k)
            along = 1.0 / math.sqrt(1.0 + lean * lean * k)
            at = centre + s / root * along + lean * (r + s * up) - q * y
            lean = max(-(m + fanning * at), 0.0)
        height = r + s * up
        if height <= low or not lean > 0.0:
            continue
        graze = math.acos(up)
        foot, foot_sine, foot_cosine = 0.5 * math.pi, 1.0, 0.0
        if r < 0.0:
            foot_cosine = min(-r / s, 1.0)
            foot, foot_sine = math.acos(foot_cosine), math.sqrt(1.0 - foot_cosine * foot_cosine)
        if foot <= graze:
            continue
        body = r * s / root * (foot_sine - along)
        body += 0.5 * s * s / root * (foot - graze + foot_sine * foot_cosine - along * up)
        off = body - 0.5 * lean * (height * height - low * low)
        total += off * half * math.cos(turn) * math.pi / _LINES
    return total
