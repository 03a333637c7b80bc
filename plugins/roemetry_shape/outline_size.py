"""Length and width of a product from its outline, in millimetres."""

from __future__ import annotations

import numpy as np

from roemetry.records import Product
from roemetry_shape.sections import Sections

_ENDS = (0, -1)


def outline_size(product: Product, sections: Sections) -> dict[str, float]:
    """Give ``length_mm``, ``across_mm`` and ``footprint_mm2``; empty without an outline or a view.

    The outline is where the surface turns away from the camera: it is taken to lie as high as the sections
    end, on the median. Length and width are the sides of the smallest rectangle around it, so they do not
    depend on how the product lies.
    """
    outline, view = product.outline, product.view
    if outline is None or view is None or not len(sections.stripe):
        return {}
    import cv2

    ends_mm = np.maximum(sections.height_mm[:, _ENDS], 0.0)
    x, y = view.at_height(outline.xy_px, float(np.median(ends_mm)))[:, :2].T
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return {}
    # OpenCV reckons in float32: about the middle that is enough.
    about = np.column_stack([x - x.mean(), y - y.mean()])
    sides = cv2.minAreaRect(about.astype(np.float32))[1]
    area = 0.5 * abs(float(about[:, 0] @ np.roll(about[:, 1], -1) - about[:, 1] @ np.roll(about[:, 0], -1)))
    return {"length_mm": float(max(sides)), "across_mm": float(min(sides)), "footprint_mm2": area}
