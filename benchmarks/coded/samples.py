"""A sample: peaks, the truth they come from, and what goes wrong between; and what a coder made of them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from benchmarks.coded.scenes import CodingRig, Crossings, crossings_of, in_view
from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.stripes import SATURATED
from roemetry_simulate.solid import Solid
from roemetry_tools.compare.stripes import REACH_PX, longest_run, nearest


@dataclass(frozen=True)
class Damage:
    """How much of each damage a sample gets."""

    missing_share: float = 0.002
    """Share of peaks that are lost one by one."""
    gaps: int = 0
    """Breaks of 2–25 rows along single stripes."""
    belt_lost: str = ""
    """``above``, ``below``: the belt beyond the product on that side of the image is not seen, on four fifths
    of the stripes that a product moves; ``some``: on half of them, on a side drawn for each; "" for none."""
    blobs: int = 0
    """Bright spots of 5–14 px radius, where peaks are lost and one or two false ones a row appear."""
    false_peaks: int = 0
    """Single false peaks."""
    dirt: int = 0
    """Specks that glow: false runs of 3–15 rows."""
    ghosts: int = 0
    """Second reflections: false runs of 20–60 rows that follow a piece of a stripe 10–60 px beside it."""
    dead_stripes: int = 0
    """Stripes without light."""
    lost_rows: int = 0
    """Blocks of 3–12 rows of which nothing is left."""


DAMAGES = {
    "none": Damage(),
    "gaps": Damage(gaps=12),
    "belt-above": Damage(belt_lost="above"),
    "belt-below": Damage(belt_lost="below"),
    "belt-some": Damage(belt_lost="some"),
    "blobs": Damage(blobs=4),
    "false": Damage(false_peaks=60),
    "dirt": Damage(dirt=8),
    "ghosts": Damage(ghosts=2),
    "dead-stripe": Damage(dead_stripes=1),
    "lost-rows": Damage(lost_rows=3),
}
"""One damage at a time, by name; `none` still loses two peaks in a thousand."""


def kept(crossings: Crossings, damage: Damage, rng: np.random.Generator) -> Flags:
    """Say which crossings make a peak at all: (crossing,). Blobs are counted by `blobs_of`."""
    keep = rng.random(crossings.row.size) >= damage.missing_share
    stripes = np.unique(crossings.stripe)
    for _ in range(damage.gaps):
        stripe, start = rng.choice(stripes), rng.integers(0, int(crossings.row.max()))
        rows = int(rng.integers(2, 26))
        within = (crossings.row >= start) & (crossings.row < start + rows)
        keep &= ~((crossings.stripe == stripe) & within)
    if damage.belt_lost:
        _lose_belt(crossings, damage.belt_lost, keep, rng)
    for stripe in rng.choice(stripes, damage.dead_stripes, replace=False):
        keep &= crossings.stripe != stripe
    for _ in range(damage.lost_rows):
        start = int(rng.integers(0, int(crossings.row.max())))
        keep &= ~((crossings.row >= start) & (crossings.row < start + int(rng.integers(3, 13))))
    return keep


def dead_of(crossings: Crossings, keep: Flags) -> Integers:
    """Stripes that have crossings and no peak."""
    return np.setdiff1d(crossings.stripe, crossings.stripe[keep])


def blobs_of(crossings: Crossings, keep: Flags, count: int, rng: np.random.Generator) -> tuple[Flags, Floats]:
    """Put bright spots onto products: which crossings are left, and the false peaks (peak, row and x)."""
    false = [np.empty((0, 2))]
    at = np.flatnonzero(crossings.on_product)
    for _ in range(count if at.size else 0):
        middle = rng.choice(at)
        row, x_px = crossings.row[middle] + rng.normal(0, 6), crossings.x_px[middle] + rng.normal(0, 8)
        high, wide = rng.uniform(5.0, 14.0, 2)
        inside = ((crossings.row - row) / high) ** 2 + ((crossings.x_px - x_px) / wide) ** 2 < 1.0
        keep = keep & ~inside
        rows = np.arange(np.ceil(row - high), np.floor(row + high) + 1)
        half = wide * np.sqrt(np.clip(1.0 - ((rows - row) / high) ** 2, 0.0, None))
        if rng.random() < 0.5:  # one broad peak in its middle, or one at each edge
            false.append(np.column_stack([rows, x_px + rng.normal(0.0, 0.8, rows.size)]))
        else:
            wide_enough = half > 3.0
            for sign in (-1.0, 1.0):
                edge = x_px + sign * half + rng.normal(0.0, 0.5, rows.size)
                false.append(np.column_stack([rows, edge])[wide_enough])
    return keep, np.concatenate(false)


def false_peaks(
    crossings: Crossings, damage: Damage, size: tuple[int, int], rng: np.random.Generator
) -> Floats:
    """Draw false peaks, dirt and ghosts: (peak, row and x)."""
    rows, columns = size
    single = np.column_stack(
        [rng.integers(0, rows, damage.false_peaks), rng.uniform(5.0, columns - 6.0, damage.false_peaks)]
    ).astype(np.float64)
    false = [single]
    for _ in range(damage.dirt):
        row, length = rng.integers(0, rows - 16), int(rng.integers(3, 16))
        run = np.arange(row, row + length, dtype=np.float64)
        x_px = rng.uniform(10.0, columns - 11.0) + 1.5 * np.sin(np.linspace(0.0, np.pi, length))
        false.append(np.column_stack([run, x_px + rng.normal(0.0, 0.2, length)]))
    at = np.flatnonzero(crossings.on_product)
    for _ in range(damage.ghosts if at.size else 0):
        origin = rng.choice(at)
        stripe, start = crossings.stripe[origin], crossings.row[origin]
        length, beside = int(rng.integers(20, 61)), rng.choice([-1.0, 1.0]) * rng.uniform(10.0, 60.0)
        near = (crossings.stripe == stripe) & (crossings.row >= start) & (crossings.row < start + length)
        x_px = crossings.x_px[near] + beside + rng.normal(0.0, 0.2, int(near.sum()))
        false.append(np.column_stack([crossings.row[near].astype(np.float64), x_px]))
    return np.concatenate(false)


def _lose_belt(crossings: Crossings, which: str, keep: Flags, rng: np.random.Generator) -> None:
    """Take the belt of one side of the product away, stripe by stripe."""
    for stripe in np.unique(crossings.stripe[crossings.on_product]):
        mine = crossings.stripe == stripe
        rows = crossings.row[mine & crossings.on_product]
        if rng.random() >= (0.5 if which == "some" else 0.8):
            continue
        side = rng.choice(["above", "below"]) if which == "some" else which
        beyond = crossings.row < rows.min() if side == "above" else crossings.row > rows.max()
        keep &= ~(mine & ~crossings.on_product & beyond)


_ALBEDO = np.array([0.66, 0.53])
_LEAST_GREY = 12.0
_MERGED_SIGMAS = 3.0
"""Two stripes closer than this share one peak."""
_BLUR_PX = 0.5
_AMBIENT = 12.0


@dataclass(frozen=True, eq=False)
class Sample:
    """One image's worth of peaks."""

    peaks: Peaks
    """What the coder is given."""
    crossings: Crossings
    """All true crossings, damaged or not."""
    calibration: Calibration
    """The exact one."""
    dead: Integers
    """Stripes that were lit and of which no peak is left."""
    displaced_spacings: float
    """Largest displacement of a product's point from its rest line, in mean spacings."""


def sample_of(rig: CodingRig, solid: Solid, damage: Damage | None = None, *, seed: int) -> Sample:
    """Trace a product that is moved into view, and draw its peaks; the same arguments give the same peaks."""
    return sample_from(rig, crossings_of(rig.camera, rig.laser, in_view(solid, rig)), damage, seed=seed)


def sample_from(rig: CodingRig, crossings: Crossings, damage: Damage | None = None, *, seed: int) -> Sample:
    """Draw the peaks of known crossings: another damage to the same scene costs no tracing."""
    damage = Damage() if damage is None else damage
    rng = np.random.default_rng([seed, 404])
    keep = kept(crossings, damage, rng)
    dead = dead_of(crossings, keep)
    keep, blobs = blobs_of(crossings, keep, damage.blobs, rng)
    size = rig.camera.height_px, rig.camera.width_px
    true = _seen(rig, crossings, keep, rng)
    false = np.concatenate([blobs, false_peaks(crossings, damage, size, rng)])
    calibration = rig.calibration()
    rest_px = calibration.rest_line_px(np.arange(rig.rows, dtype=np.float64))
    moved_px = crossings.x_px - rest_px[crossings.stripe, crossings.row]
    far_px = float(np.abs(moved_px[crossings.on_product]).max(initial=0.0))
    spacing_px = float(np.diff(rest_px[:, rig.rows // 2]).mean())
    return Sample(
        _peaks(true, _drawn(false, rig, rng), size), crossings, calibration, dead, far_px / spacing_px
    )


def _seen(rig: CodingRig, crossings: Crossings, keep: Flags, rng: np.random.Generator) -> Floats:
    """Give (peak, 6): row, x, deviation, amplitude, width and overlap of what an extractor would find."""
    row, x_px = crossings.row[keep], crossings.x_px[keep]
    stripe, on = crossings.stripe[keep], crossings.on_product[keep].astype(int)
    sigma_px = np.hypot(rig.laser.sigma_mm / np.maximum(crossings.mm_per_px[keep], 1e-3), _BLUR_PX)
    amplitude = rig.laser.peak_grey[stripe] * _ALBEDO[on] * crossings.cosine[keep]
    amplitude *= np.clip(rng.normal(1.0, 0.12, row.size), 0.4, 1.6)
    usual_px = np.median(sigma_px) if sigma_px.size else 1.0
    std_px = rig.noise_px * np.clip(sigma_px / usual_px, 0.5, 4.0)
    found = np.column_stack([row, x_px + std_px * rng.standard_normal(row.size), std_px, amplitude, sigma_px])
    found = found[(amplitude >= _LEAST_GREY) & (sigma_px < 30.0)]
    return _merged(found[np.lexsort((found[:, 1], found[:, 0]))])


def _merged(found: Floats) -> Floats:
    """Make one peak of neighbours that no valley parts."""
    while len(found) > 1:
        near = (np.diff(found[:, 0]) == 0.0) & (
            np.diff(found[:, 1]) < _MERGED_SIGMAS * 0.5 * (found[1:, 4] + found[:-1, 4])
        )
        near[1:] &= ~near[:-1]  # pairs, one after the other
        left = np.flatnonzero(near)
        if not left.size:
            break
        weight = found[left, 3] / (found[left, 3] + found[left + 1, 3])
        apart = found[left + 1, 1] - found[left, 1]
        found[left, 1] = weight * found[left, 1] + (1.0 - weight) * found[left + 1, 1]
        found[left, 2] = np.maximum(found[left, 2], found[left + 1, 2])
        found[left, 3] = np.maximum(found[left, 3], found[left + 1, 3])
        found[left, 4] = np.maximum(found[left, 4], found[left + 1, 4]) + 0.5 * apart
        found = np.delete(found, left + 1, axis=0)
    return found


def _drawn(false: Floats, rig: CodingRig, rng: np.random.Generator) -> Floats:
    """Give false peaks the looks of true ones."""
    count = len(false)
    amplitude, width = rng.uniform(15.0, 220.0, count), rng.uniform(1.0, 3.0, count)
    return np.column_stack([false, np.full(count, rig.noise_px), amplitude, width])


def _peaks(true: Floats, false: Floats, size: tuple[int, int]) -> Peaks:
    found = np.concatenate([true, false])
    inside = (found[:, 0] >= 0) & (found[:, 0] < size[0])
    inside &= (found[:, 1] > -0.5) & (found[:, 1] < size[1] - 0.5)
    found = found[inside]
    found = found[np.lexsort((found[:, 1], found[:, 0]))]
    found = _merged(found)
    top = 255.0 - _AMBIENT
    return Peaks(
        image_size=size, row=found[:, 0].astype(np.int64), x_px=found[:, 1], x_std_px=found[:, 2],
        amplitude=np.minimum(found[:, 3], top), background=np.full(len(found), _AMBIENT),
        width_px=2.355 * found[:, 4], flags=np.where(found[:, 3] > top, SATURATED, 0).astype(np.uint8),
    )  # fmt: skip


_TALL_MM = 1.0


@dataclass(frozen=True)
class Score:
    """Counts, which add up over samples; wrong means the nearest true centre within 3 px is another's."""

    visible: int = 0
    """True crossings on products, lit and seen, whether or not a peak of them is left."""
    unseen: int = 0
    """Of these, without a peak within 3 px."""
    right: int = 0
    mistaken: int = 0
    refused: int = 0
    """right, mistaken, refused: of the others: their peak carries their number; another's; none."""
    ambiguous: int = 0
    """Of the refused, called ambiguous."""
    labelled: int = 0
    """All peaks, of product and belt, that were given a number and lie within 3 px of a true centre."""
    wrong: int = 0
    """Of these, wrong."""
    shared: int = 0
    """Of the wrong, with light of the stripe whose number they carry within 6 px: two stripes, one peak."""
    invented: int = 0
    """Peaks with a number and no true centre within 3 px."""
    as_belt: int = 0
    """Product points at least 1 mm high with the right number, taken for belt."""
    as_product: int = 0
    """Points of the belt with the right number, taken for product."""
    longest_wrong_run: int = 0
    """Rows that follow each other on one stripe, all wrong; the largest counts."""
    products: int = 1
    products_wrong: int = 0
    """products, products_wrong: samples; samples with a wrong run of more than 3 rows."""
    frames_refused: int = 0
    """Samples that the coder refused as a whole."""

    def __add__(self, other: Score) -> Score:
        sums = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        sums["longest_wrong_run"] = max(self.longest_wrong_run, other.longest_wrong_run)
        return Score(**sums)

    @property
    def labelled_share(self) -> float:
        """Share with a number, of the product's points that have a peak."""
        return (self.right + self.mistaken) / max(self.visible - self.unseen, 1)

    @property
    def wrong_share(self) -> float:
        """Wrong, of all peaks with a number, on product and belt."""
        return self.wrong / max(self.labelled, 1)


def score(stripes: StripeMap | None, sample: Sample, least_margin: float = 0.0) -> Score:
    """Score a coder's answer to a sample; None is a frame that was refused.

    Labels with less margin than `least_margin` are taken as refused.
    """
    true, peaks = sample.crossings, sample.peaks
    at = nearest(true.row, true.x_px, peaks.row, peaks.x_px)  # peak of each crossing
    seen = true.on_product & (at >= 0)
    counts = {"visible": int(true.on_product.sum()), "unseen": int((true.on_product & (at < 0)).sum())}
    if stripes is None:
        return Score(**counts, refused=int(seen.sum()), frames_refused=1)
    given, said = verdicts(stripes, sample, least_margin)
    of = nearest(peaks.row, peaks.x_px, true.row, true.x_px)  # crossing of each peak
    known = of >= 0
    is_wrong = known & (given >= 0) & (true.stripe[of] != given)
    is_right = known & (given >= 0) & (true.stripe[of] == given)
    on_product = known & true.on_product[of]
    refused = seen & (given[at] < 0)
    point_right = seen & (given[at] == true.stripe)
    map_wrong = np.zeros(stripes.seen.shape, np.bool_)
    map_wrong[given[is_wrong], peaks.row[is_wrong]] = True
    run = max((longest_run(line) for line in map_wrong), default=0)
    product = np.full(given.size, -1, np.int64)
    product[given >= 0] = stripes.product[given[given >= 0], peaks.row[given >= 0]]
    tall = on_product & (true.xyz_mm[of, 2] >= _TALL_MM)
    return Score(
        **counts,
        right=int(point_right.sum()),
        mistaken=int((seen & ~refused & ~point_right).sum()),
        refused=int(refused.sum()),
        ambiguous=int((refused & (said[at] == AMBIGUOUS)).sum()),
        labelled=int((known & (given >= 0)).sum()),
        wrong=int(is_wrong.sum()),
        shared=_shared(given, np.flatnonzero(is_wrong), sample),
        invented=int((~known & (given >= 0)).sum()),
        as_belt=int((tall & is_right & (product == 0)).sum()),
        as_product=int((known & ~on_product & is_right & (product > 0)).sum()),
        longest_wrong_run=run,
        products_wrong=int(run > 3),
    )


def _shared(given: Integers, wrong: Integers, sample: Sample) -> int:
    """Count the wrong peaks near which the stripe of their number is, too."""
    true, peaks, count = sample.crossings, sample.peaks, 0
    for k in wrong:
        own = (true.row == peaks.row[k]) & (true.stripe == given[k])
        count += bool((np.abs(true.x_px[own] - peaks.x_px[k]) <= 2.0 * REACH_PX).any())
    return count


def verdicts(stripes: StripeMap, sample: Sample, least_margin: float = 0.0) -> tuple[Integers, Integers]:
    """Give each peak's number (−1 for none), and what the coder said of it, `AMBIGUOUS` included."""
    said = stripes.peak_stripe.astype(np.int64)
    given = np.maximum(said, -1)
    if least_margin > 0.0:
        has = given >= 0
        margin = np.full(given.size, np.nan)
        margin[has] = stripes.margin[given[has], sample.peaks.row[has]]
        given = np.where(margin < least_margin, -1, given)
    return given, said
