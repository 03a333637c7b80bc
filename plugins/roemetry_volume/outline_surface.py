"""Visible volume from stripes and outline together: the default where a plain-light image exists."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Reason, Shares, Volume
from roemetry.stages import Capabilities, VolumeEstimator
from roemetry_volume.common_error import common_height_std_mm
from roemetry_volume.fusing import Fused, fuse
from roemetry_volume.outline_doubts import outline_fault
from roemetry_volume.slice_doubts import reasons_of
from roemetry_volume.slice_ends import upright_ends
from roemetry_volume.slice_estimators import SlicePchip, gaps_std
from roemetry_volume.slice_options import SliceOptions
from roemetry_volume.slice_table import Slices, slices_of
from roemetry_volume.surface_budget import OUTLINE, budget_of
from roemetry_volume.underside import UndersideOptions, estimate_of, true_volume

_STEPS = 0.7  # of what single slices depart from the course of the others
_STEPS_LEAST = 4
_SMOOTH = 0.012  # of the volume: what a dent or a bend does is in the plate's own budget
_BEYOND, _FAR_BEYOND = 0.015, 0.15
"""Of what lies beyond the outer slices, and times its share: rolls reach far beyond them, roe hardly."""


class OutlineSurface(VolumeEstimator[UndersideOptions]):
    """Integrates a surface through stripes and outline over the footprint.

    Where there is no outline, or none that can be believed, it gives what `slice-pchip` gives, and says so.
    """

    Options = UndersideOptions
    capabilities = Capabilities(relative_tolerance=0.026)

    @property
    def states_model_error(self) -> bool:
        """Whether all of the model's error is drawn."""
        return True

    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the visible volume; with `rng` all is drawn but the outline's place, which a run moves.

        Raises
        ------
        StageError
            Fewer than three stripes lie on the product, it is cut by the image's edge, or the volume is not
            positive.
        """
        slices = slices_of(product)
        why = outline_fault(product, slices)
        if why is not None or product.outline is None or product.view is None:
            return self._by_slices(product, why, rng)
        fused = fuse(product, product.view, product.outline.xy_px, upright_ends(product, slices))
        late = outline_fault(product, slices, fused)
        if late is not None:
            return self._by_slices(product, late, rng)
        volume = _positive(fused.volume_mm3)
        shares = _shares(fused, slices, product)
        budget = budget_of(fused, product.view, product.outline.xy_std_px)
        budget["between slices"] = math.hypot(budget["between slices"], _steps_std(slices, volume))
        budget |= {"gaps": gaps_std(slices), "ends": _beyond_std(shares.assumed) * volume}
        budget["common height"] = common_height_std_mm(product) * float(fused.weight_mm2.sum())
        volume += _model_error(budget, rng)
        visible = estimate_of(volume, budget)
        return Volume(
            visible_mm3=visible,
            true_mm3=true_volume(self.options, visible, float(fused.weight_mm2.sum()), rng),
            shares=shares,
            slice_stripe=slices.stripe,
            slice_area_mm2=slices.area_mm2,
            slice_spacing_mm=slices.held_mm,
            reasons=reasons_of(product, slices) + _reasons(fused),
        )

    def redraw(self, product: Product, found: Volume, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate a drawn product by the budget that was found: to make it takes as long as the surface.

        Raises
        ------
        StageError
            As `estimate` does.
        """
        if OUTLINE not in found.visible_mm3.budget or product.outline is None or product.view is None:
            return self.estimate(product, rng=rng)
        slices = slices_of(product)
        if outline_fault(product, slices) is not None:
            return self.estimate(product, rng=rng)
        fused = fuse(product, product.view, product.outline.xy_px, upright_ends(product, slices))
        if outline_fault(product, slices, fused) is not None:
            return self.estimate(product, rng=rng)
        budget = dict(found.visible_mm3.budget)
        visible = estimate_of(_positive(fused.volume_mm3) + _model_error(budget, rng), budget)
        true = true_volume(self.options, visible, float(fused.weight_mm2.sum()), rng)
        return replace(found, visible_mm3=visible, true_mm3=true)

    def _by_slices(self, product: Product, why: Reason | None, rng: np.random.Generator | None) -> Volume:
        options = SliceOptions(**self.options.model_dump())
        volume = SlicePchip(options).estimate(product, rng=rng)
        return volume if why is None else replace(volume, reasons=(why, *volume.reasons))


def _positive(volume_mm3: float) -> float:
    if not volume_mm3 > 0.0:
        raise StageError(
            f"the surface encloses {volume_mm3:.4g} mm³: the points lie on or below the belt",
            hint="look at the coding and the belt's zero",
        )
    return volume_mm3


def _model_error(budget: Mapping[str, float], rng: np.random.Generator | None) -> float:
    """Draw all causes but the outline's place, which a run moves itself."""
    if rng is None:
        return 0.0
    return sum(std * rng.standard_normal() for cause, std in budget.items() if cause != OUTLINE)


def _reasons(fused: Fused) -> tuple[Reason, ...]:
    if not fused.open_end.any():
        return ()
    return (
        Reason(
            "flat-end",
            "the slices do not fall towards an end of the outline: the surface goes on there as it comes, "
            "up to an upright end",
        ),
    )


def _beyond_std(share: float) -> float:
    """Say how far what lies beyond the outer slices may be off, of the volume."""
    return share * (_BEYOND + _FAR_BEYOND * share)


def _steps_std(slices: Slices, volume_mm3: float) -> float:
    """Say how far the volume may be off where inner slices jump: a stair's riser is anywhere between two."""
    from roemetry_kernels.volume.slice_rules import unevenness

    if slices.t_mm.size < _STEPS_LEAST + 2:
        return 0.0
    uneven: float = unevenness(slices.t_mm[1:-1], slices.area_mm2[1:-1])
    return _STEPS * max(uneven - _SMOOTH * volume_mm3, 0.0)


def _shares(fused: Fused, slices: Slices, product: Product) -> Shares:
    """What lies beyond the outer slices is assumed; between them it is as seen as the slices are."""
    planes = product.profiles.plane
    slope = -planes[:, 2] / planes[:, 0]
    t = slices.table[:, 0]
    lit = [int(np.flatnonzero(product.profiles.stripe == stripe)[0]) for stripe in slices.stripe[[0, -1]]]
    heights = fused.heights()
    xy = _belt_xy(fused)
    beyond = np.zeros(heights.size, np.bool_)
    y0 = 0.5 * float(fused.points.xyz_mm[:, 1].min() + fused.points.xyz_mm[:, 1].max())
    for end, sign in ((0, -1.0), (1, 1.0)):
        plane = planes[lit[end]]
        at = xy[:, 0] + plane[1] / plane[0] * (xy[:, 1] - y0) - slope[lit[end]] * heights
        beyond |= sign * (at - t[-end]) > 0.0
    part = fused.weight_mm2 * np.abs(heights)
    assumed = float(part[beyond].sum() / part.sum())
    between = slices.seen_mm3 + slices.joined_mm3 + slices.assumed_mm3
    seen = (1.0 - assumed) * slices.seen_mm3 / between
    joined = (1.0 - assumed) * slices.joined_mm3 / between
    return Shares(seen, joined, max(1.0 - seen - joined, 0.0) if not math.isnan(seen) else math.nan)


def _belt_xy(fused: Fused) -> np.ndarray:
    """Belt X and Y of the nodes: from three points of the border, whose places are known in both frames."""
    design = np.column_stack([fused.contour, np.ones(fused.contour.shape[0])])
    turn, *_ = np.linalg.lstsq(design, fused.border.xy_mm, rcond=None)
    places: np.ndarray = np.column_stack([fused.s, fused.v, np.ones_like(fused.s)]) @ turn
    return places
