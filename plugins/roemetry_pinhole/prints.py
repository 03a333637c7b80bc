"""Sizes of several boards' prints, against each other and along x and y.

Model. Marks alone do not tell a board's size: a larger one is further away. Stripes do: a board whose print
is larger than described by a factor s lies s times as far away, and only then do its lines lie in the planes
that the first board's poses show. Each line on each plane gives an s; the one that most lines share is the
start, and in the joint adjustment each further board has a size of its own. Compared with what is described,
that checks the scale, as a block does.

A stretched print (paper drawn through a printer) shows in boards that are tilted and turned in different
ways: one more step of the adjustment, with each board's y apart from its x, tells by how much.

It fails where the first board is seen in fewer than two poses, since its planes judge the others' sizes, and
for prints that are off by more than a factor of e^0.3 (`_SIZE_MAX`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roemetry.records import Board
from roemetry.records.arrays import Floats, Integers
from roemetry_pinhole.boards import BoardView
from roemetry_pinhole.bundle import Adjusted, Measured
from roemetry_pinhole.numbering import PoseLines, distances, planes_of, spacing_mm

_SIZE_MAX = 0.3  # of the logarithm: nobody describes a print so wrongly
_TRIED = 6  # sizes that are tried in full: the right one and those at which the neighbours' planes fit
_ON_PLANE = 0.1  # of the spacing of stripes: a line that is further from each plane lies on none
_ALIKE = 0.01  # difference of the logarithms by a line's two ends: more, and the line is not this plane's
_STRETCH_STDS, _STRETCH_MIN = 5.0, 0.002  # a stretch is told from here on: 0.2 % is what printers do
_NOT_SQUARE = 0.004
"""Where boards all lie alike in the image fx over fy takes the stretch: from here on it is told."""
_SQUARE = 0.001
"""Pixels are as square as this. Bent boards seem stretched as well (two real sets by 0.6 and 0.9 %), but then
fx and fy come apart, where a real stretch lets them agree."""


def first_sizes(poses: Sequence[PoseLines], boards: Integers) -> Floats:
    """Give (board,) how much larger each print is than described, by the planes that the first one shows.

    With equal spacing another stripe's planes fit nearly as well at another size; of the sizes on which many
    lines agree, the one is taken at which all lines lie nearest to the planes they then make.
    """
    sizes = np.ones(int(boards.max(initial=0)) + 1)
    mine = [pose for pose, board in zip(poses, boards, strict=True) if board == 0]
    if len(mine) < 2:
        return sizes
    for other in np.unique(boards[boards > 0]):
        theirs = [pose for pose, board in zip(poses, boards, strict=True) if board == other]
        found = []
        for size in _likely(theirs, planes_of(mine, belt_shows_all=False)[0]):
            scaled = [*mine, *(replace(pose, ends_mm=size * pose.ends_mm) for pose in theirs)]
            found.append((_misfit(scaled), size))
        sizes[other] = min(found)[1] if found else 1.0
    return sizes


def _likely(poses: Sequence[PoseLines], planes: Floats) -> Floats:
    """Give the sizes on which most lines agree, the likeliest first."""
    found, weight = [], []
    for pose in poses:
        with np.errstate(divide="ignore", invalid="ignore"):
            # p·X = 1 at the right size, so each end says 1/(p·X)
            size = -np.log(pose.ends_mm @ planes.T)  # (line, end, plane)
        at = size.mean(axis=1)
        good = (np.abs(size[:, 0] - size[:, 1]) < _ALIKE) & (np.abs(at) < _SIZE_MAX)
        found.append(at[good])
        weight.append(np.broadcast_to(pose.weight[:, None], at.shape)[good])
    at, counts = np.concatenate(found), np.concatenate(weight)
    sizes: list[float] = []
    while at.size and len(sizes) < _TRIED:
        # the size that most lines are near, by their light
        near = np.abs(at[:, None] - at) < 0.5 * _ALIKE
        best = float(np.median(at[near[(near @ counts).argmax()]]))
        sizes.append(best)
        others = np.abs(at - best) > _ALIKE
        at, counts = at[others], counts[others]
    return np.exp(sizes)


def _misfit(poses: list[PoseLines]) -> float:
    """Give the mean distance of lines from the planes they make; what lies on none counts 1."""
    planes = planes_of(poses, belt_shows_all=False)[0]
    if not len(planes):
        return 1.0
    off = np.concatenate([distances(pose, planes).min(axis=1) for pose in poses]) / spacing_mm(poses)
    return float(
        np.average(np.minimum(off / _ON_PLANE, 1.0), weights=np.concatenate([p.weight for p in poses]))
    )


def tolerance_of(board: Board) -> float:
    """Give the relative standard uncertainty of a board's lengths."""
    return float(board.tolerance_mm / np.sqrt(3.0) / board.size_mm.max())


def stretched(measured: Measured, found: Adjusted, views: Sequence[BoardView]) -> list[str]:
    """Say which prints seem longer along y than described, against x, and what to do."""
    boards = {view.number: view.board for view in views}
    count = max(boards) + 1
    free = np.zeros((count, 2), np.bool_)
    free[: len(found.unknowns.prints), 0] = found.unknowns.prints[:, 0] >= 0
    free[list(boards), 1] = True
    geometry = replace(found.geometry, prints=np.zeros((count, 2)))
    geometry.prints[: len(found.geometry.prints)] = found.geometry.prints
    unknowns = found.unknowns.of(geometry, free)
    moved, covariance = replace(measured, unknowns=unknowns).step_of(replace(found, geometry=geometry))
    before, after = (abs(float(np.log(one.camera[1] / one.camera[0]))) for one in (geometry, moved))
    said = []
    fx, fy = found.unknowns.camera[:2]
    way = np.zeros(len(found.covariance))
    way[[fx, fy]] = -1.0 / geometry.camera[0], 1.0 / geometry.camera[1]
    # all boards alike: the camera takes the stretch
    if before > max(_STRETCH_STDS * float(np.sqrt(way @ found.covariance @ way)), _NOT_SQUARE):
        said.append(
            f"fx and fy differ by {before:.2%}, and pixels of nearly all cameras are square: is the print of "
            "a board stretched? Measure the pitch along both sides; state pitch_mm (x) and row_pitch_mm (y)"
        )
    for number, board in boards.items():
        at = unknowns.prints[number, 1]
        stretch, std = float(moved.prints[number, 1]), float(np.sqrt(covariance[at, at]))
        if abs(stretch) > max(_STRETCH_STDS * std, _STRETCH_MIN) and after < max(before, _SQUARE):
            said.append(
                f"the print of the board {board.name} seems stretched: along y {np.exp(stretch):.4f} ± "
                f"{std:.4f} times as long, against x, as described. Measure the pitch along both sides, and "
                "state pitch_mm (x) and row_pitch_mm (y)"
            )
    return said
