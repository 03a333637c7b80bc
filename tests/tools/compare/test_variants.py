"""Which variants are compared, and how a slip in what is varied is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from comparing_lines import names

from roemetry.errors import ConfigurationError
from roemetry.stages.registry import discover
from roemetry_tools.compare.variants import Variant, make_variants


def test_every_variant_stands_once_and_the_recipe_first(line: Callable[..., Path]) -> None:
    made = make_variants(
        line(1),
        ["stages.extractor.options.threshold=15,60", "extractor=local-maximum,dominant-peak"],
        registry=discover(),
    )
    assert names(made) == ["recipe", "local-maximum", "threshold=15"]
    assert made[0].settings == {"extractor": "dominant-peak", "stages.extractor.options.threshold": "60"}
    local = made[1].recipe
    assert local is not None
    assert local.stages["extractor"].options == local.stages["extractor"].stage.Options()


def test_what_is_said_of_the_product_stays_when_the_method_is_exchanged(line: Callable[..., Path]) -> None:
    """The underside is the product's; the ends are the method's; another method's default may differ."""
    own = (
        "{use: slice-pchip, options: {ends: hold, underside: rounded, true_share: 0.9, true_share_std: 0.02}}"
    )
    path, known = line(1), discover()

    def made(*vary: str) -> tuple[Variant, ...]:
        return make_variants(path, vary, sets=[f"stages.volume={own}"], registry=known)

    _, simpson, zero_order = made("volume=slice-simpson,zero-order-hold")
    _, other, *_ = made("volume=slice-simpson", "stages.volume.options.true_share=0.8")
    assert simpson.name == "slice-simpson"
    assert simpson.recipe is not None
    options = simpson.recipe.stages["volume"].options.model_dump()
    assert options["underside"] == "rounded"
    assert (options["true_share"], options["true_share_std"]) == (0.9, 0.02)
    assert options["ends"] == "taper"
    assert zero_order.fault == ""
    assert other.recipe is not None
    assert other.recipe.stages["volume"].options.model_dump()["true_share"] == 0.8


@pytest.mark.parametrize(
    ("vary", "says"),
    [
        ("extracter=dominant-peak", "did you mean `extractor`?"),
        ("extractor=dominant-peek", "did you mean `dominant-peak`?"),
        ("stages.extractor.options.treshold=1", "did you mean `threshold`?"),
        ("stages.extracter.options.threshold=1", "did you mean `extractor`?"),
        ("stages.extractor.option.threshold=1", "did you mean `options`?"),
        ("source.chanel=red", "did you mean `channel`?"),
        ("source.path=a,b", "cannot be varied"),
        ("extractor", "expected KIND=name,name"),
        ("gaussian", "did you mean `extractor=gaussian`?"),
        ("extractor=", "a value is missing"),
        ("extractor=local-maximum,", "a value is missing"),
        ("stages.extractor=local-maximum", "write `extractor=…`"),
        ("stages.outliner.options.x=1", "the recipe has no outliner"),
    ],
)
def test_a_slip_in_vary_is_named(line: Callable[..., Path], vary: str, says: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make_variants(line(1), [vary], registry=discover())
    assert says in str(caught.value)
    assert str(caught.value).startswith("--vary ")
