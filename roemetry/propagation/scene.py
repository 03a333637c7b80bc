"""What draws start from, and the stages they go through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from roemetry.calibration import Calibration
from roemetry.penetration import Penetration
from roemetry.records import Outline, StripeMap


@dataclass(frozen=True)
class Chain:
    """The stages from the triangulator on, as one recipe has them."""

    triangulator: Any
    volume: Any
    weigher: Any
    classifier: Any


@dataclass(frozen=True)
class Scene:
    """What one acquisition gave before triangulation."""

    acquisition_id: str
    stripes: StripeMap
    outlines: tuple[Outline, ...]
    calibration: Calibration
    penetration: Penetration | None = None
