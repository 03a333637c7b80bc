"""The table of all rigs and its Markdown page, from the results in JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.extraction.tables import Table
from benchmarks.outside.reading import NO_SKEIN

Row = Mapping[str, Any]


def tables(results: Sequence[Row]) -> list[Table]:
    """Give one table of everything over all rigs, and one of each body."""
    rows: list[list[str]] = []
    for one in results:
        rows += _rig_rows(one)
    return [
        Table("Rendered rigs against their truth", ["rig", "what", "by", "result"], rows),
        _bodies(results),
    ]


def _rig_rows(one: Row) -> list[list[str]]:
    name = one["rig"]
    if "fault" in one:
        return [[name, "whole rig", "", f"left out: {one['fault']}"]]
    rows = []
    for target, found in one["calibration"].items():
        if found:
            rows.append([name, "calibration", target, _calibration(found)])
    for extractor, found in one["peaks"].items():
        for where in ("body", "belt"):
            rows.append([name, f"peaks on {where}", extractor, _peaks(found, where)])
    by = "; the calibration is the true one" if one["labels_by_true_calibration"] else ""
    for chain, found in one["chains"].items():
        if "refused" in found:
            rows.append([name, "measuring", chain, f"not run: {found['refused']}"])
            continue
        bodies = found["bodies"]
        shown = by if chain != "paper" else ""
        rows.append([name, "labels", chain, _labels(bodies.values()) + shown])
        rows.append([name, "visible volume", chain, _volume(bodies.values(), "visible")])
        rows.append([name, "true volume", chain, _volume(bodies.values(), "true")])
        rows.append([name, "grade", chain, _grades(bodies.values())])
    rows += [[name, "fault", "", fault] for fault in one["faults"]]
    return rows


def _calibration(found: Row) -> str:
    if "refused" in found:
        return f"refused: {found['refused']}"
    low, high = found["range_mm"]
    ratio = found["real_over_stated"]
    said = "uncertainty not stated" if math.isnan(ratio) else f"real/stated {ratio:.2f}"
    return (
        f"heights of {low:g} to {high:g} mm: rms {found['rms_mm']:.4f} mm (lower half "
        f"{found['rms_lower_half_mm']:.4f}), largest {found['max_mm']:.4f} mm; {said}"
    )


def _peaks(found: Row, where: str) -> str:
    if "refused" in found:
        return f"refused: {found['refused']}"
    if not found.get(f"{where}_found"):
        return "none found"
    count, missed = found[f"{where}_found"], found[f"{where}_missed"]
    ratio = found.get(f"{where}_stated_over_observed")
    said = "not stated" if ratio is None else f"stated/observed {ratio:.2f}"
    false = f", {found['false']} false in all" if where == "belt" else ""
    return (
        f"{count} found, {missed} missed ({missed / (count + missed):.2%}){false}; rms "
        f"{found[f'{where}_rms_px']:.3f} px, mean {found[f'{where}_mean_px']:+.3f} px; {said}"
    )


def _labels(bodies: Iterable[Row]) -> str:
    total: dict[str, float] = {}
    for body in bodies:
        for key, value in body["labels"].items():
            total[key] = total.get(key, 0) + value
    seen = max(total.get("visible", 0) - total.get("unseen", 0), 1)
    return (
        f"{total.get('right', 0) / seen:.2%} right, {1e6 * total.get('wrong', 0) / seen:.0f} ppm wrong, "
        f"{total.get('refused', 0) / seen:.2%} refused of {seen:.0f} points"
    )


def _volume(bodies: Iterable[Row], which: str) -> str:
    bodies = list(bodies)
    known = [body[which] for body in bodies if which in body and math.isfinite(body[which]["error"])]
    split = sum(body["products"] > 1 for body in bodies)
    parts = f", {split} split" if split else ""
    if not known:
        return f"0 of {len(bodies)} measured{parts}"
    off = np.array([one["error"] for one in known])
    held = [one["holds"] for one in known if one["holds"] is not None]
    widths = [one["width"] for one in known if one["holds"] is not None]
    interval = "no interval stated"
    if held:
        interval = f"{sum(held)} of {len(held)} intervals hold, median width {np.median(widths):.2%}"
    return (
        f"{len(known)} of {len(bodies)} measured{parts}; mean {off.mean():+.2%}, mean absolute "
        f"{np.abs(off).mean():.2%}, largest {np.abs(off).max():.2%}; {interval}"
    )


def grade_of(said: str | None, true: str) -> str:
    """Judge one grade: right, wrong, unknown or none."""
    if said is None:
        return "none"
    if true == NO_SKEIN:  # a body that no class describes: `unknown` is the right answer
        return "right" if said == "unknown" else "wrong"
    if said == "unknown":
        return "unknown"
    return "right" if said == true else "wrong"


def _grades(bodies: Iterable[Row]) -> str:
    judged = [grade_of(body["grade"]["said"], body["grade"]["true"]) for body in bodies]
    return ", ".join(f"{judged.count(name)} {name}" for name in ("right", "wrong", "unknown", "none"))


def shortened(text: str, length: int = 70) -> str:
    """Give the beginning of a sentence; all of it stands in the JSON."""
    return text if len(text) <= length else text[:length].rsplit(" ", 1)[0] + " …"


def _bodies(results: Sequence[Row]) -> Table:
    """Give a row for each body, the worst first."""
    rows = []
    for one in results:
        for chain, found in one.get("chains", {}).items():
            for name, body in found.get("bodies", {}).items():
                error = body["visible"]["error"] if "visible" in body else math.inf
                rows.append((-abs(error), [one["rig"], name, chain, *_body(body)]))
    rows.sort(key=lambda pair: pair[0])
    columns = ["rig", "body", "chain", "visible volume", "interval", "labels right", "wrong", "grade, true"]
    return Table("Every body, the worst first", columns, [cells for _, cells in rows])


def _body(body: Row) -> list[str]:
    label, seen = body["labels"], max(body["labels"]["visible"] - body["labels"]["unseen"], 1)
    if "visible" in body:
        held = {None: "not stated", True: "holds", False: "does not hold"}[body["visible"]["holds"]]
        volume = f"{body['visible']['error']:+.2%}"
        held += "" if math.isnan(body["visible"]["width"]) else f", {body['visible']['width']:.2%} wide"
    else:
        volume, held = f"refused: {shortened(body['refused'])}", ""
    grade = f"{body['grade']['said'] or '–'}, {body['grade']['true']}"
    return [volume, held, f"{label['right'] / seen:.2%}", f"{label['wrong'] / seen:.3%}", grade]
