"""Mass by what weighed samples have taught: features of a product, the model as a file, and the stage.

Model. Mass over visible volume is a linear function of features, fitted by ridge regression and judged on
samples that it has not seen (`fit_weights`). The visible volume counts the air below a rounded product, which
lies below the widest line, the rim: a product whose rim is high has more of it, and one that arches over a
gap has a rim that bows.

Fails, and says so, for products unlike the samples (`WeightModel.outside`).
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from roemetry.errors import DataError, StageError
from roemetry.records import NOTHING, Estimate, Fitted, Product, Reason, Samples, Volume, Weight
from roemetry.records.arrays import Floats, Integers
from roemetry.records.units import mm3_to_cm3
from roemetry.stages import Capabilities, StageOptions, Weigher
from roemetry_volume.footprint import area_of, evenly, inside_by
from roemetry_volume.rim import StripePoints, ends_of, rim_of
from roemetry_volume.surface_fit import axes_of, points_of

VERSION = 1

FORMS: Mapping[str, tuple[str, ...]] = {
    "scale": (),
    "offset": ("per_cm3",),
    "ends": ("end_share",),
    "rim": ("end_share", "rim_share", "rim_bow_share"),
}
"""By name of a model, the features that mass over visible volume is linear in."""

BEYOND = 0.25
"""So much of the samples' range may a feature lie outside of it."""

VISIBLE = "visible_cm3"
_LEVEL = 0.8  # of the median height of the slices' ends: the contour is taken to lie so high
_CONTOUR_POINTS = 200  # of the outline, evenly spaced
_SLICES_MIN = 4  # fewer have no features
_POINTS_MIN = 4  # of a slice that counts
PRIOR = 1.0
"""Ridge on coefficients of standardised features, in samples: as much as one sample that says "no effect"."""
FREE_MIN = 5
"""Least number of samples beyond the coefficients; so Student's t has a standard deviation at any rate."""
_FOLDS_MAX = 50  # of cross-validation: up to so many samples each is left out alone
_SIMPLER = 0.97
"""A form with more features must bring the error below this share of a plainer one's."""

DENSITY_RANGE = (0.05, 25.0)
"""Mass over visible volume, g/cm³, of anything that is weighed: from puffed food to tungsten."""

UNITS_G = {"kilograms": 1000.0, "pounds": 453.592, "ounces": 28.3495, "milligrams": 0.001}
"""Grams in each."""

_LIKELY = (0.2, 3.0)  # g/cm³: a unit that brings the masses there is named
_SAME_UNIT = 0.2  # in natural logarithms: a mass off by a unit's factor is off by it to 20 %
_FAR_STDS = 4.0  # of the samples' robust scatter, and
_FAR_SHARE = 0.1  # of the fitted mass: what is farther off than both is named
_NAMED = 5  # samples in a message
_FOR_TREND = 8  # samples from which on masses must follow volumes
_BY_CHANCE = 0.05
"""Ranks that agree no better than this share of shuffled tables do show no trend."""


class FittedWeightOptions(StageOptions):
    """Options of `FittedWeight`."""

    model: Path | None = Field(
        default=None, description="file of `roemetry fit-weight`; none: features only, no mass"
    )


class FittedWeight(Weigher[FittedWeightOptions]):
    """Multiplies the visible volume by a ratio that weighed samples of the same product have taught.

    The ratio may depend on how high the product's widest line lies, below which there is air. The mass has
    the prediction interval of one more product: scatter of the samples, uncertainty of the fit, and few
    samples (Student's t). The volume's own random error is part of the samples' scatter.
    """

    capabilities = Capabilities(fixture="roemetry_volume.fitted_weight:weight_options")

    @property
    def states_model_error(self) -> bool:
        """Whether there is a model, which has a scatter."""
        return self.options.model is not None

    @cached_property
    def _model(self) -> WeightModel | None:
        return None if self.options.model is None else WeightModel.load(self.options.model)

    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Reckon the mass; given `rng`, draw the product's own ratio from Student's t.

        Raises
        ------
        StageError
            The model's file is none, or damaged.
        """
        model = self._model
        features = weight_features(product, volume)
        if model is None:
            return Weight(Estimate(math.nan), (_NO_MODEL,), features)
        asked = with_inverse(features)
        ratio, of_fit, scatter = model.ratio(asked)
        if math.isnan(ratio):
            missing = ", ".join(name for name in model.features if name not in asked)
            return Weight(
                Estimate(math.nan),
                (Reason("weight-feature-missing", f"{missing} could not be measured: no mass without it"),),
                features,
            )
        outside = model.outside(asked)
        reasons = (Reason("outside-weighed", f"not valid here: {'; '.join(outside)}"),) if outside else ()
        visible = features[VISIBLE]
        value, std = visible * ratio, visible * math.hypot(of_fit, scatter)
        if rng is not None:
            # Student's t of standard deviation 1, times the uncertainty
            drawn = rng.standard_t(model.degrees_of_freedom) / model.student_std
            return Weight(Estimate(value + std * drawn), reasons, features)
        if value < 0.0:
            return Weight(Estimate(math.nan), (_NEGATIVE, *reasons), features)
        if not value > 0.0:
            return Weight(Estimate(value), reasons, features)
        from scipy.stats import t

        # `std` is the standard deviation of Student's t; the quantile is of its scale
        half = std / model.student_std * float(t.ppf(0.975, model.degrees_of_freedom))
        budget = {"samples' scatter": visible * scatter, "fit": visible * of_fit}
        return Weight(Estimate(value, std, budget, (value - half, value + half)), reasons, features)

    @classmethod
    def fit(cls, samples: Samples, *, form: str = "auto") -> Fitted:
        """Learn from weighed products; see `fit_weights`."""
        return fit_weights(samples, form=form)


def with_inverse(features: dict[str, float]) -> dict[str, float]:
    """Add one over the volume, by which an offset of the mass is a share of it."""
    visible = features[VISIBLE]
    return features if not visible > 0.0 else {**features, "per_cm3": 1.0 / visible}


@dataclass(frozen=True, eq=False)
class WeightModel:
    """Mass over visible volume, g/cm³, as a linear function of features."""

    form: str
    """A key of `FORMS`."""
    features: tuple[str, ...]
    """Names, in the coefficients' order."""
    centre: Floats
    spread: Floats
    """centre, spread: (feature,) mean and standard deviation of the samples."""
    coefficients: Floats
    """(1 + feature,) g/cm³: at the centre, and for each spread off it."""
    covariance: Floats
    """(1 + feature, 1 + feature) of the coefficients, (g/cm³)²."""
    scatter_g_per_cm3: float
    """Standard deviation of products about the function."""
    degrees_of_freedom: float
    """Of that."""
    limits: Mapping[str, tuple[float, float]]
    """By feature, and for `visible_cm3`, smallest and largest value among the samples."""

    def ratio(self, features: Mapping[str, float]) -> tuple[float, float, float]:
        """Give mass over visible volume, its uncertainty from the fit alone, and the scatter, g/cm³.

        Both are standard deviations of a Student's t of `degrees_of_freedom`. NaN where a feature is missing.
        """
        values = np.array([features.get(name, math.nan) for name in self.features])
        row = np.concatenate([[1.0], (values - self.centre) / self.spread])
        wider = self.student_std
        of_fit = math.sqrt(float(row @ self.covariance @ row)) if np.isfinite(row).all() else math.nan
        return float(row @ self.coefficients), wider * of_fit, wider * self.scatter_g_per_cm3

    @property
    def student_std(self) -> float:
        """Standard deviation of Student's t of the model's degrees of freedom."""
        return math.sqrt(self.degrees_of_freedom / (self.degrees_of_freedom - 2.0))

    def outside(self, features: Mapping[str, float]) -> tuple[str, ...]:
        """Say of which features a product lies beyond the samples."""
        said = []
        for name, (low, high) in self.limits.items():
            slack = BEYOND * (high - low)
            value = features.get(name, math.nan)
            if not low - slack <= value <= high + slack:
                said.append(f"{name} is {value:.3g}, the weighed samples have {low:.3g} to {high:.3g}")
        return tuple(said)

    def to_json(self, about: Mapping[str, Any]) -> str:
        """Write the model, with whatever is to be said about it."""
        content = {
            "roemetry_weight": VERSION,
            "about": dict(about),
            "form": self.form,
            "features": list(self.features),
            "centre": self.centre.tolist(),
            "spread": self.spread.tolist(),
            "coefficients": self.coefficients.tolist(),
            "covariance": self.covariance.tolist(),
            "scatter_g_per_cm3": self.scatter_g_per_cm3,
            "degrees_of_freedom": self.degrees_of_freedom,
            "limits": {name: list(ends) for name, ends in self.limits.items()},
        }
        return json.dumps(content, allow_nan=False, indent=1) + "\n"

    @classmethod
    def load(cls, path: Path) -> WeightModel:
        """Read a file; raise StageError where it is none, or damaged."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["roemetry_weight"] != VERSION:
                raise StageError(f"{path.name}: format {data['roemetry_weight']}, expected {VERSION}")
            count = len(data["features"])
            return cls(
                form=str(data["form"]),
                features=tuple(data["features"]),
                centre=np.array(data["centre"], np.float64).reshape(count),
                spread=np.array(data["spread"], np.float64).reshape(count),
                coefficients=np.array(data["coefficients"], np.float64).reshape(count + 1),
                covariance=np.array(data["covariance"], np.float64).reshape(count + 1, count + 1),
                scatter_g_per_cm3=float(data["scatter_g_per_cm3"]),
                degrees_of_freedom=float(data["degrees_of_freedom"]),
                limits={name: (float(low), float(high)) for name, (low, high) in data["limits"].items()},
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StageError(
                f"{path.name} is no fitted weigher, or it is damaged: {type(error).__name__}: {error}",
                hint="make it with `roemetry fit-weight`",
            ) from error


def weight_features(product: Product, volume: Volume) -> dict[str, float]:
    """Give the features by name, units in the names; shares are of the mean height over the footprint.

    Returns
    -------
    dict
        `visible_cm3`; `end_share`, the height of the slices' ends at the product's middle; with an outline
        and a view also `rim_share`, the height of the rim at the middle, and `rim_bow_share`, how far it
        falls (negative) or rises from there to the ends. Empty but for the volume with fewer than four
        slices.
    """
    found = {VISIBLE: mm3_to_cm3(volume.visible_mm3.value)}
    points = points_of(_seen(product))
    if len(points.first) - 1 < _SLICES_MIN or np.diff(points.first).min(initial=99) < 1:
        return found
    return found | _by_ends(points) | _by_rim(product, points, volume)


def _seen(product: Product) -> Product:
    """Leave bridged points out: at its end a stripe is bridged down to the belt, which is no rim."""
    profiles = product.profiles
    mine = np.where(profiles.seen, profiles.product, NOTHING)
    return replace(product, profiles=replace(profiles, product=mine))


def _by_ends(points: StripePoints) -> dict[str, float]:
    """Fit a parabola along the product to the heights of the slices' ends."""
    places, ends, area, width = [], [], 0.0, 0.0
    for begin, stop in zip(points.first[:-1].tolist(), points.first[1:].tolist(), strict=True):
        if stop - begin < _POINTS_MIN:
            continue
        x, y, z = points.xyz_mm[begin:stop].T
        # in the order of Y, for the trapezoid rule
        order = np.argsort(y, kind="stable")
        y, z = y[order], z[order]
        places.append(float(np.median(x)))
        ends.append((z[0], z[-1]))
        area += float((0.5 * (z[1:] + z[:-1]) * np.diff(y)).sum())
        width += float(y[-1] - y[0])
    if len(places) < _SLICES_MIN or not (area > 0.0 and width > 0.0):
        return {}
    at = np.array(places)
    # from −1 to 1 along the product
    at = (at - 0.5 * (at.min() + at.max())) / max(0.5 * float(np.ptp(at)), 1e-9)
    # the parabola's value at the middle
    level = np.polyfit(np.concatenate([at, at]), np.array(ends).T.ravel(), 2)[2]
    return {"end_share": float(level / (area / width))}


def _by_rim(product: Product, points: StripePoints, volume: Volume) -> dict[str, float]:
    if product.outline is None or product.view is None or not volume.visible_mm3.value > 0.0:
        return {}
    ends = ends_of(points, points.xyz_mm[:, 1])
    level = _LEVEL * float(np.median(points.xyz_mm[ends[0][ends[1]], 2]))
    xy = product.view.at_height(evenly(product.outline.xy_px, _CONTOUR_POINTS), level)[:, :2]
    if not np.isfinite(xy).all():
        return {}
    centre, turn = axes_of(xy)
    place = (points.xyz_mm[:, :2] - centre) @ turn
    contour = (xy - centre) @ turn
    rim = rim_of(points, ends, place, inside_by(contour, place[ends[0]]))
    # mean height over the footprint
    mean_mm = volume.visible_mm3.value / abs(area_of(contour))
    return {
        "rim_share": float(rim.coefficients[0] / mean_mm),
        "rim_bow_share": float(rim.coefficients[2] / mean_mm),
    }


def weight_options() -> FittedWeightOptions:
    """Write a model of 1.1 g/cm³ with a scatter of 0.05 g/cm³; give its options."""
    nothing = np.empty(0)
    model = WeightModel(
        form="scale",
        features=(),
        centre=nothing,
        spread=nothing,
        coefficients=np.array([1.1]),
        covariance=np.array([[0.05**2 / 20]]),
        scatter_g_per_cm3=0.05,
        degrees_of_freedom=19.0,
        limits={"visible_cm3": (1.0, 100.0)},
    )
    path = Path(tempfile.mkdtemp()) / "one_ratio.json"
    path.write_text(model.to_json({"samples": 20}), encoding="utf-8")
    return FittedWeightOptions(model=path)


_NO_MODEL = Reason("no-weight-model", "there is no model yet: the features are measured, the mass is not")
_NEGATIVE = Reason("negative-weight", "the model would give less than nothing: it does not hold here")


def fit_weights(samples: Samples, *, form: str = "auto") -> Fitted:
    """Fit on all samples; judge on folds that share no group.

    Parameters
    ----------
    samples
        With masses and the features of the weigher `fitted`.
    form
        A key of `FORMS`, or ``auto``: the one that does best on held-out samples, of like ones the plainest.

    Raises
    ------
    StageError
        There is no such form.
    DataError
        No column `visible_cm3`; too few samples; masses in another unit; masses that do not follow the
        volumes; features missing that the form needs.
    """
    if form != "auto" and form not in FORMS:
        raise StageError(f"there is no form `{form}`", hint=f"there are auto, {', '.join(FORMS)}")
    table = _table(samples)
    check_masses(table.ids, table.masses_g, table.visible_cm3)
    tried = {name: _held_out(table, name) for name in FORMS if table.has(name)}
    if form != "auto" and form not in tried:
        raise DataError(
            f"the form `{form}` needs {' and '.join(FORMS[form])} of more samples than the table has",
            hint=f"there is enough for {', '.join(tried)}" if tried else "weigh more products",
        )
    if not tried:
        raise DataError(
            f"only {len(table.masses_g)} weighed products can be used; at least {FREE_MIN + 1} are needed",
            hint="weigh more: 20 are a good start",
        )
    chosen = form if form != "auto" else _best(tried)
    model = _fitted(table, chosen, chosen_of=len(tried) if form == "auto" else 1)
    figures = _figures(table, tried, chosen)
    words = _words(table, tried, chosen, len(samples.ids))
    return Fitted(model.to_json({"samples": len(table.masses_g), **figures}), figures, words)


@dataclass(frozen=True, eq=False)
class _Table:
    """Samples that can be used."""

    ids: tuple[str, ...]
    masses_g: Floats
    visible_cm3: Floats
    group: Integers
    columns: Mapping[str, Floats]

    def has(self, form: str) -> bool:
        """Whether there is enough for a form."""
        enough = len(self.masses_g) >= len(FORMS[form]) + 1 + FREE_MIN
        return enough and all(
            name in self.columns and bool(np.isfinite(self.columns[name]).all()) for name in FORMS[form]
        )

    def design(self, form: str) -> Floats:
        """(sample, feature) values."""
        columns = [self.columns[name] for name in FORMS[form]]
        return np.column_stack(columns) if columns else np.empty((len(self.masses_g), 0))


@dataclass(frozen=True, eq=False)
class _Errors:
    """(sample,) relative errors on samples that were held out, and whether the interval held them."""

    relative: Floats
    held: Floats
    width: Floats

    @property
    def rms(self) -> float:
        return float(np.sqrt((self.relative**2).mean()))


def _table(samples: Samples) -> _Table:
    if VISIBLE not in samples.features:
        raise DataError(
            f"there is no column `{VISIBLE}`",
            hint="measure with the weigher `fitted` (without a model) and `csv` with `features: true`",
        )
    columns = {name: samples.values[:, k] for k, name in enumerate(samples.features)}
    visible = columns[VISIBLE]
    usable = np.isfinite(visible) & (visible > 0.0) & np.isfinite(samples.mass_g)
    with np.errstate(divide="ignore"):
        columns["per_cm3"] = 1.0 / visible
    groups = np.unique(np.array(samples.groups), return_inverse=True)[1]
    return _Table(
        ids=tuple(name for name, use in zip(samples.ids, usable, strict=True) if use),
        masses_g=samples.mass_g[usable],
        visible_cm3=visible[usable],
        group=groups[usable],
        columns={name: values[usable] for name, values in columns.items()},
    )


def _fitted(table: _Table, form: str, which: Floats | None = None, chosen_of: int = 1) -> WeightModel:
    """Fit some samples, all by default.

    A form that the same samples have chosen of several has adapted to them by that, too: the choice counts as
    one more coefficient.
    """
    use = np.ones(len(table.masses_g), np.bool_) if which is None else which
    values, ratio = table.design(form)[use], table.masses_g[use] / table.visible_cm3[use]
    count = len(ratio)
    centre = values.mean(axis=0)
    spread = values.std(axis=0, ddof=1)
    # a feature that never varies is left as it is
    spread = np.where(spread > 0.0, spread, 1.0)
    rows = np.column_stack([np.ones(count), (values - centre) / spread])
    # the mean is not shrunk
    penalty = np.diag([0.0] + [PRIOR] * values.shape[1])
    inverse = np.linalg.inv(rows.T @ rows + penalty)
    coefficients = inverse @ rows.T @ ratio
    # the trace counts coefficients, less what the ridge holds back
    free = count - float(np.trace(rows @ inverse @ rows.T)) - float(chosen_of > 1)
    variance = float(((ratio - rows @ coefficients) ** 2).sum()) / free
    limits = {name: table.columns[name][use] for name in (VISIBLE, *FORMS[form])}
    return WeightModel(
        form=form,
        features=FORMS[form],
        centre=centre,
        spread=spread,
        coefficients=coefficients,
        covariance=variance * inverse,
        scatter_g_per_cm3=math.sqrt(variance),
        degrees_of_freedom=free,
        limits={name: (float(column.min()), float(column.max())) for name, column in limits.items()},
    )


def _held_out(table: _Table, form: str) -> _Errors:
    """Judge a form: each group of samples by a model that has not seen it."""
    from scipy.stats import t

    numbers = np.unique(table.group)
    # groups are dealt out to the folds in turn
    fold_of = dict(zip(numbers.tolist(), (np.arange(numbers.size) % _FOLDS_MAX).tolist(), strict=True))
    fold = np.array([fold_of[number] for number in table.group.tolist()])
    relative, held, width = (np.full(fold.size, np.nan) for _ in range(3))
    for number in np.unique(fold):
        asked = fold == number
        # too few are left to fit
        if (~asked).sum() < len(FORMS[form]) + 4:
            continue
        model = _fitted(table, form, ~asked)
        factor = float(t.ppf(0.975, model.degrees_of_freedom)) / model.student_std
        for sample in np.flatnonzero(asked):
            ratio, of_fit, scatter = model.ratio({n: c[sample] for n, c in table.columns.items()})
            true = table.masses_g[sample] / table.visible_cm3[sample]
            half = factor * math.hypot(of_fit, scatter)
            relative[sample] = ratio / true - 1.0
            held[sample] = abs(ratio - true) <= half
            width[sample] = 2.0 * half / ratio
    known = np.isfinite(relative)
    return _Errors(relative[known], held[known], width[known])


def _best(tried: Mapping[str, _Errors]) -> str:
    chosen = ""
    for name, errors in tried.items():
        if not errors.relative.size:
            continue
        # from the plainest on, as `FORMS` has them
        if not chosen or errors.rms < _SIMPLER * tried[chosen].rms:
            chosen = name
    return chosen or next(iter(tried))


def _figures(table: _Table, tried: Mapping[str, _Errors], chosen: str) -> dict[str, float]:
    errors = tried[chosen]
    if not errors.relative.size:
        return {"samples": float(len(table.masses_g))}
    figures = {
        "samples": float(len(table.masses_g)),
        "error_mean_share": float(np.abs(errors.relative).mean()),
        "error_largest_share": float(np.abs(errors.relative).max()),
        "interval_held_share": float(errors.held.mean()),
        "interval_width_median_share": float(np.median(errors.width)),
    }
    for name, other in tried.items():
        if other.relative.size:
            figures[f"error_mean_share_{name}"] = float(np.abs(other.relative).mean())
    return figures


def _words(table: _Table, tried: Mapping[str, _Errors], chosen: str, given: int) -> tuple[str, ...]:
    count, groups = len(table.masses_g), len(np.unique(table.group))
    said = [
        f"{count} weighed products in {groups} groups; form `{chosen}`"
        + (f" of {', '.join(tried)}" if len(tried) > 1 else "")
        + "; judged on products that were left out"
    ]
    if given > count:
        said.append(f"{given - count} weighed products were not used: their volume was not measured")
    if groups < FREE_MIN + 1:
        said.append(f"there are {groups} groups only: how it does on others is hardly known")
    said += far_off(table.ids, table.masses_g, table.visible_cm3 * _ratios(table, chosen))
    return tuple(said)


def _ratios(table: _Table, form: str) -> Floats:
    model = _fitted(table, form)
    rows = [{name: float(column[k]) for name, column in table.columns.items()} for k in range(len(table.ids))]
    return np.array([model.ratio(row)[0] for row in rows])


def check_masses(ids: Sequence[str], masses_g: Floats, visible_cm3: Floats) -> None:
    """Raise DataError where masses cannot be grams of these products.

    Parameters
    ----------
    ids, masses_g, visible_cm3
        (sample,) names, masses as they were given, and visible volumes, all above 0.
    """
    if not len(ids):
        raise DataError(
            "no weighed product has a measured volume", hint="look at the run: was anything measured?"
        )
    density = masses_g / visible_cm3
    usual = float(np.median(density))
    if not DENSITY_RANGE[0] <= usual <= DENSITY_RANGE[1]:
        units = [name for name, grams in UNITS_G.items() if _LIKELY[0] <= usual * grams <= _LIKELY[1]]
        maybe = f"are they {' or '.join(units)}? " if units else ""
        raise DataError(
            f"the masses are {usual:.3g} times the visible volumes in cm³ (median): these are not grams",
            hint=f"{maybe}`mass_g` is in grams; also look at the calibration's scale",
        )
    # some masses in another unit than the others
    odd = np.abs(np.log(density / usual))
    for name, grams in UNITS_G.items():
        like = (odd > np.log(3.0)) & (np.abs(np.log(density * grams / usual)) < _SAME_UNIT)
        if like.any():
            named = ", ".join(ids[k] for k in np.flatnonzero(like)[:_NAMED])
            raise DataError(
                f"{int(like.sum())} of {len(ids)} masses are off by the factor of {name} ({named})",
                hint="one unit for all of them: grams",
            )
    _check_trend(masses_g, visible_cm3)


def _check_trend(masses_g: Floats, visible_cm3: Floats) -> None:
    """Refuse masses that no volume says anything of, where volumes differ enough to tell."""
    if len(masses_g) < _FOR_TREND or np.log(visible_cm3).std() < 0.1:
        return
    from scipy.stats import spearmanr

    # One odd sample does not unmake a trend: medians, and ranks.
    scatter, alone = _scatter(np.log(masses_g / visible_cm3)), _scatter(np.log(masses_g))
    ranks = spearmanr(masses_g, visible_cm3, alternative="greater")
    if scatter > alone or not ranks.pvalue <= _BY_CHANCE:
        raise DataError(
            f"the masses do not follow the volumes: mass over volume scatters by {scatter:.0%}, masses alone "
            f"by {alone:.0%}; their ranks agree by {ranks.statistic:+.2f} of 1",
            hint="were rows mixed up, or ids of one table given to the other's products?",
        )


def _scatter(values: Floats) -> float:
    # 1.4826 makes it the standard deviation of normal values
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def far_off(ids: Sequence[str], masses_g: Floats, fitted_g: Floats) -> list[str]:
    """Name samples far from what was fitted: perhaps another product's weight."""
    off = masses_g / fitted_g - 1.0
    usual = _scatter(off)
    far = np.flatnonzero(np.abs(off) > max(_FAR_STDS * usual, _FAR_SHARE))
    far = far[np.argsort(-np.abs(off[far]))]
    return [
        f"look at {ids[k]}: {masses_g[k]:.4g} g, fitted {fitted_g[k]:.4g} g ({off[k]:+.0%}); "
        "is that its own weight?"
        for k in far[:_NAMED]
    ]
