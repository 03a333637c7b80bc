"""The old place of what stands in the module below."""

from roemetry.io.files import shipped as shipped
