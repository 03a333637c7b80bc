"""Stripes on boards and on the belt: lines among peaks, and numbered points for the adjustment.

Model. A plane of light meets a plane board in a straight line, which is straight in the image once the lens's
distortion is out. So the peaks of one image that lie on the board are traced from row to row, pieces on one
straight line are joined, and each line gets every peak near it. Lines of all poses are numbered jointly
(numbering.py), the planes they lie in say where on each board each stripe must be, and its peaks are gathered
there: also those of pieces too short to be a line of their own.

Peaks on uneven print are not used: a stripe that straddles an edge of light and dark is seen shifted towards
the light side (Curless and Levoy, ICCV 1995; on rendered boards by 1.2 px rms, on even print by less than
0.01 px in the mean). Peaks far off a smooth curve along the stripe are left out. Many peaks are averaged
over a few rows.

It fails where stripes are as wide as the board's squares (no even print is left), or cross on the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import EDGE, WIDE, Observation, Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_pinhole.boards import on_board, on_even_print
from roemetry_pinhole.bundle import MAD_TO_STD
from roemetry_pinhole.geometry import ON_BELT, StripePoints, rays
from roemetry_pinhole.initial_intrinsics import InitialCamera, belt_under, reasons
from roemetry_pinhole.numbering import PoseLines, number_stripes
from roemetry_pinhole.prints import first_sizes

_STEP_MAX_PX = 3.0
"""A trace goes on where the next row's peak is nearer than this, px: a stripe that leans by 45° moves 1 px a
row, noise 1 px. Scaled by 0.6 or 1.6, heights do not change (two rigs)."""
_JOIN_PX = 2.5
"""Pieces nearer than this to one straight line are the same stripe, px; stripes are 7 px apart or more. No
change of heights from 1.5 to 4 px."""
_NEAR_PX = 2.0
"""Peaks nearer than this to the line are its own, px: five times the noise on dark print. Heights change by 1
µm at 1.2 px, by 0.2 µm at 3.2 px."""
_ROWS_MIN = 12
"""Rows of a line: from fewer its slope is not known to a pixel over a board. No change of heights from 7 to
19."""
_FRAGMENT_ROWS_MIN = 6
"""Rows of a piece that is looked at at all: shorter ones are noise and letters. No change from 4 to 10."""
_SHARE_MIN = 0.08
"""Of the longest line's peaks: shorter lines are edges of the print. No change from 0.05 to 0.13."""
_ROUNDS = 3  # rounds of sharing peaks out and fitting, until each peak has its nearest line


@dataclass(frozen=True, eq=False, slots=True)
class StripeLine:
    """One stripe on a plane."""

    start: float
    slope: float
    """start, slope: x = start + slope · y on the plane at distance 1, without distortion."""
    peak: Integers
    """(n,) indices of its peaks, by row."""

    def ends(self, xy: Floats) -> Floats:
        """Give (2, 3) the rays of its two ends, from (peak, 2) places without distortion."""
        y = xy[self.peak[[0, -1]], 1]
        return np.column_stack([self.start + self.slope * y, y, np.ones(2)])

    def off(self, xy: Floats) -> Floats:
        """Give (n,) how far places (n, 2) are from it along x."""
        return np.abs(xy[:, 0] - self.start - self.slope * xy[:, 1])


def find_lines(peaks: Peaks, xy: Floats, use: Flags, focal_px: float) -> list[StripeLine]:
    """Find the stripes, left to right, among the peaks of an image that lie on the plane looked at.

    `xy` (peak, 2) are their places on the plane at distance 1, without distortion, `use` (peak,) says which
    lie on the plane, and `focal_px` makes pixels of distances there.
    """
    from roemetry_kernels.tracing import trace_fragments

    chosen = np.flatnonzero(use)
    if not chosen.size:
        return []
    row_start = np.searchsorted(peaks.row[chosen], np.arange(peaks.image_size[0] + 1))
    fragment, _ = trace_fragments(row_start, np.ascontiguousarray(peaks.x_px[chosen]), _STEP_MAX_PX)
    order = np.argsort(fragment, kind="stable")
    parts = np.split(chosen[order], np.flatnonzero(np.diff(fragment[order])) + 1)
    lines: list[StripeLine] = []
    # long pieces first: they point well
    for part in sorted(parts, key=len, reverse=True):
        if len(part) < _FRAGMENT_ROWS_MIN:
            break
        off = [np.median(line.off(xy[part])) * focal_px for line in lines]
        near = int(np.argmin(off)) if off else -1
        if near >= 0 and off[near] < _JOIN_PX:
            lines[near] = _fitted(np.concatenate([lines[near].peak, part]), xy, focal_px)
        elif len(part) >= _ROWS_MIN:
            lines.append(_fitted(part, xy, focal_px))
    longest = max((line.peak.size for line in lines), default=0)
    lines = [line for line in lines if line.peak.size >= max(_ROWS_MIN, _SHARE_MIN * longest)]
    middle = float(np.median(xy[chosen, 1]))
    lines.sort(key=lambda line: line.start + line.slope * middle)
    # each line gets every peak that is near it, also those of fragments too short to count
    for _ in range(_ROUNDS if lines else 0):
        away = np.stack([line.off(xy[chosen]) * focal_px for line in lines])
        nearest = np.where(away.min(axis=0) < _NEAR_PX, away.argmin(axis=0), -1)
        own = [chosen[nearest == number] for number in range(len(lines))]
        lines = [
            _fitted(part, xy, focal_px) if part.size >= _ROWS_MIN else line
            for line, part in zip(lines, own, strict=True)
        ]
    lines = _uncrossed(_merged(lines, xy, focal_px), xy[chosen, 1])
    return [replace(line, peak=np.sort(line.peak)) for line in lines]


def _uncrossed(lines: list[StripeLine], y: Floats) -> list[StripeLine]:
    """Of lines that cross on the board leave the shorter out: stripes of one fan do not cross."""
    ends = np.array([y.min(), y.max()])
    at = np.array([line.start + line.slope * ends for line in lines])
    kept: list[int] = []
    for number in sorted(range(len(lines)), key=lambda number: -lines[number].peak.size):
        apart = at[kept] - at[number]
        if not (apart.min(axis=1, initial=np.inf) * apart.max(axis=1, initial=-np.inf) < 0.0).any():
            kept.append(number)
    return [lines[number] for number in sorted(kept)]


def _merged(lines: list[StripeLine], xy: Floats, focal_px: float) -> list[StripeLine]:
    """Join neighbours that are one line in two parts, found before either was long enough to point well."""
    kept: list[StripeLine] = []
    for line in lines:
        if kept:
            both = np.concatenate([kept[-1].peak, line.peak])
            at = np.array([xy[both, 1].min(), xy[both, 1].max()])
            apart = line.start - kept[-1].start + (line.slope - kept[-1].slope) * at
            # the nearest that they come within the rows of both
            if np.abs(apart).min() * focal_px < _JOIN_PX:
                kept[-1] = _fitted(np.unique(both), xy, focal_px)
                continue
        kept.append(line)
    return kept


def _fitted(part: Integers, xy: Floats, focal_px: float) -> StripeLine:
    """Fit by least absolute deviations (reweighted), so that outliers do not count."""
    part = np.sort(part)
    x, y = xy[part, 0], xy[part, 1]
    weight = np.ones(part.size)
    start = slope = 0.0
    for _ in range(8):
        total = weight.sum()
        mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
        spread = (weight * (y - mean_y) ** 2).sum()
        slope = float((weight * (y - mean_y) * (x - mean_x)).sum() / max(spread, 1e-30))
        start = float(mean_x - slope * mean_y)
        off = np.abs(x - start - slope * y) * focal_px
        # weights 1/|r|: least absolute deviations by least squares
        weight = 1.0 / np.maximum(off, 0.2)
    return StripeLine(start, slope, part)


def strongest(lines: list[StripeLine], peaks: Peaks, count: int) -> list[StripeLine]:
    """Leave out lines beyond `count` that are far weaker: edges of the print, reflections."""
    if len(lines) <= count:
        return lines
    # light, not number of peaks: a faint reflection may be long
    light = np.array([float(peaks.amplitude[line.peak].sum()) for line in lines])
    least = _STRAY_SHARE * np.sort(light)[-count]
    return [line for line, own in zip(lines, light, strict=True) if own >= least]


_STRAY_SHARE = 0.35
"""Of the weakest stripe's light: surplus lines with less are reflections. Powers of stripes differ by up to
2. No change of heights from 0.2 to 0.56."""


_WIDTH_SHARE_MAX = 0.35
"""Of the board's pitch: wider peaks are glare or edges of squares. No change of heights from 0.2 to 0.56."""
_POINTS_MAX = 20_000
"""Points that go into the adjustment; more are averaged over rows, for its time grows with them. Heights
change by 1 µm at 12,000 and at 32,000, as another draw of the noise would change them."""
_PEAKS_MIN = 8  # peaks of a stripe on one surface: from fewer no curve can be fitted. No change from 5 to 13
_BOARDS_MIN = 2  # two lines determine a plane
_OFF_MAX_MADS = 5.0
"""Standard deviations from a smooth curve along the stripe beyond which a peak is left out: one normal error
in two million. Heights change by 1 to 1.5 µm at 3 and at 8."""
_OFF_MAX_LEAST_PX = 0.5
"""Nearer than this a peak is never left out, px: on clean images the scatter is smaller than what bends a
stripe. Heights change by 1 µm at most at 0.8 px."""


@dataclass(frozen=True, eq=False, slots=True)
class Gathered:
    """Stripe points for the adjustment, and a first estimate of the planes."""

    points: StripePoints
    """Means over a few rows each."""
    planes: Floats
    """(stripe, 3) p·X = 1, 1/mm."""
    belt: Floats | None
    """(3,) a first estimate of the belt from the empty belt's images; None without any."""
    print_share: float
    outlier_share: float
    """print_share, outlier_share: share of the boards' peaks that is not used because the print under the
    stripe is uneven, and of the others because it is far off its stripe."""
    sizes: Floats
    """(board,) a first estimate of how much larger each print is than described."""
    outlying_views: tuple[int, ...] = ()
    """Views whose stripes contradict the others', by number: their marks are not to be trusted either."""


def gather(
    first: InitialCamera,
    belts: tuple[Observation, ...],
    stripes: int,
    travelled: Floats,
    left_out: dict[str, str],
    *,
    print_contrast_max: float,
) -> Gathered:
    """Find the stripes on all boards and on the empty belt, and number them.

    Camera and poses are nearly right; `travelled` (view,) are encoder counts since the view's pose was
    defined, `left_out` says by image why its stripes are not used, and is added to, and `print_contrast_max`
    is the largest contrast of the print under a stripe at which its peaks count.

    Raises
    ------
    CalibrationError
        The stripes cannot be numbered, or one lies on too few boards.
    """
    found: list[_OnBoard] = []
    poses: list[PoseLines] = []
    focal_px = float(first.camera[0])
    for number, view in enumerate(first.views):
        if view.laser is None:
            continue
        peaks = view.laser.peaks
        xy = _straight(peaks, first.camera)
        # on the board and, where it is known, its white margin
        place = on_board(xy, first.rotation[number], first.shift[number])
        margin_mm = view.board.margin_mm
        use = ((place > -margin_mm) & (place < view.board.size_mm + margin_mm)).all(axis=1)
        use &= (peaks.flags & (EDGE | WIDE)) == 0
        use &= ~(peaks.width_px > _WIDTH_SHARE_MAX * view.marks.spacing_px)
        even = np.ones(len(peaks), np.bool_)
        if view.plain is not None:
            even = on_even_print(peaks, view.plain.frame, print_contrast_max)
        # peaks at edges of the print follow the print: where they are many they make lines of their own
        lines = find_lines(peaks, xy, use & even, focal_px) or find_lines(peaks, xy, use, focal_px)
        if not lines:
            left_out[view.laser.frame.name] = (
                "no stripe is seen on the board: is the laser on, and does it fall on it? A line on the "
                "white margin counts where margin_mm says how wide that is"
            )
            continue
        plane = first.surface(number)
        found.append(_OnBoard(number, peaks, xy, use, even, plane))
        poses.append(_in_space(view.laser.frame.name, lines, xy, plane))
    if len(poses) < _BOARDS_MIN:
        raise CalibrationError(
            f"stripes lie on the board in {len(poses)} of {len(first.views)} poses, not in {_BOARDS_MIN}"
            + reasons(left_out),
            hint="hold the board under the stripes, at different heights and tilts; is `stripes` right?",
        )
    belt_pose = _belt_pose(first, belts, stripes)
    number_of = np.array([first.views[one.number].number for one in found])
    sizes = first_sizes(poses, number_of)
    if (sizes != 1.0).any():
        # on a larger print points lie farther away, and p·X = 1 shrinks
        size_of = sizes[number_of]
        found = [replace(one, plane=one.plane / s) for one, s in zip(found, size_of, strict=True)]
        poses = [replace(one, ends_mm=one.ends_mm * s) for one, s in zip(poses, size_of, strict=True)]
    numbered = number_stripes(poses, stripes, belt_pose)
    left_out |= numbered.left_out
    parts: list[tuple[int, int, Peaks, Integers]] = []
    on_stripes = on_even = 0
    for one, pose in zip(found, poses, strict=True):
        # numbered planes say where on each board a stripe must lie
        for stripe, part in () if pose.name in numbered.left_out else one.near(numbered.planes, focal_px):
            on_stripes += part.size
            part = part[one.even[part]]
            on_even += part.size
            if part.size >= _PEAKS_MIN:
                parts.append((one.number, stripe, one.peaks, part))
    belt, belt_parts = _belt_lines(belts, first.camera, numbered.planes)
    parts += belt_parts
    points, kept = _points(parts, travelled)
    return Gathered(
        points=points,
        planes=numbered.planes,
        belt=belt,
        print_share=1.0 - on_even / max(on_stripes, 1),
        outlier_share=1.0 - kept / max(on_even, 1),
        sizes=sizes,
        outlying_views=tuple(
            one.number for one, pose in zip(found, poses, strict=True) if pose.name in numbered.moved
        ),
    )


@dataclass(frozen=True, eq=False, slots=True)
class _OnBoard:
    """Peaks of one view, without distortion; which lie on the board and on even print; the board's plane."""

    number: int
    peaks: Peaks
    xy: Floats
    use: Flags
    even: Flags
    plane: Floats

    def near(self, planes: Floats, focal_px: float) -> list[tuple[int, Integers]]:
        """Give the peaks of each stripe, sought where its plane of light meets the board.

        Pieces of a stripe that were too short to be a line of their own are found again so, and lines that
        belong to no plane are not.
        """
        # rays on plane of light and board: (p − b)·ray = 0
        line = planes - self.plane
        chosen = np.flatnonzero(self.use)
        y = self.xy[chosen, 1]
        x = -(line[:, 1:2] * y + line[:, 2:]) / line[:, :1]
        off = np.abs(self.xy[chosen, 0] - x) * focal_px
        nearest = off.argmin(axis=0)
        found = []
        for stripe in range(len(planes)):
            others = np.delete(x, stripe, axis=0) - x[stripe]
            room = np.abs(others).min(axis=0, initial=np.inf) * focal_px
            # nearest to this stripe, and within a share of the way to the next one
            near = (nearest == stripe) & (off[stripe] < np.minimum(_SEARCH_PX, _SEARCH_SHARE * room))
            if near.sum() >= _PEAKS_MIN:
                own = _fitted(chosen[near], self.xy, focal_px)
                # of these, the ones near the line fitted to them
                found.append((stripe, own.peak[own.off(self.xy[own.peak]) * focal_px < _NEAR_PX]))
        return [(stripe, part) for stripe, part in found if part.size >= _PEAKS_MIN]


_SEARCH_PX = 6.0  # half the width of the lane in which a stripe is sought, px: first poses err by 1 to 2 px
_SEARCH_SHARE = 0.35  # the same at most, of the distance of the next stripe


def _in_space(name: str, lines: list[StripeLine], xy: Floats, plane: Floats) -> PoseLines:
    """Give lines by their ends on a plane (3,) p·X = 1 in the camera's frame."""
    ends = np.array([line.ends(xy) for line in lines])
    ends /= (ends @ plane)[:, :, None]
    return PoseLines(name, ends, np.array([line.peak.size for line in lines]))


def _belt_pose(first: InitialCamera, belts: tuple[Observation, ...], stripes: int) -> PoseLines | None:
    """Give the lines on the empty belt, where a board lay on it; the image with the right number of them."""
    lies = [number for number, view in enumerate(first.views) if view.on_belt]
    for view in belts if lies else ():
        xy, lines = _on_belt(view, first.camera, stripes)
        if len(lines) == stripes:
            return _in_space(view.frame.name, lines, xy, belt_under(first, lies[0]))
    return None


def _on_belt(view: Observation, camera: Floats, stripes: int) -> tuple[Floats, list[StripeLine]]:
    """Give (peak, 2) places without distortion, and the lines on the empty belt."""
    xy = _straight(view.peaks, camera)
    usable = (view.peaks.flags & (EDGE | WIDE)) == 0
    return xy, strongest(find_lines(view.peaks, xy, usable, float(camera[0])), view.peaks, stripes)


def belt_points(
    belts: tuple[Observation, ...], camera: Floats, planes: Floats
) -> tuple[StripePoints, Floats]:
    """Give the stripes on the empty belt, numbered by known planes, and a first estimate of the belt.

    Raises
    ------
    CalibrationError
        Another number of stripes is seen than there are planes.
    """
    belt, parts = _belt_lines(belts, camera, planes)
    if belt is None:
        raise CalibrationError("there is no image of the empty belt", hint="name one in images.belt")
    return _points(parts, np.empty(0))[0], belt


def _straight(peaks: Peaks, camera: Floats) -> Floats:
    return rays(camera, np.column_stack([peaks.x_px, peaks.row]))[:, :2]


def _belt_lines(
    belts: tuple[Observation, ...], camera: Floats, planes: Floats
) -> tuple[Floats | None, list[tuple[int, int, Peaks, Integers]]]:
    """Find and number the stripes on the empty belt, by the plane that fits them best."""
    parts: list[tuple[int, int, Peaks, Integers]] = []
    rays, sides = [], []
    for view in belts:
        xy, lines = _on_belt(view, camera, len(planes))
        if not lines or len(lines) > len(planes):
            raise CalibrationError(
                f"{view.frame.name}: {len(planes)} stripes are expected on the empty belt, "
                f"{len(lines)} are seen",
                hint="check `stripes`, the extractor's threshold, turn_deg, and that the belt is empty",
            )
        ray = np.concatenate([line.ends(xy) for line in lines])
        fits = []
        # outer stripes may be missing: every shift in order is tried
        for first in range(len(planes) - len(lines) + 1):
            # a point on belt and plane of light has b·ray = p·ray: linear in b
            side = (ray * np.repeat(planes[first : first + len(lines)], 2, axis=0)).sum(axis=1)
            plane, _, rank, _ = np.linalg.lstsq(ray, side, rcond=1e-9)
            # lines that are one line determine no belt
            off = np.abs(ray @ plane - side).max() / np.sqrt((plane**2).sum()) if rank == 3 else np.inf
            fits.append((float(off), first))
        first = min(fits)[1]
        rays += [line.ends(xy) for line in lines]
        sides += [line.ends(xy) @ planes[first + number] for number, line in enumerate(lines)]
        parts += [(ON_BELT, first + number, view.peaks, line.peak) for number, line in enumerate(lines)]
    if not parts:
        return None, parts
    belt = np.linalg.lstsq(np.concatenate(rays), np.concatenate(sides), rcond=None)[0]
    return belt, parts


def _binned(
    number: int, stripe: int, peaks: Peaks, part: Integers, step: int, count: float
) -> tuple[Floats, Integers]:
    """Means of peaks over `step` rows: pose, stripe, x, row, standard uncertainty, counts; and how many each.

    What is far off a smooth curve along the stripe is left out first.
    """
    row, x, std = peaks.row[part].astype(np.float64), peaks.x_px[part], peaks.x_std_px[part]
    std = np.where(np.isfinite(std) & (std > 0), std, 1.0)
    middle, half = row.mean(), max(np.ptp(row) / 2.0, 1.0)
    keep = np.ones(row.size, np.bool_)
    for _ in range(3):
        curve = np.polynomial.polynomial.polyfit((row[keep] - middle) / half, x[keep], 3)
        off = np.abs(x - np.polynomial.polynomial.polyval((row - middle) / half, curve))
        spread = MAD_TO_STD * float(np.median(off[keep]))
        keep = off <= max(_OFF_MAX_MADS * spread, _OFF_MAX_LEAST_PX)
    row, x, std = row[keep], x[keep], std[keep]
    bin_of = np.unique(((row - row[0]) // step).astype(np.int64), return_inverse=True)[1]
    members = np.bincount(bin_of)

    def mean(of: Floats) -> Floats:
        return np.bincount(bin_of, of) / members

    many = np.sqrt(mean(std**2) / members)
    same = np.ones(members.size)
    rows = np.column_stack([number * same, stripe * same, mean(x), mean(row), many, count * same])
    return rows, members


def _points(parts: list[tuple[int, int, Peaks, Integers]], travelled: Floats) -> tuple[StripePoints, int]:
    """Give the points of pose, stripe, peaks and which of them, and how many peaks on boards they hold."""
    # rounded up: never more points than wanted
    step = max(1, -(-sum(part.size for *_, part in parts) // _POINTS_MAX))
    tables, kept = [], 0
    for number, stripe, peaks, part in parts:
        count = 0.0 if number == ON_BELT else travelled[number]
        table, members = _binned(number, stripe, peaks, part, step, count)
        tables.append(table)
        kept += 0 if number == ON_BELT else int(members.sum())
    rows = np.concatenate(tables)
    whole = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
    return StripePoints(*whole, *np.ascontiguousarray(rows[:, 2:].T)), kept
