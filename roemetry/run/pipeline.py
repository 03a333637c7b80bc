"""One acquisition through the stages of a recipe, one way and without state."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.errors import FAULTS
from roemetry.records import (
    Acquisition,
    Decision,
    Frame,
    Grade,
    Outline,
    Peaks,
    Product,
    ProductTrace,
    Profiles,
    Reason,
    StripeMap,
    Trace,
    Volume,
    Weight,
)
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.penetration import raise_surface
from roemetry.records.view import View
from roemetry.run.linearisation import linearise
from roemetry.run.monte_carlo import Chain, Scene, propagate, without_draws
from roemetry.run.open_parts import (
    OpenPart,
    open_parts,
    open_points_reason,
    split_products,
    widened,
    widened_by,
)
from roemetry.run.preprocess import prepare, prepare_plain
from roemetry.run.scan import Placing, cut_by_scan, gather, measured_by_another, placed_only
from roemetry.run.stage_errors import describe_failure, is_refusal, plugin_frame
from roemetry.run.time_limit import StageTimeout, time_limit, timer_kept
from roemetry.run.transport_faults import check_joins, not_counted, not_told
from roemetry.stages.kinds import Extractor, check_result_type

T = TypeVar("T")

_HEIGHT_SLACK_MM = 0.5
"""Noise may lift a point by so much above the calibrated range."""

_TOO_HIGH_SHARE_MAX = 0.01
"""A hundredth of a product's points above the calibrated range may be false peaks; more is the product."""

_NO_VOLUME = Reason("no-volume", "there is no volume to weigh")

_EDGE_ROWS = 2
"""Rows at the image's ends in which a product counts as cut; extractors may leave the very first out."""

UNCALIBRATED = Reason("uncalibrated", "no calibration: results are in pixels")


class Pipeline:
    """The stages of a recipe, made once and used for every acquisition; safe to call from several threads.

    Parameters
    ----------
    debug
        Let every exception through instead of noting it on the trace.
    stages
        By kind, stages to use instead of those the recipe would make: objects with the kind's method.
    draws
        Monte Carlo draws; None: uncertainties as the recipe says; 0: none.
    frame
        Makes an acquisition's frame ready, or remembers it; None: `frame_of` does.
    """

    def __init__(
        self,
        recipe: Recipe,
        *,
        debug: bool = False,
        stages: Mapping[str, Any] | None = None,
        draws: int | None = None,
        frame: Callable[[Acquisition], Frame] | None = None,
    ) -> None:
        keep_freed_memory()
        self.recipe = recipe
        self._stages: Mapping[str, Any] = (
            {kind: chosen.make() for kind, chosen in recipe.stages.items()} if stages is None else stages
        )
        self._frame = frame or partial(frame_of, recipe, extractor=self._stages.get("extractor"))
        self._debug = debug
        self._view: View | None = None
        self._draws = recipe.draws if draws is None else draws
        self._linear = draws is None and recipe.uncertainty == "linear"
        # Draws must not meet a stage that remembers: each is another scene.
        self._chain = Chain(
            *(
                recipe.stages[kind].make()
                if kind in recipe.stages and (self._draws or self._linear)
                else None
                for kind in ("triangulator", "volume", "weigher", "classifier")
            )
        )

    def trace(self, acquisition: Acquisition, *, surfaces: bool = False) -> Trace:
        """Take one acquisition through the chain; whatever goes wrong stands in `Trace.absent`.

        With `surfaces`, the surface behind each volume and the relief beside each grade are kept to be drawn.
        """
        with nullcontext() if self.recipe.stage_timeout_s is None else timer_kept():
            return self._trace(acquisition, surfaces)

    def _trace(self, acquisition: Acquisition, surfaces: bool) -> Trace:
        steps = _Steps(self.recipe, self._debug)
        if acquisition.lines is not None or acquisition.profiles is not None:
            return self._trace_slices(acquisition, steps, surfaces)
        source = self.recipe.source_choice
        frame = steps.do("source", lambda: self._frame(acquisition))
        peaks: Peaks | None = None
        stripes: StripeMap | None = None
        outlines: tuple[Outline, ...] = ()
        profiles: Profiles | None = None
        products: tuple[ProductTrace, ...] = ()
        calibration = self.recipe.calibration
        if frame is not None:
            peaks = steps.do("extractor", lambda: self._stages["extractor"].extract(frame))
        fit = _unfit(frame, calibration)
        alignment: Alignment | None = None
        if peaks is not None and calibration is not None and "aligner" in self._stages and fit is None:
            made, own = calibration, self._stages["triangulator"]
            alignment = steps.do("aligner", lambda: self._stages["aligner"].align(peaks, made, own.moved))
            if alignment is None:
                fit = steps.absent["aligner"]
            elif alignment.moved:
                calibration = own.moved(made, alignment)
        if peaks is not None and "coder" in self._stages and steps.allow("coder", fit):
            stripes = steps.do("coder", lambda: self._stages["coder"].code(peaks, calibration))
        said = (() if peaks is None else peaks.reasons) + (() if alignment is None else alignment.reasons)
        if stripes is not None and said:
            stripes = replace(stripes, reasons=said + stripes.reasons)
        if stripes is not None and "smoother" in self._stages:
            stripes = steps.do("smoother", lambda: self._stages["smoother"].smooth(stripes))
        if stripes is not None and "outliner" in self._stages:
            plain = prepare_plain(acquisition, turn_deg=source.turn_deg)
            outlines = (
                steps.do(
                    "outliner", lambda: self._stages["outliner"].outline(frame, plain, stripes, calibration)
                )
                or ()
            )
        if (
            stripes is not None
            and "triangulator" in self._stages
            and steps.allow("triangulator", UNCALIBRATED if calibration is None else None)
        ):
            profiles = steps.do(
                "triangulator", lambda: self._stages["triangulator"].triangulate(stripes, calibration)
            )
        penetration = self.recipe.penetration
        if profiles is not None and penetration is not None:
            profiles = raise_surface(profiles, penetration.offset_mm)
        if profiles is not None and stripes is not None and calibration is not None:
            view = self._view_of(calibration)
            assembled = split_products(profiles, outlines, calibration, acquisition.id, stripes.reasons, view)
            opened = open_parts(peaks, stripes, outlines) if peaks is not None else {}
            assembled = tuple(_with_open_part(product, opened.get(product.number)) for product in assembled)
            doubts = {
                product.number: _undecided(product)
                or _too_high(product)
                or _cut_off(stripes, product.number)
                or (product.outline.fault if product.outline is not None else None)
                for product in assembled
            }
            products = tuple(
                self._outcome(product, doubts[product.number], steps.seconds) for product in assembled
            )
            scene = Scene(acquisition.id, stripes, outlines, calibration, penetration, view)
            products = self._drawn(products, scene, steps, self._chain)
            products = tuple(_with_open_points(found, opened) for found in products)
            products = self._concluded(products, doubts, steps, surfaces)
        return Trace(
            acquisition_id=acquisition.id,
            acquisition=acquisition,
            frame=frame,
            peaks=peaks,
            alignment=alignment,
            stripes=stripes,
            outlines=outlines,
            profiles=profiles,
            products=products,
            absent=steps.absent,
            seconds=steps.seconds,
        )

    def _trace_slices(self, acquisition: Acquisition, steps: _Steps, surfaces: bool) -> Trace:
        """Take a scan's lines, or slices that another sensor measured, to their products."""
        lines, slices, calibration = acquisition.lines, acquisition.profiles, self.recipe.calibration
        chain, scene, stripes = self._chain, None, None
        assembler = self._stages["assembler"]
        if lines is not None and steps.allow("assembler", UNCALIBRATED if calibration is None else None):
            assert calibration is not None
            made, placed, triangulator = calibration, lines, self._stages["triangulator"]
            stripes = steps.do("coder", lambda: gather(placed, self._frame, self._stages, made))
            if stripes is not None:
                place = partial(assembler.place, stripes, placed, made, triangulator)
                slices = steps.do("assembler", place)
                del place
        if slices is not None:
            own = None if lines is None else lines.own
            unlabelled = [slices]  # handed over, not kept: each set of slices of a long part takes 30 MB
            del slices
            slices = steps.do("assembler", lambda: assembler.label(unlabelled.pop(), own))
        products: tuple[ProductTrace, ...] = ()
        if slices is not None:
            view = None
            if lines is not None and stripes is not None and calibration is not None:
                per_line = stripes.stripe_count // len(lines.count)
                kept, lines = placed_only(stripes, lines, slices, per_line // 2)
                stripes, view = kept, self._view_of(calibration)
                scene = Scene(acquisition.id, kept, (), calibration, self.recipe.penetration, view)
                chain = replace(chain, triangulator=Placing(assembler, lines, self._chain.triangulator))
            else:
                calibration = measured_by_another(slices)
            if self.recipe.penetration is not None:
                slices = raise_surface(slices, self.recipe.penetration.offset_mm)
            assembled = split_products(slices, (), calibration, acquisition.id, view=view)
            doubts = {
                one.number: _too_high(one)
                or (None if stripes is None else _cut_off(stripes, one.number))
                or cut_by_scan(slices, one.number)
                for one in assembled
            }
            products = tuple(self._outcome(one, doubts[one.number], steps.seconds) for one in assembled)
            if scene is None:
                products = tuple(without_draws(found, approximate=False) for found in products)
            else:
                products = self._drawn(products, scene, steps, chain)
            products = self._concluded(products, doubts, steps, surfaces)
        return Trace(
            acquisition_id=acquisition.id,
            acquisition=acquisition,
            profiles=slices,
            products=products,
            absent=steps.absent,
            seconds=steps.seconds,
        )

    def _concluded(
        self, products: tuple[ProductTrace, ...], doubts: Mapping[int, Reason | None], steps: _Steps,
        surfaces: bool,
    ) -> tuple[ProductTrace, ...]:  # fmt: skip
        """Add surfaces where they are asked for, and decisions where there is a grader."""
        if surfaces:
            products = tuple(self._with_surface(found) for found in products)
        if "grader" in self._stages:
            products = tuple(
                self._decided(found, doubts[found.product.number], steps.seconds) for found in products
            )
        return products

    def _view_of(self, calibration: Calibration) -> View | None:
        """Give the view of a calibration; the recipe's own never changes, and neither does its view."""
        if calibration is not self.recipe.calibration:
            return calibration.view
        if self._view is None:
            self._view = self._stages["triangulator"].view(calibration)
        return self._view

    def _drawn(
        self, products: tuple[ProductTrace, ...], scene: Scene, steps: _Steps, chain: Chain
    ) -> tuple[ProductTrace, ...]:
        """Give the products with their uncertainties; without draws, name what is a part only."""
        if self._linear:
            linear = steps.do("uncertainty", lambda: linearise(products, scene, chain))
            return linear or products
        if not self._draws:
            view = scene.calibration.view
            approximate = view is not None and not view.exact
            return tuple(without_draws(found, approximate=approximate) for found in products)
        return (
            steps.do("uncertainty", lambda: propagate(products, scene, chain, draws=self._draws)) or products
        )

    def _outcome(self, product: Product, doubt: Reason | None, seconds: dict[str, float]) -> ProductTrace:
        steps = _Steps(self.recipe, self._debug, seconds)
        volume: Volume | None = None
        weight: Weight | None = None
        grade: Grade | None = None
        if "volume" in self._stages and steps.allow("volume", doubt):
            volume = steps.do("volume", lambda: self._stages["volume"].estimate(product))
        if "weigher" in self._stages and steps.allow(
            "weigher", doubt or (_NO_VOLUME if volume is None else None)
        ):
            weight = steps.do("weigher", lambda: self._stages["weigher"].weigh(product, volume))
        if "classifier" in self._stages and steps.allow("classifier", doubt):
            grade = steps.do("classifier", lambda: self._stages["classifier"].classify(product))
        return ProductTrace(product, volume, weight, grade, steps.absent)

    def _with_surface(self, found: ProductTrace) -> ProductTrace:
        """Add what is drawn of a product: the surface behind its volume, and that beside its grade."""
        steps, stages, product = _Steps(self.recipe, self._debug), self._stages, found.product
        if found.volume is not None:
            found = replace(found, surface=steps.do("surface", lambda: stages["volume"].surface(product)))
        if found.grade is not None:
            relief = steps.do("relief", lambda: stages["classifier"].relief(product))
            if relief is not None:  # else what came with the grade, if anything did, stays
                found = replace(found, grade=replace(found.grade, relief=relief))
        return replace(found, undrawn=steps.absent) if steps.absent else found

    def _decided(self, found: ProductTrace, doubt: Reason | None, seconds: dict[str, float]) -> ProductTrace:
        """Let the grader decide, on results that have their uncertainties."""
        steps = _Steps(self.recipe, self._debug, seconds)
        decision: Decision | None = None
        if steps.allow("grader", doubt):
            decision = steps.do(
                "grader",
                lambda: self._stages["grader"].decide(found.product, found.volume, found.weight, found.grade),
            )
        return replace(found, decision=decision, absent={**found.absent, **steps.absent})


def frame_of(recipe: Recipe, acquisition: Acquisition, *, extractor: Any = None) -> Frame:
    """Make the laser frame ready as the recipe's source says; see `roemetry.run.preprocess.prepare`.

    An extractor may compare lines and count steps of the grey level, sooner than the core does.
    """
    source = recipe.source_choice
    helper = extractor if isinstance(extractor, Extractor) else None
    lines_differ = not_told if helper is None else helper.lines_differ
    frame = prepare(
        acquisition,
        channel=source.channel,
        second_channel=source.second_channel,
        contrast=source.contrast,
        turn_deg=source.turn_deg,
        subtract=source.subtract,
        bit_depth=source.bit_depth,
        sensor=recipe.sensor,
        lines_differ=lines_differ,
    )
    # a contrast ends at once where the light is clipped: what the lens drew is in the grey image
    checked = frame
    if source.contrast != "none":
        checked = prepare(acquisition, turn_deg=0, subtract="none", lines_differ=lines_differ)
    check_joins(checked, not_counted if helper is None else helper.count_steps)
    return frame


_DRAWN_BY = {"surface": "volume", "relief": "classifier"}
"""The kind of stage that gives what is drawn."""


class _Steps:
    """Runs steps, takes their time, and notes why a result is missing."""

    def __init__(self, recipe: Recipe, debug: bool, seconds: dict[str, float] | None = None) -> None:
        self.absent: dict[str, Reason] = {}
        self.seconds: dict[str, float] = {} if seconds is None else seconds
        self._chosen = recipe.stages
        self._limit_s = recipe.stage_timeout_s
        self._debug = debug

    def do(self, kind: str, step: Callable[[], T]) -> T | None:
        """Run a step; None if it could not be done."""
        begin = time.perf_counter()
        try:
            with time_limit(self._limit_s):
                return check_result_type(kind, step())
        except StageTimeout as error:
            if self._debug:
                raise
            self.absent[kind] = Reason(f"{kind}-fault", self._not_finished(error, kind))
        # A fault in one plugin must not end a batch; the row says whose fault it is.
        except FAULTS as error:
            if self._debug:
                raise
            if is_refusal(error):
                self.absent[kind] = Reason(f"{kind}-refused", str(error))
            else:
                stage = _DRAWN_BY.get(kind, kind)
                self.absent[kind] = Reason(
                    f"{kind}-fault", describe_failure(error, stage, self._chosen.get(stage))
                )
        finally:
            self.seconds[kind] = self.seconds.get(kind, 0.0) + time.perf_counter() - begin
        return None

    def _not_finished(self, error: StageTimeout, step: str) -> str:
        kind = _DRAWN_BY.get(step, step)
        chosen = self._chosen.get(kind)
        whose = f"the {kind}" if chosen is None else f"the {kind} `{chosen.registered.entry.name}`"
        place = None if chosen is None else plugin_frame(error, chosen.stage.__module__)
        where = "" if place is None else f" (at {place})"
        return (
            f"{whose} had not finished after {self._limit_s:g} s{where}: it hangs, or needs more time; "
            "stage_timeout_s in the recipe is the limit"
        )

    def allow(self, kind: str, why_not: Reason | None) -> bool:
        """Say whether a step may be tried; if not, note why."""
        if why_not is not None:
            self.absent[kind] = why_not
        return why_not is None


def _with_open_part(product: Product, part: OpenPart | None) -> Product:
    """Say of a product what of it is open, instead of what was refused in the whole frame."""
    said = tuple(reason for reason in product.reasons if reason.code != "ambiguous")
    own = open_points_reason(part, product) if part is not None else None
    return replace(product, reasons=said if own is None else (own, *said))


def _undecided(product: Product) -> Reason | None:
    """Say why nothing can be stated of a product: most of it is open."""
    return next((reason for reason in product.reasons if reason.code == "undecided"), None)


def _with_open_points(found: ProductTrace, opened: Mapping[int, OpenPart]) -> ProductTrace:
    """Widen what is stated of a product by what is open of it."""
    part = opened.get(found.product.number)
    if part is None or not part.points:
        return found
    volume, weight = widened(found.volume, found.weight, widened_by(part, found.product))
    return replace(found, volume=volume, weight=weight)


def _too_high(product: Product) -> Reason | None:
    """Say why nothing can be stated of a product that is higher than the calibration was made for."""
    high_mm = product.calibration.height_range_mm[1]
    if not product.height_max_mm > high_mm + _HEIGHT_SLACK_MM:
        return None
    heights = product.profiles.xyz_mm[:, :, 2]
    heights = heights[np.isfinite(heights)]
    beyond = int(np.count_nonzero(heights > high_mm + _HEIGHT_SLACK_MM))
    if beyond <= _TOO_HIGH_SHARE_MAX * heights.size:
        return None
    return Reason(
        "above-calibrated-range",
        f"the product reaches {heights.max():.1f} mm, and {beyond / heights.size:.0%} of its points lie "
        f"above the {high_mm:.1f} mm that the calibration is meant for: calibrate for greater heights",
    )


def _cut_off(stripes: StripeMap, number: int) -> Reason | None:
    """Say why nothing can be stated of a product that runs out of the image."""
    product = stripes.product
    if not any((rows == number).any() for rows in (product[:, :_EDGE_ROWS], product[:, -_EDGE_ROWS:])):
        return None
    return Reason("cut-by-edge", "the product reaches the image's first or last row: a part is not seen")


def _unfit(frame: Frame | None, calibration: Calibration | None) -> Reason | None:
    """Say why an image cannot be used with the calibration."""
    if calibration is None or frame is None:
        return None
    if frame.turn_deg != calibration.turn_deg:
        return Reason(
            "other-turn",
            f"the image is turned by {frame.turn_deg}°, the calibration was made at {calibration.turn_deg}°; "
            "set source.turn_deg as in the rig file",
        )
    if frame.size != calibration.image_size:
        rows, columns = frame.size
        made_rows, made_columns = calibration.image_size
        return Reason(
            "other-camera",
            f"the image is {columns} × {rows} pixels, the calibration was made with "
            f"{made_columns} × {made_rows}: another camera or region of interest; calibrate this one",
        )
    return None


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_LARGEST_ON_HEAP = 32 << 20
"""Bytes: glibc takes no more. A frame of 12 megapixels fits."""
_KEPT = 256 << 20
"""Bytes that stay with the process between frames."""


@cache
def keep_freed_memory() -> None:
    """Let glibc keep freed memory; other C libraries do as they always do.

    It gives a large array's memory back to the system at once, and takes it anew for the next one: of the
    careful recipe's time on a frame a tenth went into pages that the system cleared.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _LARGEST_ON_HEAP)
    mallopt(_TRIM_THRESHOLD, _KEPT)
