"""How spoiled calibrations are judged, and that they are spoiled at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

spoil = pytest.importorskip("benchmarks.spoil", reason="only in a checkout")

from roemetry.testing import LinearRig  # noqa: E402
from roemetry_pinhole.conformance import calibration_of  # noqa: E402

SWAPPED = spoil.SPOILED[0]


def shots() -> spoil.Shots:
    rng = np.random.default_rng(1)
    images = {
        shows: {str(n): rng.integers(0, 255, (40, 60), np.uint8) for n in range(8)}
        for shows in ("board", "board_laser")
    }
    rig = {"stripes": 5, "board": {"name": "b", "pitch_mm": 8.0, "marker_mm": 6.0}, "images": {}}
    return spoil.Shots(rig, images)


@pytest.mark.parametrize("kind", spoil.SPOILED, ids=lambda kind: kind.name)
def test_each_kind_changes_the_rig_or_images_and_never_the_first_pose(kind: spoil.Kind) -> None:
    before, after = shots(), shots()
    kind.spoil(after, np.random.default_rng(2))
    changed = before.rig != after.rig
    for shows, images in before.images.items():
        for pose, image in images.items():
            changed |= not np.array_equal(image, after.images[shows].get(pose, np.empty(0)))
    assert changed
    if kind.name != "five poses of one plane":
        assert all(np.array_equal(before.images[one]["0"], after.images[one]["0"]) for one in before.images)


def test_a_refusal_counts_by_its_words() -> None:
    sound = calibration_of(LinearRig())
    assert spoil.judged(SWAPPED, "the poses contradict each other", sound, ["3"]).word == "refused"
    assert spoil.judged(SWAPPED, "it is too dark", sound, ["3"]).word == "other words"
    assert spoil.judged(spoil.SOUND[0], "it is too dark", sound, []).word == "refused"


def test_what_is_accepted_counts_by_what_is_told_and_by_its_heights() -> None:
    sound = calibration_of(LinearRig())
    wrong = replace(sound, parameters=sound.parameters | {"focal_px": 1.1 * sound.parameters["focal_px"]})
    assert spoil.judged(SWAPPED, (sound, ""), sound, ["3"]).word == "harmless"
    assert spoil.judged(SWAPPED, (wrong, ""), sound, ["3"]).word == "missed"
    assert spoil.judged(spoil.SOUND[0], (wrong, ""), sound, []).word == "missed"
    told = replace(wrong, notes=("not used: on_3.png: too dark", "not used: on_5.png: too dark"))
    assert spoil.judged(SWAPPED, (told, ""), sound, ["3", "5"]).word == "reported"
    assert spoil.judged(SWAPPED, (told, ""), sound, ["3", "6"]).word == "missed"
    # what is told of the sound set as well tells nobody anything
    always = replace(sound, notes=("stripes and board corners contradict each other",))
    assert spoil.judged(SWAPPED, (replace(wrong, notes=always.notes), ""), always, ["3"]).word == "missed"


def test_two_boards_are_written_with_their_own_images(tmp_path: Path) -> None:
    two = shots()
    kind = next(kind for kind in spoil.SPOILED if kind.name == "second board's pitch 2 % wrong")
    kind.spoil(two, np.random.default_rng(1))
    text = spoil._written(two, tmp_path).read_text("utf-8")
    assert "more_boards" in text
    assert len(list((tmp_path / "second_board").iterdir())) == 3
    assert len(list((tmp_path / "board").iterdir())) == 5
