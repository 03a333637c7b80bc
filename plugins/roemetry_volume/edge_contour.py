"""Outlines from the plain-light image, or from the laser image's own ambient light where there is none."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import Frame, Outline, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Outliner, StageOptions
from roemetry_volume.outline_edge import edge_around
from roemetry_volume.outline_features import features_of
from roemetry_volume.outline_image import ambient, over_belt
from roemetry_volume.outline_start import belt_stripes, cores, ring_around, seen_regions

_LEAST_CONTRAST = 3.0
_USUAL_SPACING_PX = 40.0
_SAMPLED = 3  # every third row and column tell the belt's middle and scatter


class EdgeContourOptions(StageOptions):
    """Options of `edge-contour`."""

    light: Literal["auto", "plain", "laser"] = Field(
        default="auto", description="image to look in; auto is the plain-light one where there is one"
    )
    belt: Path | None = Field(
        default=None,
        description="image of the empty belt in the same light; its stripes, if any, are taken out",
    )


class EdgeContour(Outliner[EdgeContourOptions]):
    """Starts from what is seen of the product's stripes, and ends at the kink in the brightness.

    Nothing is known of heights here: an outline is what the camera sees, in pixels.
    """

    Options = EdgeContourOptions

    def outline(
        self, frame: Frame, plain: Frame | None, stripes: StripeMap, calibration: Calibration | None
    ) -> tuple[Outline, ...]:
        """Give one outline for each product that the stripes show; without stripes, for each core.

        Raises
        ------
        StageError
            A plain-light image is asked for and there is none, or images differ in size.
        """
        use_plain = self.options.light == "plain" or (self.options.light == "auto" and plain is not None)
        if use_plain and plain is None:
            raise StageError(
                "there is no plain-light image",
                hint="name the plain images in the source's options, or set light to laser",
            )
        chosen: Frame = plain if use_plain and plain is not None else frame
        if chosen.size != frame.size:
            raise StageError(f"the plain-light image is {chosen.size}, the laser image {frame.size}")
        known = seen_regions(stripes, frame.size)
        if not use_plain and not known:
            return ()
        product = np.zeros(frame.size, np.bool_)
        for mask in known.values():
            product |= mask
        belt = _belt_of(self.options.belt, chosen)
        spacing = _spacing_px(stripes)
        if use_plain:
            level, on_stripes = over_belt(chosen.pixels, belt, product), None
        else:
            dark = None if belt is None else ambient(_one(belt), spacing)[0]
            light, on_stripes = ambient(_one(chosen.pixels), spacing)
            level = over_belt(light, dark, product)
        outlines = []
        for number, region in (known or cores(level)).items():
            if not _is_clear(level, region):
                continue
            ring, others = ring_around(region, spacing), belt_stripes(stripes, number, frame.size)
            edge = edge_around(level, ring, others, spacing, stripes=on_stripes)
            if edge is None:
                continue
            outlines.append(
                Outline(
                    product=number,
                    xy_px=edge.xy_px,
                    xy_std_px=edge.std_px,
                    features=features_of(edge.xy_px, chosen.pixels),
                )
            )
        return tuple(outlines)


def _is_clear(level: Floats, region: NDArray[np.bool_]) -> bool:
    """Say whether a region stands out of the belt at all."""
    if not region.any() or region.all():
        return False
    outside = level[::_SAMPLED, ::_SAMPLED][~region[::_SAMPLED, ::_SAMPLED]]
    if not outside.size:
        return False
    middle = float(np.median(outside))
    scatter = 1.4826 * float(np.median(np.abs(outside - middle)))
    # some of the region may be belt: stripes are wider than what they show
    low, high = np.percentile(level[region], [20, 80])
    return bool(max(high - middle, middle - low) > _LEAST_CONTRAST * max(scatter, 1e-3))


def _spacing_px(stripes: StripeMap) -> float:
    rest = (
        np.sort(np.nanmedian(stripes.rest_px, axis=1)) if np.isfinite(stripes.rest_px).any() else np.empty(0)
    )
    step = np.diff(rest[np.isfinite(rest)])
    step = step[step > 1.0]
    return float(np.median(step)) if step.size else _USUAL_SPACING_PX


def _one(pixels: NDArray[Any]) -> NDArray[Any]:
    return pixels if pixels.ndim == 2 else np.asarray(pixels.max(axis=2))


def _belt_of(path: Path | None, like: Frame) -> NDArray[Any] | None:
    """Read the empty belt's image, turned like the others; StageError where it does not fit."""
    if path is None:
        return None
    pixels = np.rot90(_read(path), like.turn_deg // 90)
    if like.pixels.ndim == 2 and pixels.ndim == 3:
        pixels = np.rint(pixels.mean(axis=2)).astype(pixels.dtype)
    if pixels.shape != like.pixels.shape:
        raise StageError(
            f"{path.name}: the empty belt's image has shape {pixels.shape}, expected {like.pixels.shape}",
            hint="take it with the same camera, region of interest and colour",
        )
    return np.ascontiguousarray(pixels)


@lru_cache(maxsize=4)
def _read(path: Path) -> NDArray[Any]:
    import cv2

    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise StageError(f"{path}: the empty belt's image cannot be read")
    pixels = pixels[..., :3] if pixels.ndim == 3 else pixels
    pixels.flags.writeable = False
    return np.asarray(pixels)
