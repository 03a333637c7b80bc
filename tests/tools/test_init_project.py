"""`roemetry init` and `new-plugin`: what they lay out runs and is measured, and what cannot be is told."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from typer.testing import CliRunner

from roemetry import Recipe, run_recipe
from roemetry.cli.main import app
from roemetry.config.rig import Rig
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, OutputError, RoemetryError
from roemetry.io.yaml_source import parse
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import Provider, Registered, discover
from roemetry.testing import conformance
from roemetry_tools.init_project import COPIED, copied, shipped_lines, start_like, start_own, texts_of
from roemetry_tools.init_project import line_of as find_line
from roemetry_tools.init_project.layout import Answers, Layout, lay_out
from roemetry_tools.new_plugin import TEMPLATES, write_plugin
from tests.command import typed

LINES = ("bread_roll", "egg", "fish_fillet", "herring_roe", "potato")


def displaced_mm(rig: Layout, x_mm: float, height_mm: float) -> float:
    """Place on the belt where the camera sees a stripe's point at a height, less the stripe's own place.

    By similar triangles, apart from what `lay_out` works out.
    """
    lit = x_mm + (rig.projector_x - x_mm) * height_mm / rig.projector_z
    return lit * rig.distance / (rig.distance - height_mm) - x_mm


@given(
    length=st.floats(10, 500),
    width=st.floats(0.2, 1.0),
    height=st.floats(0.05, 1.0),
    stripes=st.none() | st.integers(5, 25),
    focal_mm=st.sampled_from([8.0, 16.0, 35.0]),
    columns=st.sampled_from([640, 1280, 2048]),
)
@example(length=10.0, width=1.0, height=0.625, stripes=16, focal_mm=8.0, columns=2048)
def test_a_rig_that_is_laid_out_can_measure_the_product(
    length: float, width: float, height: float, stripes: int | None, focal_mm: float, columns: int
) -> None:
    size = (length, width * length, height * width * length)
    answers = Answers(
        "p", size, columns=columns, rows=3 * columns // 4, pixel_um=5, focal_mm=focal_mm, stripes=stripes
    )
    try:
        rig = lay_out(answers)
    except ConfigurationError as refused:
        assert refused.hint
        return
    assume(rig.spacing * (rig.stripes - 1) > 0.9 * length)  # rounding to 0.1 mm, of very small ones
    for x in (-0.5 * length, 0.0, 0.5 * length):
        assert displaced_mm(rig, x, size[2]) <= 0.85 * rig.spacing
        assert displaced_mm(rig, x, size[2]) > 0.0
    shrunk = (rig.distance - size[2]) / rig.distance
    across, along = (side * shrunk for side in rig.view)
    turned = math.radians(10)
    assert across >= length * math.cos(turned) + size[1] * math.sin(turned)
    assert along >= size[1] * math.cos(turned) + length * math.sin(turned) + 10.0
    assert rig.block[2] < size[2] or size[2] < 4.0
    assert rig.spacing * (rig.stripes - 1) <= rig.view[0]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"product": " "}, "--product: the name is empty"),
        ({"size_mm": (0.0, 40.0, 30.0)}, "--size: the length is 0 mm"),
        ({"size_mm": (90.0, 40.0, math.nan)}, "--size: the height is nan mm"),
        ({"stripes": 1}, "several stripes on each product"),
        ({"stripes": 40}, "px apart in the image"),
        ({"size_mm": (20.0, 20.0, 60.0), "stripes": 20}, "stripes or fewer"),
        ({"columns": 10}, "--image: found 10"),
        ({"pixel_um": 1000.0}, "--pixel-um: found 1000"),
        ({"focal_mm": 0.0}, "--focal-mm: found 0"),
        ({"distance_mm": 200.0}, "go to"),
        ({"distance_mm": -1.0}, "--distance-mm: found -1"),
        ({"measures": ("wieght",)}, "there is no `wieght`"),
        ({"measures": ("weight",)}, "a weight needs the density"),
        ({"density_g_per_cm3": 1080.0}, "expected g/cm³"),
    ],
)
def test_answers_that_cannot_be_are_told(changed: dict[str, object], says: str) -> None:
    given = {"product": "plums", "size_mm": (90.0, 60.0, 45.0)} | changed
    with pytest.raises(ConfigurationError) as refused:
        lay_out(Answers(**given))  # type: ignore[arg-type]
    assert says in str(refused.value)
    with pytest.raises(ConfigurationError) as refused:
        lay_out(Answers("", (1.0, 1.0, -1.0), pixel_um=0.0))
    assert len(refused.value.faults) == 3


@pytest.mark.parametrize(
    ("name", "measures", "plain"),
    [
        ("plums", ("volume",), False),
        ('say "plum": # {x}', ("volume", "weight", "shape"), True),
        ("Слива\\n", ("volume",), True),
        ("- a\n- b", ("volume", "weight", "shape"), False),
    ],
)
def test_files_of_an_own_product_are_sound(
    tmp_path: Path, measures: tuple[str, ...], plain: bool, name: str
) -> None:
    answers = Answers(
        name, (90.0, 60.0, 45.0), measures=measures, density_g_per_cm3=1.0, plain_light=plain, stripes=12
    )
    for file, text in texts_of(answers, lay_out(answers), items=2).items():
        (tmp_path / file).write_text(text, "utf-8")
    scene = Scene.load(tmp_path)
    assert scene.file.name == name
    assert ("plain" in scene.simulator.options.light.images) == plain
    for line in ("calibration: calibration.yaml\n", "  triangulator: pinhole-plane\n"):
        text = (tmp_path / "recipe.yaml").read_text("utf-8")
        assert line in text
    loaded = Recipe.load(
        tmp_path,
        sets=["calibration=", "stages.aligner=", "stages.triangulator=", "stages.volume=", "stages.weigher=",
              "stages.classifier=", "stages.outliner=", "source.use=image-files"],
    )  # fmt: skip
    assert loaded.product == name
    assert "{{" not in (tmp_path / "README.md").read_text("utf-8")


@pytest.mark.parametrize(
    ("said", "meant"), [("potatoe", "potato"), ("Bread-Rol", "bread_roll"), ("eg", "egg")]
)
def test_an_unknown_line_gets_a_close_match(said: str, meant: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=f"did you mean `{meant}`"):
        start_like(said, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "recipe.yaml").write_text("mine", "utf-8")
    for begin in (
        lambda: start_like("egg", tmp_path),
        lambda: start_own(Answers("p", (90, 60, 45)), tmp_path),
    ):
        with pytest.raises(RoemetryError, match="not empty"):
            begin()
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.yaml"]
    with pytest.raises(RoemetryError, match="is a file"):
        start_like("egg", tmp_path / "recipe.yaml")


@pytest.mark.parametrize("name", LINES)
def test_a_line_is_begun_without_images_and_names_nothing_outside_its_folder(
    name: str, tmp_path: Path
) -> None:
    assert set(shipped_lines()) == set(LINES)
    texts = copied(find_line(name))
    assert "../" not in texts["recipe.yaml"] + texts["rig.yaml"]
    assert "recipes/" not in texts["recipe.yaml"]
    begun = start_like(name, tmp_path / "line", items=0)
    assert {path.name for path in begun.files} >= {*COPIED, "README.md"}
    assert Recipe.load(begun.folder).stages
    assert Scene.load(begun.folder).file.name


def test_a_line_is_begun_run_and_reported(tmp_path: Path) -> None:
    begun = start_like("herring roe", tmp_path / "line", items=1)
    run_recipe(Recipe.load(begun.folder), tmp_path / "out")
    record = (tmp_path / "out" / "measurements.jsonl").read_text("utf-8")
    rows = [json.loads(line) for line in record.splitlines()]
    assert [row["status"] for row in rows] == ["measured"]
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("failing", "there", "error"),
    [
        ("write_whole", False, OSError(28, "No space left on device")),
        ("_simulate", True, KeyboardInterrupt()),
        ("_calibrate", False, KeyboardInterrupt()),
        ("_calibrate", True, OSError(28, "No space left on device")),
    ],
)
def test_what_comes_to_no_end_leaves_nothing(
    there: bool, failing: str, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def fails(*_: object) -> None:
        calls.append(1)
        if failing != "write_whole" or len(calls) == 3:
            raise error

    folder = tmp_path / "new"
    if there:
        folder.mkdir()
    for name in ("_simulate", "_calibrate"):
        monkeypatch.setattr(f"roemetry_tools.init_project.{name}", lambda *_: folder / "calibration.yaml")
    monkeypatch.setattr(f"roemetry_tools.init_project.{failing}", fails)
    with pytest.raises(type(error)):
        start_own(Answers("p", (90, 60, 45)), folder)
    assert folder.is_dir() == there
    assert not there or not list(folder.iterdir())


def test_an_own_product_is_begun_calibrated_run_and_reported(tmp_path: Path) -> None:
    size = "--product plums --size 50x40x30mm --image 240x180 --pixel-um 26.7 --stripes 7"
    wanted = "--measure volume,weight --density 1 --items 1"
    words = ["init", str(tmp_path / "plums"), *size.split(), *wanted.split()]
    typed(*words)
    Rig.load(tmp_path / "plums" / "rig.yaml")
    run_recipe(Recipe.load(tmp_path / "plums"), tmp_path / "out")
    row = json.loads((tmp_path / "out" / "measurements.jsonl").read_text("utf-8").splitlines()[0])
    item = json.loads((tmp_path / "plums" / "data" / "items.jsonl").read_text("utf-8").splitlines()[0])
    true_mm3 = item["products"][0]["visible_mm3"]
    assert abs(row["volume"]["visible_mm3"]["value"] / true_mm3 - 1.0) < 0.06
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "no terminal to ask in"),
        (["{new}"], "--like or --product with --size must be given"),
        (["{new}", "--like", "potato", "--product", "p"], "exclude each other"),
        (["{new}", "--product", "p"], "--size: this is missing"),
        (["{new}", "--product", "p", "--size", "90x60"], "expected 3 numbers"),
        (["{new}", "--product", "p", "--size", "90x60xhigh"], "expected 3 numbers"),
        (["{new}", "--product", "p", "--size", "infx60x5"], "expected 3 numbers"),
        (["{new}", "--product", "p", "--size", "90x60x45", "--image", "640"], "expected 2 numbers"),
        (["{new}", "--like", "carrot"], "there is no product line `carrot`"),
    ],
)
def test_what_a_beginner_types_has_a_message(words: list[str], says: str, tmp_path: Path) -> None:
    said = [word.format(new=tmp_path / "new") for word in words]
    done = typed("init", *said, code=1)
    assert isinstance(done.exception, ConfigurationError)
    assert says in str(done.exception)
    assert not (tmp_path / "new").exists()


def test_questions_are_asked_in_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from roemetry_tools import init_project as starting

    asked: dict[str, Answers] = {}

    def begun(answers: Answers, folder: Path, **_: object) -> starting.NewProject:
        asked["answers"] = answers
        return starting.NewProject(folder, (), 0, lay_out(answers))

    monkeypatch.setattr("roemetry_tools.init.start_own", begun)
    monkeypatch.setattr("roemetry_tools.init.in_terminal", lambda: True)
    answers = f"{tmp_path / 'new'}\nplums\n90x60x45\n1280x1024\n5\n12\n0\n12\nvolume,weight\n1.1\ny\n"
    done = CliRunner().invoke(app, ["init"], input=answers)
    assert done.exit_code == 0, done.output
    assert asked["answers"] == Answers(
        "plums", (90, 60, 45), 1280, 1024, 5, 12, None, 12, ("volume", "weight"), 1.1, plain_light=True
    )


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_new_plugin_keeps_its_kinds_contract(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"tried-{kind}"
    write_plugin(name, kind, tmp_path, discover())
    monkeypatch.syspath_prepend(tmp_path / name)
    module = __import__(f"tried_{kind}")
    try:
        (entry,) = module.roemetry_stages()
        assert (entry.kind, entry.name) == (kind, name)
        registered = Registered(entry, Provider(name, "0.1.0", name))
        results = [(check.__name__, result) for check, result in conformance(registered)]
        assert results
        assert [(check, result.message) for check, result in results if not result.as_declared] == []
    finally:
        for loaded in [loaded for loaded in sys.modules if loaded.startswith(f"tried_{kind}")]:
            del sys.modules[loaded]


def test_every_kind_has_a_template_or_a_place_to_start_from(tmp_path: Path) -> None:
    for kind in set(KINDS) - set(TEMPLATES):
        with pytest.raises(ConfigurationError, match="start from plugins/"):
            write_plugin("my-thing", kind, tmp_path, discover())


def test_what_is_written_is_in_good_style(tmp_path: Path) -> None:
    for kind in TEMPLATES:
        write_plugin(f"tried-{kind}", kind, tmp_path, discover())
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--line-length", "110", "--select",
               "E,F,W,I,UP,B", str(tmp_path)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_package_can_be_installed(tmp_path: Path) -> None:
    files = write_plugin("my-peaks", "extractor", tmp_path, discover())
    assert all(file.is_file() for file in files)
    project = tomllib.loads((tmp_path / "my-peaks" / "pyproject.toml").read_text("utf-8"))
    assert project["project"]["entry-points"]["roemetry"] == {"my-peaks": "my_peaks"}
    readme = (tmp_path / "my-peaks" / "README.md").read_text("utf-8")
    said = readme.split("```yaml\n")[1].split("```")[0]
    assert parse(said, "readme").data == {"stages": {"extractor": "my-peaks"}}


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("gaussian", "extractor", "there is a stage `gaussian` of this kind already"),
        ("json", "sink", "`json` is installed already as a Python module"),
        ("class", "sink", "it is a word of Python"),
        ("my-peaks", "extracter", "did you mean `extractor`"),
        ("my-peaks", "Extractor", "did you mean `extractor`"),
    ],
)
def test_what_is_taken_is_refused(name: str, kind: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=says):
        write_plugin(name, kind, tmp_path, discover())


@pytest.mark.parametrize(
    ("name", "better"),
    [("MyPeaks", "my-peaks"), ("my peaks", "my-peaks"), ("3d-peaks", "my-3d-peaks"), ("Class", "my-class"),
     ("", "my-peaks"), ("../peaks", "peaks")],
)  # fmt: skip
def test_a_name_that_cannot_be_is_refused_and_a_better_one_offered(
    name: str, better: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigurationError, match=f"cannot be a plugin's name(.|\\n)*`{better}`"):
        write_plugin(name, "extractor", tmp_path, discover())
    assert not list(tmp_path.iterdir())
    assert write_plugin(better, "extractor", tmp_path, discover())


def test_no_plugin_is_overwritten(tmp_path: Path) -> None:
    written = write_plugin("my-peaks", "extractor", tmp_path, discover())
    before = [file.read_bytes() for file in written]
    with pytest.raises(ConfigurationError, match=r"is there already(.|\n)*pip install -e"):
        write_plugin("my-peaks", "extractor", tmp_path, discover())
    assert [file.read_bytes() for file in written] == before
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="--out names a folder"):
        write_plugin("my-peaks", "extractor", tmp_path / "file", discover())


def test_the_example_is_what_new_plugin_writes(root: Path, tmp_path: Path) -> None:
    write_plugin("run-centroid", "extractor", tmp_path, discover())
    example = root / "examples" / "roemetry-example-plugin" / "roemetry_example" / "extractor.py"
    written = tmp_path / "run-centroid" / "run_centroid" / "extractor.py"
    assert example.read_text("utf-8") == written.read_text("utf-8")
