"""The kinds of stage, and how plugins register theirs.

The kinds are imported when one is used: listing plugins needs neither numpy nor pydantic.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roemetry.stages.kinds import *

__all__ = [
    "INTERFACES",
    "Aligner",
    "Assembler",
    "Calibrator",
    "Capabilities",
    "Classifier",
    "Coder",
    "Extractor",
    "Feed",
    "Grader",
    "Outlet",
    "Outliner",
    "Planner",
    "Run",
    "Simulator",
    "Sink",
    "Smoother",
    "Source",
    "Stage",
    "StageOptions",
    "Triangulator",
    "Turn",
    "VolumeEstimator",
    "Weigher",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'roemetry.stages' has no attribute {name!r}")
    return getattr(import_module("roemetry.stages.kinds"), name)
