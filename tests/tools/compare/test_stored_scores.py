"""What was scored comes back from its file as it was, and no code comes with it."""

from __future__ import annotations

import base64
import json
import math
import pickle
import zlib
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import OutputError
from roemetry.records import Estimate, Grade, Measurement, ProductTruth, Reason, Shares, Volume
from roemetry.stages.registry import discover
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import Pair, Scored
from roemetry_tools.compare.stripes import CentreScore, CodingScore
from roemetry_tools.compare.variants import make_variants
from roemetry_tools.compare.write import KEPT, StoredScores, _plain
from tests.tools.compare.conftest import dataset

__all__ = ["dataset"]

WHY = Reason("undecided", "a third of the points is open")


class Evil:
    """What runs code where a pickle is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "ran")


def scored() -> Scored:
    counts = np.zeros_like(CentreScore().counts)
    counts[[3, 2999]] = 7, 1
    row = Measurement(
        "a#1",
        "a",
        1,
        status="measured",
        height_max_mm=Estimate(0.1 + 0.2, 1e-300, interval=(-math.inf, math.inf)),
        volume=Volume(Estimate(math.pi * 1e4, 1.0), None, Shares(1.0, 0.0, 0.0), reasons=(WHY,)),
        grade=Grade("good", math.nan),
        absent={"weigher": WHY},
    )
    true = ProductTruth("good", visible_mm3=31000.0, figures={"length_mm": 71.3})
    return Scored(
        2,
        "ä\udce4",
        (Pair(1, row, true, (WHY,)), Pair(0, None, None)),
        WHY,
        CentreScore(9, 8, 7, 0.1 + 0.2, math.inf, counts),
        CentreScore(),
        CodingScore(5, 3),
        {"stripes": WHY},
        {"frame": 0.0125},
    )


@pytest.fixture
def kept(dataset, tmp_path):
    variants = make_variants(dataset(2), [], registry=discover())
    data = Data(variants[0].recipe)
    return lambda: StoredScores(tmp_path, variants, data, Terms(), resume=True)


def test_what_was_kept_comes_back_to_the_last_digit(kept) -> None:
    with kept() as file:
        file.add((True, [scored()]))
        ((cold, (found,)),) = file.found()
    assert cold is True
    assert json.dumps(found, default=_plain) == json.dumps(scored(), default=_plain)
    assert (found.centres.counts == scored().centres.counts).all()
    assert found.pairs[0].reasons == (WHY,)
    assert found.pairs[0].measured.height_max_mm.interval == (-math.inf, math.inf)
    assert math.isnan(found.pairs[0].measured.grade.probability)


def test_a_stranger_s_file_runs_nothing(kept, tmp_path) -> None:
    with kept():
        pass
    bad = base64.b64encode(zlib.compress(pickle.dumps(Evil(tmp_path / "ran"))))
    with (tmp_path / KEPT).open("ab") as file:
        file.write(bad + b"\n")
    with kept() as file, pytest.raises(OutputError, match=r"\.scored:2: damaged, or of another roemetry"):
        next(file.found())
    assert not (tmp_path / "ran").exists()
