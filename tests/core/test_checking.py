"""Checks of a calibration, by a block, and of weights, by a scale: known answers, and a whole chart."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibrating import (
    Chart,
    Check,
    Quantity,
    calibration_doubts,
    chart_page,
    find_block,
    judge,
    read_block,
)
from roemetry.calibrating.weight_check import WeighedPair, check_weights
from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError, DataError, OutputError
from roemetry.records import Block, Peaks, Reason, StripeMap
from roemetry.run.batch import run_recipe
from roemetry.run.control_chart import due
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear
from tests.command import typed

RIG = LinearRig()
BLOCK = Block("block", 40.0, 25.0, 12.0, 0.02)
NOW = datetime(2026, 5, 1, tzinfo=UTC)


def heights(height_mm: float = 12.0, rows: slice = slice(50, 150)) -> np.ndarray:
    found = RIG.belt()
    found[1:5, rows] = height_mm
    return found


def light_of(found: np.ndarray) -> tuple[Peaks, StripeMap]:
    return RIG.peaks(RIG.x_px(found)).peaks, RIG.stripe_map(found)


def test_a_drawn_block_is_measured_exactly() -> None:
    """100 rows of 0.25 mm are 25 mm: from the middle of one gap to the middle of the other."""
    profiles = BlockLinear().triangulate(RIG.stripe_map(heights()), RIG.calibration())
    places = find_block(profiles, BLOCK, light_of(heights()))
    reading = read_block(profiles, places, RIG.view())
    assert reading.height_mm == pytest.approx(12.0, abs=1e-9)  # mm
    assert reading.belt_mm == pytest.approx(0.0, abs=1e-9)  # mm
    assert reading.width_mm == pytest.approx(25.0, abs=0.02)  # mm
    assert reading.stripes == 4
    assert not places.top[:, :53].any(), "the rows beside an edge do not count"


@pytest.mark.parametrize("labelled", ["block", "nothing"])
def test_an_edge_within_a_row_is_told_by_its_light(labelled: str) -> None:
    """A quarter of row 50 and 99 whole rows are 24.81 mm, whatever a coder makes of the row at the edge."""
    peaks, stripes = light_of(heights())
    rim = peaks.row == 50
    peaks = replace(peaks, amplitude=np.where(rim, 0.25, 1.0) * peaks.amplitude)
    if labelled == "nothing":
        _, stripes = light_of(heights(rows=slice(51, 150)))
        on_block = rim & (np.abs(peaks.x_px - RIG.x_px(RIG.belt())[stripes.peak_stripe, peaks.row]) > 1.0)
        stripes = replace(stripes, peak_stripe=np.where(on_block, -1, stripes.peak_stripe).astype(np.int16))
    profiles = BlockLinear().triangulate(stripes, RIG.calibration())
    reading = read_block(profiles, find_block(profiles, BLOCK, (peaks, stripes)), RIG.view())
    assert reading.width_mm == pytest.approx(24.81, abs=0.03)  # mm


def test_a_turned_block_has_its_own_width() -> None:
    found = RIG.belt()
    x_mm = RIG.xyz_mm(heights())[:, :, 0]
    y_mm = RIG.xyz_mm(heights())[:, :, 1]
    yaw = np.radians(4.0)
    across = -np.sin(yaw) * x_mm + np.cos(yaw) * y_mm
    found[1:6] = np.where(np.abs(across[1:6]) < 10.0, 12.0, 0.0)
    profiles = BlockLinear().triangulate(RIG.stripe_map(found), RIG.calibration())
    reading = read_block(profiles, find_block(profiles, BLOCK, light_of(found)), RIG.view())
    assert reading.width_mm == pytest.approx(20.0, abs=0.15)  # mm


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        (RIG.belt(), "is not seen: fewer than 3 stripes"),
        (heights(6.0), "is not seen"),
        (np.where(heights() > 0, 12.0, np.nan), "no bare belt"),
    ],
)
def test_what_is_no_block_is_named(scene: np.ndarray, says: str) -> None:
    profiles = BlockLinear().triangulate(RIG.stripe_map(scene), RIG.calibration())
    with pytest.raises(DataError, match=says):
        find_block(profiles, BLOCK)


def check(height_mm: float = 12.0, *, made: datetime = NOW, sha: str = "c" * 64) -> Check:
    return Check(
        made=made.isoformat(timespec="seconds"),
        calibration_sha256=sha,
        target="block",
        image="block.png",
        image_sha256="0" * 64,
        height=Quantity(height_mm, 12.0, 0.05),
        belt=Quantity(0.0, 0.0, 0.05),
        width=Quantity(float("nan"), 25.0, 0.1),
        stripes=4,
        stripe_spread_mm=0.01,
    )


def test_out_means_twice_the_standard_uncertainty() -> None:
    assert judge(check(12.099), ()) == ("in order", ())
    verdict, reasons = judge(check(12.101), ())
    assert verdict == "out"
    assert "12.101 mm, expected 12.000 mm" in reasons[0].text


def test_drift_is_seen_before_a_limit_is_passed() -> None:
    rng = np.random.default_rng(4)
    history = [check(12.0 + e) for e in rng.normal(0.0, 0.004, 8)]
    assert judge(check(12.005), history)[0] == "in order"
    jumped, reasons = judge(check(12.04), history)
    assert (jumped, reasons[0].code) == ("drifting", "calibration-drift")
    assert judge(check(12.04), history[:7])[0] == "in order", "seven checks say nothing of their scatter"
    crept = [*history, *(check(12.002 + e) for e in rng.normal(0.0, 0.0002, 7))]
    assert "the last eight all lie above the centre" in judge(check(12.002), crept)[1][0].text


def test_chance_alone_seldom_looks_like_drift() -> None:
    rng = np.random.default_rng(8)
    alarms = 0
    for _ in range(200):
        history = [check(12.0 + e) for e in rng.normal(0.0, 0.01, 12)]
        alarms += judge(check(12.0 + rng.normal(0.0, 0.01)), history)[0] == "drifting"
    assert alarms < 20


def test_the_chart_gives_back_what_was_written(tmp_path: Path) -> None:
    chart = Chart(tmp_path / "chart.sqlite")
    assert chart.checks() == ()
    first = replace(check(12.3), verdict="out", reasons=(Reason("calibration-out", "too high"),))
    other = check(sha="d" * 64)
    for one in (first, check(made=NOW + timedelta(days=1)), other):
        chart.add(one)
    found = chart.checks("c" * 64)
    assert [c.made for c in found] == [first.made, (NOW + timedelta(days=1)).isoformat(timespec="seconds")]
    assert found[0].reasons == first.reasons
    assert found[0].height == first.height
    assert math.isnan(found[0].width.value)
    with closing(sqlite3.connect(tmp_path / "chart.sqlite")) as base:
        (content,) = base.execute("SELECT content FROM checks").fetchone()
    assert json.loads(content, parse_constant=pytest.fail)["width"]["value"] is None, "NaN is no JSON"
    assert len(chart.checks()) == 3
    text = chart_page(chart.checks(), "line <3>")
    assert text.count('class="point"') == 2 * 3, "height and belt; the width was not measured"
    assert "line &lt;3&gt;" in text


def test_what_is_no_chart_is_named_and_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "chart.sqlite"
    path.write_bytes(b"this is a diary, not a chart " * 50)
    for act in (lambda: Chart(path).checks(), lambda: Chart(path).add(check())):
        with pytest.raises(DataError, match=r"chart.sqlite: this is no control chart"):
            act()
    assert path.read_bytes().startswith(b"this is a diary")
    with pytest.raises(OutputError, match="cannot be written"):
        Chart(tmp_path / "no" / "such" / "chart.sqlite").add(check())


def test_a_check_that_is_cut_off_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chart = Chart(tmp_path / "chart.sqlite")
    chart.add(check())

    class Full(sqlite3.Connection):
        def commit(self) -> None:
            raise sqlite3.OperationalError("database or disk is full")

    real = sqlite3.connect
    with monkeypatch.context() as patched:
        patched.setattr(sqlite3, "connect", lambda *a, **k: real(*a, **k, factory=Full))
        with pytest.raises(OutputError, match="disk is full"):
            chart.add(check(13.0))
    assert [c.height.value for c in chart.checks()] == [12.0]


@pytest.fixture
def line(tmp_path: Path, rig) -> Callable[..., Path]:
    """A recipe with a calibration, one image of a block of 12 mm, and demands on the calibration."""

    def make(demands: str = "") -> Path:
        found = np.zeros((rig.stripes, rig.rows))
        found[1:6, 70:170] = 12.0
        (tmp_path / "images").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "images" / "block.png"), rig.image(rig.x_px(found), lens_px=0.5))
        replace(rig.calibration(), made=NOW.isoformat()).save(tmp_path / "calibration.yaml")
        (tmp_path / "block.yaml").write_text(
            "kind: block\nname: b\nlength_mm: 50\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n", "utf-8"
        )
        text = (
            "roemetry: 1\nproduct: block\nsource: {path: images}\ncalibration: calibration.yaml\n"
            f"{demands}stages:\n  extractor: {{use: dominant-peak, options: {{threshold: 30}}}}\n"
            "  coder: window-tracking\n  triangulator: block-linear\nsinks: []\n"
        )
        (tmp_path / "recipe.yaml").write_text(text, "utf-8")
        return tmp_path / "recipe.yaml"

    return make


def test_the_verb_checks_and_keeps_a_chart(line: Callable[..., Path], tmp_path: Path) -> None:
    recipe = line("calibration_check: {chart: chart.sqlite}\n")
    words = ["check-calibration", str(recipe), str(tmp_path / "images" / "block.png")]
    words += ["--target", str(tmp_path / "block.yaml")]
    done = typed(*words, "--json", "--report", tmp_path / "chart.html")
    told = json.loads(done.stdout)
    assert told["height"]["value"] == pytest.approx(12.0, abs=0.05)  # mm
    assert len(Chart(tmp_path / "chart.sqlite").checks()) == 1
    assert "in order" in (tmp_path / "chart.html").read_text("utf-8")
    text = (tmp_path / "block.yaml").read_text("utf-8").replace("height_mm: 12", "height_mm: 12.6")
    (tmp_path / "block.yaml").write_text(text, "utf-8")
    out = typed(*words, code=1)
    assert "height of the block: 12.0" in out.stdout


def test_a_run_carries_the_doubts(line: Callable[..., Path], tmp_path: Path) -> None:
    recipe = Recipe.load(line("calibration_check: {chart: chart.sqlite, max_age_days: 2, valid_days: 30}\n"))
    sha = recipe.calibration.sha256
    codes = lambda now: [reason.code for reason in calibration_doubts(recipe, now)]  # noqa: E731
    assert codes(NOW) == ["calibration-unchecked"]
    assert codes(NOW + timedelta(days=31)) == ["calibration-expired", "calibration-unchecked"]
    chart = Chart(tmp_path / "chart.sqlite")
    chart.add(check(sha=sha))
    assert codes(NOW + timedelta(days=1)) == []
    assert codes(NOW + timedelta(days=3)) == ["calibration-overdue"]
    out = replace(check(12.3, sha=sha, made=NOW + timedelta(days=1)), verdict="out")
    chart.add(replace(out, reasons=(Reason("calibration-out", "too high"),)))
    assert codes(NOW + timedelta(days=1)) == ["calibration-out"]
    run_recipe(recipe, tmp_path / "results")
    (row,) = (tmp_path / "results" / "measurements.jsonl").read_text("utf-8").splitlines()
    assert "calibration-out" in {reason["code"] for reason in json.loads(row)["reasons"]}


def pairs(line_over_scale: np.ndarray, std: float = 0.02) -> list[WeighedPair]:
    scale = 25.0
    return [
        WeighedPair(f"p{k}", scale * ratio, scale * std, scale) for k, ratio in enumerate(line_over_scale)
    ]


def test_what_has_not_moved_holds(rng: np.random.Generator) -> None:
    """Of 300 checks of 20 true pairs each, at most 3 % say otherwise."""
    false = sum(
        check_weights(pairs(1.0 + 0.02 * rng.standard_normal(20))).verdict != "holds" for _ in range(300)
    )
    assert false <= 9 + 9  # 3 %, and three standard deviations of the count


def test_a_bias_is_seen_and_one_below_the_tolerance_let_be(rng: np.random.Generator) -> None:
    off = 0.02 * rng.standard_normal(30)
    check = check_weights(pairs(1.04 + off - off.mean()))
    assert check.verdict == "refit"
    assert check.bias_share == pytest.approx(0.04, abs=1e-12)
    assert "+4.0%" in check.words[0]
    assert check_weights(pairs(1.004 + off - off.mean())).verdict == "holds"


def test_a_season_that_begins_is_dated() -> None:
    quiet = np.tile([0.99, 1.01], 15)
    check = check_weights(pairs(np.concatenate([quiet, quiet + 0.05])))
    assert check.verdict == "refit"
    assert check.since in ("p29", "p30", "p31")


def test_uncertainties_that_are_too_small_are_seen(rng: np.random.Generator) -> None:
    off = rng.standard_normal(40)
    off = (off - off.mean()) / off.std()
    check = check_weights(pairs(1.0 + 0.02 * off[np.argsort(np.abs(off))], std=0.01))
    assert check.verdict == "refit"
    assert check.scatter_over_stated == pytest.approx(2.0, abs=1e-9)
    assert any("2.00 times as wide as stated" in sentence for sentence in check.words)
    narrow = pairs(np.tile([0.98, 1.02], 10), std=0.01)
    rough = [pair._replace(scale_std_g=math.sqrt(3.0) * pair.line_std_g) for pair in narrow]
    assert check_weights(narrow).scatter_over_stated == pytest.approx(2.0, abs=1e-9)
    assert check_weights(rough).scatter_over_stated == pytest.approx(1.0, abs=1e-9), "the scale's own counts"
    unstated = [pair._replace(line_std_g=math.nan) for pair in narrow]
    assert check_weights(unstated).verdict == "holds"
    assert math.isnan(check_weights(unstated).within_share)
    assert check_weights(narrow[:4]).verdict == "too few"
    for none, says in (
        ([], "weighed by line and scale both"),
        (pairs(np.full(6, 1000.0)), "not the same unit"),
    ):
        with pytest.raises(DataError, match=says):
            check_weights(none)


def test_a_bias_within_the_tolerance_never_adds_up_to_running_away() -> None:
    """0.9 % in each of 200 pairs, stated to 0.5 %: 1.8 uncertainties to one side, every time."""
    sure = pairs(np.full(200, 1.009), std=0.005)
    assert check_weights(sure, 0.01).since == ""
    assert check_weights(sure, 0.0).since == "p0"
    assert check_weights(pairs(np.full(200, 1.02), std=0.005), 0.01).since == "p0"


def test_a_run_refuses_to_begin_without_its_check(line: Callable[..., Path], tmp_path: Path) -> None:
    """Nothing is written; a check in order lets it run, one that is overdue does not."""
    path = line("calibration_check: {chart: chart.sqlite, max_age_days: 1, refuse: true}\n")
    recipe = Recipe.load(path)
    with pytest.raises(CalibrationError, match="holds no check of this calibration"):
        run_recipe(recipe, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert recipe.calibration is not None
    fresh = check(sha=recipe.calibration.sha256, made=datetime.now(UTC))
    Chart(path.parent / "chart.sqlite").add(fresh)
    assert run_recipe(recipe, tmp_path / "out").counts["failed"] == 0
    old = Recipe.load(path, sets=["calibration_check.max_age_days=0.00000001"])
    with pytest.raises(CalibrationError, match="last checked"):
        run_recipe(old, tmp_path / "later")
    assert (due(fresh, 1.0) - datetime.fromisoformat(fresh.made)).days == 1
