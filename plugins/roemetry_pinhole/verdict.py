"""What may be said of a calibration: limits that refuse it, figures, held-out views, a verdict in words.

Limits. A stripe's peaks on all surfaces lie in one plane but for noise, so the residuals of each stripe are
limited twice: by what its extractor states of its peaks (`_STATED_FACTOR_MAX`) and by the residuals of the
other stripes (`_PLANE_FACTOR_MAX`). The marks' residuals are noise, so neighbours in the image must not
share them. Peaks and marks that are left out as far off are few (`_USED_MIN`). Peaks on uneven print are
counted apart: they are not used for a known reason. A stripe of Gaussian profile that straddles an edge
between light and dark print is seen shifted towards the light side (Curless and Levoy, ICCV 1995), by more
than a pixel where it is some pixels wide.

Cross-validation. Each fifth view is left out in turn, and the calibration of the rest says where the stripes
on it lie; its marks know better. That shows what residuals cannot: too few poses, poses too much alike.

What it cannot see: an error that all targets share (a wrong pitch, a bent board laid flat by its marks).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import Evidence, EvidenceFigure, Residuals
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry_pinhole.bundle import Adjusted, Measured, chosen
from roemetry_pinhole.geometry import (
    CAMERA,
    ON_BELT,
    Geometry,
    StripePoints,
    corner_residuals,
    plane_distances,
    rays,
    unknowns_of,
)
from roemetry_pinhole.initial_intrinsics import InitialCamera
from roemetry_pinhole.joint_adjustment import JointAdjustment
from roemetry_pinhole.pinhole_plane import belt_pose

_CELLS = 6
"""Cells along either side of the image in which marks are averaged; with 10 poses of 80 marks 20 fall into
each."""
_CELL_MARKS_MIN = 8  # marks in a cell: from fewer the mean is noise
_SYSTEMATIC_MAX_PX = 0.4
"""Error that neighbouring marks share, px, by which a lens model is refused: at 1500 px focal length 0.03 %,
that is 0.1 mm over 350 mm."""
_SYSTEMATIC_SHARE_MAX = 0.5  # the same as a share of the marks' noise: less is drowned in it
_COVERAGE_MIN = 0.4  # of the cells: with fewer the lens is a guess outside
_PLANE_FACTOR_MAX = 5.0
"""Residuals of one stripe over those of the median stripe. Powers and widths of stripes differ, and with them
their noise, by 2 to 3; a reflection taken for a stripe gives 20 and more."""
_STATED_FACTOR_MAX = 4.0
"""Residuals of a stripe over what its extractor states. Points are means of neighbouring rows, stated as if
rows were independent: speckle (0.8 px long) makes that too small by 1.2 to 2, uneven print left by 1.2."""
_PLANE_RMS_MIN_PX = 0.5
"""Residuals below this are no reason to refuse, however little is stated: half a pixel is 0.5 to 1 % of the
height of a product in the rigs this is made for."""
_PLANE_RMS_MAX_PX = 2.0
"""Residuals above this are refused whatever is stated, or if nothing is: a stripe's peaks are gathered within
2 px of one straight line on each surface, so what is above is no noise but lines that are in no plane."""
_GRAZING_MIN = 0.02
"""Distance of a plane of light from the camera's centre over that of the belt: 1° between light and sight; 1
px is then 10 mm of height and more."""
_USED_MIN = 0.75
"""Share of marks, and of stripe peaks on even print, that must fit. Least squares after trimming at 4.5
standard deviations holds up to about a third of outliers."""
_STRIPE_USED_MIN = 0.5  # the same of each stripe alone: with less, what is left may be the outliers
_SYSTEMATIC_TOLD_PX = 0.05  # from here on a shared error is told: half the noise of a mark
_CONFLICT_LITTLE = 10.0
"""Up to here stripes pull camera and poses off the marks by about three standard deviations in all."""
_CONFLICT_MAX = 100.0
"""Beyond, by ten: no bow or bleeding light of a sound rig does that (1 on sound sets), a wrong pairing of
images, another camera or a board that moved does."""


@dataclass(frozen=True, eq=False, slots=True)
class Verdict:
    """Figures for the calibration file, sentences for its reader, and the height the boards reached, mm."""

    residuals: dict[str, float]
    notes: tuple[str, ...]
    height_min_mm: float
    height_max_mm: float


def judged(joined: JointAdjustment, *, scale_is_known: bool = True) -> Verdict:
    """Judge an adjustment; `scale_is_known` says whether the board's pitch is what lengths come from.

    Raises
    ------
    CalibrationError
        A plane goes nearly through the camera; stripes do not lie in planes; residuals are no noise.
    """
    adjusted = joined.adjusted
    # refusals first: figures of what cannot be are of no use
    _check_planes_pass_by(adjusted)
    _check_used(joined)
    _check_planes(adjusted, joined)
    if adjusted.conflict > _CONFLICT_MAX:
        raise CalibrationError(
            "stripes and board corners contradict each other: for both to be right, the errors of stripes "
            f"would have to be {np.sqrt(adjusted.conflict):.0f} times their scatter",
            hint="is each laser image paired with the board it was taken of, by one camera? did nothing move "
            "between the two images of a pose? is the board flat? are its `pitch_mm` and `thickness_mm` "
            "right?",
        )
    residuals: dict[str, float] = {}
    notes: list[str] = []
    if adjusted.corner_used.size:
        residuals, notes = _of_marks(joined, scale_is_known=scale_is_known)
    if joined.solids is not None:
        names = ", ".join(f"{shape.kind} {shape.name}" for shape in joined.solids.shapes)
        notes.append(f"planes of light: from {names}")
    if joined.moves:
        travelled, said = _of_travel(adjusted)
        residuals, notes = residuals | travelled, [*notes, said]
    if adjusted.conflict > 1.0:
        size = "a little" if adjusted.conflict <= _CONFLICT_LITTLE else "by more than their scatter explains"
        notes.append(
            f"stripes and board corners contradict each other {size}: stripes count "
            f"{adjusted.conflict:.0f} times less than their scatter would allow"
        )
    if adjusted.disagreement > 1.0:
        notes.append(
            f"the poses disagree about camera and planes {np.sqrt(adjusted.disagreement):.1f} times as much "
            "as their scatter explains, and all that is stated is as much less certain: does the lens focus "
            "by itself, or the board bend in the hand?"
        )
    if joined.print_share > 0.0:
        notes.append(
            f"{joined.print_share:.0%} of the boards' stripe peaks lie on edges of the print, where a line "
            "seems shifted towards the light side: they do not count"
        )
    used = adjusted.stripe_used
    residuals |= {
        "stripes_rms_px": _rms(adjusted.stripe_px[used]),
        "stripes_rms_mm": _rms(plane_distances(adjusted.geometry, joined.measured.points)[used]),
        "stripes_over_stated": adjusted.stripe_scale,
        "stripes_left_out": _outlier_share(joined),
        "stripes_on_uneven_print": joined.print_share,
        "stripes_correlation": adjusted.correlation,
        "poses_over_stated": float(np.sqrt(adjusted.disagreement)),
        "poses": float(len(joined.first.views)),
    }
    return Verdict(residuals, tuple(notes), *_heights_reached(joined))


def _of_marks(joined: JointAdjustment, *, scale_is_known: bool) -> tuple[dict[str, float], list[str]]:
    """Figures and notes of the boards' marks."""
    adjusted = joined.adjusted
    rms_px = float(np.sqrt((adjusted.corner_px[adjusted.corner_used] ** 2).sum(axis=1).mean()))
    systematic_px, coverage = _systematic(adjusted, joined.first, joined.size)
    if systematic_px > max(_SYSTEMATIC_MAX_PX, _SYSTEMATIC_SHARE_MAX * adjusted.corner_std_px):
        raise CalibrationError(
            "the residuals are not noise: neighbouring board corners are off together, by "
            f"{systematic_px:.2f} px",
            hint="take another lens model (calibrator.options.lens), a flat board or `flatness: free`, "
            "and a sharp lens",
        )
    notes = []
    if systematic_px > max(_SYSTEMATIC_TOLD_PX, _SYSTEMATIC_SHARE_MAX * adjusted.corner_std_px):
        notes.append(
            "the residuals are not noise alone: neighbouring board corners are off together by "
            f"{systematic_px:.2f} of {adjusted.corner_std_px:.2f} px; stated uncertainties are too small"
        )
    if joined.board is not None and joined.solids is None and scale_is_known:
        notes.append(f"scale: from the board's pitch of {joined.board.pitch_mm:g} mm")
    warp = adjusted.geometry.warp
    shape = {} if warp is None else {"board_bend_mm": warp.range_mm()}
    if warp is not None:
        notes.append(f"the board's shape was looked for: its print is bent by {warp.range_mm():.3f} mm")
    if coverage < _COVERAGE_MIN:
        notes.append(f"board corners cover {coverage:.0%} of the image: elsewhere the lens is extrapolated")
    figures = {
        "corners_rms_px": rms_px,
        "corners_std_px": adjusted.corner_std_px,
        "corners_left_out": float(1.0 - adjusted.corner_used.mean()),
        "corners_systematic_px": systematic_px,
        "corners_coverage": coverage,
    }
    return figures | shape, notes


def _of_travel(adjusted: Adjusted) -> tuple[dict[str, float], str]:
    """Way of the belt per count, and its direction in the belt's frame."""
    way, at = adjusted.geometry.travel, adjusted.unknowns.travel
    size = float(np.sqrt(way @ way))
    std = float(np.sqrt(way @ adjusted.covariance[np.ix_(at, at)] @ way)) / size
    x, y, z = belt_pose(adjusted.geometry.belt)[:3, :3] @ way / size
    said = (
        f"the belt runs {size:.6g} ± {std:.1g} mm per count, at {np.degrees(np.arctan2(y, x)):.2f}° from X "
        f"towards Y, {np.degrees(np.arcsin(z)):.2f}° out of its plane"
    )
    return {"mm_per_count": size, "mm_per_count_std": std}, said


def _check_planes_pass_by(adjusted: Adjusted) -> None:
    """A plane through the camera's centre is seen edge on: no height moves its stripe."""
    geometry = adjusted.geometry
    # 1/|p| is the distance of a plane from the camera's centre
    past = 1.0 / np.sqrt((geometry.planes**2).sum(axis=1))
    away = 1.0 / float(np.sqrt((geometry.belt**2).sum()))
    worst = int(past.argmin())
    if past[worst] < _GRAZING_MIN * away:
        raise CalibrationError(
            f"the plane of stripe {worst + 1} passes the camera's centre by {past[worst]:.1f} mm only "
            f"({past[worst] / away:.1%} of the distance to the belt): heights would hardly move the stripe",
            hint="move the laser away from the camera, sideways",
        )


def _outlier_share(joined: JointAdjustment) -> float:
    """Share of the stripe peaks that are left out as far off, those on uneven print apart."""
    used = joined.adjusted.stripe_used
    # left out before the adjustment, and in it
    return 1.0 - (1.0 - joined.outlier_share) * (float(used.mean()) if used.size else 1.0)


def _check_used(joined: JointAdjustment) -> None:
    """Refuse where too much was left out as far off."""
    adjusted, stripe = joined.adjusted, joined.measured.points.stripe
    marks = 1.0 - float(adjusted.corner_used.mean()) if adjusted.corner_used.size else 0.0
    shares = [("board corners", marks, _USED_MIN), ("stripe peaks", _outlier_share(joined), _USED_MIN)]
    for number in np.unique(stripe):
        left = 1.0 - float(adjusted.stripe_used[stripe == number].mean())
        shares.append((f"peaks of stripe {number + 1}", left, _STRIPE_USED_MIN))
    for what, left, least in shares:
        if left > 1.0 - least:
            raise CalibrationError(
                f"{left:.0%} of the {what} do not fit: what was seen is not one rigid rig",
                hint="did the camera, the laser or the board move or bend between the images?",
            )


def _check_planes(adjusted: Adjusted, joined: JointAdjustment) -> None:
    """Refuse where a stripe's points do not lie in one plane, by the others' residuals or by those stated."""
    points = joined.measured.points
    stripes = np.unique(points.stripe)
    if not stripes.size:
        return
    rms_px = np.array([_rms(adjusted.stripe_px[points.stripe == one]) for one in stripes])
    stated_px = np.array([_rms(points.std_px[points.stripe == one]) for one in stripes])
    worst = int(rms_px.argmax())
    usual = float(np.median(rms_px))
    if stripes.size > 2 and rms_px[worst] > max(_PLANE_FACTOR_MAX * usual, _PLANE_RMS_MIN_PX):
        raise CalibrationError(
            f"stripe {stripes[worst] + 1} does not lie in one plane: its points are off by "
            f"{rms_px[worst]:.2f} px (rms), those of the others by {usual:.2f} px",
            hint="look for a reflection, a bent board, or a laser that moved between the images",
        )
    # by what is stated, but never below half a pixel nor above two
    limit = np.clip(_STATED_FACTOR_MAX * stated_px, _PLANE_RMS_MIN_PX, _PLANE_RMS_MAX_PX)
    worst = int((rms_px / limit).argmax())
    if rms_px[worst] > limit[worst]:
        raise CalibrationError(
            f"stripe {stripes[worst] + 1} does not lie in one plane: its points are off by "
            f"{rms_px[worst]:.2f} px (rms), {stated_px[worst]:.2f} px is what the extractor states of them",
            hint="is what was found the laser's line, and not a reflection or a lamp? is the board flat, its "
            "pitch right, and did nothing move between the two images of a pose?",
        )


def _systematic(adjusted: Adjusted, first: InitialCamera, size: tuple[int, int]) -> tuple[float, float]:
    """Part of the marks' residuals that neighbours in the image share, px, and the share of cells with marks.

    Squares of the means over cells of the image, less what noise alone gives them.
    """
    xy = np.concatenate([view.marks.xy_px for view in first.views])
    cell = np.clip((xy / np.array([size[1], size[0]]) * _CELLS).astype(int), 0, _CELLS - 1) @ [1, _CELLS]
    used = adjusted.corner_used
    excess, weight = 0.0, 0
    for number in range(_CELLS * _CELLS):
        inside = adjusted.corner_px[used & (cell == number)]
        if len(inside) < _CELL_MARKS_MIN:
            continue
        # squared mean of a cell, less what the noise of its marks gives it
        share = float((inside.mean(axis=0) ** 2).mean() - inside.var(axis=0).mean() / len(inside))
        excess += len(inside) * share
        weight += len(inside)
    systematic = np.sqrt(max(excess / weight, 0.0)) if weight else 0.0
    return float(systematic), float(np.unique(cell).size / _CELLS**2)


def _heights_reached(joined: JointAdjustment) -> tuple[float, float]:
    """Least and greatest height over the belt of the boards' middles, or of solids, mm; 0 without either."""
    geometry = joined.adjusted.geometry
    if joined.solids is not None:
        return 0.0, max(shape.height_mm for shape in joined.solids.shapes)
    if joined.board is None:
        return 0.0, 0.0
    middle = np.zeros((len(geometry.shift), 3, 1))
    for pose, view in zip(joined.pose, joined.first.views, strict=True):
        middle[pose, :2, 0] = 0.5 * view.board.size_mm
    at: Floats = (geometry.rotation @ middle)[:, :, 0] + geometry.shift
    height = (1.0 - at @ geometry.belt) / np.sqrt(geometry.belt @ geometry.belt)
    return float(height.min()), float(max(height.max(), 1.0))


_FOLDS = 5  # views are left out in five parts: four fifths of the views still calibrate nearly as well as all
_POSES_MIN = 4  # poses that must be left to calibrate from


class CrossValidation(NamedTuple):
    """Errors of a calibration at views that were held out of it."""

    mark_px: Floats
    mark_at_px: Floats
    mark_pose: Integers
    """mark_px, mark_at_px, mark_pose: (mark, 2) seen less predicted, and where, and (mark,) pose; each
    board's pose is found from its own marks."""
    height_mm: Floats
    height_at_px: Floats
    height_pose: Integers
    height_stripe: Integers
    """height_…: (point,) measured less true height, along the belt's normal, of stripe points on the held-out
    boards, whose marks say where they are; (point, 2) where in the image; (point,) pose and stripe."""
    skipped: int
    """Poses that cannot be spared: without them the rest determines no calibration."""


def cross_validate(measured: Measured, found: Geometry) -> CrossValidation:
    """Leave every fifth pose out in turn; boards that lie on the belt always stay.

    What the adjustment of all found is a start for those of less.
    """
    poses = np.unique(measured.corners.pose)
    # boards on the belt tell where it is: they are never left out
    spare = np.setdiff1d(poses, measured.contacts.pose)
    folds = min(_FOLDS, spare.size)
    parts: list[tuple[Any, ...]] = []
    skipped = 0
    for fold in range(folds):
        # every so many-th, so that each part holds poses from all of the sequence
        out = spare[fold::folds]
        try:
            geometry = _calibrated(measured, np.setdiff1d(poses, out), found)
        except CalibrationError:
            skipped += out.size
            continue
        for pose in out:
            # the board's pose from its own marks, with that camera
            start = replace(found, camera=geometry.camera, warp=geometry.warp)
            alone = measured.of(np.array([pose]), start)
            unknowns = unknowns_of(alone.start, free_camera=np.zeros(CAMERA, np.bool_))
            board = Measured(alone.start, unknowns, alone.corners).adjusted().geometry
            off = -corner_residuals(board, alone.corners).reshape(-1, 2)
            points = chosen(measured.points, measured.points.pose == pose)
            at = points.xy_px
            marks = off, alone.corners.xy_px, np.full(len(off), pose)
            parts.append((*marks, _heights(geometry, board, points), at, points.pose, points.stripe))
    none, both, whole = np.empty(0), np.empty((0, 2)), np.empty(0, np.int64)
    columns = zip((both, both, whole, none, both, whole, whole), *parts, strict=True)
    joined: list[Any] = [*(np.concatenate(column) for column in columns), skipped]
    return CrossValidation(*joined)


def lifted(geometry: Geometry, points: StripePoints) -> Floats:
    """Give (point, 3) where the points' rays meet their planes of light, camera frame, mm."""
    ray = rays(geometry.camera, points.xy_px)
    return np.asarray(ray / (ray * geometry.planes[points.stripe]).sum(axis=1)[:, None])


def _heights(geometry: Geometry, board: Geometry, points: StripePoints) -> Floats:
    """Heights over the board's surface along the belt's normal, mm."""
    normal, place = board.rotation[0][:, 2], board.shift[0] + points.counts[:, None] * geometry.travel
    up = -geometry.belt / np.sqrt(geometry.belt @ geometry.belt)
    away = lifted(geometry, points) - place
    off = away @ normal
    if board.warp is not None:
        off = off - board.warp.height_mm((away @ board.rotation[0])[:, :2])
    # from along the board's normal to along the belt's
    return np.asarray(off / (normal @ up))


def _calibrated(measured: Measured, kept: Integers, found: Geometry) -> Geometry:
    """Adjust without the others; raise CalibrationError where a stripe or the lens is then not determined."""
    if kept.size < _POSES_MIN:
        raise CalibrationError(f"{kept.size} poses are left")
    less = measured.of(kept, found)
    for stripe in range(found.stripe_count):
        if np.unique(less.points.pose[less.points.stripe == stripe]).size < 2:
            raise CalibrationError(f"stripe {stripe + 1} is left on one surface")
    return less.adjusted().geometry


def stripe_offsets(geometry: Geometry, points: StripePoints) -> tuple[Floats, Floats, Integers]:
    """Say how far stripes are apart on one surface: a plane through all their points, each stripe's mean.

    Gives (n,) mean distance from the plane of a stripe's points on one surface, mm, positive towards the
    camera, (n, 2) where their middle is in the image, px, and (n,) pose of the surface, −1 of the belt.
    """
    offset, at, surface = [], [], []
    xyz = lifted(geometry, points)
    if geometry.warp is not None and points.face is None:
        # as if the board's print were its plane
        on = np.flatnonzero(points.pose != ON_BELT)
        rotation, place = geometry.rotation[points.pose[on]], geometry.shift[points.pose[on]]
        place = place + points.counts[on, None] * geometry.travel
        there = ((xyz[on] - place)[:, None, :] @ rotation)[:, 0, :2]
        xyz[on] -= geometry.warp.height_mm(there)[:, None] * rotation[:, :, 2]
    level = np.zeros(points.pose.size, np.int64)
    if points.face is not None:
        level = np.unique(points.face, axis=0, return_inverse=True)[1].ravel()
    # one plane for each surface: pose and face
    for pose, number in np.unique(np.column_stack([points.pose, level]), axis=0):
        on = np.flatnonzero((points.pose == pose) & (level == number))
        stripes = np.unique(points.stripe[on])
        if stripes.size < _STRIPES_MIN or (pose == ON_BELT and np.ptp(points.counts[on]) > 0):
            continue
        middle = xyz[on].mean(axis=0)
        # the direction of least spread
        normal = np.linalg.svd(xyz[on] - middle, full_matrices=False)[2][2]
        # towards the camera, which looks along +z
        normal = normal * (-1.0 if normal[2] > 0 else 1.0)
        for stripe in stripes:
            mine = on[points.stripe[on] == stripe]
            offset.append(float(((xyz[mine] - middle) @ normal).mean()))
            at.append([points.x_px[mine].mean(), points.row_px[mine].mean()])
            surface.append(pose)
    return np.array(offset), np.array(at).reshape(-1, 2), np.array(surface, np.int64)


_STRIPES_MIN = 4  # stripes on a surface: through three a plane fits always


_WORSE_MAX = 1.5
"""Marks of other views over those used: half as large again means that the lens was fitted to noise."""
_COVERAGE_TOLD_MIN = 0.7  # of the cells with marks: with fewer it is told
_STRAYS_TOLD = 0.1
"""A tenth of the peaks far off is more than noise and the odd reflection give (0 to 4 % on sound sets)."""
_NOISE_TOLD = 2.0
"""See `_STATED_FACTOR_MAX`: above this, the stripes have errors that the extractor does not know of."""
_UNUSABLE = 10.0
"""Times the limit of a thousandth of the height range: heights are off by a hundredth of the range."""


def evidence_of(joined: JointAdjustment, calibration: Calibration) -> Evidence:
    """Show what speaks for a calibration, and judge it in words."""
    held = cross_validate(joined.measured, joined.adjusted.geometry)
    offsets = stripe_offsets(joined.adjusted.geometry, joined.measured.points)
    figures = _figures(joined, held, offsets[0], calibration)
    judging = [figures[key] for key in ("bias", "agree") if key in figures]
    usable = not any(one.value > _UNUSABLE * one.limit for one in judging)
    verdict = _verdict(figures, held, calibration, usable=usable)
    return Evidence(verdict, tuple(figures.values()), _residuals(joined, held, offsets), usable)


def _residuals(
    joined: JointAdjustment, held: CrossValidation, offsets: tuple[Floats, Floats, Integers]
) -> tuple[Residuals, ...]:
    adjusted, measured = joined.adjusted, joined.measured
    marks, used = measured.corners, adjusted.corner_used
    points, seen = measured.points, adjusted.stripe_used
    peaks_px = points.xy_px
    shown = [
        Residuals(
            f"board corners, {axis}", "px", marks.xy_px[used], -adjusted.corner_px[used, n], marks.pose[used],
            f"Board corners, {axis} in the image; group: the view.",
        )
        for n, axis in enumerate("xy")
    ]  # fmt: skip
    shown += [
        Residuals(
            f"board corners of held-out views, {axis}", "px", held.mark_at_px, held.mark_px[:, n],
            held.mark_pose,
            "Each fifth view was left out in turn; the board's pose is its own, the camera that of the rest.",
            held_out=True,
        )
        for n, axis in enumerate("xy")
    ]  # fmt: skip
    shown += [
        Residuals(
            "stripe peaks", "px", peaks_px[seen], adjusted.stripe_px[seen], points.stripe[seen],
            "Means over a few rows, along the row, on boards and belt; group: the stripe.",
        ),
        Residuals(
            "heights on held-out views", "mm", held.height_at_px, held.height_mm, held.height_stripe,
            "Stripe points on boards that were left out, against the place their corners give; group: the "
            "stripe.",
            held_out=True,
        ),
        Residuals(
            "stripes against each other", "mm", offsets[1], offsets[0], np.maximum(offsets[2], 0),
            "Mean distance of each stripe's points from the plane through those of all stripes on the same "
            "board or belt; group: the view.",
        ),
    ]  # fmt: skip
    return tuple(one for one in shown if len(one.error))


def _figures(
    joined: JointAdjustment, held: CrossValidation, offset_mm: Floats, calibration: Calibration
) -> dict[str, EvidenceFigure]:
    adjusted, residuals = joined.adjusted, calibration.residuals
    found = {}
    # 20 µm of 20 mm: heights then err by less than a product's volume is asked for
    thousandth_mm = 1e-3 * (calibration.height_range_mm[1] - calibration.height_range_mm[0])
    covered = residuals.get("corners_coverage", residuals.get("marks_coverage"))  # of older files
    if covered is not None:
        title, limit = "part of the image without board corners", 1.0 - _COVERAGE_TOLD_MIN
        found["coverage"] = EvidenceFigure(title, 1.0 - covered, "1", "6 × 6 cells", limit)
    if held.mark_px.size:
        found["corners"] = EvidenceFigure(
            "board corners of held-out views over those used, rms",
            _robust_rms(held.mark_px) / max(_rms(adjusted.corner_px[adjusted.corner_used]), 1e-12),
            "1",
            "cross-validation, every fifth view left out in turn",
            _WORSE_MAX,
        )
    if held.height_mm.size:
        boards = np.unique(held.height_pose)
        means = np.array([held.height_mm[held.height_pose == one].mean() for one in boards])
        title, basis = (
            "heights on held-out views, single points, rms",
            "means over a few rows, random part included",
        )
        found["heights"] = EvidenceFigure(title, _robust_rms(held.height_mm), "mm", basis)
        found["bias"] = EvidenceFigure(
            "heights on held-out views, mean of a board, rms",
            _rms(means),
            "mm",
            f"{means.size} boards; at most a thousandth of the height range",
            thousandth_mm,
        )
    found["outliers"] = EvidenceFigure(
        "stripe peaks left out as far off",
        residuals["stripes_left_out"],
        "1",
        f"besides {joined.print_share:.0%} on edges of the board's print, which are never used",
        _STRAYS_TOLD,
    )
    found["noise"] = EvidenceFigure(
        "stripe residuals over what the extractor states",
        residuals["stripes_over_stated"],
        "1",
        "rms of means over a few rows",
        _NOISE_TOLD,
    )
    if offset_mm.size:
        found["agree"] = EvidenceFigure(
            "stripes against each other on one surface, rms",
            _rms(offset_mm),
            "mm",
            f"{offset_mm.size} stripes on boards and belt; at most a thousandth of the height range",
            thousandth_mm,
        )
    return found


def _verdict(
    figures: dict[str, EvidenceFigure], held: CrossValidation, calibration: Calibration, *, usable: bool
) -> tuple[str, ...]:
    low, high = calibration.height_range_mm
    over = [key for key, one in figures.items() if one.value > one.limit]
    value = {key: one.value for key, one in figures.items()}
    range_mm = f"from {low:g} to {high:.1f} mm"
    if not usable:
        words = [f"Not usable {range_mm}: heights are off by more than a hundredth of that range, see below."]
    elif over:
        words = [f"Usable {range_mm} with care: {len(over)} of {len(figures)} checks failed, see below."]
    else:
        words = [f"Usable {range_mm}: it passed all checks."]
    if "bias" in figures:
        words.append(
            f"On held-out boards heights are {1e3 * value['heights']:.0f} µm off (rms of "
            f"single points) and {1e3 * value['bias']:.1f} µm in the mean of a board."
        )
    else:
        words.append("No view can be spared: there is no check on held-out views. Take more poses.")
    told = {
        "corners": "Held-out views fit {:.1f} times worse than those it was made from: too few poses for "
        "this lens model, or poses too much alike.",
        "bias": "Held-out boards lie at wrong heights: a bent board, or too few poses.",
        "agree": "Stripes contradict each other by {:.0f} µm on one surface: steps between stripes of that "
        "size are the calibration's, not the product's.",
        "outliers": "{:.0%} of the stripe peaks on even print are far off and not used: look at the laser "
        "images for reflections, a lamp, or a board that moved.",
        "noise": "Stripe peaks scatter {:.1f} times as much as the extractor states: what is stated of "
        "heights by their peaks is too small by so much.",
        "coverage": "Board corners cover {:.0%} of the image: elsewhere the lens is extrapolated, and "
        "heights there are not proven.",
    }
    said = value | {"agree": 1e3 * value.get("agree", 0.0), "coverage": 1.0 - value.get("coverage", 0.0)}
    words += [sentence.format(said[key]) for key, sentence in told.items() if key in over]
    if held.skipped:
        words.append(f"{held.skipped} views could not be left out: the rest determines no calibration.")
    return tuple(words)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _robust_rms(values: Floats) -> float:
    """Rms without what is beyond six times the median: outliers are left out of the adjustment as well."""
    size = np.abs(values)
    return _rms(values[size <= 6.0 * max(float(np.median(size)), 1e-12)])
