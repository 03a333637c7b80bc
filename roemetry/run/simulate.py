"""Make a data set from a scene: images, calibration images and their truth, on as many processes as wanted.

An item is a pure function of scene, seed and number, so any number of processes makes the same bytes. Its
files are written whole, each under another name first; its line, which makes it count, comes last, in order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from roemetry.config.dataset import (
    ITEMS,
    DatasetWriter,
    Description,
    Item,
    save_bytes,
    save_calibration_hashes,
    save_calibration_truth,
    save_stripes,
)
from roemetry.config.recipe_file import SensorFile
from roemetry.config.scene import Scene
from roemetry.errors import InterruptedRunError, OutputError
from roemetry.io.files import exclusive, make_folder, write_whole
from roemetry.io.yaml_source import dump
from roemetry.records import Frame, Role
from roemetry.run.executors import Executor, Lost, Processes
from roemetry.run.pace import OnProgress, Pace, silent
from roemetry.stages import Simulator

Calibration = Literal["none", "basic", "charuco", "all"]
BASIC = ("block", "belt")
KINDS: dict[Calibration, tuple[str, ...]] = {"basic": BASIC, "charuco": (*BASIC, "charuco")}
FOLDERS: dict[Role, str] = {"laser": "images", "plain": "images_plain", "dark": "images_dark"}

_SCENE = "scene.yaml"


@dataclass(frozen=True, slots=True)
class Made:
    """What a simulation came to."""

    folder: Path
    items: int
    kept: int
    """items, kept: how many items it has, and how many of them were there before."""
    views: int


@dataclass(frozen=True, slots=True)
class _View:
    """A calibration image to make."""

    kind: str
    name: str
    path: str


_Task = int | _View


def simulate(
    scene: Scene,
    folder: Path,
    *,
    count: int,
    seed: int = 1,
    jobs: int = 1,
    executor: Executor | None = None,
    resume: bool = False,
    calibration: Calibration = "basic",
    on_progress: OnProgress = silent,
) -> Made:
    """Make a data set, or go on with one.

    Parameters
    ----------
    scene
        What to make images of.
    folder
        Where; created if needed.
    count
        Number of items.
    seed
        The same scene, seed and number give the same bytes.
    jobs
        Worker processes; the same bytes for any number.
    executor
        What does the work instead of `jobs` processes; its workers write into `folder`.
    resume
        Go on with a set of the same scene and seed; it may also become longer.
    calibration
        Calibration images: none, block and empty belt, these and the ChArUco board, or every kind the
        simulator has.
    on_progress
        Called with (items and calibration images done, of how many, and the time that the others will take,
        s).

    Raises
    ------
    OutputError
        The folder cannot be written, or holds another data set; what was written before stays whole.
    StageError
        The simulator cannot make an item, with the reason.
    """
    make_folder(folder)
    if not resume and (folder / ITEMS).exists() and (folder / ITEMS).stat().st_size:
        raise OutputError(
            f"{folder}: there is a data set in this folder already",
            hint="go on with it by --resume, or choose another folder with --out",
        )
    simulator = scene.make()
    views = _views(simulator, seed, calibration)
    told = _description(scene, simulator, seed, count, calibration, views)
    with exclusive(folder), DatasetWriter(folder, told) as writer:
        _keep_scene(scene, folder)
        names = [scene.file.item.format(number=number + 1) for number in range(count)]
        tasks: list[_Task] = [number for number, name in enumerate(names) if name not in writer.done]
        # the kinds with most images first: the time left is soon told by what most of them take
        alike = Counter(view.kind for view in views)
        ordered = sorted(views, key=lambda view: -alike[view.kind])
        tasks += [view for view in ordered if not (folder / view.path).exists()]
        pace = Pace(Counter(map(_kind_of, tasks)))
        kept = sum(name in writer.done for name in names)
        total = len(views) + count
        done = total - len(tasks)
        on_progress(done, total, pace.left_s())
        made = (executor or Processes(jobs)).in_order(_Worker, (scene, folder, seed), tasks)
        for task, item in zip(tasks, made, strict=True):
            if isinstance(item, Lost):
                raise InterruptedRunError(f"{item.task}: {item.why}", hint="go on with --resume")
            if item is not None:
                writer.add(item)
            done += 1
            pace.done(_kind_of(task))
            on_progress(done, total, pace.left_s())
    known = [view.path for view in views]
    if calibration != "none" and (truth := simulator.calibration_truth(seed)):
        known.append(save_calibration_truth(folder, truth))
    save_calibration_hashes(folder, known)
    return Made(folder, count, kept, len(views))


def _kind_of(task: _Task) -> str:
    """Name the tasks that cost alike: items, and calibration images of one target in one light."""
    return (
        "item"
        if isinstance(task, int)
        else f"{task.kind} {task.name.rpartition('_')[2].rstrip('0123456789')}"
    )


def _views(simulator: Simulator[Any], seed: int, calibration: Calibration) -> list[_View]:
    """List the calibration images; of a kind with one image the file lies beside the others' folders."""
    if calibration == "none":
        return []
    found = []
    for kind, frames in simulator.calibration_frames(seed).items():
        if kind not in KINDS.get(calibration, (kind,)):
            continue
        names = list(frames)
        for name in names:
            path = f"calibration/{kind}.png" if len(names) == 1 else f"calibration/{kind}/{name}.png"
            found.append(_View(kind, name, path))
    return found


def _description(
    scene: Scene,
    simulator: Simulator[Any],
    seed: int,
    count: int,
    calibration: Calibration,
    views: Sequence[_View],
) -> Description:
    folders: dict[str, str] = {}
    for view in views:
        alone = view.path == f"calibration/{view.kind}.png"
        folders[view.kind] = view.path if alone else f"calibration/{view.kind}"
    sensor = simulator.sensor()
    more = "" if calibration == "basic" else f" --calibration {calibration}"
    return Description(
        roemetry_dataset=1,
        name=scene.file.name,
        licence=scene.file.licence,
        made_with=f"roemetry simulate {_SCENE} --count {count} --seed {seed}{more} --out OUT",
        made_from={
            "simulator": scene.simulator.registered.entry.name,
            "provider": str(scene.simulator.registered.provider),
            "seed": seed,
            "scene_sha256": scene.sha256,
        },
        turn_deg=simulator.turn_deg(),
        sensor=None if sensor is None else SensorFile(**asdict(sensor)),
        calibration=folders,
    )


def _keep_scene(scene: Scene, folder: Path) -> None:
    """Put the scene, whole, beside what it made; a scene that lies there already stays as it is."""
    path = folder / _SCENE
    if path.exists():
        if path.resolve() == scene.path.resolve() or Scene.load(path).sha256 == scene.sha256:
            return
        raise OutputError(f"{path}: there is another scene here", hint="choose another folder with --out")
    told, files = scene.kept()
    for name, file in files.items():
        save_bytes(folder / name, file.read_bytes())
    write_whole(path, dump(told))


class _Worker:
    """Makes one item or calibration image at a time, and writes its files."""

    def __init__(self, scene: Scene, folder: Path, seed: int) -> None:
        self._scene, self._folder, self._seed = scene, folder, seed
        self._simulator = scene.make()

    def __call__(self, task: _Task) -> Item | None:
        if isinstance(task, int):
            return self._item(task)
        frame = self._simulator.calibration_frames(self._seed)[task.kind][task.name]
        save_bytes(self._folder / task.path, _png(frame))
        return None

    def _item(self, number: int) -> Item:
        name = self._scene.file.item.format(number=number + 1)
        made = self._simulator.simulate(number, self._seed)
        files: dict[Role, str] = {}
        for frame in made.frames:
            files[frame.role] = f"{FOLDERS[frame.role]}/{name}.png"
            save_bytes(self._folder / files[frame.role], _png(frame))
        if made.counts is not None:
            told = "".join(f"{count},{line}\n" for line, count in enumerate(made.counts))
            path = self._folder / f"{FOLDERS['laser']}/{name}.csv"
            save_bytes(path, f"encoder_count,frame_number\n{told}".encode())
        stripes = None
        if made.truth.stripes is not None:
            stripes = f"truth/{name}.npz"
            save_stripes(self._folder / stripes, made.truth.stripes)
        first = made.frames[0]
        return Item(
            id=name,
            files=files,
            products=made.truth.products,
            stripes=stripes,
            time_s=first.time_s,
            encoder_count=first.encoder_count,
            bit_depth=first.bit_depth,
        )


def _png(frame: Frame) -> bytes:
    import cv2

    # OpenCV's own compression: the highest one takes 150 times as long, longer than rendering, for 8 % less
    good, data = cv2.imencode(".png", frame.pixels)
    if not good:
        raise OutputError(f"{frame.name}: the image could not be encoded as PNG")
    return bytes(data.tobytes())
