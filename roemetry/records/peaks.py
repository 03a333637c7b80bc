"""The old place of what stands in the module below."""

from roemetry.records.stripes import EDGE as EDGE
from roemetry.records.stripes import SATURATED as SATURATED
from roemetry.records.stripes import WIDE as WIDE
from roemetry.records.stripes import Peaks as Peaks
