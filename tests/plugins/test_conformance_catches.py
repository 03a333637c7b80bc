"""Stages that are bad on purpose: each is caught by the check that is meant for it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from pydantic import Field

from roemetry.errors import DataError
from roemetry.records import AMBIGUOUS, Estimate, Frame, Grade, Peaks, Reason, Weight
from roemetry.stages import INTERFACES, Capabilities, Extractor, Smoother, StageOptions
from roemetry.testing import checks_of
from roemetry.testing.checks import name_of
from roemetry.testing.kit import run_check
from roemetry.testing.solids import BOX, product_of
from roemetry_files.image_files import ImageFiles
from roemetry_files.product_table import CsvTable
from roemetry_paper.arc_curvature import ArcCurvature
from roemetry_paper.block_linear import BlockLinear
from roemetry_paper.density import Density
from roemetry_paper.window_tracking import WindowTracking
from roemetry_paper.zero_order_hold import ZeroOrderHold


class GravityOptions(StageOptions):
    threshold: float = Field(default=0.2, gt=0.0, lt=1.0, description="share of the row's highest level")


class Gravity(Extractor[GravityOptions]):
    """A small honest extractor: centre of gravity of each run above a share of the frame's contrast."""

    capabilities = Capabilities(tolerance_px=0.2)

    def extract(self, frame: Frame) -> Peaks:
        if frame.pixels.ndim != 2:
            raise DataError("one channel is expected")
        grey = frame.pixels.astype(np.float64)
        floor = float(np.median(grey))
        above = grey - floor
        least = self.options.threshold * above.max()
        row, x, flags, height = [], [], [], []
        for r in range(grey.shape[0] if least > 0.05 * frame.white else 0):
            inside = np.concatenate([[False], above[r] > least, [False]])
            edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                weight = above[r, begin:end]
                row.append(r)
                x.append(np.average(np.arange(begin, end), weights=weight))
                flags.append(int(frame.pixels[r, begin:end].max() == frame.white))
                height.append(weight.max())
        nan, row, x = np.full(len(row), np.nan), np.array(row, np.int64), np.array(x, np.float64)
        return Peaks(frame.size, row, x, nan, np.array(height), nan, nan, np.array(flags, np.uint8))


VERBS = {
    Gravity: "extract",
    WindowTracking: "code",
    BlockLinear: "triangulate",
    ZeroOrderHold: "estimate",
    Density: "weigh",
    ArcCurvature: "classify",
}


def spoilt(base, change):
    """The stage, but for a `change` of what its verb gives, by that and what it was given."""
    verb = VERBS[base]
    real = getattr(base, verb)
    return type(
        "Spoilt", (base,), {verb: lambda self, *given, **more: change(real(self, *given, **more), *given)}
    )


def given_another(change):
    """`Gravity`, of a frame that is changed before."""
    return type("Spoilt", (Gravity,), {"extract": lambda self, frame: Gravity.extract(self, change(frame))})


class Remembering(Gravity):
    calls = 0

    def extract(self, frame):
        self.calls += 1
        found = super().extract(frame)
        return replace(found, x_px=found.x_px + 1e-9 * self.calls)


class SaysAllDiffer(Gravity):
    def lines_differ(self, pixels):
        return True


class LastFrame(Gravity):
    """The same for the same frame twice over; but a threshold learned from the frame before."""

    first = None

    def extract(self, frame):
        self.first = self.first or int(frame.pixels.max())
        return replace(found := super().extract(frame), amplitude=found.amplitude + self.first)


class Locked(Gravity):
    def __init__(self, options=None):
        super().__init__(options)
        self.unpicklable = lambda: None


class Racing(Gravity):
    """Keeps its frame on itself while it works."""

    def extract(self, frame):
        self.frame = frame
        time.sleep(0.005)
        return super().extract(self.frame)


class LooseOptions(StageOptions):
    gain: float = 1.0


class Loose(Gravity):
    Options = LooseOptions


class Inventing(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        return super().estimate(product if (product.profiles.product > 0).any() else product_of(BOX))


class Entropic(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        noise = 0.0 if rng is None else float(np.random.default_rng().normal())
        volume = super().estimate(product)
        return replace(volume, visible_mm3=Estimate(volume.visible_mm3.value + noise))


class Nameless(ImageFiles):
    def read(self, reference):
        try:
            return super().read(reference)
        except DataError as error:
            raise DataError("a file cannot be read") from error


class Straying(CsvTable):
    def write(self, run):
        (run.folder.parent / "log.txt").write_text("here", encoding="utf-8")
        return super().write(run)


class NeedsRows(CsvTable):
    def write(self, run):
        next(iter(run.measurements()))
        return super().write(run)


class MovingMean(Smoother[StageOptions]):
    """An honest, simple smoother of three rows that takes no notice of steps or gaps."""

    def smooth(self, stripes):
        filled = np.stack([np.convolve(np.pad(x, 1, "edge"), np.ones(3) / 3, "valid") for x in stripes.x_px])
        return replace(stripes, x_px=filled, x_std_px=stripes.x_std_px / np.sqrt(3.0), correlation_rows=1.0)


class Idle(Smoother[StageOptions]):
    def smooth(self, stripes):
        return stripes


def writes(frame):
    frame.pixels.setflags(write=True)
    frame.pixels[0, 0] += 1
    return frame


def writes_plainly(frame):
    frame.pixels[frame.pixels < 20] = 0
    return frame


def needs_light(frame):
    if not (frame.pixels > 50).any():
        raise IndexError("index 0 is out of bounds")
    return frame


def as_if_contiguous(frame):
    """Reads the pixels' memory as if rows followed one another."""
    plain = np.frombuffer(frame.pixels.tobytes(order="A"), frame.pixels.dtype)
    return Frame(plain.reshape(frame.size), bit_depth=frame.bit_depth)


def one_channel(frame):
    pixels = frame.pixels if frame.pixels.ndim == 2 else frame.pixels[:, :, 2]
    return Frame(pixels, bit_depth=frame.bit_depth)


def one_of_two(found, frame):
    """Takes two peaks nearer than 20 px for one."""
    near = (np.diff(found.row, prepend=-1) == 0) & (np.diff(found.x_px, prepend=-99.0) < 20.0)
    return found.some(~near)


def shifts_labels(found, *_):
    """Gives every stripe right of a missing one its left neighbour's number."""
    missing = np.flatnonzero(~found.seen.any(axis=1))
    beyond = (found.peak_stripe > missing[0]) if missing.size else 0
    return replace(found, peak_stripe=found.peak_stripe - beyond)


def thick_belt(found, *_):
    """Takes everything below 5 mm for belt."""
    near = np.abs(found.x_px - found.rest_px) < 10.0
    return replace(found, product=np.where(near & (found.product > 0), 0, found.product))


def bent(found, *_):
    return replace(found, xyz_mm=found.xyz_mm + [0.0, 0.0, 1e-4] * found.xyz_mm[..., :1] ** 2)


def side_of(product):
    return np.sign(getattr(product, "calibration", product).displacement_px_per_mm[0])


def as_they_come(volume, product):
    """Holds every slice to the one that comes after it in the record."""
    profiles = product.profiles
    area = np.nansum(profiles.xyz_mm[..., 2], axis=1) * 0.25
    spacing = np.abs(np.diff(profiles.plane[:, 3] / profiles.plane[:, 0], append=np.nan))
    return replace(volume, visible_mm3=Estimate(float(np.nansum(area * spacing))))


def in_pixels(volume, product):
    total = float(np.nansum(product.profiles.xyz_mm[..., 2]))
    return replace(volume, visible_mm3=Estimate(total * 1.5 * 0.25))


def sure(volume, _):
    known = Estimate(volume.visible_mm3.value, 0.0)
    return replace(volume, visible_mm3=known, shares=replace(volume.shares, assumed=0.2))


def first_slice(_, product):
    """Looks at the first slice in the record alone, and guesses."""
    higher = np.nan_to_num(product.profiles.xyz_mm[:12, :, 2]).max() > 5.0
    return Grade("good" if higher else "henkei", reasons=(Reason("first", "the first slices are so"),))


SHIFTED = spoilt(Gravity, lambda found, _: replace(found, x_px=found.x_px + 0.5))
THICK_BELT = spoilt(WindowTracking, thick_belt)
ALL_PRODUCT = spoilt(WindowTracking, lambda s, *_: replace(s, product=np.where(s.product == 0, 1, s.product)))
BENT = spoilt(BlockLinear, bent)
SURE = spoilt(ZeroOrderHold, sure)
FIRST_SLICE = spoilt(ArcCurvature, first_slice)
SIDED = spoilt(ArcCurvature, lambda _, product: Grade("good" if side_of(product) > 0.0 else "henkei"))

CAUGHT = {
    "check_centres_are_right": SHIFTED,
    "check_centres_are_not_biased": SHIFTED,
    "check_same_input_gives_same_result": Remembering,
    "check_differing_lines_are_told_for_certain": SaysAllDiffer,
    "check_keeps_nothing_between_calls": LastFrame,
    "check_leaves_its_input_alone": given_another(writes),
    "check_leaves_its_input_alone ": given_another(writes_plainly),
    "check_threads_agree": Racing,
    "check_crosses_to_another_process": Locked,
    "check_nothing_in_gives_nothing_out": given_another(needs_light),
    "check_every_option_is_described": Loose,
    "check_every_number_is_bounded": Loose,
    "check_brightness_does_not_matter": spoilt(Gravity, lambda p, f: p.some(p.amplitude > 0.5 * f.white)),
    "check_bit_depth_does_not_matter": spoilt(Gravity, lambda p, _: p.some(p.amplitude < 256)),
    "check_two_near_stripes_stay_two": spoilt(Gravity, one_of_two),
    "check_saturated_peaks_are_flagged": spoilt(Gravity, lambda p, _: replace(p, flags=0 * p.flags)),
    "check_memory_layout_does_not_matter": given_another(as_if_contiguous),
    "check_a_colour_frame_is_refused": given_another(one_channel),
    "check_a_missing_stripe_shifts_nothing": spoilt(WindowTracking, shifts_labels),
    "check_labelled_points_are_peaks": spoilt(
        WindowTracking, lambda s, *_: replace(s, x_px=np.round(s.x_px))
    ),
    "check_gaps_shift_nothing": spoilt(  # what it refuses is the first one's
        WindowTracking,
        lambda s, *_: replace(s, peak_stripe=np.where(s.peak_stripe == AMBIGUOUS, 0, s.peak_stripe)),
    ),
    "check_a_grazed_tail_is_product": THICK_BELT,
    "check_a_smooth_wedge_is_product": THICK_BELT,
    "check_an_untouched_stripe_is_belt": ALL_PRODUCT,
    "check_a_bare_belt_has_no_product": ALL_PRODUCT,
    "check_what_is_not_seen_is_marked": spoilt(
        WindowTracking, lambda s, *_: replace(s, seen=np.isfinite(s.x_px))
    ),
    "check_scatter_becomes_less": Idle,
    "check_labels_and_gaps_stay": MovingMean,
    "check_a_mirrored_rig_measures_alike": spoilt(
        BlockLinear, lambda f, _, made: replace(f, xyz_mm=f.xyz_mm * [1.0, 1.0, side_of(made)])
    ),
    "check_points_are_where_the_scene_is": BENT,
    "check_a_plane_stays_plane": BENT,
    "check_points_lie_on_their_slices_plane": BENT,
    "check_nothing_seen_gives_no_point": spoilt(
        BlockLinear, lambda f, *_: replace(f, xyz_mm=np.nan_to_num(f.xyz_mm))
    ),
    "check_order_of_slices_does_not_matter": spoilt(ZeroOrderHold, as_they_come),
    "check_volume_grows_with_the_cube": spoilt(ZeroOrderHold, in_pixels),
    "check_a_mirrored_scene_has_the_same_volume": spoilt(
        ZeroOrderHold,
        lambda v, p: replace(v, visible_mm3=Estimate(v.visible_mm3.value * (1.0 + 0.004 * side_of(p)))),
    ),
    "check_shares_add_up": SURE,
    "check_uncertainty_is_positive_or_not_stated": SURE,
    "check_no_point_is_no_number": Inventing,
    "check_one_seed_gives_one_draw": Entropic,
    "check_mass_is_proportional_to_volume": spoilt(
        Density, lambda w, *_: Weight(Estimate(w.mass_g.value + 0.5))
    ),
    "check_the_mass_is_one_of_this_world": spoilt(
        Density, lambda w, *_: Weight(Estimate(1e-3 * w.mass_g.value))
    ),
    "check_order_of_slices_does_not_matter ": FIRST_SLICE,
    "check_almost_nothing_is_unknown": FIRST_SLICE,
    "check_mirroring_does_not_matter": SIDED,
    "check_every_class_has_reasons": SIDED,
    "check_probability_is_one_or_not_stated": spoilt(ArcCurvature, lambda g, _: Grade(g.label, 1.5)),
    "check_an_unreadable_file_is_named": Nameless,
    "check_it_writes_only_inside_its_folder": Straying,
    "check_an_empty_run_works": NeedsRows,
}
"""By check a stage that it is meant for; a blank at the end of a name tells two of the same apart."""


@pytest.mark.parametrize("check", CAUGHT)
def test_a_bad_stage_is_caught_by_the_check_meant_for_it(check):
    stage = CAUGHT[check]
    kind = next(kind for kind, cls in INTERFACES.items() if issubclass(stage, cls))
    (meant,) = (one for one in checks_of(kind) if name_of(one) == check.strip())
    result = run_check(stage(), meant)
    assert result.outcome == "failed"
    assert len(result.message) > 10


def test_an_honest_stage_of_another_hand_passes():
    """The kit does not ask for what only the shipped stages do."""
    failed = {name_of(c) for c in checks_of("extractor") if run_check(Gravity(), c).message}
    assert failed <= {"check_brightness_does_not_matter", "check_crosses_to_another_process"}
