"""Lines of two families between each other: each coded by its planes, both by the one surface they lie on.

Model. Every second line is of another colour, and each peak says of which (`Peaks.family`). Within a family
lines stand twice as far apart as all together, so a height that takes a line to its neighbour's place is
twice as large, and `planes` codes each family as if the other were not there. What is then wrong shows:

- Lines of both families alternate on one surface. Where a run of one lies off the lines of the other on both
  its sides by half of what a label is worth or more, in most of its rows, one of them is a line off.
- All lines together are coded as well, as if of one colour. A number that is one off would be of the other
  colour, and so says nothing; another line of the right colour contradicts.

Both are refused. Without families, as of a frame of one channel, it is `planes`. It cannot tell what is wrong
alike in all three. Source: our own.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import AMBIGUOUS, UNLABELLED
from roemetry.stages import Coder
from roemetry_coding.planes import Planes, PlanesOptions
from roemetry_kernels.bridging import bridged
from roemetry_kernels.consistency import required_calibration
from roemetry_kernels.rest_lines import calibrated_rest_lines, reasons_of

_OFF = 0.5
"""Of what a label is worth in height, from which on two lines are not on one surface: flanks between two
lines make a quarter of it."""
_STEP_PX = 3.0
"""From row to row, by which a line that goes on does not move."""
_ROWS_MIN = 8
"""Of a run off the lines of the other family: in fewer rows edges may do that."""


class TwoFamilies(Coder[PlanesOptions]):
    """Codes each family by its planes, and asks whether both lie on one surface."""

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Raises
        ------
        StageError
            What `planes` refuses of either family, which is named.
        """
        if peaks.family is None:
            return Planes(self.options).code(peaks, calibration)
        calibration = required_calibration(calibration, "two-families", "without planes a peak has no height")
        stripe, margin = np.full(len(peaks), UNLABELLED, np.int64), np.full(len(peaks), np.nan)
        for family, name in enumerate(("first", "second")):
            mine = np.flatnonzero(peaks.family == family)
            try:
                coded = Planes(self.options).code(
                    peaks.some(mine, family=None), family_of(calibration, family)
                )
            except StageError as error:
                raise StageError(f"lines of the {name} colour: {error.message}", hint=error.hint) from error
            label = coded.peak_stripe.astype(np.int64)
            # stripes take turns: the first family has the even numbers
            stripe[mine] = np.where(label >= 0, 2 * label + family, label)
            own = np.flatnonzero(label >= 0)
            margin[mine[own]] = coded.margin[label[own], peaks.row[mine[own]]]
        off = _off_the_other(peaks, stripe, calibration) | self._doubted(peaks, stripe, calibration)
        stripe[off] = AMBIGUOUS
        rest = calibrated_rest_lines(peaks, calibration)
        said = reasons_of(rest)
        if off.any():
            said.append(
                Reason(
                    "families-disagree",
                    f"{int(off.sum())} peaks are left out: they do not lie on the surface of the other "
                    "colour, or get another label if both colours are coded together",
                )
            )
        return bridged(
            peaks,
            stripe,
            margin,
            rest,
            longest_gap_rows=self.options.longest_gap_rows,
            smallest_product_points=self.options.smallest_product_points,
            reasons=said,
        )

    def _doubted(self, peaks: Peaks, stripe: Integers, calibration: Calibration) -> Flags:
        """Say which peaks all lines together, coded as if of one colour, give another line of their colour.

        Where that gives them a line of the other colour it is refuted itself.
        """
        try:
            together = Planes(self.options).code(replace(peaks, family=None), calibration).peak_stripe
        except StageError:  # of one colour they are too dense: that says nothing
            return np.zeros(len(peaks), np.bool_)
        # a line of the other colour says nothing
        known = (together >= 0) & (stripe >= 0) & (together % 2 == peaks.family)
        runs = _runs_of(peaks, stripe, calibration.stripe_count)
        return runs.beside(known & (together != stripe), known)


@lru_cache(maxsize=4)
def family_of(calibration: Calibration, family: int) -> Calibration:
    """Give what coders need of a calibration for every second stripe.

    Kept, so that what coders work out of a calibration once is not worked out of every frame.
    """
    view = calibration.view
    return replace(
        calibration,
        rest_px=calibration.rest_px[family::2],
        displacement_px_per_mm=calibration.displacement_px_per_mm[family::2],
        view=None if view is None else replace(view, planes=view.planes[family::2]),
    )


class _Runs(NamedTuple):
    """Runs of rows in which a line's peaks go on without break or step."""

    of: Integers
    """(peak,) run of each; −1 of what has no label."""

    def mostly(self, bad: Flags, known: Flags, *, least: int) -> Flags:
        """Say which peaks are of runs that are bad in most of what is known of them, and in so many."""
        on = self.of >= 0
        count = int(self.of.max(initial=-1)) + 1
        ill, seen = (np.bincount(self.of[on & one], minlength=count) for one in (bad, known))
        refused = np.append((ill >= least) & (2 * ill > seen), False)  # the last is for what has none
        return np.asarray(refused[self.of], np.bool_)

    def beside(self, bad: Flags, known: Flags) -> Flags:
        """Say which peaks are bad or, if they are not known, next to such along their run."""
        order = np.argsort(self.of, kind="stable")  # peaks come by row
        run = self.of[order]
        found = bad.copy()
        for way in (1, -1):
            # the last known place before each, in either direction
            at = np.arange(order.size)
            last = np.maximum.accumulate(np.where(known[order][::way], at, -1))
            there = last >= 0
            there &= run[::way][last] == run[::way]
            found[order[::way]] |= there & (run[::way] >= 0) & bad[order][::way][last]
        return found


def _runs_of(peaks: Peaks, stripe: Integers, stripes: int) -> _Runs:
    on = np.flatnonzero(stripe >= 0)
    x_px = np.full((stripes, peaks.image_size[0]), np.nan)
    x_px[stripe[on], peaks.row[on]] = peaks.x_px[on]
    with np.errstate(invalid="ignore"):
        goes_on = np.abs(np.diff(x_px, axis=1, prepend=np.nan)) < _STEP_PX
    # a new number where a run begins
    run = np.cumsum(np.isfinite(x_px) & ~goes_on).reshape(x_px.shape) - 1
    of = np.full(len(peaks), -1)
    of[on] = run[stripe[on], peaks.row[on]]
    return _Runs(of)


def _off_the_other(peaks: Peaks, stripe: Integers, calibration: Calibration) -> Flags:
    """Say which peaks are of runs that lie off the lines of the other family on both sides."""
    view = calibration.view
    if view is None:
        return np.zeros(len(peaks), np.bool_)
    on = np.flatnonzero(stripe >= 0)
    place = stripe[on], peaks.row[on]
    z = np.full((calibration.stripe_count, peaks.image_size[0]), np.nan)
    z[place] = view.lift(np.column_stack([peaks.x_px[on], peaks.row[on]]), stripe[on])[:, 2]
    between = np.full_like(z, np.nan)
    # the surface at a line, by the lines of the other family on both sides
    between[1:-1] = 0.5 * (z[:-2] + z[2:])
    known, bad = np.zeros(len(peaks), np.bool_), np.zeros(len(peaks), np.bool_)
    known[on] = np.isfinite(between + z)[place]
    with np.errstate(invalid="ignore"):
        bad[on] = (np.abs(z - between) > _OFF * _worth_mm(calibration))[place]
    return _runs_of(peaks, stripe, calibration.stripe_count).mostly(bad, known, least=_ROWS_MIN)


def _worth_mm(calibration: Calibration) -> Floats:
    """Height from a plane to the next one of its family, where a place in the image stays the same."""
    middle = np.array([0.5 * (calibration.image_size[0] - 1)])
    apart = np.diff(calibration.rest_line_px(middle)[::2], axis=0)
    return np.asarray(np.median(np.abs(apart)) / np.median(np.abs(calibration.displacement_px_per_mm)))
