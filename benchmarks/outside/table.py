"""The table of all rigs and its Markdown page, from the results in JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.outside.reading import NO_SKEIN
from benchmarks.outside.scoring import CHAINS
from benchmarks.tables import Table

Row = Mapping[str, Any]
Rows = Sequence[Row]

VERDICTS = ("right", "wrong", "unknown", "none")
DEFECTIVE = ("henkei", "not-good")
"""What the paper's and the fuzzy rules call any defect, and `learned` a defect whose kind is in doubt."""


def tables(results: Rows) -> list[Table]:
    """Give a line for each rig, the worst volume first; then everything of each rig; then every body."""
    rows = [row for one in results for row in _rig_rows(one)]
    return [_summary(results), Table("Everything", ["rig", "what", "by", "result"], rows), _bodies(results)]


def _summary(results: Rows) -> Table:
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
    skeins, shapes = usual.get("skeins", []), usual.get("shapes", [])
    short = "{right:.2%}, {wrong:.0f} ppm"
    labels = [_labels(bodies, short) if bodies else "–" for bodies in (skeins, shapes)]
    volumes = [skeins, shapes, *(kinds.get(chain, {}).get("skeins", []) for chain in CHAINS[1:])]
    grades = [" / ".join(str(n) for n in _judged(bodies)) if bodies else "–" for bodies in (skeins, shapes)]
    off = [abs(body["visible"]["error"]) for body in skeins if "visible" in body]
    return float(np.mean(off)) if off else math.inf, [name, heights, *labels, *map(_short, volumes), *grades]


def _errors(bodies: Rows, which: str) -> tuple[np.ndarray, list[bool], float]:
    """Give the errors of what was measured, which of the stated intervals hold, and their median width."""
    known = [body[which] for body in bodies if which in body and math.isfinite(body[which]["error"])]
    stated = [one for one in known if one["holds"] is not None]
    width = float(np.median([one["width"] for one in stated])) if stated else math.nan
    return np.array([one["error"] for one in known]), [one["holds"] for one in stated], width


def _short(bodies: Rows) -> str:
    if not bodies:
        return "–"
    off, holds, width = _errors(bodies, "visible")
    text = f"{off.size} of {len(bodies)}" + (f", {np.abs(off).mean():.2%}" if off.size else "")
    return text + (f", {sum(holds)} hold, {width:.1%}" if holds else "")


def _volume(bodies: Rows, which: str) -> str:
    off, holds, width = _errors(bodies, which)
    split = sum(body["products"] > 1 for body in bodies)
    text = f"{off.size} of {len(bodies)} measured" + (f", {split} split" if split else "")
    if not off.size:
        return text
    interval = f"{sum(holds)} of {len(holds)} intervals hold, median width {width:.2%}"
    return (
        f"{text}; mean {off.mean():+.2%}, mean absolute {np.abs(off).mean():.2%}, "
        f"largest {np.abs(off).max():.2%}; {interval if holds else 'no interval stated'}"
    )


def _rig_rows(one: Row) -> list[list[str]]:
    name, rows = one["rig"], list[list[str]]()
    if "fault" in one:
        return [[name, "whole rig", "", f"left out: {one['fault']}"]]

    def add(what: str, by: str, result: str) -> None:
        rows.append([name, what, by, result])

    for target, found in one["calibration"].items():
        if found:
            add("calibration", target, _calibration(found))
    for extractor, found in one["peaks"].items():
        for where in ("body", "belt"):
            add(f"peaks on {where}", extractor, _peaks(found, where))
    by = "; the calibration is the true one" if one["labels_by_true_calibration"] else ""
    labelled: dict[str, str] = {}
    for chain, found in one["chains"].items():
        if "refused" in found:
            add("measuring", chain, f"not run: {found['refused']}")
            continue
        kinds = _kinds(found["bodies"])
        labels = {kind: _labels(bodies) + (by if chain != "paper" else "") for kind, bodies in kinds.items()}
        for kind, bodies in kinds.items():
            if labelled.get(kind) != labels[kind]:  # chains that code alike are told once
                add(f"labels, {kind}", chain, labels[kind])
            add(f"visible volume, {kind}", chain, _volume(bodies, "visible"))
            if any("true" in body for body in bodies):
                add(f"true volume, {kind}", chain, _volume(bodies, "true"))
            if any(body["grade"]["said"] for body in bodies):
                add(f"grade, {kind}", chain, _grades(bodies))
        labels["all peaks"] = _all_peaks(found["bodies"].values())
        if labelled.get("all peaks") != labels["all peaks"]:
            add("labels, all peaks", chain, labels["all peaks"])
        labelled |= labels
    for fault in one["faults"]:
        add("fault", "", fault)
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


_LABELS = (
    "{right:.2%} right, {wrong:.0f} ppm wrong, {refused:.2%} refused of {seen:.0f} points; "
    "{unseen:.2%} have no peak"
)


def _summed(bodies: Iterable[Row]) -> Counter[str]:
    total = Counter[str]()
    for body in bodies:
        total.update(body["labels"])
    return total


def _labels(bodies: Iterable[Row], words: str = _LABELS) -> str:
    total = _summed(bodies)
    seen = max(total["visible"] - total["unseen"], 1)
    return words.format(
        right=total["right"] / seen, wrong=1e6 * total["wrong"] / seen, refused=total["refused"] / seen,
        seen=seen, unseen=total["unseen"] / max(total["visible"], 1),
    )  # fmt: skip


def _all_peaks(bodies: Iterable[Row]) -> str:
    total = _summed(bodies)
    names = ("peaks_wrong", "peaks_stray", "peaks_at_rims", "peaks")
    wrong, stray, rims, count = (round(total[name]) for name in names)
    return f"{wrong} wrong, {stray} stray, {rims} at rims of {count} labelled, belt and edges included"


def grade_of(said: str | None, true: str) -> str:
    """Judge one grade: right, wrong, unknown or none."""
    if said is None:
        return "none"
    if said == "unknown":  # the right answer for a body that no class describes
        return "right" if true == NO_SKEIN else "unknown"
    if said in DEFECTIVE:  # any defect, not named
        return "wrong" if true in ("good", NO_SKEIN) else "right"
    return "right" if said == true else "wrong"


def _judged(bodies: Rows) -> list[int]:
    """Count the grades by verdict."""
    judged = [grade_of(body["grade"]["said"], body["grade"]["true"]) for body in bodies]
    return [judged.count(verdict) for verdict in VERDICTS]


def _grades(bodies: Rows) -> str:
    counts = ", ".join(f"{n} {verdict}" for verdict, n in zip(VERDICTS, _judged(bodies), strict=True))
    said = [(body["grade"]["said"], body["grade"]["true"]) for body in bodies]
    good = [one for one, true in said if true == "good"]
    bad = [one for one, true in said if true not in ("good", NO_SKEIN)]
    if not good and not bad:
        return counts
    caught = sum(one not in (None, "good", "unknown") for one in bad)
    return f"{counts}; good kept {good.count('good')} of {len(good)}, defects caught {caught} of {len(bad)}"


def _bodies(results: Rows) -> Table:
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
        volume, held = f"refused: {_shortened(body['refused'])}", ""
    grade = f"{body['grade']['said'] or '–'}, {body['grade']['true']}"
    return [volume, held, f"{label['right'] / seen:.2%}", f"{label['wrong'] / seen:.3%}", grade]


def _shortened(text: str) -> str:
    """Give the beginning of a sentence; all of it stands in the JSON."""
    return text if len(text) <= 70 else text[:70].rsplit(" ", 1)[0] + " …"
