"""Fit mass over visible volume to weighed products; judge it on products it has not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roemetry.errors import DataError, StageError
from roemetry.records import Fitted, Samples
from roemetry.records.arrays import Floats, Integers
from roemetry_volume.weighed_faults import check_masses, far_off
from roemetry_volume.weight_features import VISIBLE
from roemetry_volume.weight_model import FORMS, WeightModel

PRIOR = 1.0
"""Ridge on coefficients of standardised features, in samples: as much as one sample that says "no effect"."""
FREE_MIN = 5
"""Least number of samples beyond the coefficients; so Student's t has a standard deviation at any rate."""
_FOLDS_MAX = 50
_SIMPLER = 0.97
"""A form with more features must bring the error below this share of a plainer one's."""


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
    spread = np.where(spread > 0.0, spread, 1.0)
    rows = np.column_stack([np.ones(count), (values - centre) / spread])
    penalty = np.diag([0.0] + [PRIOR] * values.shape[1])
    inverse = np.linalg.inv(rows.T @ rows + penalty)
    coefficients = inverse @ rows.T @ ratio
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
    fold_of = dict(zip(numbers.tolist(), (np.arange(numbers.size) % _FOLDS_MAX).tolist(), strict=True))
    fold = np.array([fold_of[number] for number in table.group.tolist()])
    relative, held, width = (np.full(fold.size, np.nan) for _ in range(3))
    for number in np.unique(fold):
        asked = fold == number
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
