"""The old place of what stands in the module below."""

from roemetry.records.view import distorted as distorted
from roemetry.records.view import slopes as slopes
from roemetry.records.view import undistorted as undistorted
