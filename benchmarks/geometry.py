"""The picture and the table of the page on geometry, from a scene's own rig.

``python -m benchmarks geometry [--scene recipes/herring_roe] [--picture docs/images/geometry.svg]``
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from markupsafe import Markup

from roemetry.config.scene import Scene
from roemetry.html import plots as svg
from roemetry.records.arrays import Floats
from roemetry_simulate.render import Rig
from roemetry_simulate.scene import RayCasterOptions, rig_of

_STYLE = Markup(
    "<style>text{font:12px system-ui,sans-serif;fill:#3c434c;text-anchor:middle}"
    ".start{text-anchor:start}.end{text-anchor:end}.head{font-weight:600;text-anchor:start}"
    ".ground{fill:#fff}.belt{stroke:#3c434c;stroke-width:2}.light{stroke:#c22;opacity:.35}"
    ".plane{stroke:#c22;stroke-width:1.6}.ray{stroke:#0d689c;stroke-width:1.6}.rest{stroke:#0d689c;"
    "stroke-dasharray:4 3}.body{fill:#e9dcc3;stroke:#8a7a55}.shift{stroke:#187059;stroke-width:2}"
    ".height{stroke:#3c434c;stroke-dasharray:2 3}</style>"
)
_WIDTH, _HEIGHT = 860.0, 420.0
_MARKED_MM = 16.5
"""Height of the block by which the paper calibrates."""


def main() -> None:
    """Print the table, and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=Path("recipes/herring_roe"))
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    options = Scene.load(given.scene).simulator.options
    assert isinstance(options, RayCasterOptions)
    rig = rig_of(options)
    stripe = rig.laser.count // 2
    at_block = _shift_px(rig, stripe, _MARKED_MM) / _MARKED_MM
    print("| height, mm | displacement, px | px/mm | linear model's height, mm | its error, % |")
    print("|---:|---:|---:|---:|---:|")
    for height_mm in (2.0, 5.0, 10.0, _MARKED_MM, 25.0):
        shift_px = _shift_px(rig, stripe, height_mm)
        told_mm = shift_px / at_block
        error = 100.0 * (told_mm / height_mm - 1.0)
        print(
            f"| {height_mm:g} | {shift_px:.2f} | {shift_px / height_mm:.3f} | {told_mm:.2f} | {error:+.1f} |"
        )
    if given.picture is not None:
        given.picture.write_text(_picture(rig, stripe), encoding="utf-8")
        print(given.picture)


def _shift_px(rig: Rig, stripe: int, height_mm: float) -> float:
    """Displacement of a stripe's point at Y = 0, along the image row in which it is seen."""
    lit = _lit(rig, stripe, height_mm)
    seen = rig.camera.project(lit)
    # where the stripe lies on the belt in that very row of the image
    y_mm = np.linspace(-20.0, 20.0, 4001)
    belt = np.stack([rig.laser.x_mm(y_mm, 0.0)[:, stripe], y_mm, np.zeros_like(y_mm)], axis=-1)
    rest = rig.camera.project(belt)
    order = np.argsort(rest[:, 1])
    return abs(float(seen[0] - np.interp(seen[1], rest[order, 1], rest[order, 0])))


def _lit(rig: Rig, stripe: int, height_mm: float) -> Floats:
    return np.array([float(rig.laser.x_mm(0.0, height_mm)[stripe]), 0.0, height_mm])


def _picture(rig: Rig, stripe: int) -> str:
    """Draw the rig to scale on the left, what happens at one stripe on the right."""
    body = [_STYLE, svg.box(0.0, 0.0, _WIDTH, _HEIGHT, "ground"), *_whole(rig), *_near(rig, stripe)]
    drawn = svg.picture(body, _HEIGHT, "Side view of a stripe rig: camera, planes of light, belt", _WIDTH)
    return str(drawn).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"


def _whole(rig: Rig) -> list[Markup]:
    eye, light = rig.camera.centre_mm, rig.laser.projector_mm
    per_mm = 330.0 / max(float(eye[2]), float(light[2]))
    middle = 150.0

    def place(x_mm: float, z_mm: float) -> tuple[float, float]:
        return middle + per_mm * x_mm, 385.0 - per_mm * z_mm

    def between(one: tuple[float, float], other: tuple[float, float], kind: str) -> Markup:
        return svg.line(*place(*one), *place(*other), kind)

    feet = rig.laser.x_mm(0.0, 0.0)
    parts = [svg.text(16.0, 22.0, "The rig, to scale", "head")]
    dome = [(40.0 * np.cos(a), 18.0 * np.sin(a)) for a in np.linspace(0.0, np.pi, 40)]
    parts.append(svg.shape([place(float(x), float(z)) for x, z in dome], "body"))
    parts += [between((light[0], light[2]), (float(foot), 0.0), "light") for foot in feet]
    parts.append(between((eye[0], eye[2]), (0.0, 0.0), "rest"))
    parts.append(between((-120.0, 0.0), (170.0, 0.0), "belt"))
    for name, at in (("camera", eye), ("laser", light)):
        x, y = place(float(at[0]), float(at[2]))
        parts += [svg.dot(x, y, "", name, "#3c434c", 5.0), svg.text(x, y - 12.0, name)]
    x, y = place(-120.0, 0.0)
    return [*parts, svg.text(x, y + 18.0, "belt, Z = 0", "start")]


def _near(rig: Rig, stripe: int) -> list[Markup]:
    """Draw one stripe at the block's height: lit point, rest place, and the camera's two rays."""
    foot = _lit(rig, stripe, 0.0)
    lit = _lit(rig, stripe, _MARKED_MM)
    eye = rig.camera.centre_mm
    apparent = eye + (lit - eye) * (eye[2] / (eye[2] - lit[2]))
    middle_mm = 0.5 * (float(foot[0]) + float(apparent[0]))
    per_mm = 12.0

    def place(point: Floats) -> tuple[float, float]:
        return 590.0 + per_mm * (float(point[0]) - middle_mm), 330.0 - per_mm * float(point[2])

    def beyond(source: Floats, point: Floats, height_mm: float) -> Floats:
        share = (height_mm - point[2]) / (source[2] - point[2])
        return np.asarray(point + share * (source - point))

    above = place(beyond(rig.laser.projector_mm, foot, 25.0))
    dome = [
        np.array([lit[0] + 17.0 * np.cos(a), 0.0, _MARKED_MM * np.sin(a)]) for a in np.linspace(0, np.pi, 60)
    ]
    side = np.array([middle_mm - 21.0, 0.0, 0.0]), np.array([middle_mm + 21.0, 0.0, 0.0])
    (fx, fy), (ax, ay), (lx, ly) = place(foot), place(apparent), place(lit)
    shift_px = _shift_px(rig, stripe, _MARKED_MM)
    return [
        svg.text(330.0, 22.0, "One plane of light, enlarged", "head"),
        svg.shape([place(point) for point in dome], "body"),
        svg.line(*above, fx, fy, "plane"),
        svg.line(*place(beyond(eye, lit, 25.0)), ax, ay, "ray"),
        svg.line(*place(beyond(eye, foot, 25.0)), fx, fy, "rest"),
        svg.line(*place(side[0]), *place(side[1]), "belt"),
        svg.line(fx, fy + 14.0, ax, ay + 14.0, "shift"),
        svg.line(lx, ly, lx, fy, "height"),
        svg.dot(lx, ly, "", "lit and seen", "#c22", 4.0),
        svg.dot(fx, fy, "", "rest place", "#0d689c", 4.0),
        svg.dot(ax, ay, "", "apparent place", "#0d689c", 4.0),
        svg.text(lx - 10.0, ly - 8.0, "P, lit and seen", "end"),
        svg.text(lx + 6.0, 0.5 * (ly + fy), f"Z = {_MARKED_MM:g} mm", "start"),
        svg.text(0.5 * (fx + ax), fy + 32.0, f"displacement {shift_px:.1f} px"),
        svg.text(fx, fy + 50.0, "rest line"),
        svg.text(ax, fy + 50.0, "seen there"),
        svg.text(above[0] + 6.0, above[1] + 14.0, "plane of light", "start"),
        svg.text(place(beyond(eye, lit, 25.0))[0], above[1] - 6.0, "camera's ray"),
    ]


if __name__ == "__main__":
    main()
