"""What the shape classifiers show: the surface's maps, its dents and humps, its sizes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roemetry.records import Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Floats
from roemetry_shape.curvature import SurfaceShape
from roemetry_shape.regions import Region
from roemetry_shape.sections import SAMPLES, Sections

_EVERY = 2
"""Of the samples across a section, those that are shown."""

_FIGURES = (
    "length_seen_mm",
    "length_mm",
    "width_mm",
    "thickness_mm",
    "bend_mm",
    "turn_net_deg",
    "lean_range_deg",
    "asymmetry",
)


def relief_of(
    sections: Sections,
    surface: SurfaceShape,
    stands_out_mm: Floats,
    regions: Mapping[str, tuple[Region, ...]],
    features: Mapping[str, float],
) -> Relief:
    """Put together what there is to show.

    Parameters
    ----------
    sections
        The product's.
    surface
        Slope, principal curvatures and shape index, away from the edges.
    stands_out_mm
        (section, sample) height above (or below, negative) what dents and humps are measured from.
    regions
        By kind, ``dent`` and ``hump``.
    features
        Of which the sizes are written beside the drawing.
    """
    kept = slice(0, SAMPLES, _EVERY)
    x = np.broadcast_to(sections.middle_mm[:, :1], sections.across_mm.shape)
    y = sections.middle_mm[:, 1:] + sections.across_mm
    return Relief(
        xy_mm=np.stack([x, y], axis=-1)[:, kept],
        middle_mm=sections.middle_mm,
        maps=(
            ReliefMap("Dents (−) and humps (+)", "mm", stands_out_mm[:, kept], True, 1.0),
            ReliefMap(
                "Slope, and normals",
                "°",
                _spread(surface.slope_deg, sections),
                False,
                45.0,
                np.stack([_spread(part, sections) for part in (surface.normal_x, surface.normal_y)], axis=-1),
            ),
            ReliefMap(
                "Shape index: −1 cap, 0 saddle, 1 cup", "", _spread(surface.shape_index, sections), True, 1.0
            ),
            *(
                ReliefMap(f"{which} principal curvature", "1/mm", _spread(values, sections), True, 0.05)
                for which, values in (
                    ("Larger", surface.curvature_max),
                    ("Smaller", surface.curvature_min),
                )
            ),
        ),
        regions=tuple(
            ReliefRegion(
                kind=kind,
                depth_mm=region.depth_mm,
                area_mm2=region.area_mm2,
                xy_mm=np.array([region.x_mm, region.y_mm]),
                cells=np.unique(region.cells // np.array([1, _EVERY]), axis=0),
            )
            for kind, found in regions.items()
            for region in found
        ),
        figures={name: features[name] for name in _FIGURES if name in features},
    )


def _spread(values: Floats, sections: Sections) -> Floats:
    """Put values of the inner places among all, NaN around them."""
    whole = np.full((len(sections.stripe), SAMPLES), np.nan)
    if values.size:
        margin = (SAMPLES - (2 * values.shape[1] - 1)) // 2
        whole[1:-1, margin : SAMPLES - margin : 2] = values
    return whole[:, ::_EVERY]
