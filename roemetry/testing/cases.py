"""One ordinary call, another one, and an empty one for each kind of stage, and the fixtures they need."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.config.dataset import DatasetWriter, Description, Item
from roemetry.errors import PluginError
from roemetry.records import Block, CalibrationSet, Estimate, Grade, Observation, Weight
from roemetry.records.calibration import Calibration
from roemetry.stages import (
    INTERFACES,
    Calibrator,
    Classifier,
    Coder,
    Extractor,
    Grader,
    Outliner,
    Planner,
    Simulator,
    Sink,
    Smoother,
    Source,
    Stage,
    Triangulator,
    VolumeEstimator,
    Weigher,
)
from roemetry.stages.kinds import given
from roemetry.testing.runs import failed, measured, run_of, volume_of
from roemetry.testing.scenes import SEED, LinearRig, frame_of
from roemetry.testing.solids import BOX, HALF_ELLIPSOID, product_from, product_of

BLOCK = Block("block", length_mm=100.0, width_mm=30.0, height_mm=8.0, tolerance_mm=0.05)
SUITED = (Calibrator, Source, Triangulator)


def made(cls: type[Stage[Any]], options: Mapping[str, Any] | None = None) -> Stage[Any]:
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


def write_image(path: Path, number: int) -> None:
    """Write a grey 8-bit PNG of 24 × 32 pixels that is another for each number."""
    import cv2

    pixels = np.random.default_rng(SEED + number).integers(0, 256, (24, 32), np.uint8)
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


@dataclass(frozen=True, slots=True)
class Case:
    """A call of a stage's verb."""

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
    for kind, make in _MAKERS.items():
        if isinstance(stage, kind):
            cases = make(stage)
            empty = None if cases.empty is None else _typed(cases.empty, stage)
            return Cases(_typed(cases.ordinary, stage), _typed(cases.other, stage), empty)
    raise PluginError(f"{type(stage).__name__} is of no kind that has checks")


def _typed(case: Case, stage: Stage[Any]) -> Case:
    """Let a call say so if the stage does not give the record of its kind."""
    kind = next(kind for kind, interface in INTERFACES.items() if isinstance(stage, interface))

    return replace(case, call=lambda called: given(kind, case.call(called)))


def _source(stage: Source[Any]) -> Cases:
    def read_all(source: Source[Any], *, first: int) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = readable_path(source, Path(folder))
            return [source.read(reference) for reference in source.references(path)][first:]

    def find_nothing(source: Source[Any]) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            return source.references(Path(folder))

    return Cases(
        Case((), lambda source: read_all(source, first=0)),
        Case((), lambda source: read_all(source, first=1)),
        Case((), find_nothing, lambda found: len(found) == 0),
    )


def _extractor(stage: Extractor[Any]) -> Cases:
    rig = LinearRig()
    frame = frame_of(rig.light(rig.x_px(rig.dome())), noise=2.0)
    other = frame_of(rig.light(rig.x_px(rig.belt())))
    dark = frame_of(np.full((rig.rows, rig.columns), rig.background))
    return Cases(
        Case((frame,), lambda extractor: extractor.extract(frame)),
        Case((other,), lambda extractor: extractor.extract(other)),
        Case((dark,), lambda extractor: extractor.extract(dark), lambda peaks: len(peaks) == 0),
    )


def _coder(stage: Coder[Any]) -> Cases:
    def case(rig: LinearRig, x_px: Any) -> Case:
        """Give the coding of peaks at (stripe, row) places, px; NaN everywhere is an empty image."""
        calibration = None if stage.capabilities.relative_numbers else rig.calibration()
        inputs = rig.peaks(x_px, scatter_px=0.1).peaks, calibration
        return Case(
            inputs, lambda coder: coder.code(*inputs), lambda stripes: not np.isfinite(stripes.x_px).any()
        )

    rig = LinearRig()
    mirrored = rig.mirrored()
    return Cases(
        case(rig, rig.x_px(rig.dome())),
        case(mirrored, mirrored.x_px(mirrored.dome(6.0))),
        case(rig, np.full((rig.stripes, rig.rows), np.nan)),
    )


def _smoother(stage: Smoother[Any]) -> Cases:
    rig = LinearRig()

    def case(height_mm: Any) -> Case:
        """Give the smoothing of stripes over (stripe, row) heights, mm; NaN is not seen."""
        inputs = rig.stripe_map(height_mm)
        return Case(
            (inputs,),
            lambda smoother: smoother.smooth(inputs),
            lambda stripes: not np.isfinite(stripes.x_px).any(),
        )

    return Cases(case(rig.dome()), case(rig.dome(4.0)), case(np.full((rig.stripes, rig.rows), np.nan)))


def _calibrator(stage: Calibrator[Any]) -> Cases:
    def case(rig: LinearRig) -> Case:
        """Give the calibration of a rig from images of the targets that the stage takes."""
        observed = calibration_set_for(stage, rig)
        return Case((observed,), lambda calibrator: calibrator.calibrate(observed))

    nothing = replace(calibration_set_for(stage, LinearRig()), observations=())
    return Cases(
        case(LinearRig()),
        case(LinearRig().mirrored()),
        Case((nothing,), lambda calibrator: calibrator.calibrate(nothing), lambda _: False),
    )


def _triangulator(stage: Triangulator[Any]) -> Cases:
    rig = LinearRig()
    calibration = calibration_for(stage, rig)

    def case(height_mm: Any) -> Case:
        """Give the triangulation of stripes over (stripe, row) heights, mm; NaN is not seen."""
        inputs = rig.stripe_map(height_mm), calibration
        return Case(
            inputs,
            lambda triangulator: triangulator.triangulate(*inputs),
            lambda profiles: not np.isfinite(profiles.xyz_mm).any(),
        )

    return Cases(case(rig.dome()), case(rig.dome(4.0)), case(np.full((rig.stripes, rig.rows), np.nan)))


def _outliner(stage: Outliner[Any]) -> Cases:
    rig = LinearRig()

    def case(height_mm: Any, *, lit: bool = True) -> Case:
        """Give the outlining of an ellipse over (stripe, row) heights, mm; without light there is none."""
        row, column = np.mgrid[: rig.rows, : rig.columns]
        inside = np.hypot((row - rig.middle_row) / 45.0, (column - rig.middle_column) / 100.0) < 1.0
        plain = frame_of(np.where(inside, 180.0, 40.0) if lit else np.full(inside.shape, 40.0))
        laser = frame_of(rig.light(rig.x_px(height_mm)))
        inputs = laser, replace(plain, role="plain"), rig.stripe_map(height_mm), None
        return Case(inputs, lambda outliner: outliner.outline(*inputs), lambda found: len(found) == 0)

    return Cases(case(rig.dome()), case(rig.dome(5.0)), case(rig.belt(), lit=False))


def _volume(stage: VolumeEstimator[Any]) -> Cases:
    def case(product: Any) -> Case:
        """Give the estimate of a product's volume."""
        return Case(
            (product,),
            lambda estimator: estimator.estimate(product),
            lambda volume: not volume.visible_mm3.value > 0.0,
        )

    return Cases(case(product_of(HALF_ELLIPSOID)), case(product_of(BOX)), case(_NOTHING))


def _weigher(stage: Weigher[Any]) -> Cases:
    product = product_of(HALF_ELLIPSOID)

    def case(volume_mm3: float) -> Case:
        """Give the weighing of a volume, mm³."""
        inputs = product, volume_of(volume_mm3)
        return Case(
            inputs, lambda weigher: weigher.weigh(*inputs), lambda weight: not weight.mass_g.value > 0.0
        )

    return Cases(case(9000.0), case(20000.0), case(0.0))


def _classifier(stage: Classifier[Any]) -> Cases:
    def case(product: Any) -> Case:
        """Give the classification of a product."""
        return Case(
            (product,),
            lambda classifier: classifier.classify(product),
            lambda grade: grade.label == "unknown",
        )

    return Cases(case(product_of(HALF_ELLIPSOID)), case(product_of(BOX)), case(_NOTHING))


def _grader(stage: Grader[Any]) -> Cases:
    def case(mass_g: float) -> Case:
        """Give the decision on a product of a mass, g; at 0 nothing is known of it."""
        weight = None if mass_g == 0.0 else Weight(Estimate(mass_g, 0.1))
        grade = None if mass_g == 0.0 else Grade("good", 0.99)
        volume = None if mass_g == 0.0 else volume_of(9000.0)
        inputs = product_of(HALF_ELLIPSOID), volume, weight, grade
        return Case(
            inputs, lambda grader: grader.decide(*inputs), lambda decision: decision.label == "undecided"
        )

    return Cases(case(9.9), case(20.0), case(0.0))


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
    return Cases(
        Case((), lambda simulator: simulator.simulate(0, 1)),
        Case((), lambda simulator: simulator.simulate(1, 1)),
        None,
    )


def _planner(stage: Planner[Any]) -> Cases:
    case = Case((), lambda planner: planner.plan(simulate=False))
    return Cases(case, case, None)


_NOTHING = product_from(np.full((61, 240), np.nan))

_MAKERS: dict[type[Any], Callable[[Any], Cases]] = {
    Source: _source,
    Extractor: _extractor,
    Coder: _coder,
    Smoother: _smoother,
    Calibrator: _calibrator,
    Triangulator: _triangulator,
    Outliner: _outliner,
    VolumeEstimator: _volume,
    Weigher: _weigher,
    Classifier: _classifier,
    Grader: _grader,
    Sink: _sink,
    Simulator: _simulator,
    Planner: _planner,
}
