"""Figures of `compare` on stripes of known truth; what the verb writes, and how it ends."""

from __future__ import annotations

import csv
import json
import re
import shutil
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest

from roemetry.calibrating.known_products import read_labels
from roemetry.config.dataset import Item
from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Acquisition, Frame
from roemetry.stages.registry import discover
from roemetry_tools.compare import tables
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


def test_verdicts_intervals_and_classes_reach_every_file(dataset, tmp_path, capsys, roemetry) -> None:
    """A density 1.4 times as large is 33 % of the mean away, whatever the products."""
    path, out = dataset(6), tmp_path / "out"
    vary = "stages.weigher.options.density_g_per_cm3=1.54"
    words = [path, "--vary", vary, "--out", out, "--tolerance", "5", "--folds", "2", "--seed", "4"]
    assert roemetry(*words) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("no clear winner; `recipe` is ahead: mean absolute error of the weight")
    assert "warning: 6 products" in printed
    assert "weight beside the recipe's, tolerance 5 %: different" in printed
    told = json.loads((out / "comparison.json").read_text("utf-8"))
    assert told["terms"] == {
        "tolerance_pct": 5.0,
        "folds": 2,
        "seed": 4,
        "stop_early": False,
        "resamples": 2000,
    }
    figures = told["variants"][1]["figures"]
    assert figures["to_recipe"]["weight"]["mean_pct"] == pytest.approx(100 / 3, abs=1e-6)
    assert figures["to_recipe"]["volume_visible"]["verdict"] == "equivalent"
    assert figures["to_truth"]["volume_visible"]["specimens"] == 6
    assert {recall["name"] for recall in figures["recalls"]} == {"good", "henkei"}
    (by_weight,) = (choice for choice in told["choices"] if choice["figure"] == "mass_g")
    assert by_weight["best"] == 0
    (row,) = list(csv.DictReader((out / "comparison.csv").read_text("utf-8").splitlines()))[1:]
    assert row["weight_to_recipe_verdict"] == "different"
    page = (out / "comparison.html").read_text("utf-8")
    for said in ("limits of agreement", "Beside the recipe as it is", "Choosing among these variants"):
        assert said in page


def test_a_comparison_in_a_bucket_is_stopped_and_gone_on_with(dataset, capsys, monkeypatch, roemetry) -> None:
    place, bucket = "memory://plant/study", fsspec.filesystem("memory")
    path = dataset(3)
    bucket.put(f"{path.parent}/", "/plant/set/", recursive=True)
    words = [path, "--vary", "stages.weigher.options.density_g_per_cm3=1.54"]
    assert roemetry(*words, "--data", path.parent, "--out", path.parent / "here") == 0
    here = (path.parent / "here" / "items.jsonl").read_bytes()
    words += ["--data", "memory://plant/set", "--out", place]

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as broken:
        broken.setattr("roemetry_tools.compare.write_comparison", stopped)
        assert roemetry(*words) == 130
    assert f"what was scored is kept in {place}" in capsys.readouterr().err
    assert sorted(bucket.glob("/plant/study/.*")) == ["/plant/study/.scored"]
    assert roemetry(*words) == 1, "a folder that holds a comparison is refused"
    assert f"{place}: there is a comparison in this folder" in capsys.readouterr().err
    assert roemetry(*words, "--resume") == 0
    assert f"{place}/comparison.html" in capsys.readouterr().out
    names = ["comparison.csv", "comparison.html", "comparison.json", "items.jsonl"]
    assert sorted(bucket.find("/plant/study")) == [f"/plant/study/{name}" for name in names]
    assert bucket.cat("/plant/study/items.jsonl") == here
    bucket.rm("/plant", recursive=True)


class Tags(HTMLParser):
    """Checks that tags close in order, and gathers whatever a page could load."""

    VOID = ("meta", "link", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        assert tag not in ("script", "iframe", "object", "img")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_command_line_and_files(dataset, tmp_path, roemetry, capsys) -> None:
    path, out = dataset(), tmp_path / "out"
    words = [path, "--vary", "extractor=dominant-peak,log-parabola", "--data", path.parent, "--out", out]
    assert roemetry(*words) == 0
    assert "log-parabola" in capsys.readouterr().out
    told = json.loads((out / "comparison.json").read_text("utf-8"))
    assert told["data"]["name"] == "drawn domes"
    assert told["data"]["seeds"] == [1, COUNT]
    assert told["data"]["made_from"] == {"seed": 7}
    assert set(told["data"]["sha256"]) == {"dataset.yaml", "items.jsonl"}
    assert [variant["name"] for variant in told["variants"]] == ["recipe", "log-parabola"]
    assert told["variants"][0]["figures"]["volume_visible"]["bias_pct"] == pytest.approx(-100 / 11)
    with (out / "comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["set extractor"] for row in rows] == ["dominant-peak", "log-parabola"]
    assert float(rows[0]["volume_visible_rmse_mm3"]) > 0
    items = [json.loads(text) for text in (out / "items.jsonl").read_text("utf-8").splitlines()]
    assert len(items) == 2 * COUNT
    assert items[0]["true"]["visible_mm3"] == pytest.approx(1.1 * items[0]["measured"]["visible_mm3"])
    page = (out / "comparison.html").read_text("utf-8")
    tags = Tags()
    tags.feed(page)
    assert tags.open == []
    assert tags.loads == ["data:,"]
    assert "url(" not in page
    assert "@import" not in page
    for said in (
        "drawn domes",
        told["variants"][1]["name"],
        "CC0-1.0",
        told["data"]["sha256"]["items.jsonl"],
    ):
        assert said in page
    assert roemetry(*words) == 1
    assert "there is a comparison in this folder already" in capsys.readouterr().err


def test_exit_codes(dataset, tmp_path, roemetry, monkeypatch, capsys) -> None:
    path = dataset()
    monkeypatch.chdir(tmp_path)
    assert roemetry(path, "--vary", "extractor=nothing") == 2
    assert "there is no extractor `nothing`" in capsys.readouterr().err
    assert roemetry(path, "--data", tmp_path) == 2
    assert "dataset.yaml: cannot be read" in capsys.readouterr().err
    assert roemetry(path, "--vary", "stages.extractor.options.threshold=-5", "--json") == 1
    assert json.loads(capsys.readouterr().out)["variants"][1]["status"] == "failed"
    assert (tmp_path / "results" / "line-compare-1" / "comparison.html").exists()


def test_figures_on_two_data_sets_stand_side_by_side(dataset, tmp_path, roemetry, capsys) -> None:
    """The second set's products are truly a tenth larger: only its volume disagrees."""
    path, other, out = dataset(6), tmp_path / "other", tmp_path / "out"
    shutil.copytree(path.parent, other)
    items = [json.loads(line) for line in (other / "items.jsonl").read_text("utf-8").splitlines()]
    for item in items:
        for product in item["products"]:
            product["visible_mm3"] *= 1.1
    (other / "items.jsonl").write_text("".join(json.dumps(item) + "\n" for item in items), "utf-8")
    assert roemetry(path, "--data", path.parent, "--data", other, "--out", out) == 0
    assert "between the data sets" in capsys.readouterr().out
    rows = {
        row["figure"]: row for row in csv.DictReader((out / "between.csv").read_text("utf-8").splitlines())
    }
    bias = rows["volume_visible_bias_pct"]
    assert float(bias[path.parent.name]) == pytest.approx(100 * (1 / 1.1 - 1), abs=1e-6)
    assert float(bias["other"]) == pytest.approx(100 * (1 / 1.21 - 1), abs=1e-6)
    assert bias["apart"] == "true" and rows["weight_bias_pct"]["apart"] == "false"
    assert float(rows["centre_rms_px"]["difference"]) == 0.0
    assert (out / "other" / "comparison.html").exists()
    assert roemetry(path, "--data", other, "--data", other, "--out", tmp_path / "twice") == 2
    assert "two data sets are called other" in capsys.readouterr().err


def test_every_step_that_is_timed_has_a_colour_of_its_own() -> None:
    sheet = Path(tables.__file__).with_name("templates") / "comparison.css"
    colours = re.findall(r"\.step-([a-z]+) \{ fill: (#[0-9a-f]{6});", sheet.read_text("utf-8"))
    assert {step for step, _ in colours} == set(tables.STEPS)
    assert len({colour for _, colour in colours}) == len(tables.STEPS)
