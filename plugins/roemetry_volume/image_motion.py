"""How the plain-light image lies over the laser image, by the belt's own texture in both.

Model. Beside the stripes a laser image shows the belt dimly in ambient light: the same dirt, weave and
scratches as in plain light. With both images high-passed, what the laser image shows there is

    b(x) = g · a(W x) + noise,    W x = x + shift + (turn, growth) about the middle,

where a is log(plain). W is the least-squares solution (Lucas & Kanade, IJCAI 1981), from coarse to fine; its
covariance is that of the noise, correlated over the smoothing. Where no step gets there, the fit begins at
the shift of the highest cross-correlation. Camera or belt may have moved between the two images, or one is of
another scale: then the plain image is brought back over the laser image. And the images are compared part by
part: where the texture that must be seen is not, the frames are not of one scene: rows or columns of one are
lost, or a part of it is another frame's.

Fails, and says nothing, where no ambient light reaches the belt, or the belt has no texture or one that
repeats (a weave), if the images lie farther apart than its grains.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Frame, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import median_of, plain_layout
from roemetry_kernels.robust_fit import solve

_LEVELS = 3
"""Halvings of the images: on the last, motions of some ten pixels are found; on the first, tenths of one."""
_WIDTHS = _FINE, _COARSE = 3, 13
"""Boxes, in pixels of a level, over which noise is averaged and light varies: texture lies between."""
_APART = 2  # of averages over three pixels every second tells nearly all
_ALIKE = _FINE**2 / _APART
"""Of the places that are looked at, as many tell as much as one."""
_ROUNDS = 20
"""At most: from growth by 3 % five rounds came half the way, and what they gave was believed."""
_SLOPES_ROUNDS = 8
"""In which slopes are looked up where the images have come to lie."""
_SETTLED_PX = 0.02
"""A step that moves nothing in the image by as much is the last."""
_SINGULAR = 1e-14
"""Of the normal equations' largest element: a smaller pivot is rounding, of texture in one direction only."""
_GROWTHS = (-0.04, 0.04)
"""Where nothing is found, images that have grown by so much are tried; of fine or faint texture only the
finest level shows it."""
_SHIFT_MAX = 20
"""Pixels of the finest level, 40 px of the image: shifts that are tried where no fit finds the texture."""
_GRAIN, _SECOND_MAX = 4, 0.6
"""Pixels around the best shift that are the same grain; and the correlation of any other shift, as a share of
the best one's, from which on the texture repeats. Of random texture in noise it is 0.06 to 0.11, of drawn
weaves with up to a tenth of random texture 0.74 to 1."""
_STILL_SIGMAS = 3.0
"""A first step on the finest level that is less than that, between images that are alike everywhere: nothing
has moved, and what follows would only say so again."""
_STRIPE_PX = 25
"""More than a stripe is wide; where stripes are nearer to each other the light between them is no ambient."""
_STRIPE = 6.0
"""Standard deviations of what the opening takes away: that much is a stripe."""
_SAMPLED = 5  # every fifth row and column tell it
_GROWN = (5, 13)
"""Rows and columns by which a stripe is grown: its skirts are laser light."""
_BLOCK_PX = 8  # side of the blocks that are compared with the usual one
_OFF_BELT, _OFF_BELT_MIN = 4.0, 0.1
"""Blocks of the plain image that differ from the usual one by more, in scatters and in log brightness, are no
bare belt in even light, and neither are their neighbours."""
_CLEAR = 8.0
"""Standard deviations by which a correlation, of the whole or of a part, is known to be no chance."""
_MISSED = 3.0
"""A part whose correlation is below so many, where it must be above `_CLEAR`, shows another scene."""
_PARTS = (6, 4)
"""Rows and columns of parts: each still holds hundreds of grains of texture."""
_PARTS_MIN = 2
"""One part alone may be glare, or dirt that only one light shows."""
_ODD = 3.0
"""Standard deviations from which texture counts no more: an edge of a product, glare."""


_MOVED_SIGMAS = 3.0
"""Standard deviations from which the images have moved: by chance in six of a hundred images, and then by no
more than the outlines' uncertainty says."""


class Overlay(NamedTuple):
    """The plain image as it lies over the laser image."""

    plain: Frame
    std_px: float
    """Standard uncertainty of where it lies, at the image's border; infinite where no texture tells."""
    growth_std: float = 0.0
    """Of what it was scaled by; 0 where it was left as it was."""
    fault: Reason | None = None
    """Why it is of another scene; then it is as it was."""


def laid_over(
    plain: Frame, laser: NDArray[Any], product: Flags, spacing_px: float, *, grid: bool = False
) -> Overlay:
    """Lay the plain image over the laser image.

    Parameters
    ----------
    plain
        Of the laser image's size.
    laser
        (row, column) grey levels.
    product
        (row, column) where stripes show products; half a spacing beside them is not compared either.
    spacing_px
        Distance of neighbouring stripes.
    grid
        Whether stripes lie across the image, too.
    """
    import cv2

    width = 2 * round(0.5 * spacing_px) + 1
    near = cv2.dilate(product.astype(np.uint8), np.ones((width, width), np.uint8)).astype(np.bool_)
    found = image_motion(laser, plain.pixels, near, grid=grid)
    if found is None:
        return Overlay(plain, math.inf)
    if found.missed is not None:
        top, bottom, left, right = found.missed
        fault = Reason(
            "images-contradict",
            f"between the rows {top} and {bottom} and the columns {left} and {right} the laser image does "
            "not show the belt that the plain-light image shows: rows or columns are lost, or a part "
            "belongs to another frame; look at both, and take them again",
        )
        return Overlay(plain, math.inf, fault=fault)
    # at the border, half of the longer side from the middle
    half_px = 0.5 * max(plain.size)
    std_px = float(np.sqrt(np.diag(found.covariance)[[0, 1]].max() + half_px**2 * found.covariance[3, 3]))
    if not found.significant(_MOVED_SIGMAS):
        return Overlay(plain, std_px)
    how, rows_columns = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, plain.size
    moved = cv2.warpAffine(
        plain.pixels, found.matrix, rows_columns[::-1], flags=how, borderMode=cv2.BORDER_REPLICATE
    )
    growth_std = math.sqrt(found.covariance[3, 3])
    return Overlay(replace(plain, pixels=np.asarray(moved)), std_px, growth_std)


Singles = NDArray[np.float32]


class ImageMotion(NamedTuple):
    """How the plain image lies over the laser image."""

    matrix: Floats
    """(2, 3) that takes pixels of the laser image to those of the plain image."""
    covariance: Floats
    """(4, 4) of shift along x and y, px, turn, rad, and growth, about the image's middle."""
    motion: Floats
    """(4,) the same."""
    missed: tuple[int, int, int, int] | None
    """First and last row and column of a part in which the images show different scenes; None of none."""
    alike: int
    """Number of parts in which they surely show the same."""
    sigmas: float
    """Standard deviations by which the textures' likeness is more than chance."""

    def significant(self, sigmas: float) -> bool:
        """Say whether the images lie otherwise than one over the other."""
        return bool(self.motion @ np.linalg.solve(self.covariance, self.motion) > sigmas**2)


def image_motion(
    laser: NDArray[Any], plain: NDArray[Any], product: Flags, *, grid: bool = False
) -> ImageMotion | None:
    """Lay the plain image over the laser image by what both show of the belt; None where that is too little.

    Parameters
    ----------
    laser, plain
        (row, column) grey levels, and the same or (row, column, colour).
    product
        (row, column) where the product may be: its light differs too much.
    grid
        Whether stripes lie across the image, too.
    """
    log_plain = logarithm(plain)
    free = _beside_stripes(laser, grid=grid) & ~product & _belt_like(log_plain)
    weighted, share = halved_where(plain_layout(laser), free)
    bright = _halved(log_plain)
    finest = _Level.of(weighted, share, bright)
    still = np.zeros(4)
    # one step first: most often nothing has moved
    found = _fitted(finest, still, 2.0, rounds=1)
    if found is not None and found.missed is None and not found.significant(_STILL_SIGMAS):
        return found
    textures = [finest]
    for _ in range(_LEVELS - 1):
        weighted, share, bright = (_halved(image) for image in (weighted, share, bright))
        textures.append(_Level.of(weighted, share, bright))
    motion = still
    for level in range(_LEVELS, 0, -1):
        texture, every = textures[level - 1], 2.0**level
        reach = np.abs(motion) @ [1.0, 1.0, *[0.5 * max(laser.shape)] * 2]
        # a motion beyond this level's reach may be wrong: none at all is tried, too
        starts = [still, motion] if reach > every / 2.0 else [still]
        if found is None:
            # on the finest level all shifts are looked at at once, including no shift
            shift = _likeliest_shift(finest) if level == 1 else None
            starts = [still if shift is None else shift]
            starts += [np.array([0.0, 0.0, 0.0, growth]) for growth in _GROWTHS]
        fits = [_fitted(texture, start, every) for start in starts]
        found = max((fit for fit in fits if fit is not None), key=lambda fit: fit.sigmas, default=None)
        motion = still if found is None else found.motion
    if found is not None and not found.significant(_MOVED_SIGMAS):
        return found
    unmoved = _parts(finest, still, 2.0)
    if unmoved is None or unmoved.missed is None or (found is not None and found.alike > unmoved.alike):
        return found
    return unmoved


def _likeliest_shift(level: _Level) -> Floats | None:
    """Give the shift, as a motion (4,), by which the textures of the finest level correlate best.

    Steps of a fit do not get there where the shift is larger than the texture's grains, and coarser levels do
    not show these. None where another shift is nearly as good: by a period more, on a woven belt.
    """
    from scipy.fft import irfft2, rfft2

    dim = np.zeros(level.dim.size, np.float32)
    dim.ravel()[level.dim.place] = level.dim.value
    # the correlation at all shifts at once, by Fourier's transform
    likeness = irfft2(rfft2(level.bright[0]) * np.conj(rfft2(dim)), dim.shape)
    reach = [min(_SHIFT_MAX, size // 2 - 1) for size in dim.shape]
    # shifts from −reach to reach, with none in the middle
    near = np.roll(likeness, reach, axis=(0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1].copy()
    down, across = (int(k) for k in np.unravel_index(int(near.argmax()), near.shape))
    best = near[down, across]
    near[max(down - _GRAIN, 0) : down + _GRAIN + 1, max(across - _GRAIN, 0) : across + _GRAIN + 1] = 0.0
    if near.max() > _SECOND_MAX * best:
        return None
    # the finest level is half as large as the image
    return np.array([2.0 * (across - reach[1]), 2.0 * (down - reach[0]), 0.0, 0.0])


def logarithm(pixels: NDArray[Any]) -> Singles:
    """Give (row, column) log(pixels + 1); of colours, of their mean."""
    if pixels.dtype != np.uint8:
        level = pixels if pixels.ndim == 2 else pixels.mean(axis=2)
        return np.log(level.astype(np.float32) + np.float32(1.0))
    import cv2

    if pixels.ndim == 2:
        return np.asarray(cv2.LUT(np.ascontiguousarray(pixels), _LOGARITHMS))
    total = pixels[..., 0].astype(np.uint16)
    for k in range(1, pixels.shape[2]):
        total += pixels[..., k]
    levels = (np.arange(255 * pixels.shape[2] + 1) / pixels.shape[2]).astype(np.float32)
    return np.asarray(np.log(levels + np.float32(1.0)).take(total))


_LOGARITHMS = np.log(np.arange(256, dtype=np.float32) + np.float32(1.0))


def _halved(image: Singles) -> Singles:
    import cv2

    rows, columns = (size // 2 * 2 for size in image.shape)
    return np.asarray(
        cv2.resize(image[:rows, :columns], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    )


@float_kernel
def halved_where(laser: NDArray[Any], free: Flags) -> tuple[Singles, Singles]:
    """Give (row // 2, column // 2) means of four pixels: of grey levels where free, and of that."""
    rows, columns = laser.shape[0] // 2, laser.shape[1] // 2
    weighted, share = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            many, total = 0, 0
            for k in range(4):
                row, column = 2 * i + k // 2, 2 * j + k % 2
                many += free[row, column]
                total += np.int64(laser[row, column]) * free[row, column]
            weighted[i, j], share[i, j] = 0.25 * total, 0.25 * many
    return weighted, share


def _beside_stripes(laser: NDArray[Any], *, grid: bool) -> Flags:
    import cv2

    # an opening takes off what is narrower than itself, along the rows
    opened = cv2.morphologyEx(laser, cv2.MORPH_OPEN, np.ones((1, _STRIPE_PX), np.uint8))
    if grid:
        opened = cv2.min(opened, cv2.morphologyEx(laser, cv2.MORPH_OPEN, np.ones((_STRIPE_PX, 1), np.uint8)))
    taken = cv2.subtract(laser, opened)
    sample = taken[::_SAMPLED, ::_SAMPLED].astype(np.float32)
    usual = median_of(sample.ravel())
    noise = 1.4826 * median_of(np.abs(sample - usual).ravel())
    on = (taken > usual + _STRIPE * max(noise, 1.0)).astype(np.uint8)
    on = cv2.morphologyEx(on, cv2.MORPH_OPEN, np.ones((3, 1), np.uint8))  # single pixels are noise
    grown = (max(_GROWN), max(_GROWN)) if grid else _GROWN
    return np.asarray(cv2.dilate(on, np.ones(grown, np.uint8)) == 0)


def _belt_like(log_plain: Singles) -> Flags:
    """Leave out what is brighter or darker than belt: products beyond their stripes, shadows."""
    import cv2

    small = cv2.resize(log_plain, None, fx=1 / _BLOCK_PX, fy=1 / _BLOCK_PX, interpolation=cv2.INTER_AREA)
    off = np.abs(small - np.float32(median_of(small.ravel())))
    odd = (off > max(_OFF_BELT * 1.4826 * median_of(off.ravel()), _OFF_BELT_MIN)).astype(np.uint8)
    odd = cv2.dilate(odd, np.ones((3, 3), np.uint8))
    rows, columns = log_plain.shape
    return np.asarray(cv2.resize(odd, (columns, rows), interpolation=cv2.INTER_NEAREST) == 0)


def _texture(image: Singles) -> Singles:
    """Give what varies over less than light does and more than noise, (row, column)."""
    import cv2

    fine, coarse = (cv2.blur(image, (width, width)) for width in _WIDTHS)
    return np.asarray(fine - coarse)


class _Seen(NamedTuple):
    """The belt's texture where a level of the laser image shows it."""

    value: Singles
    place: Integers
    """Of each in the flattened level."""
    x: Singles
    y: Singles
    """x, y: px of the level, from its middle."""
    size: tuple[int, int]

    @classmethod
    def of(cls, weighted: Singles, share: Singles) -> _Seen:
        """Take it from a level: sums of grey levels, and of how much of each pixel was seen."""
        import cv2

        fine, coarse = ([cv2.blur(image, (width, width)) for image in (weighted, share)] for width in _WIDTHS)
        value, place, x, y = texture_seen(share, *fine, *coarse)
        return cls(_clipped(value), place, x, y, share.shape)


class _Level(NamedTuple):
    """A level of both images."""

    dim: _Seen
    bright: Singles
    """(3, row, column) the plain image's texture, and its slopes along x and y, eight times as steep."""

    @classmethod
    def of(cls, weighted: Singles, share: Singles, bright: Singles) -> _Level:
        """Take it from what `halved_where` gives of the laser image, and the plain image's logarithm."""
        import cv2

        images = np.empty((3, *bright.shape), np.float32)
        images[0] = _clipped(_texture(bright))
        for slope, way in ((images[1], (1, 0)), (images[2], (0, 1))):
            cv2.Sobel(images[0], cv2.CV_32F, *way, dst=slope, ksize=3)
        return cls(_Seen.of(weighted, share), images)


@float_kernel
def texture_seen(
    share: Singles, fine: Singles, fine_share: Singles, coarse: Singles, coarse_share: Singles
) -> tuple[Singles, Integers, Singles, Singles]:
    """Give the fields of `_Seen` but for the size, of sums and shares averaged over both boxes."""
    rows, columns = share.shape
    value, place = np.empty(share.size, np.float32), np.empty(share.size, np.int64)
    x, y = np.empty(share.size, np.float32), np.empty(share.size, np.float32)
    least, seen, count = np.float32(1e-3), 0, 0
    for row in range(rows):
        for column in range(columns):
            if not (share[row, column] > 0.0 and fine_share[row, column] > 0.5):
                continue
            seen += 1
            if (seen - 1) % _APART:
                continue
            value[count] = fine[row, column] / max(fine_share[row, column], least)
            value[count] -= coarse[row, column] / max(coarse_share[row, column], least)
            place[count], x[count] = row * columns + column, column - 0.5 * (columns - 1)
            y[count] = row - 0.5 * (rows - 1)
            count += 1
    return value[:count].copy(), place[:count].copy(), x[:count].copy(), y[:count].copy()


def _clipped(values: Singles) -> Singles:
    sample = np.abs(values.ravel()[::_SAMPLED])
    most = _ODD * 1.4826 * median_of(sample) if sample.size else 0.0
    return np.asarray(np.clip(values, -most, most))


class _Compared(NamedTuple):
    """Both textures at the places that the laser image shows, of a level whose pixels are `every` px wide."""

    a: Singles
    b: Singles
    gain: float


def _compared(level: _Level, motion: Floats, every: float) -> _Compared:
    return _of(_sampled(level.bright[:1], level.dim, motion, every)[0], level.dim)


def _of(a: Singles, dim: _Seen) -> _Compared:
    return _Compared(a, dim.value, float(a @ dim.value) / max(float(a @ a), 1e-12))


def _sampled(images: Singles, dim: _Seen, motion: Floats, every: float) -> Singles:
    """Give (image, place) what each of some images has at the places, once they have moved."""
    found = np.empty((len(images), dim.place.size), np.float32)
    sampled_at(images, dim.place, motion, every, found)
    return found


@float_kernel
def sampled_at(images: Singles, place: Integers, motion: Floats, every: float, found: Singles) -> None:
    """Write (image, place) of the first images (image, row, column) to `found`, linear between pixels.

    They are repeated at the border. `place` counts flattened pixels, in their order; `every` is how wide a
    pixel is, px of the `motion`.
    """
    rows, columns = images.shape[1:]
    if not motion.any():
        for n in range(found.shape[0]):
            found[n] = images[n].ravel()[place]
        return
    level = motion.copy()
    level[:2] /= every
    matrix = _matrix(level, rows, columns).astype(np.float32)
    row, first = 0, 0
    nowhere, wide, high = np.float32(-1.0), np.float32(columns), np.float32(rows)
    # in the order in which OpenCV's warp rounds: what is the same along a row first
    of_x, of_y = matrix[0, 2], matrix[1, 2]
    for k in range(place.size):
        while place[k] >= first + columns:
            row, first = row + 1, first + columns
            of_x = matrix[0, 1] * np.float32(row) + matrix[0, 2]
            of_y = matrix[1, 1] * np.float32(row) + matrix[1, 2]
        column = np.float32(place[k] - first)
        # farther out than a pixel the border is all there is
        x = min(max(matrix[0, 0] * column + of_x, nowhere), wide)
        y = min(max(matrix[1, 0] * column + of_y, nowhere), high)
        left, top = np.int64(np.floor(x)), np.int64(np.floor(y))
        share, low = x - np.float32(left), y - np.float32(top)
        # unsigned, which no index from the end can be
        j, i = np.uint64(min(max(left, 0), columns - 1)), np.uint64(min(max(top, 0), rows - 1))
        right, under = np.uint64(min(left + 1, columns - 1)), np.uint64(min(top + 1, rows - 1))
        for n in range(np.uint64(found.shape[0])):
            above = images[n, i, j] + share * (images[n, i, right] - images[n, i, j])
            below = images[n, under, j] + share * (images[n, under, right] - images[n, under, j])
            found[n, k] = above + low * (below - above)


def _fitted(level: _Level, motion: Floats, every: float, rounds: int = _ROUNDS) -> ImageMotion | None:
    """Fit the motion on one level, from a first guess."""
    dim = level.dim
    if dim.place.size < _ALIKE * _CLEAR**2:
        return None
    alike, motion, normal, std = followed(
        level.bright, dim.value, dim.place, dim.x, dim.y, motion, every, rounds
    )
    found = _parts(level, motion, every) if alike else None
    if found is None:
        return None
    # neighbouring places share their noise, so fewer tell
    return found._replace(covariance=np.asarray(_ALIKE * std**2 * np.linalg.inv(normal), np.float64))


@float_kernel
def followed(
    bright: Singles, value: Singles, place: Integers, x: Singles, y: Singles, start: Floats, every: float,
    rounds: int,
) -> tuple[bool, Floats, Floats, float]:  # fmt: skip
    """Follow the motion on one level, from a first guess, to where the textures differ least.

    Parameters
    ----------
    bright
        See `_Level`.
    value, place, x, y
        See `_Seen`.
    start
        (4,) first guess, as `ImageMotion.motion`.
    every
        How wide a pixel of the level is, px.
    rounds
        Steps at most.

    Returns
    -------
    tuple
        Whether there is any likeness to follow; if so, (4,) the motion, and of the last step (4, 4) the
        normal equations and the scatter of what is left.
    """
    columns = bright.shape[2]
    motion, normal, std = start.copy(), np.zeros((4, 4)), 0.0
    reach = np.array([1.0, 1.0, every * columns / 2.0, every * columns / 2.0])
    found = np.empty((3, place.size), np.float32)
    slope_gain = 0.0
    for turn in range(rounds):
        # later steps change the slopes by little
        sampled_at(bright, place, motion, every, found if turn < _SLOPES_ROUNDS else found[:1])
        squares, products = 0.0, 0.0
        for k in range(place.size):
            squares += found[0, k] * found[0, k]
            products += found[0, k] * value[k]
        # least squares of value = gain × texture
        gain = products / max(squares, 1e-12)
        if gain <= 0.0:
            return False, motion, normal, std
        # Sobel's slopes are eight times as steep
        if turn < _SLOPES_ROUNDS:
            slope_gain = gain / 8.0
        normal, step, std = _step_sums(found, value, gain, slope_gain, x, y, every)
        factor, most = normal.copy(), max(normal[0, 0], normal[1, 1], normal[2, 2], normal[3, 3])
        solve(factor, step)
        for n in range(4):
            # pivots of the factors, squared
            if not factor[n, n] * factor[n, n] > _SINGULAR * most:
                return False, motion, normal, std
        motion += step
        if np.abs(step * reach).max() < _SETTLED_PX:
            break
    return True, motion, normal, std


@inlined
def _step_sums(
    found: Singles, value: Singles, gain: float, slope_gain: float, x: Singles, y: Singles, every: float
) -> tuple[Floats, Floats, float]:
    """Give (4, 4) and (4,) normal equations of a step of the motion, and the scatter of what is left.

    Parameters
    ----------
    found, gain
        (3, place) the bright texture at the places seen, its slopes along x and y; and what the first is
        multiplied with to be `value`.
    value, x, y, every
        See `followed`.
    slope_gain
        What slopes are multiplied with.
    """
    texture, along, down = found[0], found[1], found[2]
    squares = 0.0
    for k in range(x.size):
        left = value[k] - gain * texture[k]
        squares += left * left
    std = math.sqrt(squares / x.size)
    # each sum a number of its own: so several places are taken at once
    xx = xy = yy = xt = yt = tt = xg = yg = tg = gg = of_x = of_y = of_turn = of_growth = 0.0
    for k in range(x.size):
        left = value[k] - gain * texture[k]
        # Huber's weights
        weight = min(1.0, _ODD * std / max(abs(left), 1e-9))
        right_way, down_way = slope_gain * along[k], slope_gain * down[k]
        # derivatives by turn and growth about the middle
        turn, growth = down_way * x[k] - right_way * y[k], right_way * x[k] + down_way * y[k]
        across, below = right_way / every, down_way / every
        xx += weight * across * across
        xy += weight * across * below
        yy += weight * below * below
        xt += weight * across * turn
        yt += weight * below * turn
        tt += weight * turn * turn
        xg += weight * across * growth
        yg += weight * below * growth
        tg += weight * turn * growth
        gg += weight * growth * growth
        of_x += weight * across * left
        of_y += weight * below * left
        of_turn += weight * turn * left
        of_growth += weight * growth * left
    normal = np.array([[xx, xy, xt, xg], [xy, yy, yt, yg], [xt, yt, tt, tg], [xg, yg, tg, gg]])
    return normal, np.array([of_x, of_y, of_turn, of_growth]), std


@float_kernel
def part_sums(one: _Compared, place: Integers, rows: int, columns: int) -> Floats:
    """Give (4, part) the number of places in each part, and sums there of a·b, a² and b²."""
    sums = np.zeros((4, _PARTS[0] * _PARTS[1]))
    for k in range(place.size):
        row, column = place[k] // columns, place[k] % columns
        part = row * _PARTS[0] // rows * _PARTS[1] + column * _PARTS[1] // columns
        sums[0, part] += 1.0
        sums[1, part] += one.a[k] * one.b[k]
        sums[2, part] += one.a[k] * one.a[k]
        sums[3, part] += one.b[k] * one.b[k]
    return sums


def _parts(level: _Level, motion: Floats, every: float) -> ImageMotion | None:
    """Compare the textures as a whole and part by part; None where neither is alike.

    The gain is that of the parts that are alike: of a torn frame the others would lower it. No part must show
    more texture than is usual: what else varies is the rim of a shadow, which plain light alone throws.
    """
    one, (rows, columns) = _compared(level, motion, every), level.dim.size
    count, both, of_a, of_b = part_sums(one, level.dim.place, rows, columns)
    # a correlation of n places of noise scatters by 1/√n
    scale = np.sqrt(count / _ALIKE) / np.sqrt(np.maximum(of_a * of_b, 1e-12))
    alike = both * scale > _CLEAR
    whole = both.sum() / np.sqrt(max(of_a.sum() * of_b.sum(), 1e-12)) * math.sqrt(count.sum() / _ALIKE)
    if whole < _CLEAR and not alike.any():
        return None
    gain = both[alike].sum() / of_a[alike].sum() if alike.any() else 0.0
    seen = count > 0.0
    usual = median_of(of_a[seen] / count[seen]) if seen.any() else 0.0
    other = (gain * np.minimum(of_a, usual * count) * scale > _CLEAR) & (both * scale < _MISSED)
    missed = None
    if other.sum() >= _PARTS_MIN:
        down, across = np.nonzero(other.reshape(_PARTS))
        size = round(rows * every), round(columns * every)
        first = down.min() * size[0] // _PARTS[0], across.min() * size[1] // _PARTS[1]
        last = (down.max() + 1) * size[0] // _PARTS[0], (across.max() + 1) * size[1] // _PARTS[1]
        missed = int(first[0]), int(last[0]) - 1, int(first[1]), int(last[1]) - 1
    full = _matrix(motion, round(rows * every), round(columns * every))
    return ImageMotion(full, np.diag(np.full(4, np.inf)), motion, missed, int(alike.sum()), float(whole))


@kernel
def _matrix(motion: Floats, rows: int, columns: int) -> Floats:
    right, down, turn, growth = motion[0], motion[1], motion[2], motion[3]
    x, y = 0.5 * (columns - 1), 0.5 * (rows - 1)
    along, across = (1.0 + growth) * math.cos(turn), (1.0 + growth) * math.sin(turn)
    return np.array(
        [
            [along, -across, x + right - (along * x - across * y)],
            [across, along, y + down - (across * x + along * y)],
        ]
    )
