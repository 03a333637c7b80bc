"""Changed constants: what is found of them, what follows from them, and that kernels see it."""

import subprocess
import sys

import numpy as np
import pytest

from benchmarks.constants import Constants, changed_by, compared, named
from benchmarks.golden import ROOT

NAN = float("nan")


def test_constants_are_found_with_what_follows_from_them() -> None:
    keys = named(["roemetry_coding.ordered"], ["_FAR"])
    module = "roemetry_coding.ordered"
    assert keys[module, "_SKIP"] == 0.6
    assert (module, "_FAR") not in keys
    assert Constants({(module, "_SKIP"): 0.75}).of(module)["DEAREST"] == pytest.approx(1.5)


def test_whole_numbers_change_by_at_least_one_and_tuples_as_a_whole() -> None:
    assert (changed_by(2, 0.8), changed_by(2, 1.25), changed_by(20, 1.25), changed_by(-4, 1.25)) == (
        1,
        3,
        25,
        -3,
    )
    assert changed_by((10, (2.0, 1)), 0.8) == (8, (1.6, 0))


def test_changes_are_summed_up_over_products_and_outcomes() -> None:
    seen_px = np.array([[1.0, 2.0, NAN, 4.0]])
    base = {"one": ({"#1": (100.0, 1.0, "measured", "good")}, seen_px)}
    # a point is gone, and another one has become another stripe's
    now_px = np.array([[1.0, NAN, NAN, 9.0]])
    found = {"one": ({"#1": (103.0, 0.5, "measured", "bent")}, now_px)}
    told = compared(found, base)
    assert told["volume_max_percent"] == told["volume_rms_percent"] == pytest.approx(3.0)
    assert told["std_max_percent"] == pytest.approx(50.0)
    assert told["labels_max_percent"] == pytest.approx(100.0 * 2.0 / 3.0)
    assert (told["grades"], told["outcomes"]) == (1, [])
    refused = {"one": ({"#1": (NAN, NAN, "refused (why)", "")}, seen_px)}
    told = compared(refused, base)
    assert told["outcomes"] == ["one #1: measured → refused (why)"]
    assert told["volume_max_percent"] == 0.0


def test_kernels_see_a_changed_constant() -> None:
    program = """
import numpy as np
from benchmarks.constants import Live, named
live = Live(named(["roemetry_kernels.bridging"], []))
from roemetry_kernels.bridging import off_belt_and_bridged
def off():
    x_px = np.array([[5.0, 5.0, 5.0, 0.0, 0.0]])
    return int(off_belt_and_bridged(x_px, np.zeros((1, 5)), 1.0, 3.0, 2).sum())
before = off()
live.set({("roemetry_kernels.bridging", "_PRODUCT_ROWS_MIN"): 4})
print(before, off())
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.split() == ["3", "0"]


def test_every_plugin_can_be_asked() -> None:
    """What is made of what is no constant, a generator too, is passed over."""
    found = named(["roemetry_*"], [])
    assert {module.partition(".")[0] for module, _ in found} >= {"roemetry_coding", "roemetry_volume"}
    assert found["roemetry_coding.planes.vetoes", "_MISSING_ROWS"] == 60
