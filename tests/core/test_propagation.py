"""Monte Carlo against closed forms: what is linear in heights has an uncertainty one can write down."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Estimate, Grade, Outline, ProductTrace, Shares, StripeMap, Volume, Weight
from roemetry.records.calibration import Calibration
from roemetry.run.linearisation import linearise
from roemetry.run.monte_carlo import Chain, Scene, moved_by, offset_contour, propagate
from roemetry.run.open_parts import split_products
from roemetry.stages import Classifier, StageOptions, VolumeEstimator, Weigher
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear

RIG = LinearRig()
STD_PX = 0.2
OMEGA_RELATIVE = 0.01
DRAWS = 1000


class SumOfHeights(VolumeEstimator[StageOptions]):
    """Sum of all heights; its model errs by `model_mm3`."""

    model_mm3 = 0.0

    @property
    def states_model_error(self) -> bool:
        return True

    def estimate(self, product, *, rng=None):
        error = 0.0 if rng is None else rng.normal(0.0, self.model_mm3)
        value = float(np.nansum(product.profiles.xyz_mm[:, :, 2])) + error
        return Volume(Estimate(value), None, Shares(1.0, 0.0, 0.0))


class Erring(SumOfHeights):
    model_mm3 = 30.0


class Silent(SumOfHeights):
    @property
    def states_model_error(self) -> bool:
        return False


class ByOutline(SumOfHeights):
    """Height of the contour's box, px."""

    def estimate(self, product, *, rng=None):
        return Volume(Estimate(float(np.ptp(product.outline.xy_px[:, 1]))), None, Shares(1.0, 0.0, 0.0))


class Refusing(SumOfHeights):
    """Refuses what came out larger than the truth."""

    limit = 0.0

    def estimate(self, product, *, rng=None):
        found = super().estimate(product, rng=rng)
        if found.visible_mm3.value > self.limit:
            raise StageError("too much")
        return found


class Tenth(Weigher[StageOptions]):
    @property
    def states_model_error(self) -> bool:
        return True

    def weigh(self, product, volume, *, rng=None):
        error = 0.0 if rng is None else rng.normal(0.0, 5.0)
        return Weight(Estimate(0.1 * volume.visible_mm3.value + error))


class WithInterval(Tenth):
    def weigh(self, product, volume, *, rng=None):
        return Weight(replace(super().weigh(product, volume, rng=rng).mass_g, std=5.0, interval=(0.0, 1e6)))


class FromTheMiddle(BlockLinear):
    """Gives points in another order than the image's rows."""

    def triangulate(self, stripes, calibration):
        found = super().triangulate(stripes, calibration)
        fields = ("xyz_mm", "product", "seen", "x_px", "row_px", "height_std_mm")
        return replace(
            found, **{name: np.roll(getattr(found, name), RIG.rows // 2, axis=1) for name in fields}
        )


class AboveLimit(Classifier[StageOptions]):
    limit = 0.0

    def classify(self, product, *, rng=None):
        total = float(np.nansum(product.profiles.xyz_mm[:, :, 2]))
        return Grade("large" if total > self.limit else "small")


def calibration() -> Calibration:
    """Ω uncertain by 1 %, common to all stripes."""
    exact = RIG.calibration()
    omega = exact.parameters["omega_mm_per_px"]
    covariance = np.zeros_like(exact.covariance)
    covariance[: omega.size, : omega.size] = (OMEGA_RELATIVE**2) * np.outer(omega, omega)
    return replace(exact, covariance=covariance)


def scene(stripes: StripeMap | None = None, outlines: tuple[Outline, ...] = ()) -> Scene:
    given = RIG.stripe_map(RIG.dome()) if stripes is None else stripes
    std = np.where(given.seen, STD_PX, np.nan) if stripes is None else given.x_std_px
    return Scene("a", replace(given, x_std_px=std), outlines, calibration())


def done(
    given: Scene,
    estimator=None,
    weigher=None,
    classifier=None,
    draws: int = DRAWS,
    triangulator=BlockLinear(),  # noqa: B008
    name: str = "a",
) -> ProductTrace:
    """Results with uncertainties by so many draws; without draws by linearisation."""
    given = replace(given, acquisition_id=name)
    profiles = triangulator.triangulate(given.stripes, given.calibration)
    (product,) = split_products(profiles, given.outlines, given.calibration, "a")
    volume = None if estimator is None else estimator.estimate(product)
    found = ProductTrace(
        product=product,
        volume=volume,
        weight=None if weigher is None else weigher.weigh(product, volume),
        grade=None if classifier is None else classifier.classify(product),
    )
    chain = Chain(triangulator, estimator, weigher, classifier)
    if not draws:
        return linearise((found,), given, chain)[0]
    return propagate((found,), given, chain, draws=draws)[0]


def closed_form(given: Scene) -> tuple[float, float, int]:
    """Value, part of the peaks, number of points of the product."""
    mine = given.stripes.product == 1
    value = float(RIG.dome()[mine].sum())
    return value, STD_PX / RIG.px_per_mm * math.sqrt(mine.sum()), int(mine.sum())


def test_parts_and_sum_are_the_closed_forms() -> None:
    given = scene()
    value, peaks, _ = closed_form(given)
    found = done(given, Erring(), Tenth())
    visible, mass = found.volume.visible_mm3, found.weight.mass_g
    expected = {"peak noise": peaks, "calibration": OMEGA_RELATIVE * value, "volume model": 30.0}
    assert visible.value == pytest.approx(value, rel=1e-12)
    assert set(visible.budget) == set(expected)
    # 250 draws a cause know a standard deviation to 4.5 %: 4 of those; all together 1000 draws, 2.2 %.
    for cause, part in expected.items():
        assert visible.budget[cause] == pytest.approx(part, rel=0.18), cause
    total = math.sqrt(sum(part**2 for part in expected.values()))
    assert visible.std == pytest.approx(total, rel=0.09)
    low, high = visible.interval
    assert high - low == pytest.approx(2 * 1.96 * total, rel=0.12)
    assert low < value < high
    assert mass.std == pytest.approx(math.hypot(0.1 * total, 5.0), rel=0.09)
    assert mass.budget["weight model"] == pytest.approx(5.0, rel=0.18)


def test_points_need_not_stand_in_the_order_of_rows() -> None:
    usual, other = (
        done(scene(), SumOfHeights(), draws=60, triangulator=by).volume.visible_mm3
        for by in (BlockLinear(), FromTheMiddle())
    )
    assert other.std == pytest.approx(usual.std, rel=1e-9)
    assert other.budget == pytest.approx(usual.budget, rel=1e-9)


def largest_height(noise_px=0.0, std_px: float = STD_PX, relative: float = 0.0, draws: int = 60) -> Estimate:
    """Put noise on the stripes of a dome, and draw the largest height's uncertainty."""
    given = scene()
    stripes = given.stripes
    stripes = replace(
        stripes,
        x_px=np.where(stripes.seen, stripes.x_px + noise_px, stripes.x_px),
        x_std_px=np.where(stripes.seen, std_px, np.nan),
    )
    covariance = (relative / OMEGA_RELATIVE) ** 2 * given.calibration.covariance
    calibration = replace(given.calibration, covariance=covariance)
    return done(replace(given, stripes=stripes, calibration=calibration), draws=draws).height_max_mm


def test_a_scale_in_common_moves_the_largest_height_in_proportion() -> None:
    height = largest_height(std_px=1e-9, relative=OMEGA_RELATIVE, draws=1000)
    assert height.std == pytest.approx(OMEGA_RELATIVE * height.value, rel=0.1)
    assert height.budget["calibration"] == pytest.approx(height.std, rel=0.15)
    assert height.budget["peak noise"] < 1e-6 * height.value
    low, high = height.interval
    assert high - height.value == pytest.approx(height.value - low, abs=1e-9)  # mm
    assert set(largest_height().budget) == {"peak noise"}, "what does not touch it is not in its budget"


@pytest.mark.thorough
def test_the_largest_heights_interval_holds_though_noise_lifts_it(rng: np.random.Generator) -> None:
    true_mm = largest_height(draws=2).value
    shape = RIG.stripe_map(RIG.dome()).x_px.shape
    found = [largest_height(rng.normal(0.0, STD_PX, shape), draws=50) for _ in range(100)]
    off_mm = np.array([height.value - true_mm for height in found])
    assert off_mm.mean() > 2 * off_mm.std() / 10.0, "noise lifts the largest of many heights"
    assert sum(height.interval[0] < true_mm < height.interval[1] for height in found) >= 90
    rms_mm = math.sqrt(float(np.mean(off_mm**2)))
    assert np.median([height.std for height in found]) == pytest.approx(rms_mm, rel=0.35)


def test_correlated_peaks_weigh_more() -> None:
    """Noise with exp(−Δ²/(4ℓ²)) sums to √(2ℓ√π) times as much over long stripes."""
    given = scene()
    _, peaks, _ = closed_form(given)
    reach = 3.0
    found = done(replace(given, stripes=replace(given.stripes, correlation_rows=reach)), SumOfHeights())
    factor = math.sqrt(2.0 * reach * math.sqrt(math.pi))
    assert found.volume.visible_mm3.budget["peak noise"] == pytest.approx(factor * peaks, rel=0.2)


def test_bridged_points_move_with_their_ends() -> None:
    """A bridge of n points between two seen ones errs like n/2 times each of its ends."""
    heights = np.zeros((RIG.stripes, RIG.rows))
    heights[3, 90:111] = 5.0
    stripes = RIG.stripe_map(heights)
    seen = stripes.seen.copy()
    seen[3, 91:110] = False
    std = np.where(stripes.product == 1, np.where(seen, STD_PX, np.nan), 0.0)
    found = done(scene(replace(stripes, seen=seen, x_std_px=std)), SumOfHeights())
    each = 1.0 + 19 / 2.0
    expected = STD_PX / RIG.px_per_mm * each * math.sqrt(2.0)
    assert found.volume.visible_mm3.budget["peak noise"] == pytest.approx(expected, rel=0.18)


def test_what_is_not_stated_gives_no_interval() -> None:
    given = scene()
    for draws in (60, 0):
        found = done(given, Silent(), Tenth(), draws=draws)
        assert math.isnan(found.volume.visible_mm3.std)
        assert math.isnan(found.weight.mass_g.std)
        assert np.isnan(found.volume.visible_mm3.interval).all()
        assert [reason.code for reason in found.volume.reasons] == ["volume-model-not-stated"]
        assert set(found.volume.visible_mm3.budget) == {"peak noise", "calibration"}
    found = done(given, Silent(), WithInterval(), draws=60)
    assert math.isnan(found.weight.mass_g.std), "and an interval of the weigher's own is none of the whole"
    assert np.isnan(found.weight.mass_g.interval).all()
    unknown = np.full_like(given.stripes.x_px, np.nan)
    silent = replace(given, stripes=replace(given.stripes, x_std_px=unknown))
    classifier = Softly()
    classifier.limit = closed_form(given)[0]
    found = done(silent, SumOfHeights(), classifier=classifier, draws=200)
    assert [reason.code for reason in found.volume.reasons] == ["peak-noise-not-stated"]
    assert set(found.volume.visible_mm3.budget) == {"calibration", "volume model"}
    assert found.grade.features_std == {}
    assert math.isnan(found.height_max_mm.std) and math.isnan(found.height_max_mm.interval[0])
    assert set(found.height_max_mm.budget) == {"calibration"}


def test_draws_that_are_refused_state_nothing_and_a_side_that_is_refused_is_as_far_as_the_other() -> None:
    refusing = Refusing()
    refusing.limit = closed_form(scene())[0] + 1e-6
    found = done(scene(), refusing, draws=100)
    assert math.isnan(found.volume.visible_mm3.std)
    assert [reason.code for reason in found.volume.reasons] == ["draws-refused"]
    linear, usual = (done(scene(), by, draws=0).volume.visible_mm3 for by in (refusing, SumOfHeights()))
    assert linear.budget == pytest.approx(usual.budget, rel=1e-6)


def contour(std_px: float) -> Outline:
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    return Outline(1, np.column_stack([160 + 80 * np.cos(angle), 100 + 40 * np.sin(angle)]), std_px)


def test_a_calibration_known_to_be_approximate_gives_no_interval(root: Path) -> None:
    view = Calibration.load(root / "recipes" / "herring_roe" / "calibration.yaml").view
    assert not view.exact
    given = scene()
    approximate = replace(given, calibration=replace(given.calibration, view=view))
    found = done(approximate, SumOfHeights(), draws=50).volume
    assert math.isnan(found.visible_mm3.std)
    assert found.visible_mm3.budget["calibration"] > 0.0
    assert [reason.code for reason in found.reasons] == ["calibration-model-not-stated"]
    exact = replace(approximate, calibration=replace(approximate.calibration, view=replace(view, exact=True)))
    assert math.isfinite(done(exact, SumOfHeights(), draws=50).volume.visible_mm3.std)


def test_a_contour_moves_as_one() -> None:
    out = offset_contour(contour(0.5), 2.0).xy_px
    assert np.ptp(out[:, 0]) == pytest.approx(164.0, abs=0.1)  # px
    back = offset_contour(replace(contour(0.5), xy_px=contour(0.5).xy_px[::-1]), 2.0).xy_px
    assert np.ptp(back[:, 1]) == pytest.approx(84.0, abs=0.1)  # px
    found = done(scene(outlines=(contour(0.5),)), ByOutline())
    assert found.volume.visible_mm3.budget["outline"] == pytest.approx(2 * 0.5, rel=0.18)
    assert found.volume.visible_mm3.std == pytest.approx(1.0, rel=0.1)


def test_what_is_read_off_a_contour_is_drawn_with_it_and_no_longer_in_doubt() -> None:
    given = replace(contour(0.5), features={"convexity": 0.99, "convexity_std": 0.004, "grey_mean": 50.0})
    moved = moved_by(given, 1.5)
    assert moved.features == {"convexity": pytest.approx(0.996), "grey_mean": 50.0}
    assert np.array_equal(moved.xy_px, offset_contour(given, 0.75).xy_px)


def test_an_outline_of_unknown_error_matters_only_where_it_is_used() -> None:
    given = scene(outlines=(contour(math.nan),))
    used = done(given, ByOutline(), draws=60)
    assert [reason.code for reason in used.volume.reasons] == ["outline-error-not-stated"]
    unused = done(given, SumOfHeights(), draws=60)
    assert math.isfinite(unused.volume.visible_mm3.std)


@pytest.mark.parametrize(
    ("draws", "said"), [(1, "one draw has no scatter"), (3, "few"), (4, "few"), (19, "few"), (20, "")]
)
def test_few_draws_say_that_they_are_few(draws: int, said: str) -> None:
    volume = done(scene(), SumOfHeights(), draws=draws).volume
    # Student's distribution of fewer than three degrees of freedom has no finite variance
    assert math.isfinite(volume.visible_mm3.std) == (draws > 3)
    assert bool(volume.reasons) == bool(said)
    assert not said or said in volume.reasons[-1].code + volume.reasons[-1].text


def test_the_grades_probability_is_the_share_of_draws() -> None:
    """With the limit one standard uncertainty below the value, 84 % of draws stay above."""
    given = scene()
    value, peaks, _ = closed_form(given)
    classifier = AboveLimit()
    classifier.limit = value - math.hypot(peaks, OMEGA_RELATIVE * value)
    found = done(given, SumOfHeights(), classifier=classifier)
    assert found.grade.label == "large"
    assert found.grade.probability == pytest.approx(0.8413, abs=0.05)
    classifier.limit = value - 1e-6
    assert done(given, SumOfHeights(), None, classifier, draws=0).grade.probability < 0.9
    classifier.limit *= 0.5
    assert done(given, SumOfHeights(), None, classifier, draws=0).grade.probability == 1.0


class WithTotal(AboveLimit):
    """Tells what it judges by."""

    def classify(self, product, *, rng=None):
        total = float(np.nansum(product.profiles.xyz_mm[:, :, 2]))
        return replace(super().classify(product), features={"total": total})


@pytest.mark.parametrize("draws", [2, 4, 18])
def test_few_draws_make_no_grade_sure(draws: int) -> None:
    """Draws that agree say as much as if one more did not; below 19 none reaches 0.95."""
    given = scene()
    classifier = WithTotal()
    classifier.limit = 0.5 * closed_form(given)[0]
    grade = done(given, SumOfHeights(), classifier=classifier, draws=draws).grade
    assert grade.probability == pytest.approx(draws / (draws + 1.0))
    assert grade.probability < 0.95
    assert bool(grade.features_std) == (draws > 3), "three draws know no standard deviation"


class NeverSure(AboveLimit):
    """Names no class, and has a feature that no draw changes, of a value no sum of equals hits."""

    def classify(self, product, *, rng=None):
        return Grade("unknown", features={"always": 0.1})


@pytest.mark.parametrize("draws", [60, 0])
def test_an_unknown_grade_has_no_probability_and_what_never_changes_no_scatter(draws: int) -> None:
    found = done(scene(), SumOfHeights(), classifier=NeverSure(), draws=draws)
    assert math.isnan(found.grade.probability)
    assert found.grade.features_std == {"always": 0.0}


class Softly(AboveLimit):
    """States a probability of both classes: a straight line over 100 mm, far from its ends."""

    def classify(self, product, *, rng=None):
        total = float(np.nansum(product.profiles.xyz_mm[:, :, 2]))
        large = 0.5 + (total - self.limit) / 200.0
        told = {"probability_large": large, "probability_small": 1.0 - large, "total_mm": total}
        label = "large" if large > 0.5 else "small"
        return Grade(label, told[f"probability_{label}"], told)


def test_the_models_doubt_and_the_measurements_are_one_probability() -> None:
    """Of a probability that is a straight line the mean over draws is its value at the mean: 0.53."""
    given = scene()
    value, peaks, _ = closed_form(given)
    classifier = Softly()
    classifier.limit = value - 6.0
    found = done(given, SumOfHeights(), classifier=classifier)
    std = math.hypot(peaks, OMEGA_RELATIVE * value)
    assert std < 25.0, "the line must not end within the draws"
    assert found.grade.probability == pytest.approx(0.53, abs=4 * std / 200.0 / math.sqrt(DRAWS))
    assert found.grade.features_std["total_mm"] == pytest.approx(std, rel=0.1)


def test_linearised_parts_are_the_closed_forms() -> None:
    """Only noise, of which twelve patterns are run, and a model that is drawn are not exact."""
    given = scene(outlines=(contour(0.5),))
    value, peaks, _ = closed_form(given)
    found = done(given, Erring(), Tenth(), draws=0)
    visible, mass = found.volume.visible_mm3, found.weight.mass_g
    assert visible.value == pytest.approx(value, rel=1e-12)
    assert visible.budget["calibration"] == pytest.approx(OMEGA_RELATIVE * value, rel=1e-6)
    assert visible.budget["outline"] == 0.0
    assert visible.budget["volume model"] == pytest.approx(30.0, rel=0.4)  # 50 draws: 10 %, four times
    assert visible.budget["peak noise"] == pytest.approx(peaks, rel=0.6)  # 12 patterns: 20 %, three times
    assert visible.std == pytest.approx(math.hypot(*visible.budget.values()), rel=1e-12)
    assert visible.interval == pytest.approx((value - 1.959964 * visible.std, value + 1.959964 * visible.std))
    carried = 0.1 * math.hypot(visible.budget["calibration"], visible.budget["peak noise"])
    own = math.hypot(mass.budget["volume model"], mass.budget["weight model"])
    assert mass.std == pytest.approx(math.hypot(carried, own), rel=1e-6)
    moved = done(given, ByOutline(), draws=0).volume.visible_mm3
    assert moved.budget["outline"] == pytest.approx(1.0, rel=1e-3)  # both ends by 0.5 px


def test_linearised_uncertainty_hangs_on_no_name_and_agrees_with_draws() -> None:
    one, other = (done(scene(), SumOfHeights(), Tenth(), draws=0, name=name) for name in ("a", "b"))
    assert one.volume.visible_mm3 == other.volume.visible_mm3
    assert one.weight == other.weight
    assert one.height_max_mm == other.height_max_mm
    drawn = done(scene(), SumOfHeights(), Tenth())
    assert one.volume.visible_mm3.std == pytest.approx(drawn.volume.visible_mm3.std, rel=0.09)
    assert one.weight.mass_g.std == pytest.approx(drawn.weight.mass_g.std, rel=0.3)  # 50 draws of its model


def test_numbers_that_are_kept_are_those_that_the_generator_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = done(scene(), draws=0).height_max_mm
    again = done(scene(), draws=0).height_max_mm
    monkeypatch.setattr("roemetry.run.monte_carlo._KEPT_MAX", 0)
    assert kept == again == done(scene(), draws=0).height_max_mm
    assert kept.budget["peak noise"] > 0.0
