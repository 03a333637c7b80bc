"""Write a folder of herring roe images, calibration images and their truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.herring_roe import (
    CALIBRATION_BLOCK,
    SPACING_MM,
    Scene,
    belt_scene,
    block_scene,
    default_rig,
    render_scene,
    scene,
    stripe_truth,
)
from roemetry_simulate.render import Rig
from roemetry_simulate.shown import Shown, shown
from roemetry_simulate.truth import StripeTruth

DENSITY_G_PER_MM3 = 1.1e-3

SHIPPED: tuple[tuple[int, str], ...] = (
    (1, "healthy"),
    (11, "healthy"),
    (14, "dented"),
    (22, "dented"),
    (23, "bent"),
    (24, "twisted"),
    (25, "folded"),
    (28, "healthy"),
    (29, "bent"),
    (30, "broken"),
)
"""Seed and kind of the shipped skeins, in order.

Counted up from 1, each entry takes the next seed that shows what is wanted at its place: any healthy one; one
with both ends beyond the outer stripes; a dent that a stripe meets nearly at its deepest; a dent that falls
between the stripes; bent; twisted; folded; healthy and turned by more than 12°; bent and beyond both outer
stripes; broken. No measuring algorithm had a say.
"""


def write(out: Path, skeins: Sequence[tuple[int, str | None]]) -> None:
    """Write the data set.

    Parameters
    ----------
    out : Path
        Folder, made if absent; files of the same names are replaced, others stay.
    skeins : sequence of (int, str or None)
        Seed and kind of each skein; see `roemetry_simulate.herring_roe.scene`.
    """
    for folder in ("images", "images_plain", "calibration"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    save_png(out / "calibration" / "block.png", render_scene(block_scene()))
    save_png(out / "calibration" / "belt.png", render_scene(belt_scene()))
    rows: list[dict[str, str]] = []
    records: list[dict[str, Any]] = []
    truths: list[StripeTruth] = []
    for number, (seed, kind) in enumerate(skeins, start=1):
        name = f"skein_{number:02d}.png"
        one = scene(seed, kind)
        save_png(out / "images" / name, render_scene(one))
        save_png(out / "images_plain" / name, render_scene(one, plain=True))
        truths.append(stripe_truth(one))
        rows.append(truth_row(name, one, truths[-1]))
        assert one.skein is not None
        records.append({"file": f"images/{name}", **asdict(one.skein.record)})
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, fieldnames=list(rows[0]) if rows else ["file"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    save_text(out / "truth.csv", table.getvalue())
    save_stripes(out / "truth_stripes.npz", truths)
    save_yaml(out / "rig.truth.yaml", rig_as_dict(default_rig()))
    save_yaml(out / "skeins.truth.yaml", {"skeins": records})
    save_text(out / "DATA.md", _about(list(skeins) == list(SHIPPED)))


def truth_row(name: str, one: Scene, truth: StripeTruth) -> dict[str, str]:
    """Return a skein's row of `truth.csv`.

    Parameters
    ----------
    name : str
        Its image's name.
    one : Scene
        The scene, with a skein.
    truth : StripeTruth
        Its stripes.

    Returns
    -------
    dict
        Column to text; the columns' names carry the units.
    """
    if one.skein is None:
        raise ValueError("the scene holds no skein")
    record, seen = one.skein.record, shown(one.skein, truth)
    numbers: dict[str, tuple[float, int]] = {
        "true_volume_mm3": (one.solid.true_volume_mm3, 1),
        "visible_volume_mm3": (one.solid.visible_volume_mm3, 1),
        "weight_g": (one.solid.true_volume_mm3 * DENSITY_G_PER_MM3, 3),
        "footprint_mm2": (one.skein.solid.footprint_mm2, 1),
        **_sizes(seen),
        "yaw_deg": (record.yaw_deg, 2),
        "left_stripe": (seen.left_stripe, 0),
        "right_stripe": (seen.right_stripe, 0),
        "overhang_left_spacings": (seen.overhang_left_mm / SPACING_MM, 3),
        "overhang_right_spacings": (seen.overhang_right_mm / SPACING_MM, 3),
    }
    return {
        "file": f"images/{name}",
        "seed": str(record.seed),
        "class": "good" if record.kind == "healthy" else "henkei",
        "defect": "none" if record.kind == "healthy" else record.kind,
        **{column: f"{value:.{digits}f}" for column, (value, digits) in numbers.items()},
    }


def _sizes(seen: Shown) -> dict[str, tuple[float, int]]:
    return {
        "length_mm": (seen.length_mm, 2),
        "width_mm": (seen.width_mm, 2),
        "thickness_mm": (seen.thickness_mm, 2),
        "defect_depth_mm": (seen.defect_depth_mm, 2),
        "defect_seen_mm": (seen.defect_seen_mm, 2),
        "hollow_seen_mm": (seen.hollow_seen_mm, 2),
    }


def rig_as_dict(rig: Rig) -> dict[str, Any]:
    """Return the true rig in plain numbers.

    Parameters
    ----------
    rig : Rig
        Any rig.

    Returns
    -------
    dict
        For a YAML file.
    """
    block = CALIBRATION_BLOCK
    return {
        "frame": "belt: X along image x, Y towards the image's top, Z up, millimetres; planes are n·X = d",
        "camera": rig.camera.as_dict(),
        "sensor": {
            name: value
            for name, value in asdict(rig.sensor).items()
            if name not in ("full_well_e", "bit_depth")
        },
        "laser": rig.laser.as_dict(),
        "light": {
            "ambient_grey": rig.ambient_grey,
            "plain_grey": rig.plain_grey,
            "lamp_height_mm": rig.lamp_height_mm,
            "lamp_radius_mm": rig.lamp_radius_mm,
        },
        "calibration_block": asdict(block),
    }


def save_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an 8 bit image of shape (height, width) as PNG, whole or not at all."""
    import cv2

    good, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not good:
        raise OSError(f"{path}: the image could not be encoded")
    _save(path, data.tobytes())


def save_stripes(path: Path, truths: Sequence[StripeTruth]) -> None:
    """Write the stripes of all skeins: `x_px` float32 and `on_product` int8, (skein, stripe, row)."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        x_px=np.array([t.x_px for t in truths], dtype=np.float32),
        on_product=np.array([t.on_product for t in truths], dtype=np.int8),
    )
    _save(path, buffer.getvalue())


def save_yaml(path: Path, content: dict[str, Any]) -> None:
    """Write plain data as YAML."""
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 110
    buffer = io.StringIO()
    yaml.dump(content, buffer)
    save_text(path, buffer.getvalue())


def save_text(path: Path, text: str) -> None:
    """Write text as UTF-8, whole or not at all."""
    _save(path, text.encode())


def _save(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


def _about(shipped: bool) -> str:
    """Return the text that goes with the data."""
    from importlib.resources import files

    text = (files("roemetry_simulate") / "herring_data.md").read_text(encoding="utf-8")
    made = "python -m roemetry_simulate.herring_roe OUT"
    return text.replace("@COMMAND@", made if shipped else made + " --seed N --count N")
