"""The pattern file: which lines, dots or circles of light there are; one file for rig and scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from roemetry.config.recipe_file import Section, StageChoice
from roemetry.config.target_file import described
from roemetry.errors import ConfigurationError


class PatternFile(Section):
    """The light's pattern on the belt."""

    kind: Literal["lines", "grid", "cross-hair", "dots", "circles"] = Field(
        description="what the projector throws"
    )
    lines_x: int = Field(
        default=1, ge=1, le=200,
        description="lines one beside the other along X: stripes; of dots: columns; of circles: how many",
    )  # fmt: skip
    lines_y: int | None = Field(
        default=None, ge=1, le=200, description="lines one below the other along Y; of dots: in a column"
    )
    colours: Literal[1, 2] = Field(default=1, description="2: lines are of two colours in turn, red first")
    spacing_x_mm: float | None = Field(
        default=None, gt=0, le=1000, description="between neighbours along X on the belt, mm; scenes need it"
    )
    spacing_y_mm: float | None = Field(
        default=None, gt=0, le=1000, description="the same along Y, mm; default: as along X"
    )

    @model_validator(mode="after")
    def _is_whole(self) -> PatternFile:
        if self.kind == "cross-hair" and (self.lines_x, self.lines_y) not in ((1, None), (1, 1)):
            raise ValueError("a cross hair is one line along each side")
        if self.kind in ("lines", "circles") and (self.lines_y or self.spacing_y_mm):
            raise ValueError(
                f"{self.kind} follow each other along X alone: lines_y and spacing_y_mm are for others"
            )
        if self.kind != "lines" and self.colours == 2:
            raise ValueError("two colours are for lines")
        if self.kind in ("grid", "dots") and self.lines_y is None:
            raise ValueError(f"{self.kind} need lines_y, too")
        return self

    @property
    def light(self) -> Literal["lines", "grid", "dots", "circles"]:
        """What stages call it: a cross hair is a grid of one line and one."""
        return "grid" if self.kind == "cross-hair" else self.kind

    @property
    def stripes(self) -> int:
        """How many stripes there are: each circle is two, its left and its right half."""
        return 2 * self.lines_x if self.kind == "circles" else self.lines_x

    @property
    def across(self) -> int | None:
        """Lines along Y, or dots in a column; None of lines alone."""
        return 1 if self.kind == "cross-hair" else self.lines_y

    def calibrated_by(self, calibrator: StageChoice) -> StageChoice:
        """Give the calibrator with the number of lines across; ConfigurationError where it says another."""
        if self.across is None:
            return calibrator
        told = calibrator.options.get("lines", self.across)
        if told != self.across:
            raise ConfigurationError(f"the pattern has {self.across} lines along Y, `lines` says {told}")
        return StageChoice(use=calibrator.use, options={**calibrator.options, "lines": self.across})

    def drawn_by(self, simulator: StageChoice) -> StageChoice:
        """Give the simulator with the pattern among its laser's options.

        ConfigurationError where these say another, or the spacing is missing.
        """
        if self.spacing_x_mm is None and self.lines_x > 1:
            raise ConfigurationError("a scene needs spacing_x_mm of its pattern")
        wanted: dict[str, Any] = {"planes": self.lines_x} | ({"colours": 2} if self.colours == 2 else {})
        if self.spacing_x_mm is not None:
            wanted["spacing_mm"] = self.spacing_x_mm
        if self.kind == "circles":
            spacing = {"spacing_mm": self.spacing_x_mm} if self.spacing_x_mm else {}
            wanted = {"circles": {"count": self.lines_x} | spacing}
        elif self.light != "lines":
            apart = self.spacing_y_mm or self.spacing_x_mm
            wanted[self.light] = {"lines": self.across} | ({"spacing_mm": apart} if apart else {})
        laser = dict(simulator.options.get("laser") or {})
        for key in ("planes", "spacing_mm", "grid", "dots", "circles", "colours", "belt_x_mm"):
            if laser.get(key) not in (None, wanted.get(key)):
                raise ConfigurationError(
                    f"the pattern says {key}: {wanted.get(key)}, and laser.{key} {laser[key]}",
                    hint="leave it to the pattern",
                )
        return StageChoice(use=simulator.use, options={**simulator.options, "laser": {**laser, **wanted}})


def read_pattern(given: str | PatternFile, folder: Path) -> PatternFile:
    """Give the pattern; ConfigurationError with every fault of its file, each with its place."""
    pattern = described(given, folder, PatternFile)
    assert pattern is not None
    return pattern
