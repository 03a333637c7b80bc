"""Visible volume from stripes and outline together: the default where a plain-light image exists.

Model. A thin plate through the slices' points that meets the rim where the outline shows it
(`roemetry_volume.surface_fit`) is integrated over the footprint (`roemetry_volume.footprint`). What is
uncertain is told by what changes the volume: leaving out single slices, a stiffer plate, a border that lies
farther out, a rim that lies higher.

Assumed: between slices the product is as smooth as its slices show, and its footprint is what the outline
encloses. It fails where there is no outline, or one that contradicts the stripes, and at holes: the volume is
then that of the slices alone, and a reason says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Reason, Shares, Surface, Volume
from roemetry.records.arrays import Flags, Floats
from roemetry.records.view import View
from roemetry.stages import Capabilities, VolumeEstimator
from roemetry_volume.slice_estimators import (
    SlicePchip,
    common_height_std_mm,
    gaps_std,
    reasons_of,
)
from roemetry_volume.slice_table import Slices, slices_of
from roemetry_volume.spline import add_points
from roemetry_volume.surface_fit import LONG_AXIS, FittedSurface, fit_surface, plate_through, without_slice
from roemetry_volume.underside import UndersideOptions, estimate_of, true_volume, underside_reasons

_STEPS = 0.7  # of what single slices depart from the course of the others
_STEPS_LEAST = 4  # inner slices: fewer have no course to depart from
_SMOOTH = 0.012  # of the volume: what a dent or a bend does is in the plate's own budget
_BEYOND, _FAR_BEYOND = 0.015, 0.15
"""Of what lies beyond the outer slices, and times its share: rolls reach far beyond them, roe hardly."""


class OutlineSurface(VolumeEstimator[UndersideOptions]):
    """Integrates a surface through stripes and outline over the footprint.

    Where there is no outline, or none that can be believed, it gives what `slice-pchip` gives, and says so.
    An outline that disagrees with the stripes may still be right, if dim flanks leave them short: then the
    two volumes are a rectangle's middle and end, and their distance over √3 joins the uncertainty.
    """

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
        fused = fit_surface(product, product.view, product.outline)
        late = outline_fault(product, slices, fused)
        if late is not None:
            by_slices = self._by_slices(product, late, rng)
            return _widened(by_slices, abs(fused.volume_mm3 / by_slices.visible_mm3.value - 1.0), rng)
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
            reasons=reasons_of(product, slices) + _reasons(fused) + underside_reasons(self.options),
            solution=fused.start,
        )

    def redraw(self, product: Product, found: Volume, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate a product that has moved a little, from the surface and by the budget that were found.

        Raises
        ------
        StageError
            As `estimate` does.
        """
        if OUTLINE not in found.visible_mm3.budget or product.outline is None or product.view is None:
            return self.estimate(product, rng=rng)
        fused = fit_surface(product, product.view, product.outline, found.solution)
        budget = dict(found.visible_mm3.budget)
        visible = estimate_of(_positive(fused.volume_mm3) + _model_error(budget, rng), budget)
        true = true_volume(self.options, visible, float(fused.weight_mm2.sum()), rng)
        return replace(found, visible_mm3=visible, true_mm3=true)

    def surface(self, product: Product) -> Surface:
        """Give the plate over the footprint, or the slices and their caps where no outline was used."""
        slices = slices_of(product)
        if (
            outline_fault(product, slices) is None
            and product.outline is not None
            and product.view is not None
        ):
            fused = fit_surface(product, product.view, product.outline)
            if outline_fault(product, slices, fused) is None:
                return _drawn(fused, slices, product)
        return self._slices().surface(product)

    def _by_slices(self, product: Product, why: Reason | None, rng: np.random.Generator | None) -> Volume:
        volume = self._slices().estimate(product, rng=rng)
        return volume if why is None else replace(volume, reasons=(why, *volume.reasons))

    def _slices(self) -> SlicePchip:
        return SlicePchip(self.options)


def _widened(volume: Volume, apart: float, rng: np.random.Generator | None) -> Volume:
    """Add to a volume's uncertainties what outline and stripes are apart by, as a share of it."""
    share = apart / math.sqrt(3.0) if math.isfinite(apart) else 1.0
    times = 1.0 if rng is None else math.exp(share * float(rng.standard_normal()))  # never negative

    def wider(one: Estimate) -> Estimate:
        budget = {**one.budget, "outline or stripes": share * one.value}
        return estimate_of(one.value * times, budget)

    true = volume.true_mm3
    return replace(
        volume, visible_mm3=wider(volume.visible_mm3), true_mm3=None if true is None else wider(true)
    )


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


def _reasons(fused: FittedSurface) -> tuple[Reason, ...]:
    if not fused.open_end.any():
        return ()
    return (
        Reason(
            "flat-end",
            "the slices do not fall towards an end of the outline: the surface is continued there up to an "
            "upright end",
        ),
    )


def _beyond_std(share: float) -> float:
    """Say how far what lies beyond the outer slices may be off, of the volume."""
    return share * (_BEYOND + _FAR_BEYOND * share)


def _steps_std(slices: Slices, volume_mm3: float) -> float:
    """Say how far the volume may be off where inner slices jump: a stair's riser is anywhere between two."""
    from roemetry_volume.slice_rules import unevenness

    if slices.t_mm.size < _STEPS_LEAST + 2:
        return 0.0
    # the outer slices fall at any rate: the inner ones alone tell of steps
    uneven: float = unevenness(slices.t_mm[1:-1], slices.area_mm2[1:-1])
    return _STEPS * max(uneven - _SMOOTH * volume_mm3, 0.0)


_DRAWN = 61, 27
"""Stations along a drawn surface, points across each: at most 2 mm apart on a skein."""
_NEAR_RIM_MM = 2.0
"""A dome meets its rim upright, where the square root of what the plate is off by shows as a zigzag."""


def _drawn(fused: FittedSurface, slices: Slices, product: Product) -> Surface:
    """Lay a grid over the footprint, closer towards its border, where the surface is steepest."""
    from roemetry_volume.footprint import inside_by

    # closer together at both ends, as sines are
    along, across = (np.sin(np.linspace(-0.5 * math.pi, 0.5 * math.pi, count)) for count in _DRAWN)
    low, high = fused.contour[:, 0].min(), fused.contour[:, 0].max()
    s = 0.5 * (low + high) + 0.4999 * (high - low) * along
    v = np.empty(_DRAWN)
    for station, at in enumerate(s.tolist()):
        left, right = _crossings(fused.contour, at)
        v[station] = 0.5 * (left + right) + 0.5 * (right - left) * across
    places = np.column_stack([np.repeat(s, _DRAWN[1]), v.ravel()])
    grid = replace(fused, s=places[:, 0], v=places[:, 1])
    heights, rim = grid.heights().reshape(_DRAWN), fused.rim.at(grid.s, grid.v).reshape(_DRAWN)
    for border in (0, -1):
        near = np.abs(heights[:, border] - rim[:, border]) < _NEAR_RIM_MM
        heights[near, border] = rim[near, border]
    xyz = np.column_stack([_belt_xy(grid), np.maximum(heights.ravel(), 0.0)])
    xyz[inside_by(fused.contour, places) < -_STEP_MM] = math.nan
    return Surface(xyz.reshape(*_DRAWN, 3), _beyond(grid, slices, product).reshape(_DRAWN))


def _crossings(contour: Floats, s: float) -> tuple[float, float]:
    """Give the outermost places where a line across the product meets its border."""
    ahead = np.roll(contour, -1, axis=0)
    # pieces of the border that cross s
    cut = (contour[:, 0] <= s) != (ahead[:, 0] <= s)
    one, other = contour[cut], ahead[cut]
    v = one[:, 1] + (s - one[:, 0]) / (other[:, 0] - one[:, 0]) * (other[:, 1] - one[:, 1])
    return float(v.min()), float(v.max())


def _shares(fused: FittedSurface, slices: Slices, product: Product) -> Shares:
    """What lies beyond the outer slices is assumed; between them it is as seen as the slices are."""
    part = fused.weight_mm2 * np.abs(fused.heights())
    assumed = float(part[_beyond(fused, slices, product)].sum() / part.sum())
    between = slices.seen_mm3 + slices.joined_mm3 + slices.assumed_mm3
    seen = (1.0 - assumed) * slices.seen_mm3 / between
    joined = (1.0 - assumed) * slices.joined_mm3 / between
    return Shares(seen, joined, max(1.0 - seen - joined, 0.0) if not math.isnan(seen) else math.nan)


def _beyond(fused: FittedSurface, slices: Slices, product: Product) -> Flags:
    """Say which nodes lie beyond the outer slices."""
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
        # where a plane that leans as the outer slice's, through the node, cuts the belt
        at = xy[:, 0] + plane[1] / plane[0] * (xy[:, 1] - y0) - slope[lit[end]] * heights
        beyond |= sign * (at - t[-end]) > 0.0
    return beyond


def _belt_xy(fused: FittedSurface) -> np.ndarray:
    """Belt X and Y of the nodes: from three points of the border, whose places are known in both frames."""
    design = np.column_stack([fused.contour, np.ones(fused.contour.shape[0])])
    turn, *_ = np.linalg.lstsq(design, fused.border.xy_mm, rcond=None)
    places: np.ndarray = np.column_stack([fused.s, fused.v, np.ones_like(fused.s)]) @ turn
    return places


OUTLINE_STD_PX = 0.3
"""Taken where the outliner does not say how sure its contour is."""

OUTLINE = "outline"
"""The cause that a run draws itself, by moving the contour."""

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/outline-surface.md
_BETWEEN = 0.13  # of what leaving single slices out changes, in quadrature: with them, gaps are half as wide
_FEW = 7.0  # and that over the square of their number: few slices do not show how smooth the product is
_STIFFER = 30.0  # times the plate's stiffness, of another plate that it is compared with
_SETTINGS = 0.4  # of what a plate so much stiffer changes
_LEAST_STD = 0.0004  # of the volume: the border's place and shape, however many stripes there are
_STEP_MM = 0.2
"""Of differences: about the rim's own uncertainty, since what is square there is not even nearly linear."""


def budget_of(fused: FittedSurface, view: View, outline_std_px: float) -> dict[str, float]:
    """Give standard uncertainties by cause, mm³: between slices, settings, outline, rim."""
    px_mm = _mm_per_px(fused, view)
    std_px = OUTLINE_STD_PX if math.isnan(outline_std_px) else outline_std_px
    return {
        "between slices": _left_out(fused),
        "settings": math.hypot(
            _SETTINGS * (_stiffer(fused) - fused.volume_mm3), _LEAST_STD * fused.volume_mm3
        ),
        OUTLINE: std_px * px_mm * abs(_per_mm_outwards(fused, np.ones(fused.height_mm.size))),
        "rim": fused.rim.std_mm * abs(_per_mm_of_rim(fused)),
    }


def _left_out(fused: FittedSurface) -> float:
    """Part of what the volume changes by when each slice in turn is left out, in quadrature."""
    total = 0.0
    volume = fused.volume_mm3
    slices = np.unique(fused.knots.slice)
    for number in slices:
        changed = replace(fused.plate, coefficients=without_slice(fused.plate, fused.knots, int(number)))
        values = changed.at(LONG_AXIS * fused.s, fused.v)
        total += (_volume(fused, values) - volume) ** 2
    return (_BETWEEN + _FEW / slices.size**2) * math.sqrt(total)


def _stiffer(fused: FittedSurface) -> float:
    rim = fused.contour[~fused.open_end][::2]
    plate = plate_through(fused.knots, LONG_AXIS * rim[:, 0], rim[:, 1], stiffness=_STIFFER)
    return _volume(fused, plate.at(LONG_AXIS * fused.s, fused.v))


def _per_mm_outwards(fused: FittedSurface, outwards: Floats) -> float:
    """Change of volume when each point of the border moves outwards by so many times a millimetre, mm²."""
    steps = np.roll(fused.border.xy_mm, -1, axis=0) - fused.border.xy_mm
    # a strip along the border, as high as the border
    edge = np.hypot(steps[:, 0], steps[:, 1]) * fused.height_mm * outwards
    rim = fused.contour[~fused.open_end]
    # where the border was, the plate rises by what it falls within a millimetre
    inner = rim - (fused.border.outward @ _turn(fused))[~fused.open_end]
    fall = np.maximum(fused.plate.at(LONG_AXIS * inner[:, 0], inner[:, 1]), 0.0) * outwards[~fused.open_end]
    change = _rim_right(fused, rim[::2], _STEP_MM * fall[::2])
    values = fused.plate.at(LONG_AXIS * fused.s, fused.v) + _moved(fused, change)
    return float(edge.sum()) + (_volume(fused, values) - fused.volume_mm3) / _STEP_MM


def _per_mm_of_rim(fused: FittedSurface) -> float:
    """Change of volume when the rim is taken higher by a millimetre, and the border placed there, mm².

    A border that is placed higher on its line of sight moves inwards by the ray's tilt; where the camera
    sees the wall, the border is the wall's foot and stays.
    """
    knots, upright = fused.knots, fused.rim.upright
    # the plate holds squares of heights over an upright rim
    over = (np.sign(knots.u) * np.sqrt(np.abs(knots.u)) if upright else knots.u) - _STEP_MM
    fall = (over * np.abs(over) if upright else over) - knots.u
    change = np.zeros_like(fused.plate.right)
    unused = np.zeros_like(fused.plate.band)
    add_points(unused, change, fused.plate.grid, knots.s, knots.v, fall, knots.weight)
    values = fused.plate.at(LONG_AXIS * fused.s, fused.v) + _moved(fused, change)
    raised = (_volume(fused, values, _STEP_MM) - fused.volume_mm3) / _STEP_MM
    return raised + _per_mm_outwards(fused, -np.maximum(fused.border.tilt, 0.0))


def _rim_right(fused: FittedSurface, rim: Floats, values: Floats) -> Floats:
    change = np.zeros_like(fused.plate.right)
    unused = np.zeros_like(fused.plate.band)
    add_points(
        unused, change, fused.plate.grid, LONG_AXIS * rim[:, 0], rim[:, 1], values, np.full(rim.shape[0], 6.0)
    )
    return change


def _moved(fused: FittedSurface, change: Floats) -> Floats:
    moved = replace(fused.plate, coefficients=fused.plate.moved_by(change))
    return moved.at(LONG_AXIS * fused.s, fused.v)


def _volume(fused: FittedSurface, values: Floats, rim_shift_mm: float = 0.0) -> float:
    return float((fused.weight_mm2 * fused.heights(values, rim_shift_mm)).sum())


def _turn(fused: FittedSurface) -> Floats:
    """Turn from the belt to along and across the product."""
    design = fused.border.xy_mm - fused.border.xy_mm.mean(axis=0)
    turn, *_ = np.linalg.lstsq(design, fused.contour - fused.contour.mean(axis=0), rcond=None)
    return np.asarray(turn)


def _mm_per_px(fused: FittedSurface, view: View) -> float:
    """Size of a pixel at the middle of the border."""
    middle = np.append(fused.border.xy_mm.mean(axis=0), float(np.mean(fused.height_mm)))
    # a millimetre along X
    step = view.project(np.stack([middle, middle + np.array([1.0, 0.0, 0.0])]))
    return 1.0 / float(np.hypot(*(step[1] - step[0])))


_EDGE_PX = 1.0  # an outline so near the image's border is cut by it
_SOME = 0.1  # of the usual width: less of a slice is no outer one
_OUTSIDE_MM = 1.0  # farther outside, a point is not on the outlined body
_OUTSIDE_SHARE = 0.03  # of the points: false peaks at rims are fewer
_SHORT_MM = (
    1.0  # the nearer half of the ends lies within 0.4 mm of a true outline, on skeins and on other bodies
)


def outline_fault(product: Product, slices: Slices, fused: FittedSurface | None = None) -> Reason | None:
    """Say why a product's volume has to do without its outline; None where it need not.

    Parameters
    ----------
    product, slices
        The product and its slices.
    fused
        What came of the outline; without it only what can be said beforehand is.

    Raises
    ------
    StageError
        The outline reaches the image's edge.
    """
    from roemetry_volume.slice_table import HOLE

    outline, view = product.outline, product.view
    if outline is None:
        return Reason(
            "no-outline", "no outline was found that fits the stripes: the volume is that of the slices alone"
        )
    if view is None:
        return Reason(
            "no-view",
            "the calibration does not say where the camera stands, so the outline cannot be placed on the "
            "belt: the volume is that of the slices alone",
        )
    rows, columns = product.calibration.image_size
    xy = outline.xy_px
    edge = (xy < _EDGE_PX - 0.5) | (xy > np.array([columns, rows]) - 0.5 - _EDGE_PX)
    if edge.any():
        raise StageError(
            "the product's outline reaches the image's edge: a part is not seen",
            hint="place it within the image",
        )
    # outer slices may cut an end wall, of which only the two edges are seen
    some = np.flatnonzero(slices.width_mm > _SOME * float(np.median(slices.width_mm)))
    if (slices.table[some[0] + 1 : some[-1], HOLE] > 0.0).any():
        return Reason(
            "outline-not-used",
            "slices have a hole that an outline does not show: the volume is that of the slices alone",
        )
    return None if fused is None else _disagreement(fused)


def _disagreement(fused: FittedSurface) -> Reason | None:
    """Compare the stripes' points and ends with the border."""
    from roemetry_volume.footprint import inside_by

    contour = fused.contour[::4].copy()
    inside = inside_by(contour, fused.place[::3].copy())
    outside = float((inside < -_OUTSIDE_MM).mean())
    ends = np.concatenate([fused.points.first[:-1], fused.points.first[1:] - 1])
    # the farther half may lie in the shadow
    nearer = np.sort(inside_by(contour, fused.place[ends]))[: (ends.size + 1) // 2]
    short = float(np.median(nearer))
    if outside <= _OUTSIDE_SHARE and short <= _SHORT_MM:
        return None
    what = (
        f"{outside:.0%} of the stripes' points lie outside it"
        if outside > _OUTSIDE_SHARE
        else f"the stripes end {short:.1f} mm inside it"
    )
    return Reason(
        "outline-disagrees",
        f"the outline does not fit the stripes: {what}; the volume is that of the slices alone",
    )
