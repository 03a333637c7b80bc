"""`compare` from end to end, on drawn stripes whose truth is made to give known figures."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.cli.main import main
from roemetry.compare.comparing import Compared, compare
from roemetry.compare.data import Data, as_taken, labelled
from roemetry.compare.tables import flat
from roemetry.compare.variants import Variant, make_variants
from roemetry.compare.writing import ItemsFile, write_comparison
from roemetry.dataset import DatasetWriter, Description, Item, save_stripes
from roemetry.errors import ConfigurationError, DataError
from roemetry.fitting import read_labels
from roemetry.hookspecs import StageEntry
from roemetry.pipeline import Pipeline
from roemetry.recipe import Recipe
from roemetry.records import Acquisition, Frame, Peaks, ProductTruth, StripeTruth
from roemetry.registry import Registered, Registry, discover
from roemetry_paper.dominant_peak import DominantPeak
from roemetry_paper.zero_order_hold import ZeroOrderHold

COUNT = 3


@pytest.fixture
def dataset(line: Callable[..., Path], rig: Any) -> Callable[..., Path]:
    """Make the line's folder a data set: true volume 1.1 times, mass 0.8 times what is measured."""

    def make(count: int = COUNT, half_turned: bool = False, quarter_turned: bool = False) -> Path:
        path = line(count)
        rig_heights = [8.0 + number % 6 for number in range(1, count + 1)]
        folder, pipeline = path.parent, Pipeline(Recipe.load(path))
        (folder / "truth").mkdir()
        writer = DatasetWriter(
            folder,
            Description(
                roemetry_dataset=1,
                name="drawn domes",
                licence="CC0-1.0",
                made_from={"seed": 7},
                turn_deg=90 if quarter_turned else 0,
            ),
        )
        for number, height in enumerate(rig_heights, start=1):
            image = cv2.imread(str(folder / "images" / f"p{number:02d}.png"), cv2.IMREAD_UNCHANGED)
            found = pipeline.trace(Acquisition("one", (Frame(image),))).products[0]
            assert found.volume is not None
            assert found.weight is not None
            heights = rig.dome(height_mm=height)
            x_px, on_product = rig.x_px(heights), heights > 0.3
            if half_turned:
                cv2.imwrite(str(folder / "images" / f"p{number:02d}.png"), image[::-1, ::-1])
                x_px, on_product = rig.columns - 1 - x_px[::-1, ::-1], on_product[::-1, ::-1]
            if quarter_turned:
                cv2.imwrite(str(folder / "images" / f"p{number:02d}.png"), np.rot90(image, -1))
            name = f"truth/p{number:02d}.npz"
            save_stripes(folder / name, StripeTruth(x_px, on_product, np.full((*x_px.shape, 3), np.nan)))
            measured = found.volume.visible_mm3.value
            true = ProductTruth(
                label="good" if number % 2 else "henkei",
                visible_mm3=1.1 * measured,
                mass_g=0.8 * found.weight.mass_g.value,
                figures={"seed": float(number)},
            )
            writer.add(Item(f"p{number:02d}", {"laser": f"images/p{number:02d}.png"}, {}, (true,), name))
        writer.close()
        return path

    return make


class Shifted(DominantPeak):
    """The paper's extractor, 0.3 px to the right."""

    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        return replace(found, x_px=found.x_px + 0.3)


class Counting(DominantPeak):
    """Counts what it is asked for."""

    asked = 0

    def extract(self, frame: Frame) -> Peaks:
        type(self).asked += 1
        return super().extract(frame)


class Raising(ZeroOrderHold):
    """Never works."""

    def estimate(self, product: object, *, rng: object = None) -> object:
        raise ZeroDivisionError("nothing to share")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """What is installed, and stages of this file."""
    module = ModuleType("stages_for_compare")
    found = discover()
    provider = found.stages[0].provider
    extra = []
    for kind, stage in (("extractor", Shifted), ("extractor", Counting), ("volume", Raising)):
        setattr(module, stage.__name__, stage)
        entry = StageEntry(kind, stage.__name__.lower(), f"{module.__name__}:{stage.__name__}", "", "")
        extra.append(Registered(entry, provider))
    missing = StageEntry("volume", "costly", "x:Y", "", "", requires=(("no_such_module", "pip install it"),))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return Registry((*found.stages, *extra, Registered(missing, provider)), ())


def compared(
    path: Path, *vary: str, registry: Registry | None = None, jobs: int = 1, sets: tuple[str, ...] = ()
) -> tuple[Compared, ...]:
    variants = make_variants(path, vary, sets=sets, registry=registry or discover())
    assert variants[0].recipe is not None
    return compare(variants, Data(variants[0].recipe), jobs=jobs)


def names(variants: tuple[Variant, ...]) -> list[str]:
    return [variant.name for variant in variants]


def test_figures_are_those_the_truth_was_made_for(dataset: Callable[..., Path]) -> None:
    (one,) = compared(dataset())
    row = flat(one)
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)
    assert row["volume_visible_mean_absolute_pct"] == pytest.approx(100 / 11, abs=1e-9)
    assert row["weight_bias_pct"] == pytest.approx(25.0, abs=1e-9)
    assert row["volume_visible_n"] == row["weight_n"] == COUNT
    assert row["volume_true_n"] is None
    assert one.figures is not None
    assert one.figures.absent == {"true_mm3": "the data set knows the true volume of no product"}
    assert row["classes_n"] == COUNT
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert row["centre_missed_pct"] == pytest.approx(100 * 14 / (7 * 240))  # the first and the last row
    assert row["centre_false_pct"] == 0.0
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05
    assert row["time_frame_median_ms"] is not None


def test_a_shifted_extractor_shows_its_shift(dataset: Callable[..., Path], registry: Registry) -> None:
    base, shifted = (flat(one) for one in compared(dataset(), "extractor=shifted", registry=registry))
    for group in ("centre", "centre_on_product"):
        moved = float(shifted[f"{group}_bias_px"] or 0) - float(base[f"{group}_bias_px"] or 0)
        assert moved == pytest.approx(0.3, abs=0.01)


def test_shared_steps_are_done_once(dataset: Callable[..., Path], registry: Registry) -> None:
    Counting.asked = 0
    found = compared(
        dataset(),
        "stages.weigher.options.density_g_per_cm3=1.0,1.2,1.4",
        "classifier=arc-curvature",
        registry=registry,
        sets=("stages.extractor.use=counting", "stages.extractor.options.threshold=60"),
    )
    assert len(found) == 4
    assert Counting.asked == COUNT
    masses = {round(float(flat(one)["weight_bias_pct"] or 0), 6) for one in found}
    assert len(masses) == 4
    times = [one.figures.seconds["extractor"] for one in found if one.figures]
    assert len({(time.n, time.median) for time in times}) == 1


def test_other_options_are_not_shared(dataset: Callable[..., Path], registry: Registry) -> None:
    Counting.asked = 0
    found = compared(
        dataset(),
        "stages.extractor.options.threshold=30,90",
        registry=registry,
        sets=("stages.extractor.use=counting",),
    )
    assert Counting.asked == 3 * COUNT
    assert [one.variant.name for one in found] == ["recipe", "threshold=30", "threshold=90"]


def test_a_failing_variant_is_a_row_and_not_the_end(dataset: Callable[..., Path], registry: Registry) -> None:
    found = compared(
        dataset(),
        "volume=zero-order-hold,raising,costly",
        "stages.extractor.options.threshold=60,-5",
        registry=registry,
    )
    failures = {one.variant.name: one.failure for one in found}
    assert failures["recipe"] == ""
    assert "ZeroDivisionError: nothing to share" in failures["raising, threshold=60"]
    assert (
        "needs the module no_such_module; install it with `pip install it`"
        in failures["costly, threshold=60"]
    )
    assert "--vary stages.extractor.options.threshold=-5: " in failures["threshold=-5"]
    assert "expected greater than or equal to 0" in failures["threshold=-5"]
    raising = next(one for one in found if one.variant.name == "raising, threshold=60")
    assert raising.figures is not None
    assert raising.figures.refused == COUNT
    assert raising.figures.coding is not None
    assert raising.figures.absent["visible_mm3"] == "nothing was given by the volume"


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


def test_numbers_are_the_same_for_any_number_of_processes(
    dataset: Callable[..., Path], tmp_path: Path
) -> None:
    path = dataset(4)
    items: list[str] = []
    rows: list[list[dict[str, object]]] = []
    for jobs in (1, 2):
        variants = make_variants(path, ["extractor=local-maximum"], registry=discover())
        assert variants[0].recipe is not None
        with ItemsFile(tmp_path / f"out{jobs}") as file:
            found = compare(variants, Data(variants[0].recipe), jobs=jobs, on_judged=file.add)
        rows.append([{k: v for k, v in flat(one).items() if not k.startswith("time_")} for one in found])
        items.append((tmp_path / f"out{jobs}" / "items.jsonl").read_text("utf-8"))
    assert items[0] == items[1]
    assert rows[0] == rows[1]


def test_half_turned_images_are_judged_alike(dataset: Callable[..., Path]) -> None:
    path = dataset(half_turned=True)
    (folder := path.parent / "calibration.yaml").write_text(
        folder.read_text("utf-8").replace("turn_deg: 0", "turn_deg: 180"), encoding="utf-8"
    )
    row = flat(compared(path, sets=("source.turn_deg=180",))[0])
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)


def test_truth_of_images_turned_by_a_quarter_is_that_of_the_turned_image(
    dataset: Callable[..., Path],
) -> None:
    path = dataset(quarter_turned=True)
    (folder := path.parent / "calibration.yaml").write_text(
        folder.read_text("utf-8").replace("turn_deg: 0", "turn_deg: 90"), encoding="utf-8"
    )
    row = flat(compared(path, sets=("source.turn_deg=90",))[0])
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05


def test_verdicts_intervals_and_classes_reach_every_file(
    dataset: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    roemetry: Callable[..., int],
) -> None:
    """A density 1.4 times as large is 33 % of the mean away, whatever the products."""
    path, out = dataset(6), tmp_path / "out"
    vary = "stages.weigher.options.density_g_per_cm3=1.54"
    words = [path, "--vary", vary, "--out", out, "--tolerance", "5", "--folds", "2", "--seed", "4"]
    assert roemetry(*words) == 0
    assert "weight beside the recipe's, tolerance 5 %: different" in capsys.readouterr().out
    told = json.loads((out / "comparison.json").read_text("utf-8"))
    assert told["terms"] == {"tolerance_pct": 5.0, "folds": 2, "seed": 4, "resamples": 2000}
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


def test_labels_count_instead_of_those_of_the_set(
    dataset: Callable[..., Path], tmp_path: Path, roemetry: Callable[..., int]
) -> None:
    table = tmp_path / "labels.csv"
    table.write_text("id,label\np01,good\np02#1,dull\n", encoding="utf-8")
    assert roemetry(dataset(), "--labels", table, "--out", tmp_path / "out") == 0
    told = json.loads((tmp_path / "out" / "comparison.json").read_text("utf-8"))
    assert told["data"]["labels"] == 2
    classes = told["variants"][0]["figures"]["classes"]
    assert (classes["n"], classes["true"]) == (2, ["dull", "good"])


def test_labels_make_classes_known_without_a_data_set(line: Callable[..., Path]) -> None:
    variants = make_variants(line(2), [], registry=discover())
    assert variants[0].recipe is not None
    (found,) = compare(variants, Data(variants[0].recipe, labels={"p01#1": "good"}))
    assert found.figures is not None
    assert found.figures.classes is not None
    assert found.figures.classes.n == 1
    with pytest.raises(DataError, match="labels of what is not there: p77#1"):
        Data(variants[0].recipe, labels={"p77#1": "good"})


def test_labels_without_a_data_set_keep_the_products_numbers() -> None:
    many = labelled(None, "a", {f"a#{number}": f"class {number}" for number in range(1, 12)})
    assert many is not None
    assert [one.label for one in many.products] == [f"class {number}" for number in range(1, 12)]
    second = labelled(None, "a", {"a#2": "dull", "aa#1": "good"})
    assert second is not None
    assert [one.label for one in second.products] == ["", "dull"]
    assert labelled(None, "a", {"b#1": "good"}) is None


@pytest.mark.parametrize("name", ["p01#", "p01#x", "p01#0", "p01#1#1"])
def test_a_label_of_no_products_number_is_told(line: Callable[..., Path], name: str) -> None:
    recipe = make_variants(line(1), [], registry=discover())[0].recipe
    assert recipe is not None
    with pytest.raises(DataError, match=f"labels of what is not there: {name}"):
        Data(recipe, labels={name: "good"})


def test_a_product_that_is_labelled_twice_is_told(tmp_path: Path) -> None:
    table = tmp_path / "labels.csv"
    table.write_text("id,label\np01,good\np01,dull\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"labels.csv:3: p01 stands there a second time"):
        read_labels(table)


def test_a_changed_image_is_refused(dataset: Callable[..., Path]) -> None:
    path = dataset()
    cv2.imwrite(str(path.parent / "images" / "p02.png"), np.zeros((240, 320), np.uint8))
    (one,) = compared(path)
    assert one.figures is not None
    assert one.figures.refused == 1
    assert one.figures.causes[0].code == "changed"
    assert "p02.png: has changed since" in one.figures.causes[0].text
    assert flat(one)["volume_visible_n"] == COUNT - 1
    assert flat(one)["classes_n"] == COUNT


def test_without_a_data_set_there_are_times_and_a_reason(line: Callable[..., Path], tmp_path: Path) -> None:
    variants = make_variants(line(2), ["extractor=local-maximum"], registry=discover())
    assert variants[0].recipe is not None
    data = Data(variants[0].recipe)
    with ItemsFile(tmp_path / "out") as file:
        found = compare(variants, data, on_judged=file.add)
    write_comparison(tmp_path / "out", found, data)
    assert found[0].figures is not None
    assert set(found[0].figures.absent) == {"visible_mm3", "true_mm3", "mass_g", "label", "centres", "coding"}
    assert "there is no dataset.yaml" in found[0].figures.absent["visible_mm3"]
    assert flat(found[0])["time_frame_median_ms"] is not None
    header = (tmp_path / "out" / "comparison.csv").read_text("utf-8").splitlines()[0]
    assert "bias" not in header
    assert "volume_visible_to_recipe_mean_pct" in header
    assert flat(found[1])["volume_visible_to_recipe_n"] == 2
    assert "No truth." in (tmp_path / "out" / "comparison.html").read_text("utf-8")


def test_what_the_set_knows_of_an_image_counts() -> None:
    frame = Frame(np.zeros((2, 2), np.uint16), bit_depth=16)
    item = Item("one", {}, time_s=2.0, bit_depth=10)
    (known,) = as_taken(Acquisition("one", (frame,)), item).frames
    assert (known.white, known.time_s) == (1023, 2.0)
    assert np.isnan(known.encoder_count)


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


@pytest.fixture
def roemetry(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run the command line in this process; gives the exit code."""

    def run(*words: object) -> int:
        monkeypatch.setattr(sys, "argv", ["roemetry", "compare", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            main()
        return int(caught.value.code or 0)

    return run


def test_command_line_and_files(
    dataset: Callable[..., Path],
    tmp_path: Path,
    roemetry: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, out = dataset(), tmp_path / "out"
    words = [path, "--vary", "extractor=dominant-peak,local-maximum", "--data", path.parent, "--out", out]
    assert roemetry(*words) == 0
    assert "local-maximum" in capsys.readouterr().out
    told = json.loads((out / "comparison.json").read_text("utf-8"))
    assert told["data"]["name"] == "drawn domes"
    assert told["data"]["seeds"] == [1, COUNT]
    assert told["data"]["made_from"] == {"seed": 7}
    assert set(told["data"]["sha256"]) == {"dataset.yaml", "items.jsonl"}
    assert [variant["name"] for variant in told["variants"]] == ["recipe", "local-maximum"]
    assert told["variants"][0]["figures"]["volume_visible"]["bias_pct"] == pytest.approx(-100 / 11)
    with (out / "comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["set extractor"] for row in rows] == ["dominant-peak", "local-maximum"]
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


def test_exit_codes(
    dataset: Callable[..., Path],
    tmp_path: Path,
    roemetry: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = dataset()
    monkeypatch.chdir(tmp_path)
    assert roemetry(path, "--vary", "extractor=nothing") == 2
    assert "there is no extractor `nothing`" in capsys.readouterr().err
    assert roemetry(path, "--data", tmp_path) == 2
    assert "dataset.yaml: cannot be read" in capsys.readouterr().err
    assert roemetry(path, "--vary", "stages.extractor.options.threshold=-5", "--json") == 1
    assert json.loads(capsys.readouterr().out)["variants"][1]["status"] == "failed"
    assert (tmp_path / "results" / "line-compare-1" / "comparison.html").exists()
