"""The kinds of stage: a small abstract class each, with one verb.

A stage is a pure function of its input, its options and (from the coder on) the calibration. It keeps no
state between calls, changes no input, and may be called from several threads.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, model_validator

from roemetry.errors import CalibrationError, MisfitError, StageError
from roemetry.records import (
    Acquisition,
    AcquisitionReference,
    CalibrationSet,
    CameraFit,
    Decision,
    Evidence,
    Fitted,
    Frame,
    Grade,
    ImageFinding,
    Measurement,
    Motion,
    Outline,
    Peaks,
    Plan,
    Product,
    Profiles,
    Pyramid,
    Relief,
    Samples,
    ScanLines,
    Sensor,
    Simulated,
    SpherePlate,
    StripeMap,
    Surface,
    Trace,
    Volume,
    Weight,
)
from roemetry.records.arrays import Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.live import LineControl, LineRow, LiveFrame
from roemetry.records.view import View


class StageOptions(BaseModel):
    """Options of a stage: a frozen model per implementation; each field with description, unit, bound.

    `about_product` names options that say what the product is, not how the method works. Where `roemetry
    compare` puts another stage in the place of one, those that both have in common stay as they are.
    """

    about_product: ClassVar[frozenset[str]] = frozenset()
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _yes_is_no_number(cls, data: Any) -> Any:
        """Refuse `threshold: true`, which would be read as 1."""
        if isinstance(data, Mapping):
            faults = [
                ((name,), "expected a number")
                for name, field in cls.model_fields.items()
                if isinstance(data.get(name), bool) and _is_number(field.annotation)
            ]
            if faults:
                raise MisfitError(*faults)
        return data


def _is_number(annotation: Any) -> bool:
    """Tell whether a field takes a number, and not yes or no."""
    kinds = get_args(annotation) or (annotation,)
    plain = [get_args(kind)[0] if get_origin(kind) is Annotated else kind for kind in kinds]
    return bool not in plain and (int in plain or float in plain)


OptionsT = TypeVar("OptionsT", bound=StageOptions)


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a stage claims of itself with its default options; `roemetry.testing` holds it to that."""

    tolerance_px: float = 0.1
    """Largest error of a position on a noise-free image, px: of a peak (extractors), of a rest line
    (calibrators)."""
    saturated_tolerance_px: float = 1.0
    """Largest error of a peak where the image is saturated, px."""
    height_tolerance_mm: float = 0.01
    """Largest error of a point, with exact stripes and an exact calibration, mm (triangulators)."""
    relative_tolerance: float = 0.05
    """Largest error relative to the true value: of a volume; of px/mm (calibrators)."""
    pattern: Literal["lines", "dots", "grid", "circles"] = "lines"
    """The light pattern a stage is made for; recipes with stages for different patterns are refused."""
    relative_numbers: bool = False
    """True for a coder that uses no calibration and counts stripes from the first visible one: its numbers
    may have a common offset."""
    fixture: str = ""
    """``package.module:function`` that makes inputs which the conformance tests cannot make. For a
    triangulator it takes a `roemetry.testing.LinearRig` and returns the rig's `Calibration`; for a calibrator
    it takes the rig and returns a `CalibrationSet`; for a source it takes an empty folder, puts two
    acquisitions there and returns the path to read; for any other kind it takes nothing and returns the
    stage's options. Empty: the default inputs."""


class Stage(ABC, Generic[OptionsT]):
    """What all stages have: options, and declarations of what they can do.

    A subclass names its option model in its base, as in ``Extractor[MyOptions]``; it is `Options` then, and
    ``MyStage()`` has the defaults. `expected_failures` names the checks of `roemetry.testing` that the method
    cannot pass, each with the reason.
    """

    Options: ClassVar[type[StageOptions]] = StageOptions
    capabilities: ClassVar[Capabilities] = Capabilities()
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        for model in (one for base in vars(cls).get("__orig_bases__", ()) for one in get_args(base)):
            if "Options" not in vars(cls) and isinstance(model, type) and issubclass(model, StageOptions):
                cls.Options = model

    def __init__(self, options: OptionsT | None = None) -> None:
        self.options: OptionsT = self.Options() if options is None else options  # type: ignore[assignment]


Turn = Literal[0, 90, 180, 270]


class Source(Stage[OptionsT]):
    """Lists acquisitions and reads them."""

    gives: ClassVar[Literal["images", "lines", "slices"]] = "images"
    """What an acquisition contains: images of a scene, lines of a scan, or slices already measured."""

    @abstractmethod
    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List the acquisitions in order, without reading images; raise DataError if there are none."""

    @abstractmethod
    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Read one acquisition; raise DataError, with the file's name, if that fails."""


class Extractor(Stage[OptionsT]):
    """Finds where stripes cross image rows."""

    @abstractmethod
    def extract(self, frame: Frame) -> Peaks:
        """Find the peaks of a frame of one channel."""

    def rows_apart(self) -> int | None:
        """Return how many empty rows must separate frames of a scan that are joined to one tall image.

        None: it takes one frame at a time. 0: each row is measured independently.
        """
        return None

    def count_steps(self, pixels: NDArray[Any], least: int) -> tuple[Integers, Integers, Integers] | None:
        """Count where the grey level changes by more than `least` in one pixel, for the check of joins.

        Parameters
        ----------
        pixels
            (row, column) of one channel.
        least
            Grey levels.

        Returns
        -------
        tuple or None
            (rows − 1,) steps at each boundary between two rows; (columns − 1,) the same between columns; and
            (columns − 1,) how many of the latter have neighbours on both sides that differ by at most one and
            a half steps, without the first and the last boundary. None: the core counts, in several times
            the time.
        """
        return None

    def lines_differ(self, pixels: NDArray[Any]) -> bool:
        """Say for certain that no row and no column is of one level or like another, for the check of lines.

        Parameters
        ----------
        pixels
            (row, column) of one channel, as acquired.

        Returns
        -------
        bool
            False tells nothing: the core looks at the lines itself, which takes longer.
        """
        return False


class Aligner(Stage[OptionsT]):
    """Compares a frame's belt with the calibration, to detect motion of camera, laser or belt."""

    @abstractmethod
    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Return the small motion of the camera that explains where this frame shows the rest lines.

        Parameters
        ----------
        peaks
            Of the whole frame.
        calibration
            As it was made.
        moved
            Returns the calibration of a camera that has moved: `moved` of the recipe's triangulator.

        Raises
        ------
        StageError
            The motion cannot be corrected; the frame is then refused.
        """


class Coder(Stage[OptionsT]):
    """Assigns each peak to a stripe, and to the belt or a product."""

    @abstractmethod
    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks; refuse single peaks as ambiguous, or everything by a StageError with the reason."""

    def rows_apart(self) -> int | None:
        """Return the empty rows between frames, as for an extractor; used only with a single stripe."""
        return None


class Smoother(Stage[OptionsT]):
    """Smooths each labelled stripe along its rows, and states the resolution that remains."""

    @abstractmethod
    def smooth(self, stripes: StripeMap) -> StripeMap:
        """Return the same stripes with less noise. Labels and gaps do not change."""


class Calibrator(Stage[OptionsT]):
    """Makes a calibration from images of known objects."""

    @abstractmethod
    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate, or raise a CalibrationError that says why not and what to do."""

    def camera(self, observed: CalibrationSet) -> CameraFit:
        """Find camera and lens only, from the same set without stripes; raise CalibrationError if unable."""
        raise CalibrationError(
            f"{type(self).__name__} does not calibrate a camera alone", hint="pinhole-plane does, from boards"
        )

    def evidence(self, observed: CalibrationSet, calibration: Calibration) -> Evidence:
        """Return the evidence for a calibration made from these observations, for its page."""
        return Evidence()

    def findings(self, observed: CalibrationSet) -> tuple[ImageFinding, ...]:
        """Return what was found in each image and why it is not used, also if `calibrate` refuses."""
        none = np.empty((0, 2))
        return tuple(
            ImageFinding(one, True, f"{len(one.peaks)} peaks found", "", none, none)
            for one in observed.observations
        )


class Triangulator(Stage[OptionsT]):
    """Turns labelled stripes into points in millimetres."""

    @abstractmethod
    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Return calibrated slices in the belt frame."""

    def view(self, calibration: Calibration) -> View | None:
        """Return the rig's geometry for the calibration's parameters, which a draw may have changed."""
        return calibration.view

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Return the calibration of a camera that has moved: parameters, covariance, rest lines and view.

        Raises
        ------
        StageError
            This triangulator cannot do it; a recipe with an aligner is then refused.
        """
        raise StageError(
            f"{type(self).__name__} cannot correct a calibration for a camera that has moved",
            hint="leave stages.aligner out; frames are then only refused where the belt lies elsewhere",
        )


class Assembler(Stage[OptionsT]):
    """Places a scan's lines as slices, and separates products from the belt in slices of any sensor."""

    @abstractmethod
    def place(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any]
    ) -> Profiles:
        """Return the slices of a scan in a frame that moves with the belt, sorted along it.

        Parameters
        ----------
        stripes
            (line · stripe, row): those of each line, one line after the other. Points labelled 0 are belt and
            define Z = 0; without them, Z is that of the calibration.
        lines
            The lines, with the belt's positions.
        calibration
            With the belt's motion.
        triangulator
            That of the recipe, for the stripes of one frame.

        Raises
        ------
        StageError
            The lines cannot be placed: no motion, no counts, or constant counts.
        """

    @abstractmethod
    def label(self, profiles: Profiles, own: tuple[int, int] | None = None) -> Profiles:
        """Find belt and products in slices, put Z = 0 on the belt, and number the products.

        Only products that begin in the slices of `own` (first, end) count; None: all.
        """

    def motion(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any],
        target: Pyramid | SpherePlate, *, right: bool = True,
    ) -> tuple[Motion, Mapping[str, float]]:  # fmt: skip
        """Measure the belt's motion from a scan of a known body, with figures of how well it fits.

        `right`: whether the product moves towards larger x in the image while the encoder counts up.

        Raises
        ------
        CalibrationError
            With the reason and what to do.
        """
        raise CalibrationError(f"{type(self).__name__} measures no motion", hint="belt-motion does")


class Outliner(Stage[OptionsT]):
    """Finds the products' contours in the image."""

    @abstractmethod
    def outline(
        self, frame: Frame, plain: Frame | None, stripes: StripeMap, calibration: Calibration | None
    ) -> tuple[Outline, ...]:
        """Return an outline for each product.

        Parameters
        ----------
        frame
            The laser image that the extractor was given.
        plain
            The image in plain light, turned equally, in colour if taken in colour; None without one.
        stripes
            The labelled stripes.
        calibration
            None if the recipe has none.
        """


class VolumeEstimator(Stage[OptionsT]):
    """Estimates a product's volume."""

    @property
    def states_model_error(self) -> bool:
        """True if, with `rng`, all of the stage's model error is drawn; otherwise no interval is stated."""
        return False

    @abstractmethod
    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the volume; with `rng`, add a random draw of the estimator's model error."""

    def redraw(self, product: Product, found: Volume, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the volume of a product that was changed a little, within its uncertainty.

        A slow estimator may start from its solution (`Volume.solution`) and budget, which hardly change. Only
        the values of the result are used, as differences from the result for the unchanged product.

        Parameters
        ----------
        product
            The changed product.
        found
            The result of `estimate` for the unchanged product.
        rng
            As in `estimate`.
        """
        del found
        return self.estimate(product, rng=rng)

    def surface(self, product: Product) -> Surface | None:
        """Return the top surface that `estimate` integrates, for plots; None if there is none."""
        del product
        return None


class Weigher(Stage[OptionsT]):
    """Computes the mass from the volume and, if useful, from other features."""

    @property
    def states_model_error(self) -> bool:
        """True if, with `rng`, all of the stage's model error is drawn; otherwise no interval is stated."""
        return False

    @abstractmethod
    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Estimate the mass; with `rng`, add a random draw of the weigher's model error."""

    @classmethod
    def fit(cls, samples: Samples, *, form: str = "auto") -> Fitted:
        """Learn from weighed products.

        Parameters
        ----------
        samples
            With masses.
        form
            Name of one of the weigher's models; ``auto``: the best one on held-out products.

        Raises
        ------
        StageError
            This weigher does not learn, or knows no such model.
        DataError
            The samples cannot be learned from.
        """
        raise StageError(f"{cls.__name__} does not learn", hint="the weigher `fitted` does")


class Classifier(Stage[OptionsT]):
    """Judges a product's shape."""

    @abstractmethod
    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Return the class with reasons; it may be ``unknown``."""

    def redraw(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Classify a product that was changed a little, within its uncertainty.

        Only label, probability and features of the result are used.
        """
        return self.classify(product, rng=rng)

    def relief(self, product: Product) -> Relief | None:
        """Return the surface to draw beside a grade; None if this classifier uses none."""
        del product
        return None

    @classmethod
    def fit(
        cls, samples: Samples, *, good: str = "", smoothing_mm: float = 3.0, begin: Path | None = None
    ) -> Fitted:
        """Learn from labelled products.

        Parameters
        ----------
        samples
            With labels.
        good
            The class of good products; "" if there is none.
        smoothing_mm
            Window the features were measured with, mm.
        begin
            A model learned elsewhere, to be adapted to these samples and tested on them.

        Raises
        ------
        StageError
            This classifier does not learn.
        DataError
            The samples cannot be learned from.
        """
        raise StageError(f"{cls.__name__} does not learn", hint="the classifier `learned` does")


class Grader(Stage[OptionsT]):
    """Decides what to do with a product, from all its results."""

    def needs(self) -> frozenset[str]:
        """Return the kinds of stage whose results it needs; a recipe without one of them is refused."""
        return frozenset()

    @abstractmethod
    def decide(
        self, product: Product, volume: Volume | None, weight: Weight | None, grade: Grade | None
    ) -> Decision:
        """Return the class with reasons; it may be ``undecided``.

        Parameters
        ----------
        product
            With its outline, if there is one.
        volume, weight, grade
            With their uncertainties; None if a stage is not in the recipe or gave no result.
        """


@dataclass(frozen=True, slots=True)
class Run:
    """A finished or stopped run, as sinks receive it."""

    folder: Path
    title: str
    measurements: Callable[[], Iterator[Measurement]]
    """Returns an iterator over all measurements."""
    replay: Callable[[str], Trace]
    """Processes the acquisition with this id again and returns its trace; DataError if the image is gone."""
    provenance: Mapping[str, Any]


class Sink(Stage[OptionsT]):
    """Derives files for people or other programs from a run's record."""

    @property
    def replays_first(self) -> int:
        """How many of a run's first acquisitions `write` replays; their traces are kept on disk."""
        return 0

    @abstractmethod
    def write(self, run: Run) -> Sequence[Path]:
        """Write the files and return their paths."""


class Simulator(Stage[OptionsT]):
    """Makes images with known truth. Its options are the scene file: rig, belt, light, products."""

    @abstractmethod
    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the acquisition of this number, as a pure function of options, number and seed."""

    @abstractmethod
    def calibration_frames(self, seed: int) -> Mapping[str, Mapping[str, Frame]]:
        """Make calibration images, by kind (``block``, ``belt``, …) and file name without suffix."""

    def turn_deg(self) -> Turn:
        """Return the counter-clockwise turn that recipes must apply; truth refers to the turned image."""
        return 0

    def sensor(self) -> Sensor | None:
        """Return the noise of the simulated camera; None if it is not stated."""
        return None

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Return the truth of rig and targets, as plain values for a file; empty if there is none."""
        return {}


class Planner(Stage[OptionsT]):
    """Predicts how well a rig will measure before it is built. Its options are those of a simulator."""

    @abstractmethod
    def plan(self, *, simulate: bool) -> Plan:
        """Compute the plan, with short simulations if requested; raise StageError if that fails."""


class Feed(Stage[OptionsT]):
    """Delivers frames as a camera takes them."""

    @abstractmethod
    def open(self) -> AbstractContextManager[Iterator[LiveFrame | None]]:
        """Connect; within the block, yield the frames in the order in which they were taken.

        The iterator waits for a frame. It yields None if none has come for half a second, so that the caller
        can do something else, and ends if no frame can come any more (at a video's end).

        Raises
        ------
        ConfigurationError
            An option does not suit the camera: it has no such node, or refuses the value.
        DataError
            On entering or from the iterator: there is no camera, or its connection is lost. It may be opened
            again.
        """


class Outlet(Stage[OptionsT]):
    """Delivers rows of a line to a receiver: a controller, a broker, a database."""

    line: LineControl | None = None
    """The line the rows come from, set before it is opened; None if they come from elsewhere."""

    @abstractmethod
    def open(self) -> AbstractContextManager[Callable[[Sequence[LineRow]], None]]:
        """Connect; within the block, provide a function that delivers rows, in order.

        It returns when the receiver has taken them all. If it raises, all of them are delivered again, so
        a receiver may see a row twice, with the same key, but never misses one.

        Raises
        ------
        OutputError
            On entering or from the function: the receiver cannot be reached or refuses a row. It may be
            opened again.
        """


INTERFACES: Mapping[str, type[Stage[Any]]] = {
    "source": Source,
    "extractor": Extractor,
    "aligner": Aligner,
    "coder": Coder,
    "smoother": Smoother,
    "calibrator": Calibrator,
    "triangulator": Triangulator,
    "assembler": Assembler,
    "outliner": Outliner,
    "volume": VolumeEstimator,
    "weigher": Weigher,
    "classifier": Classifier,
    "grader": Grader,
    "sink": Sink,
    "simulator": Simulator,
    "planner": Planner,
    "feed": Feed,
    "outlet": Outlet,
}

T = TypeVar("T")
_GIVES: Mapping[str, type] = {
    "extractor": Peaks,
    "aligner": Alignment,
    "coder": StripeMap,
    "smoother": StripeMap,
    "outliner": tuple,
    "calibrator": Calibration,
    "camera": CameraFit,
    "triangulator": Profiles,
    "assembler": Profiles,
    "volume": Volume,
    "weigher": Weight,
    "classifier": Grade,
    "grader": Decision,
}


def check_result_type(kind: str, result: T) -> T:
    """Return a result, if it is the record of its kind or the kind may return anything.

    Otherwise raise a TypeError that says what was expected: ``None`` would pass for a stage that is not in
    the recipe, and a belt without a product would be reported.
    """
    wanted = _GIVES.get(kind)
    if wanted is not None and not isinstance(result, wanted):
        found = "nothing (None)" if result is None else f"a {type(result).__name__}"
        raise TypeError(f"it gave {found}, expected {wanted.__name__}")
    return result
