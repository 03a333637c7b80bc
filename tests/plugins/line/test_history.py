"""Control charts against closed forms, days as Parquet, and blocks that are measured while the line runs."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import OutputError
from roemetry.records import Frame
from roemetry.run.control_chart import Chart
from roemetry_line import line_file as line_file_module
from roemetry_line.block_checks import BlockChecks, LaserHealth
from roemetry_line.control_charts import chart_of
from roemetry_line.days import HourlyTidying, tidy, write_days
from roemetry_line.gate import GateSection, ShiftRegister, count_at_gate
from roemetry_line.history import charts_of, checks_of, counts_of
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from roemetry_line.outlets.database import COLUMNS, connect
from tests.command import typed
from tests.plugins.line.loopback import wait_for

HOUR_S = 3600.0


def test_limits_of_alternating_values_are_known() -> None:
    values = np.tile([10.0, 11.128], 30)  # every moving range is 1.128: the standard deviation is 1
    chart = chart_of("mass_g", np.arange(60) * 60.0, values)
    assert chart.std_within == pytest.approx(1.0, abs=1e-12)
    assert chart.mean == pytest.approx(10.564, abs=1e-12)
    ((begin, count, mean, limit),) = chart.hours
    assert (begin, count) == (0.0, 60)
    assert mean == pytest.approx(10.564, abs=1e-12)
    assert limit == pytest.approx(3.0 / np.sqrt(60.0), abs=1e-12)
    assert chart.ewma[0] == pytest.approx(0.2 * 10.0 + 0.8 * 10.564, abs=1e-12)
    assert chart.ewma_limit[0] == pytest.approx(2.86 * 0.2, abs=1e-12)
    assert chart.ewma_limit[-1] == pytest.approx(2.86 / 3.0, abs=1e-5)
    few = chart_of("mass_g", np.arange(9.0), np.arange(9.0))
    assert np.isnan(few.std_within)
    assert few.hours == ()


def test_a_shift_is_seen_and_steady_products_are_not(rng) -> None:
    times_s = np.arange(2000) * 60.0
    steady = rng.normal(20.0, 1.0, 2000)
    chart = chart_of("mass_g", times_s, steady)
    assert len(chart.ewma_out) < 30  # 2,000 / 370 = 5.4 false alarms are expected, each of a few products
    shifted = steady + np.where(times_s > 30 * HOUR_S, 1.5, 0.0)
    out = chart_of("mass_g", times_s, shifted)
    assert {hour * HOUR_S for hour in (30.0, 31.0, 32.0, 33.0)} <= set(out.hours_out)
    assert len(chart.hours_out) <= 1


def table(tmp_path):
    made = connect(f"sqlite:{tmp_path / 'h.sqlite'}")
    rows = []
    for n in range(48):
        found = dict.fromkeys(COLUMNS) | {
            "line": "l", "run": "r", "id": str(n), "station": "s", "kind": "product", "text": "{}",
            "time_s": n * HOUR_S, "mass_g": 20.0 + n, "status": "measured",
            "grade": "good" if n % 3 else None, "product": "roe" if n % 2 else "cod",
        }  # fmt: skip
        rows.append([found[name] for name in COLUMNS])
    made.insert(rows)
    return made


def test_counts_and_values_come_from_the_table(tmp_path) -> None:
    made = table(tmp_path)
    assert counts_of(made, "l", "s", 0.0) == {"good": 32, "measured": 16}
    assert counts_of(made, "l", "other", 0.0) == {}
    charts = charts_of(made, "mass_g", "l", None, 42 * HOUR_S)
    assert list(charts) == ["roe", "cod"], "the product that was measured last comes first"
    assert charts["roe"].times_s.tolist() == [43 * HOUR_S, 45 * HOUR_S, 47 * HOUR_S]
    assert charts["roe"].values.tolist() == [63.0, 65.0, 67.0]
    assert charts["cod"].values.tolist() == [62.0, 64.0, 66.0]


def test_closed_days_become_parquet_once_and_again_where_rows_came_late(tmp_path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    made, days = table(tmp_path), tmp_path / "days"
    (written,) = write_days(made, "l", days, now=40 * HOUR_S)
    assert written.name == "1970-01-01.parquet"
    found = parquet.read_table(written)
    assert found.column("mass_g").to_pylist() == [20.0 + n for n in range(24)]
    assert found.column("decision").null_count == 24
    assert str(found.schema.field("decision").type) == "string", "of one type in every file"
    assert write_days(made, "l", days, now=40 * HOUR_S) == []
    made.insert([["l", "r", "late", "s", "product", 3.5 * HOUR_S, *[None] * 13, "{}"]])
    assert write_days(made, "l", days, now=40 * HOUR_S) == [written]
    assert parquet.read_table(written).column("id").to_pylist()[4] == "late"
    made.forget("l", 12 * HOUR_S)
    assert write_days(made, "l", days, now=40 * HOUR_S) == [], "what is forgotten stays in its file"
    assert [path.name for path in days.iterdir()] == ["1970-01-01.parquet"]
    assert write_days(made, "another line", days, now=40 * HOUR_S) == []


def test_nothing_is_forgotten_before_its_day_is_written(line_file, tmp_path, monkeypatch) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    history = f"history: {{url: 'sqlite:{tmp_path}/h.sqlite', days: days, keep_days: 2}}\n"
    path = line_file(("name: line-1", "name: l"), end=history)
    made = table(tmp_path)
    (path.parent / "data").mkdir()
    blocked = path.parent / "data" / "days"
    blocked.write_text("not a folder")
    with pytest.raises(OutputError, match="days"):
        tidy(Line.load(path))
    assert made.ask("select count(*) from roemetry_rows") == [(48,)]
    blocked.unlink()
    outbox = Outbox(path.parent / "data")
    outbox.raise_alarm("history", "days", "closed days are not written")
    monkeypatch.setattr("roemetry_line.days._FIRST_S", 0.0)
    tidying = HourlyTidying(Line.load(path), outbox)

    def tidied() -> bool:
        tidying.look()  # as a line does, which has it done by a process beside
        return not outbox.open_alarms("history")

    wait_for(tidied, "the alarm does not end", 60.0)
    assert made.ask("select count(*) from roemetry_rows") == [(0,)]
    assert [parquet.ParquetFile(day).metadata.num_rows for day in sorted(blocked.iterdir())] == [24, 24]


@pytest.mark.parametrize(
    ("moves", "count", "y_mm", "expected"),
    [
        ("+y", 1000.0, 100.0, 5000),
        ("-y", 1000.0, 100.0, 7000),
        ("+y", 65_000.0, 0.0, 70_000 - 65_536),
        ("+y", float("nan"), 0.0, None),
        ("+y", 1000.0, float("nan"), None),
    ],
)
def test_the_count_at_the_gate(moves, count, y_mm, expected) -> None:
    gate = GateSection(counts_per_mm=10.0, distance_mm=500.0, moves=moves, encoder_bits=16)
    assert count_at_gate(gate, count, y_mm) == expected


@given(st.lists(st.tuples(st.integers(0, 200), st.integers(0, 30_000)), max_size=30), st.integers(0, 65_535))
def test_a_shift_register_is_the_list_of_what_has_not_passed(steps, begin) -> None:
    register, now, placed = ShiftRegister(16), begin, list[int]()
    for step, ahead in steps:
        now += step
        register.move(now)
        register.put((now + ahead) % 65_536, now + ahead)
        placed.append(now + ahead)
    expected = sorted(count for count in placed if count >= now)
    assert [told for _, told in register.waiting] == expected, "the next one is first"
    assert register.missed == 0


BLOCK = "kind: block\nname: block-12\nlength_mm: 40\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n"


@dataclass
class Checked:
    """What a test looks at."""

    line: Line
    outbox: Outbox
    checks: BlockChecks
    told: list[tuple[str, str]]

    def until_told(self, frame: Frame | None = None) -> tuple[str, str]:
        """Let the checks run, on this frame or none, until they say something; gives it."""
        stop, before = threading.Event(), len(self.told)
        running = threading.Thread(target=self.checks.run, args=(stop,))
        running.start()
        try:
            if frame is not None:
                wait_for(lambda: self.checks.takes(frame), "no frame is taken")
            wait_for(lambda: len(self.told) > before, "nothing is told")
        finally:
            stop.set()
            running.join()
        return self.told[-1]

    def after(self, frame: Frame) -> tuple[str, str]:
        number = self.outbox.ask_check("one", "otto")
        assert self.outbox.ask_check("one", "erika") == number, "one is enough"
        self.until_told(frame)
        assert not self.checks.takes(frame), "the next frame shows a product"
        assert self.outbox.last_check("one")["ended"] is not None
        return self.told[-1]


@pytest.fixture
def checked(line_file, monkeypatch):
    monkeypatch.setattr("roemetry_line.block_checks._LOOK_S", 0.02)
    path = line_file(("recipe: recipe.yaml", "recipe: recipe.yaml\n    check_block: block.yaml"))
    (path.parent / "block.yaml").write_text(BLOCK, "utf-8")
    loaded = Line.load(path)
    outbox, told = Outbox(loaded.folder), list[tuple[str, str]]()
    recipe = path.parent / "recipe.yaml"
    checks = BlockChecks(
        "one", loaded.stations[0].block, loaded.folder, outbox,
        lambda: line_file_module.load_recipe(recipe, loaded.folder), lambda *given: told.append(given),
    )  # fmt: skip
    return Checked(loaded, outbox, checks, told)


def block_of(rig, height_mm: float) -> Frame:
    """Draw the block under the inner stripes."""
    heights = np.zeros((rig.stripes, rig.rows))
    heights[1:5, 60:160] = height_mm
    return Frame(rig.image(rig.x_px(heights), lens_px=1.0))


def test_a_block_is_measured_when_somebody_asks(checked, rig, tmp_path) -> None:
    assert not checked.checks.takes(block_of(rig, 12.0)), "nobody has asked"
    verdict, said = checked.after(block_of(rig, 12.0))
    assert verdict == "in order", said
    assert "height 12.0" in said
    verdict, said = checked.after(block_of(rig, 13.0))
    assert verdict == "out"
    assert "height 13.0" in said
    verdict, said = checked.after(Frame(rig.image(rig.x_px(np.zeros((rig.stripes, rig.rows))))))
    assert verdict == "failed", "there is no block"
    last = checked.outbox.last_check("one")
    assert (last["who"], last["verdict"], last["text"]) == ("otto", "failed", said)
    assert [one.verdict for one in checks_of(checked.line, checked.line.stations[0])] == ["in order", "out"]
    kept = list((checked.line.folder / "checks").glob("*.tif"))
    assert len(kept) == 3, "every frame that was taken for a check is kept"
    assert Chart(checked.line.folder / "checks" / "one.sqlite").checks()[0].image in {
        one.name for one in kept
    }

    connect(checked.line.history_url).close()
    shown = typed("history", checked.line.path, "--report", tmp_path / "h.html")
    assert "calibration of one: 2 checks" in shown.output
    assert "height of the block: 13.0" in shown.output
    page = (tmp_path / "h.html").read_text("utf-8")
    assert "Calibration of station one" in page
    assert page.count("<svg") == 3, "a chart for each length"


@pytest.mark.parametrize("frame_s", [0.05, 0.0], ids=["in time", "asked for long ago"])
def test_a_check_that_gets_no_frame_ends_and_takes_no_products_frame(
    checked, rig, monkeypatch, frame_s
) -> None:
    monkeypatch.setattr("roemetry_line.block_checks._FRAME_S", frame_s)
    number = checked.outbox.ask_check("one", "otto")
    verdict, said = checked.until_told()
    assert (verdict, said[:54]) == ("failed", "the check block was not measured: no frame came within")
    assert len(checked.told) == 1
    assert checked.outbox.last_check("one")["n"] == number
    assert not checked.checks.takes(block_of(rig, 12.0))


def seen(height: float, many: int = 50) -> SimpleNamespace:
    """Give as much of a trace as the laser's health looks at."""
    return SimpleNamespace(
        frame=SimpleNamespace(white=255.0), peaks=SimpleNamespace(amplitude=np.full(many, height))
    )


def test_a_laser_that_dims_or_goes_out_is_told_after_three_frames() -> None:
    laser = LaserHealth()
    assert [laser.look(seen(153.0)) for _ in range(30)] == [""] * 30
    assert laser.percent == pytest.approx(60.0)
    assert [laser.look(seen(80.0)) for _ in range(3)] == [""] * 3, "half of the light is left"
    assert [laser.look(seen(70.0)) for _ in range(2)] == [None, None], "a hand before the camera"
    assert (
        laser.look(seen(70.0))
        == "the stripes have 27 % of white, 60 % when the run began: is the window dirty?"
    )
    assert laser.look(seen(0.0, many=0)) == "no stripe is seen: is the laser on, and its window clean?"
    assert laser.look(seen(150.0)) == ""
    assert laser.look(None) is None
    never_on = LaserHealth()
    assert [never_on.look(seen(0.0, many=0)) for _ in range(3)][-1].startswith("no stripe is seen")
