"""What a calibrator receives and shows: targets, the peaks on them, residuals; and what is learned from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from roemetry.records.acquisition import Frame
from roemetry.records.arrays import Checker, Flags, Floats, Integers
from roemetry.records.display import Shown
from roemetry.records.stripes import Peaks


@dataclass(frozen=True, slots=True)
class Block:
    """A square block: three sides as they lie on the belt, mm, with the tolerance (half width) of each.

    `length_mm` lies along X (across the stripes), `width_mm` along Y (along the stripes), `height_mm` up.
    """

    name: str
    length_mm: float
    width_mm: float
    height_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board with a printed pattern."""

    name: str
    kind: str
    """``charuco``, ``chessboard`` or ``circle-grid``."""
    columns: int
    rows: int
    """columns, rows: squares along the board's x and y; of a grid, circles."""
    pitch_mm: float
    """Side of a square, or from circle to circle, mm."""
    marker_mm: float | None = None
    dictionary: str | None = None
    layout: str = "auto"
    """marker_mm, dictionary, layout: of a ChArUco board: its markers' side and OpenCV's name of them, and the
    layout: ``new`` (OpenCV from 4.6 on), ``old``, or ``auto`` where it is to be found out."""
    tolerance_mm: float = 0.1
    """Half width of the longer side's tolerance, mm."""
    flatness_mm: float = 0.1
    """Largest distance of the print from a plane, mm."""
    thickness_mm: float = 0.0
    """From the print to what the board lies on, mm."""
    margin_mm: float = 0.0
    """How far the sheet, flat and of one colour, goes on beyond the pattern on all sides, mm."""
    row_pitch_mm: float | None = None
    """`pitch_mm` along the board's y, mm, of a print that is stretched; None where both are the same."""

    @property
    def size_mm(self) -> Floats:
        """(2,) the pattern's sides along x and y, mm."""
        return np.array([self.columns * self.pitch_mm, self.rows * (self.row_pitch_mm or self.pitch_mm)])


@dataclass(frozen=True, slots=True)
class Staircase:
    """Level steps, one behind the other along the stripes: heights over the belt and their tolerance, mm."""

    name: str
    heights_mm: tuple[float, ...]
    tread_mm: float
    width_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class Pyramid:
    """A square pyramid without its top: sides of base and top, height, and each one's tolerance, mm."""

    name: str
    base_mm: float
    top_mm: float
    height_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class SpherePlate:
    """Equal balls in a square grid: columns along X (across the stripes), rows along Y; lengths in mm.

    `centre_height_mm` is that of the balls' centres over the belt; `tolerance_mm` the half width of each
    length's tolerance.
    """

    name: str
    columns: int
    rows: int
    pitch_mm: float
    diameter_mm: float
    centre_height_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class Ruler:
    """A length of the board's print, as it should be and as a ruler measures it, with that one's std, mm."""

    printed_mm: float
    measured_mm: float
    std_mm: float


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Observation(Shown):
    """One image of a target, and the peaks the recipe's extractor found in it."""

    shows: str
    """What is seen: ``belt`` (the empty one), ``block``, ``staircase``, ``pyramid``, ``sphere_plate``,
    ``board`` (held in any pose) or ``board_on_belt`` (the same board lying on the belt)."""
    frame: Frame
    """The image; its role says whether the laser was on (``laser``) or off (``plain``)."""
    peaks: Peaks
    """Of a laser image. Where the same pose was also seen with the laser off, they come from the difference
    of the two. A plain image has none."""
    pose: str = ""
    """Of a board: observations with the same `shows` and `pose` show it in the same place."""
    board: int = 0
    """Which board, by its number among the set's."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class CalibrationSet(Shown):
    """Everything a calibrator may use."""

    observations: tuple[Observation, ...]
    """The images, prepared alike (channel, turn) and run through one extractor."""
    stripe_count: int
    block: Block | None
    """The block in the ``block`` images, or None where none was described."""
    working_distance_mm: float | None
    """Camera (its centre of projection) to belt, mm; None where it is not known."""
    extractor: Mapping[str, object]
    """Name and version of the extractor the peaks come from, with its options."""
    board: Board | None = None
    staircase: Staircase | None = None
    pyramid: Pyramid | None = None
    mm_per_count: tuple[float, float] | None = None
    """Way of the belt per encoder count and its standard uncertainty, mm, where they are known from
    elsewhere; else None."""
    sphere_plate: SpherePlate | None = None
    """board, staircase, pyramid, sphere_plate: what the images of a board, of a staircase, of a truncated
    pyramid and of a sphere plate show; None where it was not described."""
    ruler: Ruler | None = None
    """A length of the board's print that was measured with a ruler; None where none was."""
    more_boards: tuple[Board, ...] = ()
    """Boards beside `board`: each checks the other's scale."""

    @property
    def boards(self) -> tuple[Board, ...]:
        """All boards; lengths come from the first."""
        return (() if self.board is None else (self.board,)) + self.more_boards

    def showing(self, what: str) -> tuple[Observation, ...]:
        """Give the observations of one kind of target."""
        return tuple(observation for observation in self.observations if observation.shows == what)


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class ImageFinding(Shown):
    """What a calibrator found in one image, and what it made of it."""

    observation: Observation
    """The image, with all peaks that were found in it."""
    used: bool
    said: str
    """What was found, and how well it fits; "" where nothing was."""
    why: str
    """Why it is not used, or not wholly, and what to do; "" where it is."""
    corners_px: Floats
    """(mark, 2) marks of a board."""
    points_px: Floats
    """(point, 2) points of stripes that count; means over a few rows where there are many."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class CameraFit(Shown):
    """A camera and its lens alone, from a board in many poses."""

    image_size: tuple[int, int]
    """Rows and columns."""
    focal_px: Floats
    principal_px: Floats
    """focal_px, principal_px: (2,) fx, fy and cx, cy."""
    distortion: Floats
    """(8,) k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's model."""
    std: Floats
    """(12,) standard uncertainties of all of these in this order; 0 of what was not looked for."""
    rms_px: float
    """Distance of seen and predicted marks, px."""
    images: int
    """In how many images the board was used."""
    left_out: Mapping[str, str]
    """By image, why the board in it was not."""


@dataclass(frozen=True, slots=True)
class EvidenceFigure:
    """One number that speaks for or against a calibration."""

    title: str
    value: float
    unit: str
    """``mm``, ``px``, ``1`` for a pure number, …"""
    basis: str
    limit: float = math.nan
    """value, limit: what was found, and what it may be at most; NaN where there is no limit."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Residuals(Shown):
    """Differences between what was observed and what the model says, each at its place in the image."""

    title: str
    unit: str
    xy_px: Floats
    """(n, 2) where in the (turned) image, px."""
    error: Floats
    group: Integers
    """(n,) number of the view or stripe it belongs to."""
    basis: str
    """What was observed, and what is drawn."""
    held_out: bool = False
    """True where these observations were held out of the fit."""

    def __post_init__(self) -> None:
        check = Checker(self)
        count = check.array("xy_px", np.float64, (None, 2)).shape[0]
        check.array("error", np.float64, (count,))
        check.array("group", np.int64, (count,))
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class TargetView(Shown):
    """One image of a target, with what was found in it and where the target stood."""

    name: str
    frame: Frame
    peaks_px: Floats
    """(peak, 2) x and row of stripe peaks in the (turned) image, px."""
    stripe: Integers
    """(peak,) stripe of each; −1 where that is not known."""
    corners_px: Floats = field(default_factory=lambda: np.empty((0, 2)))
    """(corner, 2) board corners, px."""
    used: Flags = field(default_factory=lambda: np.empty(0, np.bool_))
    """(corner,) False for those left out as far off."""
    border_mm: Floats = field(default_factory=lambda: np.empty((0, 3)))
    """(4, 3) corners of the board, belt frame, mm; (0, 3) where there is no board."""

    def __post_init__(self) -> None:
        check = Checker(self)
        peaks = check.array("peaks_px", np.float64, (None, 2)).shape[0]
        check.array("stripe", np.int64, (peaks,))
        corners = check.array("corners_px", np.float64, (None, 2)).shape[0]
        check.array("used", np.bool_, (corners,))
        check.array("border_mm", np.float64, (None, 3))
        check.finish()


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Evidence(Shown):
    """All that a calibrator can show."""

    verdict: tuple[str, ...] = ()
    """In a few sentences: whether, and for what, the calibration may be used."""
    figures: tuple[EvidenceFigure, ...] = ()
    residuals: tuple[Residuals, ...] = ()
    """figures, residuals: what the verdict rests on."""
    usable: bool = True
    """Whether anything may be measured with it at all."""
    views: tuple[TargetView, ...] = ()
    """The images, with the corners and stripes that were used of each."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Samples(Shown):
    """Products of known class or mass, with their measured features."""

    ids: tuple[str, ...]
    groups: tuple[str, ...]
    """(sample,) what belongs together: samples of one group are never on both sides of a fold."""
    features: tuple[str, ...]
    values: Floats
    """(sample, feature) measured; NaN where a feature is missing."""
    labels: tuple[str, ...] = ()
    """(sample,) true classes; empty where masses are learned."""
    mass_g: Floats = field(default_factory=lambda: np.empty(0))
    mass_std_g: Floats = field(default_factory=lambda: np.empty(0))
    """mass_g, mass_std_g: (sample,) true masses, grams, and the scale's standard uncertainty; empty where
    classes are."""

    def __post_init__(self) -> None:
        check = Checker(self)
        count = len(self.ids)
        check.array("values", np.float64, (count, len(self.features)))
        check.require(len(self.groups) == count, "groups and ids differ in number")
        check.require(len(self.labels) in (0, count), "labels and ids differ in number")
        for name in ("mass_g", "mass_std_g"):
            array = check.array(name, np.float64, (None,))
            check.require(array.size in (0, count), f"{name} and ids differ in number")
        check.finish()


@dataclass(frozen=True, slots=True)
class Fitted:
    """What a stage has learned."""

    content: str
    """Text of the file that the stage's options name."""
    figures: Mapping[str, float]
    """How well it did on folds it had not seen, units in the names."""
    words: tuple[str, ...] = ()
    """What the user must know, in sentences."""
