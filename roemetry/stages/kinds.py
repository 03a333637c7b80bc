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
    """Largest error of a point, of exact stripes under an exact calibration, mm (triangulators)."""
    relative_tolerance: float = 0.05
    """Largest error relative to the true value: of a volume; of px/mm (calibrators)."""
    pattern: Literal["lines", "dots", "grid", "circles"] = "lines"
    """The light a stage is made for; the stages of a recipe that see the light agree in it."""
    relative_numbers: bool = False
    """True for a coder that takes no calibration and counts stripes from the first that is seen: it is given
    none, and numbers that are right but for the same offset are right."""
    fixture: str = ""
    """``package.module:function`` that gives the kit what it cannot make itself. For a triangulator it takes
    a `roemetry.testing.LinearRig` and gives the rig's `Calibration`; for a calibrator it takes the rig and
    gives a `CalibrationSet`; for a source it takes an empty folder, puts two acquisitions there and gives
    the path to read; for any other kind it takes nothing and gives the options to make the stage with.
    Empty: the kit's own."""


class Stage(ABC, Generic[OptionsT]):
    """What all stages have: options, and what they claim of themselves.

    A subclass names its option model in `Options`; ``MyStage()`` has the defaults. `expected_failures` holds
    the checks of `roemetry.testing` that the method itself cannot keep, each with the reason.
    """

    Options: ClassVar[type[StageOptions]] = StageOptions
    capabilities: ClassVar[Capabilities] = Capabilities()
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __init__(self, options: OptionsT | None = None) -> None:
        self.options: OptionsT = self.Options() if options is None else options  # type: ignore[assignment]


Turn = Literal[0, 90, 180, 270]


class Source(Stage[OptionsT]):
    """Knows where acquisitions are, and reads them."""

    gives: ClassVar[Literal["images", "lines", "slices"]] = "images"
    """What an acquisition holds: images of a scene, lines of a scan, or slices that are measured already."""

    @abstractmethod
    def references(self, path: Path) -> Sequence[AcquisitionReference]:
        """List what there is, in order, without reading images; raise DataError where there is nothing."""

    @abstractmethod
    def read(self, reference: AcquisitionReference) -> Acquisition:
        """Read one acquisition; raise DataError, with the file's name, where that cannot be done."""


class Extractor(Stage[OptionsT]):
    """Finds where stripes cross image rows."""

    @abstractmethod
    def extract(self, frame: Frame) -> Peaks:
        """Find the peaks of a frame of one channel."""

    def rows_apart(self) -> int | None:
        """Give the empty rows that keep frames of one scan apart when it is given several as one tall image.

        None: it takes one frame at a time. 0: each row is measured by itself.
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
            (columns − 1,) those of the latter at which the pixels before and after differ by no more than one
            and a half steps, of all boundaries but the first and the last. None: the core counts, with whole
            arrays in several times the time.
        """
        return None


class Aligner(Stage[OptionsT]):
    """Compares a frame's belt with the calibration, to see whether camera, laser or belt have moved."""

    @abstractmethod
    def align(
        self, peaks: Peaks, calibration: Calibration, moved: Callable[[Calibration, Alignment], Calibration]
    ) -> Alignment:
        """Give the small motion that takes the calibrated rest lines to where this frame shows them.

        Parameters
        ----------
        peaks
            Of the whole frame.
        calibration
            As it was made.
        moved
            Gives the calibration of a camera that has moved: `Triangulator.moved` of the recipe's.

        Raises
        ------
        StageError
            What has moved cannot be corrected; the frame is then refused.
        """


class Coder(Stage[OptionsT]):
    """Says which stripe each peak belongs to, and whether it lies on the belt or on a product."""

    @abstractmethod
    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks; refuse single peaks as ambiguous, or everything by a StageError with the reason."""

    def rows_apart(self) -> int | None:
        """Give the empty rows that keep frames apart, as for an extractor; asked only for a single stripe."""
        return None


class Smoother(Stage[OptionsT]):
    """Smooths each labelled stripe along its rows, and says what resolution that costs."""

    @abstractmethod
    def smooth(self, stripes: StripeMap) -> StripeMap:
        """Give the same stripes with less noise: no label changes, and breaks stay breaks."""


class Calibrator(Stage[OptionsT]):
    """Makes a calibration from images of known things."""

    @abstractmethod
    def calibrate(self, observed: CalibrationSet) -> Calibration:
        """Calibrate, or refuse by a CalibrationError that says why and what to do."""

    def camera(self, observed: CalibrationSet) -> CameraFit:
        """Find camera and lens alone, from the same set without stripes; CalibrationError where it cannot."""
        raise CalibrationError(
            f"{type(self).__name__} does not calibrate a camera alone", hint="pinhole-plane does, from boards"
        )

    def evidence(self, observed: CalibrationSet, calibration: Calibration) -> Evidence:
        """Show what speaks for a calibration that was made from these observations: for its page."""
        return Evidence()

    def findings(self, observed: CalibrationSet) -> tuple[ImageFinding, ...]:
        """Show what was found in each image, and why it is or is not used; also where `calibrate` refuses."""
        none = np.empty((0, 2))
        return tuple(
            ImageFinding(one, True, f"{len(one.peaks)} peaks found", "", none, none)
            for one in observed.observations
        )


class Triangulator(Stage[OptionsT]):
    """Turns labelled stripes into points in millimetres."""

    @abstractmethod
    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give calibrated slices in the belt frame."""

    def view(self, calibration: Calibration) -> View | None:
        """Give the rig's geometry by the calibration's parameters, which a redraw has moved."""
        return calibration.view

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera that has moved: parameters, covariance, rest lines and view.

        Raises
        ------
        StageError
            This triangulator cannot; a recipe with an aligner is then refused.
        """
        raise StageError(
            f"{type(self).__name__} cannot correct a calibration for a camera that has moved",
            hint="leave stages.aligner out; frames are then only refused where the belt lies elsewhere",
        )


class Assembler(Stage[OptionsT]):
    """Makes one set of slices of a scan's lines, and tells products from the belt in slices of any sensor."""

    @abstractmethod
    def place(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any]
    ) -> Profiles:
        """Give the slices of a scan in a frame that moves with the belt, sorted along it.

        Parameters
        ----------
        stripes
            (line · stripe, row): those of each line, one line after the other. Points labelled 0 are belt,
            on which Z = 0 is laid; where there are none, Z stays that of the calibration.
        lines
            Where the belt was.
        calibration
            With the belt's motion.
        triangulator
            Of the recipe, for the stripes of one frame.

        Raises
        ------
        StageError
            The lines cannot be placed: no motion, no counts, or counts that stand still.
        """

    @abstractmethod
    def label(self, profiles: Profiles, own: tuple[int, int] | None = None) -> Profiles:
        """Find belt and products in slices, lay Z = 0 on the belt, and number the products.

        `own` are the first slice and the one after the last in which a product that counts begins; None: any.
        """

    def motion(
        self, stripes: StripeMap, lines: ScanLines, calibration: Calibration, triangulator: Triangulator[Any],
        target: Pyramid | SpherePlate, *, right: bool = True,
    ) -> tuple[Motion, Mapping[str, float]]:  # fmt: skip
        """Measure the belt's motion from a scan of a known body, with figures that say how well it fits.

        `right`: whether the product moves towards larger x in the image while the counter counts up.

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
        """Give one outline for each product that was found.

        Parameters
        ----------
        frame
            The laser image as the extractor saw it.
        plain
            The image in plain light, turned alike, in colour if it was taken so; None where there is none.
        stripes
            The labelled stripes.
        calibration
            None where the recipe has none.
        """


class VolumeEstimator(Stage[OptionsT]):
    """Estimates a product's volume."""

    @property
    def states_model_error(self) -> bool:
        """True if, given `rng`, all of the stage's own model's error is drawn; else no interval is given."""
        return False

    @abstractmethod
    def estimate(self, product: Product, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the volume; given `rng`, draw the estimator's own model error as well."""

    def redraw(self, product: Product, found: Volume, *, rng: np.random.Generator | None = None) -> Volume:
        """Estimate the volume of a product that has moved a little within what it may be wrong by.

        An estimator that takes long may go on from what it has found (`Volume.solution`) and by the budget
        that it has found: they hardly change. Of the result only the values are used, and of values only how
        they differ from that of the product as it was seen, given as `product`.

        Parameters
        ----------
        product
            As it has moved.
        found
            What `estimate` gave of the product as it was seen.
        rng
            As in `estimate`.
        """
        del found
        return self.estimate(product, rng=rng)

    def surface(self, product: Product) -> Surface | None:
        """Give the top surface that `estimate` integrates, for drawings; None where it has none."""
        del product
        return None


class Weigher(Stage[OptionsT]):
    """Turns volume (and what else is known) into mass."""

    @property
    def states_model_error(self) -> bool:
        """True if, given `rng`, all of the stage's own model's error is drawn; else no interval is given."""
        return False

    @abstractmethod
    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Estimate the mass; given `rng`, draw the weigher's own model error as well."""

    @classmethod
    def fit(cls, samples: Samples, *, form: str = "auto") -> Fitted:
        """Learn from weighed products.

        Parameters
        ----------
        samples
            With masses.
        form
            Name of one of the weigher's models; ``auto``: the one that does best on held-out products.

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
        """Give the class with reasons; ``unknown`` is a legal answer."""

    def redraw(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Judge a product that has moved a little within what it may be wrong by.

        Of the result only label, probability and features are used.
        """
        return self.classify(product, rng=rng)

    def relief(self, product: Product) -> Relief | None:
        """Give the surface that is drawn beside a grade; None where this classifier looks at none."""
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
            The class of good products; "" where there is none.
        smoothing_mm
            Window the features were measured with, mm.
        begin
            A model that was learned elsewhere, to be adapted to these samples and judged by them.

        Raises
        ------
        StageError
            This classifier does not learn.
        DataError
            The samples cannot be learned from.
        """
        raise StageError(f"{cls.__name__} does not learn", hint="the classifier `learned` does")


class Grader(Stage[OptionsT]):
    """Decides what is to be done with a product, by all that was found of it."""

    def needs(self) -> frozenset[str]:
        """Name the kinds of stage whose results it asks for; a recipe without one of them is refused."""
        return frozenset()

    @abstractmethod
    def decide(
        self, product: Product, volume: Volume | None, weight: Weight | None, grade: Grade | None
    ) -> Decision:
        """Give the class with reasons; ``undecided`` is a legal answer.

        Parameters
        ----------
        product
            With its outline, where there is one.
        volume, weight, grade
            With their uncertainties; None where a stage was not asked for or could not say.
        """


@dataclass(frozen=True, slots=True)
class Run:
    """A finished (or stopped) run, as sinks receive it."""

    folder: Path
    title: str
    measurements: Callable[[], Iterator[Measurement]]
    """Gives all measurements anew at each call, one at a time."""
    replay: Callable[[str], Trace]
    """Makes an acquisition's whole trace again from its id; raises DataError where the image is gone."""
    provenance: Mapping[str, Any]


class Sink(Stage[OptionsT]):
    """Derives something for people or other programs from a run's record."""

    @property
    def replays_first(self) -> int:
        """How many of a run's first acquisitions `write` replays: their traces are kept for it on disk."""
        return 0

    @abstractmethod
    def write(self, run: Run) -> Sequence[Path]:
        """Write, and give the files written."""


class Simulator(Stage[OptionsT]):
    """Makes images whose answer is known. Its options are the scene file: rig, belt, light, products."""

    @abstractmethod
    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the population's acquisition of this number: a pure function of options, number, seed."""

    @abstractmethod
    def calibration_frames(self, seed: int) -> Mapping[str, Mapping[str, Frame]]:
        """Make calibration images: by kind (``block``, ``belt``, …), by file name without suffix."""

    def turn_deg(self) -> Turn:
        """Give the counter-clockwise turn that rights its images; its truth is of the turned image."""
        return 0

    def sensor(self) -> Sensor | None:
        """Give the noise of the camera it makes images of; None where that is not told."""
        return None

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Give what is true of rig and targets, as plain values for a file; empty where nothing is told."""
        return {}


class Planner(Stage[OptionsT]):
    """Says what a rig will give before it is built. Its options are a simulator's: the scene file."""

    @abstractmethod
    def plan(self, *, simulate: bool) -> Plan:
        """Work the rig out, with short simulations beside it if wanted; raise StageError where that fails."""


class Feed(Stage[OptionsT]):
    """Gives frames as a camera takes them."""

    @abstractmethod
    def open(self) -> AbstractContextManager[Iterator[LiveFrame | None]]:
        """Connect; while the block runs, give the frames in the order in which they were taken.

        The iterator waits for a frame. It gives None where none has come for half a second, so that who asks
        can do something else, and it ends where no frame can come any more (a video's end).

        Raises
        ------
        ConfigurationError
            An option does not suit the camera: it has no such node, or refuses the value.
        DataError
            On entering or from the iterator: there is no camera, or it is gone. It may be opened again.
        """


class Outlet(Stage[OptionsT]):
    """Takes rows of a line to whoever acts on them: a controller, a broker, a database."""

    line: LineControl | None = None
    """The line that it hears from, set before it is opened; None where rows come from elsewhere."""

    @abstractmethod
    def open(self) -> AbstractContextManager[Callable[[Sequence[LineRow]], None]]:
        """Connect; while the block runs, give what delivers rows, in order.

        It returns when the receiver has taken them all. Where it raises, all of them are delivered again, so
        a receiver may see a row twice, by the same key, and never misses one.

        Raises
        ------
        OutputError
            On entering or from what was given: the receiver cannot be reached or refuses a row. It may be
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
    """Give a result on, if it is the record of its kind or the kind is free to give what it likes.

    Else TypeError says what was expected: ``None`` would pass for a step that was not wanted, and a belt
    without a product be reported.
    """
    wanted = _GIVES.get(kind)
    if wanted is not None and not isinstance(result, wanted):
        found = "nothing (None)" if result is None else f"a {type(result).__name__}"
        raise TypeError(f"it gave {found}, expected {wanted.__name__}")
    return result
