"""Stages that are bad on purpose: each is caught by the check that is meant for it."""

from __future__ import annotations

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

    Options = GravityOptions
    capabilities = Capabilities(tolerance_px=0.2)
    shift_px = 0.0

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
                x.append(np.average(np.arange(begin, end), weights=weight) + self.shift_px)
                flags.append(int(frame.pixels[r, begin:end].max() == frame.white))
                height.append(weight.max())
        nan = np.full(len(row), np.nan)
        return Peaks(
            frame.size,
            np.array(row, np.int64),
            np.array(x, np.float64),
            nan,
            np.array(height, np.float64),
            nan,
            nan,
            np.array(flags, np.uint8),
        )


class Shifting(Gravity):
    shift_px = 0.5


class Remembering(Gravity):
    def __init__(self, options=None) -> None:
        super().__init__(options)
        self.calls = 0

    def extract(self, frame: Frame) -> Peaks:
        self.calls += 1
        found = super().extract(frame)
        return replace(found, x_px=found.x_px + 1e-9 * self.calls)


class LastFrame(Gravity):
    """The same for the same frame twice over; but a threshold learned from the frame before."""

    def __init__(self, options=None) -> None:
        super().__init__(options)
        self.brightest: list[int] = []

    def extract(self, frame: Frame) -> Peaks:
        self.brightest.append(int(frame.pixels.max()))
        return replace(found := super().extract(frame), amplitude=found.amplitude + self.brightest[0])


class Writing(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        frame.pixels.setflags(write=True)
        frame.pixels[0, 0] += 1
        return found


class WritingPlainly(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        frame.pixels[frame.pixels < 20] = 0
        return super().extract(frame)


class Locked(Gravity):
    def __init__(self, options=None) -> None:
        super().__init__(options)
        self.unpicklable = lambda: None


class Racing(Gravity):
    """Keeps its frame on itself while it works."""

    def extract(self, frame: Frame) -> Peaks:
        import time

        self.frame = frame
        time.sleep(0.005)
        return super().extract(self.frame)


class Crashing(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        if not (frame.pixels > 50).any():
            raise IndexError("index 0 is out of bounds")
        return super().extract(frame)


class FixedLevel(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        keep = found.amplitude > 0.5 * frame.white
        return _only(found, keep)


class EightBit(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        return _only(found, found.amplitude < 256)


class OneOfTwo(Gravity):
    """Takes two peaks nearer than 20 px for one."""

    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        near = (np.diff(found.row, prepend=-1) == 0) & (np.diff(found.x_px, prepend=-99.0) < 20.0)
        return _only(found, ~near)


class Unflagged(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        found = super().extract(frame)
        return replace(found, flags=np.zeros_like(found.flags))


class Raw(Gravity):
    """Reads the pixels' memory as if rows followed one another."""

    def extract(self, frame: Frame) -> Peaks:
        plain = np.frombuffer(frame.pixels.tobytes(order="A"), frame.pixels.dtype)
        return super().extract(Frame(plain.reshape(frame.size), bit_depth=frame.bit_depth))


class NoColour(Gravity):
    def extract(self, frame: Frame) -> Peaks:
        pixels = frame.pixels if frame.pixels.ndim == 2 else frame.pixels[:, :, 2]
        return super().extract(Frame(pixels, bit_depth=frame.bit_depth))


class LooseOptions(StageOptions):
    gain: float = 1.0


class Loose(Gravity):
    Options = LooseOptions


def _only(peaks: Peaks, keep: np.ndarray) -> Peaks:
    names = ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags")
    return replace(peaks, **{name: getattr(peaks, name)[keep] for name in names})


class ShiftedLabels(WindowTracking):
    """Gives every stripe right of a missing one its left neighbour's number."""

    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        missing = np.flatnonzero(~found.seen.any(axis=1))
        verdict = found.peak_stripe.copy()
        if missing.size:
            verdict[verdict > missing[0]] -= 1
        return replace(found, peak_stripe=verdict)


class Rounding(WindowTracking):
    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        return replace(found, x_px=np.round(found.x_px))


class Hasty(WindowTracking):
    """Takes what it refuses for the left neighbour's."""

    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        return replace(found, peak_stripe=np.where(found.peak_stripe == AMBIGUOUS, 0, found.peak_stripe))


class ThickBelt(WindowTracking):
    """Takes everything below 5 mm for belt."""

    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        near = np.abs(found.x_px - found.rest_px) < 10.0
        return replace(found, product=np.where(near & (found.product > 0), 0, found.product))


class AllProduct(WindowTracking):
    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        return replace(found, product=np.where(found.product == 0, 1, found.product))


class Boasting(WindowTracking):
    def code(self, peaks, calibration):
        found = super().code(peaks, calibration)
        return replace(found, seen=np.isfinite(found.x_px))


class Unsigned(BlockLinear):
    def triangulate(self, stripes, calibration):
        found = super().triangulate(stripes, calibration)
        return replace(
            found, xyz_mm=found.xyz_mm * [1.0, 1.0, np.sign(calibration.displacement_px_per_mm[0])]
        )


class Bent(BlockLinear):
    def triangulate(self, stripes, calibration):
        found = super().triangulate(stripes, calibration)
        bend = np.zeros_like(found.xyz_mm)
        bend[..., 2] = 1e-4 * found.xyz_mm[..., 0] ** 2
        return replace(found, xyz_mm=found.xyz_mm + bend)


class Filling(BlockLinear):
    def triangulate(self, stripes, calibration):
        found = super().triangulate(stripes, calibration)
        return replace(found, xyz_mm=np.nan_to_num(found.xyz_mm))


class AsTheyCome(ZeroOrderHold):
    """Holds every slice to the one that comes after it in the record."""

    def estimate(self, product, *, rng=None):
        profiles = product.profiles
        area = np.nansum(profiles.xyz_mm[..., 2], axis=1) * 0.25
        spacing = np.abs(np.diff(profiles.plane[:, 3] / profiles.plane[:, 0], append=np.nan))
        volume = super().estimate(product)
        return replace(volume, visible_mm3=Estimate(float(np.nansum(area * spacing))))


class InPixels(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        heights = product.profiles.xyz_mm[..., 2]
        return replace(
            super().estimate(product), visible_mm3=Estimate(float(np.nansum(heights) * 1.5 * 0.25))
        )


class OneSided(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        volume = super().estimate(product)
        sign = np.sign(product.calibration.displacement_px_per_mm[0])
        return replace(volume, visible_mm3=Estimate(volume.visible_mm3.value * (1.0 + 0.004 * sign)))


class Sure(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        volume = super().estimate(product)
        shares = replace(volume.shares, assumed=0.2)
        return replace(volume, visible_mm3=Estimate(volume.visible_mm3.value, 0.0), shares=shares)


class Inventing(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        if not (product.profiles.product > 0).any():
            return super().estimate(product_of(BOX))
        return super().estimate(product)


class Entropic(ZeroOrderHold):
    def estimate(self, product, *, rng=None):
        volume = super().estimate(product)
        noise = 0.0 if rng is None else float(np.random.default_rng().normal())
        return replace(volume, visible_mm3=Estimate(volume.visible_mm3.value + noise))


class Tared(Density):
    def weigh(self, product, volume, *, rng=None):
        return Weight(Estimate(super().weigh(product, volume).mass_g.value + 0.5))


class InKilograms(Density):
    def weigh(self, product, volume, *, rng=None):
        return Weight(Estimate(1e-3 * super().weigh(product, volume).mass_g.value))


class FirstSlice(ArcCurvature):
    """Looks at the first slice in the record alone, and guesses."""

    def classify(self, product, *, rng=None):
        higher = np.nan_to_num(product.profiles.xyz_mm[:12, :, 2]).max() > 5.0
        return Grade("good" if higher else "henkei", reasons=(Reason("first", "the first slices are so"),))


class Sided(ArcCurvature):
    def classify(self, product, *, rng=None):
        label = "good" if product.calibration.displacement_px_per_mm[0] > 0.0 else "henkei"
        return Grade(label, probability=1.5)


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


@pytest.mark.parametrize(
    ("stage", "check"),
    [
        (Shifting, "check_centres_are_right"),
        (Shifting, "check_centres_are_not_biased"),
        (Remembering, "check_same_input_gives_same_result"),
        (LastFrame, "check_keeps_nothing_between_calls"),
        (Writing, "check_leaves_its_input_alone"),
        (WritingPlainly, "check_leaves_its_input_alone"),
        (Racing, "check_threads_agree"),
        (Locked, "check_crosses_to_another_process"),
        (Crashing, "check_nothing_in_gives_nothing_out"),
        (Loose, "check_every_option_is_described"),
        (Loose, "check_every_number_is_bounded"),
        (FixedLevel, "check_brightness_does_not_matter"),
        (EightBit, "check_bit_depth_does_not_matter"),
        (OneOfTwo, "check_two_near_stripes_stay_two"),
        (Unflagged, "check_saturated_peaks_are_flagged"),
        (Raw, "check_memory_layout_does_not_matter"),
        (NoColour, "check_a_colour_frame_is_refused"),
        (ShiftedLabels, "check_a_missing_stripe_shifts_nothing"),
        (Rounding, "check_coded_points_are_peaks"),
        (Hasty, "check_gaps_shift_nothing"),
        (ThickBelt, "check_a_grazed_tail_is_product"),
        (ThickBelt, "check_a_smooth_wedge_is_product"),
        (AllProduct, "check_an_untouched_stripe_is_belt"),
        (AllProduct, "check_a_bare_belt_has_no_product"),
        (Boasting, "check_what_is_not_seen_is_marked"),
        (Idle, "check_scatter_becomes_less"),
        (MovingMean, "check_labels_and_gaps_stay"),
        (Unsigned, "check_a_mirrored_rig_measures_alike"),
        (Bent, "check_points_are_where_the_scene_is"),
        (Bent, "check_a_plane_stays_plane"),
        (Bent, "check_points_lie_on_their_slices_plane"),
        (Filling, "check_nothing_seen_gives_no_point"),
        (AsTheyCome, "check_order_of_slices_does_not_matter"),
        (InPixels, "check_volume_grows_with_the_cube"),
        (OneSided, "check_a_mirrored_scene_has_the_same_volume"),
        (Sure, "check_shares_add_up"),
        (Sure, "check_uncertainty_is_positive_or_not_stated"),
        (Inventing, "check_no_point_is_no_number"),
        (Entropic, "check_one_seed_gives_one_draw"),
        (Tared, "check_mass_is_proportional_to_volume"),
        (InKilograms, "check_the_mass_is_one_of_this_world"),
        (FirstSlice, "check_order_of_slices_does_not_matter"),
        (FirstSlice, "check_almost_nothing_is_unknown"),
        (Sided, "check_mirroring_does_not_matter"),
        (Sided, "check_every_class_has_reasons"),
        (Sided, "check_probability_is_one_or_not_stated"),
        (Nameless, "check_an_unreadable_file_is_named"),
        (Straying, "check_it_writes_only_inside_its_folder"),
        (NeedsRows, "check_an_empty_run_works"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.__name__,
)
def test_a_bad_stage_is_caught_by_the_check_meant_for_it(stage, check: str) -> None:
    result = run_check(stage(), _check(stage, check))
    assert result.outcome == "failed"
    assert len(result.message) > 10


def test_an_honest_stage_of_another_hand_passes() -> None:
    """The kit does not ask for what only the shipped stages do."""
    failed = {name_of(c): r.message for c in checks_of("extractor") if (r := run_check(Gravity(), c)).message}
    assert set(failed) <= {"check_brightness_does_not_matter", "check_crosses_to_another_process"}


def _check(stage, name: str):
    kind = next(kind for kind, cls in INTERFACES.items() if issubclass(stage, cls))
    return next(check for check in checks_of(kind) if name_of(check) == name)
