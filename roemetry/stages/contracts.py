"""The old place of what stands in the module below."""

from roemetry.stages.kinds import given as given
