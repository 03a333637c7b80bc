"""A form's fields say what the options' models say, for every installed stage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field

from roemetry.stages.registry import discover
from roemetry_tools.tune.form import as_plain, fields_of
from roemetry_tools.tune.request import KINDS

REGISTRY = discover()
STAGES = [stage for stage in REGISTRY.stages if stage.entry.kind in KINDS]


class Options(BaseModel):
    number_px: float = Field(default=2.0, gt=0.0, le=9.0, description="a number")
    count: int = Field(default=3, ge=1, description="a count")
    either: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(default="auto")
    maybe: float | None = Field(default=None, ge=0.0, lt=1.0)
    word: Literal["one", "two"] = "one"
    single: Literal["only"] = "only"
    yes: bool = False
    text: str = "as it is"
    file: Path | None = None
    region: tuple[int, int] | None = None
    several: float | str = 1.0
    needed: float


def test_each_kind_of_option_becomes_its_kind_of_field() -> None:
    fields = {field.name: field for field in fields_of(Options)}
    assert {name: field.kind for name, field in fields.items()} == {
        "number_px": "number",
        "count": "integer",
        "either": "number",
        "maybe": "number",
        "word": "choice",
        "single": "choice",
        "yes": "switch",
        "text": "text",
        "file": "file",
        "region": "yaml",
        "several": "yaml",
        "needed": "number",
    }
    number = fields["number_px"]
    assert (number.low, number.low_open, number.high, number.high_open) == (0.0, True, 9.0, False)
    assert (number.unit, number.default, number.description) == ("px", 2.0, "a number")
    assert (fields["count"].low, fields["count"].high) == (1.0, None)
    assert (fields["either"].words, fields["either"].high) == (("auto",), 255.0)
    assert (fields["maybe"].words, fields["maybe"].high_open) == ((None,), True)
    assert fields["word"].choices == ("one", "two")
    assert fields["single"].choices == ("only",)
    assert fields["file"].words == (None,)
    assert [name for name, field in fields.items() if field.required] == ["needed"]
    assert "text" not in {field.name for field in fields_of(Options, ("text",))}


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: f"{stage.entry.kind}-{stage.entry.name}")
def test_every_option_of_every_stage_has_a_field_that_explains_itself(stage: object) -> None:
    options = REGISTRY.load(stage).Options  # type: ignore[arg-type]
    fields = as_plain(fields_of(options))
    assert [field["name"] for field in fields] == list(options.model_fields)
    for field in fields:
        assert len(field["description"]) > 10
        if field["low"] is not None and field["high"] is not None:
            assert field["low"] < field["high"]
