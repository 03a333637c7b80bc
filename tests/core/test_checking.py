"""A known block on the belt: the calibration is checked by it, and how far light enters a product."""

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
    fit_penetration_in_one,
    judge,
    read_block,
)
from roemetry.calibrating.weight_check import WeighedPair, check_weights
from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError, ConfigurationError, DataError, OutputError
from roemetry.records import Block, Peaks, Reason, StripeMap
from roemetry.records.penetration import Penetration, raise_surface
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


LIGHT = Penetration("roe", 0.4, 0.05, "c" * 64, "block", "2026-05-01T00:00:00+00:00")


def test_points_of_products_are_lifted_and_stay_on_their_planes() -> None:
    before = BlockLinear().triangulate(RIG.stripe_map(RIG.dome()), RIG.calibration())
    after = raise_surface(before, 0.4)
    risen = after.xyz_mm[:, :, 2] - before.xyz_mm[:, :, 2]
    np.testing.assert_allclose(risen[before.product > 0], 0.4, atol=1e-12)  # mm
    np.testing.assert_array_equal(risen[before.product == 0], 0.0)
    off = np.einsum("spk,sk->sp", after.xyz_mm, after.plane[:, :3]) - after.plane[:, 3:]
    np.testing.assert_allclose(off, 0.0, atol=1e-9)  # mm


def test_a_file_comes_back(tmp_path: Path) -> None:
    LIGHT.save(tmp_path / "p.yaml")
    assert Penetration.load(tmp_path / "p.yaml") == LIGHT
    text = (tmp_path / "p.yaml").read_text("utf-8")
    (tmp_path / "p.yaml").write_text(text.replace("0.4", "deep"), "utf-8")
    with pytest.raises(CalibrationError, match=r"p.yaml: the file is damaged: could not convert"):
        Penetration.load(tmp_path / "p.yaml")
    (tmp_path / "p.yaml").write_text("a: 1\n", "utf-8")
    with pytest.raises(CalibrationError, match="not a penetration file"):
        Penetration.load(tmp_path / "p.yaml")
    with pytest.raises(CalibrationError, match="std_mm is -1"):
        replace(LIGHT, std_mm=-1.0)


def block_of(rig, height_mm: float, film_mm: float = 0.0, covered: slice = slice(70, 120)) -> np.ndarray:
    """An image of a block, a film on some of its rows."""
    found = np.zeros((rig.stripes, rig.rows))
    found[1:6, 70:170] = height_mm
    found[1:6, covered] += film_mm
    return rig.image(rig.x_px(found), lens_px=0.5)


@pytest.fixture
def covered_line(tmp_path: Path, rig) -> Path:
    """A recipe, and images of a block of 12 mm: bare, and under 2 mm of something light enters by 0.6 mm."""
    for name, height in (("bare", 12.0), ("covered", 12.0 + 2.0 - 0.6)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "block.png"), block_of(rig, height))
    rig.calibration().save(tmp_path / "calibration.yaml")
    (tmp_path / "block.yaml").write_text(
        "kind: block\nname: b\nlength_mm: 50\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n", "utf-8"
    )
    (tmp_path / "recipe.yaml").write_text(
        "roemetry: 1\nproduct: roe\nsource: {path: covered}\ncalibration: calibration.yaml\n"
        "penetration: penetration.yaml\nstages:\n  extractor: centre-of-gravity\n  coder: window-tracking\n"
        "  triangulator: block-linear\n  volume: zero-order-hold\nsinks: []\n",
        "utf-8",
    )
    return tmp_path


def row_of(recipe: Recipe, folder: Path) -> dict:
    run_recipe(recipe, folder)
    return json.loads((folder / "measurements.jsonl").read_text("utf-8"))


def words(covered_line: Path, film: str = "2.0") -> list[str]:
    images = [str(covered_line / name / "block.png") for name in ("bare", "covered")]
    target = ["--target", str(covered_line / "block.yaml")]
    return ["fit-penetration", str(covered_line), *images, "--film", film, "--film-std", "0.03", *target]


def test_what_was_drawn_is_found_and_used(covered_line: Path) -> None:
    typed(*words(covered_line))
    light = Penetration.load(covered_line / "penetration.yaml")
    assert light.offset_mm == pytest.approx(0.6, abs=0.03)  # mm
    assert 0.03 <= light.std_mm < 0.05
    assert light.product == "roe"
    raised, plain = (
        row_of(Recipe.load(covered_line, sets=sets), covered_line / f"out{len(sets)}")["height_max_mm"][
            "value"
        ]
        for sets in ([], ["penetration="])
    )
    assert raised - plain == pytest.approx(light.offset_mm, abs=1e-9)  # mm
    assert Recipe.load(covered_line).sha256 != Recipe.load(covered_line, sets=["penetration="]).sha256


@pytest.mark.parametrize(("half", "film"), [("top", 2.0), ("bottom", 0.0)])
def test_two_colours_in_one_image(covered_line: Path, rig, half: str, film: float) -> None:
    """Half of a block under 2 mm of something light enters by 0.6 mm; or painted, entered by as much."""
    covered = slice(70, 120) if half == "top" else slice(120, 170)
    cv2.imwrite(str(covered_line / "both.png"), block_of(rig, 12.0, film - 0.6, covered))
    common = ["--film", str(film), "--film-std", "0.03", "--target", str(covered_line / "block.yaml")]
    typed("fit-penetration", covered_line, covered_line / "both.png", "--half", half, *common)
    light = Penetration.load(covered_line / "penetration.yaml")
    assert light.offset_mm == pytest.approx(0.6, abs=0.03)  # mm
    assert 0.03 <= light.std_mm < 0.05


def test_what_cannot_be_told_from_the_images_is_refused(covered_line: Path, rig) -> None:
    """Without a second image the half must be named; too little of a top is said, as is a film too thick."""
    with pytest.raises(ConfigurationError, match=r"recipe.yaml:5:1: penetration: .*No such file"):
        Recipe.load(covered_line)
    LIGHT.save(covered_line / "penetration.yaml")
    thick = typed(*words(covered_line, film="14"), code=1)
    assert isinstance(thick.exception, DataError)
    assert "14 mm thick" in str(thick.exception)
    row = row_of(Recipe.load(covered_line), covered_line / "run")
    assert "penetration-other-calibration" in {reason["code"] for reason in row["reasons"]}
    target = ["--film", "0", "--target", str(covered_line / "block.yaml")]
    bare = str(covered_line / "bare" / "block.png")
    neither = typed("fit-penetration", covered_line, bare, *target, code=1)
    assert isinstance(neither.exception, ConfigurationError)
    assert "expected a second image or --half" in str(neither.exception)
    short = np.zeros((rig.stripes, rig.rows))
    short[1:6, 100:115] = 12.0
    cv2.imwrite(str(covered_line / "short.png"), rig.image(rig.x_px(short), lens_px=0.5))
    small = typed(
        "fit-penetration", covered_line, covered_line / "short.png", "--half", "top", *target, code=1
    )
    assert isinstance(small.exception, DataError)
    assert "does not show two level halves on 3 stripes" in str(small.exception)


def test_the_calibration_counts_where_halves_lie_apart(covered_line: Path, rig) -> None:
    """A calibration whose stripes are uncertain one by one by 1 %: the step's own 1 % by √5 stripes stays."""
    cv2.imwrite(str(covered_line / "both.png"), block_of(rig, 12.0, 2.0))
    calibration = rig.calibration()
    omega = calibration.parameters["omega_mm_per_px"]
    covariance = np.zeros(calibration.covariance.shape)
    covariance[: omega.size, : omega.size] = np.diag((0.01 * omega) ** 2)
    replace(calibration, covariance=covariance).save(covered_line / "calibration.yaml")
    recipe = Recipe.load(covered_line, sets=["penetration="])
    block = Block("b", 50.0, 25.0, 12.0, 0.02)
    light = fit_penetration_in_one(
        recipe, covered_line / "both.png", block, "top", film_mm=2.0, film_std_mm=0.0
    )
    assert light.std_mm == pytest.approx(0.01 * 2.0 / np.sqrt(5.0), rel=0.3)


def test_the_offset_stands_in_the_budget(covered_line: Path) -> None:
    """An offset known to 5 % of a mm on a flat top: the volume's part is area × 0.05 mm."""
    recipe = Recipe.load(covered_line, sets=["penetration="])
    light = replace(LIGHT, calibration_sha256=recipe.calibration.sha256)
    light.save(covered_line / "penetration.yaml")
    volume = row_of(Recipe.load(covered_line, sets=["draws=400"]), covered_line / "run")["volume"]
    plain = row_of(recipe, covered_line / "plain")["volume"]
    per_mm = (volume["visible_mm3"]["value"] - plain["visible_mm3"]["value"]) / LIGHT.offset_mm
    part = volume["visible_mm3"]["budget"]["penetration"]
    assert part == pytest.approx(LIGHT.std_mm * per_mm, rel=0.3)  # 100 draws: 7 %, four of those
