"""Where lengths come from, and references that check them.

Model. All lengths of a calibration grow together with the target they come from: the board's pitch, or
solids on the belt. A second reference (block, staircase, pyramid, sphere plate, ruler, encoder) is measured
with the calibration, and the ratio to its description must be 1 within three standard uncertainties, of
which the calibration's part follows from derivatives by its parameters; else both are named. With `scale:
free` the board's pitch is looked for: the references' weighted mean ratio scales the board until it is 1,
and the covariance follows. Solids that give the planes are checked by leaving each kind out in turn.

What it cannot see: one reference alone that is described wrongly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry_pinhole.bundle import with_disagreement
from roemetry_pinhole.from_solids import solids_in
from roemetry_pinhole.geometry import BoardWarp
from roemetry_pinhole.joint_adjustment import JointAdjustment
from roemetry_pinhole.pinhole_plane import by_parameter, flat, lines_at_height, parameters_of, points_of
from roemetry_pinhole.plates import BELT_MM, plate_scale
from roemetry_pinhole.prints import tolerance_of


def of_lengths(joined: JointAdjustment, parameters: Mapping[str, Floats]) -> Floats:
    """Give the covariance that the targets' own tolerances add to that of the adjustment."""
    mean = flat(parameters)
    found = np.zeros((mean.size, mean.size))
    if joined.solids is not None:
        for geometry in joined.solids.by_tolerance:
            way = flat(parameters_of(geometry, travel=False)) - mean
            found += np.outer(way, way)
    elif joined.board is not None:
        way = by_scale(parameters)
        found = tolerance_of(joined.board) ** 2 * np.outer(way, way)
    return found


def by_scale(parameters: Mapping[str, Floats]) -> Floats:
    """Give (n,) derivatives of the parameters by the logarithm of all lengths."""
    found = {name: np.zeros_like(array) for name, array in parameters.items()}
    for name in ("planes_per_mm", "belt_per_mm"):
        # p and b are 1/mm: they shrink as lengths grow
        found[name] = -parameters[name]
    if "travel_mm_per_count" in parameters:
        found["travel_mm_per_count"] = parameters["travel_mm_per_count"]
    return flat(found)


_ROUNDS_MAX = 8  # of scaling the board: each leaves about the square of the error before
_STILL = 1e-6  # relative change of the scale at which it ends: a hundredth of any reference's uncertainty


def scaled_by_references(
    joined: JointAdjustment, observed: CalibrationSet, made: Callable[[JointAdjustment], Calibration]
) -> Calibration:
    """Make the calibration in which the references have the lengths that are described.

    `joined` is the adjustment with the board's pitch as described, `observed` holds the references' images,
    and `made` gives the calibration of an adjustment, its covariance without that of any length.

    Raises
    ------
    CalibrationError
        There is no reference, or two contradict each other.
    """
    if joined.board is None or joined.solids is not None:
        raise CalibrationError(
            "`scale: free` asks for the scale, but it comes from the solids' own lengths",
            hint="leave `scale: free` out, or show the board under the laser",
        )
    described_mm = joined.board.pitch_mm
    for _ in range(_ROUNDS_MAX):
        calibration = made(joined)
        found, missed = references(calibration, observed, joined=joined)
        if not found:
            raise CalibrationError(
                "`scale: free` needs a reference besides the board, and there is none"
                + "".join(f"\n  {note}" for note in missed),
                hint="add images of a block or a staircase, or encoder_counts with encoder_mm_per_count; if "
                "you measured the board with a ruler, correct pitch_mm and tolerance_mm and leave "
                "`scale: free` out",
            )
        weight = np.array([max(one.std(calibration.covariance), 1e-9) ** -2 for one in found])
        share = weight / weight.sum()
        off = float(share @ np.log([one.ratio for one in found]))
        if abs(off) < _STILL:
            break
        # the board grows until the mean ratio is 1
        joined = rescaled(joined, float(np.exp(-off)))
    covariance = calibration.covariance
    for one, other in combinations(found, 2):
        # what both share of the calibration cancels in the difference
        apart = one.by_parameter - other.by_parameter
        std = float(np.sqrt(one.own_std**2 + other.own_std**2 + apart @ covariance @ apart))
        _check_alike(other.name, one.name, one.what, one.ratio / other.ratio, std, _CALLIPER)
    # all lengths follow −ln ratio, which depends on the parameters and on the references' own errors
    way, slope = by_scale(calibration.parameters), share @ np.array([one.by_parameter for one in found])
    own = float((share**2) @ np.array([one.own_std**2 for one in found]))
    # errors in the direction of scale go; the references' own come in
    kept = np.eye(way.size) - np.outer(way, slope)
    std = float(np.sqrt(own + slope @ covariance @ slope))
    pitch_mm = float(calibration.target["pitch_mm"])
    note = (
        f"scale: looked for, from {', '.join(one.name for one in found)}; the board's pitch comes out as "
        f"{pitch_mm:.5g} mm, {pitch_mm / described_mm:.4f} ± {std:.4f} times what is described"
    )
    residuals = {"pitch_ratio": pitch_mm / described_mm, "pitch_ratio_std": std}
    for one in found if len(found) > 1 else ():
        residuals |= {one.key: one.ratio, f"{one.key}_std": one.std(covariance)}
    return replace(
        calibration,
        covariance=kept @ covariance @ kept.T + own * np.outer(way, way),
        residuals={**calibration.residuals, **residuals},
        notes=(*calibration.notes, note, *missed),
    )


def _check_alike(by: str, name: str, what: str, ratio: float, std: float, hint: str) -> None:
    """Refuse two sources of one scale that contradict each other; `ratio` is that of `what` by `by`."""
    if abs(np.log(ratio)) > CONFLICT_STDS * std:
        raise CalibrationError(
            f"{by} and {name} contradict each other: by the {by} {what} is {ratio:.4f} ± {std:.4f} times "
            "what is described",
            hint=hint,
        )


def rescaled(joined: JointAdjustment, factor: float) -> JointAdjustment:
    """Adjust again with a board that is larger by a factor; what stands under it keeps its thickness."""
    board, measured = joined.board, joined.measured
    assert board is not None, "the scale is that of a board"
    found = joined.adjusted.geometry
    warp = found.warp
    if warp is not None:
        warp = BoardWarp(factor * warp.middle_mm, factor * warp.reach_mm, factor * warp.coefficients_mm)
    prints = found.prints + np.array([np.log(factor), 0.0])
    start = replace(
        found,
        prints=prints * (np.arange(len(prints)) > 0)[:, None],
        shift=factor * found.shift,
        planes=found.planes / factor,
        belt=found.belt / factor,
        travel=factor * found.travel,
        warp=warp,
    )
    corners, contacts = measured.corners, measured.contacts
    # of the first board the marks themselves are enlarged
    size = np.where(corners.board == 0, factor, 1.0)[:, None]
    measured = replace(
        measured,
        start=start,
        corners=replace(corners, board_mm=size * corners.board_mm),
        contacts=replace(contacts, board_mm=contacts.board_mm * [factor, factor, 1.0]),
    )
    marker_mm = None if board.marker_mm is None else factor * board.marker_mm
    return replace(
        joined,
        board=replace(board, pitch_mm=factor * board.pitch_mm, marker_mm=marker_mm),
        measured=measured,
        adjusted=with_disagreement(measured, measured.adjusted()),
    )


CONFLICT_STDS = 3.0
"""Standard uncertainties: two references of one scale differ by more once in 370."""
_STEP_MM = 0.05  # cells of the histogram of heights, mm: below a peak's noise of some 0.1 mm
_POINTS_MIN = 60  # points near a level: fewer gather by chance, for every peak is taken for every stripe


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """A length whose measure does not come from the board."""

    name: str
    key: str
    what: str
    """name, key, what: of the reference, of its ratio among the residuals, and of its length in words."""
    ratio: float
    own_std: float
    """ratio, own_std: what the calibration measures over what is described; its relative standard uncertainty
    without the calibration's part."""
    by_parameter: Floats
    """(n,) derivative of ln ratio by the calibration's parameters, in the order of its covariance."""

    def std(self, covariance: Floats) -> float:
        """Give the ratio's relative standard uncertainty, the calibration's part included."""
        return float(np.sqrt(self.own_std**2 + self.by_parameter @ covariance @ self.by_parameter))

    def checked(self, by: str, covariance: Floats, hint: str) -> tuple[dict[str, float], str]:
        """Give residuals and a note; CalibrationError where it contradicts what the scale comes from."""
        std = self.std(covariance)
        _check_alike(by, self.name, self.what, self.ratio, std, hint)
        note = f"{self.what} comes out {self.ratio:.4f} ± {std:.4f} times as described"
        return {self.key: self.ratio, f"{self.key}_std": std}, note


def check_scale(
    calibration: Calibration, observed: CalibrationSet, joined: JointAdjustment | None = None
) -> dict[str, Any]:
    """Measure solids, the prints and the belt's way; give residuals and notes with what was found.

    Raises
    ------
    CalibrationError
        One contradicts what the scale comes from: the ratio and its uncertainty are told.
    """
    residuals, notes = dict(calibration.residuals), list(calibration.notes)
    kind, board = str(calibration.target.get("kind", "known planes")), observed.board
    by_board = board is not None and kind == board.kind
    board_std = tolerance_of(board) if by_board and board is not None else 0.0
    found, missed = references(calibration, observed, board_std, joined)
    first = "board" if by_board else kind
    if board is not None and by_board and observed.more_boards:
        first = f"board {board.name}"
    if by_board and not found:
        notes.append(_ALONE)
    for one in found:
        figures, note = one.checked(first, calibration.covariance, _HINT if by_board else _CALLIPER)
        residuals |= figures
        notes.append(note)
    return {"residuals": residuals, "notes": (*notes, *missed)}


_ALONE = (
    "lengths rest on the pitch of one board alone: if it is wrong, all of them are, and no image shows it. "
    "Measure the print with a calliper over as many squares as there are; a second board (`more_boards`), a "
    "block or `ruler` checks it"
)
_CALLIPER = "measure both with a calliper, or leave one out"
_HINT = (
    "measure the board's pitch and the reference with a calliper: was the board printed to fit the page? "
    "`scale: free` takes the scale from the reference"
)


def references(
    calibration: Calibration,
    observed: CalibrationSet,
    board_std: float = 0.0,
    joined: JointAdjustment | None = None,
) -> tuple[list[Reference], list[str]]:
    """Give what can be measured with a calibration though it is known, and notes on what was seen.

    `board_std` is the relative standard uncertainty of the board's lengths, where the scale comes from them;
    further boards' prints are among the references where the adjustment `joined` is given.
    """
    found: list[Reference] = []
    notes: list[str] = []
    none = np.zeros(len(calibration.covariance))
    for name in ("block", "staircase", "pyramid"):
        solid, views = getattr(observed, name), observed.showing(name)
        if solid is None or not views:
            continue
        heights = solid.heights_mm if name == "staircase" else (solid.height_mm,)
        seen = [_height(calibration, [view.peaks for view in views], height) for height in heights]
        known = [(m, u, h) for (m, u), h in zip(seen, heights, strict=True) if np.isfinite(m)]
        if not known:
            notes.append(f"the {name} was not found in its images: it checks nothing")
            continue
        measured, stds, height = (np.array(column) for column in zip(*known, strict=True))
        # rectangular tolerance beside the measured scatter
        weight = (np.hypot(stds, solid.tolerance_mm / np.sqrt(3.0)) / height) ** -2
        ratio = float((weight * measured / height).sum() / weight.sum())
        way = _height_by_parameter(calibration, float(height.max()))
        key, what = f"{name}_height_ratio", f"the {name}'s height"
        found.append(Reference(name, key, what, ratio, float(weight.sum() ** -0.5), way))
    plates = [view.peaks for view in observed.showing("sphere_plate")]
    if observed.sphere_plate is not None and plates:
        scale = plate_scale(calibration, plates, observed.sphere_plate)
        if scale is None:
            notes.append("the sphere plate was not found in its images: it checks nothing")
        else:
            what, own = "the sphere plate's lengths", (scale.ratio, scale.own_std, scale.by_parameter)
            found.append(Reference("sphere plate", "sphere_plate_ratio", what, *own))
            notes.append(scale.said)
    board, ruler = observed.board, observed.ruler
    if ruler is not None and board is not None and "pitch_mm" in calibration.target:
        # the pitch is no parameter: what peaks and marks are uncertain by does not change the print's size
        ratio = float(calibration.target["pitch_mm"]) / board.pitch_mm * ruler.printed_mm / ruler.measured_mm
        std = float(np.hypot(ruler.std_mm / ruler.measured_mm, board_std))
        found.append(Reference("ruler", "ruler_ratio", "the print's length", ratio, std, none))
    if observed.mm_per_count is not None and "travel_mm_per_count" in calibration.parameters:
        known_mm, std_mm = observed.mm_per_count
        travel = calibration.parameters["travel_mm_per_count"]
        size = float(np.sqrt(travel @ travel))
        parts = {name: np.zeros_like(array) for name, array in calibration.parameters.items()}
        # derivative of ln |t| by t
        way = flat({**parts, "travel_mm_per_count": travel / size**2})
        what = "the belt's way per encoder count"
        found.append(Reference("encoder", "encoder_ratio", what, size / known_mm, std_mm / known_mm, way))
    if joined is not None:
        at, adjusted = joined.adjusted.unknowns.prints, joined.adjusted
        for number in np.flatnonzero(at[:, 0] >= 0) if at.size else ():
            print_of = observed.boards[number]  # whose size was looked for
            size = float(np.exp(adjusted.geometry.prints[number, 0]))
            seen_std = np.sqrt(adjusted.covariance[at[number, 0], at[number, 0]])
            what = f"the pitch of the board {print_of.name}"
            key, std = (
                f"board_{number + 1}_ratio",
                float(np.hypot(np.hypot(seen_std, tolerance_of(print_of)), board_std)),
            )
            found.append(Reference(f"board {print_of.name}", key, what, size, std, none))
    return found, notes


def _height(calibration: Calibration, images: list[Peaks], height_mm: float) -> tuple[float, float]:
    """Mean height of the points near a level, mm, and its standard uncertainty; NaN where there are few.

    Every peak is taken for every stripe; those of the right stripe gather at one height.
    """
    heights = []
    for peaks in images:
        stripe, peak = (index.ravel() for index in np.indices((calibration.stripe_count, len(peaks))))
        row_px = peaks.row.astype(np.float64)
        at = points_of(calibration.parameters, stripe, peaks.x_px[peak], row_px[peak])
        z = at[:, 2].reshape(calibration.stripe_count, -1)
        # what may be belt on any stripe is not used
        on_belt = (np.abs(z) < BELT_MM).any(axis=0)
        heights.append(z[:, ~on_belt].ravel())
    z = np.concatenate(heights)
    room = 0.08 * height_mm + 0.3
    z = z[np.abs(z - height_mm) < room]
    if z.size < _POINTS_MIN:
        return np.nan, np.nan
    # heights of wrong stripes spread, those of the right one gather
    count, edge = np.histogram(z, np.arange(height_mm - room, height_mm + room + _STEP_MM, _STEP_MM))
    smooth = np.convolve(count, np.ones(3), "same")
    peak_mm = float(edge[smooth.argmax()]) + 0.5 * _STEP_MM
    for _ in range(4):
        near = z[np.abs(z - peak_mm) < 0.25]
        if near.size < _POINTS_MIN:
            return np.nan, np.nan
        peak_mm = float(near.mean())
    # twelve parts: neighbours' noise hangs together
    batches = np.array([part.mean() for part in np.array_split(near, 12)])
    return peak_mm, float(batches.std(ddof=1) / np.sqrt(12.0))


def _height_by_parameter(calibration: Calibration, height_mm: float) -> Floats:
    """Give (n,) derivatives of ln(height) in the image's middle row by the calibration's parameters."""
    parameters = calibration.parameters
    row = np.array([(calibration.image_size[0] - 1) / 2.0])
    x_px = lines_at_height(parameters, row, height_mm)[:, 0]
    good = np.flatnonzero(np.isfinite(x_px))
    places = good, x_px[good], np.full(good.size, row[0])
    return by_parameter(calibration, lambda drawn: points_of(drawn, *places)[:, 2].mean()) / height_mm


def with_solid_checks(
    calibration: Calibration, observed: CalibrationSet, made: Callable[[CalibrationSet], Calibration]
) -> dict[str, Any]:
    """Give residuals and notes of a calibration from solids with what its other targets say."""
    residuals, notes = check_solids(observed, made)
    found = replace(
        calibration, residuals={**calibration.residuals, **residuals}, notes=(*calibration.notes, *notes)
    )
    # no board's print is what this scale comes from
    kinds = [shows for shows, _ in solids_in(observed)] or ["sphere_plate"]
    return check_scale(found, replace(_without(observed, kinds), ruler=None))


def check_solids(
    observed: CalibrationSet, made: Callable[[CalibrationSet], Calibration]
) -> tuple[dict[str, float], list[str]]:
    """Leave out each kind of solid in turn, and measure it with what the others give.

    `made` gives the calibration of a set, or raises CalibrationError. Gives residuals and notes; of solids
    that the others could not do without, a note.

    Raises
    ------
    CalibrationError
        One contradicts the others: the ratio and its uncertainty are told.
    """
    residuals: dict[str, float] = {}
    notes: list[str] = []
    kinds = list(dict.fromkeys(shows for shows, _ in solids_in(observed)))
    for left in kinds if len(kinds) > 1 else ():
        others = [kind for kind in kinds if kind != left]
        try:
            calibration = made(_without(observed, [left]))
        except CalibrationError as error:
            notes.append(f"{left}: not checked: without it there is no calibration: {error.message}")
            continue
        found, said = references(calibration, replace(_without(observed, others), mm_per_count=None))
        notes += said
        for one in (one for one in found if one.name == left):
            figures, note = one.checked(", ".join(others), calibration.covariance, _CALLIPER)
            residuals |= figures
            notes.append(f"{note} by the {', '.join(others)} alone")
    return residuals, notes


def _without(observed: CalibrationSet, kinds: list[str]) -> CalibrationSet:
    gone: dict[str, Any] = dict.fromkeys(kinds)
    kept = tuple(one for one in observed.observations if one.shows not in kinds)
    return replace(observed, observations=kept, **gone)
