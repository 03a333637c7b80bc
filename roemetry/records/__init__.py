"""The records that go from stage to stage: frozen, checked when made, arrays read-only, invalid is NaN."""

from roemetry.records.acquisition import Acquisition, AcquisitionReference, Frame, Role, Sensor
from roemetry.records.alignment import Alignment
from roemetry.records.evidence import Evidence, EvidenceFigure, Residuals
from roemetry.records.fitting import Fitted, Samples
from roemetry.records.measurement import Coding, Measurement, Status
from roemetry.records.observations import (
    Block,
    Board,
    CalibrationSet,
    Observation,
    Pyramid,
    Ruler,
    SpherePlate,
    Staircase,
)
from roemetry.records.outcome import Decision, Estimate, Grade, Marks, Shares, Volume, Weight
from roemetry.records.peaks import EDGE, SATURATED, WIDE, Peaks
from roemetry.records.plan import (
    Plan,
    PlanColumn,
    PlanCurves,
    PlanFigure,
    PlanMap,
    PlanShape,
    PlanTable,
)
from roemetry.records.product import Outline, Product
from roemetry.records.profiles import Profiles
from roemetry.records.reasons import Reason
from roemetry.records.relief import Relief, ReliefMap, ReliefRegion
from roemetry.records.stripes import AMBIGUOUS, BELT, NOTHING, UNCODED, StripeMap
from roemetry.records.trace import ProductTrace, Trace
from roemetry.records.truth import ProductTruth, Simulated, StripeTruth, Truth

__all__ = [
    "AMBIGUOUS",
    "BELT",
    "EDGE",
    "NOTHING",
    "SATURATED",
    "UNCODED",
    "WIDE",
    "Acquisition",
    "AcquisitionReference",
    "Alignment",
    "Block",
    "Board",
    "CalibrationSet",
    "Coding",
    "Decision",
    "Estimate",
    "Evidence",
    "EvidenceFigure",
    "Fitted",
    "Frame",
    "Grade",
    "Marks",
    "Measurement",
    "Observation",
    "Outline",
    "Peaks",
    "Plan",
    "PlanColumn",
    "PlanCurves",
    "PlanFigure",
    "PlanMap",
    "PlanShape",
    "PlanTable",
    "Product",
    "ProductTrace",
    "ProductTruth",
    "Profiles",
    "Pyramid",
    "Reason",
    "Relief",
    "ReliefMap",
    "ReliefRegion",
    "Residuals",
    "Role",
    "Ruler",
    "Samples",
    "Sensor",
    "Shares",
    "Simulated",
    "SpherePlate",
    "Staircase",
    "Status",
    "StripeMap",
    "StripeTruth",
    "Trace",
    "Truth",
    "Volume",
    "Weight",
]
