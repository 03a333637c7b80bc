"""Damaged files end in one of our errors, or in a result; the nightly form is `python -m benchmarks fuzz`."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import fuzz
from benchmarks.fuzz import Target, damaged, fault_of, fuzzed


def test_five_hundred_damaged_files_neither_crash_nor_hang() -> None:
    assert fuzzed(500, seed=1) == []


def test_the_fuzzer_sees_what_it_looks_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "any"
    path.write_bytes(b"")

    def crash(_: object) -> object:
        raise KeyError("lost")

    assert fault_of(Target("sound", path, lambda _: None), path) == ""
    assert "KeyError" in fault_of(Target("crash", path, crash), path)
    monkeypatch.setattr(fuzz, "HANG_S", 0.01)
    assert "processor time" in fault_of(Target("slow", path, lambda _: sum(range(10_000_000))), path)
    monkeypatch.setattr(fuzz, "HANG_S", 60.0)
    monkeypatch.setattr(fuzz, "_peak_mb", iter((100.0, 700.0)).__next__)
    assert fault_of(Target("flood", path, lambda _: None), path) == "600 MB more memory"


def test_a_seed_makes_the_same_damage_again() -> None:
    content = bytes(range(256)) * 8
    one, other = (damaged(content, np.random.default_rng(seed)) for seed in (3, 3))
    assert one == other != content
