"""Coded truth: peaks whose stripe is known exactly, from traced rays without a rendered image.

A product lies on a rig; every place where a light plane, lit and seen, crosses the middle of an image row is
found as a float64 root (`scenes`); noise, lost and false peaks are added, and what a coder makes of these
peaks is held against the truth (`samples`). A sample takes a third of a second.

    from benchmarks.coded import DAMAGES, dense_rig, easy_rig, sample_of, score, skein

    sample = sample_of(easy_rig(7), skein(7, "dented"), DAMAGES["blobs"], seed=7)
    verdict = score(coder.code(sample.peaks, sample.calibration), sample)
"""

from benchmarks.coded.samples import DAMAGES, Damage, Sample, Score, sample_from, sample_of, score, verdicts
from benchmarks.coded.scenes import (
    KINDS,
    SHAPES,
    CodingRig,
    Crossings,
    crossings_of,
    dense_rig,
    easy_rig,
    grown,
    in_view,
    shape,
    side_by_side,
    skein,
)

__all__ = [
    "DAMAGES", "KINDS", "SHAPES", "CodingRig", "Crossings", "Damage", "Sample", "Score", "crossings_of",
    "dense_rig", "easy_rig", "grown", "in_view", "sample_from", "sample_of", "score", "shape", "side_by_side",
    "skein", "verdicts",
]  # fmt: skip
