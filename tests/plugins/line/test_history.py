"""Control charts against their closed forms, and the days written as Parquet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import OutputError
from roemetry_line.control_charts import chart_of
from roemetry_line.days import HourlyTidying, tidy, write_days
from roemetry_line.gate import GateSection, ShiftRegister, count_at_gate
from roemetry_line.history import charts_of, counts_of
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from roemetry_line.outlets.database import COLUMNS, connect
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
