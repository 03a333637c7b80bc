"""Rows of bodies on virtual rigs: features, the paper's grades, what the stripes show; kept between runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.grading.bodies import CLASSES, Body, of_meshes, our_skein, second_skein
from benchmarks.grading.virtual_rig import Rig, draw_rig, measured
from benchmarks.tables import kept_rows
from benchmarks.traced import Row, papers_grades
from roemetry_shape.features import shape_of

MIX = (*("good",) * 4, "dent", "dent", "bend", "twist", "fold", "fold", "broken")
"""Classes by turns."""

KINDS = dict(zip(CLASSES, ("none", "dented", "bent", "twisted", "folded", "broken"), strict=True))
"""Kind in a row, by class."""

TURN_DEG = 12.0
"""Products lie along the belt within this, either end first."""

FAMILIES: Mapping[str, Callable[[int, str], Body]] = {"ours": our_skein, "second": second_skein}


def make_body(family: str, seed: int, label: str) -> Body:
    """Draw a body of a family with a class of defect."""
    return FAMILIES.get(family, lofted_skein)(seed, label)


def virtual_rows(family: str, seeds: Sequence[int], rigs_each: int, cache: Path) -> list[Row]:
    """Draw bodies of a family, each measured on `rigs_each` random rigs, turned and mirrored at random."""

    def make(seed: int) -> list[dict[str, Any]]:
        body = make_body(family, seed, MIX[seed % len(MIX)])
        found = rows_of_body(body, family, seed, np.random.default_rng([seed, 7]), rigs_each)
        return [row._asdict() for row in found]

    known = kept_rows(cache / f"virtual_{family}_{rigs_each}.jsonl", seeds, make)
    return [Row(**row) for seed in seeds for row in known[seed]]


def rows_of_body(
    body: Body, family: str, seed: int, rng: np.random.Generator, count: int, rig: Rig | None = None
) -> Iterator[Row]:
    """Measure a body `count` times; on one rig, or on a new one each time."""
    for _ in range(count):
        turn, flip = rng.uniform(-TURN_DEG, TURN_DEG) + 180.0 * rng.integers(2), bool(rng.integers(2))
        surface, sound = (
            (one.mirrored() if flip else one).turned(turn) for one in (body.surface, body.sound)
        )
        product = measured(surface, draw_rig(rng) if rig is None else rig, rng)
        xyz = product.profiles.xyz_mm[product.profiles.seen]
        off = sound.at(xyz[:, 0], xyz[:, 1]) - surface.at(xyz[:, 0], xyz[:, 1])
        yield Row(
            seed=seed, rig=family, kind=KINDS[body.label], refused="", features=shape_of(product).features,
            grades=papers_grades(product), shown_mm=float(np.abs(off).max(initial=0.0)),
        )  # fmt: skip


def lofted_skein(seed: int, label: str) -> Body:
    """Draw a skein of the family of the plugin `mitsuba`; raise ImportError where it is not installed."""
    from roemetry_mitsuba.products import FAMILIES as OTHERS

    family = OTHERS["lofted-skein"]
    kind = KINDS[label]
    drawn = family.make(np.random.default_rng(seed), family.Options(kinds={kind: 1.0}))
    sound = drawn.reference or drawn.body
    meshes = [(one.points_mm, one.faces) for one in (drawn.body, sound)]
    return Body(*of_meshes(meshes), label)


def rendered_bodies(folder: Path) -> list[Body]:
    """Read the skeins among the meshes of a rendered set (`objects/`).

    Their sound shapes are not known; an empty belt stands for them, so all of a defect counts as shown.
    """
    import open3d as o3d

    bodies: list[Body] = []
    objects = json.loads((folder / "objects" / "objects.json").read_text("utf-8"))
    for name, one in objects.items():
        if one["cls"] in ("good", "defective"):
            mesh = o3d.io.read_triangle_mesh(str(folder / "objects" / f"{name}.ply"))
            (top,) = of_meshes([(np.asarray(mesh.vertices), np.asarray(mesh.triangles))])
            empty = top._replace(height_mm=np.zeros_like(top.height_mm))
            bodies.append(Body(top, empty, "good" if one["cls"] == "good" else one["defect"]))
    return bodies


def rendered_rows(folder: Path, count: int) -> list[Row]:
    """Measure the skeins of a rendered set, each on `count` random rigs."""
    return [
        row
        for number, body in enumerate(rendered_bodies(folder))
        for row in rows_of_body(body, "rendered", number, np.random.default_rng([number, 5]), count)
    ]
