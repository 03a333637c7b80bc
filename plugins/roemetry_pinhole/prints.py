"""Sizes of several boards' prints, against each other and along x and y.

Model. Marks alone do not tell a board's size: a larger one is further away. Stripes do: a board whose print
is larger than described by a factor s lies s times as far away, and only then do its lines lie in the planes
that the first board's poses show. Each line on each plane gives an s; the one that most lines share is the
start, and in the joint adjustment each further board has a size of its own. Compared with what is described,
that checks the scale, as a block does.

A stretched print (paper drawn through a printer) shows in boards that are tilted and turned in different
ways: one more step of the adjustment, with each board's y apart from its x, tells by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import Board
from roemetry.records.arrays import Floats, Integers
from roemetry_pinhole.boards import BoardView
from roemetry_pinhole.bundle import Adjusted, Measured
from roemetry_pinhole.geometry import unknowns_of
from roemetry_pinhole.numbering import PoseLines, number_stripes

_SIZES = np.arange(-0.3, 0.3, 0.001)
"""Logarithms of the sizes that are tried."""
_ALIKE = 0.01
"""Difference of the logarithms by a line's two ends: more, and the line is not this plane's."""
_STRETCH_STDS, _STRETCH_MIN = 5.0, 0.002
"""A stretch is told from here on: 0.2 % is what printers do."""
_SQUARE = 0.001
"""Pixels are as square as this. Bent boards seem stretched as well (two real sets by 0.6 and 0.9 %), but then
fx and fy come apart, where a real stretch lets them agree."""


def first_sizes(poses: Sequence[PoseLines], boards: Integers, stripes: int, belt: PoseLines | None) -> Floats:
    """Give (board,) how much larger each print is than described, by the planes that the first one shows.

    1 for boards on which no stripe lies, and where the first board alone does not tell the planes.
    """
    sizes = np.ones(int(boards.max(initial=0)) + 1)
    others = np.unique(boards[boards > 0])
    try:
        mine = [pose for pose, board in zip(poses, boards, strict=True) if board == 0]
        if not others.size or len(mine) < 2:
            return sizes
        planes = number_stripes(mine, stripes, belt).planes
    except CalibrationError:
        return sizes
    for other in others:
        lines = [pose for pose, board in zip(poses, boards, strict=True) if board == other]
        votes = np.zeros(_SIZES.size)
        for pose in lines:
            with np.errstate(divide="ignore", invalid="ignore"):
                size = -np.log(pose.ends_mm @ planes.T)  # (line, end, plane)
            apart = np.abs(size[:, 0] - size[:, 1])
            weight = np.broadcast_to(pose.weight[:, None], apart.shape)
            at = size.mean(axis=1)
            good = (apart < _ALIKE) & (np.abs(at) < -_SIZES[0])
            near = np.abs(_SIZES - at[good][:, None]) < 0.5 * _ALIKE
            votes += weight[good] @ near
        best = np.flatnonzero(votes == votes.max())
        sizes[other] = np.exp(_SIZES[best[best.size // 2]]) if votes.any() else 1.0
    return sizes


def compared(found: Adjusted, boards: Sequence[Board]) -> list[tuple[Board, float, float]]:
    """Give each further board whose size was looked for: its size over what is described.

    Beside it stands the relative standard uncertainty, by what was seen and by the board's own tolerance.
    """
    at = found.unknowns.prints
    return [
        (
            board,
            float(np.exp(found.geometry.prints[number, 0])),
            float(np.hypot(np.sqrt(found.covariance[at[number, 0], at[number, 0]]), tolerance_of(board))),
        )
        for number, board in enumerate(boards)
        if number < len(at) and at[number, 0] >= 0
    ]


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
    unknowns = unknowns_of(
        geometry,
        free_camera=found.unknowns.camera >= 0,
        planes=bool((found.unknowns.planes >= 0).any()),
        belt=bool((found.unknowns.belt >= 0).any()),
        travel=bool((found.unknowns.travel >= 0).any()),
        prints=free,
    )
    moved, covariance = replace(measured, unknowns=unknowns).step_of(replace(found, geometry=geometry))
    before, after = (abs(float(np.log(one.camera[1] / one.camera[0]))) for one in (geometry, moved))
    said = []
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
