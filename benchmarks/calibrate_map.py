"""Height errors over the image as an SVG: five by five cells for each method and height, in micrometres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from roemetry.records.arrays import Floats

_CELL = (46, 26)
_GAP = 16


def over_the_image(found: Mapping[str, Mapping[float, Floats]], heights_mm: Sequence[float]) -> str:
    """Draw mean errors.

    Parameters
    ----------
    found
        By method and height the (stripe, row) errors of Z, mm; NaN outside the image.
    heights_mm
        Which heights.
    """
    wide, high = 5 * _CELL[0] + _GAP, 5 * _CELL[1] + _GAP
    width, height = 120 + wide * len(heights_mm), 30 + high * len(found)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="11"><rect width="100%" height="100%" fill="white"/>'
    ]
    for column, level in enumerate(heights_mm):
        x = 112 + column * wide
        parts.append(f'<text x="{x + 2.5 * _CELL[0]}" y="18" text-anchor="middle">{level:g} mm high</text>')
        for row, (method, errors) in enumerate(found.items()):
            parts += _cells(cells_um(errors[level]), x, 26 + row * high)
            if column == 0:
                y = 26 + row * high + 2.5 * _CELL[1]
                parts.append(f'<text x="104" y="{y}" text-anchor="end">{method}</text>')
    parts.append(f'<text x="104" y="{height - 6}" text-anchor="end" fill="#666">µm</text></svg>')
    return "\n".join(parts)


def cells_um(error_mm: Floats) -> Floats:
    """Give (5, 5) mean errors, µm, of five groups of rows, top first, by five of stripes; NaN without any."""
    found = np.full((5, 5), np.nan)
    for across, stripes in enumerate(np.array_split(error_mm, 5)):
        for down, cell in enumerate(np.array_split(stripes, 5, axis=1)):
            if np.isfinite(cell).any():
                found[down, across] = 1e3 * np.nanmean(cell)
    return found


def _cells(um: Floats, left: float, top: float) -> list[str]:
    parts = []
    for (down, across), value in np.ndenumerate(um):
        x, y = left + across * _CELL[0], top + down * _CELL[1]
        # a shade of a decade each: 1, 10, 100, 1000 µm
        depth = 0.0 if np.isnan(value) else min(np.log10(1.0 + abs(value)) / 3.2, 1.0)
        shade = f"rgb({255 - 40 * depth:.0f},{255 - 150 * depth:.0f},{255 - 215 * depth:.0f})"
        word = "" if np.isnan(value) else f"{value:+.0f}"
        parts.append(
            f'<rect x="{x}" y="{y}" width="{_CELL[0] - 1}" height="{_CELL[1] - 1}" fill="{shade}"/>'
            f'<text x="{x + 0.5 * _CELL[0]}" y="{y + 17}" text-anchor="middle">{word}</text>'
        )
    return parts
