"""Freed memory is kept where the C library can be told to, and nothing happens where it cannot."""

import ctypes

import pytest

from roemetry.run.pipeline import keep_freed_memory


class _Library:
    def __init__(self) -> None:
        self.told: list[tuple[int, int]] = []

    def mallopt(self, which: int, value: int) -> int:
        self.told.append((which, value))
        return 1


def test_glibc_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    library = _Library()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: library)
    keep_freed_memory.cache_clear()
    keep_freed_memory()
    keep_freed_memory()
    assert library.told == [(-3, 32 << 20), (-1, 256 << 20)]


@pytest.mark.parametrize("library", [object(), None])
def test_another_library_stays_as_it_is(library: object, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def found(name: object) -> object:
        asked.append(name)
        if library is None:
            raise OSError("there is no C library")
        return library

    monkeypatch.setattr(ctypes, "CDLL", found)
    keep_freed_memory.cache_clear()
    keep_freed_memory()
    keep_freed_memory()
    assert asked == [None], "the process itself is asked, once"
