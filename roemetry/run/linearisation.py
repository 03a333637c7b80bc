"""From what each cause may be wrong by to what a result may be wrong by: linearisation (JCGM 100, 5.1 and H).

Each cause is taken apart into independent parts p of standard deviation 1: the calibration's covariance into
the modes that move the product's points most, an outline and the light's penetration into one each, peak
noise into some drawn patterns. The chain is run with each part at +1 and at −1, and for a result f

    Δ_p = (f(+1) − f(−1)) / 2,     e_p = (f(+1) + f(−1)) / 2 − f,     u² = Σ_p Δ_p² + 2 e_p²,

where 2 e² is the variance of the second-order term for a normal part. What the stages state of their own
models is added. No random number decides a result: the patterns of noise are the same for every image.

Of each cause that all points share the first part is run both ways; for others Δ = f(+1) − f stands alone
unless a grade moves. f itself is run again, too: what goes on from a solution differs a little from it.

Against the Monte Carlo method (`roemetry.run.monte_carlo`): some ten runs of the chain instead of
hundreds. Where results do not follow a part in a straight line (a class border, a rule that switches), the
second-order term shows it, a reason says so, and the uncertainty holds it as far as a parabola does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import RoemetryError
from roemetry.records import NOTHING, Dots, Estimate, Grade, Product, ProductTrace, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Calibration
from roemetry.records.light import at_height
from roemetry.run.monte_carlo import (
    CALIBRATION,
    COVERAGE_FACTOR,
    OUTLINE,
    PEAKS,
    PENETRATION,
    UNKNOWN,
    VOLUME_MODEL,
    WEIGHT_MODEL,
    Chain,
    Result,
    Sampler,
    Scene,
    draw_models,
    lift_share,
    moved_by,
    probability_of,
    rerun,
    shifted,
    what_is_unstated,
)
from roemetry.run.scan import Placing

_NOISE_PATTERNS = 12
"""Patterns of peak noise, at most: they know its part to 20 %."""
_NOISE_SHARES = {2: 0.02}
_NOISE_SHARE = 0.05
"""Of the volume's variance, after so many patterns and after more: noise averages out over thousands of
points and mostly has less, which so few patterns know well enough, the whole to 2 %."""
_HEIGHT_PATTERNS = 100
"""Patterns of noise in which the highest point is looked for: they know its scatter to 7 %."""
_HEIGHTS_AT_ONCE = 100_000
"""Noisy heights that are drawn together: a megabyte."""
_FAR = 5.0
"""Standard deviations: what lies further below the highest point never is the highest."""
_MODES_SHARE = 0.9
"""Of the variance of the product's shape, what the modes of the calibration hold that are run; the sum is
divided by what they hold. Against all modes the volume's part is then 1.02 to 1.05 times as large."""
_MODES_MAX = 12  # of a calibration, however little of the variance they hold
_BLOCKS, _PLACES = 20, 6
"""Of the lattice on which it is found how far a mode moves points: blocks of rows, and places along x."""
_ROWS_APART = 8
"""Of a scan's lines points of every so many rows tell it: calibrations are smooth over tens of rows."""
_MODEL_DRAWS = 50
"""For a stage that draws its model's error and does not state it."""
_GRADE_MOVES = 0.02
"""Change of a grade's probability from which a part is run the other way as well."""
_CURVED = 0.5
"""Second-order over first-order variance from which a result is said not to follow its causes straight."""
_NOT_LINEAR = Reason(
    "not-linear",
    "the result is not a linear function of its causes here (a limit or a rule switches within the "
    "uncertainty): its uncertainty is only an estimate; use `uncertainty: monte-carlo`",
)

Part = tuple[str, float, Callable[[float], Mapping[int, Product]]]
"""A cause, the weight of one of its parts in a variance, and what gives the products by number with that
part at so many standard deviations."""


def linearise(products: tuple[ProductTrace, ...], scene: Scene, chain: Chain) -> tuple[ProductTrace, ...]:
    """Give the products with uncertainties, budgets, intervals and probabilities.

    Labels stay as they were found: triangulation and what follows is run anew, not the coding.
    """
    if not products:
        return products
    rng = np.random.default_rng(0)
    drawn = Sampler(scene, chain, rng)
    as_found = {trace.product.number: trace.product for trace in products}
    if isinstance(chain.triangulator, Placing):  # a scan's runs see the lines that were placed
        as_found = dict(_unmoved(scene, drawn))
    still = {
        trace.product.number: rerun(
            chain, trace, as_found.get(trace.product.number), rng, model=False, graded=False
        )
        for trace in products
    }
    runs: dict[int, list[_Run]] = {trace.product.number: [] for trace in products}
    noisy = products
    for cause, weight, make in _parts(products, scene, chain, drawn):
        if cause == PEAKS:
            noisy = tuple(
                trace
                for trace in noisy
                if _noise_matters(trace, runs[trace.product.number], still[trace.product.number])
            )
        wanted = noisy if cause == PEAKS else products
        above = make(1.0) if wanted else {}
        below: Mapping[int, Product] | None = None
        for trace in wanted:
            number = trace.product.number
            up = rerun(chain, trace, above.get(number), rng, model=False)
            down = None
            first = cause != PEAKS and not any(run.cause == cause for run in runs[number])
            if first or _wants_both(trace, up):
                below = make(-1.0) if below is None else below
                down = rerun(chain, trace, below.get(number), rng, model=False)
            runs[number].append(_Run(cause, weight, up, down))
    return tuple(
        _stated(trace, still[trace.product.number], runs[trace.product.number], chain, drawn, scene, rng)
        for trace in products
    )


@dataclass(frozen=True, slots=True)
class _Run:
    """What the chain gave with one part of a cause at +1 and at −1, and the part's weight in a variance."""

    cause: str
    weight: float
    above: Result
    below: Result | None
    """None: not run."""


def _parts(products: tuple[ProductTrace, ...], scene: Scene, chain: Chain, drawn: Sampler) -> Iterator[Part]:
    """Give every part of every cause whose size is stated."""
    calibration, outlines, light = scene.calibration, scene.outlines, scene.penetration
    stripes = scene.stripes if isinstance(chain.triangulator, Placing) else _on_products(scene.stripes)
    offset_mm = 0.0 if light is None else light.offset_mm

    modes, held = _modes(scene, chain)
    for mode in modes:
        yield (
            CALIBRATION,
            1.0 / held,
            lambda sign, mode=mode: drawn.products(  # type: ignore[misc]
                stripes, calibration.shifted(sign * mode, chain.triangulator.view), outlines, offset_mm
            ),
        )
    if OUTLINE in drawn.causes:
        yield OUTLINE, 1.0, lambda sign: {trace.product.number: _outlined(trace, sign) for trace in products}
    if light is not None:
        std_mm = light.std_mm
        yield (
            PENETRATION,
            1.0,
            lambda sign: drawn.products(stripes, calibration, outlines, offset_mm + sign * std_mm),
        )
    if PEAKS in drawn.causes:
        for unit in drawn.first_patterns(_NOISE_PATTERNS):  # all: what follows is drawn from the same numbers
            yield (
                PEAKS,
                1.0,
                lambda sign, unit=unit: drawn.products(  # type: ignore[misc]
                    shifted(stripes, drawn.as_noise(unit), sign), calibration, outlines, offset_mm
                ),
            )


def _on_products(stripes: StripeMap) -> StripeMap:
    """Leave of a map what lies on products: the runs look at nothing else."""
    across = None if stripes.across is None else _on_products(stripes.across)
    on = stripes.product > 0
    x_px, product = np.where(on, stripes.x_px, np.nan), np.where(on, stripes.product, NOTHING)
    product = product.astype(stripes.product.dtype)
    return replace(stripes, x_px=x_px, product=product, seen=stripes.seen & on, across=across)


def _unmoved(scene: Scene, drawn: Sampler) -> Mapping[int, Product]:
    """Give the products of a scene in which nothing has moved."""
    offset_mm = 0.0 if scene.penetration is None else scene.penetration.offset_mm
    return drawn.products(scene.stripes, scene.calibration, scene.outlines, offset_mm)


def _outlined(trace: ProductTrace, sigmas: float) -> Product:
    """Give a product with its outline moved outwards by so many standard deviations."""
    outline = trace.product.outline
    return trace.product if outline is None else replace(trace.product, outline=moved_by(outline, sigmas))


def _modes(scene: Scene, chain: Chain) -> tuple[Floats, float]:
    """Give (mode, parameter) steps of the calibration, one standard deviation each, and what they hold.

    With the covariance C = L·Lᵀ and the points' places J·p, the points move by J·L·z for independent z of
    variance 1; the eigenvectors of (J·L)ᵀ·(J·L) are the directions of z that move them most.
    """
    steps, moves, share = _moves(scene, chain)
    # where on the belt a product lies changes nothing of it
    moves[:, :, :2] -= np.einsum("snk,n->sk", moves[:, :, :2], share)[:, None]
    moves = (moves * np.sqrt(share)[:, None]).reshape(len(moves), -1)
    size, turned = np.linalg.eigh(moves @ moves.T)
    size, turned = np.maximum(size[::-1], 0.0), turned[:, ::-1]
    total = float(size.sum())
    if total == 0.0:
        return np.empty((0, steps.shape[1])), 1.0
    held = np.cumsum(size) / total
    count = min(int(np.searchsorted(held, _MODES_SHARE)) + 1, _MODES_MAX, held.size)
    return turned[:, :count].T @ steps, float(held[count - 1])


def _moves(scene: Scene, chain: Chain) -> tuple[Floats, Floats, Floats]:
    """Give (step, parameter) the calibration's independent steps, and how the products move with them.

    That is (step, node, 3) mm, and (node,) the share of the products' points at each. In a frame a point
    moves as the nearest node of a lattice, which is the same for all frames; a scan's lines are their own.
    """
    stripes, calibration, triangulator = scene.stripes, scene.calibration, chain.triangulator
    if isinstance(triangulator, Placing):
        stripes = _every(stripes, _ROWS_APART)
        steps, moves = _moved(stripes, stripes.product > 0, calibration, triangulator)
        return steps, moves.astype(np.float64), np.full(moves.shape[1], 1.0 / max(moves.shape[1], 1))
    lattice = _lattice_of(calibration, triangulator)
    if stripes.dots is not None:
        return _moves_of_dots(stripes, lattice)
    families = (stripes,) if stripes.across is None else (stripes, stripes.across)
    many, first = np.zeros(lattice.moves_mm.shape[1], np.int64), 0
    for family, nodes in zip(families, lattice.nodes, strict=True):
        mine = family.product > 0
        stripe, row = np.nonzero(mine)
        along = np.rint((family.x_px[mine] - nodes.first_px[stripe, row]) / nodes.step_px)
        node = first + (stripe * _BLOCKS + row * _BLOCKS // family.rows) * _PLACES
        many += np.bincount(node + np.clip(along, 0, _PLACES - 1).astype(np.int64), minlength=many.size)
        first += family.stripe_count * _BLOCKS * _PLACES
    held = np.flatnonzero(many)
    return lattice.steps, lattice.moves_mm[:, held].astype(np.float64), many[held] / max(many.sum(), 1)


class _Nodes(NamedTuple):
    """Nodes of one family of stripes in blocks of rows, along x from the belt to the greatest height.

    A map has one place in a row, so that the nodes of a block stand in rows next to each other.
    """

    places: StripeMap
    """The nodes as stripes."""
    first_px: Floats
    """(stripe, row) the first node along x."""
    step_px: float


class _Lattice(NamedTuple):
    """Nodes of both families, and how they move."""

    steps: Floats
    """(step, parameter) independent steps of the calibration."""
    moves_mm: NDArray[np.float32]
    """(step, node, 3) by how much each moves a node: stripe by stripe, down the rows, along x."""
    nodes: tuple[_Nodes, ...]
    """Of the stripes and, in a grid, of the lines across."""


def _moves_of_dots(stripes: StripeMap, lattice: _Lattice) -> tuple[Floats, Floats, Floats]:
    """Give what `_moves` does: a dot moves as the node of its ray that is seen nearest to it."""
    places, dots = lattice.nodes[0].places, stripes.dots
    assert dots is not None and places.dots is not None
    stripe, row = np.nonzero((stripes.product > 0) & (dots.line >= 0))
    each = _heights_of_ray(places.rows, int(places.dots.line.max(initial=0)) + 1)
    node = dots.line[stripe, row].astype(np.int64)[:, None] * each + np.arange(each)
    off = (places.x_px[stripe[:, None], node] - stripes.x_px[stripe, row, None]) ** 2
    off += (places.dots.y_px[stripe[:, None], node] - dots.y_px[stripe, row, None]) ** 2
    known = np.isfinite(off).any(axis=1)
    nearest = np.nan_to_num(off, nan=np.inf).argmin(axis=1)
    number = np.cumsum(places.seen).reshape(places.seen.shape) - 1
    at = number[stripe, node[np.arange(node.shape[0]), nearest]][known]
    many = np.bincount(at, minlength=lattice.moves_mm.shape[1])
    held = np.flatnonzero(many)
    return lattice.steps, lattice.moves_mm[:, held].astype(np.float64), many[held] / max(many.sum(), 1)


@lru_cache(maxsize=2)
def _lattice_of(calibration: Calibration, triangulator: Any) -> _Lattice:
    nodes = [_nodes_of(calibration) if calibration.rays is None else _nodes_of_rays(calibration)]
    places = nodes[0].places
    lit = places.seen
    if calibration.across is not None:
        nodes.append(_nodes_of(calibration.across))
        places = replace(places, across=nodes[1].places)
        rows = max(nodes[0].places.rows, nodes[1].places.rows)
        lit = np.concatenate(
            [np.pad(one.places.seen, [(0, 0), (0, rows - one.places.rows)]) for one in nodes]
        )
    return _Lattice(*_moved(places, lit, calibration, triangulator), tuple(nodes))


def _nodes_of(calibration: Calibration) -> _Nodes:
    rows = calibration.image_size[0]
    ends_px = np.outer(calibration.height_range_mm, calibration.displacement_px_per_mm)
    step_px = max(float(np.ptp(ends_px)) / (_PLACES - 1), 1e-3)
    rest_px = calibration.rest_line_px(np.arange(rows, dtype=np.float64))
    first_px = rest_px + ends_px.min()
    middle = (np.arange(_BLOCKS) + 0.5) * rows / _BLOCKS
    row = np.clip(middle[:, None].astype(np.int64) + np.arange(_PLACES) - _PLACES // 2, 0, rows - 1).ravel()
    x_px = np.full_like(first_px, np.nan)
    x_px[:, row] = first_px[:, row] + step_px * np.tile(np.arange(_PLACES), _BLOCKS)
    lit, unknown = np.isfinite(x_px), np.full_like(x_px, np.nan)
    product = np.where(lit, 1, NOTHING).astype(np.int16)
    interpolated, missing = np.zeros_like(lit), np.empty(0, np.int16)
    places = StripeMap(x_px, unknown, product, lit, unknown, interpolated, rest_px, missing)
    return _Nodes(places, first_px, step_px)


def _heights_of_ray(rows: int, lines: int) -> int:
    """Give how many nodes each ray has, so that those of a column find place in its rows."""
    return max(min(_PLACES, rows // max(lines, 1)), 1)


def _nodes_of_rays(calibration: Calibration) -> _Nodes:
    """Give nodes on every ray, from the belt to the greatest height: dot by dot, each height in a row."""
    rays, view, rows = calibration.rays, calibration.view, calibration.image_size[0]
    assert rays is not None and view is not None
    lines = rays.moved(calibration.parameters)
    count = lines.shape[1]
    each = _heights_of_ray(rows, count)
    heights = np.linspace(*calibration.height_range_mm, each)
    flat = np.repeat(lines.reshape(-1, 4), each, axis=0)
    xy_px = view.project(at_height(flat, np.tile(heights, lines.shape[0] * count)))
    shape = (lines.shape[0], rows)
    seen = np.zeros(shape, np.bool_)
    seen[:, : count * each] = np.isfinite(xy_px).all(axis=1).reshape(lines.shape[0], -1)
    x_px, y_px, unknown = (np.full(shape, np.nan) for _ in range(3))
    x_px[seen], y_px[seen] = xy_px[np.isfinite(xy_px).all(axis=1)].T
    line = np.full(shape, -1, np.int16)
    line[seen] = np.tile(np.repeat(np.arange(count), each), (lines.shape[0], 1))[seen[:, : count * each]]
    product = np.where(seen, 1, NOTHING).astype(np.int16)
    rest_px = calibration.rest_line_px(np.arange(rows, dtype=np.float64))
    places = StripeMap(
        x_px, unknown, product, seen, unknown, np.zeros(shape, np.bool_), rest_px, np.empty(0, np.int16),
        dots=Dots(y_px, np.full((*shape, 2, 2), np.nan), line),
    )  # fmt: skip
    return _Nodes(places, x_px, math.nan)


def _every(stripes: StripeMap, rows: int) -> StripeMap:
    """Leave of a map the points of every so many rows."""
    x_px = np.where(np.arange(stripes.rows) % rows == 0, stripes.x_px, np.nan)
    lit = np.isfinite(x_px)
    product = np.where(lit, stripes.product, NOTHING).astype(stripes.product.dtype)
    return replace(stripes, x_px=x_px, product=product, seen=stripes.seen & lit)


def _moved(
    places: StripeMap, wanted: Flags, calibration: Calibration, triangulator: Any
) -> tuple[Floats, NDArray[np.float32]]:
    """Give the calibration's independent steps, and (step, place, 3) by how much each moves wanted places.

    Raises
    ------
    RoemetryError
        The places cannot be triangulated, of which nobody may conclude that the calibration has no error.
    """

    def points(moved: Calibration) -> Floats:
        try:
            return np.asarray(triangulator.triangulate(places, moved).xyz_mm[wanted])
        except RoemetryError:
            return np.full((int(wanted.sum()), 3), math.nan)

    steps = calibration.independent_steps()
    steps = steps[(steps != 0.0).any(axis=1)]
    at = np.asarray(triangulator.triangulate(places, calibration).xyz_mm[wanted])
    moves = [(points(calibration.shifted(step)) - at).astype(np.float32) for step in steps]
    return steps, np.nan_to_num(np.array(moves).reshape(len(steps), len(at), 3))


def _stated(
    trace: ProductTrace,
    still: Result,
    runs: Sequence[_Run],
    chain: Chain,
    drawn: Sampler,
    scene: Scene,
    rng: np.random.Generator,
) -> ProductTrace:
    """Put on a product's results what the runs show; `still` is the one in which nothing has moved."""
    unstated = what_is_unstated(trace, scene, chain, drawn)
    volume, weight, grade = trace.volume, trace.weight, trace.grade
    own = _own_parts(trace, chain, rng, set(drawn.causes))
    if volume is not None:
        stated = not unstated.volume
        visible, said = _estimate(volume.visible_mm3, still, runs, "visible_mm3", own, stated=stated)
        true = volume.true_mm3
        if true is not None:
            true, _ = _estimate(true, still, runs, "true_mm3", own, stated=stated)
        said = volume.reasons + unstated.volume + said
        volume = replace(volume, visible_mm3=visible, true_mm3=true, reasons=said)
    if weight is not None:
        stated = not (unstated.volume or unstated.weight)
        mass, said = _estimate(weight.mass_g, still, runs, "mass_g", own, stated=stated)
        weight = replace(weight, mass_g=mass, reasons=weight.reasons + unstated.weight + said)
    if grade is not None:
        grade = _graded(grade, runs, spread=not unstated.points)
    height = _height(trace, runs, drawn)
    return replace(trace, volume=volume, weight=weight, grade=grade, height_max_mm=height)


@dataclass(frozen=True, slots=True)
class _Spread:
    """First- and second-order variance of one value by cause."""

    first: Mapping[str, float]
    second: Mapping[str, float]

    @property
    def budget(self) -> dict[str, float]:
        return {cause: math.sqrt(part + self.second[cause]) for cause, part in self.first.items()}

    @property
    def is_curved(self) -> bool:
        return sum(self.second.values()) > _CURVED * sum(self.first.values()) > 0.0


def _noise_matters(trace: ProductTrace, runs: Sequence[_Run], still: Result) -> bool:
    """Tell whether another pattern of noise is worth its time."""
    patterns = sum(run.cause == PEAKS for run in runs)
    if patterns < min(_NOISE_SHARES):
        return True
    if trace.volume is None:
        return False
    visible = trace.volume.visible_mm3
    spread = _spread(runs, lambda result: result.visible_mm3, still.visible_mm3)
    if spread is None:
        return False
    whole = sum(spread.first.values()) + float(np.nan_to_num(visible.std)) ** 2
    return spread.first[PEAKS] > _NOISE_SHARES.get(patterns, _NOISE_SHARE) * whole


def _wants_both(trace: ProductTrace, result: Result) -> bool:
    """Tell whether a part is to be run the other way as well: it was refused, or the grade moves."""
    if trace.volume is not None and math.isnan(result.visible_mm3):
        return True
    if trace.grade is None or trace.grade.label == UNKNOWN:
        return False
    return abs(probability_of(result, trace.grade.label) - _sure_of(trace.grade)) > _GRADE_MOVES


def _sure_of(grade: Grade) -> float:
    stated = Result(label=grade.label, probability=grade.probability, features=grade.features)
    return probability_of(stated, grade.label)


def _spread(runs: Sequence[_Run], value: Callable[[Result], float], found: float) -> _Spread | None:
    """Give how a value varies; None where a run could not be measured on either side, or as it was found."""
    if math.isnan(found):
        return None
    first: dict[str, float] = {}
    second: dict[str, float] = {}
    patterns = sum(run.cause == PEAKS for run in runs)
    for run in runs:
        weight = run.weight / (patterns if run.cause == PEAKS else 1)
        above = value(run.above)
        below = math.nan if run.below is None else value(run.below)
        if math.isnan(above) or math.isnan(below):
            one = below if math.isnan(above) else above
            if math.isnan(one):
                return None
            above, below = one, 2.0 * found - one  # what was not run, or refused: as far the other way
        bend = 0.5 * (above + below) - found
        first[run.cause] = first.get(run.cause, 0.0) + weight * (0.5 * (above - below)) ** 2
        second[run.cause] = second.get(run.cause, 0.0) + weight * 2.0 * bend**2
    return _Spread(first, second)


def _estimate(
    found: Estimate,
    still: Result,
    runs: Sequence[_Run],
    field: str,
    own: Mapping[str, Mapping[str, float]],
    *,
    stated: bool,
) -> tuple[Estimate, tuple[Reason, ...]]:
    """Give an estimate with std, budget and interval, and what is to be said of it."""
    spread = _spread(runs, lambda result: float(getattr(result, field)), float(getattr(still, field)))
    if spread is None:
        return replace(found, std=math.nan, interval=(math.nan, math.nan)), (_REFUSED,)
    budget = {**spread.budget, **own[field]}
    if not stated:
        return Estimate(found.value, math.nan, budget), ()
    std = math.hypot(*budget.values())
    reach = COVERAGE_FACTOR * std
    said = (_NOT_LINEAR,) if spread.is_curved else ()
    return Estimate(found.value, std, budget, (found.value - reach, found.value + reach)), said


_REFUSED = Reason(
    "draws-refused",
    "it could not be measured with an uncertain input changed in either direction: no uncertainty is stated",
)


def _own_parts(
    trace: ProductTrace, chain: Chain, rng: np.random.Generator, run: set[str]
) -> dict[str, dict[str, float]]:
    """Give, for volumes and mass, what the stages state of their own models, by cause.

    Causes that are `run` are left out of it. A mass whose weigher does not carry the volume's model over gets
    it by its slope. Of a stage that draws its error without stating it, the draws' standard deviation counts.
    """
    volume, weight = trace.volume, trace.weight
    parts: dict[str, dict[str, float]] = {"visible_mm3": {}, "true_mm3": {}, "mass_g": {}}
    if volume is None:
        return parts
    drawn = draw_models(trace, chain, rng, _MODEL_DRAWS, stated_too=False)

    def of(estimate: Estimate, field: str, model: str) -> dict[str, float]:
        if estimate.budget:
            return {cause: part for cause, part in estimate.budget.items() if cause not in run}
        values = [float(getattr(result, field)) for result in drawn.get(model, ())]
        return {model: float(np.nanstd(values, ddof=1))} if values else {}

    parts["visible_mm3"] = of(volume.visible_mm3, "visible_mm3", VOLUME_MODEL)
    if volume.true_mm3 is not None:
        parts["true_mm3"] = of(volume.true_mm3, "true_mm3", VOLUME_MODEL)
    if weight is not None:
        parts["mass_g"] = of(weight.mass_g, "mass_g", WEIGHT_MODEL)
        if not parts["visible_mm3"].keys() & parts["mass_g"].keys():
            model_mm3 = math.hypot(*parts["visible_mm3"].values())
            parts["mass_g"][VOLUME_MODEL] = model_mm3 * _grams_per_mm3(trace, chain)
    return parts


def _grams_per_mm3(trace: ProductTrace, chain: Chain) -> float:
    """Give how much heavier a product is weighed for a visible volume that is larger."""
    assert trace.volume is not None
    assert trace.weight is not None
    volume, true = trace.volume, trace.volume.true_mm3
    step = 1e-3
    larger = replace(
        volume,
        visible_mm3=Estimate(volume.visible_mm3.value * (1.0 + step)),
        true_mm3=None if true is None else Estimate(true.value * (1.0 + step)),
    )
    mass = chain.weigher.weigh(trace.product, larger).mass_g.value
    return abs(float(mass) - trace.weight.mass_g.value) / (step * volume.visible_mm3.value)


def _height(trace: ProductTrace, runs: Sequence[_Run], drawn: Sampler) -> Estimate:
    """Give the largest height with its uncertainty."""
    found_mm = trace.product.height_max_mm
    others = [run for run in runs if run.cause != PEAKS]
    spread = _spread(others, lambda result: result.height_max_mm, found_mm)
    if spread is None:
        return Estimate(found_mm)
    budget = {cause: math.sqrt(part) for cause, part in spread.first.items() if part > 0.0}
    if PEAKS in drawn.causes:
        budget[PEAKS] = _noise_of_height(trace.product, drawn)
    if not drawn.peaks_stated:
        return Estimate(found_mm, budget=budget)
    std = math.hypot(*budget.values())
    reach = COVERAGE_FACTOR * std
    return Estimate(found_mm, std, budget, (found_mm - reach, found_mm + reach))


def _noise_of_height(product: Product, drawn: Sampler) -> float:
    """Give the uncertainty of the largest height by peak noise, mm, and by what noise has lifted it.

    It hangs on the noise of single points and takes many patterns; their own heights' noise is enough for it.
    """
    profiles = product.profiles
    heights, std_mm = profiles.xyz_mm[:, :, 2], np.nan_to_num(profiles.height_std_mm)
    near = np.flatnonzero((heights + _FAR * std_mm > product.height_max_mm).any(axis=0))
    window = slice(int(near[0]), int(near[-1]) + 1)
    heights, std_mm = heights[:, window], std_mm[:, window]
    slices, rows = heights.shape
    highest: list[float] = []
    while len(highest) < _HEIGHT_PATTERNS:  # many small patterns at once, of a scan's slices one by one
        many = min(_HEIGHT_PATTERNS - len(highest), max(1, _HEIGHTS_AT_ONCE // heights.size))
        noise = drawn.next_noise(
            (many * slices, rows), len(highest) * heights.size, _HEIGHT_PATTERNS * heights.size
        )
        noise = noise.reshape(many, slices, rows)
        # NaN is no height: fmax passes over it
        highest += np.fmax.reduce(heights + noise * std_mm, axis=(1, 2)).tolist()
    return math.hypot(np.std(highest, ddof=1), lift_share(float(np.mean(highest)) - product.height_max_mm))


def _graded(grade: Grade, runs: Sequence[_Run], *, spread: bool) -> Grade:
    """Give a grade the mean probability of its label, to the second order, and its features' spread."""
    if grade.label == UNKNOWN:
        sure = math.nan
    else:
        found = _sure_of(grade)
        patterns = sum(run.cause == PEAKS for run in runs)
        mean = [
            (
                run.weight / (patterns if run.cause == PEAKS else 1),
                0.5 * (probability_of(run.above, grade.label) + probability_of(run.below, grade.label)),
            )
            for run in runs
            if run.below is not None
        ]
        sure = min(max(found + sum(weight * (both - found) for weight, both in mean), 0.0), 1.0)
    return replace(
        grade, probability=sure, features_std=_features_std(grade.features, runs) if spread else {}
    )


def _features_std(features: Mapping[str, float], runs: Sequence[_Run]) -> dict[str, float]:
    """Give the standard deviation of each feature as `_spread` does, of all at once."""
    patterns = sum(run.cause == PEAKS for run in runs)
    weight = np.array([run.weight / (patterns if run.cause == PEAKS else 1) for run in runs])[:, None]
    found = np.array(list(features.values()))
    nothing = np.full(found.size, math.nan)

    def values(result: Result | None) -> Floats:
        if result is None or not result.features:
            return nothing
        return np.array([result.features.get(name, math.nan) for name in features])

    above = np.stack([values(run.above) for run in runs])
    below = np.stack([values(run.below) for run in runs])
    above, below = (
        np.where(np.isnan(one), 2.0 * found - other, one) for one, other in ((above, below), (below, above))
    )
    first, bend = 0.5 * (above - below), 0.5 * (above + below) - found
    std = np.sqrt((weight * (first**2 + 2.0 * bend**2)).sum(axis=0))
    return {name: float(one) for name, one in zip(features, std, strict=True) if not math.isnan(one)}
