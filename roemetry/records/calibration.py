"""The calibration: how pixels become millimetres and how sure that is; and how far a rig has moved since."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, DataError
from roemetry.io.files import write_whole
from roemetry.io.yaml_source import dump, read_numbers
from roemetry.records.arrays import Checker, Floats
from roemetry.records.display import Shown
from roemetry.records.light import Rays
from roemetry.records.reasons import Reason
from roemetry.records.scan import Motion
from roemetry.records.view import View

VERSION = 1

ON_BELT, ON_BOARD = "belt", "board"
"""What Z = 0 of a calibration is."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Calibration(Shown):
    """What a calibrator found."""

    method: str
    """Name of the calibrator; the triangulator of the same name understands `parameters`."""
    image_size: tuple[int, int]
    turn_deg: int
    """image_size, turn_deg: rows and columns of the (turned) images it was made from, and their turn."""
    rest_px: Floats
    """(stripe, coefficient) each stripe's rest line: its x on the bare belt, px, as a polynomial in the
    row counted from the image's middle row, lowest power first. Of circles, whose lines `view` has, for
    readers."""
    displacement_px_per_mm: Floats
    """(stripe,) shift of the stripe's peak along +x for each millimetre of height at belt level, px/mm. Its
    sign says on which side the laser stands."""
    height_range_mm: tuple[float, float]
    """Lowest and highest height the calibration is meant for, mm."""
    parameters: Mapping[str, Floats]
    """The method's own parameters by name, units in the names."""
    covariance: Floats
    """(n, n) of the parameters, in the order of `parameters`, each array flattened: what is common to all
    points measured with this calibration."""
    residuals: Mapping[str, float] = field(default_factory=dict)
    """Figures that say how well the model fits what was observed, units in the names."""
    target: Mapping[str, Any] = field(default_factory=dict)
    extractor: Mapping[str, Any] = field(default_factory=dict)
    """target, extractor: what was looked at, and which extractor with which options found the peaks."""
    image_sha256: Mapping[str, str] = field(default_factory=dict)
    made: str = ""
    """Date and time, ISO 8601."""
    notes: tuple[str, ...] = ()
    view: View | None = None
    """Camera and planes of light in the belt frame, as coders and outlines need them whatever the method;
    None where the method gives none."""
    reference: str = ON_BELT
    """What Z = 0 is: ``belt``, on which stripes are seen beside the product, or ``board``, the plane of a
    board in one of its poses where there is no belt."""
    motion: Motion | None = None
    """How the belt runs, where a scan of a known body has told; None where none was taken."""
    rays: Rays | None = None
    """Rays of a matrix of dots, whose columns the stripes then are; None where the light is in planes."""
    across: Calibration | None = None
    """Of a grid: that of the lines across, in the image turned by 90° counter-clockwise, as coders need it.
    It follows from `parameters`, and stays as it is where they move."""

    def __post_init__(self) -> None:
        check = Checker(self)
        stripes = check.array("rest_px", np.float64, (None, None)).shape[0]
        check.array("displacement_px_per_mm", np.float64, (stripes,))
        arrays = {name: np.array(value, np.float64) for name, value in self.parameters.items()}
        for array in arrays.values():
            array.flags.writeable = False
        object.__setattr__(self, "parameters", arrays)
        check.require(self.reference in (ON_BELT, ON_BOARD), f"reference is {self.reference!r}")
        size = sum(array.size for array in arrays.values())
        check.array("covariance", np.float64, (size, size))
        if self.rays is not None:
            fits = self.rays.stripe_count == stripes and self.rays.parameters.size == size
            check.require(fits, "rays are of another number of stripes, or of other parameters")
        if self.motion is not None:
            fits = self.motion.per_parameter.shape[1] in (0, size)
            check.require(fits, f"motion.per_parameter has not as many columns as parameters, {size}")
        check.finish()

    @property
    def stripe_count(self) -> int:
        """Number of stripes."""
        return int(self.rest_px.shape[0])

    @property
    def sha256(self) -> str:
        """Hash of everything in it but the date."""
        content = self.to_dict()
        del content["made"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def rest_line_px(self, row_px: Floats) -> Floats:
        """Rest x of every stripe at the given rows: (stripe, row) px."""
        if self.view is not None and len(self.view.cones):
            return self.view.rest_of_cones_px(row_px)
        from_middle = np.asarray(row_px, np.float64) - (self.image_size[0] - 1) / 2.0
        powers = from_middle[None, :] ** np.arange(self.rest_px.shape[1])[:, None]
        return self.rest_px @ powers

    def redraw(
        self, rng: np.random.Generator, view_of: Callable[[Calibration], View | None] | None = None
    ) -> Calibration:
        """Give a calibration whose parameters are drawn from their joint distribution (JCGM 101, 6.4.8)."""
        return next(self.redraws(rng, view_of))

    def redraws(
        self, rng: np.random.Generator, view_of: Callable[[Calibration], View | None] | None = None
    ) -> Iterator[Calibration]:
        """Give drawn calibrations without end; the covariance is taken apart once for all of them.

        `view_of` gives the view of drawn parameters (`Triangulator.view` of the method's triangulator).
        Without it a drawn calibration has no view, for this one's would belong to other parameters. `rest_px`
        and `displacement_px_per_mm`, by which frames are labelled, stay as they are.
        """
        steps = self.independent_steps()
        while True:
            yield self.shifted(rng.standard_normal(len(steps)) @ steps, view_of)

    def independent_steps(self) -> Floats:
        """Give (step, parameter): independent steps of one standard deviation that make up the covariance."""
        # parameters of different units differ by ten powers of ten: taken apart in their own sizes
        own = np.sqrt(np.diag(self.covariance))
        scale = np.where(own > 0.0, own, 1.0)
        size, turned = np.linalg.eigh(self.covariance / scale[:, None] / scale[None, :])
        return np.asarray((scale[:, None] * turned * np.sqrt(np.maximum(size, 0.0))).T)

    def shifted(
        self, step: Floats, view_of: Callable[[Calibration], View | None] | None = None
    ) -> Calibration:
        """Give the calibration with its parameters, in the order in which they stand, moved by a step.

        Its motion moves along, for it was found with these parameters. `view_of` as in `redraws`.
        """
        parameters, start = {}, 0
        for name, array in self.parameters.items():
            parameters[name] = array + step[start : start + array.size].reshape(array.shape)
            start += array.size
        motion = None if self.motion is None else self.motion.with_parameters(step)
        moved = replace(self, parameters=parameters, view=None, motion=motion)
        return moved if view_of is None else replace(moved, view=view_of(moved))

    @property
    def poor(self) -> str:
        """Why the calibration was refused before it was accepted nevertheless; "" where it was not."""
        return next((note.removeprefix(_POOR) for note in self.notes if note.startswith(_POOR)), "")

    def accepted_as_poor(self, why: str) -> Calibration:
        """Give the calibration marked as refused, for this reason, and used nevertheless."""
        return replace(self, notes=(*self.notes, _POOR + why))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and words, as they stand in the file."""
        return {
            "roemetry_calibration": VERSION,
            "method": self.method,
            "made": self.made,
            "image_size": {"rows": self.image_size[0], "columns": self.image_size[1]},
            "turn_deg": self.turn_deg,
            "stripes": self.stripe_count,
            "height_range_mm": list(self.height_range_mm),
            "rest_px": self.rest_px.tolist(),
            "displacement_px_per_mm": self.displacement_px_per_mm.tolist(),
            "parameters": {name: array.tolist() for name, array in self.parameters.items()},
            "covariance": self.covariance.tolist(),
            "residuals": dict(self.residuals),
            "target": dict(self.target),
            "extractor": dict(self.extractor),
            "image_sha256": dict(self.image_sha256),
            "notes": list(self.notes),
            "view": None if self.view is None else self.view.to_dict(),
            **({} if self.reference == ON_BELT else {"reference": self.reference}),
            **({} if self.motion is None else {"motion": self.motion.to_dict()}),
            **({} if self.rays is None else {"rays": self.rays.to_dict()}),
            **({} if self.across is None else {"across": self.across.to_dict()}),
        }

    def save(self, path: Path | str) -> None:
        """Write the calibration as a YAML file that people can read."""
        write_whole(Path(path), _HEADER + dump(self.to_dict()))

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a calibration file.

        CalibrationError where there is none, or it is none, or numbers in it are missing or not numbers.
        """
        path = Path(path)
        data = read_numbers(path)
        if not isinstance(data, dict) or "roemetry_calibration" not in data:
            raise CalibrationError(
                f"{path}: not a calibration file (no `roemetry_calibration` in it)",
                hint="make one with `roemetry calibrate rig.yaml`",
            )
        if data["roemetry_calibration"] != VERSION:
            raise CalibrationError(
                f"{path}: calibration format {data['roemetry_calibration']}, this program reads {VERSION}",
                hint="calibrate again with `roemetry calibrate`",
            )
        try:
            calibration = cls._from_dict(data)
            json.dumps([data[name] for name in _TOLD], sort_keys=True)  # words as keys
            for name in (*data["parameters"], *data["residuals"]):
                if not isinstance(name, str):
                    raise TypeError(f"{name!r} is a number where a name is expected")
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, DataError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise CalibrationError(
                f"{path}: the calibration is damaged: {what}",
                hint="restore the file or make it again with `roemetry calibrate`",
            ) from error
        decisive = {
            "displacement_px_per_mm": calibration.displacement_px_per_mm,
            **{f"parameters.{name}": array for name, array in calibration.parameters.items()},
            "covariance": calibration.covariance,
        }
        for name, numbers in decisive.items():
            if not np.isfinite(numbers).all():
                raise CalibrationError(f"{path}: {name} holds a number that is not finite")
        if wrong := calibration._no_covariance():
            raise CalibrationError(
                f"{path}: covariance is not positive semi-definite, as that of real quantities is: {wrong}; "
                "no uncertainty follows from it",
                hint="restore the file or make it again with `roemetry calibrate`",
            )
        return calibration

    @classmethod
    def _from_dict(cls, data: Mapping[str, Any]) -> Calibration:
        """Read what `to_dict` wrote; KeyError, TypeError, ValueError or RecordError where it is damaged."""
        size = int(data["image_size"]["rows"]), int(data["image_size"]["columns"])
        return cls(
            method=str(data["method"]),
            image_size=size,
            turn_deg=int(data["turn_deg"]),
            rest_px=np.array(data["rest_px"], np.float64),
            displacement_px_per_mm=np.array(data["displacement_px_per_mm"], np.float64),
            height_range_mm=(float(data["height_range_mm"][0]), float(data["height_range_mm"][1])),
            parameters={n: np.array(v, np.float64) for n, v in data["parameters"].items()},
            covariance=np.array(data["covariance"], np.float64),
            residuals={n: float(v) for n, v in data["residuals"].items()},
            target=data["target"],
            extractor=data["extractor"],
            image_sha256=data["image_sha256"],
            made=str(data["made"]),
            notes=tuple(data["notes"]),
            view=None if data.get("view") is None else View.from_dict(data["view"], size),
            reference=str(data.get("reference", ON_BELT)),
            motion=None if data.get("motion") is None else Motion.from_dict(data["motion"]),
            rays=None if data.get("rays") is None else Rays.from_dict(data["rays"]),
            across=None if data.get("across") is None else cls._from_dict(data["across"]),
        )

    def _no_covariance(self) -> str:
        """Name the parameter that shows that the covariance is none; "" where it is one."""
        names = [f"{name}[{place}]" for name, array in self.parameters.items() for place in range(array.size)]
        variance = np.diag(self.covariance)
        if (variance < 0.0).any():
            worst = int(variance.argmin())
            return f"the variance of {names[worst]} is {variance[worst]:.3g}"
        own = np.sqrt(np.where(variance > 0.0, variance, 1.0))
        scaled = self.covariance / own[:, None] / own[None, :]
        uneven = np.abs(scaled - scaled.T)
        if uneven.max(initial=0.0) > _ROUNDED:
            one, other = np.unravel_index(uneven.argmax(), uneven.shape)
            return f"{names[one]} with {names[other]} is another number than the other way round"
        size, turned = np.linalg.eigh(scaled)
        if size.size == 0 or size[0] > -_ROUNDED:
            return ""
        first, second = np.argsort(-np.abs(turned[:, 0]))[[0, -1 if size.size == 1 else 1]]
        mixed = f"{names[first]}, {names[second]} and others"
        return f"a sum of {mixed} has the variance {size[0]:.3g} of its parts'"


_TOLD = ("residuals", "target", "extractor", "image_sha256")
_POOR = "accepted though refused: "
_ROUNDED = 1e-6
"""Of variances: what is left by rounding when a file is written with fewer digits, and 1e-15 with all."""

_HEADER = """\
# Made by `roemetry calibrate`. rest_px: polynomials in (row − middle row), px, lowest power first.
# covariance: of all parameters in the order in which they stand, each list flattened.
"""


PARAMETERS = ("pan_px", "roll_rad", "zoom", "tilt_rad")
"""Names and units of `Alignment.motion`."""


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Alignment(Shown):
    """A small motion of the camera that takes the calibrated rest lines to where a frame shows them.

    What has really moved (camera, laser or belt) cannot be told from the belt alone, and hardly matters: near
    the belt they do the same to heights. What differs is in the covariance.
    """

    motion: Floats
    """(4,) what the image has done: shifted along +x at its principal point, px; turned about it, from +x to
    +y (clockwise as one looks at it), rad; grown, relative; turned about the camera's x axis (positive
    moves the image up), rad."""
    covariance: Floats
    largest_px: float = 0.0
    largest_std_px: float = 0.0
    """largest_px, largest_std_px: largest distance along x between where the rest lines are and where the
    calibration has them, px, and its standard uncertainty."""
    stripe_px: Floats = field(default_factory=lambda: np.empty(0))
    """(stripe,) what is left of each stripe's mean distance when the motion is taken out, px; NaN for stripes
    of which no belt is seen."""
    planes_px: Floats = field(default_factory=lambda: np.empty(0))
    """(stripe,) what rest lines of single planes have moved beside that, and are corrected by, px; 0: not."""
    planes_std_px: float = 0.0
    """Standard uncertainty of each such correction, px."""
    reasons: tuple[Reason, ...] = ()
    """What is to be said of every product of the frame."""
    edge_px: tuple[float, ...] = ()
    """(4,) what each part of the motion that was found does at the image's edge, px, corrected or not; empty
    where too little belt is seen."""

    def __post_init__(self) -> None:
        check = Checker(self)
        motion = check.array("motion", np.float64, (len(PARAMETERS),))
        check.array("covariance", np.float64, (len(PARAMETERS), len(PARAMETERS)))
        check.array("stripe_px", np.float64, (None,))
        check.array("planes_px", np.float64, (None,))
        check.require(bool(np.isfinite(motion).all()), "the motion is not finite")
        check.finish()

    @property
    def moved(self) -> bool:
        """Whether the calibration is to be corrected for this frame."""
        return bool(self.motion.any() or self.planes_px.any())
