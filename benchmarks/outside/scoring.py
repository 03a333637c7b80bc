"""Scores of one rig: its calibration, its peaks, and every body by every recipe, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.outside.reading import (
    NO_SKEIN,
    Body,
    Crossings,
    RenderedRig,
    RigError,
    camera_and_planes,
    lines_at,
    read_crossings,
    true_calibration,
)
from roemetry import Calibration, Recipe, Rig, RoemetryError, calibrate
from roemetry.io.yaml_source import read
from roemetry.records import AMBIGUOUS, Acquisition, Estimate, Measurement, Peaks, StripeMap, Trace
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.run.pipeline import Pipeline, frame_of
from roemetry.run.rows import measurements_of
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry.stages.registry import discover
from roemetry_tools.compare.stripes import REACH_PX, nearest

HIT_PX = 2.0
HEIGHTS_MM = 9
"""Levels over the calibrated range at which heights are compared."""
RIM_ROWS = 2
"""Rows about a peak where a crossing of its stripe excuses it: at a rim light reaches over the exact edge."""
DRAWS = 40
"""Redrawn calibrations: their standard deviation is known to 11 %."""

PAPER = Path(__file__).resolve().parents[2] / "recipes" / "herring_roe" / "recipe.yaml"
CHAINS = ("plain outline", "laser outline", "no outline", "paper")

Row = dict[str, Any]


def calibrated(rig: RenderedRig, folder: Path, file: str) -> tuple[Calibration | None, Row]:
    """Calibrate as a user would, and compare with the truth; None with the reason where it is refused."""
    try:
        found = calibrate(Rig.load(folder / file))
    except RoemetryError as error:
        return None, {"refused": _sentence(error)}
    found.save(folder / f"{Path(file).stem}_calibration.yaml")
    left_out = {name: float(value) for name, value in found.residuals.items() if name.endswith("left_out")}
    return found, heights(found, rig) | {"left_out": left_out}


def heights(calibration: Calibration, rig: RenderedRig) -> Row:
    """Compare heights of exact crossings, over the image and the calibrated range, with the truth."""
    stage = discover().load(discover().find("triangulator", calibration.method))()
    true = camera_and_planes(rig.truth)
    rows, columns = true.image_size
    count = len(true.planes)
    if (count, true.image_size) != (calibration.stripe_count, calibration.image_size):
        made = f"calibrated are {calibration.stripe_count} stripes in {calibration.image_size}"
        return {"refused": f"{made}; the truth has {count} in {true.image_size}"}
    low, high = calibration.height_range_mm
    levels, maps = np.linspace(low, high, HEIGHTS_MM), []
    row_px = np.arange(rows, dtype=np.float64)
    for level in levels:
        x_px = lines_at(true, float(level), row_px)
        x_px[(x_px < 0) | (x_px > columns - 1)] = np.nan
        maps.append(_exact_map(x_px, calibration.rest_line_px(row_px)))

    def off(one: Calibration) -> Floats:
        return np.array(
            [stage.triangulate(it, one).xyz_mm[:, :, 2] - z for it, z in zip(maps, levels, strict=True)]
        )

    found = off(calibration)
    drawn = calibration.redraws(np.random.default_rng(7), stage.view)
    std = np.std([off(one) for _, one in zip(range(DRAWS), drawn, strict=False)], axis=0)
    usual = found[levels <= 0.5 * (low + high)]
    stated = np.isfinite(found) & (std > 0)
    return {
        "range_mm": [low, high],
        "rms_mm": _rms(found),
        "rms_lower_half_mm": _rms(usual),
        "max_mm": float(np.nanmax(np.abs(found))),
        "stated_mm": _rms(std[stated]),
        "real_over_stated": _rms(found[stated] / std[stated]),
    }


def _exact_map(x_px: Floats, rest_px: Floats) -> StripeMap:
    """Give exact crossings as a coder would."""
    seen = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px, x_std_px=np.where(seen, 0.0, np.nan), product=np.where(seen, 0, -1).astype(np.int16),
        seen=seen, margin=np.where(seen, 1.0, np.nan), ambiguous=np.zeros_like(seen), rest_px=rest_px,
        peak_stripe=np.zeros(0, np.int16),
    )  # fmt: skip


def peaks(found: Peaks, true: Crossings) -> Row:
    """Compare one image's peaks with the truth; sums add up over images."""
    at = nearest(true.row, true.x_px, found.row, found.x_px)
    off = np.where(at >= 0, found.x_px[at] - true.x_px, np.nan)
    hit = true.sure & (np.abs(off) <= HIT_PX)
    of = nearest(found.row, found.x_px, true.row, true.x_px)
    row: Row = {"crossings": int(true.sure.sum()), "false": int((of < 0).sum())}
    for name, where in (("body", hit & true.on_body), ("belt", hit & ~true.on_body)):
        std = found.x_std_px[at[where]]
        has = np.isfinite(std) & (std > 0)
        row |= {
            f"{name}_found": int(where.sum()),
            f"{name}_missed": int((true.sure & (true.on_body == (name == "body"))).sum() - where.sum()),
            f"{name}_sum_px": float(off[where].sum()),
            f"{name}_square_px2": float((off[where] ** 2).sum()),
            f"{name}_stated": int(has.sum()),
            f"{name}_stated_square_px2": float((std[has] ** 2).sum()),
            f"{name}_observed_square_px2": float((off[where][has] ** 2).sum()),
        }
    return row


def labels(trace: Trace, true: Crossings) -> Row:
    """Compare one image's labels with the truth: visible points of the body, see the definitions."""
    visible = true.on_body & true.sure
    row: Row = {"visible": int(visible.sum()), "unseen": 0, "right": 0, "wrong": 0, "refused": 0}
    if trace.peaks is None:
        return row | {"unseen": row["visible"]}
    found = trace.peaks
    at = nearest(true.row, true.x_px, found.row, found.x_px)
    seen = visible & (at >= 0)
    row["unseen"] = int((visible & (at < 0)).sum())
    if trace.stripes is None:
        return row | {"refused": int(seen.sum())}
    said = trace.stripes.peak_stripe.astype(np.int64)
    of = nearest(found.row, found.x_px, true.row, true.x_px)
    # A peak is wrong only when the nearest crossing to the peak, too, is another stripe's.
    right = seen & (said[at] == true.stripe)
    given = np.where(said >= 0, said, -1)
    meant = of[at]
    wrong = seen & ~right & (given[at] >= 0) & (true.stripe[meant] != given[at])
    known, given_any = of >= 0, given >= 0
    strange = given_any & ~(known & (true.stripe[of] == given))
    at_home = np.zeros_like(strange)
    at_home[strange] = _crosses_near(found.row[strange], found.x_px[strange], given[strange], true)
    astray = strange & ~at_home
    heights_off = _heights_off(trace, true, right)
    return row | {
        "right": int(right.sum()),
        "wrong": int(wrong.sum()),
        "refused": int((seen & (given[at] < 0)).sum()),
        "shared": int((seen & ~right & ~wrong & (given[at] >= 0)).sum()),
        "ambiguous": int((seen & (said[at] == AMBIGUOUS)).sum()),
        "peaks": int(given_any.sum()),
        "peaks_at_rims": int(at_home.sum()),
        "peaks_wrong": int((astray & known).sum()),
        "peaks_stray": int((astray & ~known).sum()),
        "heights": int(heights_off.size),
        "heights_sum_mm": float(heights_off.sum()),
        "heights_square_mm2": float((heights_off**2).sum()),
    }


def _crosses_near(row: Integers, x_px: Floats, stripe: Integers, true: Crossings) -> Flags:
    """Say which peaks have a crossing of the stripe they name within reach, in their row or one beside it."""
    near = np.zeros(row.size, np.bool_)
    for k in range(row.size):  # some hundred peaks of an image
        same = (true.stripe == stripe[k]) & (np.abs(true.row - row[k]) <= RIM_ROWS)
        near[k] = bool((np.abs(true.x_px[same] - x_px[k]) <= REACH_PX).any())
    return near


def _heights_off(trace: Trace, true: Crossings, right: Any) -> Floats:
    """Give the height errors of the points whose label is right, mm."""
    if trace.profiles is None:
        return np.empty(0)
    z = trace.profiles.xyz_mm[true.stripe[right], true.row[right], 2] - true.z_mm[right]
    near = trace.profiles.x_px[true.stripe[right], true.row[right]] - true.x_px[right]
    return np.asarray(z[np.isfinite(z) & (np.abs(near) <= HIT_PX)])


def body_row(body: Body, trace: Trace, rows: Sequence[Measurement], true: Crossings) -> Row:
    """Score what one recipe said of one body."""
    row: Row = {"labels": labels(trace, true), "products": sum(one.product > 0 for one in rows)}
    chosen = _largest(trace, rows)
    if chosen.volume is None:
        why = chosen.absent.get("volume") or next(iter((*chosen.absent.values(), *chosen.reasons)), None)
        row["refused"] = why.text if why else "no product"
    else:
        row["visible"] = _against(chosen.volume.visible_mm3, body.topview_mm3)
        if chosen.volume.true_mm3 is not None and body.grade != NO_SKEIN:  # the share is a skein's
            row["true"] = _against(chosen.volume.true_mm3, body.volume_mm3)
    row["grade"] = {
        "true": body.grade,
        "said": None if chosen.grade is None else chosen.grade.label,
        "probability": math.nan if chosen.grade is None else chosen.grade.probability,
    }
    return row


def _largest(trace: Trace, rows: Sequence[Measurement]) -> Measurement:
    """Give the row of the product with most points: a body that was split shows its larger part."""
    if trace.stripes is None or len(rows) == 1:
        return rows[0]
    sizes = {one.product: int((trace.stripes.product == one.product).sum()) for one in rows}
    return max(rows, key=lambda one: sizes[one.product])


def _against(found: Estimate, truth: float) -> Row:
    low, high = found.interval
    stated = math.isfinite(low) and math.isfinite(high) and math.isfinite(truth)
    return {
        "error": found.value / truth - 1.0,
        "holds": bool(low <= truth <= high) if stated else None,
        "width": (high - low) / truth if stated else math.nan,
    }


def recipes_of(
    rig: RenderedRig, folder: Path, boards: Calibration | None, block: Calibration | None, draws: int | None
) -> dict[str, Recipe | str]:
    """Give the recipe of each chain, or the sentence why there is none."""
    if boards is None:
        true_calibration(rig.truth, _tallest_mm(rig)).save(folder / "calibration.yaml")
    else:
        boards.save(folder / "calibration.yaml")
    files = dict.fromkeys(CHAINS, "with_outline.yaml") | {"laser outline": "laser_outline.yaml"}
    made: dict[str, Recipe | str] = {}
    for chain in CHAINS:
        try:
            if chain == "paper":
                if block is None:
                    made[chain] = "no calibration by the block"
                    continue
                data = read(PAPER).data
                data["source"] = {"path": "images"}
                data["calibration"] = "block_rig_calibration.yaml"
            else:
                path = folder / files[chain]
                if not path.is_file():
                    made[chain] = f"{path.name}: missing"
                    continue
                data = read(path, path.name).data
                data.pop("draws", None)
                data |= {"uncertainty": "linear"} if draws is None else {"draws": draws}
                if chain == "no outline":
                    data["source"].get("options", {}).pop("plain", None)
                    data["stages"].pop("outliner", None)
                    data["stages"]["volume"] = {"use": "slice-pchip"}  # no true volume
            data["sinks"] = []
            made[chain] = Recipe.of(data, folder=folder)
        except RoemetryError as error:
            made[chain] = _sentence(error)
        except (AttributeError, KeyError, TypeError) as error:
            made[chain] = f"{chain}: the recipe cannot be read: {error}".replace("\n", " ")
    return made


def score_rig(
    rig: RenderedRig, folder: Path, draws: int | None, extractors: Sequence[str], chains: Sequence[str]
) -> Row:
    """Take one rig through everything, in a copy of its folder that may be written into.

    `draws` are Monte Carlo draws of the recipes with an outline (None: linearised uncertainties); the
    extractors are compared on every body's image; of `CHAINS` the given ones are run.
    """
    faults = list(rig.faults)
    boards, by_boards = calibrated(rig, folder, "boards.yaml")
    block, by_block = calibrated(rig, folder, "block_rig.yaml") if "paper" in chains else (None, {})
    result: Row = {
        "rig": rig.name, "calibration": {"boards": by_boards, "block": by_block},
        "labels_by_true_calibration": boards is None, "peaks": {}, "chains": {}, "faults": faults,
    }  # fmt: skip
    recipes = recipes_of(rig, folder, boards, block, draws)
    truths: dict[str, Crossings] = {}
    for body in rig.bodies:
        try:
            planes = len(rig.truth["laser"]["planes_belt"])
            truths[body.name] = read_crossings(rig.folder / body.truth, rig.image_size, planes)
        except RigError as fault:
            faults.append(f"{body.name}: {fault}; the body is left out")
    usual = next((one for one in recipes.values() if isinstance(one, Recipe)), None)
    if usual is not None:
        for name in extractors:
            result["peaks"][name] = _peaks_by(name, usual, truths, faults)
    runnable = {chain: one for chain in chains if isinstance(one := recipes[chain], Recipe)}
    measured = _measured(runnable, rig, truths, faults)
    for chain in chains:
        one = recipes[chain]
        result["chains"][chain] = {"refused": one} if isinstance(one, str) else {"bodies": measured[chain]}
    return result


def _measured(
    recipes: Mapping[str, Recipe], rig: RenderedRig, truths: Mapping[str, Crossings], faults: list[str]
) -> dict[str, dict[str, Row]]:
    """Measure every body by every recipe; the steps that recipes share are done once for each body."""
    memory = StageCache()
    stages = {chain: CachedStages(recipe, memory) for chain, recipe in recipes.items()}
    pipelines = {chain: Pipeline(recipe, stages=stages[chain].stages) for chain, recipe in recipes.items()}
    images = {
        chain: dict(_acquisitions(recipe, set(truths), faults, chain)) for chain, recipe in recipes.items()
    }
    found: dict[str, dict[str, Row]] = {chain: {} for chain in recipes}
    for body in rig.bodies:
        memory.clear()
        for chain, recipe in recipes.items():
            if body.name not in images[chain]:
                continue
            stages[chain].start()
            trace = pipelines[chain].trace(images[chain][body.name])
            rows = measurements_of(trace, recipe, recipe.hashes)
            found[chain][body.name] = body_row(body, trace, rows, truths[body.name])
    return found


def _peaks_by(name: str, recipe: Recipe, truths: Mapping[str, Crossings], faults: list[str]) -> Row:
    total: Row = {}
    try:
        stage = discover().load(discover().find("extractor", name))()
    except RoemetryError as error:
        return {"refused": _sentence(error)}
    for body, acquisition in _acquisitions(recipe, set(truths), faults, name):
        try:
            one = peaks(stage.extract(frame_of(recipe, acquisition)), truths[body])
        except RoemetryError as error:
            faults.append(f"{body}, {name}: {_sentence(error)}")
            continue
        total = {key: total.get(key, 0) + value for key, value in one.items()}
    for where in ("body", "belt"):
        count = total.get(f"{where}_found", 0)
        stated, has = total.get(f"{where}_stated_square_px2", 0.0), total.get(f"{where}_stated", 0)
        if count:
            total[f"{where}_rms_px"] = math.sqrt(total[f"{where}_square_px2"] / count)
            total[f"{where}_mean_px"] = total[f"{where}_sum_px"] / count
        if has:
            total[f"{where}_stated_over_observed"] = math.sqrt(stated / total[f"{where}_observed_square_px2"])
    return total


def _acquisitions(
    recipe: Recipe, names: set[str], faults: list[str], what: str
) -> list[tuple[str, Acquisition]]:
    """Read the images of the bodies; what cannot be read is a fault, and the rest goes on."""
    source, found = recipe.source.make(), []
    try:
        references = source.references(recipe.source_path)
    except RoemetryError as error:
        faults.append(f"{what}: {_sentence(error)}")
        return []
    for reference in references:
        if reference.id in names:
            try:
                found.append((reference.id, source.read(reference)))
            except RoemetryError as error:
                faults.append(f"{reference.id}, {what}: {_sentence(error)}")
    return found


def _tallest_mm(rig: RenderedRig) -> float:
    heights_mm = [float(one.get("max_height_mm") or 0.0) for one in rig.truth["objects"].values()]
    return max(40.0, *heights_mm)


def _sentence(error: RoemetryError) -> str:
    return " ".join(error.message.split())


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else math.nan
