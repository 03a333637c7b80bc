"""The records that go from stage to stage: frozen, checked when made, arrays read-only, invalid is NaN."""

from roemetry.records.acquisition import Acquisition, AcquisitionReference, Frame, Role, ScanLines, Sensor
from roemetry.records.calibration import Alignment
from roemetry.records.light import Dots, Rays
from roemetry.records.measurement import (
    Coding,
    Decision,
    Estimate,
    Grade,
    ImageArrows,
    Measurement,
    Relief,
    ReliefMap,
    ReliefRegion,
    Shares,
    Status,
    Surface,
    Volume,
    Weight,
)
from roemetry.records.observations import (
    Block,
    Board,
    CalibrationSet,
    CameraFit,
    Evidence,
    EvidenceFigure,
    Fitted,
    ImageFinding,
    Observation,
    Pyramid,
    Residuals,
    Ruler,
    Samples,
    SpherePlate,
    Staircase,
    TargetView,
)
from roemetry.records.plan import (
    Plan,
    PlanAnswer,
    PlanColumn,
    PlanCurves,
    PlanFigure,
    PlanMap,
    PlanShape,
    PlanTable,
)
from roemetry.records.product import Outline, Product, ProductTrace, Trace
from roemetry.records.profiles import Profiles
from roemetry.records.reasons import Reason
from roemetry.records.scan import Motion, ScanFigures
from roemetry.records.stripes import (
    AMBIGUOUS,
    BELT,
    EDGE,
    NOTHING,
    SATURATED,
    UNLABELLED,
    WIDE,
    Peaks,
    StripeMap,
)
from roemetry.records.truth import ProductTruth, Simulated, StripeTruth, Truth
