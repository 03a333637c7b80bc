"""The table of all rigs and its Markdown page, from the results in JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.outside.reading import NO_SKEIN
from benchmarks.outside.scoring import CHAINS
from benchmarks.tables import Table

Row = Mapping[str, Any]

VERDICTS = ("right", "wrong", "unknown", "none")
DEFECTIVE = "henkei"
"""What the paper's rule and the fuzzy rules call a skein with any defect."""


def tables(results: Sequence[Row]) -> list[Table]:
    """Give a line for each rig, the worst volume first; then everything of each rig; then every body."""
    rows = [row for one in results for row in _rig_rows(one)]
    return [_summary(results), Table("Everything", ["rig", "what", "by", "result"], rows), _bodies(results)]


def _summary(results: Sequence[Row]) -> Table:
    lines: list[tuple[float, list[str]]] = []
    pooled: dict[str, dict[str, dict[str, Row]]] = {chain: {"bodies": {}} for chain in CHAINS}
    for one in results:
        if "fault" in one:
            continue
        boards = one["calibration"]["boards"]
        heights = "refused" if "refused" in boards else f"{boards['rms_mm']:.4f}"
        lines.append(_line(one["rig"], heights, one["chains"]))
        for chain, found in one["chains"].items():
            bodies = found.get("bodies", {})
            pooled[chain]["bodies"] |= {f"{one['rig']}/{name}": body for name, body in bodies.items()}
    lines.sort(key=lambda line: -line[0])
    if len(lines) > 1:
        lines.append(_line("all", "", pooled))
    columns = [
        "rig", "heights rms, mm", "labels: skeins", "shapes", "skeins: plain outline", "shapes",
        "skeins: laser outline", "no outline", "the paper's recipe", "grades: skeins", "shapes",
    ]  # fmt: skip
    title = (
        "Rigs, the worst first. Labels: right, wrong. Volume: measured of all, mean absolute error of the "
        "visible volume, intervals that hold, their median width. Grades: right / wrong / unknown / none"
    )
    return Table(title, columns, [cells for _, cells in lines])


def _line(name: str, heights: str, chains: Row) -> tuple[float, list[str]]:
    """Give a rig's line, and the error of its skeins' volume, by which lines are ordered."""
    kinds = {chain: _kinds(found.get("bodies", {})) for chain, found in chains.items()}
    usual = kinds.get("plain outline", {})
    cells = [name, heights]
    for kind in ("skeins", "shapes"):
        total = _summed(usual.get(kind, []))
        seen = max(total.get("visible", 0) - total.get("unseen", 0), 1)
        right, wrong = total.get("right", 0) / seen, 1e6 * total.get("wrong", 0) / seen
        cells.append(f"{right:.2%}, {wrong:.0f} ppm" if total else "–")
    cells += [_short_volume(usual.get(kind, [])) for kind in ("skeins", "shapes")]
    cells += [_short_volume(kinds.get(chain, {}).get("skeins", [])) for chain in CHAINS[1:]]
    for kind in ("skeins", "shapes"):
        judged = [grade_of(body["grade"]["said"], body["grade"]["true"]) for body in usual.get(kind, [])]
        cells.append(" / ".join(str(judged.count(word)) for word in VERDICTS) if judged else "–")
    return _mean_absolute(usual.get("skeins", [])), cells


def _mean_absolute(bodies: Sequence[Row]) -> float:
    off = [abs(body["visible"]["error"]) for body in bodies if "visible" in body]
    return float(np.mean(off)) if off else math.inf


def _short_volume(bodies: Sequence[Row]) -> str:
    if not bodies:
        return "–"
    known = [body["visible"] for body in bodies if "visible" in body]
    if not known:
        return f"0 of {len(bodies)}"
    text = f"{len(known)} of {len(bodies)}, {_mean_absolute(bodies):.2%}"
    stated = [one for one in known if one["holds"] is not None]
    if stated:
        width = np.median([one["width"] for one in stated])
        text += f", {sum(one['holds'] for one in stated)} hold, {width:.1%}"
    return text


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
    labelled: dict[str, str] = {}
    for chain, found in one["chains"].items():
        if "refused" in found:
            rows.append([name, "measuring", chain, f"not run: {found['refused']}"])
            continue
        for kind, bodies in _kinds(found["bodies"]).items():
            text = _labels(bodies) + (by if chain != "paper" else "")
            if labelled.get(kind) != text:  # chains that code alike are told once
                rows.append([name, f"labels, {kind}", chain, text])
            labelled[kind] = text
            rows.append([name, f"visible volume, {kind}", chain, _volume(bodies, "visible")])
            if any("true" in body for body in bodies):
                rows.append([name, f"true volume, {kind}", chain, _volume(bodies, "true")])
            if any(body["grade"]["said"] for body in bodies):
                rows.append([name, f"grade, {kind}", chain, _grades(bodies)])
        text = _all_peaks(found["bodies"].values())
        if labelled.get("all peaks") != text:
            rows.append([name, "labels, all peaks", chain, text])
        labelled["all peaks"] = text
    rows += [[name, "fault", "", fault] for fault in one["faults"]]
    return rows


def _kinds(bodies: Mapping[str, Row]) -> dict[str, list[Row]]:
    """Part the bodies into skeins and other shapes."""
    parts: dict[str, list[Row]] = {"skeins": [], "shapes": []}
    for body in bodies.values():
        parts["shapes" if body["grade"]["true"] == NO_SKEIN else "skeins"].append(body)
    return {kind: found for kind, found in parts.items() if found}


def _calibration(found: Row) -> str:
    if "refused" in found:
        return f"refused: {found['refused']}"
    low, high = found["range_mm"]
    ratio = found["real_over_stated"]
    said = "uncertainty not stated" if math.isnan(ratio) else f"real/stated {ratio:.2f}"
    for name, share in found.get("left_out", {}).items():
        said += f"; {share:.1%} of the {name.removesuffix('_left_out')} left out"
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
    total = _summed(bodies)
    seen = max(total.get("visible", 0) - total.get("unseen", 0), 1)
    unseen = total.get("unseen", 0) / max(total.get("visible", 0), 1)
    return (
        f"{total.get('right', 0) / seen:.2%} right, {1e6 * total.get('wrong', 0) / seen:.0f} ppm wrong, "
        f"{total.get('refused', 0) / seen:.2%} refused of {seen:.0f} points; {unseen:.2%} have no peak"
    )


def _all_peaks(bodies: Iterable[Row]) -> str:
    total = _summed(bodies)
    names = ("peaks_wrong", "peaks_stray", "peaks_at_rims", "peaks")
    wrong, stray, rims, count = (round(total.get(name, 0)) for name in names)
    return f"{wrong} wrong, {stray} stray, {rims} at rims of {count} labelled, belt and edges included"


def _summed(bodies: Iterable[Row]) -> dict[str, float]:
    total: dict[str, float] = {}
    for body in bodies:
        for key, value in body["labels"].items():
            total[key] = total.get(key, 0) + value
    return total


def _volume(bodies: Sequence[Row], which: str) -> str:
    known = [body[which] for body in bodies if which in body and math.isfinite(body[which]["error"])]
    split = sum(body["products"] > 1 for body in bodies)
    parts = f", {split} split" if split else ""
    if not known:
        return f"0 of {len(bodies)} measured{parts}"
    off = np.array([one["error"] for one in known])
    stated = [one for one in known if one["holds"] is not None]
    interval = "no interval stated"
    if stated:
        width, held = np.median([one["width"] for one in stated]), sum(one["holds"] for one in stated)
        interval = f"{held} of {len(stated)} intervals hold, median width {width:.2%}"
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
    if said == DEFECTIVE:  # the paper's word for any defect
        return "wrong" if true == "good" else "right"
    return "right" if said == true else "wrong"


def _grades(bodies: Iterable[Row]) -> str:
    said = [(body["grade"]["said"], body["grade"]["true"]) for body in bodies]
    judged = [grade_of(*one) for one in said]
    counts = ", ".join(f"{judged.count(name)} {name}" for name in VERDICTS)
    good = [one for one, true in said if true == "good"]
    bad = [one for one, true in said if true not in ("good", NO_SKEIN)]
    if not good and not bad:
        return counts
    caught = sum(one not in (None, "good", "unknown") for one in bad)
    return f"{counts}; good kept {good.count('good')} of {len(good)}, defects caught {caught} of {len(bad)}"


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
