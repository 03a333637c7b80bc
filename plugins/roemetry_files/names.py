"""Names of files that are made of what a source calls its acquisitions."""

from __future__ import annotations


def file_name(acquisition_id: str) -> str:
    """Give a name that stays in its folder, whatever a source calls its acquisitions."""
    return acquisition_id.replace("/", "_").replace("\\", "_")
