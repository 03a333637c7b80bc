"""The parameter record of a skein, and the distributions it is drawn from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

KINDS = ("healthy", "dented", "bent", "twisted", "folded", "broken")
KIND_SHARES = (0.35, 0.18, 0.15, 0.13, 0.12, 0.07)

FURTHER_KINDS = ("s-bent", "several-dents")
"""Kinds that are made when asked for, and never drawn without: what a seed alone gives stays as it is."""


@dataclass(frozen=True)
class SkeinRecord:
    """All that makes a skein. Drawn from uniform distributions over the ranges given here.

    Attributes
    ----------
    seed : int
        What everything was drawn from.
    kind : str
        One of `KINDS` or `FURTHER_KINDS`.
    length_mm : float
        Along the mid-line, 70–105 (broken: of the whole skein, 90–105).
    width_mm : float
        20–34 in the middle of its length.
    thickness_mm : float
        Nominal height over the belt in the middle, 10–20, at most 0.68 of the width
        (folded: at most 16, before the flap).
    rim_height_mm : float
        Height of the widest line over its lowest point, 0.25–0.42 of the thickness.
    underside_power : float
        Roundness of the underside, 1 (half an ellipse) to 2.2 (flatter); at least 1.5 over a gap.
    air_gap_mm : float
        Largest air gap under the middle, which arches: 0,
        but 0–3 and at most 0.13 of the thickness for bent, s-bent and twisted ones.
    thick_end : float
        Growth of width and height from the middle to the thick end, 0.06–0.2 of either sign;
        positive is thick at the right.
    taper : float
        Share of the dome's height lost towards both ends, 0.25–0.55.
    bluntness : float
        Exponent of the outline's ends, 2.0–3.2.
    fullness : float
        0 is an elliptic cross-section, up to 0.5 is fuller.
    relief_mm : float
        Standard deviation of the fine relief, 0.04–0.10, over about 3 mm.
    bend_deg : float
        Turn of the mid-line from end to end, within ±12; bent ones 30–60 of either sign; for s-bent ones
        the turn of the right half, 25–45 of either sign, and the left half turns back by as much.
    yaw_deg : float
        Turn from belt X, within ±15.
    centre_x_mm, centre_y_mm : float
        Where the middle lies, within ±5 and ±6; a scene may move it along X to where the stripes are.
    defect_along, defect_across : float
        Where the defect is: a (−0.55…0.55), and v as a share of the half width (−0.35…0.35). Of several
        dents (2–4) this is the first; the others are drawn from the seed, over the same ranges.
    defect_depth_mm : float
        2–6, at most half of the dome; 0 for healthy ones.
    defect_length_mm, defect_width_mm : float
        Its full extent along and across the mid-line, 5–20.
    defect_angle_deg : float
        Phase of a twist (0–360), or slant of a fold's, crease's or break's line (−50…50).
    """

    seed: int
    kind: str
    length_mm: float
    width_mm: float
    thickness_mm: float
    rim_height_mm: float
    underside_power: float
    air_gap_mm: float
    thick_end: float
    taper: float
    bluntness: float
    fullness: float
    relief_mm: float
    bend_deg: float
    yaw_deg: float
    centre_x_mm: float
    centre_y_mm: float
    defect_along: float
    defect_across: float
    defect_depth_mm: float
    defect_length_mm: float
    defect_width_mm: float
    defect_angle_deg: float


def draw(seed: int, kind: str | None = None) -> SkeinRecord:
    """Draw a skein.

    Parameters
    ----------
    seed : int
        The same seed (and kind) gives the same skein.
    kind : str or None
        One of `KINDS` or `FURTHER_KINDS`; None draws one of `KINDS`, too, in the shares `KIND_SHARES`.

    Returns
    -------
    SkeinRecord
        Its parameters.
    """
    if kind is not None and kind not in KINDS + FURTHER_KINDS:
        known = ", ".join(KINDS + FURTHER_KINDS)
        raise ValueError(f"no kind of skein is called {kind!r}; there are {known}")
    rng = np.random.default_rng([seed, 3])
    drawn = str(rng.choice(KINDS, p=KIND_SHARES))
    kind = drawn if kind is None else kind
    between = rng.uniform
    length = between(90, 105) if kind == "broken" else between(70, 105)
    width = between(20, 34)
    thickness = between(10, min(20, 0.68 * width))
    record = SkeinRecord(
        seed=seed,
        kind=kind,
        length_mm=float(length),
        width_mm=float(width),
        thickness_mm=float(thickness),
        rim_height_mm=float(between(0.25, 0.42) * thickness),
        underside_power=float(between(1.0, 2.2)),
        air_gap_mm=0.0,
        thick_end=float(between(0.06, 0.20) * rng.choice([-1.0, 1.0])),
        taper=float(between(0.25, 0.55)),
        bluntness=float(between(2.0, 3.2)),
        fullness=float(between(0.0, 0.5)),
        relief_mm=float(between(0.04, 0.10)),
        bend_deg=float(between(-12, 12)),
        yaw_deg=float(between(-15, 15)),
        centre_x_mm=float(between(-5, 5)),
        centre_y_mm=float(between(-6, 6)),
        defect_along=float(between(-0.55, 0.55)),
        defect_across=float(between(-0.35, 0.35)),
        defect_depth_mm=0.0,
        defect_length_mm=float(between(5, 20)),
        defect_width_mm=float(between(5, 20)),
        defect_angle_deg=float(between(-50, 50)),
    )
    if kind == "healthy":
        return record
    deepest = 0.5 * (record.thickness_mm - record.rim_height_mm)
    record = replace(record, defect_depth_mm=float(min(between(2, 6), max(deepest, 2.0))))
    if kind in ("bent", "s-bent", "twisted"):
        gap = between(0, 3)
        record = replace(
            record,
            air_gap_mm=float(min(gap, 0.13 * record.thickness_mm)),
            underside_power=max(record.underside_power, 1.5),
        )
    if kind == "bent":
        record = replace(record, bend_deg=float(between(30, 60) * rng.choice([-1.0, 1.0])))
    if kind == "s-bent":
        record = replace(record, bend_deg=float(between(25, 45) * rng.choice([-1.0, 1.0])))
    if kind == "folded":
        # a fold doubles what is there, and comes of the thinner ones
        share = min(1.0, 16.0 / record.thickness_mm)
        record = replace(
            record, thickness_mm=share * record.thickness_mm, rim_height_mm=share * record.rim_height_mm
        )
    if kind == "twisted":
        record = replace(record, defect_angle_deg=float(between(0, 360)))
    return record
