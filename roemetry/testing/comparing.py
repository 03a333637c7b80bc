"""The old place of what stands in the module below."""

from roemetry.testing.verdict import difference as difference
