"""The conformance kit: analytic scenes, and checks that say whether a stage keeps its kind's contract."""

from roemetry.testing.checks import checks_of
from roemetry.testing.kit import Result, conformance, parametrize_stages, stages_named
from roemetry.testing.scenes import LinearRig, frame_of
from roemetry.testing.solids import Solid, product_of
from roemetry.testing.verdict import CheckFailedError, refused, require

__all__ = [
    "CheckFailedError",
    "LinearRig",
    "Result",
    "Solid",
    "checks_of",
    "conformance",
    "frame_of",
    "parametrize_stages",
    "product_of",
    "refused",
    "require",
    "stages_named",
]
