"""The surface through stripes and outline, on convex bodies with closed volumes and exact silhouettes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Outline, Product, Profiles
from roemetry.records.view import View
from roemetry.run.monte_carlo import offset_contour
from roemetry.testing import LinearRig
from roemetry_volume.footprint import area_of
from roemetry_volume.outline_surface import OutlineSurface
from roemetry_volume.rim import StripePoints, ends_of
from roemetry_volume.slice_estimators import SlicePchip
from roemetry_volume.surface_fit import Knots, fit_surface, plate_through, points_of, without_slice
from roemetry_volume.underside import UndersideOptions

CAMERA_MM, F_PX, ROWS, COLUMNS = 320.0, 1600.0, 480, 640
STRIPES, SPACING_MM, LEAN = 11, 8.75, 0.5

Top = Callable[[np.ndarray, np.ndarray], np.ndarray]


def view() -> View:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = CAMERA_MM
    matrix = np.array([[F_PX, 0.0, (COLUMNS - 1) / 2], [0.0, F_PX, (ROWS - 1) / 2], [0.0, 0.0, 1.0]])
    return View((ROWS, COLUMNS), matrix, pose, planes())


def planes() -> np.ndarray:
    t = SPACING_MM * (np.arange(STRIPES) - (STRIPES - 1) / 2) - 3.0
    normal = np.array([1.0, 0.0, -LEAN]) / np.hypot(1.0, LEAN)
    return np.column_stack([np.tile(normal, (STRIPES, 1)), t * normal[0]])


def product(top: Top, highest: float, solid_points: np.ndarray, std_px: float = 0.1) -> Product:
    """Slice the body below `top` (NaN outside); its silhouette is the hull of where its points appear."""
    y = (np.arange(ROWS) - (ROWS - 1) / 2) * -0.2
    t = planes()[:, 3] / planes()[:, 0]
    z = np.full((STRIPES, ROWS), np.nan)
    for level in np.linspace(highest, 0.0, 400):
        there = np.isnan(z) & (top(t[:, None] + LEAN * level, y[None, :]) >= level)
        z[there] = level
    xyz = np.stack([t[:, None] + LEAN * z, np.where(np.isnan(z), np.nan, y[None, :]), z], axis=-1)
    # what stands under the rim on the shadow side of an end wall is not lit from its top: exact tops only
    on = np.isfinite(z) & (np.abs(top(xyz[..., 0], xyz[..., 1]) - z) < 2.0 * highest / 400)
    xyz = np.where(
        on[..., None], np.stack([xyz[..., 0], xyz[..., 1], top(xyz[..., 0], xyz[..., 1])], -1), np.nan
    )
    hull = cv2.convexHull(view().project(solid_points).astype(np.float32))[:, 0].astype(float)
    rows = np.broadcast_to(np.arange(float(ROWS)), z.shape)
    profiles = Profiles(
        xyz_mm=xyz,
        product=np.where(on, 1, -1).astype(np.int16),
        seen=on,
        x_px=np.where(on, 0.0, np.nan),
        row_px=np.where(on, rows, np.nan),
        height_std_mm=np.full(z.shape, np.nan),
        stripe=np.arange(STRIPES),
        frame=np.zeros(STRIPES, np.int64),
        plane=planes(),
    )
    calibration = replace(LinearRig(rows=ROWS, columns=COLUMNS).calibration(), image_size=(ROWS, COLUMNS))
    return Product(1, profiles, calibration, ("drawn",), Outline(1, hull, std_px), (), view())


def dome(x0=0.0, y0=0.0, wall=5.0, a=40.0, b=14.0, c=8.0) -> tuple[Product, float]:
    """Half an ellipsoid on an upright wall."""

    def top(x, y):
        q = 1.0 - ((x - x0) / a) ** 2 - ((y - y0) / b) ** 2
        return np.where(q > 0.0, wall + c * np.sqrt(np.maximum(q, 0.0)), np.nan)

    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 1500), np.linspace(0, np.pi / 2, 160))
    points = np.stack(
        [x0 + a * np.cos(u) * np.cos(v), y0 + b * np.sin(u) * np.cos(v), wall + c * np.sin(v)], axis=-1
    )
    return product(top, wall + c, points.reshape(-1, 3)), np.pi * a * b * (wall + 2.0 / 3.0 * c)


def box(x0=0.0, y0=0.0, a=30.0, b=13.0, height=16.5) -> tuple[Product, float]:
    def top(x, y):
        return np.where((np.abs(x - x0) < a) & (np.abs(y - y0) < b), height, np.nan)

    corners = np.array([[x0 + i * a, y0 + j * b, z] for i in (-1, 1) for j in (-1, 1) for z in (0.0, height)])
    return product(top, height, corners), 4.0 * a * b * height


def half_cylinder(a=34.0, r=13.0) -> tuple[Product, float]:
    def top(x, y):
        return np.where((np.abs(x) < a) & (np.abs(y) < r), np.sqrt(np.maximum(r * r - y * y, 0.0)), np.nan)

    u = np.linspace(0, np.pi, 2000)
    ends = [np.column_stack([np.full_like(u, s * a), r * np.cos(u), r * np.sin(u)]) for s in (-1, 1)]
    return product(top, r, np.vstack(ends)), np.pi * r * r * a


def off(made: tuple[Product, float]) -> float:
    return OutlineSurface().estimate(made[0]).visible_mm3.value / made[1] - 1.0


@pytest.mark.parametrize(("wall", "place"), [(0.0, (-4.0, 6.0)), (3.0, (0.0, 0.0)), (8.0, (-4.0, 6.0))])
def test_domes_on_walls(wall: float, place) -> None:
    """Within 0.3 %, the silhouette 4 to 6 % larger than the footprint."""
    assert off(dome(*place, wall=wall)) == pytest.approx(0.0, abs=3e-3)


@pytest.mark.parametrize("place", [(-6.0, 8.0), (2.0, 25.0)])
def test_a_box_off_centre(place) -> None:
    """16.5 mm high: its top edge makes the far silhouette, its foot the near one."""
    assert off(box(*place)) == pytest.approx(0.0, abs=5e-3)


def test_flat_ends_are_not_rounded_off() -> None:
    made = half_cylinder()
    volume = OutlineSurface().estimate(made[0])
    assert volume.visible_mm3.value / made[1] - 1.0 == pytest.approx(0.0, abs=1e-2)
    assert "flat-end" in codes(volume)


def test_a_flat_end_is_seen_where_a_slice_runs_over_its_edge() -> None:
    """The outer slice, at a slant, ends half the way across: what there is of it is as high as the next."""
    made, true = half_cylinder()
    profiles = made.profiles
    outer = np.flatnonzero((profiles.product == 1).any(axis=1))[-1]
    cut = profiles.product.copy()
    cut[outer] = np.where(profiles.xyz_mm[outer, :, 1] > -1.0, cut[outer], -1)
    short = replace(made, profiles=replace(profiles, product=cut, seen=profiles.seen & (cut == 1)))
    volume = OutlineSurface().estimate(short)
    assert volume.visible_mm3.value / true - 1.0 == pytest.approx(0.0, abs=1e-2)
    assert "flat-end" in codes(volume)


def test_the_interval_holds_the_truth_and_names_its_causes() -> None:
    made = dome(-4.0, 6.0)
    volume = OutlineSurface().estimate(made[0])
    causes = {"between slices", "settings", "outline", "rim", "gaps", "ends", "common height"}
    assert set(volume.visible_mm3.budget) == causes
    assert abs(volume.visible_mm3.value - made[1]) < 2.0 * volume.visible_mm3.std
    assert volume.visible_mm3.std < 0.01 * made[1]
    assert volume.shares.assumed == pytest.approx(0.05, abs=0.05)


def test_an_outline_a_pixel_too_wide_moves_the_volume_as_budgeted() -> None:
    one, _ = dome(wall=6.0)
    middle = one.outline.xy_px.mean(axis=0)
    ray = one.outline.xy_px - middle
    wide = replace(one, outline=Outline(1, middle + ray * (1.0 + 1.0 / np.hypot(*ray.T))[:, None], 1.0))
    narrow, wider = (OutlineSurface().estimate(each).visible_mm3 for each in (one, wide))
    stated = wider.budget["outline"]
    assert wider.value - narrow.value == pytest.approx(stated, rel=0.35)


def test_leaving_a_slice_out_is_a_refit_without_it(rng: np.random.Generator) -> None:
    number = np.repeat(np.arange(6), 9)
    s, v = 4.0 * number, np.tile(np.linspace(-10.0, 10.0, 9), 6)
    # no quadric's course, which is kept as it was found with all slices
    knots = Knots(s, v, rng.normal(0.0, 2.0, s.size), np.full(s.size, 5.0), number)
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    rim = 10.0 + 16.0 * np.cos(angle), 12.0 * np.sin(angle)
    keep = number != 2
    others = Knots(*(getattr(knots, name)[keep] for name in Knots.__slots__))
    whole, again = plate_through(knots, *rim), plate_through(others, *rim)
    np.testing.assert_allclose(without_slice(whole, knots, 2), again.coefficients, atol=1e-6)


def test_without_an_outline_it_gives_the_slices_and_says_so() -> None:
    made, _ = dome()
    for changed, code in (
        (replace(made, outline=None), "no-outline"),
        (replace(made, view=None), "no-view"),
    ):
        volume = OutlineSurface().estimate(changed)
        assert volume.reasons[0].code == code
        assert "ends" in volume.visible_mm3.budget


def test_a_product_cut_by_the_image_is_refused() -> None:
    made, _ = dome()
    moved = made.outline.xy_px - [made.outline.xy_px[:, 0].min() + 0.4, 0.0]
    with pytest.raises(StageError, match="outline reaches the image's edge"):
        OutlineSurface().estimate(replace(made, outline=Outline(1, moved)))


def test_draws_scatter_by_the_stated_uncertainty(rng: np.random.Generator) -> None:
    made, _ = dome()
    stated = OutlineSurface(UndersideOptions(underside="flat")).estimate(made)
    drawn = [OutlineSurface().estimate(made, rng=rng).visible_mm3.value for _ in range(30)]
    own = np.sqrt(sum(std**2 for cause, std in stated.visible_mm3.budget.items() if cause != "outline"))
    assert np.std(drawn) == pytest.approx(own, rel=0.35)
    assert OutlineSurface().states_model_error
    assert stated.true_mm3.value == stated.visible_mm3.value


def codes(volume) -> set[str]:
    return {reason.code for reason in volume.reasons}


def changed(made: Product, mine: np.ndarray, **fields: np.ndarray) -> Product:
    """Keep the points that `mine` marks, with other fields where given."""
    old = made.profiles
    kept = replace(
        old,
        xyz_mm=np.where(mine[..., None], fields.get("xyz_mm", old.xyz_mm), np.nan),
        product=np.where(mine, old.product, -1).astype(np.int16),
        seen=old.seen & mine,
        x_px=np.where(mine, old.x_px, np.nan),
        row_px=np.where(mine, old.row_px, np.nan),
    )
    return replace(made, profiles=kept)


@pytest.mark.parametrize("by_px", [-0.3, 0.3])
def test_a_product_that_moved_goes_on_from_the_solution(by_px: float) -> None:
    """To 5 % of the change, what goes on changes as what is solved from the beginning."""
    made, _ = dome(wall=6.0)
    estimator = OutlineSurface()
    found = estimator.estimate(made)
    assert made.outline is not None
    moved = replace(made, outline=offset_contour(made.outline, by_px))
    change = estimator.estimate(moved).visible_mm3.value - found.visible_mm3.value
    still = estimator.redraw(made, found).visible_mm3.value
    assert estimator.redraw(moved, found).visible_mm3.value - still == pytest.approx(change, rel=0.05)


def test_a_drawn_product_takes_the_budget_that_was_found(rng: np.random.Generator) -> None:
    """The same surface; the budget is not made again; without an outline all is as in `estimate`."""
    made, _ = dome(wall=6.0)
    estimator = OutlineSurface()
    found = estimator.estimate(made)
    marked = replace(found, visible_mm3=replace(found.visible_mm3, budget={"outline": 5.0, "rim": 70.0}))
    again = estimator.redraw(made, marked).visible_mm3
    assert again.value == pytest.approx(found.visible_mm3.value, rel=5e-4)  # one round more
    drawn = [estimator.redraw(made, marked, rng=rng).visible_mm3.value for _ in range(40)]
    assert np.std(drawn) == pytest.approx(70.0, rel=0.35)  # the outline's place is the run's to move
    bare = replace(made, outline=None)
    slices = estimator.estimate(bare)
    assert estimator.redraw(bare, slices).visible_mm3.value == pytest.approx(slices.visible_mm3.value)
    assert estimator.redraw(bare, found).visible_mm3.value == pytest.approx(slices.visible_mm3.value)


def test_bad_products_give_a_reason_or_no_number() -> None:
    made, visible = dome()
    y, on = made.profiles.xyz_mm[..., 1], made.profiles.seen
    lit = np.flatnonzero(on.any(axis=1))
    few = on & np.isin(np.arange(STRIPES), lit[3:5])[:, None]
    with pytest.raises(StageError, match="only 2 stripes lie on the product"):
        OutlineSurface().estimate(changed(made, few))
    with pytest.raises(StageError, match="below the belt"):
        OutlineSurface().estimate(changed(made, on, xyz_mm=made.profiles.xyz_mm * [1.0, 1.0, -1.0]))
    middle = np.isin(np.arange(STRIPES), lit[3:6])[:, None]
    hole = OutlineSurface().estimate(changed(made, on & ~(middle & (np.abs(y) < 7.0))))
    assert {"outline-not-used", "hole"} <= codes(hole)
    found = hole.visible_mm3
    assert found.value < 0.9 * visible  # nothing is counted where nothing was seen
    assert abs(found.value - visible) < 1.96 * found.std, "and it may not have been empty"
    sunk = made.profiles.xyz_mm.copy()
    sunk[lit[2], :, 2] -= 18.0
    with pytest.raises(StageError, match=f"the slice of stripe {lit[2] + 1} lies .* mm below the belt"):
        OutlineSurface().estimate(changed(made, on, xyz_mm=sunk))
    dipped = made.profiles.xyz_mm.copy()
    dipped[lit[2], np.flatnonzero(on[lit[2]])[:8], 2] = -2.0
    assert "below-belt" in codes(OutlineSurface().estimate(changed(made, on, xyz_mm=dipped)))


@pytest.mark.parametrize(("times", "shift_px"), [(1.08, 0.0), (1.3, 0.0), (0.6, 0.0), (1.0, 30.0)])
def test_an_outline_that_disagrees_is_not_used(times: float, shift_px: float) -> None:
    made, visible = dome()
    outline = made.outline
    middle = outline.xy_px.mean(axis=0)
    other = replace(outline, xy_px=times * (outline.xy_px - middle) + middle + shift_px)
    volume = OutlineSurface().estimate(replace(made, outline=other))
    assert volume.reasons[0].code == "outline-disagrees"
    by_slices = SlicePchip().estimate(made).visible_mm3
    assert volume.visible_mm3.value == by_slices.value
    assert abs(volume.visible_mm3.value - visible) < 1.96 * volume.visible_mm3.std
    assert volume.visible_mm3.std > by_slices.std


def test_flanks_too_dim_to_be_seen_are_in_the_uncertainty() -> None:
    """Stripes end well inside a sound outline; which of the two is right, nothing says."""
    made, visible = dome()
    stripe, row = np.nonzero(made.profiles.seen)
    dim = np.zeros_like(made.profiles.seen)
    for s in np.unique(stripe):
        mine = np.sort(row[stripe == s])
        cut = mine.size // 6
        dim[s, np.concatenate([mine[:cut], mine[mine.size - cut :]])] = True
    profiles = made.profiles
    xyz = np.where(dim[..., None], np.nan, profiles.xyz_mm)
    volume = OutlineSurface().estimate(changed(made, profiles.seen & ~dim, xyz_mm=xyz))
    assert "outline-disagrees" in codes(volume)
    assert volume.visible_mm3.value < 0.95 * visible
    assert abs(volume.visible_mm3.value - visible) < 1.96 * volume.visible_mm3.std


def test_two_products_that_touch_are_told() -> None:
    """Two domes end to end under one outline: a number for both together, and the waist between them."""

    def top(x, y):
        q = 1.0 - (np.minimum(np.abs(x - 19.0), np.abs(x + 19.0)) / 20.5) ** 2 - (y / 14.0) ** 2
        return np.where(q > 0.0, 1.0 + 10.0 * np.sqrt(np.maximum(q, 0.0)), np.nan)

    x, y = np.meshgrid(np.linspace(-40.0, 40.0, 400), np.linspace(-15.0, 15.0, 150))
    z = top(x, y)
    there = np.isfinite(z)
    made = product(top, 11.0, np.column_stack([x[there], y[there], z[there]]))
    volume = OutlineSurface().estimate(made)
    assert "waist" in codes(volume)


@pytest.mark.parametrize(("apart", "wall"), [(16.0, 0.0), (18.0, 4.0), (20.0, 1.0), (22.0, 0.0), (22.0, 4.0)])
def test_two_products_side_by_side_have_no_volume_in_common(apart: float, wall: float) -> None:
    """Two domes beside each other, which stripes and outline take for one, overlapping or just touching."""
    made = side_by_side(apart, wall)
    for estimator in (OutlineSurface(), SlicePchip()):
        with pytest.raises(StageError, match="two products side by side, labelled as one"):
            estimator.estimate(made)


def test_a_shallow_furrow_is_that_of_one_product() -> None:
    volume = OutlineSurface().estimate(side_by_side(12.0, 4.0))
    assert not codes(volume) & {"waist", "outline-not-used"}
    assert "waist" not in codes(OutlineSurface().estimate(dome()[0]))


def test_what_is_bridged_beyond_a_slices_end_is_no_surface() -> None:
    """A coder bridges the dark rows from the product's last lit point down to the belt."""
    made, _ = dome()
    profiles = made.profiles
    xyz, product, seen = profiles.xyz_mm.copy(), profiles.product.copy(), profiles.seen.copy()
    for slice_ in np.flatnonzero(seen.any(axis=1)):
        last = int(np.flatnonzero(seen[slice_])[-1])
        for step in range(1, 6):
            there = last + step
            xyz[slice_, there] = xyz[slice_, last] * [1.0, 1.0, 1.0 - step / 6.0] - [0.0, 0.2 * step, 0.0]
            product[slice_, there] = 1
    bridged = replace(
        made,
        profiles=replace(
            profiles, xyz_mm=xyz, product=product, x_px=np.where(product == 1, 0.0, np.nan),
            row_px=np.where(product == 1, np.arange(float(ROWS)), np.nan),
        ),
    )  # fmt: skip
    plain, found = (OutlineSurface().estimate(one).visible_mm3 for one in (made, bridged))
    assert found.value == pytest.approx(plain.value, rel=1e-9)
    slices, loose = (SlicePchip().estimate(one).visible_mm3 for one in (made, bridged))
    assert slices.budget["slice ends"] == 0.0
    assert loose.budget["slice ends"] > 0.0
    # the bridge alone holds 2 % of the volume; the dome that is followed to its rim nothing but rounding
    assert loose.value == pytest.approx(slices.value, rel=2e-3)


def side_by_side(apart: float, wall: float) -> Product:
    """Two domes, 80 mm long and 22 mm wide, their middles so far apart in Y."""

    def top(x, y):
        q = 1.0 - (x / 40.0) ** 2 - ((np.abs(y) - apart / 2.0) / 11.0) ** 2
        return np.where(q > 0.0, wall + 10.0 * np.sqrt(np.maximum(q, 0.0)), np.nan)

    x, y = np.meshgrid(np.linspace(-40.0, 40.0, 401), np.linspace(-25.0, 25.0, 251))
    z = top(x, y)
    there = np.isfinite(z)
    points = np.column_stack([x[there], y[there], z[there]])
    return product(top, wall + 10.0, points)


@pytest.mark.parametrize("beyond", [1, 3])
def test_belt_peaks_behind_unseen_rows_do_not_pull_the_rim_down(beyond: int) -> None:
    made, true_mm3 = dome(wall=8.0)
    spoilt = with_belt_peaks(made, beyond)
    assert points_of(spoilt).xyz_mm[:, 2].min() == pytest.approx(points_of(made).xyz_mm[:, 2].min())
    fused = fit_surface(spoilt, spoilt.view, spoilt.outline)
    assert fused.volume_mm3 == pytest.approx(true_mm3, rel=0.01)
    as_high = with_belt_peaks(made, 2, z_mm=7.0)
    assert points_of(as_high).xyz_mm.shape[0] > points_of(made).xyz_mm.shape[0]


def test_a_speck_behind_unseen_rows_outside_the_outline_is_no_surface() -> None:
    made, true_mm3 = dome(wall=8.0)
    spoilt = with_belt_peaks(made, 1, z_mm=7.0)
    held = points_of(spoilt, spoilt.view, spoilt.outline).xyz_mm
    np.testing.assert_array_equal(held, points_of(made).xyz_mm)
    assert fit_surface(spoilt, spoilt.view, spoilt.outline).volume_mm3 == pytest.approx(true_mm3, rel=0.01)
    wide = replace(spoilt.outline, xy_std_px=5.0)
    assert len(points_of(spoilt, spoilt.view, wide).xyz_mm) > len(held), "an outline that may lie farther out"


@pytest.mark.parametrize("made", [box, dome])
def test_the_flank_of_a_line_beside_the_body_is_no_slice(made) -> None:
    """Light of a line whose centre passes 0.2 mm beside an end of the body: 3 mm too low there."""
    clean, true_mm3 = made(x0=-3.0)
    grazing = grazed(clean, end_mm=-3.0 + (30.0 if made is box else 40.0))
    found = fit_surface(grazing, grazing.view, grazing.outline)
    held = found.points
    np.testing.assert_array_equal(held.xyz_mm, points_of(clean).xyz_mm)
    moved = replace(grazing.outline, xy_px=grazing.outline.xy_px + np.array([3.0, 0.0]))
    again = fit_surface(grazing, grazing.view, moved, found.start)
    assert again.points.slice[-1] == held.slice[-1], "a slice more or less is no small change"
    assert held.first[-1] == held.slice.size and held.slice[-1] == held.first.size - 2
    assert off((grazing, true_mm3)) == pytest.approx(off((clean, true_mm3)), abs=1e-4)


def grazed(made: Product, end_mm: float) -> Product:
    """Put 12 mm of the next stripe's points on a body's end, 3 mm below its highest."""
    profiles = made.profiles
    number = int(np.flatnonzero((profiles.product == 1).any(axis=1))[-1]) + 1
    height_mm = float(np.nanmax(profiles.xyz_mm[..., 2])) - 3.0
    rows = np.arange(ROWS // 2 - 30, ROWS // 2 + 30)
    y_mm = (rows - (ROWS - 1) / 2) * -0.2
    xyz, product, seen = profiles.xyz_mm.copy(), profiles.product.copy(), profiles.seen.copy()
    row_px, x_px = profiles.row_px.copy(), profiles.x_px.copy()
    product[number, rows], seen[number, rows] = 1, True
    row_px[number, rows], x_px[number, rows] = rows, 0.0
    xyz[number, rows] = np.column_stack([np.full(rows.size, end_mm), y_mm, np.full(rows.size, height_mm)])
    return replace(
        made, profiles=replace(profiles, xyz_mm=xyz, product=product, seen=seen, row_px=row_px, x_px=x_px)
    )


def with_belt_peaks(made: Product, count: int, z_mm: float = 1.5) -> Product:
    """Add seen points at a height behind three unseen ones, at the last row's end of the last slice."""
    profiles = made.profiles
    number = int(np.flatnonzero((profiles.product == 1).any(axis=1))[-1])
    last = int(np.flatnonzero(profiles.product[number] == 1)[-1])
    rows = last + np.arange(1, 4 + count)
    xyz, product, seen = profiles.xyz_mm.copy(), profiles.product.copy(), profiles.seen.copy()
    row_px, x_px = profiles.row_px.copy(), profiles.x_px.copy()
    product[number, rows], seen[number, rows[3:]] = 1, True
    row_px[number, rows], x_px[number, rows] = rows, 0.0
    xyz[number, rows] = xyz[number, last] + np.outer(np.arange(1, 4 + count), [0.0, -0.2, 0.0])
    xyz[number, rows[3:], 2] = z_mm
    return replace(
        made, profiles=replace(profiles, xyz_mm=xyz, product=product, seen=seen, row_px=row_px, x_px=x_px)
    )


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_rows_down_a_wall_that_the_camera_sees_are_no_end_of_the_top(rows: int) -> None:
    y = np.concatenate([np.full(rows, 20.0) + 0.02 * np.arange(rows)[::-1], 20.0 - 0.2 * np.arange(1, 60)])
    z = np.concatenate([16.0 * (np.arange(rows) + 0.25) / max(rows, 1), np.full(59, 16.0)])
    points = StripePoints(
        np.column_stack([np.zeros_like(y), y, z]), np.zeros(y.size, int), np.array([0, y.size])
    )
    index, first, _ = ends_of(points, y)
    assert index[first].tolist() == [rows, y.size - 1]


@pytest.mark.parametrize("made", [box, dome, half_cylinder])
def test_the_nodes_stand_for_all_of_the_footprint(made) -> None:
    product = made()[0]
    fused = fit_surface(product, product.view, product.outline)
    assert fused.weight_mm2.sum() == pytest.approx(abs(area_of(fused.contour)), rel=1e-9)


@pytest.mark.parametrize("lowest_mm", [0.0, 16.5])
def test_a_wall_that_faces_the_camera_is_in_the_outline_or_too_dark_to_show(lowest_mm: float) -> None:
    """With the wall the outline is its foot, without it the upper edge: the footprint is the same."""
    made, true_mm3 = box(y0=17.0)
    corners = [[i, 17.0 + j, z] for i in (-30.0, 30.0) for j in (-13.0, 13.0) for z in (lowest_mm, 16.5)]
    hull = cv2.convexHull(made.view.project(np.array(corners)).astype(np.float32))[:, 0].astype(float)
    assert fit_surface(made, made.view, Outline(1, hull)).volume_mm3 == pytest.approx(true_mm3, rel=0.01)
