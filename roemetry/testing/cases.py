"""One ordinary call, another one, and an empty one for each kind of stage, and the fixtures they need."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roemetry.config.dataset import DatasetWriter, Description, Item
from roemetry.errors import PluginError
from roemetry.records import (
    Acquisition,
    Block,
    CalibrationSet,
    Estimate,
    Frame,
    Grade,
    Observation,
    Peaks,
    StripeMap,
    Weight,
)
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import (
    INTERFACES,
    Aligner,
    Calibrator,
    Coder,
    Extractor,
    Grader,
    Outliner,
    Planner,
    Simulator,
    Sink,
    Source,
    Stage,
    Triangulator,
    Weigher,
)
from roemetry.stages.kinds import check_result_type
from roemetry.testing.patterns import SHIFT, CircleRig, DotRig, belt_under, level
from roemetry.testing.runs import failed, measured, run_of, volume_of
from roemetry.testing.scenes import SEED, GridRig, LinearRig, frame_of
from roemetry.testing.solids import BOX, HALF_ELLIPSOID, product_from, product_of

BLOCK = Block("block", length_mm=100.0, width_mm=30.0, height_mm=8.0, tolerance_mm=0.05)
SUITED = (Calibrator, Source, Triangulator)


def make_stage(cls: type[Stage[Any]], options: Mapping[str, Any] | None = None) -> Stage[Any]:
    """Make a stage with these options, else with those its fixture gives, else with its default ones."""
    if options is not None:
        return cls(cls.Options.model_validate(options))
    fixture = fixture_of(cls)
    return cls() if fixture is None or issubclass(cls, SUITED) else cls(fixture())


def fixture_of(cls: type[Stage[Any]]) -> Callable[..., Any] | None:
    """Import the function that a stage's capabilities name; None where they name none."""
    target = cls.capabilities.fixture
    if not target:
        return None
    module, _, name = target.partition(":")
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise PluginError(f"{cls.__name__}.capabilities.fixture `{target}`: {error}") from error
    return found


def calibration_for(triangulator: Triangulator[Any], rig: LinearRig) -> Calibration:
    """Give the rig's calibration in the form the triangulator understands."""
    fixture = fixture_of(type(triangulator))
    calibration: Calibration = rig.calibration() if fixture is None else fixture(rig)
    return calibration


def calibration_set_for(calibrator: Calibrator[Any], rig: LinearRig) -> CalibrationSet:
    """Give observations of the rig that suit the calibrator: by default an empty belt and a block."""
    fixture = fixture_of(type(calibrator))
    observed: CalibrationSet = block_set(rig) if fixture is None else fixture(rig)
    return observed


def block_set(rig: LinearRig) -> CalibrationSet:
    """Give images of the empty belt and of a block under all stripes, with exact peaks.

    The camera is so far away that the scale does not depend on height.
    """
    y_mm = (rig.middle_row - np.arange(rig.rows)) * rig.mm_per_px
    on_block = np.abs(y_mm) < BLOCK.width_mm / 2.0
    block = np.where(on_block, BLOCK.height_mm, 0.0) * np.ones((rig.stripes, 1))
    observations = tuple(
        Observation(shows, frame_of(rig.light(x_px)), rig.peaks(x_px).peaks)
        for shows, x_px in (("belt", rig.x_px(rig.belt())), ("block", rig.x_px(block)))
    )
    return CalibrationSet(observations, rig.stripes, BLOCK, 1e6, {"use": "exact"})


def readable_path(source: Source[Any], folder: Path) -> Path:
    """Put two acquisitions into a folder and give the path at which the source finds them.

    By default the folder is a data set whose images lie in it, so that it is a folder of images, too.
    """
    fixture = fixture_of(type(source))
    if fixture is not None:
        path: Path = fixture(folder)
        return path
    description = Description(roemetry_dataset=1, name="kit", licence="CC0-1.0")
    with DatasetWriter(folder, description) as kept:
        for number in (1, 2):
            write_image(folder / f"p{number}.png", number)
            kept.add(Item(f"p{number}", {"laser": f"p{number}.png"}))
    return folder


def content_of(acquisition: Acquisition) -> tuple[Acquisition, list[Frame]]:
    """Give an acquisition with the frames of its lines, which are read only when they are asked for."""
    lines = acquisition.lines
    return acquisition, [] if lines is None else [lines.frame(line) for line in range(len(lines.count))]


def write_image(path: Path, number: int) -> None:
    """Write a grey 8-bit PNG of 24 × 32 pixels that is another for each number."""
    import cv2

    pixels = np.random.default_rng(SEED + number).integers(0, 256, (24, 32), np.uint8)
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


@dataclass(frozen=True, slots=True)
class Case:
    """A call of a stage's verb; `is_empty` says whether a result of it holds nothing."""

    inputs: tuple[Any, ...]
    call: Callable[[Any], Any]
    is_empty: Callable[[Any], bool] = lambda _: True


@dataclass(frozen=True, slots=True)
class Cases:
    """An ordinary call, another one with other input, and one with nothing in it (None: there is no such)."""

    ordinary: Case
    other: Case
    empty: Case | None


def cases_for(stage: Stage[Any]) -> Cases:
    """Make the cases for a stage of any kind, anew at each call."""
    kind = next((kind for kind, interface in INTERFACES.items() if isinstance(stage, interface)), "")
    if kind in _CALLS:
        found = _CALLS[kind](stage)
    elif kind in _INPUTS:
        (verb,) = INTERFACES[kind].__abstractmethods__
        make, is_empty = _INPUTS[kind]
        pattern = _PATTERNS.get(stage.capabilities.pattern)
        see_light = ("extractor", "coder", "triangulator", "calibrator")
        three = make(stage) if pattern is None or kind not in see_light else _under(pattern(), kind, stage)
        found = Cases(*(Case(inputs, _calling(verb, inputs), is_empty) for inputs in three))
    else:
        raise PluginError(f"{type(stage).__name__} is of no kind that has checks")
    empty = None if found.empty is None else _typed(found.empty, kind)
    return Cases(_typed(found.ordinary, kind), _typed(found.other, kind), empty)


def _calling(verb: str, inputs: tuple[Any, ...]) -> Callable[[Any], Any]:
    return lambda stage: getattr(stage, verb)(*inputs)


def _typed(case: Case, kind: str) -> Case:
    """Let a call say so if the stage does not give the record of its kind."""
    return replace(case, call=lambda called: check_result_type(kind, case.call(called)))


Three = tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]
"""Inputs of an ordinary call, of another one, and of one with nothing in it."""


def _frames(stage: Extractor[Any]) -> Three:
    rig = LinearRig()
    dome = frame_of(rig.light(rig.x_px(rig.dome())), noise=2.0)
    belt = frame_of(rig.light(rig.x_px(rig.belt())))
    return (dome,), (belt,), (frame_of(np.full((rig.rows, rig.columns), rig.background)),)


def _peaks(stage: Coder[Any]) -> Three:
    def seen(rig: LinearRig, x_px: Any) -> tuple[Any, ...]:
        """Give peaks at (stripe, row) places, px; NaN everywhere is an empty image."""
        calibration = None if stage.capabilities.relative_numbers else rig.calibration()
        return rig.peaks(x_px, scatter_px=0.1).peaks, calibration

    rig = LinearRig()
    mirrored = rig.mirrored()
    nothing = seen(rig, np.full((rig.stripes, rig.rows), np.nan))
    return seen(rig, rig.x_px(rig.dome())), seen(mirrored, mirrored.x_px(mirrored.dome(6.0))), nothing


def _stripes(stage: Stage[Any]) -> Three:
    """Two domes, and stripes of which nothing is seen; a triangulator has its calibration beside them."""
    rig = LinearRig()
    beside = (calibration_for(stage, rig),) if isinstance(stage, Triangulator) else ()
    heights = rig.dome(), rig.dome(4.0), np.full((rig.stripes, rig.rows), np.nan)
    one, other, nothing = ((rig.stripe_map(height_mm), *beside) for height_mm in heights)
    return one, other, nothing


def _moved(stage: Aligner[Any]) -> Three:
    """Light that lies 0.8 px beside where the calibration has it, light that does not, and none."""
    belt = belt_under(stage.capabilities.pattern)
    one, other, nothing = (
        (peaks, belt.calibration, belt.moved) for peaks in (belt.after(SHIFT), belt.at_rest, belt.unseen)
    )
    return one, other, nothing


def _observations(stage: Calibrator[Any]) -> Three:
    one, other = (calibration_set_for(stage, rig) for rig in (LinearRig(), LinearRig().mirrored()))
    return (one,), (other,), (replace(one, observations=()),)


def _images(stage: Outliner[Any]) -> Three:
    rig = LinearRig()
    row, column = np.mgrid[: rig.rows, : rig.columns]
    ellipse = np.hypot((row - rig.middle_row) / 45.0, (column - rig.middle_column) / 100.0) < 1.0

    def seen(height_mm: Any, *, lit: bool = True) -> tuple[Any, ...]:
        """Give an ellipse over (stripe, row) heights, mm; without light there is none."""
        plain = frame_of(np.where(ellipse & lit, 180.0, 40.0))
        laser = frame_of(rig.light(rig.x_px(height_mm)))
        return laser, replace(plain, role="plain"), rig.stripe_map(height_mm), None

    return seen(rig.dome()), seen(rig.dome(5.0)), seen(rig.belt(), lit=False)


def _products(stage: Stage[Any]) -> Three:
    nothing = product_from(np.full((61, 240), np.nan))
    return (product_of(HALF_ELLIPSOID),), (product_of(BOX),), (nothing,)


def _volumes(stage: Weigher[Any]) -> Three:
    product = product_of(HALF_ELLIPSOID)
    return (product, volume_of(9000.0)), (product, volume_of(20000.0)), (product, volume_of(0.0))


def _results(stage: Grader[Any]) -> Three:
    product, volume, grade = product_of(HALF_ELLIPSOID), volume_of(9000.0), Grade("good", 0.99)
    light, heavy = (Weight(Estimate(mass_g, 0.1)) for mass_g in (9.9, 20.0))
    return (product, volume, light, grade), (product, volume, heavy, grade), (product, None, None, None)


def _source(stage: Source[Any]) -> Cases:
    def read_all(source: Source[Any], *, first: int) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = readable_path(source, Path(folder))
            return [content_of(source.read(reference)) for reference in source.references(path)][first:]

    def find_nothing(source: Source[Any]) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            return source.references(Path(folder))

    return Cases(
        Case((), lambda source: read_all(source, first=0)),
        Case((), lambda source: read_all(source, first=1)),
        Case((), find_nothing, lambda found: len(found) == 0),
    )


def _sink(stage: Sink[Any]) -> Cases:
    def case(*rows: Any) -> Case:
        """Give what is written of rows of the record: file by file, its bytes."""

        def call(sink: Sink[Any]) -> dict[str, bytes]:
            with tempfile.TemporaryDirectory() as folder:
                paths = sink.write(run_of(Path(folder), rows))
                return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}

        return Case(rows, call)

    return Cases(case(measured(), failed()), case(measured("p3")), case())


def _simulator(stage: Simulator[Any]) -> Cases:
    one = Case((), lambda simulator: simulator.simulate(0, 1))
    return Cases(one, Case((), lambda simulator: simulator.simulate(1, 1)), None)


def _planner(stage: Planner[Any]) -> Cases:
    case = Case((), lambda planner: planner.plan(simulate=False))
    return Cases(case, case, None)


_CALLS: dict[str, Callable[[Any], Cases]] = {
    "source": _source,
    "sink": _sink,
    "simulator": _simulator,
    "planner": _planner,
}
_INPUTS: dict[str, tuple[Callable[[Any], Three], Callable[[Any], bool]]] = {
    "extractor": (_frames, lambda peaks: len(peaks) == 0),
    "aligner": (_moved, lambda alignment: not alignment.moved),
    "coder": (_peaks, lambda stripes: not np.isfinite(stripes.x_px).any()),
    "smoother": (_stripes, lambda stripes: not np.isfinite(stripes.x_px).any()),
    "calibrator": (_observations, lambda _: False),
    "triangulator": (_stripes, lambda profiles: not np.isfinite(profiles.xyz_mm).any()),
    "outliner": (_images, lambda outlines: len(outlines) == 0),
    "volume": (_products, lambda volume: not volume.visible_mm3.value > 0.0),
    "weigher": (_volumes, lambda weight: not weight.mass_g.value > 0.0),
    "classifier": (_products, lambda grade: grade.label == "unknown"),
    "grader": (_results, lambda decision: decision.label == "undecided"),
}
"""By kind, the inputs of its verb, and whether a result holds nothing."""


class _Pattern(NamedTuple):
    """What stages for other light than lines are shown."""

    rigs: tuple[LinearRig, LinearRig]
    calibration: Calibration
    image: Callable[[Any], Floats]
    peaks: Callable[[Any], Peaks]
    stripes: Callable[[Any], StripeMap]
    """image, peaks, stripes: of a scene on the first rig."""
    scenes: tuple[Any, Any, Any]
    """A product, another one, and one that is not seen."""
    bare: Any


def _dots() -> _Pattern:
    rig = DotRig()
    return _Pattern(
        (rig, DotRig(pitch_mm=2.9)), rig.dot_calibration(), lambda heights: rig.spots(rig.places_px(heights)),
        lambda heights: rig.dots(rig.places_px(heights)), rig.dot_map,
        (rig.hill(), rig.hill(5.0), np.full_like(rig.level(), np.nan)), rig.level(),
    )  # fmt: skip


def _grid() -> _Pattern:
    rig = GridRig()
    upright, across = (np.full_like(height, np.nan) for height in rig.hill())
    return _Pattern(
        (rig, GridRig(spacing_px=38.0)), rig.grid_calibration(), rig.grid_light, rig.grid_peaks, rig.grid_map,
        (rig.hill(), rig.hill(3.0), (upright, across)), rig.hill(0.0),
    )  # fmt: skip


def _circles() -> _Pattern:
    rig = CircleRig()

    def x_px(surface: Any) -> Floats:
        return np.full((rig.stripes, rig.rows), np.nan) if surface is None else rig.x_on_rows(surface)

    return _Pattern(
        (rig, CircleRig(pitch_mm=6.3)), rig.circle_calibration(), rig.circle_light,
        lambda surface: rig.circle_peaks(x_px(surface))[0], lambda surface: rig.circle_map(x_px(surface)),
        (rig.circle_dome(8.0), rig.circle_dome(3.0), None), level,
    )  # fmt: skip


_PATTERNS = {"dots": _dots, "grid": _grid, "circles": _circles}


def _under(pattern: _Pattern, kind: str, stage: Any) -> Three:
    """Give the inputs of a stage of one of the kinds that see the light."""
    rig = pattern.rigs[0]
    if kind == "calibrator":
        one, other = (calibration_set_for(stage, each) for each in pattern.rigs)
        return (one,), (other,), (replace(one, observations=()),)
    if kind == "extractor":
        dark = np.full((rig.rows, rig.columns), rig.background)
        light = pattern.image(pattern.scenes[0]), pattern.image(pattern.bare), dark
        seen, bare, nothing = ((frame_of(each),) for each in light)
        return seen, bare, nothing
    coder = kind == "coder"
    calibration = pattern.calibration if coder else calibration_for(stage, rig)
    show = pattern.peaks if coder else pattern.stripes
    first, second, third = ((show(scene), calibration) for scene in pattern.scenes)
    return first, second, third
