"""A data set in a bucket is compared on as one on the disk."""

from __future__ import annotations

import fsspec

from tests.tools.compare.conftest import dataset

__all__ = ["dataset"]


def test_a_data_set_in_a_bucket_gives_the_same_items(dataset, tmp_path, roemetry) -> None:
    path = dataset(2)
    fsspec.filesystem("memory").put(f"{path.parent}/", "/plant/set/", recursive=True)
    for name, data in (("here", path.parent), ("bucket", "memory://plant/set")):
        assert roemetry(path, "--data", data, "--out", tmp_path / name) == 0
    here, there = ((tmp_path / name / "items.jsonl").read_bytes() for name in ("here", "bucket"))
    assert here == there
