"""The old place of what stands in the module below."""

from roemetry.records.calibration import PARAMETERS as PARAMETERS
from roemetry.records.calibration import Alignment as Alignment
