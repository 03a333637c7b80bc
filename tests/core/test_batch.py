"""Runs: the batch goes on, the record is whole at every moment, any number of jobs gives the same."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.config.recipe import Recipe
from roemetry.errors import DataError, OutputError
from roemetry.io.files import exclusive
from roemetry.records import AMBIGUOUS, Acquisition, Estimate, Grade, Shares, Trace, Volume, Weight
from roemetry.run.batch import derive, run_recipe
from roemetry.run.pipeline import Pipeline
from roemetry.run.record import RECORD, read_record
from roemetry_files.image_files import ImageFiles
from roemetry_files.product_table import CsvTable
from roemetry_paper.arc_curvature import ArcCurvature
from roemetry_paper.density import Density
from roemetry_paper.dominant_peak import DominantPeak
from roemetry_paper.window_tracking import WindowTracking
from roemetry_paper.zero_order_hold import ZeroOrderHold

Line = Callable[..., Path]


def rows_of(folder: Path) -> dict[str, Any]:
    return {row.acquisition: row for row in read_record(folder)}


@pytest.fixture
def measured(line: Line, tmp_path: Path) -> Callable[..., list[Any]]:
    """Measure images, named p01, p02 …, by the line's recipe; gives a row each."""

    def run(*images: np.ndarray, sets: tuple[str, ...] = (), calibrated: bool = True) -> list[Any]:
        path = line(len(images), calibrated=calibrated)
        for number, image in enumerate(images, start=1):
            cv2.imwrite(str(path.parent / "images" / f"p{number:02d}.png"), image)
        run_recipe(Recipe.load(path, sets=sets), tmp_path / "out")
        found = rows_of(tmp_path / "out")
        return [found[f"p{number:02d}"] for number in range(1, len(images) + 1)]

    return run


def test_everything_is_measured_and_derived(line: Line, tmp_path: Path) -> None:
    outcome = run_recipe(Recipe.load(line(3)), tmp_path / "out")
    assert outcome.counts == {"measured": 3, "empty": 0, "failed": 0}
    assert outcome.sink_faults == ()
    provenance = json.loads((tmp_path / "out" / "provenance.json").read_text(encoding="utf-8"))
    assert provenance["finished"] is not None
    assert provenance["resolved_recipe"]["stages"]["extractor"]["options"]["threshold"] == 60
    headings = (tmp_path / "out" / "results.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "weight (g)" in headings
    volumes = [row.volume.visible_mm3.value for row in read_record(tmp_path / "out") if row.volume]
    assert volumes == sorted(volumes), "higher domes have larger volumes"
    before = (tmp_path / "out" / "results.csv").read_bytes()
    (tmp_path / "out" / "results.csv").unlink()
    shutil.rmtree(tmp_path / "line" / "images")
    files, faults, _ = derive(Recipe.load(tmp_path / "line"), tmp_path / "out", {})
    assert (faults, files[0].read_bytes()) == ((), before), "tables are derived from the record alone"


def test_bad_images_are_rows_and_the_batch_goes_on(line: Line, tmp_path: Path, rig) -> None:
    path, dome = line(1), rig.x_px(rig.dome())
    images, black = path.parent / "images", np.zeros((rig.rows, rig.columns), np.uint8)
    belt = rig.x_px(np.zeros((rig.stripes, rig.rows)))
    flat = belt.copy()  # its top one spacing of displacement high: over the belt's next lines
    flat[1:5, 80:160] += 20.0 * rig.px_per_mm
    flat[5, 80:160] = np.nan
    two_gone = dome.copy()
    two_gone[[2, 5]] = np.nan
    gap, broken_off = rig.image(dome), rig.image(dome)
    gap[150:190] = broken_off[120:] = 0
    whole = (images / "p01.png").read_bytes()
    (images / "a_truncated.png").write_bytes(whole[: len(whole) // 2])
    (images / "b_empty.png").write_bytes(b"")
    (images / "c_text.png").write_text("not an image", encoding="utf-8")
    for name, image in {
        "d_black": black,
        "e_white": np.full_like(black, 255),
        "f_belt": rig.image(belt),
        "g_small": black[:100, :100],
        "h_16bit": rig.image(dome).astype(np.uint16) * 257,
        "i_colour": cv2.merge([rig.image(dome)] * 3),
        "j_flat_top": rig.image(flat),
        "k_gap": gap,
        "l_broken_off": broken_off,
        "m_cut": rig.image(rig.x_px(rig.dome(first=-60, last=60))),
        "n_two_gone": rig.image(two_gone),
    }.items():
        cv2.imwrite(str(images / f"{name}.png"), image)
    outcome = run_recipe(Recipe.load(path), tmp_path / "out")
    rows = rows_of(tmp_path / "out")
    assert outcome.counts == {"measured": 4, "empty": 1, "failed": 10}
    for name, status, words in (
        ("a_truncated", "failed", "cut off"),
        ("b_empty", "failed", "empty"),
        ("c_text", "failed", "not an image"),
        ("d_black", "failed", "no stripe was found"),
        ("e_white", "failed", "no stripe was found"),
        ("f_belt", "empty", "there is no product"),
        ("g_small", "failed", "another camera"),
        ("k_gap", "failed", "the row 1(50|90) and others"),
        ("l_broken_off", "failed", "the row 120 and others|and 120 the image breaks off"),
        ("n_two_gone", "measured", r"7 stripes are expected and 5 are seen.*3, 6"),
    ):
        assert rows[name].status == status, name
        assert any(re.search(words, reason.text) for reason in rows[name].reasons), (name, rows[name].reasons)
    assert (rows["j_flat_top"].status, rows["j_flat_top"].reasons[0].code) == ("failed", "undecided")
    assert (rows["m_cut"].status, rows["m_cut"].volume, rows["m_cut"].grade) == ("failed", None, None)
    assert rows["n_two_gone"].coding.stripes_seen == 5
    deep, colour = (rows[name].volume.visible_mm3.value for name in ("h_16bit", "i_colour"))
    assert deep == pytest.approx(colour, rel=0.02)
    cv2.imwrite(str(images / "twelve.png"), rig.image(dome).astype(np.uint16) * 16)
    sets = ["source.bit_depth=12", f"source.path={images}/twelve.png"]
    run_recipe(Recipe.load(path, sets=sets), tmp_path / "deep")
    twelve = rows_of(tmp_path / "deep")["twelve"]
    assert twelve.volume.visible_mm3.value == pytest.approx(colour, rel=1e-3)


def test_uncalibrated_is_legal_and_said_on_every_row(line: Line, tmp_path: Path) -> None:
    outcome = run_recipe(Recipe.load(line(2, calibrated=False)), tmp_path / "out")
    assert outcome.counts["measured"] == 2
    for row in read_record(tmp_path / "out"):
        assert row.volume is None
        assert any(reason.code == "uncalibrated" for reason in row.reasons)
        assert row.coding.displacement_max_px == pytest.approx(2.0 * 9.0, abs=3.0)


def breaks(*_: Any, **__: Any) -> None:
    raise ZeroDivisionError("oh")


def hangs(*_: Any, **__: Any) -> None:
    while True:
        try:
            time.sleep(0.01)
        except Exception:  # what a careless plugin writes
            continue


@pytest.mark.parametrize(
    ("does", "says"),
    [
        (breaks, "`zero-order-hold` failed with ZeroDivisionError: oh"),
        (lambda *_, **__: sys.exit(0), "`zero-order-hold` failed with SystemExit: 0"),
        pytest.param(
            hangs,
            "the volume `zero-order-hold` had not finished after 0.5 s",
            marks=pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer that interrupts"),
        ),
    ],
    ids=["breaks", "ends the program", "hangs"],
)
def test_a_fault_in_a_plugin_is_a_row(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, does: Callable[..., Any], says: str
) -> None:
    monkeypatch.setattr(ZeroOrderHold, "estimate", does)
    outcome = run_recipe(Recipe.load(line(2), sets=["stage_timeout_s=0.5"]), tmp_path / "out")
    assert outcome.counts["failed"] == 2
    row = rows_of(tmp_path / "out")["p01"]
    assert row.absent["volume"].code == "volume-fault"
    assert says in row.absent["volume"].text
    assert row.grade is not None, "what does not need the volume is still there"
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    if does is breaks:
        with pytest.raises(ZeroDivisionError):
            run_recipe(Recipe.load(tmp_path / "line"), tmp_path / "debug", debug=True)


@pytest.mark.parametrize(
    ("stage", "does", "kind", "made", "says"),
    [
        (ZeroOrderHold, "estimate", "volume", lambda: volume_of(-4321.0), "visible volume is -4321 mm³"),
        (ZeroOrderHold, "estimate", "volume", lambda: volume_of(4321.0, math.inf), "value is inf"),
        (ZeroOrderHold, "estimate", "volume", lambda: volume_of(math.nan), "volume is NaN, and no reason"),
        (Density, "weigh", "weigher", lambda: Weight(Estimate(-7.0)), "mass is -7 g"),
        (ArcCurvature, "classify", "classifier", lambda: Grade("good", 7.0), "probability is 7.0"),
        (ArcCurvature, "classify", "classifier", lambda: Grade(""), "label is empty"),
    ],
)
def test_a_value_that_cannot_be_is_its_plugins_fault_and_no_measurement(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    stage: type, does: str, kind: str, made: Callable[[], Any], says: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(stage, does, lambda *_, **__: made())
    outcome = run_recipe(Recipe.load(line(1)), tmp_path / "out")
    row = rows_of(tmp_path / "out")["p01"]
    assert outcome.counts["measured"] == 0
    assert says in row.absent[kind].text and "failed with RecordError" in row.absent[kind].text
    assert {"volume": row.volume, "weigher": row.weight, "classifier": row.grade}[kind] is None


def volume_of(visible_mm3: float, true_mm3: float = 1.0) -> Volume:
    return Volume(Estimate(visible_mm3), Estimate(true_mm3), Shares(1.0, 0.0, 0.0))


def test_a_stage_that_gives_nothing_is_no_empty_belt(measured, rig, monkeypatch) -> None:
    monkeypatch.setattr(DominantPeak, "extract", lambda self, frame: None)
    (row,) = measured(rig.image(rig.x_px(rig.dome())))
    assert row.status == "failed"
    why = row.absent["extractor"]
    assert why.code == "extractor-fault"
    assert "the extractor `dominant-peak` failed" in why.text
    assert "gave nothing (None), expected Peaks" in why.text


def test_a_run_is_not_written_over_nor_gone_on_with_by_another_recipe_or_image(
    line: Line, tmp_path: Path, rig
) -> None:
    recipe, out = Recipe.load(line(1)), tmp_path / "out"
    out.mkdir()
    with exclusive(out), pytest.raises(OutputError, match=f"process {os.getpid()} on .* is writing into"):
        run_recipe(recipe, out)
    (out / ".lock").write_text("process 1 on a machine that lost its power")
    assert run_recipe(recipe, out).counts["measured"] == 1, "a lock whose owner has died is none"
    assert not (out / ".lock").exists()
    with pytest.raises(OutputError, match="--resume"):
        run_recipe(recipe, out)
    other = Recipe.load(recipe.path, sets=["stages.extractor.options.threshold=61"])
    with pytest.raises(OutputError, match="another recipe"):
        run_recipe(other, out, resume=True)
    cv2.imwrite(str(recipe.source_path / "p01.png"), rig.image(rig.x_px(rig.dome(5.0))))
    with pytest.raises(OutputError, match="another image than the one that was measured as p01"):
        run_recipe(recipe, out, resume=True)


def test_resume_measures_what_is_missing_and_mends_half_a_line(line: Line, tmp_path: Path) -> None:
    recipe, record = Recipe.load(line(4)), tmp_path / "out" / RECORD
    run_recipe(recipe, tmp_path / "out")
    whole = record.read_text("utf-8")
    lines = whole.splitlines(keepends=True)
    lacks_a_row = "".join(lines[:3]) + lines[3].replace('"products": 1', '"products": 2')
    for left in (lines[0] + lines[1][:40], lacks_a_row):
        assert left != whole
        record.write_text(left, "utf-8")
        run_recipe(recipe, tmp_path / "out", resume=True)
        assert record.read_text("utf-8") == whole


def test_killed_or_asked_to_end_all_but_the_last_line_is_whole(line: Line, tmp_path: Path) -> None:
    path, out = line(60), tmp_path / "out"
    record = out / RECORD
    kept = 0
    for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP):
        words = [sys.executable, "-m", "roemetry", "run", str(path), "--out", str(out), "--json"]
        with subprocess.Popen(
            [*words, *["--resume"] * record.exists()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # where this test itself runs under nohup, its children would rightly ignore SIGHUP
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
        ) as process:
            deadline = time.monotonic() + 60
            while time.monotonic() < deadline and not (
                record.exists() and record.read_bytes().count(b"\n") > kept
            ):
                time.sleep(0.002)
            process.send_signal(number)
            said = process.communicate(timeout=60)
        written = record.read_text(encoding="utf-8")
        whole = written[: written.rfind("\n") + 1]  # the system may stop in the middle of a write
        assert all(json.loads(row)["status"] == "measured" for row in whole.splitlines())
        assert whole.count("\n") > kept, said
        kept = whole.count("\n")
        if number == signal.SIGKILL:
            assert process.returncode == -signal.SIGKILL, said
            continue
        assert whole == written
        assert process.returncode == 130, said
        assert said[0] == ""
        assert f"stopped by {number.name}; what was measured is whole in {out}" in said[1]
        assert "--resume" in said[1] and "Traceback" not in said[1]
    run_recipe(Recipe.load(path), out, resume=True)
    assert record.read_text(encoding="utf-8").startswith(whole)
    assert [row.acquisition for row in read_record(out)] == [f"p{n:02d}" for n in range(1, 61)]


def test_asked_to_end_before_it_measures_a_run_says_so(tmp_path: Path) -> None:
    # a recipe that is a pipe: the start goes on once it is read, and is at work then
    recipe, out = tmp_path / "recipe.yaml", tmp_path / "out"
    os.mkfifo(recipe)
    command = [sys.executable, "-m", "roemetry", "run", str(recipe), "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        caught = 0
        while not caught & 1 << (signal.SIGTERM - 1) and time.monotonic() < deadline:
            status = Path(f"/proc/{process.pid}/status").read_text("utf-8")
            caught = int(status.split("SigCgt:")[1].split()[0], 16)
            time.sleep(0.002)
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    told = "stopped by SIGTERM; give the command again, with --resume where it has that option"
    assert said == ("", f"roemetry: {told}\n")
    assert not out.exists()


def test_a_folder_deleted_in_the_middle_stops_the_run(line: Line, tmp_path: Path) -> None:
    seen = []

    def progress(done: int, _: int) -> None:
        seen.append(done)
        if done == 2:
            shutil.rmtree(tmp_path / "out")

    with pytest.raises(OutputError, match="was deleted while it was written to"):
        run_recipe(Recipe.load(line(5)), tmp_path / "out", on_progress=progress)
    assert seen[-1] == 2
    assert not (tmp_path / "out").exists()


def test_an_image_written_to_while_it_is_read_is_not_measured(measured, rig, monkeypatch) -> None:
    read = ImageFiles.read

    def slow(self: ImageFiles, reference: Any) -> Any:
        taken = read(self, reference)
        path = reference.files["laser"]
        path.write_bytes(path.read_bytes() + b"\0")
        return taken

    monkeypatch.setattr(ImageFiles, "read", slow)
    (row,) = measured(rig.image(rig.x_px(rig.dome())))
    assert row.status == "failed"
    assert "while it was read" in row.reasons[0].text


def test_what_a_plugin_prints_does_not_stand_among_the_json(line: Line, tmp_path: Path) -> None:
    """Nor do two processes give another record than one."""
    (tmp_path / "sitecustomize.py").write_text(
        "import builtins, sys\n"
        "from roemetry_paper import zero_order_hold as z\n"
        "made = z.ZeroOrderHold.estimate\n"
        "def loud(*args, **words):\n"
        "    print('LOUD', flush=True)\n"
        "    return made(*args, **words)\n"
        "z.ZeroOrderHold.estimate = loud\n",
        "utf-8",
    )
    recipe, records = line(5), []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        command = [sys.executable, "-m", "roemetry", "run", str(recipe), "--out", str(out), "--json"]
        done = subprocess.run(
            [*command, "--jobs", jobs],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
        )
        assert json.loads(done.stdout)["counts"]["measured"] == 5
        assert "LOUD" in done.stderr
        records.append((out / RECORD).read_bytes())
    assert records[0] == records[1]


def test_disk_full_in_the_middle_keeps_what_was_measured(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = Recipe.load(line(3))
    real, calls = os.write, []

    def full_at_the_second(descriptor: int, data: bytes) -> int:
        if data.startswith(b'{"id"'):
            calls.append(data)
            if len(calls) == 2:
                raise OSError(28, "No space left on device")
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", full_at_the_second)
    with pytest.raises(OutputError, match="No space left"):
        run_recipe(recipe, tmp_path / "out")
    monkeypatch.setattr(os, "write", real)
    for resumed in (["p01"], ["p01", "p02", "p03"]):
        assert [row.acquisition for row in read_record(tmp_path / "out")] == resumed
        run_recipe(recipe, tmp_path / "out", resume=True)


def test_a_sink_that_fails_does_not_take_the_others_away(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: object, run: object) -> None:
        raise TypeError("oh")

    path = line(1)
    path.write_text(path.read_text("utf-8").replace("sinks: [csv]", "sinks: [csv, points]"), "utf-8")
    monkeypatch.setattr(CsvTable, "write", broken)
    outcome = run_recipe(Recipe.load(path), tmp_path / "out")
    assert [file.name for file in outcome.files] == ["p01.csv"]
    assert "csv: failed with TypeError: oh" in outcome.sink_faults[0]


@pytest.mark.parametrize("kind", ["volume", "classifier"])
def test_what_cannot_be_drawn_is_said_once_and_measured_all_the_same(
    kind: str, line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: object, product: object) -> None:
        raise IndexError("oh")

    recipe = Recipe.load(line(3), sets=("sinks=[report]",))
    whole = run_recipe(recipe, tmp_path / "whole")
    what, stage, name = {
        "volume": ("surface", ZeroOrderHold, "zero-order-hold"),
        "classifier": ("relief", ArcCurvature, "arc-curvature"),
    }[kind]
    monkeypatch.setattr(stage, what, broken)
    outcome = run_recipe(recipe, tmp_path / "out")
    assert whole.warnings == outcome.sink_faults == ()
    (said,) = outcome.warnings
    begin = f"p01#1 (and 2 more): the {what} is not drawn: the {kind} `{name}` failed with IndexError: oh"
    assert said.startswith(begin)
    assert outcome.record.read_bytes() == whole.record.read_bytes(), "the record is not about pictures"
    again = derive(recipe, tmp_path / "out", json.loads((tmp_path / "out" / "provenance.json").read_text()))
    assert again.warnings == outcome.warnings


def test_no_acquisition_is_traced_twice_and_a_later_report_is_the_same(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times apart, pages from kept traces and from traces made again are the same."""
    made: list[str] = []
    trace = Pipeline.trace

    def counted(self: Pipeline, acquisition: Acquisition, **kept: bool) -> Trace:
        made.append(acquisition.id)
        return trace(self, acquisition, **kept)

    monkeypatch.setattr(Pipeline, "trace", counted)
    recipe = Recipe.load(line(2), sets=("sinks=[report]",))
    outcome = run_recipe(recipe, tmp_path / "out")
    assert outcome.sink_faults == ()
    assert made == ["p01", "p02"]
    assert not [path for path in (tmp_path / "out").iterdir() if path.name.startswith(".")]

    def page() -> str:
        text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        return re.sub(r"(>[a-z]+) [\d.\s]+</span>", r"\1", text)

    before = page()
    derive(recipe, tmp_path / "out", json.loads((tmp_path / "out" / "provenance.json").read_text()))
    assert made == ["p01", "p02"] * 2
    assert page() == before


def test_another_extractor_than_the_calibrations_is_said(measured, rig) -> None:
    sets = ("stages.extractor.use=log-parabola", "stages.extractor.options={}")
    (row,) = measured(rig.image(rig.x_px(rig.dome())), sets=sets)
    (said,) = [reason.text for reason in row.reasons if reason.code == "other-extractor"]
    assert "measured with `log-parabola`:" in said
    assert "{" not in said


@pytest.mark.parametrize(
    ("coder", "code"), [("window-tracking", "undecided"), ("planes", "above-calibrated-range")]
)
def test_nothing_is_stated_of_a_product_above_the_calibrated_range(
    line: Line, tmp_path: Path, rig, coder: str, code: str
) -> None:
    """The dome is 9 mm high; the calibration is meant for 3.5 mm."""
    path = line(1)
    replace(rig.calibration(), height_range_mm=(0.0, 3.5)).save(path.parent / "calibration.yaml")
    run_recipe(Recipe.load(path, sets=[f"stages.coder.use={coder}"]), tmp_path / "out")
    row = rows_of(tmp_path / "out")["p01"]
    assert row.status == "failed"
    assert (row.volume, row.weight, row.grade) == (None, None, None)
    assert row.reasons[0].code == code


def test_some_open_points_are_said_and_too_many_refuse_the_product(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = WindowTracking.code
    refused_rows = 0

    def refusing(self: WindowTracking, peaks: object, calibration: object) -> object:
        """Refuse the product's peaks in the image's upper rows."""
        stripes = real(self, peaks, calibration)
        verdict = np.array(stripes.peak_stripe)
        own = stripes.rest_px[np.maximum(verdict, 0), peaks.row]
        refused = (np.abs(peaks.x_px - own) > 5.0) & (peaks.row < refused_rows) & (verdict >= 0)
        seen, x_px, product = (np.array(part) for part in (stripes.seen, stripes.x_px, stripes.product))
        cells = verdict[refused], peaks.row[refused]
        seen[cells], x_px[cells], product[cells] = False, np.nan, -1
        verdict[refused] = AMBIGUOUS
        return replace(stripes, peak_stripe=verdict, seen=seen, x_px=x_px, product=product)

    monkeypatch.setattr(WindowTracking, "code", refusing)
    path = line(1)
    rows = []
    for refused_rows in (0, 100, 140):
        run_recipe(Recipe.load(path), tmp_path / str(refused_rows))
        rows.append(rows_of(tmp_path / str(refused_rows))["p01"])
    whole, partly, hardly = rows
    assert whole.status == partly.status == "measured"
    assert any("widens the volume's uncertainty by" in reason.text for reason in partly.reasons)
    assert (hardly.volume, hardly.grade, hardly.weight) == (None, None, None)
    assert hardly.status == "failed"
    assert hardly.reasons[0].code == "undecided"


def test_without_an_aligner_a_camera_that_has_moved_is_said_and_then_refused(measured, rig) -> None:
    lean = np.linspace(-0.4, 0.4, rig.rows)
    images = [rig.image(rig.x_px(rig.dome()) + shift + lean) for shift in (0.0, 0.5, 1.4)]
    still, moved, far = measured(*images, sets=("stages.aligner=null",))
    assert "moved" not in [reason.code for reason in still.reasons]
    assert "moved" in [reason.code for reason in moved.reasons]
    assert far.status == "failed"
    assert "has moved" in far.reasons[0].text


def test_without_a_calibration_noise_fails_and_an_empty_belt_is_empty(measured, rig, rng) -> None:
    noise = rng.integers(0, 256, (600, 800), np.uint8)
    belt = rig.image(rig.x_px(np.zeros((rig.stripes, rig.rows))))
    noisy, bare = measured(noise, belt, calibrated=False)
    assert noisy.status == "failed"
    assert bare.status == "empty"
    assert bare.reasons[0].code == "no-product"
    assert "uncalibrated" in [reason.code for reason in bare.reasons]


def test_a_damaged_record_is_named_with_its_line(line: Line, tmp_path: Path) -> None:
    recipe = Recipe.load(line(2))
    run_recipe(recipe, tmp_path / "out")
    record = tmp_path / "out" / RECORD
    first = record.read_bytes().splitlines(keepends=True)[0]
    record.write_bytes(first + b'{"a": 1}\n')
    with pytest.raises(DataError, match=r"measurements\.jsonl:2: not a measurement"):
        run_recipe(recipe, tmp_path / "out", resume=True)
    record.write_bytes(first + first[:40])
    with pytest.raises(DataError, match=r"measurements\.jsonl:2: the last line is cut off"):
        list(read_record(tmp_path / "out"))
    record.write_bytes(first + first)
    for read in (
        lambda: list(read_record(tmp_path / "out")),
        lambda: run_recipe(recipe, tmp_path / "out", resume=True),
    ):
        with pytest.raises(DataError, match=r"jsonl:2: p01#1 stands in line 1 already"):
            read()
    record.write_bytes(first + b"\xff\xfe\n")
    with pytest.raises(DataError, match="not UTF-8"):
        run_recipe(recipe, tmp_path / "out", resume=True)
