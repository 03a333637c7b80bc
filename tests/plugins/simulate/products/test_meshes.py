"""Meshes and solids: volumes and heights against polyhedra and formulas, file formats, what is refused."""

import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.errors import DataError
from roemetry.io.meshes import Triangles, read_mesh
from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Pose
from roemetry_simulate.products.mesh import close, hit_triangles, lay, triangles_normal
from roemetry_simulate.solid import Block, GriddedSolid
from tests.plugins.simulate.gridded import on_grid

REAL = Path(os.environ.get("ROEMETRY_REAL_DATA", "../shared/real")) / "meshes"


def cube(side=1.0):
    points = side * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [corners for a, b, c, d in quads for corners in ((a, b, c), (a, c, d))]
    return Triangles(points, np.array(faces))


def turned(mesh, axis, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return Triangles(mesh.points @ turn.T, mesh.faces)


def lathe(radii, heights, around):
    """Closed surface about the z axis; the first and the last radius are 0."""
    at = 2.0 * np.pi * np.arange(around) / around
    points = [
        np.stack([r * np.cos(at), r * np.sin(at), np.full(around, z)], 1)
        for r, z in zip(radii, heights, strict=True)
    ]
    k, m = np.meshgrid(np.arange(len(radii) - 1), np.arange(around), indexing="ij")
    n = (m + 1) % around
    a, b, c, d = k * around + m, k * around + n, (k + 1) * around + n, (k + 1) * around + m
    lower = np.stack([a, b, c], -1)[radii[:-1] > 0.0].reshape(-1, 3)
    upper = np.stack([a, c, d], -1)[radii[1:] > 0.0].reshape(-1, 3)
    return Triangles(np.concatenate(points), np.concatenate([lower, upper]))


def ball(radius, rings, around):
    polar = np.linspace(0.0, np.pi, rings + 1)
    radii = radius * np.sin(polar)
    radii[[0, -1]] = 0.0
    return lathe(radii, -radius * np.cos(polar), around)


def test_a_cube_on_its_edge_has_its_undercut_filled():
    on_edge = close(turned(cube(10.0), 0, 45.0))
    assert on_edge.true_mm3 == pytest.approx(1000.0, rel=1e-12)
    assert on_edge.visible_mm3 == pytest.approx(1500.0, rel=1e-4)


def test_a_ball_loses_what_lies_below_its_widest_line():
    one = close(ball(15.0, 80, 160))
    assert one.true_mm3 == pytest.approx(4 / 3 * math.pi * 15**3, rel=1e-3)
    assert one.visible_mm3 / one.true_mm3 == pytest.approx(5.0 / 4.0, rel=5e-4)
    assert one.corners_mm[..., 2].min() == 0.0


def test_a_mesh_that_looks_inwards_is_turned_inside_out():
    mesh = cube(10.0)
    inwards = close(Triangles(mesh.points, mesh.faces[:, ::-1]))
    assert inwards.true_mm3 == pytest.approx(1000.0)
    body, normal = lay(inwards, Pose(0.0, 0.0, 0.0)).body(), np.zeros(3)
    triangles_normal(body.triangles, body.boxes, body.links, np.array([1.0, 2.0, 10.0]), normal)
    np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mesh: mesh._replace(faces=mesh.faces[1:]), r"lid\.stl: the mesh is not watertight: 3 of 18"),
        (
            lambda mesh: mesh._replace(faces=np.vstack([mesh.faces[1:], mesh.faces[0, ::-1]])),
            "3 of 18 edges fac",
        ),
        (lambda mesh: mesh._replace(points=mesh.points * [1.0, 1.0, 0.0]), "no volume"),
    ],
)
def test_a_mesh_without_an_inside_is_refused_by_name(change, message):
    with pytest.raises(DataError, match=message):
        close(change(cube()), name="lid.stl")


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_any_axis_can_point_up(up):
    size = np.array([3.0, 5.0, 7.0])
    mesh = close(Triangles(cube().points * size, cube().faces), 2.0, up)
    axis = "xyz".index(up[-1])
    assert mesh.corners_mm[..., 2].max() == pytest.approx(2.0 * size[axis])
    assert mesh.true_mm3 == pytest.approx(8.0 * 105.0)


@settings(max_examples=10, deadline=None)
@given(
    scale=st.floats(0.1, 50.0),
    tilt=st.floats(-80.0, 80.0),
    yaw=st.floats(-180.0, 180.0),
    x=st.floats(-50, 50),
)
def test_volumes_go_with_the_cube_of_the_scale_and_not_with_the_place(scale, tilt, yaw, x):
    mesh = turned(turned(cube(3.0), 0, tilt), 1, 20.0)
    one, large = close(mesh), close(mesh, scale)
    assert large.true_mm3 == pytest.approx(scale**3 * one.true_mm3, rel=1e-9)
    assert large.visible_mm3 == pytest.approx(scale**3 * one.visible_mm3, rel=1e-6)
    solid = lay(large, Pose(x, -7.0, yaw))
    assert (solid.visible_volume_mm3, solid.true_volume_mm3) == (large.visible_mm3, large.true_mm3)
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    share = (np.arange(200) + 0.5) / 200
    top, bottom = solid.heights_mm(
        *np.meshgrid(x_min + share * (x_max - x_min), y_min + share * (y_max - y_min))
    )
    cell = (x_max - x_min) * (y_max - y_min) / 200**2
    known = np.isfinite(top)
    assert (bottom[known] <= top[known]).all()
    assert top[known].sum() * cell == pytest.approx(large.visible_mm3, rel=1e-2)
    assert (top - bottom)[known].sum() * cell == pytest.approx(large.true_mm3, rel=1e-2)


def test_hits_are_those_of_the_nearest_triangle():
    """The tree against every triangle one by one, on a ball of some thousand."""
    solid = lay(close(ball(15.0, 30, 60)), Pose(4.0, -3.0, 10.0))
    body, corners = solid.body(), solid.corners_mm
    o = np.array([120.0, -40.0, 300.0])
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    for aim in np.random.default_rng(3).uniform(-14.0, 14.0, (60, 3)):
        d = aim + np.array([4.0, -3.0, 15.0]) - o
        d /= np.linalg.norm(d)
        h = np.cross(d, edge_2)
        turn = np.einsum("ti,ti->t", edge_1, h)
        s = o - corners[:, 0]
        u = np.einsum("ti,ti->t", s, h) / turn
        q = np.cross(s, edge_1)
        v, t = (q @ d) / turn, np.einsum("ti,ti->t", edge_2, q) / turn
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        found = hit_triangles(body.triangles, body.boxes, body.links, o, d, 1e9)
        assert found == pytest.approx(t[met].min() if met.any() else -1.0, abs=1e-9)
        if met.any():
            normal, nearest = np.zeros(3), np.argmin(np.where(met, t, np.inf))
            triangles_normal(body.triangles, body.boxes, body.links, o + found * d, normal)
            expected = np.cross(edge_1[nearest], edge_2[nearest])
            np.testing.assert_allclose(normal, expected / np.linalg.norm(expected), atol=1e-9)


def as_obj(mesh):
    lines = ["# a cube", "mtllib none", *(f"v {x} {y} {z}" for x, y, z in mesh.points), "vt 0 0", ""]
    quads = [(a, b, c, d) for (a, b, c), (_, _, d) in zip(mesh.faces[::2], mesh.faces[1::2], strict=True)]
    lines += [f"f {a + 1}/1 {b + 1}/1 {c - len(mesh.points)}/1 {d + 1}" for a, b, c, d in quads]
    return "\n".join(lines).encode()


def as_stl(mesh):
    rows = [struct.pack("<12fH", 0, 0, 0, *mesh.points[f].ravel(), 0) for f in mesh.faces]
    return b"solid but binary".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def as_stl_text(mesh):
    facets = [
        "facet normal 0 0 0\nouter loop\n" + "\n".join(f"vertex {x} {y} {z}" for x, y, z in mesh.points[f])
        + "\nendloop\nendfacet" for f in mesh.faces
    ]  # fmt: skip
    return "\n".join(["solid cube", *facets, "endsolid cube"]).encode()


def as_ply(mesh, form):
    head = (
        f"ply\nformat {form} 1.0\ncomment made by hand\nelement vertex {len(mesh.points)}\nproperty float x\n"
        f"property float y\nproperty float z\nproperty uchar red\nelement face {len(mesh.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        rows = [f"{x} {y} {z} 255" for x, y, z in mesh.points] + [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
        return head + "\n".join(rows).encode()
    order = "<" if form == "binary_little_endian" else ">"
    rows = [struct.pack(order + "fffB", *p, 255) for p in mesh.points]
    return head + b"".join(rows + [struct.pack(order + "Biii", 3, *f) for f in mesh.faces])


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("cube.obj", as_obj),
        ("cube.STL", as_stl),
        ("cube.stl", as_stl_text),
        ("cube.ply", lambda mesh: as_ply(mesh, "ascii")),
        ("cube.ply", lambda mesh: as_ply(mesh, "binary_little_endian")),
        ("cube.ply", lambda mesh: as_ply(mesh, "binary_big_endian")),
    ],
)
def test_every_format_gives_the_same_product(tmp_path, name, write):
    path = tmp_path / name
    path.write_bytes(write(cube(10.0)))
    family = PRODUCTS["mesh"]
    drawn = family.draw(1, family.Options(file=path, mm_per_unit=2.0, density_g_per_cm3=2.0))
    assert drawn.truth.true_mm3 == pytest.approx(8000.0)
    assert drawn.truth.visible_mm3 == pytest.approx(8000.0, rel=1e-4)
    assert drawn.truth.mass_g == pytest.approx(16.0)
    assert drawn.solid.heights_mm(0.0, 0.0)[0] == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"v 0 0\nf 1 1 1\n", "OBJ mesh: line 1"),
        ("a.obj", b"v 0 0 0\nf 1 2 x\n", "OBJ mesh: line 2"),
        ("a.obj", b"v 0 0 0\nf 1 1 4\n", "a point that is not there"),
        ("a.obj", b"v 0 0 nan\nv 0 0 1\nv 0 1 1\nf 1 2 3\n", "NaN"),
        ("a.obj", b"", "no faces"),
        ("a.stl", b"\0" * 84, "no faces"),
        ("a.stl", b"\0" * 80 + b"\5\0\0\0", "5 triangles need 334 bytes, the file has 84"),
        ("a.stl", b"solid x\nfacet\nvertex 1 2 3\n", "STL mesh"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "end_header"),
        ("a.ply", b"ply\nformat odd 1.0\nend_header\n", "unknown format 'odd'"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nend_header\n1", "PLY mesh"),
        ("a.step", b"", "ends in .obj, .stl, .ply, not '.step'"),
        ("none.obj", None, "No such file"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused_by_name(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DataError, match=message) as refused:
        read_mesh(path)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(("name", "cm3"), [("ycb_004_sugar_box", 637.9), ("ycb_006_mustard_bottle", 612.0)])
def test_scanned_objects_have_the_volume_that_is_known_of_them(name, cm3):
    path = REAL / f"{name}.obj"
    if not path.exists():
        pytest.skip(f"{path} is absent; ROEMETRY_REAL_DATA says where the real data is")
    family = PRODUCTS["mesh"]
    drawn = family.draw(1, family.Options(file=path, mm_per_unit=1000.0))
    assert drawn.truth.true_mm3 / 1000.0 == pytest.approx(cm3, abs=0.05)
    assert 1.0 < drawn.truth.visible_mm3 / drawn.truth.true_mm3 < 1.15


A, B, C = 17.0, 11.0, 7.0


def cap(x, y):
    return C**2 * np.maximum(1.0 - (x / A) ** 2 - (y / B) ** 2, -0.4)


def level(z_mm):
    return lambda x, y: np.full_like(x, z_mm)


def half_ellipsoid(step_mm=0.125):
    return on_grid((-19, 19, -13, 13), step_mm, level(0.0), cap, lambda x, y: np.minimum(cap(x, y), 0.0))


def test_a_half_ellipsoid_has_the_formula_s_volume():
    dome = half_ellipsoid()
    formula = 2.0 / 3.0 * np.pi * A * B * C
    assert dome.visible_volume_mm3 == pytest.approx(formula, rel=1e-4)
    assert dome.true_volume_mm3 == pytest.approx(formula, rel=1e-4)
    assert dome.footprint_mm2 == pytest.approx(np.pi * A * B, rel=1e-4)


def test_an_ellipsoid_on_the_belt_loses_what_lies_below_its_widest_line():
    body = on_grid((-19, 19, -13, 13), 0.125, level(C), cap, cap)
    half = 2.0 / 3.0 * np.pi * A * B * C
    assert body.true_volume_mm3 == pytest.approx(2.0 * half, rel=1e-4)
    assert body.visible_volume_mm3 == pytest.approx(half + np.pi * A * B * C, rel=1e-4)


def test_a_flat_slab_with_straight_sides_is_exact():
    # u falls linearly through zero at x = 5, so the footprint ends there to the last digit
    def ramp(x, y):
        return np.minimum(np.minimum(5.0 - np.abs(x), 4.0 - np.abs(y)), 0.5)

    slab = on_grid((-6, 6, -5, 5), 0.5, level(3.0), ramp, lambda x, y: ramp(x, y))
    assert slab.footprint_mm2 == pytest.approx(80.0, rel=1e-9)


def test_heights_between_nodes_and_outside():
    top, bottom = half_ellipsoid().heights_mm([0.03, 6.01, 18.0, 500.0], [0.0, -3.02, 0.0, 0.0])
    expected = C * np.sqrt(1.0 - (6.01 / A) ** 2 - (3.02 / B) ** 2)
    assert top[:2] == pytest.approx([C, expected], abs=1e-3)
    assert bottom[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.isnan(top[2:]).all()
    assert np.isnan(bottom[2:]).all()


@pytest.mark.parametrize(
    ("grid", "message"),
    [(np.zeros((4, 4)), "shape"), (np.full((4, 4, 3), np.nan), "NaN"), (np.ones((4, 4, 3)), "border")],
)
def test_what_is_no_body_is_refused(grid, message):
    with pytest.raises(ValueError, match=message):
        GriddedSolid(0.0, 0.0, 0.1, grid)
    with pytest.raises(ValueError, match="positive"):
        Block(10.0, 10.0, 0.0)
