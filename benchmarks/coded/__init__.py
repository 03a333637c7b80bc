"""Coded truth: peaks whose stripe is known exactly, from traced rays without a rendered image.

A product lies on a rig; every place where a light plane, lit and seen, crosses the middle of an image row is
found as a float64 root (`crossings`); noise, lost and false peaks are added (`damage`, `samples`); and what a
coder makes of these peaks is held against the truth (`scoring`). A sample takes a third of a second.

    from benchmarks.coded import DAMAGES, dense_rig, easy_rig, sample_of, score, skein

    sample = sample_of(easy_rig(7), skein(7, "dented"), DAMAGES["blobs"], seed=7)
    verdict = score(coder.code(sample.peaks, sample.calibration), sample)
"""

from benchmarks.coded.crossings import Crossings, crossings_of
from benchmarks.coded.damage import DAMAGES, Damage
from benchmarks.coded.products import KINDS, SHAPES, grown, shape, side_by_side, skein
from benchmarks.coded.rigs import CodingRig, dense_rig, easy_rig
from benchmarks.coded.samples import Sample, sample_from, sample_of
from benchmarks.coded.scoring import Score, score

__all__ = [
    "DAMAGES",
    "KINDS",
    "SHAPES",
    "CodingRig",
    "Crossings",
    "Damage",
    "Sample",
    "Score",
    "crossings_of",
    "dense_rig",
    "easy_rig",
    "grown",
    "sample_from",
    "sample_of",
    "score",
    "shape",
    "side_by_side",
    "skein",
]
