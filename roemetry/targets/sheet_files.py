"""A sheet as a file that prints at true scale: SVG or PDF."""

from __future__ import annotations

import io
from html import escape

from roemetry.errors import ConfigurationError
from roemetry.targets.sheet import Disc, Rectangle, Sheet, Words

_MM_PER_POINT = 25.4 / 72.0


def svg_of(sheet: Sheet) -> str:
    """Write a sheet as SVG; one unit is one millimetre."""
    size = f'width="{sheet.width_mm:g}mm" height="{sheet.height_mm:g}mm"'
    view = f'viewBox="0 0 {sheet.width_mm:g} {sheet.height_mm:g}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {view}>',
        f"<title>{escape(sheet.title)}</title>",
        '<rect width="100%" height="100%" fill="white"/>',
        '<g fill="black" shape-rendering="geometricPrecision" font-family="Helvetica, Arial, sans-serif">',
    ]
    for shape in sheet.shapes:
        x, y = f"{shape.x_mm:.6g}", f"{shape.y_mm:.6g}"
        match shape:
            case Rectangle():
                side = f'width="{shape.width_mm:.6g}" height="{shape.height_mm:.6g}"'
                parts.append(f'<rect x="{x}" y="{y}" {side}/>')
            case Disc():
                parts.append(f'<circle cx="{x}" cy="{y}" r="{shape.radius_mm:.6g}"/>')
            case Words():
                parts.append(
                    f'<text x="{x}" y="{y}" font-size="{shape.size_mm:g}">{escape(shape.text)}</text>'
                )
    return "\n".join([*parts, "</g>", "</svg>", ""])


def pdf_of(sheet: Sheet) -> bytes:
    """Write a sheet as PDF; raise ConfigurationError where reportlab is not installed."""
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise ConfigurationError(
            "PDF needs reportlab, which is not installed",
            hint='pip install "roemetry[targets]", or take --format svg',
        ) from error
    file = io.BytesIO()
    size = sheet.width_mm / _MM_PER_POINT, sheet.height_mm / _MM_PER_POINT
    # invariant: no date and no random id in the file, so that the same target gives the same bytes.
    canvas = Canvas(file, pagesize=size, invariant=1)
    canvas.setTitle(sheet.title)
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.scale(1.0 / _MM_PER_POINT, 1.0 / _MM_PER_POINT)
    for shape in sheet.shapes:
        up = sheet.height_mm - shape.y_mm
        match shape:
            case Rectangle():
                width, height = shape.width_mm, shape.height_mm
                canvas.rect(shape.x_mm, up - height, width, height, stroke=0, fill=1)
            case Disc():
                canvas.circle(shape.x_mm, up, shape.radius_mm, stroke=0, fill=1)
            case Words():
                canvas.setFont("Helvetica", shape.size_mm)
                canvas.drawString(shape.x_mm, up, shape.text)
    canvas.showPage()
    canvas.save()
    return file.getvalue()
