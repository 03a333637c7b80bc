"""From what each cause may be wrong by to what a result may be wrong by: Monte Carlo (JCGM 101).

Peak noise is drawn for each point, with its correlation along the stripe; the calibration is redrawn once a
draw, for it is common to all points; an outline moves as one; estimators and weighers draw their own model's
error. One cause drawn at a time gives the budget, all at once the standard uncertainty. Labels stay as they
were found: a draw repeats triangulation and what follows, not the coding.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.records import (
    Estimate,
    Outline,
    Product,
    ProductTrace,
    Reason,
    StripeMap,
    Volume,
    Weight,
)
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.penetration import Penetration, raise_surface
from roemetry.records.view import View
from roemetry.run.open_parts import split_products

COVERAGE = 0.95
"""Share of cases in which an interval is to hold the true value."""
COVERAGE_FACTOR = 1.959964
"""Half width of a 95 % interval in standard deviations of a normal distribution."""
FEW_DRAWS = 20
"""With fewer, a standard deviation is itself uncertain by a sixth and more."""
_TOO_FEW_DRAWS = 3
"""So many tell nothing: Student's distribution has no standard deviation for them."""
ENOUGH_FOR_QUANTILES = 1000
"""From so many draws on the interval's ends are quantiles: 25 draws lie beyond each."""
UNKNOWN = "unknown"
_NO_INTERVAL = (math.nan, math.nan)
_PART_ONLY = Reason(
    "model-error-only",
    "the uncertainty is that of the model alone: `uncertainty: linear` adds peak noise and calibration",
)
CALIBRATION_NOT_STATED = Reason(
    "calibration-model-not-stated",
    "one block does not determine the lens, and hardly the camera's tilt, and their effect on a volume "
    "is not known: no uncertainty and no interval is given",
)
FAILED_SHARE_MAX = 0.05
"""With more draws than this refused, what is left is no fair sample."""


VOLUME_MODEL, WEIGHT_MODEL = "volume model", "weight model"


class Result(NamedTuple):
    """One draw's outcome; NaN and "" where a stage refused."""

    visible_mm3: float = math.nan
    true_mm3: float = math.nan
    mass_g: float = math.nan
    label: str = ""
    probability: float = math.nan
    features: Mapping[str, float] = {}
    height_max_mm: float = math.nan


class Unstated(NamedTuple):
    """What keeps the uncertainty of volume and of weight from being stated; and that of points."""

    volume: tuple[Reason, ...]
    weight: tuple[Reason, ...]
    points: bool = False


def with_uncertainty(
    trace: ProductTrace,
    together: list[Result],
    alone: Mapping[str, list[Result]],
    models: Mapping[str, list[Result]],
    unstated: Unstated,
) -> ProductTrace:
    """Put what was drawn on a product's results, found without draws.

    `together` are results with all causes drawn at once; `alone`, by cause, with that one drawn, of what goes
    before the volume; `models` the same of the volume's and the weigher's own models.
    """
    volume, weight, grade = trace.volume, trace.weight, trace.grade
    height = _largest(trace.product.height_max_mm, together, alone, stated=not unstated.points)
    if volume is not None:
        causes = {**alone, **{cause: found for cause, found in models.items() if cause == VOLUME_MODEL}}
        visible, true = volume.visible_mm3, volume.true_mm3
        visible, lost = _estimate(visible, "visible_mm3", together, causes, stated=not unstated.volume)
        if true is not None:
            true, _ = _estimate(true, "true_mm3", together, causes, stated=not unstated.volume)
        said = volume.reasons + unstated.volume + lost
        volume = replace(volume, visible_mm3=visible, true_mm3=true, reasons=said)
    if weight is not None:
        stated = not (unstated.volume or unstated.weight)
        mass, lost = _estimate(weight.mass_g, "mass_g", together, {**alone, **models}, stated=stated)
        weight = replace(weight, mass_g=mass, reasons=weight.reasons + unstated.weight + lost)
    if grade is not None and together:
        held = [probability_of(result, grade.label) for result in together]
        sure = math.nan if grade.label == UNKNOWN else float(np.mean(held))
        if all(_is_counted(result, grade.label) for result in together):
            sure = min(sure, len(held) / (len(held) + 1.0))
        spread = {} if unstated.points else _features_std(grade.features, together)
        grade = replace(grade, probability=sure, features_std=spread)
    return replace(trace, volume=volume, weight=weight, grade=grade, height_max_mm=height)


def without_draws(trace: ProductTrace, *, approximate: bool) -> ProductTrace:
    """Say of each uncertainty that a stage stated by itself that it is a part of the whole.

    On an approximate calibration it is not stated: who reads a part as the whole would be misled most there.
    """
    volume, weight = trace.volume, trace.weight
    said = CALIBRATION_NOT_STATED if approximate else _PART_ONLY
    if volume is not None and _a_part(volume.visible_mm3):
        visible, true = volume.visible_mm3, volume.true_mm3
        if approximate:
            visible, true = _unstated(visible), None if true is None else _unstated(true)
        volume = replace(volume, visible_mm3=visible, true_mm3=true, reasons=(*volume.reasons, said))
    if weight is not None and _a_part(weight.mass_g):
        mass = _unstated(weight.mass_g) if approximate else weight.mass_g
        weight = replace(weight, mass_g=mass, reasons=(*weight.reasons, said))
    return replace(trace, volume=volume, weight=weight)


def _unstated(estimate: Estimate) -> Estimate:
    return replace(estimate, std=math.nan, interval=_NO_INTERVAL)


def _a_part(estimate: Estimate) -> bool:
    """Tell an uncertainty without an interval: a stage that knows the whole of it states that as well."""
    return math.isfinite(estimate.std) and not all(map(math.isfinite, estimate.interval))


def probability_of(result: Result, label: str) -> float:
    """Give the probability of a label in one draw: as stated of each class, else of the draw's own."""
    of_class = result.features.get(f"probability_{label}", math.nan)
    if not math.isnan(of_class) and result.label != UNKNOWN:
        return of_class
    if result.label != label:
        return 0.0
    return 1.0 if math.isnan(result.probability) else result.probability


def _is_counted(result: Result, label: str) -> bool:
    """Tell a draw that says yes or no: n of them that agree make a label no surer than n/(n + 1)."""
    return math.isnan(result.probability) and f"probability_{label}" not in result.features


def _largest(
    found_mm: float, together: list[Result], alone: Mapping[str, list[Result]], *, stated: bool
) -> Estimate:
    """Give the largest height with its uncertainty: what draws scatter by, and what noise has lifted it by.

    The largest of many noisy heights is too high on average. Noise drawn on top of it lifts it once more: on
    a flat top, where the highest of n points grows with the noise's size, by √2 − 1 of what the first noise
    did; on a peaked one both lifts are small. So the first lift is reckoned from the second by that share.
    """
    parts = {cause: _distance(found_mm, results) for cause, results in alone.items()}
    budget = {cause: part for cause, part in parts.items() if part > 0}
    std = _distance(found_mm, together)
    if not stated or not math.isfinite(std):
        return Estimate(found_mm, budget=budget)
    reach = COVERAGE_FACTOR * std
    return Estimate(found_mm, std, budget, (found_mm - reach, found_mm + reach))


def _distance(found_mm: float, results: list[Result]) -> float:
    """Give the scatter of drawn largest heights with the lift of what was found, mm; NaN where too few."""
    good = _sound([result.height_max_mm for result in results])
    if good is None:
        return math.nan
    mean, std = _mean_and_std(good)
    return math.hypot(std, lift_share(mean - found_mm))


def lift_share(lift_mm: float) -> float:
    """Give what noise has lifted a largest height by, from what drawn noise lifts it by once more, mm."""
    return max(0.0, lift_mm) / (math.sqrt(2.0) - 1.0)


def _features_std(features: Mapping[str, float], together: list[Result]) -> dict[str, float]:
    """Give the standard deviation of each feature over the draws; none of one that they lack."""
    drawn = {name: _sound([result.features.get(name, math.nan) for result in together]) for name in features}
    known = {name: good for name, good in drawn.items() if good is not None and good.size > _TOO_FEW_DRAWS}
    return {name: _mean_and_std(good)[1] * widening(good.size) for name, good in known.items()}


def _sound(drawn: list[float]) -> Floats | None:
    """Give what could be measured of the draws; None where that is too little for a fair sample."""
    values = np.array(drawn)
    good = values[np.isfinite(values)]
    return good if good.size >= max(2.0, (1.0 - FAILED_SHARE_MAX) * values.size) else None


def _estimate(
    found: Estimate, field: str, together: list[Result], causes: Mapping[str, list[Result]], *, stated: bool
) -> tuple[Estimate, tuple[Reason, ...]]:
    """Give the estimate with std, budget and interval, and what is to be said of the draws."""
    parts = {cause: _spread(results, field) for cause, results in causes.items()}
    budget = {cause: part for cause, part in parts.items() if math.isfinite(part)}
    if VOLUME_MODEL in budget and field != "mass_g" and found.budget:
        # The estimator knows its model's parts better than one number for all of them.
        del budget[VOLUME_MODEL]
        budget |= found.budget
    values = [getattr(result, field) for result in together]
    good = _sound(values)
    if good is None:
        lost = sum(not math.isfinite(value) for value in values)
        why = f"{lost} of {len(values)} draws could not be measured" if lost else "one draw has no scatter"
        said = (Reason("draws-refused", f"{why}: the uncertainty is not stated"),)
        return replace(_unstated(found), budget=budget), said
    if not stated:
        return replace(_unstated(found), budget=budget), ()
    std = _mean_and_std(good)[1] * widening(good.size)
    if math.isnan(std):
        return replace(_unstated(found), budget=budget), _few(good.size)
    if good.size >= ENOUGH_FOR_QUANTILES:
        tail = (1.0 - COVERAGE) / 2.0
        low, high = (float(q) for q in np.quantile(good, [tail, 1.0 - tail]))
        interval = (min(low, found.value), max(high, found.value))
    else:
        interval = (found.value - COVERAGE_FACTOR * std, found.value + COVERAGE_FACTOR * std)
    return replace(found, std=std, budget=budget, interval=interval), _few(good.size)


def widening(draws: int) -> float:
    """Give what a standard deviation of few draws grows by to count as one of many; NaN for up to three.

    √((n − 1)/(n − 3)), the standard deviation of Student's distribution (JCGM 101, 6.4.9.2); from `FEW_DRAWS`
    on 1, since it is then below 6 %.
    """
    if draws >= FEW_DRAWS:
        return 1.0
    return math.sqrt((draws - 1.0) / (draws - 3.0)) if draws > _TOO_FEW_DRAWS else math.nan


def _few(draws: int) -> tuple[Reason, ...]:
    """Say of a standard deviation of few draws how uncertain it is itself: by 1/√(2(n − 1))."""
    if draws >= FEW_DRAWS:
        return ()
    share = 1.0 / math.sqrt(2.0 * (draws - 1))
    said = f"{draws} draws determine a standard uncertainty only to {share:.0%}: take more"
    return (
        Reason(
            "few-draws",
            said if draws > _TOO_FEW_DRAWS else f"{draws} draws determine no uncertainty: take more",
        ),
    )


def _spread(results: list[Result], field: str) -> float:
    values = np.array([getattr(result, field) for result in results])
    good = values[np.isfinite(values)]
    return _mean_and_std(good)[1] if good.size >= 2 else math.nan


def _mean_and_std(values: Floats) -> tuple[float, float]:
    """Give both; of equal values exactly these and 0: what a mean rounds off is no scatter."""
    if np.ptp(values) == 0.0:
        return float(values[0]), 0.0
    return float(values.mean()), float(values.std(ddof=1))


PEAKS, CALIBRATION, OUTLINE, PENETRATION = "peak noise", "calibration", "outline", "penetration"


@dataclass(frozen=True)
class Chain:
    """The stages from the triangulator on, as one recipe has them."""

    triangulator: Any
    volume: Any
    weigher: Any
    classifier: Any


@dataclass(frozen=True)
class Scene:
    """What one acquisition gave before triangulation."""

    acquisition_id: str
    stripes: StripeMap
    outlines: tuple[Outline, ...]
    calibration: Calibration
    penetration: Penetration | None = None
    view: View | None = None
    """Of the calibration, as the products were made with it."""


def propagate(
    products: tuple[ProductTrace, ...], scene: Scene, chain: Chain, *, draws: int
) -> tuple[ProductTrace, ...]:
    """Give the products, found without draws, with uncertainties, budgets, intervals and probabilities.

    `draws` counts those with all causes together; each cause alone gets a quarter of it, at least 50 if there
    are as many. The seed comes from the acquisition's id: results are the same for any number of workers.
    """
    seed = int.from_bytes(hashlib.sha256(scene.acquisition_id.encode()).digest()[:8], "little")
    rng = np.random.default_rng(seed)
    if not products:
        return products
    drawn = Sampler(scene, chain, rng)
    own = min(draws, max(_BUDGET_DRAWS_MIN, draws // 4))
    together: dict[int, list[Result]] = {trace.product.number: [] for trace in products}
    alone: dict[str, dict[int, list[Result]]] = {}
    for by_number in drawn.scenes(draws, drawn.causes):
        for trace in products:
            number = trace.product.number
            together[number].append(rerun(chain, trace, by_number.get(number), rng, model=True))
    for cause in drawn.causes:
        alone[cause] = {trace.product.number: [] for trace in products}
        for by_number in drawn.scenes(own, (cause,)):
            for trace in products:
                number = trace.product.number
                found = rerun(chain, trace, by_number.get(number), rng, model=False, graded=False)
                alone[cause][number].append(found)
    return tuple(
        with_uncertainty(
            trace,
            together[trace.product.number],
            {cause: found[trace.product.number] for cause, found in alone.items()},
            draw_models(trace, chain, rng, own),
            what_is_unstated(trace, scene, chain, drawn),
        )
        for trace in products
    )


_BUDGET_DRAWS_MIN = 50
"""Draws of one cause alone: its share of the budget is then known to 10 %."""
_PROBE_PX = 1.0
"""Step by which a contour is moved to see whether the volume uses it, px."""

_PEAKS_NOT_STATED = Reason(
    "peak-noise-not-stated",
    "the extractor does not state the uncertainty of its peaks, so that of volume and weight is not stated: "
    "give the camera's gain and read noise (source.sensor), or take an extractor that finds its noise",
)
_OUTLINE_NOT_STATED = Reason(
    "outline-error-not-stated",
    "the outliner does not state the uncertainty of its contour, so that of volume and weight is not stated",
)
_VOLUME_NOT_STATED = Reason(
    "volume-model-not-stated",
    "the volume's estimator does not state its own model's error, so no uncertainty and no interval is given",
)
_WEIGHT_NOT_STATED = Reason(
    "weight-model-not-stated",
    "the weigher does not state its own model's error, so no uncertainty and no interval is given",
)


def what_is_unstated(trace: ProductTrace, scene: Scene, chain: Chain, drawn: Sampler) -> Unstated:
    """Give what keeps the uncertainty of volume and weight from being stated."""
    reasons = []
    if not drawn.peaks_stated:
        reasons.append(_PEAKS_NOT_STATED)
    view = scene.calibration.view
    if view is not None and not view.exact:
        reasons.append(CALIBRATION_NOT_STATED)
    if chain.volume and not chain.volume.states_model_error:
        reasons.append(_VOLUME_NOT_STATED)
    outline = trace.product.outline
    if outline is not None and not math.isfinite(outline.xy_std_px) and trace.volume is not None:
        probed = replace(trace.product, outline=offset_contour(outline, _PROBE_PX))
        other = result_or_none(lambda: chain.volume.estimate(probed))
        if other is None or other.visible_mm3.value != trace.volume.visible_mm3.value:
            reasons.append(_OUTLINE_NOT_STATED)
    weigher = chain.weigher and not chain.weigher.states_model_error
    return Unstated(tuple(reasons), (_WEIGHT_NOT_STATED,) if weigher else (), points=not drawn.peaks_stated)


class Sampler:
    """Draws scenes: stripes and outlines with noise, a calibration from its distribution.

    Attributes
    ----------
    causes
        What can be drawn: causes whose size is stated.
    peaks_stated
        Whether each seen point of a product has an uncertainty.
    """

    def __init__(self, scene: Scene, chain: Chain, rng: np.random.Generator) -> None:
        self._scene, self._chain, self._rng = scene, chain, rng
        self._calibrations = scene.calibration.redraws(rng, chain.triangulator.view)
        stripes = scene.stripes
        families = (stripes,) if stripes.across is None else (stripes, stripes.across)
        self.peaks_stated = all(
            bool(np.isfinite(one.x_std_px[one.seen & (one.product > 0)]).all()) for one in families
        )
        self._std_px = [np.nan_to_num(np.where(one.seen, one.x_std_px, 0.0)) for one in families]
        contours = any(math.isfinite(outline.xy_std_px) for outline in scene.outlines)
        known = {PEAKS: self.peaks_stated, CALIBRATION: True, OUTLINE: contours}
        known[PENETRATION] = scene.penetration is not None
        self.causes = tuple(cause for cause, stated in known.items() if stated)
        self._bridges = [_bridges(one) for one in families]
        self._kept: _Kept | None = None

    def scenes(self, count: int, causes: tuple[str, ...]) -> Iterator[Mapping[int, Product]]:
        """Give drawn products by number, `count` times; what is no cause stays as it was found."""
        for _ in range(count):
            scene = self._scene
            stripes, calibration, outlines = scene.stripes, scene.calibration, scene.outlines
            if PEAKS in causes:
                stripes = shifted(stripes, self.noise_px())
            if CALIBRATION in causes:
                calibration = next(self._calibrations)
            if OUTLINE in causes:
                outlines = tuple(moved_by(found, float(self._rng.normal())) for found in outlines)
            light = scene.penetration
            offset_mm = 0.0 if light is None else light.offset_mm
            if light is not None and PENETRATION in causes:
                offset_mm = float(self._rng.normal(offset_mm, light.std_mm))
            yield self.products(stripes, calibration, outlines, offset_mm)

    def products(
        self,
        stripes: StripeMap,
        calibration: Calibration,
        outlines: tuple[Outline, ...],
        offset_mm: float = 0.0,
    ) -> Mapping[int, Product]:
        """Triangulate and assemble; empty where the drawn calibration makes that impossible."""
        triangulator = self._chain.triangulator
        try:
            profiles = triangulator.triangulate(stripes, calibration)
        except RoemetryError:
            return {}
        if offset_mm:
            profiles = raise_surface(profiles, offset_mm)
        drawn = calibration is not self._scene.calibration
        view = calibration.view if drawn else self._scene.view
        found = split_products(profiles, outlines, calibration, self._scene.acquisition_id, view=view)
        return {product.number: product for product in found}

    def noise_px(self) -> tuple[Floats, ...]:
        """(stripe, row) errors, px: correlated along the stripe; bridged points move with their ends.

        Of a grid there are those of the lines across, too.
        """
        return self.as_noise(self.patterns())

    def patterns(self) -> list[Floats]:
        """Draw what `as_noise` makes noise of."""
        return [self.unit_noise(std_px.shape) for std_px in self._std_px]

    def as_noise(self, units: Sequence[Floats]) -> tuple[Floats, ...]:
        """Give errors as `noise_px` does, of such of standard deviation 1."""
        found = []
        for unit, std_px, bridges in zip(units, self._std_px, self._bridges, strict=True):
            noise = unit * std_px
            stripe, gap, before, after, share = bridges
            noise[stripe, gap] = (1.0 - share) * noise[stripe, before] + share * noise[stripe, after]
            found.append(noise)
        return tuple(found)

    def first_patterns(self, count: int) -> Iterator[Sequence[Floats]]:
        """Draw `patterns` so many times, of a generator that has just begun with seed 0.

        They are the same for all scenes of one shape: small ones are drawn once.
        """
        shapes, reach = tuple(one.shape for one in self._std_px), self._scene.stripes.correlation_rows
        if count * sum(rows * columns for rows, columns in shapes) > _KEPT_MAX:
            for _ in range(count):
                yield self.patterns()
            return
        self._kept = shapes, reach, count
        patterns, state = _first_patterns(*self._kept)
        self._rng.bit_generator.state = state
        yield from patterns

    def next_noise(self, shape: tuple[int, ...], first: int, total: int) -> Floats:
        """Give `unit_noise` that follows `first_patterns`, of the numbers from `first` on of so many in all.

        It is the same for all products of all scenes of one shape: if they are few, they are drawn once.
        """
        if self._kept is None or total > _KEPT_MAX:
            return self.unit_noise(shape)
        reach_rows = self._scene.stripes.correlation_rows
        noise = _numbers_after(*self._kept)[first : first + math.prod(shape)].reshape(shape)
        return _smoothed(noise, reach_rows) if reach_rows > 0 else noise

    def unit_noise(self, shape: tuple[int, ...]) -> Floats:
        """(stripe, row) errors of standard deviation 1, correlated along the stripe."""
        return _unit_noise(self._rng, shape, self._scene.stripes.correlation_rows)


_KEPT_MAX = 1_000_000
"""Numbers of patterns that are kept for the next frame, and as many that follow them: 8 MB each."""


_Kept = tuple[tuple[tuple[int, ...], ...], float, int]
"""Shapes, correlation rows and number of the patterns that are drawn first."""


@lru_cache(maxsize=2)
def _first_patterns(
    shapes: tuple[tuple[int, ...], ...], reach_rows: float, count: int
) -> tuple[list[list[Floats]], Mapping[str, Any]]:
    """Give what `Sampler.first_patterns` does, and the state that it leaves the generator in."""
    rng = np.random.default_rng(0)
    patterns = [[_unit_noise(rng, shape, reach_rows) for shape in shapes] for _ in range(count)]
    return patterns, rng.bit_generator.state


@lru_cache(maxsize=2)
def _numbers_after(shapes: tuple[tuple[int, ...], ...], reach_rows: float, count: int) -> Floats:
    """Give `_KEPT_MAX` normal numbers as the generator draws them after `Sampler.first_patterns`."""
    rng = np.random.default_rng()
    rng.bit_generator.state = _first_patterns(shapes, reach_rows, count)[1]
    numbers = rng.standard_normal(_KEPT_MAX)
    numbers.flags.writeable = False
    return numbers


def _unit_noise(rng: np.random.Generator, shape: tuple[int, ...], reach_rows: float) -> Floats:
    noise = rng.standard_normal(shape)
    return _smoothed(noise, reach_rows) if reach_rows > 0 else noise


def shifted(stripes: StripeMap, noise_px: tuple[Floats, ...], sign: float = 1.0) -> StripeMap:
    """Give the stripes, and the lines across, moved by `Sampler.noise_px`."""
    across = stripes.across
    if across is not None:
        across = replace(across, x_px=across.x_px + sign * noise_px[1])
    return replace(stripes, x_px=stripes.x_px + sign * noise_px[0], across=across)


def _bridges(stripes: StripeMap) -> tuple[Integers, Integers, Integers, Integers, Floats]:
    """Give bridged points: stripe, row, the seen rows before and after, how far between them it lies."""
    seen, rows = stripes.seen, np.arange(stripes.rows)
    stripe, gap = np.nonzero(~seen & np.isfinite(stripes.x_px) & seen.any(axis=1, keepdims=True))
    last = np.maximum.accumulate(np.where(seen, rows, -1), axis=1)[stripe, gap]
    next_ = np.minimum.accumulate(np.where(seen, rows, stripes.rows)[:, ::-1], axis=1)[:, ::-1][stripe, gap]
    # beyond the outermost seen row both are that
    before, after = np.where(last < 0, next_, last), np.where(next_ == stripes.rows, last, next_)
    share = np.clip((gap - before) / np.maximum(after - before, 1), 0.0, 1.0)
    return stripe, gap, before, after, share


def _smoothed(noise: Floats, reach_rows: float) -> Floats:
    """White noise of variance 1 with the autocorrelation exp(−Δ²/(4ℓ²)) along axis 1, variance 1."""
    half = max(1, math.ceil(4 * reach_rows))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / reach_rows) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    padded = np.pad(noise, ((0, 0), (half, half)), mode="wrap")
    return np.stack([np.convolve(line, kernel, mode="valid") for line in padded])


def moved_by(outline: Outline, sigmas: float) -> Outline:
    """Move a contour outwards by so many of its standard deviations, and what is read off it up by as many.

    Of a feature its standard uncertainty is told beside it, as `NAME_std`, if it is known: it is taken away,
    since no doubt is left about what was drawn.
    """
    features = dict(outline.features)
    for name in outline.features:
        std = features.pop(f"{name}_std", 0.0)
        if name in features:
            features[name] += sigmas * std
    moved = offset_contour(outline, sigmas * float(np.nan_to_num(outline.xy_std_px)))
    return replace(moved, features=features)


def offset_contour(outline: Outline, by_px: float) -> Outline:
    """Move a contour outwards along its normals."""
    ahead = np.roll(outline.xy_px, -1, axis=0) - np.roll(outline.xy_px, 1, axis=0)
    length = np.sqrt((ahead**2).sum(axis=1))
    normal = np.column_stack([ahead[:, 1], -ahead[:, 0]]) / np.where(length > 0, length, 1.0)[:, None]
    x, y = outline.xy_px.T
    turns_left = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    outwards = 1.0 if turns_left > 0 else -1.0
    return replace(outline, xy_px=outline.xy_px + by_px * outwards * normal)


def rerun(
    chain: Chain,
    trace: ProductTrace,
    product: Product | None,
    rng: np.random.Generator,
    *,
    model: bool,
    graded: bool = True,
) -> Result:
    """Estimate, weigh and classify one drawn product; with `model`, drawing the stages' own errors too."""
    if product is None:
        return Result()
    own = rng if model else None
    before = trace.volume
    volume = None if before is None else result_or_none(lambda: chain.volume.redraw(product, before, rng=own))
    found = _weighed(chain, product, volume, own)._replace(height_max_mm=product.height_max_mm)
    grade = (
        result_or_none(lambda: chain.classifier.redraw(product, rng=own))
        if trace.grade is not None and graded
        else None
    )
    if grade is None:
        return found
    return found._replace(label=grade.label, probability=grade.probability, features=grade.features)


def draw_models(
    trace: ProductTrace, chain: Chain, rng: np.random.Generator, count: int, *, stated_too: bool = True
) -> Mapping[str, list[Result]]:
    """Draw the volume's model alone, and the weigher's model alone, on the product as it was found.

    Without `stated_too` those are left out whose parts the estimate states already.
    """
    product, volume, weight = trace.product, trace.volume, trace.weight
    found: dict[str, list[Result]] = {}
    if volume is None:
        return found
    volume_states = bool(volume.visible_mm3.budget) and not stated_too
    weight_states = weight is not None and bool(weight.mass_g.budget) and not stated_too
    if chain.volume.states_model_error and not volume_states:
        drawn = (result_or_none(lambda: chain.volume.redraw(product, volume, rng=rng)) for _ in range(count))
        found[VOLUME_MODEL] = [_weighed(chain, product, volume, None) for volume in drawn]
    if chain.weigher and chain.weigher.states_model_error and not weight_states:
        found[WEIGHT_MODEL] = [_weighed(chain, product, volume, rng) for _ in range(count)]
    return found


def _weighed(
    chain: Chain, product: Product, volume: Volume | None, rng: np.random.Generator | None
) -> Result:
    if volume is None:
        return Result()
    weight: Weight | None = None
    if chain.weigher:
        weight = result_or_none(lambda: chain.weigher.weigh(product, volume, rng=rng))
    return Result(
        visible_mm3=volume.visible_mm3.value,
        true_mm3=math.nan if volume.true_mm3 is None else volume.true_mm3.value,
        mass_g=math.nan if weight is None else weight.mass_g.value,
    )


def result_or_none(step: Callable[[], Any]) -> Any:
    """Give a step's result, or None where a stage refuses."""
    try:
        return step()
    except RoemetryError:
        return None
