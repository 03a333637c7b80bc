"""Figures of `compare` from end to end, on drawn stripes whose truth is made to give known ones."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibrating.known_products import read_labels
from roemetry.config.dataset import Item
from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Acquisition, Frame
from roemetry.stages.registry import discover
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data, as_taken, labelled
from roemetry_tools.compare.tables import flat
from roemetry_tools.compare.variants import make_variants
from roemetry_tools.compare.write import ItemsFile, write_comparison
from tests.tools.compare.conftest import COUNT, Counting


def variants_of(path: Path, *vary: str, sets=()):
    return make_variants(path, vary, sets=sets, registry=discover())


def test_figures_are_those_the_truth_was_made_for(dataset, compared) -> None:
    one, other = compared(dataset(), "extractor=shifted")
    row = flat(one)
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)
    assert row["volume_visible_mean_absolute_pct"] == pytest.approx(100 / 11, abs=1e-9)
    assert row["weight_bias_pct"] == pytest.approx(25.0, abs=1e-9)
    assert row["volume_visible_n"] == row["weight_n"] == row["classes_n"] == COUNT
    assert row["volume_true_n"] is None
    assert one.figures.absent == {"true_mm3": "the data set knows the true volume of no product"}
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert row["centre_missed_pct"] == pytest.approx(100 * 14 / (7 * 240))  # the first and the last row
    assert row["centre_false_pct"] == 0.0
    assert abs(row["centre_bias_px"]) < 0.05
    assert row["time_frame_median_ms"] is not None
    for figure in ("centre_bias_px", "centre_on_product_bias_px"):
        assert flat(other)[figure] - row[figure] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("turn_deg", [180, 90])
def test_turned_images_are_judged_alike(dataset, compared, turn_deg: int) -> None:
    row = flat(compared(dataset(turn_deg=turn_deg), sets=(f"source.turn_deg={turn_deg}",))[0])
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert abs(row["centre_bias_px"]) < 0.05
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)


def test_shared_steps_are_done_once_and_other_options_are_not_shared(dataset, compared) -> None:
    path, counting = dataset(), "stages.extractor.use=counting"
    Counting.asked = 0
    found = compared(
        path,
        "stages.weigher.options.density_g_per_cm3=1.0,1.2,1.4",
        "classifier=arc-curvature",
        sets=(counting, "stages.extractor.options.threshold=60"),
    )
    assert Counting.asked == COUNT
    assert len({round(flat(one)["weight_bias_pct"], 6) for one in found}) == len(found) == 4
    times = [one.figures.seconds["extractor"] for one in found]
    assert len({(time.n, time.median) for time in times}) == 1
    Counting.asked = 0
    found = compared(path, "stages.extractor.options.threshold=30,90", sets=(counting,))
    assert Counting.asked == 3 * COUNT
    assert [one.variant.name for one in found] == ["recipe", "threshold=30", "threshold=90"]


def test_a_failing_variant_is_a_row_and_not_the_end(dataset, compared) -> None:
    vary = ("volume=zero-order-hold,raising,costly", "stages.extractor.options.threshold=60,-5")
    found = {one.variant.name: one for one in compared(dataset(), *vary)}
    for name, says in {
        "recipe": "",
        "raising, threshold=60": "ZeroDivisionError: nothing to share",
        "costly, threshold=60": "needs the module no_such_module; install it with `pip install it`",
        "threshold=-5": "--vary stages.extractor.options.threshold=-5: ",
    }.items():
        assert says in found[name].failure
        assert bool(found[name].failure) == bool(says)
    assert "expected greater than or equal to 0" in found["threshold=-5"].failure
    raising = found["raising, threshold=60"].figures
    assert raising.refused == COUNT
    assert raising.coding is not None
    assert raising.absent["visible_mm3"] == "nothing was given by the volume"


def test_a_changed_image_is_refused(dataset, compared) -> None:
    path = dataset()
    cv2.imwrite(str(path.parent / "images" / "p02.png"), np.zeros((240, 320), np.uint8))
    (one,) = compared(path)
    assert one.figures.refused == 1
    assert one.figures.causes[0].code == "changed"
    assert "p02.png: has changed since" in one.figures.causes[0].text
    assert flat(one)["volume_visible_n"] == COUNT - 1
    assert flat(one)["classes_n"] == COUNT


def test_without_a_data_set_there_are_times_and_a_reason(line, tmp_path: Path) -> None:
    variants = variants_of(line(2), "extractor=log-parabola")
    data = Data(variants[0].recipe)
    with ItemsFile(tmp_path / "out") as file:
        found = compare(variants, data, on_scored=file.add)
    write_comparison(tmp_path / "out", found, data, terms=Terms(), began=datetime.now(UTC))
    absent = found[0].figures.absent
    assert set(absent) == {"visible_mm3", "true_mm3", "mass_g", "label", "centres", "coding"}
    assert "there is no dataset.yaml" in absent["visible_mm3"]
    assert flat(found[0])["time_frame_median_ms"] is not None
    header = (tmp_path / "out" / "comparison.csv").read_text("utf-8").splitlines()[0]
    assert "bias" not in header
    assert "volume_visible_to_recipe_mean_pct" in header
    assert flat(found[1])["volume_visible_to_recipe_n"] == 2
    assert "No truth." in (tmp_path / "out" / "comparison.html").read_text("utf-8")


def test_what_the_set_knows_of_an_image_counts() -> None:
    frame = Frame(np.zeros((2, 2), np.uint16), bit_depth=16)
    (known,) = as_taken(Acquisition("one", (frame,)), Item("one", {}, time_s=2.0, bit_depth=10)).frames
    assert (known.white, known.time_s) == (1023, 2.0)
    assert np.isnan(known.encoder_count)


def test_labels_count_instead_of_those_of_the_set_or_without_one(dataset, tmp_path: Path) -> None:
    path, table = dataset(2), tmp_path / "labels.csv"
    (variant,) = variants_of(path)
    table.write_text("id,label\np01,good\np02#1,dull\n", encoding="utf-8")
    (found,) = compare((variant,), Data(variant.recipe, labels=read_labels(table)))
    assert (found.figures.classes.n, found.figures.classes.true) == (2, ("dull", "good"))
    (path.parent / "dataset.yaml").unlink()
    (found,) = compare((variant,), Data(variant.recipe, labels={"p01#1": "good"}))
    assert found.figures.classes.n == 1
    for name in ("p77#1", "p01#", "p01#x", "p01#0", "p01#1#1"):
        with pytest.raises(DataError, match=f"labels of what is not there: {name}"):
            Data(variant.recipe, labels={name: "good"})
    many = labelled(None, "a", {f"a#{number}": f"class {number}" for number in range(1, 12)})
    assert [one.label for one in many.products] == [f"class {number}" for number in range(1, 12)]
    second = labelled(None, "a", {"a#2": "dull", "aa#1": "good"})
    assert [one.label for one in second.products] == ["", "dull"]
    table.write_text("id,label\np01,good\np01,dull\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"labels.csv:3: p01 stands there a second time"):
        read_labels(table)


def test_every_variant_stands_once_and_the_recipe_first(line) -> None:
    """`log-parabola` has no option `start`: it is not varied with it."""
    vary = ("stages.extractor.options.start=fixed,lowest", "extractor=log-parabola,dominant-peak")
    sets = ["stages.extractor.options.start=lowest"]
    made = variants_of(line(1), *vary, sets=sets)
    assert [variant.name for variant in made] == ["recipe", "log-parabola", "start=fixed"]
    assert made[0].settings == {"extractor": "dominant-peak", "stages.extractor.options.start": "lowest"}
    local = made[1].recipe.stages["extractor"]
    assert local.options == local.stage.Options()


def test_what_is_said_of_the_product_stays_when_the_method_is_exchanged(line) -> None:
    """The underside is the product's; the rule between slices is the method's."""
    own = "{underside: rounded, true_share: 0.9, true_share_std: 0.02}"
    path, sets = line(1), [f"stages.volume={{use: slice-pchip, options: {own}}}"]
    _, trapezoid, zero_order = variants_of(path, "volume=slice-trapezoid,zero-order-hold", sets=sets)
    shares = "stages.volume.options.true_share=0.8"
    _, other, *_ = variants_of(path, "volume=slice-trapezoid", shares, sets=sets)
    assert trapezoid.name == "slice-trapezoid"
    options = trapezoid.recipe.stages["volume"].options.model_dump()
    assert options["underside"] == "rounded"
    assert (options["true_share"], options["true_share_std"]) == (0.9, 0.02)
    assert zero_order.fault == ""
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
        ("extractor=log-parabola,", "a value is missing"),
        ("stages.extractor=log-parabola", "write `extractor=…`"),
        ("stages.outliner.options.x=1", "the recipe has no outliner"),
    ],
)
def test_a_slip_in_vary_is_named(line, vary: str, says: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        variants_of(line(1), vary)
    assert says in str(caught.value)
    assert str(caught.value).startswith("--vary ")
