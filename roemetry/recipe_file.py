"""The shape of a recipe file: which keys there are, before any plugin is asked."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

Channel = Literal["grey", "red", "green", "blue", "max"]
Turn = Literal[0, 90, 180, 270]


class Section(BaseModel):
    """A part of a file: unknown keys are faults."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _short_form(value: Any) -> Any:
    """``extractor: dominant-peak`` means ``extractor: {use: dominant-peak}``."""
    return {"use": value} if isinstance(value, str) else value


class StageChoice(Section):
    """A stage by name, with its options."""

    use: str = Field(description="name of the plugin's stage, or provider/name where two claim the name")
    options: dict[str, Any] = Field(default_factory=dict, description="the stage's own options")


Choice = Annotated[StageChoice, BeforeValidator(_short_form)]


class SensorFile(Section):
    """The camera's noise, as EMVA 1288 data sheets state it."""

    gain_grey_per_electron: float = Field(gt=0, description="grey levels for each electron")
    read_noise_grey: float = Field(ge=0, description="standard deviation of a dark pixel, grey levels")


class SourceChoice(Section):
    """Where images come from and how they are made ready."""

    use: str = Field(default="image-files", description="name of the source")
    path: str = Field(description="what to read; relative to the recipe")
    channel: Channel = Field(default="grey", description="what to make of a colour image")
    turn_deg: Turn = Field(
        default=0,
        description="counter-clockwise turn, degrees, that makes the stripes run from top to bottom",
    )
    bit_depth: int | None = Field(
        default=None, ge=1, le=16, description="bits in use; default: all that the file's pixels have"
    )
    subtract: Literal["none", "dark"] = Field(
        default="none", description="`dark`: subtract the laser-off partner of each image"
    )
    sensor: SensorFile | None = Field(
        default=None, description="the camera's noise; default: what the source knows of it"
    )
    options: dict[str, Any] = Field(default_factory=dict, description="the source's own options")


class StageChoices(Section):
    """The chain; a recipe may end after any stage."""

    extractor: Choice
    coder: Choice | None = None
    smoother: Choice | None = None
    triangulator: Choice | None = None
    outliner: Choice | None = None
    volume: Choice | None = None
    weigher: Choice | None = None
    classifier: Choice | None = None
    grader: Choice | None = None


class CalibrationCheck(Section):
    """What is asked of a calibration before its numbers are believed."""

    chart: str | None = Field(
        default=None,
        description="control chart that `roemetry check-calibration` keeps; relative to the recipe",
    )
    max_age_days: float | None = Field(
        default=None, gt=0, description="days the last check may lie back; default: any number"
    )
    valid_days: float | None = Field(
        default=None, gt=0, description="days the calibration itself may be old; default: any number"
    )


class RecipeFile(Section):
    """One recipe."""

    roemetry: Literal[1] = Field(description="version of the recipe format")
    product: str = Field(min_length=1, description="what is measured, in words")
    source: SourceChoice
    calibration: str | None = Field(
        default=None,
        description="calibration file; relative to the recipe. Without one, results are in pixels",
    )
    penetration: str | None = Field(
        default=None,
        description="file of `roemetry fit-penetration` (light enters the product); relative to the recipe",
    )
    calibration_check: CalibrationCheck | None = Field(
        default=None, description="when a doubt about the calibration stands on every measurement"
    )
    stages: StageChoices
    draws: int = Field(
        default=0,
        ge=0,
        le=100_000,
        description="Monte Carlo draws for the uncertainty of volume, weight and grade; 0: none is stated",
    )
    sinks: list[Choice] = Field(default_factory=lambda: [StageChoice(use="csv"), StageChoice(use="report")])


NEEDS: dict[str, str] = {
    "coder": "extractor",
    "smoother": "coder",
    "triangulator": "coder",
    "outliner": "coder",
    "volume": "triangulator",
    "weigher": "volume",
    "classifier": "triangulator",
    "grader": "triangulator",
}
"""By kind, the kind whose result it works on."""
