"""The old place of what stands in the module below."""

from roemetry.run.record import recipe_of as recipe_of
