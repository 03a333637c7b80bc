"""``python -m benchmarks constants``: how much results depend on each constant of a module.

``python -m benchmarks constants PATTERN … --record FILE --recipes …`` finds the numeric constants of the
plugins' modules whose names fit a pattern (``roemetry_coding.planes*``), multiplies each by 0.8 and by 1.25
(whole numbers change by at least 1; a tuple or an array changes as a whole), measures the first images of the
recipes, some of them disturbed, and keeps what changes of volumes, standard uncertainties, labels and
outcomes. ``--page`` writes what the record holds into the documentation.

numba freezes constants into what it compiles. Here kernels that use one of these constants look it up in an
array instead. All is compiled once, and each change is measured in a fork: what it breaks ends with it.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache, partial
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from multiprocessing import get_context
from pathlib import Path
from textwrap import fill
from types import CodeType
from typing import Any, NamedTuple

import numpy as np

from benchmarks.command import keep, kept, parser_of
from benchmarks.golden import ROOT
from roemetry import Recipe
from roemetry.errors import RoemetryError
from roemetry.records import Acquisition, Measurement
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of

PAGE = ROOT / "docs" / "measurements" / "constants.md"
FACTORS = (0.8, 1.25)
_SEEN = 0.005
"""Percent: what is less is 0.00 in the table, and no change."""
_ROOM = np.zeros((2, 4096, 2))
_FLOATS, _INTEGERS = _ROOM[0, :, 0], _ROOM[1, :, 0].view(np.int64)
"""What kernels look up. numba reads arrays that are not contiguous where they lie, and copies others."""

Key = tuple[str, str]  # module and name


@cache
def _file(module: str) -> Path:
    place = ROOT.joinpath("plugins", *module.split("."))
    # a package that has become a module may leave a folder of compiled files behind
    alone = place.with_suffix(".py")
    return alone if alone.exists() else place / "__init__.py"


@cache
def _imports(module: str) -> dict[str, Key]:
    """Give the names that a module takes from others of ours, each with where it comes from."""
    froms = [node for node in ast.walk(_tree(module)) if isinstance(node, ast.ImportFrom)]
    ours = [(one.module, one.names) for one in froms if one.module and _file(one.module).is_file()]
    return {one.asname or one.name: (source, one.name) for source, names in ours for one in names}


def _tree(module: str) -> ast.Module:
    return ast.parse(_file(module).read_text("utf-8"))


def _assigned(module: str) -> Iterator[tuple[list[str], ast.expr]]:
    """Give the names that each assignment of a module sets, and the expression."""
    for node in _tree(module).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            yield [one.id for one in names if isinstance(one, ast.Name)], node.value


def _numeric(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(map(_numeric, value))
    kind = value.dtype.kind if isinstance(value, np.ndarray) else ""
    return kind in ("f", "i") or (isinstance(value, int | float) and not isinstance(value, bool))


class Constants:
    """The values of modules' constants, some of them changed: others follow from them."""

    def __init__(self, changed: dict[Key, Any]) -> None:
        self._changed, self._known = changed, dict[str, dict[str, Any]]()

    def of(self, module: str) -> dict[str, Any]:
        """Give the numeric constants that a module defines or imports, by name."""
        if module not in self._known:
            found = self._known[module] = {}
            for name, (source, other) in _imports(module).items():
                if other in (theirs := self.of(source)):
                    found[name] = theirs[other]
            for names, expression in _assigned(module):
                try:
                    made = eval(ast.unparse(expression), {"math": math, "np": np}, found)
                    values = tuple(made) if len(names) > 1 else (made,)
                except (NameError, AttributeError, TypeError):  # made of what is no constant
                    continue
                for name, value in zip(names, values, strict=True):
                    if _numeric(value):
                        found[name] = self._changed.get((module, name), value)
        return self._known[module]


def named(patterns: Iterable[str], but: Iterable[str]) -> dict[Key, Any]:
    """Give constants with a number in their definition, with their values, of the modules that fit."""
    found: dict[Key, Any] = {}
    for path in sorted((ROOT / "plugins").glob("roemetry_*/**/*.py")):
        module = ".".join(path.relative_to(ROOT / "plugins").with_suffix("").parts).removesuffix(".__init__")
        if not any(fnmatch(module, pattern) for pattern in patterns):
            continue
        values = Constants({}).of(module)
        for names, expression in _assigned(module):
            numbers = any(isinstance(one, ast.Constant) for one in ast.walk(expression))
            # a range numbers the places of an array
            if numbers and not ast.unparse(expression).startswith("range("):
                found |= {(module, one): values[one] for one in names if one in values and one not in but}
    return found


def changed_by(value: Any, factor: float) -> Any:
    """Multiply a number, or all of a tuple or an array; whole numbers change by at least 1."""
    if isinstance(value, tuple):
        return tuple(changed_by(one, factor) for one in value)
    if isinstance(value, int):
        return value + int(math.copysign(max(1, round(abs(value * (factor - 1.0)))), factor - 1.0))
    return value * factor


class Live:
    """Loads our modules, as an entry of `sys.meta_path`, with kernels whose constants can be changed."""

    def __init__(self, keys: dict[Key, Any]) -> None:
        self._modules = {module for module, _ in keys}
        self._slots, self._used = dict[Key, ast.expr](), 0
        self._base = Constants({})
        self._other = Constants({key: changed_by(value, 1.25) for key, value in keys.items()})
        if early := [one for one in sys.modules if one.startswith("roemetry_") and self.follows(one)]:
            raise SystemExit(f"{', '.join(early)}: imported before constants could be made changeable")
        sys.meta_path.insert(0, self)
        compiling = importlib.import_module("roemetry_kernels.compiling")
        compiling.kernel = partial(self._kernel, compiling.kernel)  # type: ignore[attr-defined]

    @cache  # noqa: B019  there is one of it
    def follows(self, module: str) -> bool:
        """Say whether a module is one that is changed, or imports one, however far away."""
        sources = {part for one in _imports(module).values() for part in (one[0], ".".join(one))}
        return module in self._modules or any(self.follows(one) for one in sources if _file(one).is_file())

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Find a module of ours."""
        if not name.startswith("roemetry_") or not _file(name).is_file() or not self.follows(name):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None:
            spec.loader = loader = SourceFileLoader(name, str(_file(name)))
            loader.get_code = self.code_of  # type: ignore[method-assign,assignment]
        return spec

    def code_of(self, module: str) -> CodeType:
        """Compile a module with kernels that look constants up."""
        tree, other = ast.parse(_file(module).read_text("utf-8")), self._other.of(module)
        for name, value in self._base.of(module).items():
            if repr(value) != repr(other[name]) and not (isinstance(value, np.ndarray) and value.ndim > 1):
                self._slots[module, name] = ast.parse(self._placed(value), mode="eval").body
                self._fill(module, name, value)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and any(
                getattr(getattr(one, "func", one), "id", "") in ("kernel", "float_kernel", "inlined")
                for one in node.decorator_list
            ):
                node.body = [_Looking(self._slots, module).visit(one) for one in node.body]
        # behind the module's text and `from __future__`
        tree.body.insert(2, ast.parse("from benchmarks.constants import _FLOATS, _INTEGERS").body[0])
        return compile(ast.fix_missing_locations(tree), str(_file(module)), "exec")

    def _placed(self, value: Any) -> str:
        """Put a value into its array; the expression that looks it up."""
        if isinstance(value, tuple):
            return f"({', '.join(map(self._placed, value))},)"
        room = "_INTEGERS" if np.asarray(value).dtype.kind == "i" else "_FLOATS"
        first, self._used = self._used, self._used + 1
        if not isinstance(value, np.ndarray):
            return f"{room}[{first}]"
        # the end stands before the values: another step makes an array longer
        self._used += 4 * value.size
        return f"{room}[{first + 1} : _INTEGERS[{first}]]"

    def set(self, changed: dict[Key, Any]) -> None:
        """Change constants, and what follows from them, everywhere; forget what was remembered."""
        values = Constants(changed)
        for name, module in list(sys.modules.items()):
            if name.startswith("roemetry_") and self.follows(name):
                vars(module).update(values.of(name))
            if name.startswith("roemetry"):
                for thing in vars(module).values():
                    if hasattr(thing, "cache_clear"):
                        thing.cache_clear()
        for name, constant in self._slots:
            self._fill(name, constant, values.of(name)[constant])

    def _fill(self, module: str, name: str, value: Any) -> None:
        """Write a value where kernels look it up."""
        place = self._slots[module, name]
        if isinstance(place, ast.Subscript) and isinstance(place.slice, ast.Slice) and place.slice.lower:
            first = ast.literal_eval(place.slice.lower)
            _INTEGERS[first - 1] = first + value.size
        exec(f"{ast.unparse(place)} = value", globals(), {"value": value})

    def _kernel(self, usual: Any, function: Any = None, **options: Any) -> Any:
        """Compile as `kernel` does, but keep nothing on disk of what looks constants up."""
        from numba import njit

        if function is None:
            return partial(self._kernel, usual, **options)
        if self.follows(function.__module__):
            return njit(nogil=True, no_cfunc_wrapper=True, **options)(function)
        return usual(function, **options)


class _Looking(ast.NodeTransformer):
    """Puts the place of a constant where its name stands."""

    def __init__(self, slots: dict[Key, ast.expr], module: str) -> None:
        self._slots, self._module = slots, module

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self._slots.get((self._module, node.id), node) if isinstance(node.ctx, ast.Load) else node


class Product(NamedTuple):
    """What is found of one product: volume and standard uncertainty, mm³ (NaN: none), and what is said."""

    volume_mm3: float
    std_mm3: float
    outcome: str
    grade: str


def product_of(row: Measurement) -> Product:
    """Keep what is compared of a row of the record."""
    grade = "" if row.grade is None else row.grade.label
    if row.volume is not None:
        return Product(row.volume.visible_mm3.value, row.volume.visible_mm3.std, "measured", grade)
    why = " ".join(sorted({one.code for one in row.absent.values()}))
    return Product(math.nan, math.nan, f"refused ({why})", grade)


_METHODS = {
    "extractor": "extract", "aligner": "align", "coder": "code", "smoother": "smooth", "outliner": "outline",
    "triangulator": "triangulate",
}  # fmt: skip


def _replay(stage: Any, method: str, given: list[Any]) -> None:
    """Let a stage that no change reaches give again, call by call, what it has given before."""
    usual, calls = getattr(stage, method), itertools.count()

    def again(*what: Any) -> Any:
        if (call := next(calls)) == len(given):
            try:
                given.append(usual(*what))
            except RoemetryError as error:
                given.append(error)
        if isinstance(given[call], RoemetryError):
            raise given[call]
        return given[call]

    setattr(stage, method, again)


class Images:
    """What is measured: the first images of each recipe, and copies of them that are disturbed."""

    def __init__(self, live: Live, recipes: Iterable[Path], count: int, disturbed: int, seed: int) -> None:
        self._live, self._given = live, dict[tuple[Path, str], list[Any]]()
        self._taken: list[tuple[Path, list[Acquisition]]] = []
        rng = np.random.default_rng(seed)
        for path in recipes:
            recipe = Recipe.load(path)
            source = recipe.source.make()
            taken = [source.read(one) for one in list(source.references(recipe.source_path))[:count]]
            more = [_disturbed(taken[k % count], taken[(k + 1) % count], rng) for k in range(disturbed)]
            self._taken.append((path, taken + more))

    def measured(self) -> dict[str, tuple[dict[str, Product], Any]]:
        """Give each image's products by name, and where stripes were seen, px, (stripe, row)."""
        found = {}
        for path, taken in self._taken:
            recipe = Recipe.load(path)  # anew: a calibration remembers what was calculated of it
            stages = {kind: chosen.make() for kind, chosen in recipe.stages.items()}
            for kind, method in () if taken[0].lines is not None else _METHODS.items():
                if kind in stages:
                    if self._live.follows(type(stages[kind]).__module__):
                        break
                    _replay(stages[kind], method, self._given.setdefault((path, kind), []))
            pipeline = Pipeline(recipe, stages=stages)
            for one in taken:
                trace = pipeline.trace(one)
                rows = {row.id: product_of(row) for row in measurements_of(trace, recipe, {})}
                of = trace.stripes
                seen_px = np.empty((0, 0)) if of is None else np.where(of.seen, of.x_px, np.nan)
                found[f"{path.parent.name}/{path.stem} {one.id}"] = rows, seen_px
        return found


def _disturbed(one: Acquisition, next_one: Acquisition, rng: np.random.Generator) -> Acquisition:
    """Disturb an acquisition in a way, and by a size, drawn from those of `benchmarks.disturbances`."""
    from benchmarks.disturbances import DISTURBANCES, Scene, disturbs

    (laser, plain), other = (one.frame("laser"), one.frame("plain")), next_one.frame("laser")
    if laser is None or other is None:
        return one
    scene = Scene(
        one.id,
        laser.pixels,
        None if plain is None else plain.pixels,
        math.nan,
        Scene("", other.pixels, None, 0.0),
    )
    name = str(rng.choice([word for word in DISTURBANCES if disturbs(word, scene)]))
    kind = DISTURBANCES[name]
    size = float(np.exp(rng.uniform(np.log(kind.low), np.log(kind.high)))) if kind.unit else kind.low
    made = dict(zip(("laser", "plain"), kind.make(scene, size, rng), strict=True))
    depths = {role: frame.bit_depth for role, frame in (("laser", laser), ("plain", plain)) if frame}
    frames = tuple(
        replace(frame, pixels=pixels, bit_depth=max(depths[frame.role], 8 * pixels.dtype.itemsize))
        for frame in one.frames
        if (pixels := made.get(frame.role)) is not None
    )
    return replace(one, id=f"{one.id}, {name} {size:.2g} {kind.unit}", frames=frames, before=other.pixels)


def compared(found: dict[str, Any], base: dict[str, Any]) -> dict[str, Any]:
    """Sum up how far what is found lies from what was found before anything was changed."""
    volumes, stds, labels, outcomes, grades = [], [], [], [], 0
    for image, (before, seen_px) in base.items():
        after, now_px = found[image]
        count = max(np.isfinite(seen_px).sum(), np.isfinite(now_px).sum(), 1)
        same = np.sum(np.abs(seen_px - now_px) < 1.0) if seen_px.shape == now_px.shape else 0
        # a point that only one coding has, or that they give to different stripes, is another label
        labels.append(100.0 * (1.0 - float(same) / count) if seen_px.size + now_px.size else 0.0)
        for name in sorted(before.keys() | after.keys()):
            one, other = (Product(*of[name]) if name in of else None for of in (before, after))
            if one is None or other is None or one.outcome != other.outcome:
                said = ["no product" if each is None else each.outcome for each in (one, other)]
                outcomes.append(f"{image} {name}: {said[0]} → {said[1]}")
                continue
            volumes.append(100.0 * (other.volume_mm3 / one.volume_mm3 - 1.0))
            stds.append(100.0 * (other.std_mm3 / one.std_mm3 - 1.0) if one.std_mm3 > 0.0 else math.nan)
            grades += one.grade != other.grade
    told = {"outcomes": outcomes, "grades": grades, "images": len(base)}
    for what, values in (("volume", volumes), ("std", stds), ("labels", labels)):
        known = np.array([value for value in values if math.isfinite(value)] or [0.0])
        told[f"{what}_max_percent"] = float(np.abs(known).max())
        told[f"{what}_rms_percent"] = float(np.sqrt(np.square(known).mean()))
    return told


_now: Callable[[dict[Key, Any]], dict[str, Any]]
"""What a fork does; it is not handed over but found there."""


def _in_fork(changed: dict[Key, Any]) -> dict[str, Any]:
    return _now(changed)


def after(changed: dict[Key, Any]) -> dict[str, Any]:
    """Do what `_now` does in a process that ends with it."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
            return pool.submit(_in_fork, changed).result()
    except Exception as error:  # whatever a constant breaks is what is asked
        return {"broken": f"{type(error).__name__}: {error}"[:200]}


def main() -> None:
    """Measure, and write the page."""
    parser = parser_of(__doc__)
    parser.add_argument("patterns", nargs="*", help="names of modules")
    parser.add_argument("--record", type=Path, required=True, help="JSON lines, one a change; a run goes on")
    parser.add_argument("--recipes", nargs="*", type=Path, default=[])
    parser.add_argument("--images", type=int, default=3, help="of each recipe")
    parser.add_argument("--disturbed", type=int, default=2, help="disturbed images of each recipe")
    parser.add_argument("--seed", type=int, default=1, help="of the disturbances")
    parser.add_argument("--but", nargs="*", default=[], help="names that are no quantities")
    parser.add_argument(
        "--to", nargs="*", default=[], help="NAME=VALUE: these changes instead, to leave rules out"
    )
    parser.add_argument("--page", action="store_true", help=f"write the record into {PAGE.name}")
    given = parser.parse_args()
    if given.patterns:
        measure(given)
    if given.page:
        from benchmarks.tables import put_into

        put_into(PAGE, {"constants": page_of(kept(given.record))})


def measure(given: argparse.Namespace) -> None:
    """Measure all changes that the record does not hold yet."""
    global _now
    keys = named(given.patterns, given.but)
    live = Live(keys)
    images = Images(live, given.recipes, given.images, given.disturbed, given.seed)
    base = images.measured()

    def _now(changed: dict[Key, Any]) -> dict[str, Any]:
        live.set(changed)
        return compared(images.measured(), base)

    again = after({})
    if any(value for name, value in again.items() if name != "images"):
        raise SystemExit(f"measured again without any change, results differ: {again}")
    done = {(row["module"], row["constant"], row["changed"]) for row in kept(given.record)}
    instead = {name: [ast.literal_eval(to)] for name, to in (one.split("=") for one in given.to)}
    for (module, name), value in keys.items():
        usual = () if instead else [changed_by(value, factor) for factor in FACTORS]
        for to in instead.get(name, usual):
            if (module, name, repr(to)) not in done:
                what = {"module": module, "constant": name, "value": repr(value), "changed": repr(to)}
                keep(given.record, {**what, **after({(module, name): to})})


def page_of(rows: Sequence[dict[str, Any]]) -> str:
    """Write a table a module: constants by how far they move volumes; those that move nothing by name."""
    from benchmarks.tables import number, table

    figures = ("volume_max_percent", "volume_rms_percent", "std_max_percent", "labels_max_percent")
    head = [
        "",
        "value",
        "volume, largest %",
        "r.m.s. %",
        "its std, largest %",
        "labels, largest %",
        "outcomes",
    ]
    parts = []
    for module in dict.fromkeys(row["module"] for row in rows):
        lines, still = [], []
        for name in dict.fromkeys(row["constant"] for row in rows if row["module"] == module):
            both = [row for row in rows if (row["module"], row["constant"]) == (module, name)]
            broken = next((row["broken"] for row in both if "broken" in row), "")
            worst = [max(row.get(figure, 0.0) for row in both) for figure in figures]
            others = max(len(row.get("outcomes", ())) for row in both)
            value = both[0]["value"] if len(both[0]["value"]) < 30 else "several"
            if max(worst) >= _SEEN or others or broken:
                cells = [f"`{name}`", value, *(number(one, 2) for one in worst), broken or str(others)]
                lines.append((-worst[1], cells))
            else:
                still.append(f"`{name}` ({value})")
        body = table(head, [cells for _, cells in sorted(lines)]) if lines else ""
        quiet = fill(f"Nothing changes with {', '.join(still)}.", 150) if still else ""
        parts.append(f"**{module}**\n\n{body}\n{quiet}\n")
    return "\n".join(parts)
