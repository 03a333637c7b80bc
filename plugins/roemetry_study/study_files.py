"""The files of studies that a user writes: an acceptance test, and a measurement model with its inputs."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np
from pydantic import Field, model_validator

from roemetry.config.recipe_file import Section
from roemetry.config.target_file import (
    BlockFile,
    SpherePlateFile,
    StaircaseFile,
    read_block,
    read_sphere_plate,
    read_staircase,
    read_target,
)
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError
from roemetry.io.yaml_source import read
from roemetry.records.arrays import Floats
from roemetry_study.acceptance import Artefact
from roemetry_study.uncertainty import Input


class Limits(Section):
    """Maximum permissible errors, mm; a characteristic without one is measured and not judged."""

    form: float | None = Field(default=None, gt=0, description="probing dispersion on a sphere, mm")
    size: float | None = Field(default=None, gt=0, description="probing size of a sphere, mm")
    spacing: float | None = Field(default=None, gt=0, description="distance between spheres, mm")
    flatness: float | None = Field(default=None, gt=0, description="flatness of a plane, mm")
    step: float | None = Field(default=None, gt=0, description="height of a step, mm")
    length: float | None = Field(default=None, gt=0, description="length of a side, mm")


class ArtefactFile(Section):
    """An artefact and the images of it."""

    target: str = Field(description="its description, as in calib_targets/; relative to this file")
    images: list[str] = Field(
        min_length=1, description="images of it, with * and ? as wildcards, relative to this file"
    )
    std_mm: float = Field(
        gt=0,
        description="standard uncertainty of its lengths, mm: half the expanded one of its own certificate",
    )
    certificate: str = Field(default="", description="what its calibrated values rest on: number and date")


class AcceptanceFile(Section):
    """An acceptance test."""

    roemetry_acceptance: Literal[1] = Field(description="version of the format")
    name: str = Field(description="of the instrument, e.g. its serial number")
    recipe: str = Field(description="the line's recipe, relative to this file")
    environment: str = Field(default="", description="temperature and whatever else matters")
    limits_mm: Limits = Field(description="maximum permissible errors")
    artefacts: list[ArtefactFile] = Field(min_length=1)


class InputFile(Section):
    """An input quantity."""

    value: float
    std: float | None = Field(default=None, ge=0, description="standard uncertainty")
    half: float | None = Field(default=None, ge=0, description="half width, for the shapes with ends")
    shape: Literal["normal", "rectangular", "triangular", "arcsine", "t"] = "normal"
    freedom: float | None = Field(default=None, gt=0, description="degrees of freedom of `std`")

    @model_validator(mode="after")
    def _has_its_width(self) -> InputFile:
        needed = "half" if self.shape in ("rectangular", "triangular", "arcsine") else "std"
        if getattr(self, needed) is None:
            raise ValueError(f"a {self.shape} input needs `{needed}`")
        if self.shape == "t" and self.freedom is None:
            raise ValueError("an input of shape t needs `freedom`")
        return self

    def made(self) -> Input:
        """Give the input."""
        return Input(**self.model_dump(exclude_none=True))


class ModelFile(Section):
    """A measurement model: a formula of named inputs."""

    roemetry_model: Literal[1] = Field(description="version of the format")
    quantity: str = Field(description="what it gives, its unit in the name, e.g. volume_cm3")
    formula: str = Field(description="of the inputs' names, + − * / ** ( ), sqrt, exp, log, sin, cos, pi")
    inputs: dict[str, InputFile] = Field(min_length=1)


_File = TypeVar("_File", bound=Section)


def read_acceptance(path: Path) -> AcceptanceFile:
    """Read an acceptance test; raise ConfigurationError, with places, where it is at fault."""
    return _read(path, AcceptanceFile)


def read_model(path: Path) -> tuple[ModelFile, Callable[..., Floats]]:
    """Read a measurement model and make its formula a function; ConfigurationError where it is at fault."""
    found = _read(path, ModelFile)
    return found, formula(found.formula, set(found.inputs), str(path))


def artefact_of(path: Path, std_mm: float) -> Artefact:
    """Read an artefact's description; ConfigurationError where it is at fault or of a kind without a test."""
    described = read_target(path)
    readers: dict[type, Callable[..., Any]] = {
        SpherePlateFile: read_sphere_plate,
        BlockFile: read_block,
        StaircaseFile: read_staircase,
    }
    if type(described) not in readers:
        raise ConfigurationError(
            f"{path}: kind: found {described.kind!r}, expected one of sphere-plate, block, staircase"
        )
    return Artefact(readers[type(described)](described, path.parent), std_mm)


_FUNCTIONS: dict[str, Callable[..., Floats]] = {
    name: getattr(np, name) for name in ("sqrt", "exp", "log", "sin", "cos")
}
_ALLOWED = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Constant, ast.Name, ast.Load, ast.Call, ast.Add, ast.Sub,
    ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd,
)  # fmt: skip


def formula(text: str, names: set[str], place: str) -> Callable[..., Floats]:
    """Make a function of arrays by name of a formula; nothing but arithmetic and five functions passes.

    Raises
    ------
    ConfigurationError
        It does not parse, names something unknown, leaves an input out, or holds anything else.
    """
    try:
        tree = ast.parse(text.replace("−", "-"), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ConfigurationError(f"{place}: formula: {text!r} cannot be read: {error}") from error
    used = set()
    for node in ast.walk(tree):
        if not isinstance(node, _ALLOWED) or (
            isinstance(node, ast.Constant) and type(node.value) not in (int, float)
        ):
            raise ConfigurationError(
                f"{place}: formula: found {type(node).__name__} in {text!r}, expected arithmetic alone"
            )
        if isinstance(node, ast.Call) and not (
            isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS and len(node.args) == 1
        ):
            raise ConfigurationError(
                f"{place}: formula: expected one of {', '.join(_FUNCTIONS)} of one value"
            )
        if isinstance(node, ast.Name):
            used.add(node.id)
    unknown, left = used - names - set(_FUNCTIONS) - {"pi"}, names - used
    if unknown or left:
        said = [f"`{name}` is no input" for name in sorted(unknown)]
        said += [f"the input `{name}` is not used" for name in sorted(left)]
        raise ConfigurationError(f"{place}: formula: {'; '.join(said)}")
    code = compile(tree, place, "eval")

    def model(**inputs: Floats) -> Floats:
        scope = {"__builtins__": {}, "pi": math.pi, **_FUNCTIONS, **inputs}
        return np.asarray(eval(code, scope), np.float64)  # only what was let through above

    return model


def _read(path: Path, model: type[_File]) -> _File:
    document = read(path)
    found, faults = checked(model, document.data, document.place)
    if found is None:
        raise ConfigurationError(faults)
    return cast(_File, found)
