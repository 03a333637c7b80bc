"""What speaks for and against a stripe, in one unit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Weights:
    """What speaks for and against a label; the unit is a surface step of one label height.

    Attributes
    ----------
    surface
        A step of the surface between two stripes by the height that one stripe spacing stands for.
    unseen
        A stripe left out that would be seen.
    false_peak
        A peak left out.
    on_rest, long_run, anchor
        Gain of a peak on its own rest line; more if it is one of a long run; more if that begins at the
        image's border.
    on_end
        The same at the end of a run, where a body may begin.
    absent
        A stripe whose rest line shows nothing.
    tie_whole, tie_cut, tie_gap
        Change of stripe within a piece of a trace, where it was cut, and over a gap.
    """

    surface: float = 3.0
    unseen: float = 4.0
    false_peak: float = 6.0
    on_rest: float = 0.2
    long_run: float = 0.2
    anchor: float = 4.0
    on_end: float = 1.0
    absent: float = 3.0
    tie_whole: float = 300.0
    tie_cut: float = 1.5
    tie_gap: float = 60.0


WEIGHTS = Weights()
