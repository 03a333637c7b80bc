"""What all stages have: options, and what they claim of themselves."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Generic, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, model_validator

from roemetry.errors import MisfitError


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
    """What a stage claims of itself with its default options; `roemetry.testing` holds it to that.

    Attributes
    ----------
    tolerance_px
        Largest error of a position on a noise-free image, px: of a peak (extractors), of a rest line
        (calibrators).
    saturated_tolerance_px
        Largest error of a peak where the image is saturated, px.
    height_tolerance_mm
        Largest error of a point, of exact stripes under an exact calibration, mm (triangulators).
    relative_tolerance
        Largest error relative to the true value: of a volume; of px/mm (calibrators).
    relative_numbers
        True for a coder that takes no calibration and counts stripes from the first that is seen: it is
        given none, and numbers that are right but for the same offset are right.
    fixture
        ``package.module:function`` that gives the kit what it cannot make itself. For a triangulator it
        takes a `roemetry.testing.LinearRig` and gives the rig's `Calibration`; for a calibrator it takes the
        rig and gives a `CalibrationSet`; for a source it takes an empty folder, puts two acquisitions there
        and gives the path to read; for any other kind it takes nothing and gives the options to make the
        stage with. Empty: the kit's own.
    """

    tolerance_px: float = 0.1
    saturated_tolerance_px: float = 1.0
    height_tolerance_mm: float = 0.01
    relative_tolerance: float = 0.05
    relative_numbers: bool = False
    fixture: str = ""


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
