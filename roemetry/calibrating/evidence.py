"""The pages of a calibration: what it rests on and does to heights; why each image was used or not."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.html.plots import Axis, box, dot, dots, image, line, number, path, picture, plain, text, view
from roemetry.records import BELT, NOTHING, Evidence, Frame, ImageFinding, Residuals, StripeMap, TargetView
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Triangulator

_GRID = (6, 8)
"""Rows and columns of cells of the coverage map."""
_SHOWN_PARAMETERS_MAX = 60
"""Parameters up to which a map of their correlations can be read."""
_STRONG = 0.95
"""Correlation from which two parameters are named."""


def evidence_page(
    calibration: Calibration, evidence: Evidence, triangulator: Triangulator[Any], *, name: str
) -> str:
    """Write the whole page as one text.

    Parameters
    ----------
    calibration
        What is told about.
    evidence
        What its calibrator can show for it.
    triangulator
        The one that understands the calibration: it says what its uncertainty does to heights.
    name
        Of the rig.
    """
    from roemetry.html.page import environment_of  # jinja2 takes 50 ms; runs do without

    heights = height_uncertainty(calibration, triangulator)
    correlation, names = correlations(calibration)
    shown = 1 < len(names) <= _SHOWN_PARAMETERS_MAX
    return (
        environment_of("roemetry.calibrating")
        .get_template("calibration.html.j2")
        .render(
            name=name,
            calibration=calibration,
            evidence=evidence,
            residuals=[
                (one, residual_map(one, calibration.image_size), residual_histogram(one), _figures(one))
                for one in evidence.residuals
                if len(one.error)
            ],
            pictures=target_pictures(evidence.views),
            space=boards_in_space(evidence.views, calibration),
            coverage=_coverages(evidence, calibration.image_size),
            heights=[(row, height_map(heights, n)) for n, row in enumerate(heights.row_px)],
            height_words=_height_words(heights),
            correlation=correlation_map(correlation, names) if shown else None,
            strong=_strong(correlation, names),
            strong_from=_STRONG,
            version=version("roemetry"),
        )
    )


def coverage(one: Residuals, image_size: tuple[int, int]) -> Integers:
    """Count what was observed in each of the image's cells, (6, 8)."""
    rows, columns = image_size
    row = np.clip((one.xy_px[:, 1] / rows * _GRID[0]).astype(np.int64), 0, _GRID[0] - 1)
    column = np.clip((one.xy_px[:, 0] / columns * _GRID[1]).astype(np.int64), 0, _GRID[1] - 1)
    return np.bincount(row * _GRID[1] + column, minlength=_GRID[0] * _GRID[1]).reshape(_GRID)


def _coverages(evidence: Evidence, image_size: tuple[int, int]) -> list[tuple[str, float, Markup]]:
    """Give title, covered share and drawing of every set of places; sets at the same places once."""
    found: list[tuple[str, float, Markup]] = []
    known: list[Residuals] = []
    for one in evidence.residuals:
        if one.held_out or not len(one.error):
            continue
        if any(np.array_equal(one.xy_px, other.xy_px) for other in known):
            continue
        known.append(one)
        count = coverage(one, image_size)
        found.append((one.title, float((count > 0).mean()), coverage_map(count, one.title, image_size)))
    return found


def correlations(calibration: Calibration) -> tuple[Floats, list[str]]:
    """Correlation matrix of the parameters that are uncertain at all, and their names."""
    names = []
    for parameter, values in calibration.parameters.items():
        if values.size == 1:
            names.append(parameter)
        else:
            names += [f"{parameter} {'.'.join(str(n + 1) for n in at)}" for at in np.ndindex(values.shape)]
    std = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    known = np.flatnonzero(std > 0)
    matrix = calibration.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    return matrix, [names[n] for n in known]


class _Figures(NamedTuple):
    """Of one set of residuals."""

    points: int
    rms: float
    largest: float
    bias: float


def _figures(one: Residuals) -> _Figures:
    error = one.error[np.isfinite(one.error)]
    return _Figures(
        error.size,
        float(np.sqrt((error**2).mean())),
        float(np.abs(error).max()),
        float(error.mean()),
    )


def _height_words(found: HeightUncertainty) -> tuple[float, float]:
    """Median and largest standard uncertainty, mm."""
    if not np.isfinite(found.std_mm).any():
        return float("nan"), float("nan")
    return float(np.nanmedian(found.std_mm)), float(np.nanmax(found.std_mm))


def _strong(correlation: Floats, names: list[str]) -> list[tuple[str, str, float]]:
    """Pairs that can hardly be told apart, the strongest first, ten at most."""
    one, other = np.tril_indices(len(names), -1)
    strong = [
        (names[i], names[k], float(correlation[i, k]))
        for i, k in zip(one, other, strict=True)
        if abs(correlation[i, k]) > _STRONG
    ]
    return sorted(strong, key=lambda pair: -abs(pair[2]))[:10]


_LEVELS = 5
"""Heights at which the uncertainty is shown."""
_ROWS = 3
"""Image rows at which it is shown."""
_REDRAWS = 200
"""A standard deviation of 200 draws is uncertain by 5 %."""
_SEED = 1
"""Fixed: the page of a calibration is always the same."""


def height_uncertainty(calibration: Calibration, triangulator: Triangulator[Any]) -> HeightUncertainty:
    """Triangulate points of known place with redrawn calibrations.

    Stripes are put where a level surface of each height would show them: by the view where that is exact,
    else by the displacement for each millimetre.
    """
    low, high = calibration.height_range_mm
    heights = np.linspace(max(low, 0.0), high, _LEVELS)
    rows = np.linspace(0.1, 0.9, _ROWS) * (calibration.image_size[0] - 1)
    rows = np.rint(rows)
    redraws = calibration.redraws(np.random.default_rng(_SEED))
    drawn = [next(redraws) for _ in range(_REDRAWS)]
    found = np.full((calibration.stripe_count, _LEVELS, _ROWS), np.nan)
    for level, height in enumerate(heights):
        stripes = _level(calibration, float(height))
        at = rows.astype(np.int64)
        z = np.stack([triangulator.triangulate(stripes, one).xyz_mm[:, at, 2] for one in drawn])
        found[:, level] = np.where(np.isnan(z).any(axis=0), np.nan, z.std(axis=0, ddof=1))
    return HeightUncertainty(heights, rows, found)


def _level(calibration: Calibration, height_mm: float) -> StripeMap:
    """Draw all stripes on a level surface."""
    rows, columns = calibration.image_size
    row = np.arange(rows, dtype=np.float64)
    rest = calibration.rest_line_px(row)
    view = calibration.view
    if view is not None and view.exact:
        x_px = level_line_px(calibration, row, height_mm)
    else:
        x_px = rest + calibration.displacement_px_per_mm[:, None] * height_mm
    x_px = np.where((x_px >= 0) & (x_px <= columns - 1), x_px, np.nan)
    there = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(there, 0.0, np.nan),
        product=np.where(there, BELT, NOTHING),
        seen=there,
        margin=np.full(x_px.shape, np.nan),
        ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=rest,
        peak_stripe=np.empty(0, np.int16),
    )


def level_line_px(calibration: Calibration, row: Floats, height_mm: float) -> Floats:
    """(stripe, row) x where each stripe's plane is at a height in each image row, px: by regula falsi."""
    view = calibration.view
    if view is None:
        raise AssertionError("an exact view was promised")
    count, columns = calibration.stripe_count, calibration.image_size[1]
    stripe = np.broadcast_to(np.arange(count)[:, None], (count, row.size))

    def above(x_px: Floats) -> Floats:
        xy = np.stack([x_px, np.broadcast_to(row, x_px.shape)], axis=-1)
        return view.lift(xy, stripe)[..., 2] - height_mm

    start = calibration.rest_line_px(row)
    step = calibration.displacement_px_per_mm[:, None] * max(height_mm, 1.0)
    x0, x1 = start, np.clip(start + step, -columns, 2.0 * columns)
    z0, z1 = above(x0), above(x1)
    for _ in range(20):
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(np.abs(z1 - z0) > 0, x1 - z1 * (x1 - x0) / (z1 - z0), x1)
        x0, z0, x1 = x1, z1, ahead
        z1 = above(x1)
    return np.where(np.abs(z1) < 1e-6, x1, np.nan)


_POINTS_MAX = 4000  # points drawn: more hide one another
_BINS = 40  # of the histogram of errors
_WARM, _COLD, _MIDDLE = (179, 38, 44), (11, 85, 120), (226, 229, 232)
_PALE, _EMPTY = (255, 255, 255), "#f3c9c5"
_RAMP = ((253, 246, 216), (242, 166, 94), (176, 74, 112), (58, 31, 85))


class HeightUncertainty(NamedTuple):
    """Standard uncertainty of heights by the calibration alone."""

    height_mm: Floats
    """(level,) heights, mm."""
    row_px: Floats
    """(row,) image rows."""
    std_mm: Floats
    """(stripe, level, row) standard uncertainty, mm; NaN where the stripe is not in the image there."""


def residual_map(one: Residuals, image_size: tuple[int, int]) -> Markup:
    """Draw residuals where they arose: red where observed is larger than modelled, blue where smaller."""
    rows, columns = image_size
    left, top, width = 46.0, 12.0, 440.0
    tall = width * rows / columns
    x_axis, y_axis = Axis(0, columns, left, left + width), Axis(0, rows, top, top + tall)
    scale = _scale(one.error)
    keep = np.linspace(0, len(one.error) - 1, min(len(one.error), _POINTS_MAX)).astype(np.int64)
    body = [box(left, top, width, tall, "frame")]
    for n in keep:
        x, y = one.xy_px[n]
        words = f"{plain(float(one.error[n]), 3, True)} {one.unit}, group {int(one.group[n]) + 1}"
        body.append(dot(x_axis(x), y_axis(y), "point", words, signed(float(one.error[n]) / scale), 2.0))
    body += [text(x_axis(v), top + tall + 15, words) for v, words in x_axis.ticks(5)]
    body += [text(left - 6, y_axis(v) + 4, words, "end") for v, words in y_axis.ticks(4)]
    for n in range(21):
        share = n / 10.0 - 1.0
        body.append(box(left + 10 * n, top + tall + 26, 10.4, 9, "", "", signed(share)))
    ends = f"−{scale:.2g} to +{scale:.2g} {one.unit}"
    body.append(text(left + 220, top + tall + 34, ends, "start"))
    return picture(body, top + tall + 44, one.title, left + width + 10)


def coverage_map(count: Integers, title: str, image_size: tuple[int, int]) -> Markup:
    """Draw how much was observed in each cell of the image; red cells: nothing."""
    rows, columns = image_size
    left, top, width = 46.0, 12.0, 440.0
    tall = width * rows / columns
    high, wide = tall / count.shape[0], width / count.shape[1]
    most = max(int(count.max()), 1)
    body = []
    for (row, column), much in np.ndenumerate(count):
        share = math.sqrt(much / most)
        fill = _between(_PALE, _COLD, 0.15 + 0.75 * share) if much else _EMPTY
        x, y = left + column * wide, top + row * high
        body.append(box(x, y, wide - 1, high - 1, "", f"{much} observed", fill))
        kind = "on-dark" if much and share > 0.45 else "on-light"
        body.append(text(x + wide / 2, y + high / 2 + 4, str(much), kind))
    x_axis, y_axis = Axis(0, columns, left, left + width), Axis(0, rows, top, top + tall)
    body += [text(x_axis(v), top + tall + 15, words) for v, words in x_axis.ticks(5)]
    body += [text(left - 6, y_axis(v) + 4, words, "end") for v, words in y_axis.ticks(4)]
    return picture(body, top + tall + 22, f"where {title} were observed", left + width + 10)


def residual_histogram(one: Residuals) -> Markup:
    """Draw the residuals' distribution beside a normal one of the same spread (by its quartiles)."""
    left, right, top, bottom = 46.0, 426.0, 14.0, 160.0
    error = one.error[np.isfinite(one.error)]
    scale = 1.5 * _scale(error)
    count, edges = np.histogram(np.clip(error, -scale, scale), _BINS, (-scale, scale))
    x_axis, y_axis = Axis(-scale, scale, left, right), Axis(0, max(1, count.max()) * 1.08, bottom, top)
    body = []
    for n, much in enumerate(count):
        x0, x1 = x_axis(edges[n]), x_axis(edges[n + 1])
        words = f"{plain(edges[n], 3)} to {plain(edges[n + 1], 3)} {one.unit}: {much}"
        body.append(box(x0, y_axis(much), x1 - x0 - 0.6, bottom - y_axis(much), "bar", words))
    quartiles = np.quantile(error, [0.25, 0.5, 0.75])
    sigma = (quartiles[2] - quartiles[0]) / 1.349
    if sigma > 0:
        x = np.linspace(-scale, scale, 121)
        density = error.size * (edges[1] - edges[0]) / (sigma * math.sqrt(2 * math.pi))
        y = density * np.exp(-0.5 * ((x - quartiles[1]) / sigma) ** 2)
        path = "L".join(f"{number(x_axis(a))} {number(y_axis(b))}" for a, b in zip(x, y, strict=True))
        body.append(Markup('<path class="curve" d="M{}"/>').format(path))
    body += [line(left, bottom, right, bottom, "zero")]
    body += [text(x_axis(v), bottom + 15, words) for v, words in x_axis.ticks(6)]
    body += [text(right, bottom + 31, f"{one.title}, {one.unit}", "end")]
    return picture(body, bottom + 36, f"distribution of {one.title}", right + 12)


def height_map(found: HeightUncertainty, row: int) -> Markup:
    """Draw standard uncertainty of heights over stripe and height, in one image row."""
    left, top, tall = 60.0, 12.0, 26.0
    stripes, levels = found.std_mm.shape[:2]
    wide = min(40.0, 420.0 / stripes)
    values = found.std_mm[:, :, row]
    high = float(np.nanmax(found.std_mm)) if np.isfinite(found.std_mm).any() else 1.0
    body = []
    for level in range(levels):
        y = top + (levels - 1 - level) * tall
        body.append(text(left - 6, y + 17, f"{found.height_mm[level]:.1f}", "end"))
        for stripe in range(stripes):
            value = float(values[stripe, level])
            if not math.isfinite(value):
                continue
            words = f"stripe {stripe + 1}, {found.height_mm[level]:.1f} mm: {1000 * value:.1f} µm"
            x = left + stripe * wide
            fill = _ramp(value / high if high > 0 else 0.0)
            body.append(box(x, y, wide - 1, tall - 1, "", words, fill))
            if wide >= 30:
                kind = "on-dark" if value > 0.55 * high else "on-light"
                body.append(text(x + wide / 2, y + 17, f"{1000 * value:.0f}", kind))
    bottom = top + levels * tall
    step = max(1, round(24.0 / wide))
    for stripe in range(0, stripes, step):
        body.append(text(left + (stripe + 0.5) * wide, bottom + 14, str(stripe + 1)))
    body += [text(left - 6, bottom + 14, "mm", "end"), text(left, bottom + 30, "stripe", "start")]
    return picture(
        body, bottom + 36, f"height uncertainty in row {found.row_px[row]:.0f}", left + stripes * wide + 10
    )


def correlation_map(correlation: Floats, names: Sequence[str]) -> Markup:
    """Draw correlations of parameters: red together, blue against each other."""
    count = len(names)
    side = min(26.0, 520.0 / count)
    left, top = 16.0 + 6.6 * max(map(len, names)), 8.0
    body = []
    for i in range(count):
        if side >= 9:
            body.append(text(left - 5, top + (i + 0.5) * side + 4, names[i], "end"))
        for k in range(i + 1):
            value = float(correlation[i, k])
            if math.isfinite(value):
                words = f"{names[i]}, {names[k]}: {value:+.3f}"
                body.append(
                    box(left + k * side, top + i * side, side - 0.5, side - 0.5, "", words, signed(value))
                )
    return picture(body, top + count * side + 6, "correlations of the parameters", left + count * side + 10)


def signed(share: float) -> str:
    """Give a colour for −1 … 1."""
    share = max(-1.0, min(1.0, share)) if math.isfinite(share) else 0.0
    return _between(_MIDDLE, _WARM if share > 0 else _COLD, abs(share))


def _ramp(share: float) -> str:
    place = max(0.0, min(1.0, share)) * (len(_RAMP) - 1)
    below = min(int(place), len(_RAMP) - 2)
    return _between(_RAMP[below], _RAMP[below + 1], place - below)


def _between(one: tuple[int, ...], other: tuple[int, ...], share: float) -> str:
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(one, other, strict=True))


def _scale(error: Floats) -> float:
    known = np.abs(error[np.isfinite(error)])
    return float(np.quantile(known, 0.98)) or 1e-9 if known.size else 1.0


_VIEWS_MAX = 40
"""Images shown: with more a page would pass 3 MB."""
_SIDE_PX, _QUALITY = 560, 70
_PEAKS_MAX = 500
"""Peaks drawn of one image: with more neighbours cover each other."""
_COLOURS = ("#56b4e9", "#f0e442", "#2fb592", "#e78ac3", "#ffb14a", "#c9a0ff")
_GAMMA = 0.6
"""Exponent by which pictures are lifted: what the laser does not light is nearly black."""


class Picture(NamedTuple):
    """An image with what was found in it, and that in words."""

    name: str
    drawing: Markup
    words: str


def target_pictures(views: Sequence[TargetView]) -> list[Picture]:
    """Draw corners as circles (crosses where they were left out) and stripe peaks as dots over each image."""
    return [Picture(one.name, _drawn(one), _words(one)) for one in views[:_VIEWS_MAX]]


def _drawn(one: TargetView) -> Markup:
    rows, columns = one.frame.size
    whole = (-0.5, -0.5, float(columns), float(rows))
    body = [image(_uri(one.frame), whole)]
    step = max(1, -(-len(one.stripe) // _PEAKS_MAX))
    for stripe in np.unique(one.stripe):
        x, y = one.peaks_px[one.stripe == stripe][::step].T
        body.append(path("peak", dots(x, y), stroke=_COLOURS[int(stripe) % len(_COLOURS)]))
    for kind, chosen in (("corner", one.used), ("corner out", ~one.used)):
        x, y = one.corners_px[chosen].T
        body.append(path(kind, dots(x, y)))
    return view(body, whole, f"{one.name}: {_words(one)}", "target")


def _words(one: TargetView) -> str:
    out = int((~one.used).sum())
    said = [f"{len(one.used)} corners" + (f", {out} left out" if out else "")] if len(one.used) else []
    stripes = np.unique(one.stripe[one.stripe >= 0]).size
    of = f" of {stripes} stripes" if stripes else ""
    said += [f"{len(one.stripe)} stripe peaks{of}"] if len(one.stripe) else []
    return "; ".join(said) or "nothing used"


def _uri(frame: Frame) -> str:
    import cv2

    pixels, scale = frame.pixels, min(1.0, _SIDE_PX / max(frame.size))
    rows, columns = (max(1, round(scale * side)) for side in frame.size)
    small = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
    top = max(float(np.percentile(small, 99.5)), 1.0)
    lifted = (255.0 * np.clip(small / top, 0.0, 1.0) ** _GAMMA).astype(np.uint8)
    coded = cv2.imencode(".jpg", lifted, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode()


_WIDTH, _HEIGHT = 620.0, 400.0  # of the picture, in the page's units
_YAW_DEG, _RISE_DEG = -30.0, 25.0  # from where the target is looked at: three faces show


class Space(NamedTuple):
    """The boards over the belt: a drawing, and its shapes as JSON for the script that turns it."""

    drawing: Markup
    shapes: str


def boards_in_space(views: Sequence[TargetView], calibration: Calibration) -> Space | None:
    """Draw belt, boards and camera, seen from the front and above; None where no board's place is known."""
    boards = [(str(n + 1), one.border_mm) for n, one in enumerate(views) if len(one.border_mm) == 4]
    if not boards or calibration.view is None:
        return None
    every = np.concatenate([border for _, border in boards])
    low, high = every.min(axis=0), every.max(axis=0)
    (x0, y0), (x1, y1) = low[:2] - 20.0, high[:2] + 20.0
    belt = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, high[2] / 2])
    reach = float(np.hypot(x1 - x0, y1 - y0))
    # The camera is far above: a line towards it, as long as the scene is wide.
    towards = calibration.view.T_belt_camera[:3, 3] - centre
    towards *= 0.45 * reach / float(np.hypot.reduce(towards))
    shapes = [("belt", "", belt), *(("board", name, border) for name, border in boards)]
    shapes.append(("axis", "camera", np.array([centre, centre + towards])))
    scale = min(_WIDTH / reach, _HEIGHT / (0.5 * reach + float(high[2]) + 0.3 * reach))
    yaw, rise = math.radians(_YAW_DEG), math.radians(_RISE_DEG)
    right = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    up = np.array([-math.sin(yaw) * math.sin(rise), math.cos(yaw) * math.sin(rise), math.cos(rise)])
    body = []
    for kind, name, corners in shapes:
        place = np.column_stack([(corners - centre) @ right, -((corners - centre) @ up)]) * scale
        place += (_WIDTH / 2, _HEIGHT / 2)
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in place.tolist())
        body.append(path(f"space-{kind}", data + ("Z" if len(corners) > 2 else "")))
        if name:
            x, y = place[0 if len(corners) > 2 else -1].tolist()
            body.append(text(x, y + 4, name, "space-word"))
    told = {
        "scale": scale,
        "shapes": [np.round(corners - centre, 2).tolist() for _, _, corners in shapes],
        "named": [bool(name) for _, name, _ in shapes],
    }
    label = f"{len(boards)} boards over the belt, seen from the front and above"
    drawing = view(body, (0.0, 0.0, _WIDTH, _HEIGHT), label, "space")
    return Space(drawing, json.dumps(told, separators=(",", ":")))


_PICTURE_PX = 560
"""Of a picture: what a stripe is can still be seen, and sixty fit a page of some megabytes."""
_FOUND_BGR = {"peaks": (60, 60, 235), "points": (70, 200, 60), "marks": (235, 180, 30)}
"""BGR of all peaks, of the points that count, and of marks."""
_DIM = 0.75
"""Of the image's light: dots are to be seen on white paper."""
_TITLES = {
    "belt": "empty belt",
    "board": "board",
    "board_on_belt": "board on the belt",
    "sphere_plate": "sphere plate",
}


def findings_page(findings: Sequence[ImageFinding], name: str, refusal: str) -> str:
    """Write the page as one text that needs nothing else.

    Parameters
    ----------
    findings
        Of all images.
    name
        Of the rig.
    refusal
        Why there is no calibration; "" where there is one.
    """
    from roemetry.html.page import environment_of  # jinja2 takes 50 ms; calibrations do without

    faults = [one for one in findings if one.why]
    return (
        environment_of("roemetry.calibrating")
        .get_template("findings.html.j2")
        .render(
            name=name,
            refusal=refusal,
            images=[
                (one, _title(one), picture_of(one)) for one in [*faults, *(f for f in findings if not f.why)]
            ],
            faults=len(faults),
            version=version("roemetry"),
        )
    )


def _title(one: ImageFinding) -> str:
    seen = one.observation
    light = "laser off" if seen.frame.role == "plain" else "laser on"
    pose = f", pose {seen.pose}" if seen.pose else ""
    return f"{_TITLES.get(seen.shows, seen.shows)}{pose}, {light}"


def picture_of(one: ImageFinding) -> str:
    """Draw the image, smaller, with its peaks, points and marks: a data URI of a JPEG."""
    import cv2

    frame = one.observation.frame
    scale = min(1.0, _PICTURE_PX / frame.size[1])
    light = frame.pixels.astype(np.float32) * (255.0 * _DIM / max(frame.white, 1))
    # dark laser images are brightened: a line that a camera sees is to be seen here
    light *= (
        min(4.0, 200.0 / max(float(np.percentile(light, 99.7)), 1.0))
        if one.observation.peaks.row.size
        else 1.0
    )
    grey = cv2.resize(
        light.clip(0, 255).astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    canvas = np.ascontiguousarray(np.repeat(grey[:, :, None], 3, axis=2))
    peaks = one.observation.peaks
    _dots(canvas, np.column_stack([peaks.x_px, peaks.row]) * scale, _FOUND_BGR["peaks"])
    _dots(canvas, one.points_px * scale, _FOUND_BGR["points"])
    for x, y in np.rint(one.corners_px * scale).astype(int):
        cv2.drawMarker(canvas, (int(x), int(y)), _FOUND_BGR["marks"], cv2.MARKER_CROSS, 7, 1)
    coded: NDArray[Any] = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 82])[1]
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode("ascii")


def _dots(canvas: NDArray[np.uint8], xy_px: Floats, colour: tuple[int, int, int]) -> None:
    at = np.rint(xy_px).astype(np.int64)
    inside = ((at >= 0) & (at < np.array(canvas.shape[1::-1]))).all(axis=1)
    canvas[at[inside, 1], at[inside, 0]] = colour
