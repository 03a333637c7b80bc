"""One product's row in the record of a run, and its JSON form."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from roemetry.errors import DataError
from roemetry.io.files import json_values
from roemetry.records.outcome import Decision, Estimate, Grade, Shares, Volume, Weight
from roemetry.records.reasons import Reason

Status = Literal["measured", "empty", "failed"]
_UNKNOWN = Estimate(math.nan)


@dataclass(frozen=True, slots=True)
class Coding:
    """How well the stripes of the acquisition were found and coded."""

    stripes: int
    """Number of stripes coded for."""
    stripes_seen: int
    """Number of stripes with at least one peak."""
    peaks: int
    coded: int
    ambiguous: int
    uncoded: int
    """peaks, coded, ambiguous, uncoded: peaks extracted; of them with a stripe; with several possible
    stripes; with none."""
    rows_seen: int
    rows_interpolated: int
    """rows_seen, rows_interpolated: (stripe, row) cells on this product with a seen point and with a bridged
    one. Without a product (an uncalibrated run, an empty belt) those of everything that is not belt."""
    saturated_share: float = math.nan
    """Share of the coded peaks that are saturated."""
    displacement_max_px: float = math.nan
    """Largest displacement from the rest line on the product, px, with its sign; NaN where unknown."""


@dataclass(frozen=True, eq=False, slots=True)
class Measurement:
    """All that was found of one product."""

    id: str
    """``<acquisition>#<product>``; ``#0`` where the acquisition gave no product."""
    acquisition: str
    product: int
    """acquisition, product: id of the acquisition; number of the product, 0 for none."""
    status: Status
    """``measured``: what the recipe asked for is there, or stands in `absent` with a reason. ``empty``: the
    image was read and coded, and shows no product. ``failed``: it could not be measured."""
    products: int = 1
    """Number of rows this acquisition has in the record."""
    coding: Coding | None = None
    """How the stripes were found; None where extraction or coding failed."""
    height_max_mm: Estimate = _UNKNOWN
    """Largest height of a point above the belt, mm; its value is NaN where unknown."""
    volume: Volume | None = None
    weight: Weight | None = None
    grade: Grade | None = None
    """volume, weight, grade: none where absent."""
    absent: Mapping[str, Reason] = field(default_factory=dict)
    """By stage kind, why its result is missing."""
    reasons: tuple[Reason, ...] = ()
    """What must be known to believe the numbers."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Hashes of recipe, calibration and image, and version of every plugin that had a part."""
    decision: Decision | None = None
    """What the grader made of it; None where absent."""

    @property
    def all_reasons(self) -> tuple[Reason, ...]:
        """Every reason on this row, each once: its own, then volume's, weight's, grade's, decision's."""
        parts = (self, self.volume, self.weight, self.grade, self.decision)
        return tuple(dict.fromkeys(reason for part in parts if part is not None for reason in part.reasons))

    def to_json(self) -> str:
        """One line of JSON; NaN is written as null."""
        volume = self.volume
        row = {
            "id": self.id,
            "acquisition": self.acquisition,
            "product": self.product,
            "products": self.products,
            "status": self.status,
            "decision": None if self.decision is None else _decision_row(self.decision),
            "grade": None if self.grade is None else _grade_row(self.grade),
            "weight": None if self.weight is None else _weight_row(self.weight),
            "volume": None if volume is None else _volume_row(volume),
            "height_max_mm": _estimate_row(self.height_max_mm),
            "coding": None
            if self.coding is None
            else {name: getattr(self.coding, name) for name in Coding.__slots__},
            "absent": {kind: reason._asdict() for kind, reason in self.absent.items()},
            "reasons": [reason._asdict() for reason in self.reasons],
            "provenance": dict(self.provenance),
        }
        return json.dumps(json_values(row), ensure_ascii=False, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Measurement:
        """Read a line that `to_json` wrote; null is read as NaN. Marks are not stored and come back None."""
        try:
            row = json.loads(line)
            coding = row["coding"]
            return cls(
                id=row["id"],
                acquisition=row["acquisition"],
                product=row["product"],
                status=row["status"],
                products=row["products"],
                coding=None if coding is None else Coding(**{k: _number(v) for k, v in coding.items()}),
                height_max_mm=_read_estimate(row["height_max_mm"]),
                volume=None if row["volume"] is None else _read_volume(row["volume"]),
                weight=None if row["weight"] is None else _read_weight(row["weight"]),
                grade=None if row["grade"] is None else _read_grade(row["grade"]),
                absent={kind: Reason(**reason) for kind, reason in row["absent"].items()},
                reasons=_read_reasons(row),
                provenance=row["provenance"],
                decision=None if row.get("decision") is None else _read_decision(row["decision"]),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DataError(
                f"not a measurement: {line[:60]!r}… ({type(error).__name__}: {error})",
                hint="the line was written by another version of roemetry, or edited by hand",
            ) from error


def _number(value: Any) -> Any:
    return math.nan if value is None else value


def _estimate_row(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": estimate.value,
        "std": estimate.std,
        "budget": dict(estimate.budget),
        "interval": list(estimate.interval),
    }


def _weight_row(weight: Weight) -> dict[str, Any]:
    return {
        "mass_g": _estimate_row(weight.mass_g),
        "features": dict(weight.features),
        "reasons": [r._asdict() for r in weight.reasons],
    }


def _volume_row(volume: Volume) -> dict[str, Any]:
    slices = zip(volume.slice_stripe, volume.slice_area_mm2, volume.slice_spacing_mm, strict=True)
    return {
        "visible_mm3": _estimate_row(volume.visible_mm3),
        "true_mm3": None if volume.true_mm3 is None else _estimate_row(volume.true_mm3),
        "shares": {name: getattr(volume.shares, name) for name in Shares.__slots__},
        "slices": [{"stripe": s, "area_mm2": a, "spacing_mm": x} for s, a, x in slices],
        "reasons": [r._asdict() for r in volume.reasons],
    }


def _grade_row(grade: Grade) -> dict[str, Any]:
    return {
        "label": grade.label,
        "probability": grade.probability,
        "features": dict(grade.features),
        "features_std": dict(grade.features_std),
        "reasons": [r._asdict() for r in grade.reasons],
    }


def _decision_row(decision: Decision) -> dict[str, Any]:
    return {
        "label": decision.label,
        "lane": decision.lane,
        "possible": list(decision.possible),
        "reasons": [r._asdict() for r in decision.reasons],
    }


def _read_reasons(row: Mapping[str, Any]) -> tuple[Reason, ...]:
    return tuple(Reason(**reason) for reason in row["reasons"])


def _read_estimate(row: Mapping[str, Any]) -> Estimate:
    budget = {cause: _number(part) for cause, part in row["budget"].items()}
    low, high = map(_number, row["interval"])
    return Estimate(_number(row["value"]), _number(row["std"]), budget, (low, high))


def _read_volume(row: Mapping[str, Any]) -> Volume:
    slices = row["slices"]
    return Volume(
        visible_mm3=_read_estimate(row["visible_mm3"]),
        true_mm3=None if row["true_mm3"] is None else _read_estimate(row["true_mm3"]),
        shares=Shares(**{name: _number(share) for name, share in row["shares"].items()}),
        slice_stripe=np.array([s["stripe"] for s in slices], np.int64),
        slice_area_mm2=np.array([_number(s["area_mm2"]) for s in slices], np.float64),
        slice_spacing_mm=np.array([_number(s["spacing_mm"]) for s in slices], np.float64),
        reasons=_read_reasons(row),
    )


def _read_grade(row: Mapping[str, Any]) -> Grade:
    return Grade(
        row["label"],
        _number(row["probability"]),
        _read_numbers(row["features"]),
        _read_reasons(row),
        features_std=_read_numbers(row.get("features_std", {})),
    )


def _read_weight(row: Mapping[str, Any]) -> Weight:
    return Weight(_read_estimate(row["mass_g"]), _read_reasons(row), _read_numbers(row.get("features", {})))


def _read_decision(row: Mapping[str, Any]) -> Decision:
    return Decision(row["label"], row["lane"], tuple(row["possible"]), _read_reasons(row))


def _read_numbers(row: Mapping[str, Any]) -> Mapping[str, float]:
    return {name: _number(value) for name, value in row.items()}
