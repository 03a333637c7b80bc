"""Stages that are wrong on purpose, and how the tests of `compare` call it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from roemetry.records import Frame, Peaks
from roemetry.stages.registry import Registry, discover
from roemetry_paper.dominant_peak import DominantPeak
from roemetry_paper.zero_order_hold import ZeroOrderHold
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.ranking import Compared
from roemetry_tools.compare.variants import Variant, make_variants

COUNT = 3


class Shifted(DominantPeak):
    """The paper's extractor, 0.3 px to the right."""

    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        return replace(found, x_px=found.x_px + 0.3)


class Counting(DominantPeak):
    """Counts what it is asked for."""

    asked = 0

    def extract(self, frame: Frame) -> Peaks:
        type(self).asked += 1
        return super().extract(frame)


class Raising(ZeroOrderHold):
    """Never works."""

    def estimate(self, product: object, *, rng: object = None) -> object:
        raise ZeroDivisionError("nothing to share")


def compared(
    path: Path, *vary: str, registry: Registry | None = None, jobs: int = 1, sets: tuple[str, ...] = ()
) -> tuple[Compared, ...]:
    variants = make_variants(path, vary, sets=sets, registry=registry or discover())
    assert variants[0].recipe is not None
    return compare(variants, Data(variants[0].recipe), jobs=jobs)


def names(variants: tuple[Variant, ...]) -> list[str]:
    return [variant.name for variant in variants]
