"""Numbers without a calibration on traced skeins and shapes: how many are right but for one offset.

``python -m benchmarks pieces [--frames N] [--first SEED]``

Products on a belt are what this coder is not made for: a body is moved aside by up to more than a spacing.
It shall refuse that, and number no stripe wrongly.
"""

from __future__ import annotations

import numpy as np

from benchmarks.coded import (
    DAMAGES,
    KINDS,
    Sample,
    crossings_of,
    dense_rig,
    easy_rig,
    in_view,
    sample_from,
    shape,
    skein,
)
from benchmarks.command import parser_of
from benchmarks.tables import table
from roemetry.errors import StageError
from roemetry.records import StripeMap
from roemetry_coding.pieces import Pieces
from roemetry_tools.compare.stripes import nearest

RIGS = {"easy": easy_rig, "dense": dense_rig}
DAMAGED = ("none", "gaps", "lost-rows", "blobs", "ghosts", "dead-stripe", "belt-above")
SHAPES = ("wedge", "sphere", "cylinder", "block")


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=60, help="frames a line; a third of it of shapes")
    parser.add_argument("--first", type=int, default=7000, help="first seed")
    given = parser.parse_args()
    lines = [("easy", "skein", damage) for damage in DAMAGED] + [("dense", "skein", "none")]
    lines += [("easy", form, "none") for form in SHAPES]
    rows = []
    for rig, form, damage in lines:
        frames = given.frames if form == "skein" else given.frames // 3
        rows.append(told(rig, form, damage, range(given.first, given.first + frames)))
    head = ["scene", "frames", "refused", "peaks numbered", "wrong", "frames with a wrong one"]
    print(table(head, rows), end="")


def told(rig_name: str, form: str, damage: str, seeds: range) -> list[str]:
    """Write one line."""
    refused = wrong = peaks = numbered = frames_wrong = 0
    for seed in seeds:
        rig = RIGS[rig_name](seed)
        solid = skein(seed, KINDS[seed % len(KINDS)]) if form == "skein" else shape(seed, form)
        crossings = crossings_of(rig.camera, rig.laser, in_view(solid, rig))
        sample = sample_from(rig, crossings, DAMAGES[damage], seed=seed)
        peaks += len(sample.peaks)
        try:
            stripes = Pieces().code(sample.peaks, None)
        except StageError:
            refused += 1
            continue
        mistaken = wrong_numbers(stripes, sample)
        wrong += mistaken
        frames_wrong += mistaken > 0
        numbered += int((stripes.peak_stripe >= 0).sum())
    name = f"{form}, {rig_name} rig" + ("" if damage == "none" else f", {damage}")
    share, of = f"{numbered / peaks:.1%}", f"{wrong} of {numbered}"
    return [name, f"{len(seeds)}", f"{refused}", share, of, f"{frames_wrong}"]


def wrong_numbers(stripes: StripeMap, sample: Sample) -> int:
    """Count peaks whose nearest true centre within 3 px has another number, but for most peaks' offset."""
    peaks, true = sample.peaks, sample.crossings
    of = nearest(peaks.row, peaks.x_px, true.row, true.x_px)
    known = (of >= 0) & (stripes.peak_stripe >= 0)
    shift = true.stripe[of[known]] - stripes.peak_stripe[known]
    if not shift.size:
        return 0
    return int((shift != np.bincount(shift + 1000).argmax() - 1000).sum())
