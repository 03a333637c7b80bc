"""Spheres, planes and steps against closed forms; decisions at their limits; certificates and their
signatures.
"""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.calibrating.sphere_plate import fit_sphere
from roemetry.errors import DataError, InterruptedRunError
from roemetry.records import NOTHING, Block, Profiles, SpherePlate, Staircase
from roemetry.run.executors import Lost, Processes
from roemetry_study.acceptance import Artefact, Value, decide, dispersion, measure, overall
from roemetry_study.certificate import Certificate, Table, new_key, software_sha256, verify, write
from roemetry_study.gauge import plan
from roemetry_study.reports import of_acceptance
from roemetry_study.study_files import read_acceptance
from tests.command import typed

PLATE = SpherePlate("plate", 3, 2, 30.0, 20.0, 15.0, 0.01)


def _profiles(xyz_mm: np.ndarray, product: np.ndarray) -> Profiles:
    seen = np.isfinite(xyz_mm[..., 2])
    stripes, points = seen.shape
    return Profiles(
        xyz_mm=xyz_mm,
        product=np.where(seen, product, NOTHING),
        seen=seen,
        x_px=np.where(seen, 1.0, np.nan),
        row_px=np.where(seen, np.arange(points, dtype=np.float64), np.nan),
        height_std_mm=np.full(seen.shape, np.nan),
        stripe=np.arange(stripes),
        frame=np.zeros(stripes, np.int64),
        plane=np.tile([1.0, 0.0, 0.0, 0.0], (stripes, 1)),
    )


def _plate(turn_deg: float, shift: tuple[float, float], scale: float = 1.0, radius: float = 10.0) -> Profiles:
    """Cut six spheres by upright sheets of light 4 mm apart, seen from above."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    grid = np.array([(30.0 * k, 30.0 * j) for k in (-1, 0, 1) for j in (-0.5, 0.5)])
    centres = scale * (grid @ np.array([[c, s], [-s, c]])) + shift
    x, y = np.meshgrid(np.arange(-60.0, 60.0, 4.0), np.arange(-50.0, 50.0, 0.25), indexing="ij")
    height = np.full(x.shape, 5.0)
    for cx, cy in centres:
        rest = radius**2 - (x - cx) ** 2 - (y - cy) ** 2
        height = np.where(rest > 0.0, np.maximum(height, 15.0 + np.sqrt(np.maximum(rest, 0.0))), height)
    return _profiles(np.stack([x, y, height], axis=-1), np.ones(x.shape, np.int64))


@pytest.mark.parametrize(("turn_deg", "shift"), [(0.0, (0.0, 0.0)), (7.0, (3.0, -2.0)), (-38.0, (5.0, 5.0))])
def test_exact_spheres_are_found_wherever_the_plate_lies(turn_deg: float, shift: tuple[float, float]) -> None:
    values = list(measure(_plate(turn_deg, shift), Artefact(PLATE, 0.001)))
    sizes = [v for v in values if v.characteristic == "size"]
    spacings = [v for v in values if v.characteristic == "spacing"]
    assert (len(sizes), len(spacings)) == (6, 15)
    assert max(abs(v.error_mm) for v in sizes + spacings) < 1e-6
    assert {round(v.calibrated_mm, 3) for v in spacings} == {30.0, 42.426, 60.0, 67.082}
    assert max(v.measured_mm for v in values if v.characteristic == "form") < 1e-6


def test_a_wrong_scale_shows_in_spacings_and_a_wrong_size_in_sizes() -> None:
    values = list(measure(_plate(5.0, (0.0, 0.0), scale=1.002, radius=10.05), Artefact(PLATE, 0.001)))
    longest = max((v for v in values if v.characteristic == "spacing"), key=lambda v: v.calibrated_mm)
    assert longest.error_mm == pytest.approx(0.002 * longest.calibrated_mm, abs=1e-4)
    assert next(v for v in values if v.characteristic == "size").error_mm == pytest.approx(0.1, abs=1e-4)


def test_no_plate_is_no_plate() -> None:
    plate = _plate(0.0, (0.0, 0.0))
    flat = _profiles([1.0, 1.0, 0.0] * plate.xyz_mm + [0, 0, 17.0], plate.product)
    nothing = _profiles(np.full((4, 60, 3), np.nan), np.ones((4, 60), np.int64))
    for profiles, said in ((flat, "no sphere of 20 mm"), (nothing, "is not seen")):
        with pytest.raises(DataError, match=said):
            list(measure(profiles, Artefact(PLATE, 0.001)))


@given(st.tuples(*[st.floats(-50.0, 50.0)] * 3), st.floats(2.0, 40.0))
def test_a_sphere_is_found_from_a_start_beside_it(centre: tuple[float, float, float], radius: float) -> None:
    own = np.random.default_rng(5)
    rays = own.normal(size=(80, 3))
    rays[:, 2] = np.abs(rays[:, 2])
    points = np.array(centre) + radius * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    found, size = fit_sphere(points, np.array(centre) + 0.1 * radius, 1.1 * radius)
    assert found == pytest.approx(np.array(centre), abs=1e-6 * radius + 1e-9)
    assert size == pytest.approx(radius, abs=1e-6 * radius)


def test_dispersion_leaves_the_farthest_twentieth_out() -> None:
    values = np.concatenate([np.linspace(-1.0, 1.0, 96), [50.0, -50.0, 30.0, 9.0]])
    assert dispersion(values) == pytest.approx(2.0 * 94 / 95, abs=1e-9)


def test_steps_of_a_staircase_and_of_a_block() -> None:
    x, y = np.meshgrid(np.arange(0.0, 40.0, 4.0), np.arange(0.0, 80.0, 0.5), indexing="ij")
    height = np.select([y < 20, y < 40], [4.01, 8.0], 0.0)
    stairs = _profiles(np.stack([x, y, height], axis=-1), (height > 0.0).astype(np.int64))
    values = list(measure(stairs, Artefact(Staircase("s", (4.0, 8.0), 20.0, 40.0, 0.05), 0.002)))
    assert [round(v.error_mm, 6) for v in values] == [0.01, 0.0, -0.01]
    x, y = np.meshgrid(np.arange(-40.0, 40.0, 4.0), np.arange(-30.0, 30.0, 0.5), indexing="ij")
    on = (np.abs(x) < 15.0) & (np.abs(y) < 15.0)
    block = _profiles(np.stack([x, y, np.where(on, 16.52, 0.01)], axis=-1), on.astype(np.int64))
    measured = measure(block, Artefact(Block("b", 30.0, 30.0, 16.5, 0.005), 0.002))
    found = {value.characteristic: value for value in measured}
    assert found["step"].error_mm == pytest.approx(0.01, abs=1e-9)
    assert found["flatness"].measured_mm == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("error", "decision"),
    [(0.0835, "accepted"), (0.0837, "undecided"), (0.1163, "undecided"), (0.1166, "rejected")],
)
def test_guard_bands_stand_on_both_sides_of_the_limit(error: float, decision: str) -> None:
    """Limit 0.1 mm, u 0.01 mm: 0.08355 to 0.11645 mm is undecided."""
    (outcome,) = decide([Value("step", "s", 10.0 - error, 10.0, 0.01)], {"step": 0.1})
    assert outcome.decision == decision
    assert overall([outcome]) == decision
    assert "of 5 recommended" in outcome.words
    with pytest.raises(DataError, match="no artefact shows it"):
        decide([Value("step", "s", 1.0, 1.0, 0.01)], {"form": 0.1})


@pytest.fixture
def certificate() -> Certificate:
    table = Table("Values", ("what", "mm"), (("a", 1.25), ("b", math.nan)))
    return Certificate(
        "acceptance test", "accepted", ("all well",), ("by hand",), {"rig": "7"}, (table,), "none"
    )


def test_a_signed_certificate_is_proved_unchanged(certificate: Certificate, tmp_path: Path) -> None:
    public = new_key(tmp_path / "key.pem")
    assert (tmp_path / "key.pem").stat().st_mode & 0o077 == 0
    path, page = write(certificate, tmp_path, "acceptance", tmp_path / "key.pem")
    assert verify(path, public, page).trusted
    assert verify(path).signed_by == public
    software = json.loads(path.read_text("utf-8"))["administrative"]["software"]
    assert software["sha256"] == software_sha256()
    assert len(software["sha256"]) == 64
    with pytest.raises(DataError, match="signed by"):
        verify(path, new_key(tmp_path / "other.pem"))


def test_every_changed_byte_is_seen(certificate: Certificate, tmp_path: Path) -> None:
    new_key(tmp_path / "key.pem")
    path, page = write(certificate, tmp_path, "acceptance", tmp_path / "key.pem")
    whole = path.read_bytes()
    for at in range(len(whole)):
        changed = bytearray(whole)
        changed[at] ^= 1
        path.write_bytes(changed)
        with pytest.raises(DataError):
            verify(path)
    path.write_bytes(whole + b" ")
    with pytest.raises(DataError, match="its hash is another"):
        verify(path, page=page)


def test_unsigned_and_foreign_files_are_refused(certificate: Certificate, tmp_path: Path) -> None:
    path, _ = write(certificate, tmp_path, "acceptance")
    with pytest.raises(DataError, match="is not signed"):
        verify(path)
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(DataError, match="not a certificate"):
        verify(path)
    (tmp_path / "key.pem").write_text("no key", encoding="utf-8")
    with pytest.raises(DataError, match="private key"):
        write(certificate, tmp_path, "acceptance", tmp_path / "key.pem")


def test_the_commands_from_a_table_to_a_verified_page(tmp_path: Path) -> None:
    def run(*words: str) -> str:
        outcome = typed(*list(words))
        return outcome.output

    table = str(Path(__file__).parent / "aiag.csv")
    public = run("study", "key", str(tmp_path / "key.pem")).strip()
    key = ("--key", str(tmp_path / "key.pem"))
    said = run("study", "gauge", table, "--value", "deviation_mm", "--out", str(tmp_path), *key)
    assert "conditional: the gauge is 27.9 % of the total variation" in said
    assert "unchanged" in run("verify", str(tmp_path / "gauge.json"), "--signed-by", public)
    assert "0.3024" in (tmp_path / "gauge.html").read_text("utf-8")
    stds = ("--part-std", "5", "--repeatability-std", "1")
    assert "enough for" in run("study", "plan", *stds, "--half-width", "90")


def test_the_certificate_is_the_same_wherever_images_are_measured() -> None:
    class Elsewhere:
        """Does the work with what was sent as bytes, as another machine would."""

        def in_order(self, make: Any, of: Any, tasks: Any) -> Iterator[Any]:
            make, of, tasks = pickle.loads(pickle.dumps((make, of, list(tasks))))
            yield from map(make(*of), tasks)

    path = Path("recipes/herring_roe/acceptance.yaml").absolute()
    file = read_acceptance(path).model_copy(update={"recipe": "recipe.yaml"})  # quicker than the file's own
    assert of_acceptance(file, path, Elsewhere()) == of_acceptance(file, path, Processes(1))


SIZES = ((5, 2, 2), (5, 3, 2))


class Elsewhere:
    """Does what it is given as another process would: from pickles, a worker for each task."""

    def in_order(self, make, given, tasks):
        for task in tasks:
            worker = make(*pickle.loads(pickle.dumps(given)))
            yield pickle.loads(pickle.dumps(worker(pickle.loads(pickle.dumps(task)))))


class Loses:
    """Loses what it is given."""

    def in_order(self, make, given, tasks):
        yield from (Lost(task, "its worker died") for task in tasks)


def test_a_plan_is_the_same_by_any_executor() -> None:
    here = list(plan(1.0, 0.2, 0.1, SIZES, studies=3))
    assert list(plan(1.0, 0.2, 0.1, SIZES, studies=3, executor=Elsewhere())) == here
    assert [size[:3] for size in here] == list(SIZES)
    with pytest.raises(InterruptedRunError, match="a simulated study was lost: its worker died"):
        list(plan(1.0, 0.2, 0.1, SIZES, studies=3, executor=Loses()))
