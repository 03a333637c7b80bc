"""Whether a mesh is closed, and closing the small holes that a rolling ball leaves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roemetry.records.arrays import Floats, Integers

_LARGEST_LOOP = 12


def open_edges(triangles: Integers) -> int:
    """Count edges that do not join exactly two triangles which run through them in opposite ways."""
    ways = _ways(triangles)
    _, each = np.unique(ways, axis=0, return_counts=True)
    _, both = np.unique(np.sort(ways, axis=1), axis=0, return_counts=True)
    return int((both != 2).sum() + (each > 1).sum())


def mended(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers, int]:
    """Fill loops of up to twelve open edges by fans about their middles; also how many edges were closed."""
    ways = _ways(triangles)
    known = {(int(a), int(b)) for a, b in ways}
    # an edge that one triangle runs through from a to b is open where none runs back
    after: dict[int, list[int]] = {}
    for a, b in sorted(known):
        if (b, a) not in known:
            after.setdefault(b, []).append(a)
    fans: list[tuple[int, int, int]] = []
    middles: list[Floats] = []
    closed = 0
    for loop in _loops(after):
        if not 3 <= len(loop) <= _LARGEST_LOOP:
            continue
        # from the middle, for a diagonal may be an edge of the mesh already
        middle = len(vertices) + len(middles)
        middles.append(vertices[loop].mean(axis=0))
        fans += [(middle, loop[k - 1], loop[k]) for k in range(len(loop))]
        closed += len(loop)
    if not fans:
        return vertices, triangles, 0
    return np.vstack([vertices, middles]), np.vstack([triangles, fans]), closed


def _loops(after: dict[int, list[int]]) -> Iterator[list[int]]:
    """Give the loops of open edges; where loops touch at a corner, each by itself. Empties `after`."""
    while after:
        walk = [min(after)]
        while walk:
            ways = after.get(walk[-1])
            if not ways:  # a dead end: these edges lie on no loop
                walk.pop()
                continue
            corner = ways.pop()
            if not ways:
                del after[walk[-1]]
            if corner in walk:
                at = walk.index(corner)
                yield walk[at:]
                del walk[at + 1 :]
            else:
                walk.append(corner)


def _ways(triangles: Integers) -> Integers:
    return np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
