"""From calibrated slices to products."""

from __future__ import annotations

import numpy as np

from roemetry.records import NOTHING, Outline, Product, Profiles, Reason
from roemetry.records.calibration import Calibration
from roemetry.records.view import View

_NOTHING = np.int16(NOTHING)


def split_products(
    profiles: Profiles,
    outlines: tuple[Outline, ...],
    calibration: Calibration,
    acquisition_id: str,
    reasons: tuple[Reason, ...] = (),
    view: View | None = None,
) -> tuple[Product, ...]:
    """Split the slices of one frame into its products, by the number the coder gave each point."""
    highest = int(profiles.product.max(initial=0))
    numbers = range(1, 2) if highest == 1 else np.unique(profiles.product)
    by_number = {outline.product: outline for outline in outlines}
    return tuple(
        Product(
            number=int(number),
            profiles=_only(profiles, int(number)),
            calibration=calibration,
            acquisition_ids=(acquisition_id,),
            outline=by_number.get(int(number)),
            reasons=reasons + profiles.reasons,
            view=view,
        )
        for number in numbers
        if 0 < number <= highest
    )


def _only(profiles: Profiles, number: int) -> Profiles:
    """Keep the points of one product, from the first to the last of any slice."""
    mine = profiles.product == number
    lit = mine.any(axis=0)
    points = slice(int(lit.argmax()), lit.size - int(lit[::-1].argmax()))
    mine = mine[:, points]
    # adding NaN takes a third of the time of choosing between a number and NaN, and a loop over whole rows a
    # fourth of that of one over three coordinates
    others = np.where(mine, 0.0, np.nan)
    xyz_mm = profiles.xyz_mm[:, points]
    return Profiles(
        xyz_mm=(xyz_mm.reshape(len(mine), -1) + np.repeat(others, 3, axis=1)).reshape(xyz_mm.shape),
        product=np.where(mine, profiles.product[:, points], _NOTHING),
        seen=profiles.seen[:, points] & mine,
        x_px=profiles.x_px[:, points] + others,
        row_px=profiles.row_px[:, points] + others,
        height_std_mm=profiles.height_std_mm[:, points] + others,
        stripe=profiles.stripe,
        frame=profiles.frame,
        plane=profiles.plane,
        reasons=profiles.reasons,
    )
