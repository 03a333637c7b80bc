"""What is told of a product: its row of the record, how it was taken, and a few numbers in short."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from roemetry.io.files import json_values
from roemetry.records import Measurement, Trace
from roemetry.records.live import LiveFrame
from roemetry_line.gate import GateSection, count_at_gate, position_of
from roemetry_line.outbox import NewRow


@dataclass(frozen=True, slots=True)
class Taken:
    """How a frame was taken, besides its pixels."""

    number: int
    lost_before: int
    time_s: float
    encoder_count: float
    device_time_s: float

    @classmethod
    def of(cls, live: LiveFrame, arrived_s: float) -> Taken:
        """Take it from a frame that has arrived at a time, s since 1970."""
        count = math.nan if live.frame is None else live.frame.encoder_count
        return cls(live.number, live.lost_before, arrived_s, count, live.device_time_s)


@dataclass(frozen=True, slots=True)
class Where:
    """Which line, station and run a row is of, and what the recipe calls the product."""

    line: str
    station: str
    run: str
    product: str


def product_rows(
    where: Where,
    rows: tuple[Measurement, ...],
    trace: Trace | None,
    taken: Taken | None,
    gate: GateSection | None,
    *,
    latency_ms: float,
    late: bool,
    recovered: bool = False,
) -> list[NewRow]:
    """Give what is to be told of an acquisition's products, in the order of the record.

    `trace` says where products lie, `taken` how the frame was taken; None where that is not known any more.
    `recovered`: it was measured after a restart, long after the product had gone.
    """
    found = []
    for row in rows:
        place = _place(row.product, trace, taken, gate)
        line = row.to_json()
        head = {
            **_head(where, "product", row.acquisition),
            "taken": None if taken is None else json_values(_plain(taken)),
            "latency_ms": round(latency_ms, 3),
            "late": late,
            "recovered": recovered,
            "place": json_values(place),
        }
        summary = _summary(row) | json_values(place) | {"late": int(late), "recovered": int(recovered)}
        text = json.dumps(head, ensure_ascii=False)[:-1] + f', "measurement": {line}}}'
        key = f"{where.line}/{where.run}/{row.id}"
        found.append(NewRow(key, where.station, where.run, "product", summary, text, line))
    return found


def notice_row(where: Where, code: str, text: str, taken: Taken, acquisition: str | None = None) -> NewRow:
    """Give what is to be told of a frame that gave no measurement, or none in time."""
    head = {
        **_head(where, "notice", acquisition),
        "taken": json_values(_plain(taken)),
        "code": code,
        "text": text,
    }
    encoder = json_values({"encoder_count": taken.encoder_count})
    summary = {"id": acquisition, "status": code, "late": int(code == "late"), **encoder}
    of = acquisition or f"frame-{taken.number}-{taken.time_s:.3f}"
    return NewRow(
        f"{where.line}/{where.run}/{of}!{code}",
        where.station,
        where.run,
        "notice",
        summary,
        json.dumps(head, ensure_ascii=False),
    )


def _head(where: Where, kind: str, acquisition: str | None) -> dict[str, Any]:
    return {
        "line": where.line,
        "station": where.station,
        "run": where.run,
        "product": where.product,
        "kind": kind,
        "acquisition": acquisition,
    }


def _plain(taken: Taken) -> dict[str, float]:
    return {name: getattr(taken, name) for name in Taken.__slots__}


def _place(
    product: int, trace: Trace | None, taken: Taken | None, gate: GateSection | None
) -> dict[str, float | int | None]:
    found = next((one for one in (trace.products if trace else ()) if one.product.number == product), None)
    x_mm, y_mm = (math.nan, math.nan) if found is None else position_of(found.product)
    count = None
    if gate is not None and taken is not None:
        count = count_at_gate(gate, taken.encoder_count, y_mm)
    encoder = math.nan if taken is None else taken.encoder_count
    return {"x_mm": x_mm, "y_mm": y_mm, "encoder_count": encoder, "gate_count": count}


def _summary(row: Measurement) -> dict[str, Any]:
    volume, weight, decision = row.volume, row.weight, row.decision
    told: Mapping[str, Any] = {
        "id": row.id,
        "status": str(row.status),
        "grade": None if row.grade is None else row.grade.label,
        "decision": None if decision is None else decision.label,
        "lane": None if decision is None else decision.lane,
        "mass_g": None if weight is None else weight.mass_g.value,
        "mass_std_g": None if weight is None else weight.mass_g.std,
        "volume_mm3": None if volume is None else volume.visible_mm3.value,
        "volume_std_mm3": None if volume is None else volume.visible_mm3.std,
        "height_mm": row.height_max_mm.value,
        "reason": row.reasons[0].code if row.reasons else None,
    }
    return dict(json_values(told))
