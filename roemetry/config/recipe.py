"""A recipe: which stages, with which options, on what; read in two phases.

First the names, against the registry; then only the chosen stages' options. So one recipe imports only what
it uses, and every fault of the file is told at once, each with its place.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, Self

from roemetry.config.overrides import Overridden
from roemetry.config.recipe_file import (
    DEFAULT_ALIGNERS,
    DEFAULT_ASSEMBLER,
    DRAWS,
    NEEDS,
    CalibrationCheck,
    RecipeFile,
    SourceChoice,
    StageChoice,
    Uncertainty,
)
from roemetry.config.resolve import ResolvedStage, StageResolver, choice_of
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, DataError, RoemetryError
from roemetry.io.remote import path_of
from roemetry.io.yaml_source import Document, Step, read
from roemetry.records import AcquisitionReference, Sensor
from roemetry.records.calibration import ON_BELT, Calibration
from roemetry.records.display import table
from roemetry.records.penetration import Penetration
from roemetry.stages import Stage, Triangulator
from roemetry.stages.registry import Registry, discover


class Content(Protocol):
    """A recipe file's values, and the way back to where each stands."""

    data: Any
    sets: list[str]

    def place(self, path: Sequence[Step]) -> str:
        """Say where the value at a path comes from."""


@dataclass(frozen=True, repr=False)
class Recipe:
    """A checked recipe, with its calibration read and its classes imported."""

    path: Path
    sets: tuple[str, ...]
    product: str
    source_choice: SourceChoice
    source: ResolvedStage
    """source_choice, source: where images come from and how they are made ready; the source stage."""
    source_path: Path
    source_place: str
    """Where the recipe names its images, ``file:line:column``."""
    calibration_path: Path | None
    calibration: Calibration | None
    """calibration_path, calibration: none where the recipe has none: results are then in pixels."""
    penetration: Penetration | None
    """What is added to heights because light enters the product; None: nothing."""
    calibration_check: CalibrationCheck | None
    """What is asked of the calibration; None: nothing."""
    stages: Mapping[str, ResolvedStage]
    uncertainty: Uncertainty
    draws: int
    """uncertainty, draws: how that of the results is found, and with how many Monte Carlo draws."""
    stage_timeout_s: float | None
    """How long a stage may take for one acquisition; None: for ever."""
    sinks: tuple[ResolvedStage, ...]

    def __repr__(self) -> str:
        """Give one line: the product, and the plugin of each stage."""
        stages = ", ".join(f"{kind}: {one.registered.entry.name}" for kind, one in self.stages.items())
        return f"{type(self).__name__}({str(self.path)!r}, product={self.product!r}, {stages})"

    def _repr_html_(self) -> str:
        """Give the stages with their plugins and options as a table, for notebooks."""
        rows = [("source", f"{self.source.registered.entry.name}: {self.source_path}")]
        rows.append(("calibration", str(self.calibration_path or "none: results are in pixels")))
        rows += [(kind, repr(one)) for kind, one in self.stages.items()]
        rows.append(("uncertainty", self.uncertainty))
        return table(self.product, rows)

    @classmethod
    def load(cls, path: Path | str, *, sets: Sequence[str] = (), registry: Registry | None = None) -> Self:
        """Read and check a recipe file, or the ``recipe.yaml`` in a folder.

        Parameters
        ----------
        sets
            Changes of the form ``stages.extractor.options.threshold=80``.
        registry
            Stages to choose from; default: all that are installed.

        Raises
        ------
        ConfigurationError
            With every fault of the file, each with its place.
        """
        path = Path(path)
        path = path / "recipe.yaml" if path.is_dir() else path
        return cls(**_resolved(path, Overridden(read(path), sets), registry or discover()))

    @classmethod
    def of(
        cls, data: Mapping[str, Any], *, folder: Path | str = ".", registry: Registry | None = None
    ) -> Self:
        """Check a recipe in memory: what a file says, as plain dictionaries, lists, words and numbers.

        Stages may be objects as well (see `roemetry.make_stage`). Relative paths in it begin at `folder`;
        ConfigurationError names every fault with its keys.
        """
        known = registry or discover()
        if isinstance(stages := data.get("stages"), Mapping):
            chosen = {
                kind: choice_of(kind, one, known) if isinstance(one, Stage) else one
                for kind, one in stages.items()
            }
            data = {**data, "stages": chosen}
        document = Overridden(Document("the recipe", data), ())
        return cls(**_resolved(Path(folder) / "recipe.yaml", document, known))

    @classmethod
    def drafted(
        cls,
        path: Path,
        content: Content,
        registry: Registry,
        *,
        read_calibration: Callable[[Path], Calibration] = Calibration.load,
    ) -> Self:
        """Check what a recipe file at `path`, where relative paths begin, would say if it held `content`.

        `read_calibration` reads a calibration file, or remembers it. ConfigurationError names every fault.
        """
        return cls(**_resolved(path, content, registry, read_calibration))

    def resolved(self) -> dict[str, Any]:
        """Everything that decides a result, with defaults filled in, as plain values."""
        source = self.source_choice.model_dump(mode="json")
        source["options"] = self.source.options.model_dump(mode="json")
        return {
            "roemetry": 1,
            "product": self.product,
            "source": source,
            "calibration": None if self.calibration is None else self.calibration.sha256,
            "stages": {kind: chosen.described() for kind, chosen in self.stages.items()},
            "penetration": None if self.penetration is None else self.penetration.sha256,
            "uncertainty": self.uncertainty,
            "draws": self.draws,
            "sinks": [sink.described() for sink in self.sinks],
        }

    def references(self) -> Sequence[AcquisitionReference]:
        """Give what the source has; DataError, with the place in the recipe, where that is nothing."""
        try:
            found: Sequence[AcquisitionReference] = self.source.make().references(self.source_path)
            return found
        except DataError as error:
            raise DataError(f"{self.source_place}: {error.message}", hint=error.hint) from error
        except OSError as error:
            why = error.strerror or str(error)
            raise DataError(f"{self.source_place}: {error.filename or self.source_path}: {why}") from error

    @property
    def sensor(self) -> Sensor | None:
        """The camera's noise, where the recipe states it."""
        stated = self.source_choice.sensor
        return None if stated is None else Sensor(**stated.model_dump())

    @cached_property
    def hashes(self) -> dict[str, str]:
        """What stands on every row of the record: which recipe and which calibration made it."""
        made = {"recipe_sha256": self.sha256}
        return made if self.calibration is None else made | {"calibration_sha256": self.calibration.sha256}

    @cached_property
    def sha256(self) -> str:
        """Hash of all that decides a number: not the path of the images, not the sinks."""
        deciding = self.resolved()
        del deciding["sinks"], deciding["source"]["path"]
        return hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()


def _resolved(
    path: Path,
    document: Content,
    registry: Registry,
    read_calibration: Callable[[Path], Calibration] = Calibration.load,
) -> dict[str, Any]:
    """Check a document and give the attributes of the recipe it describes."""
    file, faults = checked(RecipeFile, document.data, document.place)
    if file is None:
        raise ConfigurationError(faults)
    chooser = StageResolver(registry, document.place, path.parent)
    source = chooser.choose("source", file.source, "source")
    stages: dict[str, ResolvedStage] = {}
    gives = "images" if source is None else getattr(source.stage, "gives", "images")
    if gives != "slices" and file.stages.extractor is None:
        chooser.fault("this is missing", "stages", "extractor")
    if gives == "lines" and file.stages.triangulator is None:
        chooser.fault("the lines of a scan are placed in mm: this is missing", "stages", "triangulator")
    for kind in type(file.stages).model_fields:
        choice = getattr(file.stages, kind)
        if choice is None:
            continue
        needed = NEEDS.get(kind)
        if gives == "slices" and needed == "triangulator":
            needed = None
        if needed is not None and getattr(file.stages, needed) is None:
            chooser.fault(f"it works on the result of the {needed}; add one", "stages", kind)
        chosen = chooser.choose(kind, choice, "stages", kind)
        if chosen is not None:
            stages[kind] = chosen
    _check_needs(stages, file, chooser)
    sinks = [chooser.choose("sink", choice, "sinks", index) for index, choice in enumerate(file.sinks)]
    calibration_path = None if file.calibration is None else path.parent / file.calibration
    calibration = None
    if calibration_path is not None:
        try:
            calibration = read_calibration(calibration_path)
        except RoemetryError as error:
            chooser.fault(str(error), "calibration")
        else:
            _check_method(calibration, stages.get("triangulator"), chooser)
            _check_count(calibration, stages, chooser)
            if calibration.turn_deg != file.source.turn_deg:
                chooser.fault(
                    f"{file.source.turn_deg}°, but the calibration was made at {calibration.turn_deg}°; "
                    "turn images and rig alike",
                    "source",
                    "turn_deg",
                )
    if gives != "images" and file.stages.assembler is None:
        assembler = chooser.choose("assembler", StageChoice(use=DEFAULT_ASSEMBLER), "stages", "assembler")
        stages |= {} if assembler is None else {"assembler": assembler}
    on_belt = calibration is not None and calibration.reference == ON_BELT and gives == "images"
    if on_belt and "aligner" not in file.stages.model_fields_set:
        stages = _with_default_aligner(stages, registry, chooser)
    _check_pattern(stages, chooser)
    penetration = None
    if file.penetration is not None:
        try:
            penetration = Penetration.load(path.parent / file.penetration)
        except RoemetryError as error:
            chooser.fault(str(error), "penetration")
    if chooser.faults or source is None:
        raise ConfigurationError(chooser.faults)
    return {
        "path": path,
        "sets": tuple(document.sets),
        "product": file.product,
        "source_choice": file.source,
        "source": source,
        "source_path": path_of(file.source.path, path.parent),
        "source_place": document.place(("source", "path")),
        "calibration_path": calibration_path,
        "calibration": calibration,
        "penetration": penetration,
        "calibration_check": file.calibration_check,
        "stages": stages,
        **_uncertainty_of(file),
        "stage_timeout_s": file.stage_timeout_s,
        "sinks": tuple(sink for sink in sinks if sink is not None),
    }


def _with_default_aligner(
    stages: dict[str, ResolvedStage], registry: Registry, chooser: StageResolver
) -> dict[str, ResolvedStage]:
    """Add the usual aligner where a recipe says nothing of one and its triangulator can follow a motion.

    A camera that has moved unnoticed gives wrong volumes with tight intervals, so doing without is what a
    recipe has to ask for.
    """
    triangulator = stages.get("triangulator")
    if triangulator is None or not issubclass(triangulator.stage, Triangulator):
        return stages
    if triangulator.stage.moved is Triangulator.moved:
        return stages
    usual = DEFAULT_ALIGNERS[triangulator.stage.capabilities.pattern]
    if not any(one.entry.name == usual for one in registry.of_kind("aligner")):
        return stages
    chosen = chooser.choose("aligner", StageChoice(use=usual), "stages", "aligner")
    if chosen is None:
        return stages
    extractor = {kind: one for kind, one in stages.items() if kind == "extractor"}
    return extractor | {"aligner": chosen} | stages


def _uncertainty_of(file: RecipeFile) -> dict[str, Any]:
    """Settle how uncertainties are found: draws that are given decide."""
    if file.draws is not None:
        return {"uncertainty": "monte-carlo" if file.draws else "none", "draws": file.draws}
    chosen = file.uncertainty or "none"
    return {"uncertainty": chosen, "draws": DRAWS if chosen == "monte-carlo" else 0}


def _check_needs(stages: Mapping[str, ResolvedStage], file: RecipeFile, chooser: StageResolver) -> None:
    """Note a fault where the grader asks for the result of a stage that the recipe has not."""
    grader = stages.get("grader")
    if grader is None:
        return
    for kind in sorted(grader.make().needs()):
        if getattr(file.stages, kind) is None:
            chooser.fault(f"it works on the result of the {kind}; add one", "stages", "grader")


def _check_pattern(stages: Mapping[str, ResolvedStage], chooser: StageResolver) -> None:
    """Note a fault where a stage is made for lines and the extractor for dots, or the other way round."""
    first = stages.get("extractor")
    for kind in ("aligner", "coder", "smoother", "triangulator"):
        chosen = stages.get(kind)
        if first is None or chosen is None:
            continue
        own, light = chosen.stage.capabilities.pattern, first.stage.capabilities.pattern
        if own != light:
            chooser.fault(
                f"`{chosen.registered.entry.name}` is made for {own}, the extractor "
                f"`{first.registered.entry.name}` finds {light}",
                "stages", kind,
            )  # fmt: skip


def _check_count(
    calibration: Calibration, stages: Mapping[str, ResolvedStage], chooser: StageResolver
) -> None:
    """Note a fault where a stage is told of another number of stripes than was calibrated."""
    for kind, chosen in stages.items():
        count = getattr(chosen.options, "stripe_count", None)
        if count is not None and count != calibration.stripe_count:
            chooser.fault(
                f"{count}, but the calibration has {calibration.stripe_count} stripes",
                "stages", kind, "options", "stripe_count",
            )  # fmt: skip


def _check_method(
    calibration: Calibration, triangulator: ResolvedStage | None, chooser: StageResolver
) -> None:
    """Note a fault where the triangulator does not understand the calibration."""
    if triangulator is None or triangulator.registered.entry.name == calibration.method:
        return
    name = triangulator.registered.entry.name
    chooser.fault(
        f"made by `{calibration.method}`, but the triangulator is `{name}`; "
        f"use `{calibration.method}`, or calibrate with `{name}`",
        "calibration",
    )
