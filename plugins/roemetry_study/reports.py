"""What each study says: its sentences and tables, as a certificate or as lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from roemetry.calibrating.known_products import read_table as read_csv
from roemetry.errors import ConfigurationError, DataError
from roemetry.html.plots import in_words
from roemetry.io.files import sha256_of
from roemetry.run.control_chart import BASELINE, limits_of, signals
from roemetry.run.executors import Executor, Lost
from roemetry.run.record import PROVENANCE, read_record
from roemetry_study.certificate import Certificate, Table
from roemetry_study.table import StudyTable, estimate_of

if TYPE_CHECKING:
    from roemetry.config.recipe import Recipe
    from roemetry_study.acceptance import Artefact, Value
    from roemetry_study.study_files import AcceptanceFile

_AIAG = "AIAG Measurement Systems Analysis, 4th edition, as published worked examples confirm it"


def of_numbers(table: StudyTable, *, tolerance: float, nested: bool, method: str, by: str) -> Certificate:
    """Make all that readings that are numbers allow: a gauge study or a type-1 study, bias, stability."""
    from roemetry_study.gauge import gauge_study
    from roemetry_study.reference import catchweigher_words, type_one

    statements: list[str] = []
    tables: list[Table] = []
    references = table.references()
    if len(table.parts) == 1 and references and math.isfinite(tolerance):
        found = type_one(table, tolerance)
        verdict, title = found.verdict, "type-1 gauge study"
        statements += found.words
        rows = (
            ("reference", found.reference, math.nan, math.nan),
            ("bias", found.bias.bias, found.bias.low, found.bias.high),
            ("standard deviation", found.std, math.nan, math.nan),
            ("Cg", found.cg, *found.cg_interval),
            ("Cgk", found.cgk, *found.cgk_interval),
        )
        tables.append(
            Table(f"Part {found.part}, {found.readings} readings", ("", table.value, "95 % from", "to"), rows)
        )
    else:
        study = gauge_study(table, tolerance=tolerance, nested=nested, method=method)
        verdict, title = study.verdict, "gauge study"
        statements += study.words
        if study.missing:
            statements.append(f"{study.missing} readings are missing; the analysis allows for them")
        head = ("source", "standard deviation", "95 % from", "to", "% of total", "6 s, % of tolerance")
        lines = tuple((line.name.replace("operator", by), *line[1:]) for line in study.lines)
        tables.append(Table(f"Variation of {table.value}", head, lines))
        if study.effects:
            head = ("effect", "sum of squares", "d.f.", "mean square", "F", "p")
            effects = tuple(
                (e.name.replace("operator", by), e.squares, e.freedom, e.mean_square, e.f, e.p)
                for e in study.effects
            )
            tables.append(Table("Analysis of variance", head, effects))
        low, high = study.categories_interval
        statements.append(
            f"number of distinct categories: {study.categories}"
            + (f" (95 %: {low:.1f} to {high:.1f})" if math.isfinite(low) else "")
        )
    if references and len(table.parts) > 1:
        words, made = _bias(table)
        statements += words
        tables.append(made)
        if table.value == "mass_g":
            statements.append(catchweigher_words(table))
    if any(reading.moment for reading in table.readings):
        words, made = _stability(table)
        statements += words
        tables.append(made)
    return Certificate(
        kind=title,
        verdict=verdict,
        statements=tuple(statements),
        method=(
            _AIAG,
            "intervals: generalised confidence intervals (Hamada and Weerahandi 2000), by simulation",
        ),
        items=_items(table, by),
        tables=tuple(tables),
        decision_rule="accepted up to 10 % GRR of the total variation, conditional up to 30 % (AIAG); "
        "type 1: Cg and Cgk at least 1.33",
    )


def of_classes(table: StudyTable, good: str) -> Certificate:
    """Make a study of agreement."""
    from roemetry_study.agreement import Figure, agreement

    def percent(figure: Figure) -> tuple[float, float, float]:
        return 100.0 * figure.value, 100.0 * figure.low, 100.0 * figure.high

    found = agreement(table, good)
    rows = []
    for one in found.operators:
        kappa = one.kappa.value, one.kappa.low, one.kappa.high
        shares = *percent(one.missed), *percent(one.false_alarm), 100.0 * one.bias
        rows.append((one.name, percent(one.repeats)[0], percent(one.right)[0], *kappa, *shares))
    head: tuple[str, ...] = ("by", "repeats, %", "right, %", "kappa", "from", "to", "missed, %", "from", "to")
    head += ("false alarms, %", "from", "to", "passed too many, %")
    pairs = tuple((f"{a} and {b}", one.value, one.low, one.high) for a, b, one in found.pairs)
    tables = [Table("Against itself and the reference", head, tuple(rows))]
    if pairs:
        tables.append(Table("Between operators, kappa", ("pair", "kappa", "95 % from", "to"), pairs))
    return Certificate(
        kind="agreement of classes",
        verdict="no decision",
        statements=found.words or (f"{found.readings} readings of {found.parts} parts",),
        method=(_AIAG, "kappa: Cohen for pairs, Fleiss over all; every interval by parts"),
        items=_items(table, "operator"),
        tables=tuple(tables),
        decision_rule="none: the shares missed and falsely alarmed are for the user's own limits",
    )


def _measured(recipe: Recipe, task: tuple[Path, Artefact]) -> list[Value]:
    """Measure an artefact in one image by a recipe."""
    from roemetry.calibrating.block_check import profiles_of
    from roemetry_study.acceptance import measure

    image, artefact = task
    profiles, light = profiles_of(recipe, image)
    view = None if recipe.calibration is None else recipe.calibration.view
    return list(measure(profiles, artefact, view, light))


def of_acceptance(file: AcceptanceFile, path: Path, executor: Executor) -> Certificate:
    """Measure every artefact with the line's recipe, and decide."""
    from roemetry.config.recipe import Recipe
    from roemetry_study.acceptance import CHARACTERISTICS, decide, overall
    from roemetry_study.study_files import artefact_of

    recipe = Recipe.load(path.parent / file.recipe)
    if recipe.calibration is None:
        raise DataError(f"{recipe.path}: there is no calibration to test")
    tasks: list[tuple[Path, Artefact]] = []
    items = {"instrument": file.name, "recipe": f"{recipe.path.name}, {recipe.sha256}"}
    items["calibration"] = recipe.calibration.sha256
    for part in file.artefacts:
        artefact = artefact_of(path.parent / part.target, part.std_mm)
        images = sorted({found for pattern in part.images for found in path.parent.glob(pattern)})
        if not images:
            raise ConfigurationError(f"{path}: artefacts: {part.images} names no image in {path.parent}")
        items[f"artefact {artefact.target.name}"] = part.certificate or "no certificate of its own"
        seen: dict[str, Path] = {}
        for image in images:
            digest = sha256_of(image)
            if seen.setdefault(digest, image) != image:
                raise DataError(f"{image}: is a copy of {seen[digest].name}: a copy is no repetition")
            tasks.append((image, artefact))
            items[f"image {image.name}"] = digest
    values: list[Value] = []
    rows: list[tuple[str | float, ...]] = []
    for (image, _), found in zip(tasks, executor.in_order(partial, (_measured, recipe), tasks), strict=True):
        if isinstance(found, Lost):
            raise DataError(f"{image}: {found.why}")
        values += found
        rows += [
            (image.name, CHARACTERISTICS[value.characteristic], value.what, value.measured_mm,
             value.calibrated_mm, value.error_mm, value.std_mm)
            for value in found
        ]  # fmt: skip
    limits = {name: limit for name, limit in file.limits_mm.model_dump().items() if limit is not None}
    outcomes = decide(values, limits)
    judged = tuple(
        (CHARACTERISTICS[o.characteristic], o.decision, o.worst.error_mm, o.limit_mm, o.count)
        for o in outcomes
    )
    decisions = ("characteristic", "decision", "largest error, mm", "limit, mm", "values")
    head = ("image", "characteristic", "of", "measured, mm", "calibrated, mm", "error, mm")
    return Certificate(
        kind="acceptance test",
        verdict=overall(outcomes),
        statements=tuple(outcome.words for outcome in outcomes),
        method=(
            "characteristics in the manner of ISO 10360-13 and VDI/VDE 2634 part 2; the standards' "
            "text was not at hand: numbers of positions, filters and the choice of points (D95) were not "
            "checked clause by clause",
            "spheres by least squares with free radius; planes by least squares",
        ),
        items=items,
        tables=(
            Table("Decisions", decisions, judged),
            Table("Every value", (*head, "u of calibrated, mm"), tuple(rows)),
        ),
        decision_rule="accepted where the largest error lies within the limit less 1.645 standard "
        "uncertainties of the calibrated value, rejected beyond the limit plus as much, else "
        "undecided (ISO 14253-1, 95 %)",
        environment=file.environment,
    )


def of_calibration(path: Path, environment: str) -> Certificate:
    """Certify a calibration: what it was made from, its residuals, and how uncertain heights are."""
    from roemetry.calibrating.evidence import height_uncertainty
    from roemetry.records.calibration import Calibration
    from roemetry.stages.registry import discover

    calibration = Calibration.load(path)
    registry = discover()
    triangulator = registry.load(registry.find("triangulator", calibration.method))()
    found = height_uncertainty(calibration, triangulator)
    rows = []
    for height, std in zip(found.height_mm, np.moveaxis(found.std_mm, 1, 0), strict=True):
        known = std[np.isfinite(std)]
        if known.size:
            worst = float(known.max())
            rows.append((float(height), float(np.median(known)), worst, 2.0 * worst))
    residuals = tuple((in_words(name), float(value)) for name, value in calibration.residuals.items())
    low, high = calibration.height_range_mm
    worst = max((row[2] for row in rows), default=math.nan)
    statements = [
        f"{calibration.stripe_count} stripes, heights from {low:g} to {high:g} mm, by {calibration.method}",
        f"the calibration makes heights uncertain by at most {worst:.4f} mm (standard uncertainty)",
        *calibration.notes,
    ]
    if calibration.poor:
        statements.insert(0, f"not usable: accepted though its own checks refused it: {calibration.poor}")
    items = {"calibration": calibration.sha256, "made": calibration.made, "file": path.name}
    items |= {f"target {name}": str(value) for name, value in calibration.target.items()}
    items |= {f"image {name}": digest for name, digest in calibration.image_sha256.items()}
    head = ("height, mm", "median u, mm", "largest u, mm", "largest U (k = 2), mm")
    return Certificate(
        kind="calibration",
        verdict="not usable" if calibration.poor else "usable",
        statements=tuple(statements),
        method=(f"calibrator {calibration.method}; uncertainty of heights by its covariance (JCGM 101)",),
        items=items,
        tables=(
            Table("Uncertainty of heights, the calibration's part", head, tuple(rows)),
            Table("Residuals", ("figure", "value"), residuals),
        ),
        decision_rule="usable where the calibrator's own checks and held-out boards pass",
        coverage="U is for k = 2, about 95 %",
        environment=environment,
    )


def of_run(folder: Path, value: str, references: Path | None) -> tuple[list[str], bool]:
    """Give a run's uncertainty by cause, its comparison with references, and whether it is confirmed."""
    from roemetry_study.uncertainty import causes, compare, comparison_words, more_outside_than_chance

    rows = list(read_record(folder))
    std, found = causes(rows, value)
    lines = [f"{value}: standard uncertainty {std:.4g}, root mean square over the run"]
    said = False
    for count, one in enumerate(found, start=1):
        remains = ""
        if math.isfinite(one.to_halve_percent) and not said:
            which = "this" if count == 1 else f"these {count}"
            remains = f"; the whole would be halved if {which} shrank to {one.to_halve_percent:.0f} % each"
            said = True
        lines.append(f"  {one.name:20} {one.std:10.4g}  {one.percent:5.1f} % of the variance{remains}")
    if references is None:
        return lines, True
    pairs = compare(rows, value, _references(references))
    lines.append("\nproduct               value     std  reference     std     Eₙ      ζ")
    for pair in pairs:
        lines.append(
            f"{pair.id:16} {pair.value:10.4g} {pair.std:7.2g} {pair.reference:10.4g} "
            f"{pair.reference_std:7.2g} {pair.en:+6.2f} {pair.zeta:+6.2f}"
        )
    return lines + list(comparison_words(pairs)), not more_outside_than_chance(pairs)


def of_model(path: Path) -> list[str]:
    """Give a measurement model's value both ways."""
    from roemetry_study.study_files import read_model
    from roemetry_study.uncertainty import evaluate

    file, model = read_model(path)
    with np.errstate(all="ignore"):
        found = evaluate(model, {name: one.made() for name, one in file.inputs.items()}, seed=1)
    if not all(map(math.isfinite, (*found.gum, *found.monte_carlo))):
        raise DataError(
            f"{path}: the formula gives no number at these inputs", hint="is something divided by zero?"
        )
    lines = [f"{file.quantity} = {found.monte_carlo.value:.6g}"]
    for name, result in (("JCGM 101", found.monte_carlo), ("JCGM 100", found.gum)):
        lines.append(f"  {name}: u = {result.std:.4g}, 95 % from {result.low:.6g} to {result.high:.6g}")
    lines.append(
        "  JCGM 100 is good enough here"
        if found.validated
        else "  take the interval of JCGM 101: the linear law is not good enough here (JCGM 101, clause 8)"
    )
    for name, part in sorted(found.parts.items(), key=lambda item: -item[1]):
        lines.append(
            f"  {name:20} adds {part:.4g}, {100.0 * (part / found.gum.std) ** 2:.1f} % of the variance"
        )
    return lines


def of_plan(
    part_std: float | None,
    repeatability_std: float | None,
    operator_std: float,
    run: Path | None,
    value: str,
    half_width: float | None,
    weigh_std: float | None,
    weigh_half_width: float,
    executor: Executor,
) -> Iterator[str]:
    """Say how large a study must be."""
    from roemetry_study.gauge import plan, samples_for_mean

    if run is not None:
        found = [estimate_of(row, value) for row in read_record(run)]
        known = [
            (scale * one.value, scale * one.std) for one, scale in found if one and math.isfinite(one.value)
        ]
        values, stds = np.array(known).reshape(-1, 2).T
        if part_std is None and values.size > 2:
            part_std = float(values.std(ddof=1))
        if repeatability_std is None and np.isfinite(stds).any():
            repeatability_std = float(np.sqrt(np.nanmean(stds**2)))
            yield "repeatability: as large as the run's stated uncertainty, which is an upper bound for it"
    if weigh_std is not None:
        count = samples_for_mean(weigh_std, weigh_half_width)
        yield f"{count} weighed samples fix the mean of mass over volume to ± {weigh_half_width:.2%} (95 %)"
        if part_std is None and repeatability_std is None:
            return
    if part_std is None or repeatability_std is None:
        raise ConfigurationError(
            "how much parts and readings vary is not known",
            hint="name a run with --run, or --part-std and --repeatability-std",
        )
    yield f"parts vary by {part_std:.4g}, readings by {repeatability_std:.4g}, operators {operator_std:.4g}"
    yield "parts  operators  trials  readings   %GRR  half width of its 95 % interval, %"
    enough = None
    for size in plan(part_std, repeatability_std, operator_std, executor=executor):
        yield (
            f"{size.parts:5}  {size.operators:9}  {size.trials:6}  {size.readings:8}  {size.percent:5.1f}  "
            f"{size.half_width_percent:.1f}"
        )
        if half_width is not None and size.half_width_percent <= half_width:
            enough = enough or size
    if enough is not None:
        yield (
            f"{enough.parts} parts, {enough.operators} operators, {enough.trials} trials are enough for "
            f"± {half_width:g} %"
        )
    elif half_width is not None:
        yield f"none of these is enough for ± {half_width:g} %: more operators or heads help most"


def _bias(table: StudyTable) -> tuple[list[str], Table]:
    from roemetry_study.reference import biases, linearity

    found, line = biases(table), linearity(table)
    moved = [one for one in found if one.significant]
    words = [
        f"bias is significant at {len(moved)} of {len(found)} parts with a reference; largest "
        f"{max(found, key=lambda one: abs(one.bias)).bias:+.4g}"
    ]
    if line is not None:
        low, high = line.slope_interval
        words.append(
            f"linearity: the bias changes by {line.slope:+.4g} per unit (95 %: {low:+.4g} to {high:+.4g}), "
            f"and reaches {line.largest:.4g}" + ("" if line.significant else "; not significant")
        )
    rows = tuple((one.part, one.reference, one.readings, one.bias, one.low, one.high) for one in found)
    return words, Table("Bias", ("part", "reference", "readings", "bias", "95 % from", "to"), rows)


def _stability(table: StudyTable) -> tuple[list[str], Table]:
    words, rows = [], []
    for part in table.parts:
        mine = sorted((r for r in table.readings if r.part == part), key=lambda r: r.moment)
        values = [float(reading.value) for reading in mine]
        limits = limits_of(values)
        if limits is None:
            words.append(
                f"part {part}: {len(values)} readings; {BASELINE} are needed before anything can be told"
            )
            continue
        broken = signals(values, limits)
        rule, said = "", "stable"
        if broken:
            first = broken[0]
            rule = first.rule
            said = f"not stable: from {mine[first.at].moment} on: {first.words} ({rule})"
        rows.append((part, len(values), limits.centre, limits.std, len(broken), rule))
        words.append(f"part {part}: {said}")
    head = ("part", "readings", "centre", "standard deviation", "signals", "first rule broken")
    return words, Table("Stability", head, tuple(rows))


def _items(table: StudyTable, by: str) -> dict[str, str]:
    items = {
        "value": table.value,
        "readings": str(len(table.readings)),
        "parts": ", ".join(table.parts),
        by: ", ".join(table.operators),
    }
    for source in table.source.split(", "):
        path = Path(source)
        kept = path / PROVENANCE if path.is_dir() else path
        if kept.is_file():
            items[f"file {source}"] = sha256_of(kept)
    return items


def _references(path: Path) -> dict[str, tuple[float, float]]:
    try:
        return {row["id"]: (float(row["value"]), float(row["std"])) for _, row in read_csv(path)[1]}
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(
            f"{path}: expected a table of id, value and std, numbers in every line: {error}"
        ) from error
