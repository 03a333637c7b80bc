"""What the verb `compare` writes, and how it ends."""

from __future__ import annotations

import csv
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import fsspec
import pytest

from roemetry_tools.compare import tables
from tests.tools.compare.conftest import COUNT


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
