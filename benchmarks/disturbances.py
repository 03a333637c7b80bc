"""What may go wrong with the images of one acquisition: an open set of disturbances, each with its sizes.

Sizes are drawn evenly over the logarithm between the smallest, which no one would notice, and the gross.
Motion is made by warping (`DISTURBANCES`), or scenes are rendered anew by both simulators, camera or laser
moved, while the calibration stays (`MOTIONS`); a motion is given its size in pixels: how far it moves the
image, or a stripe, at the image's edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roemetry.config.scene import Scene as SceneFile
from roemetry.config.scene_parts import CameraPart
from roemetry.records import ScanLines
from roemetry.stages.registry import discover
from roemetry_simulate.scene import camera_of

Image = NDArray[Any]
Images = tuple[Image, Image | None]
Rng = np.random.Generator

_DIFFERS_GREY = 40
"""More than noise: a stripe is here in one image, and not in the other."""


class Scene(NamedTuple):
    """Images of one acquisition, as acquired, with what is true of it; `other` is another scene's.

    Of a scan, `laser` holds its frames (line, row, column), and `lines` where the belt was.
    """

    name: str
    laser: Image
    plain: Image | None
    true_mm3: float
    other: Scene | None = None
    lines: ScanLines | None = None

    def shown_mm3(self, laser: Image) -> float:
        """Give the true volume of the product that a laser image shows, should no plain image gainsay it.

        Most of what differs between this scene and the other may come from the other one: then that is the
        product that was seen.
        """
        if self.other is None or self.plain is not None:
            return self.true_mm3
        both = np.s_[:] if self.lines is None else np.s_[: min(len(laser), len(self.other.laser))]
        laser, other = laser[both], self.other.laser[both]
        if laser.shape != other.shape:
            return self.true_mm3
        differs = np.abs(self.laser[both].astype(np.int64) - other.astype(np.int64)) > _DIFFERS_GREY
        from_other = (laser[differs] == other[differs]).mean() if differs.any() else 0.0
        return self.other.true_mm3 if from_other > 0.5 else self.true_mm3


Make = Callable[[Scene, float, Rng], Images]
Change = Callable[[Image, float, Rng], Image]


class Disturbance(NamedTuple):
    """A way to disturb, over its sizes from `low` to `high`; up to `harmless` no stripe is harmed by it."""

    unit: str
    low: float
    high: float
    harmless: float
    make: Make


def _moved_image(
    image: Image, right: float = 0.0, down: float = 0.0, turn_deg: float = 0.0, scale: float = 1.0
) -> Image:
    """Shift, turn clockwise and scale an image about its middle."""
    rows, columns = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -turn_deg, scale)
    matrix[:, 2] += right, down
    how = {"flags": cv2.INTER_LANCZOS4, "borderMode": cv2.BORDER_REFLECT}
    return np.asarray(cv2.warpAffine(image, matrix, (columns, rows), **how))


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _motion(of: Callable[[float, Rng], dict[str, float]], *, plain_only: bool = False) -> Make:
    def make(scene: Scene, size: float, rng: Rng) -> Images:
        motion = of(size, rng)
        laser = scene.laser if plain_only else _moved_image(scene.laser, **motion)
        return laser, None if scene.plain is None else _moved_image(scene.plain, **motion)

    return make


def _all_ways(size_px: float, rng: Rng) -> dict[str, float]:
    right, down, turn, grow = size_px * rng.uniform(-0.5, 0.5, 4)
    return {"right": right, "down": down, "turn_deg": np.degrees(turn / 320.0), "scale": 1.0 + grow / 320.0}


def _aside(size_px: float, rng: Rng) -> dict[str, float]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return {"right": size_px * np.cos(angle), "down": size_px * np.sin(angle)}


def _turned(size_deg: float, rng: Rng) -> dict[str, float]:
    return {"turn_deg": size_deg * _sign(rng)}


def _scaled(size_percent: float, rng: Rng) -> dict[str, float]:
    return {"scale": 1.0 + 0.01 * size_percent * _sign(rng)}


def _laser(change: Change) -> Make:
    return lambda scene, size, rng: (change(scene.laser, size, rng), scene.plain)


def _both(change: Change) -> Make:
    return lambda scene, size, rng: (
        change(scene.laser, size, rng),
        None if scene.plain is None else change(scene.plain, size, rng),
    )


def _grey(image: Image, wanted: Image) -> Image:
    return np.asarray(np.clip(np.rint(wanted), 0, np.iinfo(image.dtype).max), image.dtype)


def _jpeg(image: Image, loss: float, _: Rng) -> Image:
    quality = [cv2.IMWRITE_JPEG_QUALITY, max(1, round(100.0 - loss))]
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_UNCHANGED))


def _gamma(image: Image, log_power: float, rng: Rng) -> Image:
    return _grey(image, 255.0 * (image / 255.0) ** float(np.exp(_sign(rng) * log_power)))


def _noise(image: Image, std: float, rng: Rng) -> Image:
    return _grey(image, image + rng.normal(0.0, std, image.shape))


def _specks(image: Image, share: float, rng: Rng) -> Image:
    hit, image = rng.random(image.shape[:2]), image.copy()
    image[hit < share / 2], image[hit > 1.0 - share / 2] = 0, 255
    return image


def _blur(image: Image, sigma_px: float, _: Rng) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def _dimmed(image: Image, loss: float, _: Rng) -> Image:
    """The laser gives less light: what rises above the background is lowered."""
    ground = float(np.median(image))
    return _grey(image, np.minimum(image, ground) + (1.0 - loss) * np.maximum(image - ground, 0.0))


def _lamp(image: Image, grey: float, rng: Rng) -> Image:
    """Other light falls in, more of it on one side."""
    rows, columns = image.shape[:2]
    across, down = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows), copy=False)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    light = grey * (0.6 + 0.4 * (across * np.cos(angle) + down * np.sin(angle)))
    light = light if image.ndim == 2 else light[..., None]
    return _grey(image, image + light + rng.normal(0.0, 0.15 * np.sqrt(grey), image.shape))


def _black_level(image: Image, grey: float, rng: Rng) -> Image:
    return _grey(image, image + _sign(rng) * grey)


def _place(size: int, lines: float, rng: Rng) -> tuple[int, int]:
    """Draw where a block of lines begins, and how many it has: at most a quarter, in the middle half."""
    count = min(max(1, round(lines)), size // 4)
    return int(rng.integers(size // 4, 3 * size // 4 - count)), count


def _lost(axis: int, fill: str) -> Change:
    """Lines are lost at a random place; what follows moves up, and the image is filled up at its end."""

    def change(image: Image, lines: float, rng: Rng) -> Image:
        """Give the image without so many lines, as large as before."""
        first, count = _place(image.shape[axis], lines, rng)
        kept = np.delete(image, np.s_[first : first + count], axis)
        filled = np.take(image, range(-count, 0) if fill == "repeated" else range(count), axis)
        return np.concatenate([kept, filled * 0 if fill == "black" else filled], axis)

    return change


def _doubled(image: Image, lines: float, rng: Rng) -> Image:
    """A block of rows is sent twice."""
    first, count = _place(image.shape[0], lines, rng)
    return np.concatenate([image[: first + count], image[first : image.shape[0] - count]])


def _joined(axis: int) -> Make:
    def make(scene: Scene, share: float, _: Rng) -> Images:
        """Give the images with the last share of the laser image's lines from the other scene's."""
        assert scene.other is not None
        size = scene.laser.shape[axis]
        place = size - max(1, round(share * size))
        parts = np.take(scene.laser, range(place), axis), np.take(scene.other.laser, range(place, size), axis)
        return np.concatenate(parts, axis), scene.plain

    return make


def _patched(scene: Scene, share: float, rng: Rng, *, band: bool = False) -> Images:
    """A block of the laser image, or a band of whole rows, is another frame's; `share` of each side."""
    assert scene.other is not None
    laser, place = scene.laser.copy(), []
    for axis, size in enumerate(laser.shape[:2]):
        count = size if band and axis else max(1, round(share * size))
        first = int(rng.integers(0, size - count + 1))
        place.append(np.s_[first : first + count])
    laser[tuple(place)] = scene.other.laser[tuple(place)]
    return laser, scene.plain


def _interlaced(scene: Scene, share: float, _: Rng) -> Images:
    assert scene.other is not None
    laser, last = scene.laser.copy(), round(share * scene.laser.shape[0])
    laser[:last:2] = scene.other.laser[:last:2]
    return laser, scene.plain


def _deep(scene: Scene, bits: float, _: Rng) -> Images:
    """An image of more bits in a 16-bit file that does not say so."""
    scale = 2 ** round(bits) // 256
    return tuple(None if one is None else one.astype(np.uint16) * scale for one in scene[1:3])  # type: ignore[return-value]


def _off(image: Image, _: float, __: Rng) -> Image:
    return np.minimum(image, np.median(image).astype(image.dtype))


_ONCE = (1.0, 1.0, 0.0)
_SHIFT, _TURN, _SCALE = (0.02, 10.0, 0.05), (0.005, 3.0, 0.009), (0.01, 5.0, 0.015)
_LINES, _SHARE = (1.0, 60.0, 0.0), (0.02, 0.9, 0.0)

DISTURBANCES: dict[str, Disturbance] = {name: Disturbance(*of) for name, of in {
    "camera shifted along x": ("px", *_SHIFT, _motion(lambda size, rng: {"right": size * _sign(rng)})),
    "camera shifted along y": ("px", *_SHIFT, _motion(lambda size, rng: {"down": size * _sign(rng)})),
    "camera turned": ("°", *_TURN, _motion(_turned)),
    "camera nearer or farther": ("%", *_SCALE, _motion(_scaled)),
    "camera moved in all ways": ("px", *_SHIFT, _motion(_all_ways)),
    "plain image shifted": ("px", 0.02, 15.0, 0.05, _motion(_aside, plain_only=True)),
    "plain image turned": ("°", 0.01, 5.0, 0.009, _motion(_turned, plain_only=True)),
    "plain image of another scale": ("%", *_SCALE, _motion(_scaled, plain_only=True)),
    "plain image of another product": (
        "", *_ONCE, lambda scene, _, __: (scene.laser, scene.other and scene.other.plain)
    ),
    "JPEG": ("lost quality", 2.0, 95.0, 25.0, _both(_jpeg)),
    "JPEG of colours": ("lost quality", 2.0, 95.0, 0.0, _both(_jpeg)),
    "gamma": ("log power", 0.03, 0.9, 0.25, _both(_gamma)),
    "noise": ("grey levels", 0.2, 15.0, 1.0, _both(_noise)),
    "specks": ("share", 1e-5, 0.03, 1e-4, _laser(_specks)),
    "out of focus": ("px", 0.2, 4.0, 0.4, _both(_blur)),
    "laser dimmed": ("share", 0.05, 0.98, 0.2, _laser(_dimmed)),
    "other light": ("grey levels", 1.0, 150.0, 5.0, _laser(_lamp)),
    "black level": ("grey levels", 1.0, 60.0, 2.0, _laser(_black_level)),
    "rows lost, last ones repeated": ("rows", *_LINES, _laser(_lost(0, "repeated"))),
    "rows lost, black ones added": ("rows", *_LINES, _laser(_lost(0, "black"))),
    "rows lost, first ones again": ("rows", *_LINES, _laser(_lost(0, "first"))),
    "rows twice": ("rows", *_LINES, _laser(_doubled)),
    "columns lost": ("columns", *_LINES, _laser(_lost(1, "repeated"))),
    "lower part of another frame": ("share", *_SHARE, _joined(0)),
    "right part of another frame": ("share", *_SHARE, _joined(1)),
    "band of rows of another frame": ("share", *_SHARE, partial(_patched, band=True)),
    "block of another frame": ("share", 0.05, 0.95, 0.0, _patched),
    "every other row of another frame": ("share", 0.05, 1.0, 0.0, _interlaced),
    "more bits than said": ("bits", 9.0, 15.0, 0.0, _deep),
    "laser off": ("", *_ONCE, _laser(_off)),
    "mirrored": ("", *_ONCE, _both(lambda image, _, __: np.ascontiguousarray(image[:, ::-1]))),
    "upside down": ("", *_ONCE, _both(lambda image, _, __: np.ascontiguousarray(image[::-1]))),
    "laser and plain image swapped": (
        "", *_ONCE, lambda scene, _, __: (scene.laser if scene.plain is None else scene.plain, scene.laser)
    ),
}.items()}  # fmt: skip


def disturbs(name: str, scene: Scene) -> bool:
    """Say whether a disturbance is one of such a scene.

    JPEG halves the resolution of colours: even the mildest moves lines of two colours by 0.05 px (root mean
    square), a quality of 75 by 0.13 px. There it is never harmless.
    """
    if scene.lines is not None and name in OF_PLAIN:
        return False
    in_colour = scene.lines is None and scene.laser.ndim == 3
    return name != ("JPEG" if in_colour else "JPEG of colours")


OF_PLAIN = frozenset(
    name for name in DISTURBANCES if name.startswith("plain image") or name == "laser and plain image swapped"
)
"""Of the plain-light image alone: a scan has none."""


_TRANSPORT = frozenset(
    name for name in DISTURBANCES if "another frame" in name or name.split()[0] in ("rows", "columns")
)
_HIT = 0.1
"""Share of a scan's frames that a fault of transport hits."""


def of_frames(scene: Scene, name: str, size: float, seed: Sequence[int]) -> Images:
    """Disturb the frames of a scan: all of them alike, with noise of their own; or some, by transport.

    There, another frame is another one of the scan.
    """
    make, frames = DISTURBANCES[name].make, []
    hit = np.random.default_rng([*seed, 0]).random(len(scene.laser)) < _HIT
    for line, frame in enumerate(scene.laser):
        rng: Rng = _FrameRng(seed, line)
        other = None
        if name in _TRANSPORT:
            rng = np.random.default_rng([*seed, line, 1])
            other = Scene(scene.name, scene.laser[rng.integers(len(scene.laser))], None, scene.true_mm3)
        one = scene._replace(laser=frame, other=other)
        frames.append(make(one, size, rng)[0] if hit[line] or name not in _TRANSPORT else frame)
    return np.stack(frames), None


class _FrameRng(np.random.Generator):
    """Draws places and signs by the case, noise by the frame."""

    def __init__(self, seed: Sequence[int], line: int) -> None:
        super().__init__(np.random.PCG64(seed))
        own = np.random.default_rng([*seed, line])
        for noise in ("normal", "random", "standard_normal", "poisson"):
            setattr(self, noise, getattr(own, noise))


# Scenes rendered anew.

Options = Mapping[str, Any]
MAKERS = {
    "ray-caster": "simulator.options.product.items=[]",
    "mitsuba": "simulator.options.product={family: lofted-skein}",
}
"""By maker: the scene's own products, drawn anew; and what the other one has like herring roe."""
_BODIES = 2
"""Products rendered of a scene; each is rendered unmoved first."""


class Motion(NamedTuple):
    """A motion of the rig with its sizes, px; `made` gives the changed options of the simulator."""

    made: Callable[[Options, float], dict[str, Any]]
    unit: str = "px"
    low: float = 0.03
    high: float = 6.0
    harmless: float = 0.05


class Moved(NamedTuple):
    """A scene with the motion it was rendered under."""

    scene: Scene
    maker: str
    motion: str
    size: float


def moved_scenes(path: Path, count: int, seed: int) -> Iterator[Moved]:
    """Render `count` moved scenes by each maker; before each product's the unmoved one, which is none."""
    stages = discover()
    for number, (maker, products) in enumerate(MAKERS.items()):
        own = SceneFile.load(path, sets=[f"simulator.use={maker}", products])
        options = own.simulator.options.model_dump()
        simulator = stages.load(stages.find("simulator", maker))
        rng, made = np.random.default_rng([seed, number]), 0
        for body in range(_BODIES):
            for k in range(1 + math.ceil(count / _BODIES)):
                if k and made >= count:
                    break
                name, size, told = "none", 0.0, options
                if k:
                    name, made = str(rng.choice(list(MOTIONS))), made + 1
                    motion = MOTIONS[name]
                    size = float(np.exp(rng.uniform(np.log(motion.low), np.log(motion.high))))
                    told = motion.made(options, size * _sign(rng))
                taken = simulator(simulator.Options.model_validate(told)).simulate(body, seed)
                frames = {frame.role: frame.pixels for frame in taken.frames}
                true_mm3 = taken.truth.products[0].visible_mm3
                scene = Scene(f"{maker}_{body}", frames["laser"], frames.get("plain"), true_mm3)
                yield Moved(scene, maker, name, size)


def _camera(turn: Callable[[float, float], tuple[float, float, float]]) -> Callable[..., dict[str, Any]]:
    """Turn the camera about its own axes by angles (x, y, z) that follow from size and focal length, px."""

    def made(options: Options, size_px: float) -> dict[str, Any]:
        part = options["camera"]
        focal_px = 1e3 * part["focal_length_mm"] / part["pixel_size_um"]
        return _posed(options, turn(size_px / focal_px, size_px / (0.5 * part["width_px"])), 0.0)

    return made


def _nearer(options: Options, size_px: float) -> dict[str, Any]:
    return _posed(options, (0.0, 0.0, 0.0), size_px / (0.5 * options["camera"]["width_px"]))


def _posed(options: Options, angles: tuple[float, float, float], nearer: float) -> dict[str, Any]:
    part = options["camera"]
    known = {name: part[name] for name in CameraPart.model_fields}  # a simulator may know more
    pose = np.array(camera_of(CameraPart.model_validate(known)).T_belt_camera)
    pose[:3, 3] += pose[:3, 2] * nearer * (pose[2, 3] / -pose[2, 2])
    pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.array(angles))[0]
    return {**options, "camera": {**part, "T_belt_camera": pose.tolist()}}


def _mm(options: Options, size_px: float) -> float:
    part = options["camera"]
    return float(size_px * part["distance_mm"] * part["pixel_size_um"] / part["focal_length_mm"] / 1e3)


def _laser_shifted(options: Options, size_px: float) -> dict[str, Any]:
    part, shift = options["laser"], _mm(options, size_px)
    x, y, z = part["projector_mm"]
    lines_x = [x_mm + shift for x_mm in part["belt_x_mm"]]
    return {**options, "laser": {**part, "projector_mm": (x + shift, y, z), "belt_x_mm": lines_x}}


def _laser_turned(options: Options, size_px: float) -> dict[str, Any]:
    turn, part = math.degrees(size_px / (0.5 * options["camera"]["height_px"])), options["laser"]
    return {**options, "laser": {**part, "yaw_deg": part["yaw_deg"] + turn}}


def _plane_moved(options: Options, size_px: float) -> dict[str, Any]:
    part = options["laser"]
    lines_x = list(part["belt_x_mm"])
    lines_x[len(lines_x) // 2] += _mm(options, size_px)
    return {**options, "laser": {**part, "belt_x_mm": lines_x}}


MOTIONS: dict[str, Motion] = {
    "camera panned (rendered)": Motion(_camera(lambda angle, _: (0.0, angle, 0.0))),
    "camera tilted (rendered)": Motion(_camera(lambda angle, _: (angle, 0.0, 0.0))),
    "camera turned (rendered)": Motion(_camera(lambda _, roll: (0.0, 0.0, roll))),
    "camera nearer or farther (rendered)": Motion(_nearer),
    "laser shifted (rendered)": Motion(_laser_shifted),
    "laser turned (rendered)": Motion(_laser_turned),
    "one plane moved (rendered)": Motion(_plane_moved),
}
