"""How far a product's rim may be off, and what that does to its volume.

A sheet of light that is cut off at the rim lifts a row's outermost point most, and those next to it by an
amount that is not known: by how wide the sheet is there, how translucent the product, how dim what grazes.
Rims are told by the points from the second on (`flanks.rims_of`); by as much as rims with the first one
differ from these, they may be off: their standard uncertainty. It is no less than a share of the spacing of
lines, between two of which each row's edge lies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles
from roemetry.records.arrays import Floats
from roemetry_scan.dense import sections_of
from roemetry_scan.flanks import followed_to, reach_of, rims_of, usual_step

_OFF_SHARE = 0.3
"""Of the spacing of lines, so much at least. Under lines 1 mm apart, rims of five balls (`mitsuba-belt`) and
of five potatoes, rolls and fillets each (`moving-belt`, all of seeds 190000 to 190004) were off by 0.29 mm
rms."""


def rim_mm3(before: Profiles, found: Profiles) -> Floats:
    """Give (product + 1,) the standard deviation of each volume by its rim, mm³; 0 where no rim was told.

    `before` are slices of which nothing was followed, `found` the same with their flanks.
    """
    stds = np.zeros(found.rim_mm.size)
    for number in range(1, stds.size):
        if not np.isfinite(found.rim_mm[number]):
            continue
        lines = np.flatnonzero((found.product == number).any(axis=1))
        # a copy of all slices would be megabytes; shadow and belt beside a product are no longer than it is
        reach = int(np.ptp(lines)) + 1
        near = slice(max(0, int(lines[0]) - reach), int(lines[-1]) + reach + 1)
        try:
            told = sections_of(_part(found, near), number).volume_mm3
            stds[number] = abs(sections_of(_by_outer_points(_part(before, near)), number).volume_mm3 - told)
        except StageError:  # a product of which too little is seen for a volume has no uncertainty either
            continue
    return stds


def _by_outer_points(before: Profiles) -> Profiles:
    """Follow flanks to rims that lie higher by as much as the outermost points say."""
    label, none = before.product, np.zeros(before.product.shape, np.bool_)
    many = int(label.max(initial=0))
    rims, by_row = rims_of(before.xyz_mm, label, none, many)
    outer, _ = rims_of(before.xyz_mm, label, none, many, 0)
    off = np.where(np.isfinite(outer), outer - rims, 0.0)
    off = np.copysign(np.maximum(np.abs(off), _OFF_SHARE * usual_step(before.xyz_mm, 0)), off)
    reach = reach_of(before.xyz_mm, label, none, by_row)
    rims, by_row = np.maximum(rims + off, 0.0), np.maximum(by_row + off[:, None], 0.0)
    xyz_mm, label, added = followed_to(before.xyz_mm, label, before.plane, rims, by_row, reach)
    return replace(before, xyz_mm=xyz_mm, product=label, seen=before.seen & ~added, rim_mm=rims)


def _part(profiles: Profiles, lines: slice) -> Profiles:
    """Leave some of the slices."""
    names = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm", "stripe", "frame", "plane")
    return replace(profiles, **{name: getattr(profiles, name)[lines] for name in names})
