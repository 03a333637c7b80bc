"""What may go wrong with the images of one acquisition: an open set of disturbances, each with its sizes.

Sizes are drawn evenly over the logarithm between the smallest, which no one would notice, and the gross.
Motion is made by warping here; `benchmarks.moved_rigs` renders the scene again with the moved rig.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[Any]
Images = tuple[Image, Image | None]

_DIFFERS_GREY = 40
"""More than noise: a stripe is here in one image, and not in the other."""


class Scene(NamedTuple):
    """Images of one acquisition, as acquired, with what is true of it; `other` is another scene's."""

    name: str
    laser: Image
    plain: Image | None
    true_mm3: float
    other: Scene | None = None

    def shown_mm3(self, laser: Image) -> float:
        """Give the true volume of the product that a laser image shows, should no plain image gainsay it.

        Most of what differs between this scene and the other may come from the other one: then that is the
        product that was seen.
        """
        if self.other is None or self.plain is not None or laser.shape != self.other.laser.shape:
            return self.true_mm3
        own, other = self.laser.astype(np.int64), self.other.laser.astype(np.int64)
        differs = np.abs(own - other) > _DIFFERS_GREY
        from_other = (laser[differs] == self.other.laser[differs]).mean() if differs.any() else 0.0
        return self.other.true_mm3 if from_other > 0.5 else self.true_mm3


class Disturbance(NamedTuple):
    """A way to disturb, over its sizes from `low` to `high`; up to `harmless` no stripe is harmed by it."""

    unit: str
    low: float
    high: float
    harmless: float
    make: Callable[[Scene, float, np.random.Generator], Images]


def moved_image(
    image: Image, right: float = 0.0, down: float = 0.0, turn_deg: float = 0.0, scale: float = 1.0
) -> Image:
    """Shift, turn clockwise and scale an image about its middle."""
    rows, columns = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -turn_deg, scale)
    matrix[:, 2] += right, down
    return np.asarray(
        cv2.warpAffine(
            image, matrix, (columns, rows), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
        )
    )


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _motion(
    of: Callable[[float, np.random.Generator], dict[str, float]], *, plain_only: bool = False
) -> Callable[[Scene, float, np.random.Generator], Images]:
    def make(scene: Scene, size: float, rng: np.random.Generator) -> Images:
        motion = of(size, rng)
        laser = scene.laser if plain_only else moved_image(scene.laser, **motion)
        return laser, None if scene.plain is None else moved_image(scene.plain, **motion)

    return make


def _all_ways(size_px: float, rng: np.random.Generator) -> dict[str, float]:
    right, down, turn, grow = size_px * rng.uniform(-0.5, 0.5, 4)
    return {"right": right, "down": down, "turn_deg": np.degrees(turn / 320.0), "scale": 1.0 + grow / 320.0}


def _aside(size_px: float, rng: np.random.Generator) -> dict[str, float]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return {"right": size_px * np.cos(angle), "down": size_px * np.sin(angle)}


def _both(
    change: Callable[[Image, float, np.random.Generator], Image],
) -> Callable[[Scene, float, np.random.Generator], Images]:
    return lambda scene, size, rng: (
        change(scene.laser, size, rng),
        None if scene.plain is None else change(scene.plain, size, rng),
    )


def _laser(
    change: Callable[[Image, float, np.random.Generator], Image],
) -> Callable[[Scene, float, np.random.Generator], Images]:
    return lambda scene, size, rng: (change(scene.laser, size, rng), scene.plain)


def _grey(image: Image, wanted: NDArray[Any]) -> Image:
    return np.asarray(np.clip(np.rint(wanted), 0, np.iinfo(image.dtype).max), image.dtype)


def _jpeg(image: Image, loss: float, _: np.random.Generator) -> Image:
    quality = [cv2.IMWRITE_JPEG_QUALITY, max(1, round(100.0 - loss))]
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_UNCHANGED))


def _gamma(image: Image, log_power: float, rng: np.random.Generator) -> Image:
    power = float(np.exp(_sign(rng) * log_power))
    return _grey(image, 255.0 * (image / 255.0) ** power)


def _noise(image: Image, std: float, rng: np.random.Generator) -> Image:
    return _grey(image, image + rng.normal(0.0, std, image.shape))


def _specks(image: Image, share: float, rng: np.random.Generator) -> Image:
    hit, image = rng.random(image.shape[:2]), image.copy()
    image[hit < share / 2], image[hit > 1.0 - share / 2] = 0, 255
    return image


def _blur(image: Image, sigma_px: float, _: np.random.Generator) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def _dimmed(image: Image, loss: float, _: np.random.Generator) -> Image:
    """The laser gives less light: what rises above the background is lowered."""
    ground = float(np.median(image))
    return _grey(image, np.minimum(image, ground) + (1.0 - loss) * np.maximum(image - ground, 0.0))


def _lamp(image: Image, grey: float, rng: np.random.Generator) -> Image:
    """Other light falls in, more of it on one side."""
    across, down = np.meshgrid(
        np.linspace(-1, 1, image.shape[1]), np.linspace(-1, 1, image.shape[0]), copy=False
    )
    angle = rng.uniform(0.0, 2.0 * np.pi)
    light = grey * (0.6 + 0.4 * (across * np.cos(angle) + down * np.sin(angle)))
    light = light if image.ndim == 2 else light[..., None]
    return _grey(image, image + light + rng.normal(0.0, 0.15 * np.sqrt(grey), image.shape))


def _black_level(image: Image, grey: float, rng: np.random.Generator) -> Image:
    return _grey(image, image + _sign(rng) * grey)


def _lost(axis: int, fill: str) -> Callable[[Image, float, np.random.Generator], Image]:
    """Lines are lost at a random place; what follows moves up, and the image is filled up at its end."""

    def change(image: Image, lines: float, rng: np.random.Generator) -> Image:
        size = image.shape[axis]
        count = min(max(1, round(lines)), size // 4)
        first = int(rng.integers(size // 4, 3 * size // 4 - count))
        kept = np.delete(image, np.s_[first : first + count], axis)
        filled = np.take(image, range(-count, 0) if fill == "repeated" else range(count), axis)
        return np.concatenate([kept, filled * 0 if fill == "black" else filled], axis)

    return change


def _doubled(image: Image, lines: float, rng: np.random.Generator) -> Image:
    """A block of rows is sent twice."""
    rows = image.shape[0]
    count = min(max(1, round(lines)), rows // 4)
    first = int(rng.integers(rows // 4, 3 * rows // 4 - count))
    return np.concatenate([image[: first + count], image[first : rows - count]])


def _joined(axis: int) -> Callable[[Scene, float, np.random.Generator], Images]:
    def make(scene: Scene, share: float, _: np.random.Generator) -> Images:
        assert scene.other is not None
        size = scene.laser.shape[axis]
        place = size - max(1, round(share * size))
        parts = np.take(scene.laser, range(place), axis), np.take(scene.other.laser, range(place, size), axis)
        return np.concatenate(parts, axis), scene.plain

    return make


def _patched(scene: Scene, share: float, rng: np.random.Generator, *, band: bool = False) -> Images:
    """A block of the laser image, or a band of whole rows, is another frame's; `share` of each side."""
    assert scene.other is not None
    laser, place = scene.laser.copy(), []
    for axis, size in enumerate(laser.shape[:2]):
        count = size if band and axis else max(1, round(share * size))
        first = int(rng.integers(0, size - count + 1))
        place.append(np.s_[first : first + count])
    laser[tuple(place)] = scene.other.laser[tuple(place)]
    return laser, scene.plain


def _interlaced(scene: Scene, share: float, _: np.random.Generator) -> Images:
    assert scene.other is not None
    laser = scene.laser.copy()
    last = round(share * laser.shape[0])
    laser[:last:2] = scene.other.laser[:last:2]
    return laser, scene.plain


def _deep(scene: Scene, bits: float, _: np.random.Generator) -> Images:
    """An image of more bits in a 16-bit file that does not say so."""
    scale = 2 ** round(bits) // 256
    return tuple(None if one is None else one.astype(np.uint16) * scale for one in scene[1:3])  # type: ignore[return-value]


_ONCE = (1.0, 1.0, 0.0)

DISTURBANCES: dict[str, Disturbance] = {
    "camera shifted along x": Disturbance(
        "px", 0.02, 10.0, 0.05, _motion(lambda size, rng: {"right": size * _sign(rng)})
    ),
    "camera shifted along y": Disturbance(
        "px", 0.02, 10.0, 0.05, _motion(lambda size, rng: {"down": size * _sign(rng)})
    ),
    "camera turned": Disturbance(
        "°", 0.005, 3.0, 0.009, _motion(lambda size, rng: {"turn_deg": size * _sign(rng)})
    ),
    "camera nearer or farther": Disturbance(
        "%", 0.01, 5.0, 0.015, _motion(lambda size, rng: {"scale": 1.0 + 0.01 * size * _sign(rng)})
    ),
    "camera moved in all ways": Disturbance("px", 0.02, 10.0, 0.05, _motion(_all_ways)),
    "plain image shifted": Disturbance("px", 0.02, 15.0, 0.05, _motion(_aside, plain_only=True)),
    "plain image turned": Disturbance(
        "°", 0.01, 5.0, 0.009, _motion(lambda size, rng: {"turn_deg": size * _sign(rng)}, plain_only=True)
    ),
    "plain image of another scale": Disturbance(
        "%", 0.01, 5.0, 0.015,
        _motion(lambda size, rng: {"scale": 1.0 + 0.01 * size * _sign(rng)}, plain_only=True),
    ),
    "plain image of another product": Disturbance(
        "", *_ONCE, lambda scene, _, __: (scene.laser, scene.other and scene.other.plain)
    ),
    "JPEG": Disturbance("lost quality", 2.0, 95.0, 25.0, _both(_jpeg)),
    "gamma": Disturbance("log power", 0.03, 0.9, 0.25, _both(_gamma)),
    "noise": Disturbance("grey levels", 0.2, 15.0, 1.0, _both(_noise)),
    "specks": Disturbance("share", 1e-5, 0.03, 1e-4, _laser(_specks)),
    "out of focus": Disturbance("px", 0.2, 4.0, 0.4, _both(_blur)),
    "laser dimmed": Disturbance("share", 0.05, 0.98, 0.2, _laser(_dimmed)),
    "other light": Disturbance("grey levels", 1.0, 150.0, 5.0, _laser(_lamp)),
    "black level": Disturbance("grey levels", 1.0, 60.0, 2.0, _laser(_black_level)),
    "rows lost, last ones repeated": Disturbance("rows", 1.0, 60.0, 0.0, _laser(_lost(0, "repeated"))),
    "rows lost, black ones added": Disturbance("rows", 1.0, 60.0, 0.0, _laser(_lost(0, "black"))),
    "rows lost, first ones again": Disturbance("rows", 1.0, 60.0, 0.0, _laser(_lost(0, "first"))),
    "rows twice": Disturbance("rows", 1.0, 60.0, 0.0, _laser(_doubled)),
    "columns lost": Disturbance("columns", 1.0, 60.0, 0.0, _laser(_lost(1, "repeated"))),
    "lower part of another frame": Disturbance("share", 0.02, 0.9, 0.0, _joined(0)),
    "right part of another frame": Disturbance("share", 0.02, 0.9, 0.0, _joined(1)),
    "band of rows of another frame": Disturbance("share", 0.02, 0.9, 0.0, partial(_patched, band=True)),
    "block of another frame": Disturbance("share", 0.05, 0.95, 0.0, _patched),
    "every other row of another frame": Disturbance("share", 0.05, 1.0, 0.0, _interlaced),
    "more bits than said": Disturbance("bits", 9.0, 15.0, 0.0, _deep),
    "laser off": Disturbance(
        "", *_ONCE, _laser(lambda image, _, __: np.minimum(image, np.median(image).astype(image.dtype)))
    ),
    "mirrored": Disturbance("", *_ONCE, _both(lambda image, _, __: np.ascontiguousarray(image[:, ::-1]))),
    "upside down": Disturbance("", *_ONCE, _both(lambda image, _, __: np.ascontiguousarray(image[::-1]))),
    "laser and plain image swapped": Disturbance(
        "", *_ONCE, lambda scene, _, __: (scene.laser if scene.plain is None else scene.plain, scene.laser)
    ),
}  # fmt: skip
