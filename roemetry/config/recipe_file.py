"""The shape of a recipe file: which keys there are, before any plugin is asked."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

Channel = Literal["grey", "red", "green", "blue", "max"]
Colour = Literal["red", "green", "blue"]
Contrast = Literal["none", "red", "green", "blue"]
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

    gain_grey_per_electron: float = Field(
        gt=0, description="grey levels for each electron (EMVA 1288: 1/K in the camera's bit depth)"
    )
    read_noise_grey: float = Field(ge=0, description="standard deviation of a dark pixel, grey levels")


class SourceChoice(Section):
    """Where images come from and how they are made ready."""

    use: str = Field(default="image-files", description="name of the source's stage")
    path: str = Field(description="what to read: a file, a folder, or a pattern such as `images/*.png`")
    channel: Channel = Field(default="grey", description="what to make of a colour image")
    second_channel: Colour | None = Field(
        default=None, description="channel of a second family of lines, of another colour; none: there is one"
    )
    contrast: Contrast = Field(
        default="none",
        description="instead of a channel: that of the laser's colour, less the lamp light that others show; "
        "overexposed cores are told from their halos",
    )
    turn_deg: Turn = Field(
        default=0,
        description="counter-clockwise turn, degrees, that makes the stripes run from top to bottom",
    )
    bit_depth: int | None = Field(
        default=None, ge=1, le=16, description="bits in use; none: all that the file's pixels have"
    )
    subtract: Literal["none", "dark"] = Field(
        default="none", description="`dark`: subtract the laser-off partner of each image, cut off at 0"
    )
    sensor: SensorFile | None = Field(
        default=None,
        description="the camera's noise, for extractors that weigh by it; none: what the source knows of it",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="the source's own options")

    @model_validator(mode="after")
    def _is_one_way_to_colours(self) -> SourceChoice:
        check_channels(self.channel, self.second_channel, self.contrast)
        return self


def check_channels(channel: str, second: str | None, contrast: str) -> None:
    """Refuse by a ValueError a second channel beside what is not another colour's."""
    if second is None:
        return
    if contrast != "none":
        raise ValueError("contrast is for light of one colour: leave it or second_channel out")
    if channel in ("grey", "max", second):
        raise ValueError(f"second_channel is {second}: channel must be another colour, not {channel}")


DEFAULT_ALIGNERS = {
    "lines": "belt-lines",
    "grid": "belt-grid",
    "dots": "belt-dots",
    "circles": "belt-circles",
}
"""By the triangulator's pattern."""
DEFAULT_ASSEMBLER = "belt-motion"


_NEEDED_OF_IMAGES: Any = None
"""An extractor is left out only where the source gives slices; it may not be `null`."""


class StageChoices(Section):
    """The chain; a recipe may end after any stage."""

    extractor: Choice = Field(
        default=_NEEDED_OF_IMAGES,
        description="finds peaks in the frame; needed unless the source gives slices that are measured",
    )
    aligner: Choice | None = Field(
        default=None,
        description="compares each frame's belt with the calibration, and corrects small motion. Left out, "
        f"{', '.join(f'`{name}`' for name in DEFAULT_ALIGNERS.values())} does, by the light's pattern, "
        "where the triangulator can follow a motion; `null` leaves it undone",
    )
    coder: Choice | None = Field(default=None, description="says which stripe each peak belongs to")
    smoother: Choice | None = Field(
        default=None, description="smooths stripes along their rows, and says what resolution that costs"
    )
    triangulator: Choice | None = Field(default=None, description="makes profiles, mm, by the calibration")
    assembler: Choice | None = Field(
        default=None,
        description="places the lines of a scan, and tells products from the belt in its slices. Left out, "
        f"`{DEFAULT_ASSEMBLER}` does where the source gives lines or slices",
    )
    outliner: Choice | None = Field(
        default=None, description="finds the products' outlines, in the plain-light or the laser frame"
    )
    volume: Choice | None = Field(
        default=None, description="gives a product's volume and what was seen of it"
    )
    weigher: Choice | None = Field(default=None, description="gives a product's mass")
    classifier: Choice | None = Field(default=None, description="gives a product's grade, and why")
    grader: Choice | None = Field(
        default=None, description="decides by the buyer's table: class, and where the product goes"
    )


class CalibrationCheck(Section):
    """What is asked of a calibration before its numbers are believed."""

    chart: str | None = Field(
        default=None,
        description="control chart that `roemetry check-calibration` keeps; relative to the recipe",
    )
    max_age_days: float | None = Field(
        default=None, gt=0, description="days the last check may lie back; none: any number"
    )
    valid_days: float | None = Field(
        default=None, gt=0, description="days the calibration itself may be old; none: any number"
    )
    refuse: bool = Field(
        default=False,
        description="whether a run refuses to begin where the check is missing, overdue or failed, or the "
        "calibration expired; without it every row says so",
    )


Uncertainty = Literal["none", "linear", "monte-carlo"]
"""How the uncertainty of results is found."""
DRAWS = 200
"""Draws where a recipe asks for the Monte Carlo method alone: they know a standard uncertainty to 5 %."""


class RecipeFile(Section):
    """One recipe."""

    roemetry: Literal[1] = Field(description="version of the recipe format")
    product: str = Field(
        min_length=1, description="what is measured, in words; the title of table and report"
    )
    source: SourceChoice = Field(description="where images come from and how they are made ready")
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
    stages: StageChoices = Field(description="the chain")
    uncertainty: Uncertainty | None = Field(
        default=None,
        description="of volume, weight and grade. linear: from the change that each cause makes (JCGM 100); "
        "monte-carlo: from draws of all causes (JCGM 101); none: what stages state by themselves. Left out: "
        "monte-carlo where there are draws, else none",
    )
    draws: int | None = Field(
        default=None,
        ge=0,
        le=100_000,
        description="Monte Carlo draws; given, they take the place of `uncertainty`, and 0 stands for none",
    )
    stage_timeout_s: float | None = Field(
        default=300,
        gt=0,
        description="how long a stage may take for one acquisition, s, before it counts as hanging and its "
        "result as missing; null: for ever",
    )
    sinks: list[Choice] = Field(
        default_factory=lambda: [StageChoice(use="csv"), StageChoice(use="report")],
        description="what is derived from the record at the end; `[]` for nothing but the record",
    )


NEEDS: dict[str, str] = {
    "aligner": "triangulator",
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
