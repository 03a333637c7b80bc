"""Light that enters a product before it comes back: how much lower its surface seems."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.io.files import write_whole
from roemetry.io.yaml_source import dump, read
from roemetry.records import BELT, Profiles

VERSION = 1


@dataclass(frozen=True, slots=True)
class Penetration:
    """What has to be added to the heights of one product's surface."""

    product: str
    offset_mm: float
    """How much lower the surface is measured than it is, mm."""
    std_mm: float
    """Its standard uncertainty, mm: common to all points."""
    calibration_sha256: str
    target: str
    made: str
    """target, made: what was looked at, and when (ISO 8601)."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.offset_mm) and math.isfinite(self.std_mm) and self.std_mm >= 0):
            raise CalibrationError(
                f"penetration: offset_mm is {self.offset_mm}, std_mm is {self.std_mm}; expected numbers, "
                "the second not negative"
            )

    @property
    def sha256(self) -> str:
        """Hash of everything in it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write it as a YAML file that people can read."""
        write_whole(path, _HEADER + dump({"roemetry_penetration": VERSION, **asdict(self)}))

    @classmethod
    def load(cls, path: Path) -> Penetration:
        """Read a file; raise CalibrationError where it is none, or damaged."""
        data = read(path).data
        if not isinstance(data, dict) or data.get("roemetry_penetration") != VERSION:
            raise CalibrationError(
                f"{path}: not a penetration file (no `roemetry_penetration: {VERSION}` in it)",
                hint="make one with `roemetry fit-penetration`",
            )
        try:
            return cls(
                product=str(data["product"]),
                offset_mm=float(data["offset_mm"]),
                std_mm=float(data["std_mm"]),
                calibration_sha256=str(data["calibration_sha256"]),
                target=str(data["target"]),
                made=str(data["made"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise CalibrationError(
                f"{path}: the file is damaged: {what}", hint="make it again with `roemetry fit-penetration`"
            ) from error


def raise_surface(profiles: Profiles, offset_mm: float) -> Profiles:
    """Lift the points of products by an offset in height, along their planes of light.

    A plane of light goes through the true surface before it enters it, so the true point lies in the same
    plane, up the light; belt points stay.
    """
    normal = profiles.plane[:, :3]
    up = -normal * normal[:, 2:] + [0.0, 0.0, 1.0]
    up /= up[:, 2:]
    on_product = profiles.product > BELT
    moved = profiles.xyz_mm + np.where(on_product[:, :, None], offset_mm * up[:, None, :], 0.0)
    return replace(profiles, xyz_mm=moved)


_HEADER = """\
# Made by `roemetry fit-penetration`. offset_mm is added to the heights of products;
# its standard uncertainty std_mm is common to all points.
"""
