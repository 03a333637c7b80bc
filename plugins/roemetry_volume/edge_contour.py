"""Outlines from the plain-light image, or from the laser image's own ambient light where there is none.

Model. Each product's outline is searched for around the polygon through the ends of what is seen of its
stripes, in log(image / empty belt): what is left is how much brighter or darker than the belt each place is.
The search itself, and how sure an outline is, is `edge_search`.

In a laser image the ambient light beside the stripes is searched (`ambient_light`). What stripes show is
used, too: the outline lies outside of the product's stripes, and inside of what lies in a row between two
neighbouring stripes that are on the belt. Where both images are there, the contour is their weighted mean
(`contour_fusion`).

First the plain image is laid over the laser image by the belt's texture, where ambient light shows it in
both (`image_motion`); images of which a part does not match are of two scenes, and the product is refused.

Then the outline is compared with the stripes, a grid or the dots (`agreement`): what contradicts them is left
out or refused, and what they leave open joins its uncertainty.

Fails where the product is as bright as the belt and shades evenly into it: then there is no outline.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.io.tiff import as_stored
from roemetry.records import Frame, Outline, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import BELT
from roemetry.stages import Outliner, StageOptions
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import median_of, quantile_of
from roemetry_kernels.robust_fit import solve
from roemetry_volume.agreement import CONTRADICTION_PX, LEAST_ROWS, brackets_of, contradiction
from roemetry_volume.ambient_light import SMOOTHED_PX, ambient_light
from roemetry_volume.circle_light import circle_light
from roemetry_volume.contour_fusion import confirmed
from roemetry_volume.edge_search import Scene, edge_around, redrawn
from roemetry_volume.footprint import area_of
from roemetry_volume.image_motion import laid_over, logarithm
from roemetry_volume.outline_features import features_of

_LEAST_CONTRAST = 3.0
"""Times the belt's scatter that a product is brighter or darker: three standard deviations."""
_USUAL_SPACING_PX = 40.0  # where the coder does not say where stripes lie on the belt
_SAMPLED = 5  # means over so many rows and columns tell the belt's middle and scatter, and a product's level

_BELT_SMOOTH_PX = 5.0
"""The belt's image is smoothed against noise by less than light and texture vary over."""
_GRID_PX, _GRID_POINTS = 12, 2500  # of the polynomial through the image's own belt: at least, at most
_ROUNDS = 6  # of reweighting: the belt's brightness has settled by then
_RIDGE = 1e-10  # keeps the equations solvable where the belt is seen on one side only

_CORE_SMOOTH_PX = 2.0  # of the image in which product and belt are told apart
_LEAST_CORE_SHARE = 5e-4
"""Of the image: smaller cores are dirt."""
_LEAST_CORE_CONTRAST = 0.08
"""Natural logarithm of brightness: with less between dark and bright there is nothing but belt."""
_PLACED_PX = 0.25
"""Half of what a stripe's end is seen to: images that are better placed need no ends to say how they lie."""
_GAP_ROWS = 3
"""A stripe that is not seen for longer may have something in between."""
_NEIGHBOURS = 1.6  # spacings: stripes farther apart have another one between them that is not seen
_END_ROWS = 3
"""At the ends of what is seen of the belt: a peak may be the rim's, and a round body bulges out between two
stripes (an arc of 150 px radius over 40 px by 1.3 px)."""

_COARSE, _BEYOND_SHARE = 4, 0.15
"""Every fourth pixel of bodies and stripes. Of a product's area as its stripes show it, no whole image of
five recipes shows more than 1 % farther than a spacing from them, but a ball of a dense rig, unlit on its far
side, 9 %. A block of another frame that hid one end of a potato passed with 11 %: 15 % of its volume."""
_BARE_SHARE = 0.02
"""Of the same area, what may lie farther than a spacing from the body in the plain image. Of 68 products of
three renderers 67 have none, a spotted potato 0.5 %; with a block of another frame beside them 6 and 8 %."""


_WITHIN_PX, _WITHIN_SHARE = 8.0, 0.02
"""Where stripes lie on the belt so far within the body in the plain image, one of both is not of this frame:
as many points as such a part of the product's. Of 67 sound products of three renderers none has any at half
of that depth; with a block of another frame over the end of a potato it is 5 %."""


class EdgeContourOptions(StageOptions):
    """Options of `edge-contour`."""

    light: Literal["auto", "plain", "laser"] = Field(
        default="auto", description="image to look in; auto is the plain-light one where there is one"
    )
    belt: Path | None = Field(
        default=None,
        description="image of the empty belt in the same light; its stripes, if any, are taken out",
    )


class EdgeContour(Outliner[EdgeContourOptions]):
    """Starts from what is seen of the product's stripes, and ends at the kink in the brightness.

    Nothing is known of heights here: an outline is what the camera sees, in pixels.
    """

    def outline(
        self, frame: Frame, plain: Frame | None, stripes: StripeMap, calibration: Calibration | None
    ) -> tuple[Outline, ...]:
        """Give one outline for each product that the stripes show; without stripes, for each core.

        Raises
        ------
        StageError
            A plain-light image is asked for and there is none, or images differ in size.
        """
        use_plain = self.options.light == "plain" or (self.options.light == "auto" and plain is not None)
        if use_plain and plain is None:
            raise StageError(
                "there is no plain-light image",
                hint="name the plain images in the source's options, or set light to laser",
            )
        chosen: Frame = plain if use_plain and plain is not None else frame
        if chosen.size != frame.size:
            raise StageError(f"the plain-light image is {chosen.size}, the laser image {frame.size}")
        known = _seen_regions(stripes, frame.size)
        if not use_plain and not known:
            return ()
        product = np.zeros(frame.size, np.bool_)
        for mask in known.values():
            product |= mask
        spacing, placed, growth_std = _spacing_px(stripes), False, 0.0
        if use_plain and known:
            overlay = laid_over(chosen, _one(frame.pixels), product, spacing, grid=stripes.across is not None)
            if overlay.fault is not None:  # of all products, also of those that no edge is found of
                return tuple(
                    Outline(number, _ring_around(region, spacing), spacing, {}, overlay.fault)
                    for number, region in known.items()
                )
            chosen, growth_std = overlay.plain, overlay.growth_std
            placed = overlay.std_px < _PLACED_PX
        belt = _belt_of(self.options.belt, chosen)
        if use_plain:
            level, on_stripes = _over_belt(chosen.pixels, belt, product), None
        else:
            grid = stripes.across is not None
            dark = None if belt is None else ambient_light(_one(belt), spacing, grid=grid)[0]
            light, on_stripes = ambient_light(_one(chosen.pixels), spacing, grid=grid)
            level = _over_belt(light, dark, product)
        taken_out = None if on_stripes is None else on_stripes.astype(np.float32)
        many = stripes.stripe_count > 1
        belts = {number: _belt_stripes(stripes, number, frame.size) for number in known if use_plain}
        other = _shown_otherwise(level, known, belts, stripes, spacing) if belts and many else {}
        of_circles = None
        view = None if calibration is None else calibration.view
        if stripes.circles and use_plain and known and view is not None:
            of_circles = circle_light(_one(frame.pixels), view)
        outlines = []
        for number, region in (known or _cores(level)).items():
            if not _is_clear(level, region):
                continue
            bounds = None
            if known:
                if on_stripes is None:
                    beside = belts[number]
                else:
                    on_belt = _with_belt_by_light(stripes, level, region, on_stripes)
                    beside = _belt_stripes(on_belt, number, frame.size)
                    beside |= _belt_between(on_belt, frame.size, spacing)
                bounds = _eroded(region).astype(np.float32), beside.astype(np.float32)
            scene = Scene(level, bounds, taken_out, 0.0 if use_plain else SMOOTHED_PX, spacing)
            edge = edge_around(scene, _ring_around(region, spacing))
            if edge is None:
                if number in other:
                    ring = _ring_around(region, spacing)
                    outlines.append(Outline(number, ring, spacing, {}, other[number]))
                continue
            radius_px = math.sqrt(abs(area_of(edge.xy_px)) / math.pi)
            std_px, fault = math.hypot(edge.std_px, growth_std * radius_px), other.get(number)
            brackets = None
            if use_plain and known:
                brackets = brackets_of(scene, edge.xy_px, stripes, number, of_circles, placed=placed)
            if brackets is not None:
                apart_px, against_px = brackets.disagreement_px()
                std_px = math.hypot(std_px, apart_px) if apart_px else std_px
                if against_px >= CONTRADICTION_PX:
                    left_px = brackets.contradiction_left_px()
                    if left_px < CONTRADICTION_PX and fault is None:
                        continue
                    fault = fault or contradiction(against_px, left_px)
            if use_plain and known and fault is None and _of_lines(stripes):
                both = confirmed(edge._replace(std_px=std_px), _one(frame.pixels), scene)
                edge, std_px = both, both.std_px
            features = features_of(edge.xy_px, chosen.pixels, redrawn(edge))
            outlines.append(Outline(number, edge.xy_px, std_px, features, fault))
        return tuple(outlines)


def _of_lines(stripes: StripeMap) -> bool:
    return stripes.across is None and stripes.dots is None and not stripes.circles


def _is_clear(level: NDArray[np.float32], region: Flags) -> bool:
    """Say whether a region stands out of the belt, by means of 5 × 5 pixels, which average noise out."""
    import cv2

    if not region.any() or region.all():
        return False
    size = (max(level.shape[1] // _SAMPLED, 1), max(level.shape[0] // _SAMPLED, 1))
    light = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
    held = cv2.resize(region.view(np.uint8), size, interpolation=cv2.INTER_NEAREST).view(np.bool_)
    outside, within = light[~held], light[held]
    if not outside.size or not within.size:
        return False
    middle = median_of(outside)
    scatter = 1.4826 * median_of(np.abs(outside - middle))
    # some of the region may be belt: stripes are wider than what they show
    low, high = (quantile_of(within, share) for share in (0.2, 0.8))
    return bool(max(high - middle, middle - low) > _LEAST_CONTRAST * max(scatter, 1e-3))


def _shown_otherwise(
    level: NDArray[np.float32], known: dict[int, Flags], belts: dict[int, NDArray[np.uint8]],
    stripes: StripeMap, spacing_px: float,
) -> dict[int, Reason]:  # fmt: skip
    """Say of which products the plain image shows a body far larger or far smaller than the stripes do.

    A body may end up to one spacing beyond its stripes; of a single stripe nobody knows how far: it has none.
    Stripes on a product lie on its body, whose rims and spots may be dark: the body is the convex hull of
    what is bright, and they may lie up to one spacing outside it. Stripes on the belt, of each product in
    `belts`, lie outside of it.
    """
    import cv2

    few = np.s_[_COARSE // 2 :: _COARSE, _COARSE // 2 :: _COARSE]
    regions = {number: region[few] for number, region in known.items()}
    size = next(iter(regions.values())).shape[::-1]
    core = _core(cv2.resize(level, size, interpolation=cv2.INTER_AREA))
    bodies = cv2.connectedComponents(core.astype(np.uint8))[1]
    from_stripes_px = _distance_px(np.logical_or.reduce(list(regions.values())))
    found = {}
    for number, region in regions.items():
        if not region.any():
            continue
        body = int(np.bincount(bodies[region]).argmax())
        shown = bodies == body
        if body == 0 or 2 * np.count_nonzero(shown) > shown.size:
            continue  # as bright as the belt, which is most of the image: brightness tells nothing
        beyond, bare = (
            np.count_nonzero(one) / np.count_nonzero(region)
            for one in (
                shown & (from_stripes_px > spacing_px),
                region & (_distance_px(_hull(core & region)) > spacing_px),
            )
        )
        within = _belt_within(_distance_px(~shown), belts[number], stripes, number)
        if beyond > _BEYOND_SHARE:
            said = f"{beyond:.0%} more of the product than the stripes do"
        elif bare > _BARE_SHARE:
            said = f"{bare:.0%} less of the product than the stripes do"
        elif within > _WITHIN_SHARE:
            said = f"the product where stripes lie on the belt, {within:.0%} of the points on the product"
        else:
            continue
        found[number] = Reason(
            "images-contradict",
            f"the plain-light image shows {said}: a part of the laser image belongs to another frame, "
            "stripes are missing, or the plain-light image is of another product; "
            "look at both, and take them again",
        )
    return found


def _belt_within(
    depth_px: NDArray[np.float32], belt: NDArray[np.uint8], stripes: StripeMap, number: int
) -> float:
    """Say how many points on the belt lie far within a product's body, as a share of those on the product.

    `depth_px` says of every fourth pixel how far it lies within the body, `belt` of each whether a stripe is
    seen there on the belt.
    """
    rows, columns = np.divmod(np.flatnonzero(belt.view(np.bool_)), belt.shape[1])
    last = depth_px.shape[0] - 1, depth_px.shape[1] - 1
    depth = depth_px[np.minimum(rows // _COARSE, last[0]), np.minimum(columns // _COARSE, last[1])]
    families = (stripes,) if stripes.across is None else (stripes, stripes.across)
    mine = sum(int(np.count_nonzero(family.seen & (family.product == number))) for family in families)
    return float(np.count_nonzero(depth > _WITHIN_PX)) / max(mine, 1)


def _distance_px(of: Flags) -> NDArray[np.float32]:
    """Give how far every fourth pixel lies from those of a region, px of the image."""
    import cv2

    away = cv2.distanceTransform((~of).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(_COARSE * away)


def _hull(of: Flags) -> Flags:
    """Fill the convex hull of a region."""
    import cv2

    filled = np.zeros(of.shape, np.uint8)
    places = cv2.findNonZero(of.astype(np.uint8))
    cv2.fillConvexPoly(filled, cv2.convexHull(places), 1)
    return filled.view(np.bool_)


def _spacing_px(stripes: StripeMap) -> float:
    known = [line[np.isfinite(line)] for line in stripes.rest_px]
    step = np.diff(np.sort([median_of(line) for line in known if line.size]))
    step = step[step > 1.0]
    return median_of(step) if step.size else _USUAL_SPACING_PX


def _one(pixels: NDArray[Any]) -> NDArray[Any]:
    return pixels if pixels.ndim == 2 else np.asarray(pixels.max(axis=2))


def _belt_of(path: Path | None, like: Frame) -> NDArray[Any] | None:
    """Read the empty belt's image, turned like the others; StageError where it does not fit."""
    if path is None:
        return None
    pixels = np.rot90(_read(path), like.turn_deg // 90)
    if like.pixels.ndim == 2 and pixels.ndim == 3:
        pixels = np.rint(pixels.mean(axis=2)).astype(pixels.dtype)
    if pixels.shape != like.pixels.shape:
        raise StageError(
            f"{path.name}: the empty belt's image has shape {pixels.shape}, expected {like.pixels.shape}",
            hint="take it with the same camera, region of interest and colour",
        )
    return np.ascontiguousarray(pixels)


@lru_cache(maxsize=4)
def _read(path: Path) -> NDArray[Any]:
    import cv2

    try:
        data = np.frombuffer(as_stored(path.read_bytes()), np.uint8)
    except OSError:
        data = np.empty(0, np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if pixels is None:
        raise StageError(f"{path}: the empty belt's image cannot be read")
    pixels = pixels[..., :3] if pixels.ndim == 3 else pixels
    pixels.flags.writeable = False
    return np.asarray(pixels)


def _over_belt(pixels: NDArray[Any], belt: NDArray[Any] | None, product: Flags) -> NDArray[np.float32]:
    """Give log(image / empty belt), (row, column).

    Parameters
    ----------
    pixels
        (row, column) or (row, column, colour) grey levels; of colours the one is taken in which product and
        belt differ most.
    belt
        The empty belt in the same light, of the same shape; None: a polynomial of second order through the
        image's own belt.
    product
        (row, column) True where stripes show product, which is left out of that polynomial.
    """
    import cv2

    few = np.s_[::_SAMPLED, ::_SAMPLED]  # they tell in which colour product and belt differ most
    if pixels.ndim == 3 and belt is not None:
        planes = [_over_belt(pixels[..., k], belt[..., k], product) for k in range(3)]
        return max(planes, key=lambda plane: _contrast(plane[few], product[few]))
    if pixels.ndim == 3:
        colours = [pixels[..., k] for k in range(3)]
        fits = [_own_belt(one, product) for one in colours]
        seen = [
            logarithm(one[few]) - _belt_at(fit, product.shape, _SAMPLED)
            for one, fit in zip(colours, fits, strict=True)
        ]
        most = max(range(3), key=lambda k: _contrast(seen[k], product[few]))
        return np.asarray(logarithm(colours[most]) - _belt_at(fits[most], product.shape, 1))
    bright = logarithm(pixels)
    if belt is not None:
        smooth = cv2.GaussianBlur(belt.astype(np.float32), (0, 0), _BELT_SMOOTH_PX)
        bright -= np.log(smooth + np.float32(1.0))
        return np.asarray(bright - np.median(bright[~product]))
    return np.asarray(bright - _belt_at(_own_belt(pixels, product), product.shape, 1))


def _own_belt(pixels: NDArray[Any], product: Flags) -> Floats:
    """Give (6,) the polynomial of the belt's brightness.

    It is fitted where the image is not product, by least squares that drop what is far off.
    """
    apart = max(_GRID_PX, round(math.sqrt(pixels.size / _GRID_POINTS)))
    grid = np.s_[::apart, ::apart]
    found: Floats = belt_fit(_belt_terms(*pixels.shape, apart), logarithm(pixels[grid]), product[grid])
    return found


def _belt_at(c: Floats, size: tuple[int, ...], every: int) -> NDArray[np.float32]:
    """Give the belt's brightness by its polynomial, on every so many rows and columns."""
    rows, columns = size
    v, u = np.arange(0, rows, every) / rows - 0.5, np.arange(0, columns, every) / columns - 0.5
    along = np.stack([c[0] + v * (c[2] + c[5] * v), c[1] + c[4] * v, np.full(v.size, c[3])], axis=1)
    return along.astype(np.float32) @ np.stack([np.ones(u.size), u, u * u]).astype(np.float32)


@lru_cache(maxsize=4)
def _belt_terms(rows: int, columns: int, apart: int) -> Floats:
    """Give (6, place) the terms of the belt's polynomial on a grid."""
    y, x = np.mgrid[0:rows:apart, 0:columns:apart]
    u, v = x.ravel() / columns - 0.5, y.ravel() / rows - 0.5
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])


@float_kernel
def belt_fit(terms: Floats, bright: NDArray[np.float32], product: Flags) -> Floats:
    """Fit the terms to (row, column) light where it is not product, without what is far off."""
    count, seen, off = terms.shape[0], bright.copy().ravel(), np.empty(bright.size)
    use, used, found = ~product.copy().ravel(), np.empty(seen.size), np.zeros(count)
    if use.sum() < count:
        use[:] = True
    for _ in range(_ROUNDS):
        # of six terms within ±1 the normal equations lose nothing; the ridge is for slivers
        normal = _RIDGE * use.sum() * np.eye(count)
        for a in range(count):
            of_seen = 0.0
            for k in range(seen.size):  # without a branch, so that several are taken at once
                used[k] = terms[a, k] * use[k]
                of_seen += used[k] * seen[k]
            found[a] = of_seen
            for b in range(a + 1):
                both = 0.0
                for k in range(seen.size):
                    both += used[k] * terms[b, k]
                normal[a, b] += both
        solve(normal, found)
        off = seen - terms[0] * found[0]
        for a in range(1, count):
            off -= terms[a] * found[a]
        away = np.abs(off - median_of(off[use]))
        again = use & (away < max(3.0 * 1.4826 * median_of(away[use]), 0.02))
        if again.sum() < 4 * count or (again == use).all():
            break
        use = again
    return found


def _contrast(light: NDArray[np.float32], product: Flags) -> float:
    if not product.any() or product.all():
        return float(light.std())
    inside, outside = light[product], light[~product]
    return abs(median_of(inside) - median_of(outside)) / (float(outside.std()) + 1e-6)


def _seen_regions(stripes: StripeMap, size: tuple[int, int]) -> dict[int, Flags]:
    """Give, by product, (row, column) the polygon through the ends of what is seen of its stripes.

    What a coder bridged is left out: it runs down to the belt beside the product, through its shadow. Of a
    grid it is both families' polygons, of dots that through the ends of their columns, of circles what lies
    between the outermost.
    """
    import cv2

    regions = {} if stripes.across is None else _turned_back(_seen_regions(stripes.across, size[::-1]))
    mine = stripes.seen & (stripes.product > 0)
    highest = int(stripes.product.max(initial=0))
    gap_rows, least_rows = (_GAP_ROWS, LEAST_ROWS) if stripes.dots is None else (size[0], 1)
    for number in range(1, highest + 1):
        on = mine if highest == 1 else mine & (stripes.product == number)
        stripe, row, _ = pieces_in_line(on, gap_rows, least_rows, 0)
        if not row.size:
            continue
        x_px, begins = stripes.x_px[stripe, row], np.flatnonzero(np.diff(stripe, prepend=-1))
        first, last = (
            list(zip(x_px[at], row[at], strict=True)) for at in (begins, np.append(begins[1:], 0) - 1)
        )
        # stripes are displaced on the product, so their order there is that of x, not of their numbers
        ring = sorted(first) + sorted(last, reverse=True)
        mask = np.zeros(size, np.uint8)
        if stripes.circles:  # they end on the product, too: it lies between the outermost in each row
            mask |= _between_outermost(row, x_px, size)
        else:
            cv2.fillPoly(mask, [np.rint(ring).astype(np.int32).reshape(-1, 1, 2)], 1)
        mask[row, np.clip(np.rint(x_px).astype(np.int64), 0, size[1] - 1)] = 1
        regions[number] = mask.view(np.bool_) | regions.get(number, False)
    return dict(sorted(regions.items()))


def _between_outermost(row: Integers, x_px: Floats, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Fill (row, column) what lies in each row between the first and the last of places."""
    first, last = np.full(size[0], np.inf), np.full(size[0], -np.inf)
    np.minimum.at(first, row, x_px)
    np.maximum.at(last, row, x_px)
    column = np.arange(size[1])
    return ((column >= first[:, None]) & (column <= last[:, None])).astype(np.uint8)


def _turned_back(regions: dict[int, Flags]) -> dict[int, Flags]:
    """Give regions of the image turned by 90° counter-clockwise in the image as it is."""
    return {number: np.ascontiguousarray(np.rot90(region, -1)) for number, region in regions.items()}


def _cores(level: NDArray[np.float32]) -> dict[int, Flags]:
    """Give what stands out of the belt, (row, column), numbered from left to right.

    `level` is (row, column) log(image / belt).
    """
    import cv2

    smooth = cv2.GaussianBlur(level, (0, 0), _CORE_SMOOTH_PX)
    return _numbered(_core(smooth))


def _ring_around(region: Flags, spacing_px: float) -> Floats:
    """Give a smooth ring (n, 2) around a region's largest piece, px, half a stripe spacing outside.

    Notches up to two spacings wide are closed, since between neighbouring stripes nothing is known. Half a
    spacing outside, normals fan out at the region's corners, and reach a product's tip beyond them.
    """
    import cv2

    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    if not rows.size:
        return np.empty((0, 2))
    # by distances: dilating with a disc of this size takes thirty times as long; every other pixel will do
    box = region[rows[0] : rows[-1] + 1 : 2, columns[0] : columns[-1] + 1 : 2]
    spacing = 0.5 * spacing_px
    edge = round(spacing) + 2
    outside = np.pad(np.uint8(1) - box.astype(np.uint8), edge, constant_values=1)
    wide = cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= spacing
    inside = cv2.distanceTransform(wide.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    ring = (inside > 0.5 * spacing).astype(np.uint8)
    found, _ = cv2.findContours(ring, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        return np.empty((0, 2))
    corner = np.array([columns[0], rows[0]], np.float64)
    chains = [2.0 * (chain[:, 0, :] - edge) + corner for chain in found]
    return max(chains, key=lambda chain: abs(area_of(chain)))


def _eroded(region: Flags) -> NDArray[np.uint8]:
    """Take a pixel off a region's border: at a rim light reaches so far over it."""
    import cv2

    return np.asarray(cv2.erode(region.astype(np.uint8), np.ones((3, 3), np.uint8)))


def _belt_stripes(stripes: StripeMap, number: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw (row, column) what is seen of stripes that lie on the belt, or on another product."""
    import cv2

    drawn = np.zeros(size, np.uint8)
    if stripes.across is not None:
        drawn |= np.rot90(_belt_stripes(stripes.across, number, size[::-1]), -1)
    on = stripes.seen & (stripes.product != number)
    if stripes.dots is not None:
        drawn[np.nonzero(on)[1], np.clip(np.rint(stripes.x_px[on]).astype(np.int64), 0, size[1] - 1)] = 1
        return drawn
    stripe, row, begins = pieces_in_line(on, _GAP_ROWS, 1, _END_ROWS)
    places = np.column_stack([np.rint(stripes.x_px[stripe, row]), row]).astype(np.int32)
    begins = [*begins.tolist(), len(row)]
    chains = [places[one:other] for one, other in pairwise(begins)]
    if chains:
        cv2.polylines(drawn, chains, isClosed=False, color=1)
    return drawn


def _with_belt_by_light(
    stripes: StripeMap, level: NDArray[np.float32], region: Flags, on_stripes: Flags
) -> StripeMap:
    """Take light on rest lines for belt where the coder left it open but the light beside it is the belt's.

    Behind a body that displaces stripes by a whole spacing, lines on the belt may as well be those of a level
    surface as high as that. Such a surface would have to be as bright as the belt, too, and begin and end
    where the light goes on along the same rest line. This keeps an outline away, and is never a label.
    """
    beside, on_beside = ~region & ~on_stripes, region & ~on_stripes
    if not (beside.any() and on_beside.any()):  # a product on a single stripe, or all over the image
        return stripes
    stripe, row = np.nonzero(stripes.ambiguous & ~stripes.seen & np.isfinite(stripes.rest_px))
    column = np.rint(stripes.rest_px[stripe, row]).astype(np.int64)
    within = (column >= 0) & (column < level.shape[1])
    stripe, row, column = stripe[within], row[within], column[within]
    of_product, of_belt = (median_of(level[where]) for where in (on_beside, beside))
    light = level[row, column]
    like_belt = on_stripes[row, column] & (np.abs(light - of_belt) < np.abs(light - of_product))
    found = np.zeros(stripes.seen.shape, np.bool_)
    found[stripe[like_belt], row[like_belt]] = True
    on_belt = stripes.seen & (stripes.product == BELT)
    for number in np.flatnonzero(found.any(axis=1)):
        found[number] &= _joined(on_belt[number], found[number])
    x_px, product = np.where(found, stripes.rest_px, stripes.x_px), np.where(found, BELT, stripes.product)
    return replace(stripes, seen=stripes.seen | found, product=product.astype(np.int16), x_px=x_px)


def _joined(sure: Flags, found: Flags) -> Flags:
    """Say which rows lie between sure ones with nothing but sure and found ones, and small gaps, between."""
    joined, rows = np.zeros_like(sure), np.flatnonzero(sure | found)
    for piece in np.split(rows, np.flatnonzero(np.diff(rows) > _GAP_ROWS) + 1):
        ends = piece[sure[piece]]
        if ends.size:
            joined[ends[0] : ends[-1]] = True
    return joined


def _belt_between(stripes: StripeMap, size: tuple[int, int], spacing_px: float) -> NDArray[np.uint8]:
    """Fill (row, column) what lies in a row between two neighbouring stripes that both lie on the belt there.

    `_END_ROWS` are left out beside the ends of their pieces.
    """
    import cv2

    filled = np.zeros(size, np.uint8)
    on_belt, on_product = (stripes.seen & on for on in (stripes.product == 0, stripes.product > 0))
    order = np.argsort(np.nanmedian(stripes.x_px, axis=1))
    columns = np.arange(size[1])
    for one, other in pairwise(order):
        rows = np.flatnonzero(on_belt[one] & on_belt[other])
        low, high = stripes.x_px[one, rows], stripes.x_px[other, rows]
        near = (high > low) & (high - low < _NEIGHBOURS * spacing_px)
        x_px = stripes.x_px[:, rows]
        near &= ~(on_product[:, rows] & (x_px > low) & (x_px < high)).any(axis=0)
        between = (columns >= low[near, None]) & (columns <= high[near, None])
        filled[rows[near]] |= between.astype(np.uint8)
    return np.asarray(cv2.erode(filled, np.ones((2 * _END_ROWS + 1, 1), np.uint8)))


@kernel
def pieces_in_line(
    on: Flags, gap_rows: int, least_rows: int, end_rows: int
) -> tuple[Integers, Integers, Integers]:
    """Give stripe and row of the points of all pieces of stripes, and where each piece begins.

    Parameters
    ----------
    on
        (stripe, row) where a stripe is seen.
    gap_rows
        A piece goes on over so many rows that are missing.
    least_rows, end_rows
        Pieces of fewer points are left out; and of others, so many points at either end.
    """
    stripe, row = np.empty(on.size, np.int64), np.empty(on.size, np.int64)
    first = np.empty(on.size, np.int64)
    count = pieces = 0
    for s in range(on.shape[0]):
        begin, last = count, -1
        for r in range(on.shape[1] + 1):
            ends = r == on.shape[1] or (on[s, r] and r - last > gap_rows and count > begin)
            if ends:
                kept = count - begin - 2 * end_rows
                if count - begin < least_rows or kept <= 0:
                    count = begin
                else:
                    row[begin : begin + kept] = row[begin + end_rows : begin + end_rows + kept].copy()
                    count, first[pieces] = begin + kept, begin
                    pieces += 1
                begin = count
            if r < on.shape[1] and on[s, r]:
                stripe[count], row[count], last = s, r, r
                count += 1
    return stripe[:count].copy(), row[:count].copy(), first[:pieces].copy()


def _core(smooth: Floats) -> Flags:
    """Threshold after Otsu; what covers less of the image is the product, bright or dark."""
    import cv2

    low, high = (quantile_of(smooth.ravel(), share) for share in (0.005, 0.995))
    if not high - low > _LEAST_CORE_CONTRAST:
        return np.zeros(smooth.shape, np.bool_)
    grey = np.clip(255.0 * (smooth - low) / (high - low), 0, 255).astype(np.uint8)
    step, _ = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    bright = smooth > low + (high - low) * step / 255.0
    return np.asarray(bright)


def _numbered(core: Flags) -> dict[int, Flags]:
    """Number the pieces that are large enough, from left to right."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(core.astype(np.uint8))
    large = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] > _LEAST_CORE_SHARE * core.size]
    large.sort(key=lambda k: int(stats[k, cv2.CC_STAT_LEFT]))
    return {number: np.asarray(labels == k) for number, k in enumerate(large, start=1)}
