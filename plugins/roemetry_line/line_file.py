"""``line.yaml``: which cameras, recipes and receivers; checked as a whole before anything starts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import Choice, Section
from roemetry.config.resolve import ResolvedStage, StageResolver
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError, MisfitError, RoemetryError
from roemetry.io.yaml_source import Document, read
from roemetry.records import Role
from roemetry.stages.registry import discover
from roemetry_line.gate import GateSection

Name = Annotated[str, Field(pattern="^[a-z0-9][a-z0-9_-]{0,40}$")]


class StationSection(Section):
    """One camera and what is measured with it."""

    name: Name = Field(description="what to call it: small letters, digits, - and _")
    recipe: str = Field(
        description="recipe file, or a folder with a recipe.yaml in it; relative to this file"
    )
    choices: list[str] = Field(
        default_factory=list, description="further recipes that an engineer may choose on the page"
    )
    feed: Choice = Field(description="where frames come from")
    lights: list[Role] = Field(
        default=["laser"],
        min_length=1,
        max_length=3,
        description="what lights the scene in the frames of one product, in the order in which they are "
        "taken, each once, as in `[laser, plain]`",
    )
    deadline_ms: float | None = Field(
        default=None,
        gt=0,
        description="how long after a frame's arrival its rows must be there; a late one is reported. "
        "none: any time",
    )
    queue: int = Field(
        default=8, ge=1, le=1000, description="frames that may wait to be measured; then the camera waits"
    )
    spool_gb: float = Field(
        default=10.0,
        ge=0,
        description="how much of the frames is kept on disk, GB, the newest; 0: none, and a frame that was "
        "taken and not measured is lost where the process is killed",
    )
    check_block: str | None = Field(
        default=None,
        description="description of the known block that is measured when somebody asks, relative to this "
        "file; none: the block that the calibration was made from",
    )
    gate: GateSection | None = Field(
        default=None, description="where products are sorted, along the belt; none: no gate"
    )


class OutletSection(Section):
    """One receiver of rows."""

    name: Name = Field(description="what to call it; its place in the outbox is kept under this name")
    use: str = Field(description="name of the outlet's stage")
    options: dict[str, Any] = Field(default_factory=dict, description="the outlet's own options")


class HistorySection(Section):
    """Where every row is kept."""

    url: str = Field(
        default="sqlite:history.sqlite",
        pattern="^(sqlite:.+|postgresql://.+)$",
        description="`sqlite:FILE`, relative to the line's folder, or `postgresql://…`",
    )
    days: str | None = Field(
        default="days",
        description="folder in which each day (UTC) that is over is kept as a Parquet file; relative to the "
        "line's folder; null: nowhere",
    )
    keep_days: float = Field(default=365.0, gt=0, description="rows that are older are taken out, days")


class PageSection(Section):
    """The operator's page."""

    host: str = Field(default="127.0.0.1", description="address to listen at; 0.0.0.0: all of this machine's")
    port: int = Field(default=8350, ge=0, le=65535, description="port to listen at; 0: a free one")
    hosts: list[str] = Field(
        default_factory=lambda: ["127.0.0.1", "localhost"],
        description="names under which the page may be asked for (the Host header)",
    )


class LineFile(Section):
    """One line."""

    roemetry_line: Literal[1] = Field(description="version of the format")
    name: Name = Field(description="what to call the line; the first part of every row's key")
    folder: str = Field(
        default=".", description="where runs, outbox and history are kept; relative to this file"
    )
    stations: list[StationSection] = Field(min_length=1, description="the cameras")
    outlets: list[OutletSection] = Field(default_factory=list, description="who receives the rows")
    history: HistorySection | None = Field(
        default_factory=HistorySection, description="where every row is kept; null: nowhere"
    )
    page: PageSection | None = Field(
        default_factory=PageSection, description="the operator's page; null: none"
    )

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        faults = []
        for group, known in (("stations", self.stations), ("outlets", self.outlets)):
            named = [one.name for one in known]
            again = Counter(named)
            faults += [
                ((group, index, "name"), f"there is another of the name `{name}` in {group}")
                for index, name in enumerate(named)
                if again[name] > 1 and name in named[:index]
            ]
        faults += [
            (("stations", index, "lights"), "`laser` must be among them, and each once")
            for index, one in enumerate(self.stations)
            if "laser" not in one.lights or len(set(one.lights)) < len(one.lights)
        ]
        if self.history is not None:
            faults += [
                (("outlets", index, "name"), f"`{HISTORY}` is the history's own name")
                for index, one in enumerate(self.outlets)
                if one.name == HISTORY
            ]
        if faults:
            raise MisfitError(*faults)
        return self


HISTORY = "history"
"""Name of the outlet that fills the history."""


@dataclass(frozen=True)
class Station:
    """One camera, checked."""

    name: str
    section: StationSection
    recipes: tuple[Path, ...]
    """The recipe, and the others that may be chosen instead."""
    feed: ResolvedStage
    block: Path | None
    """Description of its known block; None: the one that the calibration was made from."""
    at: tuple[str | int, ...]
    """The keys that lead to it in the file."""


@dataclass(frozen=True)
class NamedOutlet:
    """One receiver of rows, checked."""

    name: str
    outlet: ResolvedStage
    at: tuple[str | int, ...]


@dataclass(frozen=True)
class Line:
    """A checked line: every recipe loads, every stage is there, every option is legal."""

    path: Path
    name: str
    folder: Path
    stations: tuple[Station, ...]
    outlets: tuple[NamedOutlet, ...]
    """With the history's, where there is one."""
    history: HistorySection | None
    page: PageSection | None
    document: Document

    @classmethod
    def load(cls, path: Path, *, with_recipes: bool = True) -> Self:
        """Read and check a line file; ConfigurationError names every fault with ``file:line:column``.

        Without recipes they are not looked into: one may be edited while the line runs and rows are told.
        """
        document = read(path)
        file, faults = checked(LineFile, document.data, document.place)
        if file is None:
            raise ConfigurationError(faults, hint="docs/reference/line.md has every key")
        resolver = StageResolver(discover(), document.place, path.absolute().parent)
        folder = (path.absolute().parent / file.folder).resolve()
        stations = tuple(_stations(file, resolver, path.absolute().parent, with_recipes))
        outlets = tuple(_outlets(file, resolver, folder))
        if resolver.faults:
            raise ConfigurationError(resolver.faults)
        return cls(path.absolute(), file.name, folder, stations, outlets, file.history, file.page, document)

    @property
    def history_url(self) -> str | None:
        """Where the history is, with an absolute path; None where none is kept."""
        return None if self.history is None else _absolute(self.history.url, self.folder)

    @property
    def history_begun(self) -> bool:
        """Say whether there may be a history already: SQLite's file comes with the first product."""
        url = self.history_url or ""
        return not url.startswith("sqlite:") or Path(url.removeprefix("sqlite:")).exists()

    def place(self, *at: str | int) -> str:
        """Give ``file:line:column`` of what these keys lead to."""
        return self.document.place(at)

    def station(self, name: str) -> Station:
        """Give the station of a name."""
        return next(one for one in self.stations if one.name == name)


def load_recipe(path: Path, spool: Path) -> Recipe:
    """Load a recipe to measure what is spooled; `roemetry run` with the same changes gives the same rows."""
    changes = ["source.use=dataset", "source.options={}", f"source.path={spool}"]
    return Recipe.load(path, sets=changes)


def _stations(file: LineFile, resolver: StageResolver, home: Path, with_recipes: bool) -> Iterator[Station]:
    for index, section in enumerate(file.stations):
        at: tuple[str | int, ...] = ("stations", index)
        feed = resolver.choose("feed", section.feed, *at, "feed")
        places = [(*at, "recipe"), *((*at, "choices", i) for i in range(len(section.choices)))]
        recipes = [_recipe_file(home / text) for text in (section.recipe, *section.choices)]
        if with_recipes:
            for path, place in zip(recipes, places, strict=True):
                _check_recipe(path, resolver, place)
        block = None if section.check_block is None else home / section.check_block
        if block is not None and not block.is_file():
            resolver.fault(f"there is no file {block}", *at, "check_block")
        if feed is not None:
            yield Station(section.name, section, tuple(recipes), feed, block, at)


def _recipe_file(path: Path) -> Path:
    path = path.resolve()
    return path / "recipe.yaml" if path.is_dir() else path


def _check_recipe(path: Path, resolver: StageResolver, at: tuple[str | int, ...]) -> None:
    """Note a fault where a recipe cannot be used on a line."""
    try:
        recipe = load_recipe(path, path.parent)
    except RoemetryError as error:
        resolver.fault(str(error), *at)
        return
    if recipe.calibration is None:
        resolver.fault(f"{path} has no calibration: it would measure in pixels; name one in the recipe", *at)


def _outlets(file: LineFile, resolver: StageResolver, folder: Path) -> Iterator[NamedOutlet]:
    wanted: list[tuple[OutletSection, tuple[str | int, ...]]]
    wanted = [(one, ("outlets", index)) for index, one in enumerate(file.outlets)]
    if file.history is not None:
        url = _absolute(file.history.url, folder)
        wanted.append((OutletSection(name=HISTORY, use="database", options={"url": url}), ("history",)))
    for section, at in wanted:
        outlet = resolver.choose("outlet", section, *at)
        if outlet is not None:
            yield NamedOutlet(section.name, outlet, at)


def _absolute(url: str, folder: Path) -> str:
    path = url.removeprefix("sqlite:")
    return url if path == url else f"sqlite:{folder / path}"
