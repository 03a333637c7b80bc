"""The old place of what stands in the module below."""

from roemetry.records.view import write_camera as write_camera
