"""The old place of what stands in the module below."""

from roemetry.testing.kit import parametrized as parametrized
