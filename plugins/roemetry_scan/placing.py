"""Lines of a scan to slices of products, by the belt's motion.

Model. At the encoder count c the product has moved by t·(c − c₀) from where it was at the first line, with
the motion t, mm per count, of the calibration. A point p that the rig sees then belongs at

    q = p − t·(c − c₀)

in the frame that moves with the product. The belt, too, is a plane there, spanned by t and by the belt's line
in the light: it is fitted to what is seen of it, and Z = 0 is laid on it, so a belt that leans against the
calibration's zero costs nothing. Lines are placed by count, never by number.

What a belt that has sunk looks like, a camera or laser that has moved looks like, too, but that changes the
scale of heights and widths by their change along a row. One line cannot tell which it was: it may be anything
between nothing and that, and stands in the uncertainty.

With several stripes each is a scan of its own. Slices are made of the middle one; how far another one's
heights lie ahead or behind on slopes is the way the product slipped against the counter between both.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, Pyramid, Reason, ScanFigures, ScanLines, SpherePlate, StripeMap
from roemetry.records.arrays import Flags, Floats, Labels
from roemetry.records.calibration import Calibration
from roemetry.records.scan import Motion
from roemetry.stages import Assembler, Triangulator
from roemetry_scan.belt import BeltOptions, fitted_plane, frame_on, plane_of_belt, products_on
from roemetry_scan.encoder_places import encoder_places
from roemetry_scan.flanks import followed, usual_step
from roemetry_scan.hidden_margin import unseen_margin_mm3
from roemetry_scan.line_ends import line_ends, longer_by
from roemetry_scan.motion import measured_motion
from roemetry_scan.rim_uncertainty import rim_mm3
from roemetry_scan.rows import RowTable, placed, points_of_rows
from roemetry_scan.slip import slip_of
from roemetry_scan.torn_lines import torn_lines

_NEAR_MM = 0.3
"""Belt lies so near to its plane where its own scatter is not known yet, mm."""
_BELT_POINTS = 100_000
"""Points that tell the belt's plane, to a thousandth of their scatter; all of a scan are 100 MB more."""
_BELT_SAMPLE = 5_000
"""The same where a tenth of a millimetre will do."""
_UNIFORM = 1.0 / math.sqrt(3.0)
"""Of the greatest error: it may be any up to that, either way."""
_LIKELY_ALL = 1.0 / math.sqrt(2.0)
"""The same where the larger an error, the likelier: little but a camera nearer by makes a line longer."""
_TURNED = 1.5
"""A laser that has turned about its own place changes more than a camera that has turned: by half, for light
from 200 to 400 mm above the belt."""
_OBLIQUE = 2.0
"""Of the way between two lines, that an edge moves along them: edges at 27° and more to the belt's way."""
_TORN_MAX = 0.02
"""Share of lines: a fault of transport that is seen in more of them hits others where it is not seen."""
_OFF_TOLD = 0.002
"""Relative standard uncertainty that is worth a word: half of what a scan's volume usually has."""

_LONGER_MAX = 0.01
"""A line that is longer by more makes areas 2 % larger: more than a scan's other errors together."""
_LONGER_TOLD = 0.001
"""The same share of volumes as for the belt: `_OFF_TOLD`."""
_AT_ONCE = 128
"""Image rows, or lines, that are looked at together: a copy of all of a long scan's heights is megabytes."""
_STRAY_FACTOR = 2.0
"""Of a belt point's usual uncertainty: stray light has 3.0 to 7 of it, belt up to 1.25 (seed 9500)."""


class BeltMotion(Assembler[BeltOptions]):
    """Places lines by encoder counts, fits the belt in the moving frame, and numbers the products."""

    def place(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any]
    ) -> Profiles:
        """Give the slices of the middle stripe in the moving frame, in the order in which they were taken."""
        motion = motion_of(calibration)
        found = encoder_places(lines.count, lines.number)
        per_line = stripes.stripe_count // len(lines.count)
        # of several stripes the middle one makes the slices; the others tell slip
        middle = calibration.stripe_count // 2
        first = middle if per_line > 1 else 0
        seen = np.isfinite(stripes.x_px[first::per_line]).any(axis=1)
        line = np.flatnonzero(found.used & seen)
        if line.size < 3:
            raise StageError(
                f"{line.size} lines could be followed and placed, 3 are the least",
                hint="look at the frames: is the laser on, and does the belt run?",
            )
        # (line, 3) the way of the belt since the first line, mm
        shift = found.direction * found.way[line, None] * motion.mm_per_count
        # all lines, as nearly always, are looked at where they are, not copied
        at = slice(first, None, per_line) if line.size == len(lines.count) else line * per_line + first
        table = points_of_rows(calibration, triangulator)
        x_px, x_std_px = stripes.x_px[at], stripes.x_std_px[at]
        xyz_mm, height_std_mm = placed(x_px, x_std_px, table, middle, shift)
        # how many rows an edge may move by from line to line and still be one
        oblique = math.ceil(_OBLIQUE * usual_step(xyz_mm, 0) / usual_step(xyz_mm, 1))
        whole = np.ones(len(line), np.bool_)
        # what has belt labels is a part of lines that were placed before: nothing is asked of it again
        before = bool((stripes.product == 0).any())
        if not before:
            whole = ~torn_lines(xyz_mm[..., 2], oblique)
        if not whole.all():
            _refuse_torn(whole)
            line, shift, at = line[whole], shift[whole], line[whole] * per_line + first
            x_px, x_std_px = stripes.x_px[at], stripes.x_std_px[at]
            xyz_mm, height_std_mm = xyz_mm[whole], height_std_mm[whole]
        normal = table.plane[middle, :3]
        plane = np.column_stack(
            [np.broadcast_to(normal, (line.size, 3)), table.plane[middle, 3] - shift @ normal]
        )
        label = np.where(np.isnan(xyz_mm[..., 0]), -1, stripes.product[at]).astype(np.int16)
        off_mm = self._belt_off_mm(xyz_mm, label, shift)
        longer, longer_std = math.nan, math.nan
        if not before:
            ends = line_ends(x_px, x_std_px)
            longer, longer_std = longer_by(ends, motion.line_ends_rows, x_px.shape[1])
        _refuse_longer(longer)
        # usual step in counts, times the motion's part across the light: the pitch of slices
        step_counts = float(np.median(np.diff(found.way[line])))
        across = float(motion.mm_per_count @ normal)
        pitch = abs(across) * step_counts
        # uncertainty of t·n by the motion's covariance
        relative = math.sqrt(float(normal @ motion.covariance @ normal)) / abs(across)
        unreadable = int(np.count_nonzero(found.used & ~seen))
        figures = ScanFigures(
            lines=len(lines.count), placed=line.size, lost=found.lost, repeated=found.repeated,
            reversed=found.reversed, wraps=found.wraps,
            unreadable=unreadable,
            damaged=int(np.count_nonzero(~whole)) + (unreadable if self.options.belt == "fit" else 0),
            pitch_mm=pitch, pitch_rel_std=relative,
            quantum_mm=float(np.sqrt(motion.mm_per_count @ motion.mm_per_count)),
            first_count=found.first, mm_per_count=_three(motion.mm_per_count),
            belt_off_rel_std=_UNIFORM * abs(_scale_per_mm(table, calibration, middle) * off_mm),
            # a slice's area is as large as the square of what its line measures
            line_length_rel_std=2.0 * math.hypot(_LIKELY_ALL * longer, longer_std),
        )  # fmt: skip
        unread = stripes.reasons or _unreadable(figures)  # what was said of the first, where that is known
        reasons = (*found.reasons, *unread, *_torn(whole), *_off(figures, off_mm), *_longer(longer))
        # the other stripes lie before or behind by what the belt runs between them
        if per_line > 1:
            lag_mm = _lags(table.plane, motion.mm_per_count, middle)
            others = {
                float(lag_mm[k]): placed(
                    stripes.x_px[line * per_line + k], stripes.x_std_px[at], table, k, shift
                )[0]
                for k in range(per_line)
                if k != middle
            }
            slip, said = slip_of(xyz_mm, others)
            figures, reasons = replace(figures, slip_rel=slip), (*reasons, *said)
        rows = stripes.rows
        profiles = Profiles(
            xyz_mm=xyz_mm,
            product=label,
            seen=stripes.seen[at] & (label >= 0),
            x_px=x_px,
            row_px=np.broadcast_to(np.arange(rows, dtype=np.float64), (line.size, rows)),
            height_std_mm=height_std_mm,
            stripe=found.place[line],
            frame=line,
            plane=plane,
            reasons=reasons,
            scan=figures,
        )
        # no point is told to be belt yet: `label` will find it
        if not (label == 0).any():
            return profiles
        return _with_flanks(_on_belt(profiles, fitted_plane(_some(xyz_mm, label == 0))))

    def _belt_off_mm(self, xyz_mm: Floats, label: Labels, shift_mm: Floats) -> float:
        """Give how far the belt lies over where the calibration has it, mm; 0 where that is its zero.

        `shift_mm` (line, 3) is what the belt has run before each line: the camera sees it without.
        """
        known = (label == 0).any()
        if not known and self.options.belt != "fit":
            return 0.0
        some = np.flatnonzero((label == 0) if known else (label > 0))
        some = some[:: max(1, some.size // _BELT_SAMPLE)]
        points = xyz_mm.reshape(-1, 3)[some]
        # as the camera sees it: without what the belt rose or fell by on its way
        over = points[:, 2] + shift_mm[some // xyz_mm.shape[1], 2]
        if not known:
            plane = plane_of_belt(points, _NEAR_MM)
            over = over[np.abs(points[:, 2] - plane[0] - points[:, :2] @ plane[1:]) < _NEAR_MM]
        return float(np.median(over))

    def label(self, profiles: Profiles, own: tuple[int, int] | None = None) -> Profiles:
        """Lay Z = 0 on the belt that is seen, and number the products that begin in the own lines."""
        known: Flags = np.asarray(np.isfinite(profiles.xyz_mm).all(axis=2))
        if np.count_nonzero(known) < 3:
            raise StageError(
                "nothing is seen: every height is marked as not known",
                hint="look at the sensor's invalid value and at the exposure",
            )
        noise = 0.0
        if self.options.belt == "fit":
            plane = plane_of_belt(_some(profiles.xyz_mm, known), _NEAR_MM)
            profiles = _on_belt(profiles, plane)
        height = np.where(known, profiles.xyz_mm[..., 2], np.nan)
        if self.options.belt == "fit":
            noise = 1.4826 * float(np.median(np.abs(height[np.abs(height) < _NEAR_MM])))
        steps = (usual_step(profiles.xyz_mm, 0), usual_step(profiles.xyz_mm, 1))
        number = products_on(height, steps, noise, self.options)
        number[_outlying(profiles.height_std_mm, number == 0)] = -1
        if own is not None:
            number = _owned(number, profiles.frame, own)
        figures = profiles.scan
        if figures is not None:
            figures = replace(figures, jitter_mm=_jitter(height, number, noise))
        profiles = replace(profiles, product=number, seen=profiles.seen & (number >= 0), scan=figures)
        del height, known, number
        return _with_flanks(profiles)

    def motion(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any],
        target: Pyramid | SpherePlate, *, right: bool = True,
    ) -> tuple[Motion, Mapping[str, float]]:  # fmt: skip
        """Measure the motion from one pass of a frustum or a ball plate."""
        return measured_motion(stripes, lines, calibration, triangulator, target, right)


def motion_of(calibration: Calibration) -> Motion:
    """Give the calibration's motion in the belt frame; StageError where it has none."""
    if calibration.motion is None:
        raise StageError(
            "the calibration does not know how the belt runs",
            hint="add `scan` to the rig file, a known body carried once through the light, and calibrate",
        )
    return calibration.motion


def _with_flanks(profiles: Profiles) -> Profiles:
    """Add what is not seen of products' flanks, and say what is not seen beside them."""
    xyz_mm, label, added, rims, doubt = followed(profiles.xyz_mm, profiles.product, profiles.plane)
    found = replace(
        profiles, xyz_mm=xyz_mm, product=label, seen=profiles.seen & ~added, rim_mm=rims, flank_rel_std=doubt
    )
    return replace(found, unseen_margin_mm3=unseen_margin_mm3(found), rim_mm3=rim_mm3(profiles, found))


def _lags(plane: Floats, motion: Floats, middle: int) -> Floats:
    """Give how far the belt runs from the middle stripe to each other one, mm, with its sign."""
    size = float(np.sqrt(motion @ motion))
    return np.asarray((plane[:, 3] - plane[middle, 3]) / (plane[:, :3] @ motion) * size)


def _on_belt(profiles: Profiles, plane: Floats) -> Profiles:
    """Lay Z = 0 on a plane z = a + b·x + c·y of the slices."""
    # a rotation and a shift that lay Z = 0 on the plane
    turn, point = frame_on(plane)
    normal = profiles.plane[:, :3]
    figures = profiles.scan
    if figures is not None:
        figures = replace(figures, mm_per_count=_three(turn @ np.array(figures.mm_per_count)))
    xyz_mm = profiles.xyz_mm @ turn.T
    # in place: a copy of a long scan is megabytes
    xyz_mm -= turn @ point
    return replace(
        profiles,
        xyz_mm=xyz_mm,
        # n·X = d in the turned frame
        plane=np.column_stack([normal @ turn.T, profiles.plane[:, 3] - normal @ point]),
        scan=figures,
    )


def _three(vector: Floats) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _scale_per_mm(table: RowTable, calibration: Calibration, middle: int) -> float:
    """Give the relative change of a slice's area by where in the image its belt lies, for 1 mm of height."""
    rest_px = calibration.rest_line_px(np.arange(calibration.image_size[0], dtype=np.float64))[middle]
    # at one, two and three pixels off the rest line: how scale and width change with height
    x_px = rest_px + np.arange(3.0)[:, None]
    xyz_mm, _ = placed(x_px, np.zeros_like(x_px), table, middle, np.zeros((3, 3)))
    rise_mm = np.nanmedian(np.diff(xyz_mm[..., 2], axis=0), axis=1)
    width_mm = np.nanmax(xyz_mm[..., 1], axis=1) - np.nanmin(xyz_mm[..., 1], axis=1)
    change = float((rise_mm[1] / rise_mm[0] * width_mm[1] / width_mm[0] - 1.0) / rise_mm[0])
    return _TURNED * change if math.isfinite(change) else 0.0


def _some(xyz_mm: Floats, chosen: Flags) -> Floats:
    """Give (n, 3) of the points that are chosen, thinned out evenly."""
    index = np.flatnonzero(chosen)
    some: Floats = xyz_mm.reshape(-1, 3)[index[:: max(1, index.size // _BELT_POINTS)]]
    return some


def _outlying(std_mm: Floats, belt: Flags) -> Flags:
    """Say which belt is light of the next row, which a lens has blurred over an edge.

    That row shows no belt, or a flank too dim to stand out. Such light is much dimmer, so much less certain
    than the belt of the same row in other slices.
    """
    outlying = np.empty(belt.shape, np.bool_)
    usual_mm = np.empty((len(belt), 1))  # of each slice: noise is judged by lines that were read together
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a slice or a row without belt
        for begin in range(0, len(belt), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            usual_mm[part, 0] = np.nanmedian(np.where(belt[part], std_mm[part], np.nan), axis=1)
        for begin in range(0, belt.shape[1], _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            stated = np.where(belt[:, some], std_mm[:, some], np.nan) / usual_mm
            np.greater(stated, _STRAY_FACTOR * np.nanmedian(stated, axis=0), out=outlying[:, some])
    return outlying


def _owned(number: Any, frame: Any, own: tuple[int, int]) -> Any:
    """Leave the products that begin in the own lines, numbered anew; others belong to another part."""
    kept = number.copy()
    place = 0
    for one in range(1, int(number.max(initial=0)) + 1):
        on = number == one
        # a product that begins in lines of the part before is measured there
        begins = int(frame[np.flatnonzero(on.any(axis=1))[0]])
        mine = own[0] <= begins < own[1]
        place += mine
        kept[on] = place if mine else -1
    return kept


def _jitter(height_mm: Floats, number: Any, noise_mm: float) -> float:
    """Give how much the belt's height scatters from line to line beyond what its points' noise makes, mm."""
    many, mean = np.empty(len(height_mm), np.int64), np.empty(len(height_mm))
    for begin in range(0, len(height_mm), _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        belt = np.where(number[some] == 0, height_mm[some], np.nan)
        many[some] = np.isfinite(belt).sum(axis=1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a line without belt
            mean[some] = np.nanmean(belt, axis=1)
    good = many >= 10
    if np.count_nonzero(good) < 3:
        # fewer lines tell no scatter
        return 0.0
    mean = mean[good]
    # what the points' noise makes of the lines' means
    expected = noise_mm**2 * float(np.mean(1.0 / many[good]))
    return math.sqrt(max(0.0, float(mean.var()) - expected))


def _refuse_torn(whole: Flags) -> None:
    many = np.count_nonzero(~whole)
    if many > max(1.0, _TORN_MAX * len(whole)):
        raise StageError(
            f"{many} of {len(whole)} lines do not continue those before and after in a part of the image: "
            "rows were lost there, or that part belongs to another frame",
            hint="look at the frames, at cable and frame grabber",
        )


def _refuse_longer(longer: float) -> None:
    if abs(longer) > _LONGER_MAX:
        way = "longer" if longer > 0.0 else "shorter"
        moved = "nearer" if longer > 0.0 else "farther away"
        raise StageError(
            f"the line of light on the belt is {abs(longer):.1%} {way} in the image than at calibration: the "
            f"camera is {moved}, its lens has been turned, or other light is taken for the line's ends",
            hint="fix camera and lens, and calibrate anew",
        )


def _longer(longer: float) -> tuple[Reason, ...]:
    if not abs(longer) >= _LONGER_TOLD:
        return ()
    way = "longer" if longer > 0.0 else "shorter"
    return (
        Reason(
            "line-length",
            f"the line of light on the belt is {abs(longer):.2%} {way} in the image than at calibration: the "
            "camera may have moved towards it or away, which makes volumes uncertain by twice as much",
        ),
    )


def _off(figures: ScanFigures, off_mm: float) -> tuple[Reason, ...]:
    if not figures.belt_off_rel_std >= _OFF_TOLD:
        return ()
    way = "above" if off_mm > 0.0 else "below"
    return (
        Reason(
            "belt-off-zero",
            f"the belt lies {abs(off_mm):.1f} mm {way} its calibrated position: belt, camera or laser have "
            f"moved, which makes volumes uncertain by {figures.belt_off_rel_std:.1%}",
        ),
    )


def _torn(whole: Flags) -> tuple[Reason, ...]:
    if whole.all():
        return ()
    return (
        Reason(
            "lines-torn",
            f"{np.count_nonzero(~whole)} of {len(whole)} lines do not continue those before and after in a "
            "part of the image: rows were lost there, or that part belongs to another frame; they are not "
            "used",
        ),
    )


def _unreadable(figures: ScanFigures) -> tuple[Reason, ...]:
    if not figures.unreadable:
        return ()
    return (
        Reason(
            "lines-unreadable",
            f"in {figures.unreadable} of {figures.lines} frames no line could be followed: not seen there",
        ),
    )
