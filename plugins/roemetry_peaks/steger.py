"""Ridges of the smoothed image in any direction (Steger 1998), where they cross rows."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.extraction.grey_levels import grey, plain_layout, scaled_level
from roemetry_peaks.region import searched

_NOISES = 8.0  # of the smoothed image, that a ridge rises above both valleys
_LEVELS_MIN = 5.0  # grey levels of 0…255 that it rises at least
_BEND_NOISES = 3.0  # of the second derivative, that a ridge is curved at least
_REACH = 4.0  # standard deviations that the filters reach


class StegerOptions(StageOptions):
    """Options of `Steger`."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a stripe must rise above both "
        "valleys, in the smoothed image; auto: 8 times the noise of that image, at least 5, and 8 % of "
        "what the image's stripes reach",
    )
    width_min_px: float = Field(
        default=1.5,
        ge=0.0,
        le=100.0,
        description="smallest full width at half height across the stripe, px: rejects hot pixels",
    )
    width_max_px: float = Field(
        default=40.0,
        gt=0.0,
        le=1000.0,
        description="largest full width at half height across the stripe, px: rejects glare",
    )
    region: tuple[int, int, int, int] | None = Field(
        default=None,
        description="part of the (turned) image to search: first row, row after the last, first column, "
        "column after the last, px; none: all of it",
    )
    sigma_px: float = Field(
        default=2.0,
        ge=0.7,
        le=10.0,
        description="standard deviation of the smoothing in all directions, px: about a stripe's own",
    )


class Steger(Extractor[StegerOptions]):
    """Finds ridges by the Hessian of the smoothed image and follows each to the row's own height."""

    Options: ClassVar[type[StageOptions]] = StegerOptions
    capabilities = Capabilities(tolerance_px=0.12, saturated_tolerance_px=0.2)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        import cv2

        from roemetry_kernels.extraction.local_contrast import SHARE_MIN, faint
        from roemetry_kernels.extraction.ridges import crossings
        from roemetry_kernels.extraction.smoothed_peaks import background_noise, rounding_variance
        from roemetry_kernels.extraction.upside_down import doubts

        options = self.options
        area = searched(frame, options.region)
        image = plain_layout(grey(frame)[area.top : area.bottom, area.left : area.right])
        sigma = options.sigma_px
        plain, first, second = _filters(sigma)

        def filtered(across: np.ndarray, along: np.ndarray) -> Any:
            return cv2.sepFilter2D(image, cv2.CV_64F, across, along, borderType=cv2.BORDER_REPLICATE)

        noise = math.sqrt(max(background_noise(image) ** 2, rounding_variance(image)))
        if options.threshold == "auto":
            rise = max(_NOISES * noise * _noise_left(plain, image.shape[0]), scaled_level(_LEVELS_MIN, frame))
        else:
            rise = scaled_level(options.threshold, frame)
        found = crossings(
            image,
            filtered(plain, plain),
            (filtered(first, plain), filtered(plain, first)),
            (filtered(second, plain), filtered(first, first), filtered(plain, second)),
            sigma_px=sigma,
            bend_min=_BEND_NOISES * noise * math.sqrt(3.0 / (16.0 * math.pi)) / sigma**3,
            rise=rise,
            noise=noise,
            widths_px=(options.width_min_px, options.width_max_px),
            white=frame.white,
        )
        order = np.lexsort((found.x_px, found.row))
        row, x_px = found.row[order], found.x_px[order]
        inside = np.abs(x_px - 0.5 * (image.shape[1] - 1)) <= 0.5 * image.shape[1]
        inside[1:] &= (np.diff(row) > 0) | (np.diff(x_px) > 0.0)
        order = order[inside]
        if options.threshold == "auto":
            order = order[~faint(found.row[order], found.x_px[order], found.amplitude[order], SHARE_MIN)]
        return Peaks(
            image_size=frame.size,
            row=found.row[order] + area.top,
            x_px=found.x_px[order] + area.left,
            x_std_px=np.full(order.size, np.nan),
            amplitude=found.amplitude[order],
            background=found.background[order],
            width_px=found.width_px[order],
            flags=found.flags[order],
            correlation_rows=sigma,
            reasons=doubts(image, frame.white, found.row[order], found.x_px[order], found.width_px[order]),
        )


def _noise_left(plain: np.ndarray, rows: int) -> float:
    """Give what the smoothing leaves of white noise, halfway down an image; borders are repeated.

    Along the rows the image is taken as long: where there are few rows, each of them counts several times.
    """
    reach = plain.size // 2
    of_row = np.bincount(np.clip(rows // 2 + np.arange(-reach, reach + 1), 0, rows - 1), plain)
    return float(np.linalg.norm(plain) * np.linalg.norm(of_row))


def _filters(sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaussian and its first and second derivative, for correlation; exact on parabolas."""
    reach = math.ceil(_REACH * sigma)
    u = np.arange(-reach, reach + 1, dtype=np.float64)
    plain = np.exp(-0.5 * (u / sigma) ** 2)
    plain /= plain.sum()
    first = u * plain
    first /= first @ u
    second = (u**2 - (u**2 @ plain)) * plain
    second /= 0.5 * (second @ u**2)
    return plain, first, second
