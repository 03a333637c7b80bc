"""What a calibrator receives: targets and the peaks seen on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from roemetry.records.acquisition import Frame
from roemetry.records.peaks import Peaks


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
    """A flat board with a printed pattern.

    Attributes
    ----------
    kind
        ``charuco``, ``chessboard`` or ``circle-grid``.
    columns, rows
        Squares along the board's x and y; of a grid, circles.
    pitch_mm
        Side of a square, or from circle to circle, mm.
    marker_mm, dictionary, layout
        Of a ChArUco board: its markers' side and OpenCV's name of them, and the layout: ``new`` (OpenCV from
        4.6 on), ``old``, or ``auto`` where it is to be found out.
    tolerance_mm
        Half width of the longer side's tolerance, mm.
    flatness_mm
        Largest distance of the print from a plane, mm.
    thickness_mm
        From the print to what the board lies on, mm.
    """

    name: str
    kind: str
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None = None
    dictionary: str | None = None
    layout: str = "auto"
    tolerance_mm: float = 0.1
    flatness_mm: float = 0.1
    thickness_mm: float = 0.0


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


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """One image of a target, and the peaks the recipe's extractor found in it.

    Attributes
    ----------
    shows
        What is seen: ``belt`` (the empty one), ``block``, ``staircase``, ``pyramid``, ``sphere_plate``,
        ``board`` (held in any pose) or ``board_on_belt`` (the same board lying on the belt).
    frame
        The image; its role says whether the laser was on (``laser``) or off (``plain``).
    peaks
        Of a laser image. Where the same pose was also seen with the laser off, they come from the
        difference of the two. A plain image has none.
    pose
        Of a board: observations with the same `shows` and `pose` show it in the same place.
    """

    shows: str
    frame: Frame
    peaks: Peaks
    pose: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationSet:
    """Everything a calibrator may use.

    Attributes
    ----------
    observations
        The images, prepared alike (channel, turn) and run through one extractor.
    stripe_count
        Number of stripes the rig projects.
    block
        The block in the ``block`` images, or None where none was described.
    working_distance_mm
        Camera (its centre of projection) to belt, mm; None where it is not known.
    extractor
        Name and version of the extractor the peaks come from, with its options.
    board, staircase, pyramid, sphere_plate
        What the images of a board, of a staircase, of a truncated pyramid and of a sphere plate show; None
        where it was not described.
    mm_per_count
        Way of the belt per encoder count and its standard uncertainty, mm, where they are known from
        elsewhere; else None.
    ruler
        A length of the board's print that was measured with a ruler; None where none was.
    """

    observations: tuple[Observation, ...]
    stripe_count: int
    block: Block | None
    working_distance_mm: float | None
    extractor: Mapping[str, object]
    board: Board | None = None
    staircase: Staircase | None = None
    pyramid: Pyramid | None = None
    mm_per_count: tuple[float, float] | None = None
    sphere_plate: SpherePlate | None = None
    ruler: Ruler | None = None

    def showing(self, what: str) -> tuple[Observation, ...]:
        """Give the observations of one kind of target."""
        return tuple(observation for observation in self.observations if observation.shows == what)
