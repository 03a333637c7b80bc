"""What a product's outline says: its length and width in millimetres, and the outliner's own features."""

from __future__ import annotations

import numpy as np

from roemetry.records import Product
from roemetry_shape.sections import Sections

_ENDS = (0, -1)


def outline_features(product: Product, sections: Sections) -> dict[str, float]:
    """Give ``length_mm``, ``across_mm`` and ``footprint_mm2``, where there are an outline and a view.

    The outliner's own features go with them, such as its bend and colours; but for those in pixels, which
    would be others on a rig of another scale.

    The outline is where the surface turns away from the camera: it is taken to lie as high as the sections
    end, on the median. Length and width are the sides of the smallest rectangle around it, so they do not
    depend on how the product lies.
    """
    outline, view = product.outline, product.view
    if outline is None:
        return {}
    seen = {name: value for name, value in outline.features.items() if not name.endswith(("_px", "_px2"))}
    if view is None or not len(sections.stripe):
        return seen
    import cv2

    ends_mm = np.maximum(sections.height_mm[:, _ENDS], 0.0)
    x, y = view.at_height(outline.xy_px, float(np.median(ends_mm)))[:, :2].T
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return seen
    # OpenCV reckons in float32: about the middle that is enough.
    about = np.column_stack([x - x.mean(), y - y.mean()])
    sides = cv2.minAreaRect(about.astype(np.float32))[1]
    area = 0.5 * abs(float(about[:, 0] @ np.roll(about[:, 1], -1) - about[:, 1] @ np.roll(about[:, 0], -1)))
    size = {"length_mm": float(max(sides)), "across_mm": float(min(sides)), "footprint_mm2": area}
    return {**size, **seen}
