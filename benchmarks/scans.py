"""Belt scans on simulated rigs: motion, volumes with their intervals, faults, formats, time and memory.

    python -m benchmarks scans                       # all parts
    python -m benchmarks scans --parts motion,faults --count 20 --seed 500

Rigs are drawn: distance, angle, focal length, pitch and way of the belt. Each one's calibration is wrong by a
draw of the covariance that it states, as large as boards leave; its motion comes from one pass of a truncated
pyramid, as users measure it, and never from the truth. Seeds from 500 on were not used while developing.
"""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.command import parser_of
from benchmarks.tables import Against
from roemetry.config.recipe import Recipe
from roemetry.io.yaml_source import dump
from roemetry.records import (
    Acquisition,
    Estimate,
    Frame,
    Product,
    Profiles,
    Pyramid,
    ScanLines,
    StripeMap,
    Trace,
)
from roemetry.records.calibration import Calibration
from roemetry.records.scan import Motion
from roemetry.run.open_parts import split_products
from roemetry.run.pipeline import Pipeline
from roemetry.run.scan import gather
from roemetry.stages import Simulator
from roemetry_pinhole.pinhole_plane import PinholePlane, displacements, rest_polynomials, view_of
from roemetry_scan.belt import BeltOptions
from roemetry_scan.closed import Registration, closed_volume
from roemetry_scan.dense import DenseSlices
from roemetry_scan.formats import write
from roemetry_scan.formats.points import measured_of
from roemetry_scan.placing import BeltMotion
from roemetry_simulate.moving_belt import MovingBelt, MovingBeltOptions

PYRAMID = Pyramid("frustum-70", 70.0, 28.0, 20.0, 0.005)
FRUSTUM = {"length_mm": 70, "width_mm": 70, "top_share": 0.4, "height_mm": 20, "turn_range_deg": 20}
CONVEX: dict[str, dict[str, Any]] = {
    "truncated-pyramid": {"turn_range_deg": 40},
    "fillet": {"kinds": {"healthy": 1}},
    "bread-roll": {"kinds": {"healthy": 1}, "length_range_mm": [60, 80], "width_range_mm": [40, 50]},
    "egg": {"kinds": {"healthy": 1}},
    "potato": {"kinds": {"healthy": 1}, "length_range_mm": [55, 75], "width_range_mm": [40, 50]},
}
_BELOW_MM = 30.0
"""Of the lower head's own zero over the belt."""
_STD = {"focal_px": 3e-4, "planes_per_mm": 1e-5, "belt_per_mm": 1e-5}
"""Relative standard uncertainties of a calibration's parameters, as boards leave them: 0.3 px of a focal
length of 1,200, 3 µm of a plane's distance."""


def scene(*args: Any, **changes: Any) -> MovingBelt:
    """Make a simulator of the rig that `told_scene` describes."""
    return MovingBelt(MovingBeltOptions.model_validate(told_scene(*args, **changes)))


def told_scene(
    rows: int = 400, columns: int = 280, *, planes: int = 1, family: str = "none",
    product: dict[str, Any] | None = None, tilt_deg: float = 35.0, distance_mm: float = 300.0,
    **scan: Any,
) -> dict[str, Any]:  # fmt: skip
    """Give a simulator's options: one camera looks along the belt at a sheet of light from straight above."""
    return {
        "camera": {
            "width_px": columns, "height_px": rows, "pixel_size_um": 10, "focal_length_mm": 12,
            "distance_mm": distance_mm, "tilt_x_deg": 0.0, "tilt_y_deg": tilt_deg, "exposure_ms": 5,
        },
        "laser": {
            "projector_mm": [0, 0, 400], "planes": planes, "spacing_mm": 15.0, "centre_x_mm": 0.0,
            "line_width_mm": 1.0, "speckle_contrast": 0.03,
        },
        "product": {"family": family, "options": product or {}},
        "scan": scan,
    }  # fmt: skip


def true_calibration(sim: Simulator[Any]) -> Calibration:
    """Give the calibration that a simulated rig truly has, with its motion."""
    told = sim.calibration_truth(0)
    rig, pose = told["rig"], np.array(told["rig"]["T_belt_camera"])
    turn, place, matrix = pose[:3, :3], pose[:3, 3], np.array(rig["camera_matrix"])
    planes = [(turn.T @ plane[:3]) / (plane[3] - plane[:3] @ place) for plane in np.array(rig["planes"])]
    parameters = {
        "focal_px": np.full(2, matrix[0, 0]),
        "principal_px": matrix[:2, 2],
        "distortion": np.zeros(8),
        "planes_per_mm": np.array(planes),
        "belt_per_mm": turn.T @ np.array([0.0, 0.0, 1.0]) / -place[2],
    }
    motion = Motion(np.array(told["mm_per_count"]), np.zeros((3, 3)))
    return calibration_by(parameters, tuple(rig["image_size"]), motion)


def calibration_by(
    parameters: dict[str, Any], size: tuple[int, int], motion: Motion | None, covariance: Any = None
) -> Calibration:
    """Give a pinhole calibration by its parameters."""
    many = sum(np.size(value) for value in parameters.values())
    return Calibration(
        "pinhole-plane", size, 0, rest_polynomials(parameters, size), displacements(parameters, size),
        (-3.0, 90.0), parameters, np.zeros((many, many)) if covariance is None else covariance,
        view=view_of(parameters, size), motion=motion,
    )  # fmt: skip


def drawn_calibration(sim: Simulator[Any], rng: np.random.Generator) -> Calibration:
    """Give a calibration that is wrong by a draw of the covariance that it states; it knows no motion."""
    true = true_calibration(sim)
    std = np.concatenate(
        [
            np.full(value.size, _STD.get(name, 0.0) * float(np.abs(value).max(initial=0.0)))
            for name, value in true.parameters.items()
        ]
    )
    moved, start = {}, 0
    for name, value in true.parameters.items():
        part = std[start : start + value.size].reshape(value.shape)
        moved[name] = value + part * rng.standard_normal(value.shape)
        start += value.size
    return calibration_by(moved, true.image_size, None, np.diag(std**2))


def stripes_of(sim: MovingBelt, seed: int, noise_px: float) -> tuple[StripeMap, ScanLines]:
    """Give a scan's stripes without images: exact crossings with noise, and the counts."""
    drawn = sim.drawn(0, seed)
    counts, _ = sim.belt(drawn, seed)
    x_px = np.concatenate([x for x, _ in sim.crossings(drawn, seed)])
    x_px = x_px + noise_px * np.random.default_rng([seed, 7]).standard_normal(x_px.shape)
    known = np.isfinite(x_px)
    unknown = np.full(x_px.shape, np.nan)
    stripes = StripeMap(
        x_px, np.where(known, noise_px, np.nan), np.where(known, 1, -1).astype(np.int16), known, unknown,
        np.zeros(x_px.shape, np.bool_), unknown, np.empty(0, np.int16),
    )  # fmt: skip
    many = len(counts)
    return stripes, ScanLines(
        _no_frame, sim.options.scan.shown(counts).astype(np.float64), np.arange(many), (0, many)
    )


def _no_frame(line: int) -> Frame:
    raise AssertionError(f"line {line}: these lines have no images")


def lines_of(sim: MovingBelt, seed: int) -> ScanLines:
    """Give a scan's lines with their frames in memory."""
    drawn = sim.drawn(0, seed)
    frames = [frame for _, _, frame in sim.frames(drawn, seed)]
    counts, _ = sim.belt(drawn, seed)
    return ScanLines(
        lambda k: Frame(frames[k], sensor=sim.sensor()), sim.options.scan.shown(counts).astype(np.float64),
        np.arange(len(frames)), (0, len(frames)),
    )  # fmt: skip


def recipe_of(calibration: Calibration, folder: Path, **changes: Any) -> Recipe:
    """Make a recipe that measures scans with a calibration, and write both."""
    calibration.save(folder / "calibration.yaml")
    told = {
        "roemetry": 1,
        "product": "a scan",
        "source": {"use": "belt-scan", "path": "."},
        "calibration": "calibration.yaml",
        "stages": {
            "extractor": "gaussian", "coder": "single", "triangulator": "pinhole-plane",
            "volume": "dense-slices",
        },
        **changes,
    }  # fmt: skip
    (folder / "recipe.yaml").write_text(dump(told))
    return Recipe.load(folder / "recipe.yaml")


def measured(recipe: Recipe, lines: ScanLines, draws: int | None = None) -> Trace:
    """Measure lines in memory."""
    return Pipeline(recipe, draws=draws).trace(Acquisition("scan", (), lines=lines))


def drawn_rig(rng: np.random.Generator, **changes: Any) -> dict[str, Any]:
    """Draw a rig: distance, angle of the camera, the belt's way and the pitch."""
    return {
        "tilt_deg": float(rng.uniform(25, 40)),
        "distance_mm": float(rng.uniform(280, 340)),
        "mm_per_count": (float(rng.uniform(0.01, 0.03)), float(rng.uniform(-4e-4, 4e-4))),
        "counts_per_line": int(rng.integers(12, 25)),
        **changes,
    }


def motion(count: int, seed: int) -> None:
    """Say how far heights, pitch and direction are off after one pass of the pyramid."""
    pitch, lean, heights = [], [], []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        sim = scene(family="truncated-pyramid", product=FRUSTUM, **drawn_rig(rng))
        calibration = drawn_calibration(sim, rng)
        stripes, lines = stripes_of(sim, seed + k, 0.05)
        found, _ = BeltMotion().motion(stripes, lines, calibration, PinholePlane(), PYRAMID)
        true = np.array([*sim.options.scan.mm_per_count, 0.0])
        t = found.mm_per_count
        pitch.append(np.linalg.norm(t) / np.linalg.norm(true) - 1.0)
        lean.append(np.degrees(np.arccos(min(1.0, t @ true / np.linalg.norm(t) / np.linalg.norm(true)))))
        placed = BeltMotion()
        known = replace(calibration, motion=found)
        profiles = placed.label(placed.place(stripes, lines, known, PinholePlane()))
        z = profiles.xyz_mm[..., 2]
        top = (profiles.product == 1) & profiles.seen & (z > PYRAMID.height_mm - 0.3)
        heights.append(np.sqrt(np.mean((z[top] - PYRAMID.height_mm) ** 2)) / _range_mm(sim))
    print(
        f"motion, {count} rigs: pitch off by {np.abs(pitch).max():.3%} at most ({np.std(pitch):.3%} rms), "
        f"direction by {np.max(lean):.4f}° at most ({np.sqrt(np.mean(np.square(lean))):.4f}° rms); heights 1/"
        f"{1.0 / np.sqrt(np.mean(np.square(heights))):.0f} of the range (rms)"
    )


def _range_mm(sim: MovingBelt) -> float:
    """Give the range of heights that the camera sees in the plane of light, mm."""
    calibration = true_calibration(sim)
    assert calibration.view is not None
    rows, columns = calibration.image_size
    ends = calibration.view.lift(
        np.array([[0.0, rows / 2], [columns - 1.0, rows / 2]]), np.zeros(2, np.int64)
    )
    return float(np.ptp(ends[:, 2]))


def tell(how: str, family: str, found: Against) -> None:
    """Print how far volumes are off, and how many intervals hold."""
    off = found.off
    print(
        f"{how}, {off.size} × {family}: mean {off.mean():+.2%}, mean absolute {np.abs(off).mean():.2%}, "
        f"worst {np.abs(off).max():.2%}; intervals (± {found.half:.2%}) hold {found.held} of {off.size}"
    )


def _visible_mm3(sim: MovingBelt, seed: int) -> float:
    drawn = sim.drawn(0, seed)
    assert drawn is not None
    return drawn.truth.visible_mm3


def calibrated_volume(
    rig: dict[str, Any], rng: np.random.Generator, seed: int, lines: ScanLines, name: str
) -> Estimate | None:
    """Measure lines with a calibration drawn for the rig, and the motion that a pyramid's pass tells by it.

    Where there is not one volume, why not is printed.
    """
    with_pyramid = scene(family="truncated-pyramid", product=FRUSTUM, **rig)
    calibration = drawn_calibration(with_pyramid, rng)
    stripes, pyramid = stripes_of(with_pyramid, seed, 0.05)
    moves, _ = BeltMotion().motion(stripes, pyramid, calibration, PinholePlane(), PYRAMID)
    with tempfile.TemporaryDirectory() as folder:
        recipe = recipe_of(replace(calibration, motion=moves), Path(folder), uncertainty="linear")
        trace = measured(recipe, lines)
    if len(trace.products) == 1 and trace.products[0].volume is not None:
        return trace.products[0].volume.visible_mm3
    print(f"  {name}: {trace.absent or [one.absent for one in trace.products]}")
    return None


def volumes(count: int, seed: int) -> None:
    """Say how far volumes are off, and how often their intervals hold the truth."""
    for family, options in CONVEX.items():
        found = Against()
        for k in range(count):
            rng = np.random.default_rng([seed, k, 3])
            rig = drawn_rig(rng)
            # the shadow behind a product is as long as it is high
            sim = scene(family=family, product=options, lead_mm=35.0, **rig)
            name = f"{family} of seed {seed + k}"
            volume = calibrated_volume(rig, rng, seed + k, lines_of(sim, seed + k), name)
            if volume is not None:
                found.add(volume, _visible_mm3(sim, seed + k))
        tell("volume", family, found)


def shapes(count: int, seed: int) -> None:
    """Say the same without images: exact crossings with noise, so that only what slices miss is left."""
    for family, options in CONVEX.items():
        found = Against()
        for k in range(count):
            rig = drawn_rig(np.random.default_rng([seed, k, 3]))
            sim = scene(family=family, product=options, lead_mm=35.0, **rig)
            _, (product,) = _placed(*stripes_of(sim, seed + k, 0.05), sim)
            found.add(DenseSlices().estimate(product).visible_mm3, _visible_mm3(sim, seed + k))
        tell("without images", family, found)


def two_sides(count: int, seed: int) -> None:
    """Say how far true volumes of two heads are off: exact crossings with noise, a plate's registration."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = _BELOW_MM
    registration = Registration(pose, 0.005, 6, (0.0, 0.0))
    for family in ("egg", "potato", "bread-roll"):
        found = Against()
        for k in range(count):
            rig, sides = drawn_rig(np.random.default_rng([seed, k, 11]), tilt_deg=35.0), []
            for below_mm in (None, _BELOW_MM):
                sim = scene(family=family, product=CONVEX[family], lead_mm=35.0, below_mm=below_mm, **rig)
                belt = BeltOptions(belt="fit" if below_mm is None else "zero")
                sides.append(_placed(*stripes_of(sim, seed + k, 0.05), sim, belt)[0])
            drawn = sim.drawn(0, seed + k)
            assert drawn is not None
            assert drawn.truth.true_mm3 is not None
            found.add(closed_volume(sides[0], sides[1], registration), drawn.truth.true_mm3)
        tell("two heads", family, found)


def _placed(
    stripes: StripeMap, lines: ScanLines, sim: MovingBelt, belt: BeltOptions | None = None
) -> tuple[Profiles, tuple[Product, ...]]:
    """Place stripes by the true calibration; give the profiles, and the products in them."""
    calibration, assembler = true_calibration(sim), BeltMotion(belt)
    profiles = assembler.label(assembler.place(stripes, lines, calibration, PinholePlane()))
    return profiles, split_products(profiles, (), calibration, "scan")


def _spoiled(fault: str, lines: ScanLines, rng: np.random.Generator) -> tuple[ScanLines, Any]:
    """Give the lines with a fault at a random place, and which of the scan's they are."""
    many = len(lines.count)
    at = int(rng.integers(many // 3, 2 * many // 3))
    index = np.arange(many)
    if fault == "lost":
        index = np.delete(index, slice(at, at + int(rng.integers(1, 6))))
    elif fault == "reversed":
        back = int(rng.integers(2, 8))
        index = np.concatenate([index[: at + 1], index[at - back : at][::-1], index[at - back :]])
    count = lines.count[index]
    number = np.arange(many)[index] if fault == "lost" else np.arange(len(index))
    if fault.startswith("wrap"):
        bits = int(fault.removeprefix("wrap"))
        count = (count - count[at] + 2.0**bits) % 2.0**bits
    return ScanLines(lines.frame, count, number, (0, len(index))), index


def _of_lines(stripes: StripeMap, index: Any) -> StripeMap:
    fields = ("x_px", "x_std_px", "product", "seen", "margin", "ambiguous", "rest_px")
    return replace(stripes, **{name: getattr(stripes, name)[index] for name in fields})


def faults(count: int, seed: int) -> None:
    """Say how often each fault of a scan was noticed, and what it did to the volume."""
    said = {
        "lost": "lines-lost", "reversed": "belt-reversed", "wrap16": "counter-wrapped",
        "wrap32": "counter-wrapped",
    }  # fmt: skip
    roll = {"family": "bread-roll", "product": CONVEX["bread-roll"]}
    for fault, code in said.items():
        noticed, worst = 0, 0.0
        for k in range(count):
            rng = np.random.default_rng([seed, k, 5])
            sim = scene(rows=200, columns=200, **roll, **drawn_rig(rng, counts_per_line=40))
            stripes, lines = stripes_of(sim, seed + k, 0.05)
            bad, index = _spoiled(fault, lines, rng)
            whole, _ = _volume(stripes, lines, sim)
            value, codes = _volume(_of_lines(stripes, index), bad, sim)
            noticed += code in codes
            worst = max(worst, abs(value / whole - 1.0))
        print(f"{fault}: noticed in {noticed} of {count}; volume changed by {worst:.2%} at most")
    slip = {True: 0, False: 0}
    for k in range(count):
        rng = np.random.default_rng([seed, k, 6])
        share = float(rng.uniform(0.02, 0.04) * rng.choice([-1, 1]))
        slipping = drawn_rig(rng, counts_per_line=40, slip_share=share)
        steady = drawn_rig(np.random.default_rng([seed, k, 8]), counts_per_line=40)
        for slips, rig in ((True, slipping), (False, steady)):
            sim = scene(rows=200, columns=260, planes=3, **roll, **rig)
            slip[slips] += "slip" in _volume(*stripes_of(sim, seed + k, 0.05), sim)[1]
    print(f"slip of 2 to 4 % in the middle third, three lines: noticed in {slip[True]} of {count}")
    print(f"no slip, three lines: said in {slip[False]} of {count}")


def _volume(stripes: StripeMap, lines: ScanLines, sim: MovingBelt) -> tuple[float, set[str]]:
    profiles, products = _placed(stripes, lines, sim)
    value = sum(DenseSlices().estimate(one).visible_mm3.value for one in products)
    return value, {reason.code for reason in profiles.reasons}


def formats(count: int, seed: int) -> None:
    """Say how far volumes of files are from those of the scans they were written from."""
    worst: dict[str, float] = {}
    for k in range(count):
        rng = np.random.default_rng([seed, k, 9])
        sim = scene(family="bread-roll", product=CONVEX["bread-roll"], **drawn_rig(rng))
        with tempfile.TemporaryDirectory() as folder:
            trace = measured(recipe_of(true_calibration(sim), Path(folder)), lines_of(sim, seed + k), 0)
            assert trace.profiles is not None
            first = trace.products[0].volume
            assert first is not None
            for suffix in ("ply", "pcd", "las", "csv", "tif", "npy", "png", "x3p"):
                path = Path(folder) / f"map.{suffix}"
                write(path, measured_of(trace.profiles))
                again = Recipe.of(
                    {
                        "roemetry": 1, "product": "a map",
                        "source": {"use": "height-files", "path": path.name},
                        "stages": {"volume": "dense-slices"},
                    },
                    folder=Path(folder),
                )  # fmt: skip
                found = Pipeline(again, draws=0).trace(again.source.make().read(again.references()[0]))
                volume = found.products[0].volume
                assert volume is not None
                off = abs(volume.visible_mm3.value / first.visible_mm3.value - 1.0)
                worst[suffix] = max(worst.get(suffix, 0.0), off)
    told = ", ".join(f"{suffix} {off:.4%}" for suffix, off in worst.items())
    print(f"formats, {count} bread rolls: volumes off by at most {told}")


def speed(_: int, seed: int) -> None:
    """Say how fast lines become points, and what memory a long belt takes."""
    sim = scene(1280, 400, family="bread-roll", product=CONVEX["bread-roll"], counts_per_line=60)
    some = lines_of(sim, seed)
    frames = [some.frame(k % len(some.count)) for k in range(500)]
    lines = ScanLines(frames.__getitem__, np.linspace(0.0, 60.0 * 499.0, 500), np.arange(500), (0, 500))
    calibration = true_calibration(sim)
    with tempfile.TemporaryDirectory() as folder:
        for extractor in ("log-parabola", "gaussian"):
            recipe = recipe_of(calibration, Path(folder), stages={
                "extractor": extractor, "coder": "single", "triangulator": "pinhole-plane",
            })  # fmt: skip
            stages = {kind: one.make() for kind, one in recipe.stages.items()}
            pipeline = Pipeline(recipe, draws=0)
            took = []
            for _ in range(3):
                begin = time.process_time()
                stripes = gather(lines, pipeline._frame, stages, calibration)
                stages["assembler"].place(stripes, lines, calibration, stages["triangulator"])
                took.append(time.process_time() - begin)
            print(f"{extractor}: {500 / np.median(took):.0f} frames of 1280 × 400 a second, array to points")


def files(count: int, seed: int) -> None:
    """Say what a product takes from its files to its weight: processor time, and by the clock."""
    sim = scene(1280, 400, family="bread-roll", product=CONVEX["bread-roll"], counts_per_line=10)
    lines = lines_of(sim, seed)
    for suffix in ("pgm", "png"):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "roll").mkdir()
            for k, at in enumerate(lines.count):
                path = folder / "roll" / f"f{k:04d}_c{at:.0f}.{suffix}"
                cv2.imwrite(str(path), lines.frame(k).pixels)
            stages = {
                "extractor": "log-parabola", "coder": "single", "triangulator": "pinhole-plane",
                "volume": "dense-slices",
                "weigher": {"use": "density", "options": {"density_g_per_cm3": 0.3}},
            }  # fmt: skip
            source = {"use": "belt-scan", "path": "roll"}
            recipe = recipe_of(true_calibration(sim), folder, source=source, stages=stages)
            reader, pipeline, took = recipe.source.make(), Pipeline(recipe, draws=0), []
            for _ in range(max(2, count)):  # the first loads the kernels
                begin = time.process_time(), time.perf_counter()
                trace = pipeline.trace(reader.read(reader.references(folder / "roll")[0]))
                took.append((time.process_time() - begin[0], time.perf_counter() - begin[1]))
                assert trace.products[0].weight is not None
            processor, clock = np.median(took[1:], axis=0)
            print(f"{len(lines.count)} {suffix} files to a weight: {processor:.2f} s processor, {clock:.2f}")


def memory(count: int, seed: int) -> None:
    """Say what `roemetry run` takes at most of a belt of many frames in files, and how long."""
    sim = scene(1280, 400, family="bread-roll", product=CONVEX["bread-roll"], counts_per_line=60)
    some = lines_of(sim, seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "belt").mkdir()
        files = [f"f{k:03d}.pgm" for k in range(len(some.count))]
        for k, file in enumerate(files):
            cv2.imwrite(str(folder / "belt" / file), some.frame(k).pixels)
        many = math.ceil(1000 * count / len(files)) * len(files)
        told = "".join(f"{files[k % len(files)]},{60 * k},{k}\n" for k in range(many))
        (folder / "belt" / "counts.csv").write_text(f"file,encoder_count,frame_number\n{told}")
        options = {"part_lines": 200, "longest_product_lines": 100}  # of 50 lines or so
        source = {"use": "belt-scan", "path": "belt", "options": options}
        recipe_of(true_calibration(sim), folder, source=source, sinks=["csv"])
        command = [sys.executable, "-m", "roemetry", "run", "recipe.yaml", "--out", "results", "--json"]
        begin = time.perf_counter()
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        took = time.perf_counter() - begin
        found = len((folder / "results" / "results.csv").read_text().splitlines()) - 1
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    print(
        f"{many} frames of 1280 × 400 in files, parts of 300: {found} products, {peak:.0f} MB at most, "
        f"{took:.0f} s"
    )


PARTS: dict[str, Callable[[int, int], None]] = {
    "motion": motion, "volumes": volumes, "shapes": shapes, "faults": faults, "formats": formats,
    "speed": speed, "files": files, "memory": memory, "two-sides": two_sides,
}  # fmt: skip


def main() -> None:
    """Run the parts that are asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=500)
    asked = parser.parse_args()
    for part in asked.parts.split(","):
        PARTS[part](asked.count, asked.seed)
