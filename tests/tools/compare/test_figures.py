"""Figures of `compare` from end to end, on drawn stripes whose truth is made to give known ones."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from comparing_lines import COUNT, Counting, compared

from roemetry.config.dataset import Item
from roemetry.records import Acquisition, Frame
from roemetry.stages.registry import Registry, discover
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data, as_taken
from roemetry_tools.compare.tables import flat
from roemetry_tools.compare.variants import make_variants
from roemetry_tools.compare.write import ItemsFile, write_comparison


def test_figures_are_those_the_truth_was_made_for(dataset: Callable[..., Path]) -> None:
    (one,) = compared(dataset())
    row = flat(one)
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)
    assert row["volume_visible_mean_absolute_pct"] == pytest.approx(100 / 11, abs=1e-9)
    assert row["weight_bias_pct"] == pytest.approx(25.0, abs=1e-9)
    assert row["volume_visible_n"] == row["weight_n"] == COUNT
    assert row["volume_true_n"] is None
    assert one.figures is not None
    assert one.figures.absent == {"true_mm3": "the data set knows the true volume of no product"}
    assert row["classes_n"] == COUNT
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert row["centre_missed_pct"] == pytest.approx(100 * 14 / (7 * 240))  # the first and the last row
    assert row["centre_false_pct"] == 0.0
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05
    assert row["time_frame_median_ms"] is not None


def test_a_shifted_extractor_shows_its_shift(dataset: Callable[..., Path], registry: Registry) -> None:
    base, shifted = (flat(one) for one in compared(dataset(), "extractor=shifted", registry=registry))
    for group in ("centre", "centre_on_product"):
        moved = float(shifted[f"{group}_bias_px"] or 0) - float(base[f"{group}_bias_px"] or 0)
        assert moved == pytest.approx(0.3, abs=0.01)


def test_shared_steps_are_done_once(dataset: Callable[..., Path], registry: Registry) -> None:
    Counting.asked = 0
    found = compared(
        dataset(),
        "stages.weigher.options.density_g_per_cm3=1.0,1.2,1.4",
        "classifier=arc-curvature",
        registry=registry,
        sets=("stages.extractor.use=counting", "stages.extractor.options.threshold=60"),
    )
    assert len(found) == 4
    assert Counting.asked == COUNT
    masses = {round(float(flat(one)["weight_bias_pct"] or 0), 6) for one in found}
    assert len(masses) == 4
    times = [one.figures.seconds["extractor"] for one in found if one.figures]
    assert len({(time.n, time.median) for time in times}) == 1


def test_other_options_are_not_shared(dataset: Callable[..., Path], registry: Registry) -> None:
    Counting.asked = 0
    found = compared(
        dataset(),
        "stages.extractor.options.threshold=30,90",
        registry=registry,
        sets=("stages.extractor.use=counting",),
    )
    assert Counting.asked == 3 * COUNT
    assert [one.variant.name for one in found] == ["recipe", "threshold=30", "threshold=90"]


def test_a_failing_variant_is_a_row_and_not_the_end(dataset: Callable[..., Path], registry: Registry) -> None:
    found = compared(
        dataset(),
        "volume=zero-order-hold,raising,costly",
        "stages.extractor.options.threshold=60,-5",
        registry=registry,
    )
    failures = {one.variant.name: one.failure for one in found}
    assert failures["recipe"] == ""
    assert "ZeroDivisionError: nothing to share" in failures["raising, threshold=60"]
    assert (
        "needs the module no_such_module; install it with `pip install it`"
        in failures["costly, threshold=60"]
    )
    assert "--vary stages.extractor.options.threshold=-5: " in failures["threshold=-5"]
    assert "expected greater than or equal to 0" in failures["threshold=-5"]
    raising = next(one for one in found if one.variant.name == "raising, threshold=60")
    assert raising.figures is not None
    assert raising.figures.refused == COUNT
    assert raising.figures.coding is not None
    assert raising.figures.absent["visible_mm3"] == "nothing was given by the volume"


def test_numbers_are_the_same_for_any_number_of_processes(
    dataset: Callable[..., Path], tmp_path: Path
) -> None:
    path = dataset(4)
    items: list[str] = []
    rows: list[list[dict[str, object]]] = []
    for jobs in (1, 2):
        variants = make_variants(path, ["extractor=local-maximum"], registry=discover())
        assert variants[0].recipe is not None
        with ItemsFile(tmp_path / f"out{jobs}") as file:
            found = compare(variants, Data(variants[0].recipe), jobs=jobs, on_judged=file.add)
        rows.append([{k: v for k, v in flat(one).items() if not k.startswith("time_")} for one in found])
        items.append((tmp_path / f"out{jobs}" / "items.jsonl").read_text("utf-8"))
    assert items[0] == items[1]
    assert rows[0] == rows[1]


def test_half_turned_images_are_judged_alike(dataset: Callable[..., Path]) -> None:
    path = dataset(half_turned=True)
    (folder := path.parent / "calibration.yaml").write_text(
        folder.read_text("utf-8").replace("turn_deg: 0", "turn_deg: 180"), encoding="utf-8"
    )
    row = flat(compared(path, sets=("source.turn_deg=180",))[0])
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05
    assert row["volume_visible_bias_pct"] == pytest.approx(-100 / 11, abs=1e-9)


def test_truth_of_images_turned_by_a_quarter_is_that_of_the_turned_image(
    dataset: Callable[..., Path],
) -> None:
    path = dataset(quarter_turned=True)
    (folder := path.parent / "calibration.yaml").write_text(
        folder.read_text("utf-8").replace("turn_deg: 0", "turn_deg: 90"), encoding="utf-8"
    )
    row = flat(compared(path, sets=("source.turn_deg=90",))[0])
    assert row["coding_right_pct"] == pytest.approx(100.0)
    assert abs(float(row["centre_bias_px"] or 9)) < 0.05


def test_a_changed_image_is_refused(dataset: Callable[..., Path]) -> None:
    path = dataset()
    cv2.imwrite(str(path.parent / "images" / "p02.png"), np.zeros((240, 320), np.uint8))
    (one,) = compared(path)
    assert one.figures is not None
    assert one.figures.refused == 1
    assert one.figures.causes[0].code == "changed"
    assert "p02.png: has changed since" in one.figures.causes[0].text
    assert flat(one)["volume_visible_n"] == COUNT - 1
    assert flat(one)["classes_n"] == COUNT


def test_without_a_data_set_there_are_times_and_a_reason(line: Callable[..., Path], tmp_path: Path) -> None:
    variants = make_variants(line(2), ["extractor=local-maximum"], registry=discover())
    assert variants[0].recipe is not None
    data = Data(variants[0].recipe)
    with ItemsFile(tmp_path / "out") as file:
        found = compare(variants, data, on_judged=file.add)
    write_comparison(tmp_path / "out", found, data, terms=Terms(), began=datetime.now(UTC))
    assert found[0].figures is not None
    assert set(found[0].figures.absent) == {"visible_mm3", "true_mm3", "mass_g", "label", "centres", "coding"}
    assert "there is no dataset.yaml" in found[0].figures.absent["visible_mm3"]
    assert flat(found[0])["time_frame_median_ms"] is not None
    header = (tmp_path / "out" / "comparison.csv").read_text("utf-8").splitlines()[0]
    assert "bias" not in header
    assert "volume_visible_to_recipe_mean_pct" in header
    assert flat(found[1])["volume_visible_to_recipe_n"] == 2
    assert "No truth." in (tmp_path / "out" / "comparison.html").read_text("utf-8")


def test_what_the_set_knows_of_an_image_counts() -> None:
    frame = Frame(np.zeros((2, 2), np.uint16), bit_depth=16)
    item = Item("one", {}, time_s=2.0, bit_depth=10)
    (known,) = as_taken(Acquisition("one", (frame,)), item).frames
    assert (known.white, known.time_s) == (1023, 2.0)
    assert np.isnan(known.encoder_count)
