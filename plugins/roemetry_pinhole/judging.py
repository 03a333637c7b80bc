"""What the adjustment's residuals say, in figures and words; and what they forbid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError
from roemetry_pinhole.adjustment import Adjusted
from roemetry_pinhole.first_camera import FirstCamera
from roemetry_pinhole.frames import belt_pose
from roemetry_pinhole.joining import Joint

_CELLS = 6
_CELL_MARKS_MIN = 8
_SYSTEMATIC_MAX_PX = 0.4
_SYSTEMATIC_SHARE_MAX = 0.5
_COVERAGE_MIN = 0.4
_PLANE_FACTOR_MAX = 5.0
_PLANE_RMS_MIN_PX = 0.5
_GRAZING_MIN = 0.02
_USED_MIN = 0.75
_SYSTEMATIC_TOLD_PX = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class Verdict:
    """Figures for the calibration file, sentences for its reader, and the height the boards reached, mm."""

    residuals: dict[str, float]
    notes: tuple[str, ...]
    height_max_mm: float


def judged(joined: Joint, *, scale_is_known: bool = True) -> Verdict:
    """Judge an adjustment; `scale_is_known` says whether the board's pitch is what lengths come from.

    Raises
    ------
    CalibrationError
        A plane goes nearly through the camera; stripes do not lie in planes; residuals are no noise.
    """
    adjusted = joined.adjusted
    _check_planes_pass_by(adjusted)
    _check_used(adjusted)
    _check_planes(adjusted, joined)
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
        notes.append(
            "stripes and marks contradict each other a little: stripes count "
            f"{adjusted.conflict:.0f} times less than their scatter would allow"
        )
    used = adjusted.stripe_used
    residuals |= {
        "stripes_rms_px": float(np.sqrt((adjusted.stripe_px[used] ** 2).mean())),
        "stripes_left_out": 1.0 - (1.0 - joined.left_share) * float(used.mean()),
        "stripes_correlation": adjusted.correlation,
        "poses": float(len(joined.first.views)),
    }
    return Verdict(residuals, tuple(notes), _height_reached(joined))


def _of_marks(joined: Joint, *, scale_is_known: bool) -> tuple[dict[str, float], list[str]]:
    """Figures and notes of the boards' marks."""
    adjusted = joined.adjusted
    rms_px = float(np.sqrt((adjusted.corner_px[adjusted.corner_used] ** 2).sum(axis=1).mean()))
    systematic_px, coverage = _systematic(adjusted, joined.first, joined.size)
    if systematic_px > max(_SYSTEMATIC_MAX_PX, _SYSTEMATIC_SHARE_MAX * adjusted.corner_std_px):
        raise CalibrationError(
            f"the residuals are not noise: neighbouring marks are off together, by {systematic_px:.2f} px",
            hint="take another lens model (calibrator.options.lens), a flat board or `flatness: free`, "
            "and a sharp lens",
        )
    notes = []
    if systematic_px > max(_SYSTEMATIC_TOLD_PX, _SYSTEMATIC_SHARE_MAX * adjusted.corner_std_px):
        notes.append(
            "the residuals are not noise alone: neighbouring marks are off together by "
            f"{systematic_px:.2f} of {adjusted.corner_std_px:.2f} px; stated uncertainties are too small"
        )
    if joined.board is not None and joined.solids is None and scale_is_known:
        notes.append(f"scale: from the board's pitch of {joined.board.pitch_mm:g} mm")
    bend = adjusted.geometry.bend
    shape = {} if bend is None else {"board_bend_mm": bend.range_mm()}
    if bend is not None:
        notes.append(f"the board's shape was looked for: its print is bent by {bend.range_mm():.3f} mm")
    if coverage < _COVERAGE_MIN:
        notes.append(f"marks cover {coverage:.0%} of the image: elsewhere the lens is extrapolated")
    figures = {
        "marks_rms_px": rms_px,
        "marks_std_px": adjusted.corner_std_px,
        "marks_left_out": float(1.0 - adjusted.corner_used.mean()),
        "marks_systematic_px": systematic_px,
        "marks_coverage": coverage,
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
    past = 1.0 / np.sqrt((geometry.planes**2).sum(axis=1))
    away = 1.0 / float(np.sqrt((geometry.belt**2).sum()))
    worst = int(past.argmin())
    if past[worst] < _GRAZING_MIN * away:
        raise CalibrationError(
            f"the plane of stripe {worst + 1} passes the camera's centre by {past[worst]:.1f} mm only "
            f"({past[worst] / away:.1%} of the distance to the belt): heights would hardly move the stripe",
            hint="move the laser away from the camera, sideways",
        )


def _check_used(adjusted: Adjusted) -> None:
    for what, used in (("marks", adjusted.corner_used), ("stripe peaks", adjusted.stripe_used)):
        if used.size and used.mean() < _USED_MIN:
            raise CalibrationError(
                f"{1.0 - used.mean():.0%} of the {what} do not fit: what was seen is not one rigid rig",
                hint="did the camera, the laser or the board move or bend between the images?",
            )


def _check_planes(adjusted: Adjusted, joined: Joint) -> None:
    """Each stripe's points on all boards must lie in one plane as well as the others' do."""
    points = joined.measured.points
    rms = np.array(
        [
            np.sqrt((adjusted.stripe_px[points.stripe == stripe] ** 2).mean())
            for stripe in range(adjusted.geometry.stripe_count)
        ]
    )
    worst = int(rms.argmax())
    usual = float(np.median(rms)) if rms.size > 2 else adjusted.stripe_scale
    if rms[worst] > max(_PLANE_FACTOR_MAX * usual, _PLANE_RMS_MIN_PX) and rms.size > 2:
        raise CalibrationError(
            f"stripe {worst + 1} does not lie in one plane: its points are off by {rms[worst]:.2f} px (rms), "
            f"those of the others by {usual:.2f} px",
            hint="look for a reflection, a bent board, or a laser that moved between the images",
        )


def _systematic(adjusted: Adjusted, first: FirstCamera, size: tuple[int, int]) -> tuple[float, float]:
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
        share = float((inside.mean(axis=0) ** 2).mean() - inside.var(axis=0).mean() / len(inside))
        excess += len(inside) * share
        weight += len(inside)
    systematic = np.sqrt(max(excess / weight, 0.0)) if weight else 0.0
    return float(systematic), float(np.unique(cell).size / _CELLS**2)


def _height_reached(joined: Joint) -> float:
    """Greatest height over the belt of the boards' middles, or of the solids, mm; 0 where there are none."""
    geometry, board = joined.adjusted.geometry, joined.board
    if joined.solids is not None:
        return max(shape.height_mm for shape in joined.solids.shapes)
    if board is None:
        return 0.0
    middle = 0.5 * board.pitch_mm * np.array([board.columns, board.rows, 0.0])
    at: Floats = geometry.rotation @ middle + geometry.shift
    height = (1.0 - at @ geometry.belt) / np.sqrt(geometry.belt @ geometry.belt)
    return float(max(height.max(), 1.0))
