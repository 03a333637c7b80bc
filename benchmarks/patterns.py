"""``python -m benchmarks patterns``: grids, lines, dots, circles, lines of two colours against their truth.

``python -m benchmarks patterns [--parts grid,circles,colours] [--seed 32000] [--count 2] [--write]``
``python -m benchmarks patterns --rigs 4 --parts dots,grid --seed 1 --count 3``

Products that the ray-caster draws: with the rig of `recipes/potato_grid`, its grid, and its 15 lines alone
with twice the light each; with those of `recipes/potato_dots`, `potato_circles` and `potato_two_colours`
their own patterns, and as many lines of one colour with the same planes and light. All are measured with
their recipe's calibration. Rendered images are kept in a folder and used again; those in plain light are
shared.

With ``--rigs`` dots and grids on fresh rigs: each is drawn from the seed about that of the recipe (projector,
lean and spacing of the pattern, camera, lens, noise, speckle, light). The ray-caster renders its boards, it
is calibrated from them as a user would, and products of every family are measured with the recipe's stages.
"""

from __future__ import annotations

import json
import pickle
import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from typer.testing import CliRunner

from benchmarks.command import parser_of
from benchmarks.pictures import curves
from benchmarks.tables import Against, put_into, table
from benchmarks.volume_scenes import calibration_of
from roemetry import Recipe
from roemetry.cli.main import app
from roemetry.config.scene import Scene
from roemetry.errors import StageError
from roemetry.records import Acquisition, Peaks, Simulated, StripeMap, StripeTruth, Trace
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline
from roemetry.run.preprocess import prepare
from roemetry_coding.planes import Planes
from roemetry_coding.two_families import TwoFamilies
from roemetry_peaks.gaussian import Gaussian
from roemetry_peaks.two_channels import TwoChannels
from roemetry_simulate.ray_caster import RayCaster

GRID, DOTS = Path("recipes/potato_grid"), Path("recipes/potato_dots")
_CIRCLES, _COLOURS = Path("recipes/potato_circles"), Path("recipes/potato_two_colours")
PAGE, _PICTURE = Path("docs/measurements/patterns.md"), Path("docs/images/two-colours.svg")
FAMILIES = ("herring-roe", "potato", "egg", "fillet")
NEAR_PX = 2.0
"""A peak nearer than this to a true line, or dot, is that one."""
_DENSER = ((20, 6.5), (30, 4.3), (40, 3.25), (50, 2.6))
"""Lines over the same 130 mm; the 40 mm of a potato move a line by as much as 7 mm on the belt."""
_POTATOES = 5
LABEL_HEAD = ("right", "wrong", "no label", "other light labelled")
HEIGHT_HEAD = ("height error, median", "rms")
VOLUME_HEAD = (
    "measured", "mean error", "mean absolute", "largest", "95 % hold", "median width", "processor time",
)  # fmt: skip


class Pattern(NamedTuple):
    """A pattern: the recipe whose scene is rendered, and what is changed in the scene and in the recipe."""

    name: str
    images: str
    """Of its kept images."""
    recipe: Path
    scene: tuple[str, ...] = ()
    stages: tuple[str, ...] = ()

    def pipeline(self) -> Pipeline:
        """Give the pipeline that measures it; of a grid's lines alone with the calibration of these."""
        sets = list(self.stages)
        if self.recipe == GRID and sets:
            path = Path("build/patterns/lines.yaml")
            path.parent.mkdir(parents=True, exist_ok=True)
            _upright_of(Calibration.load(GRID / "calibration.yaml")).save(path)
            sets.append(f"calibration={path.resolve()}")
        return Pipeline(Recipe.load(self.recipe, sets=sets))

    def item(self, family: str, seed: int, number: int, folder: Path) -> Simulated:
        """Render an item, or read it; all patterns share its plain-light image."""

        def one(name: str, recipe: Path, light: str, *sets: str) -> Simulated:
            path = folder / f"{name}-{family}-{seed}-{number}.pickle"
            lights = f"simulator.options.light.images=[{light}]"
            return rendered(path, recipe, family, seed, number, [lights, *sets])

        found = one(self.images, self.recipe, "laser", *self.scene)
        return replace(found, frames=(*found.frames, *one("plain", DOTS, "plain").frames))


_ALONE = ("simulator.options.laser.peak_e_per_ms=1580", "pattern={kind: lines, lines_x: 15, spacing_x_mm: 8}")
"""15 lines 150 mm long, and 11 of 200 mm, in the view: without the latter twice the light for each.

Circles are 2.83 m long in the view, the 15 lines 2.25 m at 1580, the grid 4.45 m at 800."""
_BY_PLANES = ("stages.extractor=gaussian", "stages.coder=planes")
_OF_LINES = (*_BY_PLANES, "stages.triangulator=pinhole-plane")
_LINES = Pattern("15 lines", "lines", GRID, _ALONE, (*_OF_LINES, "stages.volume=outline-surface"))
_SURFACE = Pattern("15 lines, dot-surface", "lines", GRID, _ALONE, (*_OF_LINES, "stages.volume=dot-surface"))
_GRID = Pattern("grid 15 × 11", "grid", GRID)
_RINGS = Pattern("11 circles", "circles", _CIRCLES, ("simulator.options.laser.peak_e_per_ms=1250",))
_TWO = Pattern("20 lines, two colours", "two-colours", _COLOURS)
_ONE = Pattern(
    "20 lines, one colour", "one-colour", _COLOURS,
    ("pattern={kind: lines, lines_x: 20, spacing_x_mm: 6.5}",),
    (*_BY_PLANES, "source.channel=grey", "source.second_channel=null"),
)  # fmt: skip


def main() -> None:
    """Measure, print, and write the page's tables if wanted."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--parts",
        default="grid",
        help="of grid (with lines and dots), circles, colours; with --rigs of dots, grid",
    )
    parser.add_argument("--seed", type=int, default=32000, help="first seed of products")
    parser.add_argument("--count", type=int, default=2, help="products of each family")
    parser.add_argument(
        "--images", type=Path, default=Path("build/patterns"), help="folder of rendered images"
    )
    parser.add_argument("--rigs", type=int, default=0, help="fresh rigs of each pattern instead")
    parser.add_argument("--write", action="store_true", help=f"write the tables of {PAGE}")
    given = parser.parse_args()
    asked, parts = (given.seed, given.count, given.images), dict[str, str]()
    if given.rigs:
        if not {*given.parts.split(",")} <= {"dots", "grid"}:
            parser.error(f"--rigs takes --parts of dots and grid, not {given.parts}")
        tell(on_fresh_rigs(given.parts.split(","), given.rigs, *asked), PAGE if given.write else None)
        return
    if "grid" in given.parts:
        dots = Pattern("400 dots", "dots", DOTS)
        tallies = measured((_LINES, _SURFACE, _GRID, dots), *asked)
        parts["labels"] = labels_table(tallies, _GRID)
        parts["volumes"] = volumes_table(tallies)
    if "circles" in given.parts:
        tallies = measured((_RINGS,), *asked)
        parts |= {"circles-labels": labels_table(tallies, _RINGS), "circles-volumes": volumes_table(tallies)}
    if "colours" in given.parts:
        tallies = measured((_TWO, _ONE), *asked)
        rows = [[*who, *found.label_cells()] for who, found in tallies.items()]
        parts["colours-labels"] = table(["product", "pattern", *LABEL_HEAD], rows)
        parts["colours-volumes"] = volumes_table(tallies)
        picture = _PICTURE if given.write else None
        parts["colours-density"] = by_density(given.seed + 100, given.images, picture)
    tell(parts, PAGE if given.write else None)


def tell(parts: dict[str, str], page: Path | None) -> None:
    """Print the tables, and put them into the page if one is given."""
    for name, part in parts.items():
        print(f"{name}\n{part}")
    if page is not None:
        put_into(page, parts)


def rendered(
    path: Path, recipe: Path, family: str, seed: int, number: int, sets: Sequence[str] = ()
) -> Simulated:
    """Render an item of a family with a recipe's rig, or read it from where it is kept."""
    if not path.exists():
        sets = [f"simulator.options.product={{family: {family}}}", *sets]
        path.parent.mkdir(parents=True, exist_ok=True)
        scene = Scene.load(recipe / "simulated.yaml", sets=sets)
        path.write_bytes(pickle.dumps(scene.make().simulate(number, seed)))
    found: Simulated = pickle.loads(path.read_bytes())
    return found


def _upright_of(calibration: Calibration) -> Calibration:
    """Leave of a grid's calibration the lines that cross rows."""
    across = calibration.parameters["across_planes_per_mm"].size
    parameters = dict(calibration.parameters)
    del parameters["across_planes_per_mm"]
    kept = calibration.covariance[:-across, :-across]
    return replace(calibration, method="pinhole-plane", parameters=parameters, covariance=kept, across=None)


class Tally:
    """Labels, heights and volumes of some products, against their truth."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._found, self._seconds = Against(), list[float]()
        self.counts = np.zeros(4, np.int64)
        """Of `judged`."""
        self._over, self._error_mm = [np.empty(0)], [np.empty(0)]

    def add(self, pipeline: Pipeline, item: Simulated, name: str) -> Trace:
        """Measure an item; its largest product counts."""
        frames = tuple(replace(frame, name="item") for frame in item.frames)
        begin = time.process_time()
        trace = pipeline.trace(Acquisition(name, frames))
        self._seconds.append(time.process_time() - begin)
        found = max(
            trace.products, key=lambda one: int((one.product.profiles.product > 0).sum()), default=None
        )
        if found is not None and found.volume is not None:
            self._found.add(found.volume.visible_mm3, item.truth.products[0].visible_mm3)
        else:
            why = trace.absent if found is None else found.absent
            print(self._what, name, {kind: reason.text for kind, reason in why.items()})
        truth = item.truth.stripes
        self.counts += judged(trace, truth)
        if trace.stripes is not None and trace.profiles is not None and truth is not None:
            of = _dot_errors if trace.stripes.dots is not None else _line_errors
            over, error_mm = of(trace.profiles.xyz_mm, trace.stripes, truth)
            self._over.append(over)
            self._error_mm.append(error_mm)
        return trace

    def label_cells(self) -> list[str]:
        """Write the cells of `LABEL_HEAD`."""
        right, wrong, missed, stray = self.counts.tolist()
        total = right + wrong + missed
        if not total:
            return ["refused", "–", "–", "–"]
        return [f"{right / total:.2%} of {total}", f"{wrong}", f"{missed / total:.2%}", f"{stray}"]

    def held(self) -> str:
        """Write how many 95 % intervals of peaks hold the true place."""
        over = np.concatenate(self._over)
        return f"{np.mean(np.abs(over) < 1.96):.1%}" if over.size else "–"

    def height_cells(self) -> list[str]:
        """Write the cells of `HEIGHT_HEAD`: median and root mean square of the errors."""
        error_mm = np.concatenate(self._error_mm)
        if not error_mm.size:
            return ["–", "–"]
        return [
            f"{1e3 * np.median(np.abs(error_mm)):.0f} µm",
            f"{1e3 * np.sqrt((error_mm**2).mean()):.0f} µm",
        ]

    def volume_cells(self) -> list[str]:
        """Write the cells of `VOLUME_HEAD`."""
        found, off = self._found, 100.0 * self._found.off
        if not off.size:
            return [f"0 of {len(self._seconds)}", *["–"] * 6]
        return [
            f"{off.size} of {len(self._seconds)}", f"{off.mean():+.2f} %", f"{np.abs(off).mean():.2f} %",
            f"{np.abs(off).max():.2f} %", f"{found.held} of {off.size}", f"{100.0 * found.width:.1f} %",
            f"{1e3 * np.median(self._seconds):.0f} ms",
        ]  # fmt: skip


Tallies = dict[tuple[str, str], Tally]
"""By product and pattern."""


def measured(patterns: Sequence[Pattern], seed: int, count: int, folder: Path) -> Tallies:
    """Measure products of every family under patterns."""
    pipelines, tallies = {pattern: pattern.pipeline() for pattern in patterns}, Tallies()
    for family in FAMILIES:
        for pattern, pipeline in pipelines.items():
            found = tallies[family, pattern.name] = Tally(f"{family}, {pattern.name}")
            for number in range(count):
                found.add(pipeline, pattern.item(family, seed, number, folder), f"item_{number}")
    return tallies


def volumes_table(tallies: Tallies) -> str:
    """Write volumes of every family under every pattern."""
    rows = [[*who, *found.volume_cells()] for who, found in tallies.items()]
    return table(["product", "pattern", *VOLUME_HEAD], rows)


def labels_table(tallies: Tallies, pattern: Pattern) -> str:
    """Write how many peaks on products get their line's label, and how far heights are off."""
    rows = [
        [family, *found.label_cells(), found.held(), *found.height_cells()]
        for (family, name), found in tallies.items()
        if name == pattern.name
    ]
    return table(["product", *LABEL_HEAD, "95 % intervals of peaks hold", *HEIGHT_HEAD], rows)


def by_density(seed: int, folder: Path, picture: Path | None) -> str:
    """Write labels of more and more lines on potatoes, in two colours and in one, with the true geometry."""
    rows: list[list[str]] = []
    shares: dict[str, list[tuple[float, float]]] = {"two colours": [], "one colour": []}
    for lines, spacing_mm in _DENSER:
        for colours, way in ((2, "two colours"), (1, "one colour")):
            pattern = (
                f"pattern={{kind: lines, lines_x: {lines}, colours: {colours}, spacing_x_mm: {spacing_mm}}}"
            )
            sets = [pattern, "simulator.options.light.images=[laser]"]
            caster = Scene.load(_COLOURS / "simulated.yaml", sets=sets).make()
            assert isinstance(caster, RayCaster)
            calibration = replace(calibration_of(caster.rig), height_range_mm=(0.0, 60.0))
            counts, refused = np.zeros(4, np.int64), 0
            for number in range(_POTATOES):
                name = f"dense-{lines}-{colours}-{seed}-{number}.pickle"
                item = rendered(folder / name, _COLOURS, "potato", seed, number, sets)
                try:
                    counts += _coded(item, calibration, two=colours == 2)
                except StageError as error:
                    print(f"{lines} lines, {way}: {error.message}")
                    refused += 1
            right, wrong, missed, _ = counts.tolist()
            total = max(right + wrong + missed, 1)
            rows.append([
                f"{lines}, every {spacing_mm:g} mm", way, f"{right / total:.2%} of {total}",
                f"{wrong / total:.2%}", f"{missed / total:.2%}", f"{refused} of {_POTATOES}",
            ])  # fmt: skip
            shares[way].append((float(lines), right / total))
    if picture is not None:
        curves(picture, shares, "lines over 130 mm", "share of peaks labelled rightly")
    return table(["lines", "in", "right", "wrong", "no label", "refused"], rows)


def _coded(item: Simulated, calibration: Calibration, *, two: bool) -> NDArray[np.int64]:
    channels: dict[str, Any] = {"channel": "red", "second_channel": "green"} if two else {}
    frame = prepare(Acquisition("item", item.frames), turn_deg=0, subtract="none", **channels)
    extractor, coder = (TwoChannels(), TwoFamilies()) if two else (Gaussian(), Planes())
    peaks = extractor.extract(frame)
    trace = Trace("item", peaks=peaks, stripes=coder.code(peaks, calibration))
    return judged(trace, item.truth.stripes)


def judged(trace: Trace, truth: StripeTruth | None) -> NDArray[np.int64]:
    """Count peaks on products: right, wrong, without a label; and other light that got a label.

    Of all families of lines, each colour's peaks among the lines of that colour; 0 where there is no map.
    """
    peaks, stripes = trace.peaks, trace.stripes
    if peaks is None or stripes is None or truth is None:
        return np.zeros(4, np.int64)
    if peaks.dots is not None:
        return _judged_dots(stripes.peak_stripe, peaks, truth)
    if peaks.family is None:
        counts = _judged(peaks, stripes, truth)
        if peaks.across is not None:
            assert stripes.across is not None and truth.across is not None
            counts = counts + _judged(peaks.across, stripes.across, truth.across)
        return counts
    counts, turn = np.zeros(4, np.int64), np.arange(stripes.stripe_count)[:, None] % 2
    for family in (0, 1):
        mine = np.flatnonzero(peaks.family == family)
        part = replace(stripes, peak_stripe=stripes.peak_stripe[mine])
        own = turn == family
        lines = replace(
            truth, x_px=np.where(own, truth.x_px, np.nan), on_product=truth.on_product & own,
            xyz_mm=np.where(own[..., None], truth.xyz_mm, np.nan),
            product=np.where(own, truth.product, -1).astype(truth.product.dtype),
        )  # fmt: skip
        counts += _judged(peaks.some(mine, family=None), part, lines)
    return counts


def _judged(peaks: Peaks, stripes: StripeMap, truth: StripeTruth) -> NDArray[np.int64]:
    """Count peaks on products: labelled rightly, wrongly, not; and what is no line there and has a label."""
    off = np.abs(np.where(truth.on_product, truth.x_px, np.inf)[:, peaks.row] - peaks.x_px)
    own, near = off.argmin(axis=0), off.min(axis=0, initial=np.inf) < NEAR_PX
    belt = np.abs(np.where(truth.on_product, np.inf, truth.x_px)[:, peaks.row] - peaks.x_px)
    # of a plane that is seen twice in a row the truth holds the higher place: the other is on the rest line
    rest = np.abs(stripes.rest_px[:, peaks.row] - peaks.x_px)
    elsewhere = np.fmin(belt, rest).min(axis=0, initial=np.inf) >= NEAR_PX
    label = stripes.peak_stripe
    labelled = (label >= 0) & np.isfinite(stripes.x_px[np.maximum(label, 0), peaks.row])
    right, stray = label == own, ~near & elsewhere & labelled
    parts = near & labelled & right, near & labelled & ~right, near & ~labelled, stray
    return np.array([part.sum() for part in parts])


def _off_px(stripes: StripeMap, truth: StripeTruth) -> Floats:
    """Give (stripe, row) errors of what was seen on products, px; NaN elsewhere."""
    off = stripes.x_px - truth.x_px
    return np.where(truth.on_product & stripes.seen & (np.abs(off) < NEAR_PX), off, np.nan)


def _judged_dots(label: Any, peaks: Any, truth: StripeTruth) -> NDArray[np.int64]:
    """Count dots, as `judged` does."""
    stripe, row = np.nonzero(np.isfinite(truth.x_px))
    places = np.column_stack([truth.x_px[stripe, row], truth.y_px[stripe, row]])
    found = np.column_stack([peaks.x_px, peaks.dots.y_px])
    away = np.linalg.norm(found[:, None] - places[None], axis=2)
    own = away.argmin(axis=1)
    near = away.min(axis=1) < NEAR_PX
    lit = near & truth.on_product[stripe, row][own]
    right = lit & (label == stripe[own])
    wrong = lit & (label >= 0) & (label != stripe[own])
    return np.array([part.sum() for part in (right, wrong, lit & (label < 0), (label >= 0) & ~near)])


def _line_errors(xyz_mm: Floats, stripes: StripeMap, truth: StripeTruth) -> tuple[Floats, Floats]:
    """Give errors on products: of places over what is stated of them, and of heights, mm; of all families."""
    count, rows = stripes.x_px.shape
    families = [(xyz_mm[:count, :rows, 2], stripes, truth)]
    if stripes.across is not None and truth.across is not None:
        families.append((xyz_mm[count:, : stripes.across.rows, 2], stripes.across, truth.across))
    over, errors = [], []
    for z_mm, family, true in families:
        off_px = _off_px(family, true)
        over.append((off_px / family.x_std_px).ravel())
        errors.append((z_mm - true.xyz_mm[..., 2])[np.isfinite(off_px)])
    return tuple(np.concatenate([one[np.isfinite(one)] for one in each]) for each in (over, errors))  # type: ignore[return-value]


def _dot_errors(xyz_mm: Floats, stripes: Any, truth: StripeTruth) -> tuple[Floats, Floats]:
    """Give nothing of places, and errors of heights of dots on products, mm."""
    errors = []
    for stripe, row in np.argwhere(np.isfinite(xyz_mm[..., 0])):
        seen = np.flatnonzero(truth.on_product[stripe])
        off = np.hypot(
            truth.x_px[stripe, seen] - stripes.x_px[stripe, row],
            truth.y_px[stripe, seen] - stripes.dots.y_px[stripe, row],
        )
        if seen.size and off.min() < NEAR_PX:
            errors.append(xyz_mm[stripe, row, 2] - truth.xyz_mm[stripe, seen[off.argmin()], 2])
    return np.empty(0), np.array(errors)


_RECIPES = {"grid": GRID, "dots": DOTS}


def on_fresh_rigs(
    patterns: Sequence[str], count_of_rigs: int, seed: int, count: int, folder: Path
) -> dict[str, str]:
    """Measure products of every family on so many rigs of each pattern, `count` on each; write the tables."""
    labels, volumes = [], []
    for pattern in patterns:
        rigs = [Rig(pattern, seed, number, folder) for number in range(count_of_rigs)]
        for family in FAMILIES:
            found, reached = Tally(f"{pattern}, {family}"), np.zeros(2, np.int64)
            for rig in rigs:
                for number in range(count):
                    item = rig.item(family, number)
                    trace = found.add(rig.pipeline(), item, f"{rig.name}-{family}-{number}")
                    reached += labelled_of_visible(trace, item.truth.stripes)
            of = f"{reached[0] / max(reached[1], 1):.2%} of {reached[1]}"
            labels.append([pattern, family, *found.label_cells(), of])
            volumes.append([pattern, family, *found.volume_cells()])
    return {
        "rigs-labels": table(["pattern", "product", *LABEL_HEAD, "right, of all lit and visible"], labels),
        "rigs-volumes": table(["pattern", "product", *VOLUME_HEAD], volumes),
    }


def labelled_of_visible(trace: Trace, truth: StripeTruth | None) -> Any:
    """Count true points on products that have a peak with their label, and all of them, lit and visible.

    Where no peak is found (at rims, at crossings) none has one: the number says what image and stages lose
    together.
    """
    if truth is None or trace.peaks is None or trace.stripes is None:
        return np.array([0, 0 if truth is None else int(truth.on_product.sum())])
    families = [(trace.peaks, trace.stripes, truth)]
    if truth.across is not None:
        assert trace.peaks.across is not None and trace.stripes.across is not None
        families.append((trace.peaks.across, trace.stripes.across, truth.across))
    right = visible = 0
    for peaks, stripes, true in families:
        stripe, row = np.nonzero(true.on_product & np.isfinite(true.x_px))
        visible += stripe.size
        label = stripes.peak_stripe
        kept = np.flatnonzero((label >= 0) & np.isfinite(stripes.x_px[np.maximum(label, 0), peaks.row]))
        if peaks.dots is None:
            mine = np.full(true.x_px.shape, np.nan)
            mine[label[kept], peaks.row[kept]] = peaks.x_px[kept]
            right += int((np.abs(mine - true.x_px)[stripe, row] < NEAR_PX).sum())
            continue
        found = np.column_stack([peaks.x_px, peaks.dots.y_px])[kept]
        for one, at in zip(stripe, row, strict=True):
            own = found[label[kept] == one]
            place = true.x_px[one, at], true.y_px[one, at]
            right += bool(len(own) and np.linalg.norm(own - place, axis=1).min() < NEAR_PX)
    return np.array([right, visible])


class Rig:
    """A rig of dots or of a grid: its files, its calibration from boards, its products.

    Parameters
    ----------
    pattern
        `dots` or `grid`.
    seed, number
        Which rig.
    folder
        Of all rigs.
    """

    def __init__(self, pattern: str, seed: int, number: int, folder: Path) -> None:
        self.name = f"{pattern}-{seed}-{number}"
        self._pattern, self._folder = pattern, folder / self.name
        self._seed = 1000 * seed + 100 * number
        self._sets = drawn_rig(np.random.default_rng([seed, number, *pattern.encode()]), pattern)
        self._pipeline: Pipeline | None = None

    def pipeline(self) -> Pipeline:
        """Give the shipped recipe's stages with this rig's calibration, which is made if it is not there."""
        if self._pipeline is None:
            path = self._folder / "calibration.yaml"
            if not path.exists():
                self._calibrate()
            self._pipeline = Pipeline(
                Recipe.load(_RECIPES[self._pattern], sets=[f"calibration={path.resolve()}"])
            )
        return self._pipeline

    def item(self, family: str, number: int) -> Simulated:
        """Render a product, or read it."""
        path = self._folder / f"{family}-{number}.pickle"
        return rendered(path, _RECIPES[self._pattern], family, self._seed + 1, number, self._sets)

    def _calibrate(self) -> None:
        scene = Scene.load(_RECIPES[self._pattern] / "simulated.yaml", sets=self._sets)
        frames = scene.make().calibration_frames(self._seed)
        for kind, pose, place in _board_images():
            path = self._folder / "calibration" / place
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), frames[kind][pose].pixels)
        for name in ("rig.yaml", "pattern.yaml"):
            shutil.copy(_RECIPES[self._pattern] / name, self._folder)
        result = CliRunner().invoke(app, ["calibrate", str(self._folder / "rig.yaml")])
        print(f"{self.name}: {result.output}", flush=True)
        if result.exit_code:
            raise SystemExit(f"{self.name} cannot be calibrated")


def drawn_rig(rng: np.random.Generator, pattern: str) -> list[str]:
    """Draw what of the recipe's scene is changed, as `--set` takes it."""

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 5)

    camera = {
        "tilt_x_deg": between(-1.5, 1.5), "tilt_y_deg": between(-1.5, 1.5),
        "distance_mm": between(485.0, 520.0), "focal_length_mm": between(15.6, 16.2),
        "blur_sigma_px": between(0.4, 0.7), "read_noise_e": between(6.0, 25.0),
        "distortion": {"k1": between(-0.12, 0.05), "p1": between(-4e-4, 4e-4)},
    }  # fmt: skip
    speckle, light = between(0.05, 0.11), between(0.85, 1.05)
    if pattern == "dots":
        laser: dict[str, Any] = {
            "projector_mm": [between(78.0, 95.0), between(-8.0, 8.0), between(450.0, 500.0)],
            "yaw_deg": between(9.5, 12.5), "line_width_mm": between(1.5, 1.8),
        }  # fmt: skip
    else:
        laser = {
            "projector_mm": [between(66.0, 82.0), between(66.0, 82.0), between(450.0, 490.0)],
            "yaw_deg": between(-1.5, 1.5), "line_width_mm": between(0.9, 1.1),
            "peak_e_per_ms": round(800.0 * light, 1),
        }  # fmt: skip
    laser |= {"speckle_contrast": speckle, "waist_distance_mm": laser["projector_mm"][2]}
    surface = {
        "albedo_laser": between(0.45, 0.6),
        "texture": between(0.03, 0.08),
        "gloss": between(0.0, 0.05),
    }
    return [
        f"simulator.options.{part}.{key}={json.dumps(value)}"
        for part, values in (("camera", camera), ("laser", laser), ("surface", surface))
        for key, value in values.items()
    ]


def _board_images() -> list[tuple[str, str, str]]:
    boards = [
        ("chessboard", f"pose_{k:02d}_{light}", f"chessboard/pose_{k:02d}_{light}.png")
        for k in range(1, 10)
        for light in ("laser", "plain")
    ]
    return [
        ("belt", "belt", "belt.png"),
        ("chessboard", "on_belt_plain", "chessboard/on_belt_plain.png"),
        *boards,
    ]
