"""A session answers as the pipeline would; a recipe is never lost, and changes only where it is wanted."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, DataError, OutputError
from roemetry.io.yaml_source import parse
from roemetry.records import AMBIGUOUS, SATURATED, Frame
from roemetry.run import api
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of
from roemetry.stages.registry import discover
from roemetry_files.image_files import ImageFiles
from roemetry_paper.density import Density
from roemetry_paper.dominant_peak import DominantPeak
from roemetry_paper.window_tracking import WindowTracking
from roemetry_tools.tune.editing import differences, edited, inline
from roemetry_tools.tune.request import KINDS, StageRequest, TuneRequest, fields_of, value_of
from roemetry_tools.tune.session import Session, packed, picture_of
from tests.tools.tune.unpacking import unpacked


def peaks(threshold: object = 60, **options: str) -> StageRequest:
    return StageRequest(use="dominant-peak", options={"threshold": str(threshold), **options})


PLAIN = StageRequest(use="dominant-peak")


@pytest.fixture
def session(line) -> Session:
    return Session(line())


def wish(session: Session, acquisition: str = "", **stages: StageRequest | None) -> TuneRequest:
    """TuneRequest for what the recipe says, but for some stages."""
    recipe = session.recipe()
    said = {
        kind["kind"]: None if kind["chosen"] is None else StageRequest(**kind["chosen"])
        for kind in recipe["stages"]
    }
    return TuneRequest(acquisition=acquisition, source=recipe["source"]["stated"], stages={**said, **stages})


def ask(session: Session, asked: TuneRequest) -> tuple[dict[str, Any], dict[str, Any]]:
    return unpacked(session.answer(asked))


def test_the_answer_is_what_the_pipeline_gives(line) -> None:
    path = line()
    session = Session(path)
    for threshold in (60, 90, 60):
        changed = peaks(threshold)
        header, arrays = ask(session, wish(session, "p02", extractor=changed))
        recipe = Recipe.load(path, sets=[f"stages.extractor.options.threshold={threshold}"])
        source = recipe.source.make()
        trace = Pipeline(recipe).trace(source.read(source.references(recipe.source_path)[1]))
        assert [row["id"] for row in header["rows"]] == [r.id for r in measurements_of(trace, recipe, {})]
        volume = trace.products[0].volume
        assert header["rows"][0]["volume"]["visible_mm3"]["value"] == volume.visible_mm3.value
        assert trace.peaks is not None and trace.stripes is not None and trace.profiles is not None
        assert np.array_equal(arrays["peaks.x_px"], trace.peaks.x_px.astype(np.float32))
        assert np.array_equal(arrays["peaks.stripe"], trace.stripes.peak_stripe)
        assert arrays["profiles.xyz_mm"].shape == trace.profiles.xyz_mm.shape
        places = header["places"]
        assert places["saturated"] == np.count_nonzero(trace.peaks.flags & SATURATED)
        assert places["ambiguous"] == np.count_nonzero(trace.stripes.peak_stripe == AMBIGUOUS)
        assert header["acquisition"] == "p02"


def test_only_stages_after_the_changed_one_run_again(line, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    for stage, verb in ((DominantPeak, "extract"), (Density, "weigh")):
        real = getattr(stage, verb)

        def noted(self: Any, *given: Any, _real: Any = real, _verb: str = verb) -> Any:
            ran.append(_verb)
            return _real(self, *given)

        monkeypatch.setattr(stage, verb, noted)
    session = Session(line())
    first, _ = ask(session, wish(session))
    assert ran == ["extract", "weigh"]
    heavier = StageRequest(use="density", options={"density_g_per_cm3": "2.2"})
    second, _ = ask(session, wish(session, weigher=heavier))
    assert ran == ["extract", "weigh", "weigh"]
    ask(session, wish(session))
    assert len(ran) == 3, "going back runs nothing"
    ask(session, wish(session, "p02"))
    assert ran[3:] == ["extract", "weigh"], "another frame runs everything"
    volume_cm3 = second["rows"][0]["volume"]["visible_mm3"]["value"] / 1000.0
    assert second["rows"][0]["weight"]["mass_g"]["value"] == pytest.approx(2.2 * volume_cm3, rel=1e-12)
    assert first["rows"][0]["volume"] == second["rows"][0]["volume"]


def test_results_are_forgotten_in_time(session: Session) -> None:
    for threshold in range(20, 34):  # seven stages each
        ask(session, wish(session, extractor=peaks(threshold)))
    assert len(session._memory._kept) <= 64


WRONG = {
    "no number": ("extractor", peaks("abc"), "options.threshold", "number"),
    "out of bounds": ("extractor", peaks(256), "options.threshold", "255"),
    "not YAML": (
        "extractor",
        StageRequest(use="steger", options={"region": "[0, 1"}),
        "options.region",
        "not YAML",
    ),
    "an unknown option": ("extractor", peaks(treshold="20"), "options.treshold", "did you mean `threshold`?"),
    "an unknown plugin": (
        "extractor",
        StageRequest(use="dominant-pek"),
        "use",
        "did you mean `dominant-peak`?",
    ),
    "a stage another one needs": (
        "triangulator",
        None,
        "volume",
        "it works on the result of the triangulator",
    ),
    "a file that is not there": (
        "outliner",
        StageRequest(use="edge-contour", options={"belt": "none.png"}),
        "options.belt",
        "there is no file",
    ),
    "an option that is needed": ("classifier", StageRequest(use="learned"), "options.model", "missing"),
}


@pytest.mark.parametrize(("kind", "stage", "path", "said"), WRONG.values(), ids=list(WRONG))
def test_what_is_wrong_is_told_at_its_field(session: Session, kind, stage, path: str, said: str) -> None:
    header, arrays = ask(session, wish(session, **{kind: stage}))
    assert not arrays
    told = {".".join(map(str, fault["path"])): fault["said"] for fault in header["faults"]}
    assert said in told[f"stages.{kind}.{path}" if stage else f"stages.{path}"]
    with pytest.raises(ConfigurationError):
        session.save(wish(session, **{kind: stage}))


def test_several_faults_are_told_at_once_and_a_source_without_images_at_its_path(session: Session) -> None:
    header, _ = ask(session, wish(session, extractor=peaks("[1", start="sideways")))
    assert {fault["path"][-1] for fault in header["faults"]} == {"threshold", "start"}
    header, _ = ask(session, TuneRequest(source={"path": "nowhere"}))
    assert header["faults"][0]["path"] == ["source", "path"]
    assert "there is no image here" in header["faults"][0]["said"]


def test_a_stage_that_refuses_gives_its_reason_and_the_rest_stands(session: Session) -> None:
    blind = peaks(250)
    header, arrays = ask(session, wish(session, extractor=blind))
    assert not header["faults"]
    assert header["absent"] or header["rows"][0]["reasons"]
    assert header["places"]["peaks"] == arrays["peaks.row"].size == 0


def test_a_damaged_frame_is_told_and_the_others_can_be_looked_at(line) -> None:
    path = line()
    (path.parent / "images" / "p02.png").write_bytes(b"not an image")
    session = Session(path)
    broken, _ = ask(session, wish(session, "p02"))
    assert "p02.png" in broken["faults"][0]["said"]
    assert ask(session, wish(session, "p03"))[0]["acquisition"] == "p03"


def test_gaps_are_those_that_were_cut(line) -> None:
    path = line(count=1)
    file = path.parent / "images" / "p01.png"
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    image[116:122, 110:190] = 12  # stripes 3 to 5 of the dome's top: six rows without light
    cv2.imwrite(str(file), image)
    session = Session(path)
    header, _ = ask(session, wish(session))
    gaps = [gap for gap in header["places"]["gap_list"] if (gap["first"], gap["last"]) == (116, 121)]
    assert {gap["stripe"] for gap in gaps} >= {2, 3}
    assert all(gap["bridged"] for gap in gaps)


def test_between_dots_there_are_no_gaps(root: Path) -> None:
    session = Session(root / "recipes" / "potato_dots")
    header, _ = ask(session, wish(session, volume=None))
    assert header["places"]["labelled"] > 300
    assert header["places"]["gaps"] == 0
    assert header["places"]["gap_list"] == []


def test_what_stands_above_white_is_shown_white() -> None:
    frame = Frame(np.array([[0, 100], [255, 400]], np.uint16), bit_depth=8, headroom=255)
    shown = cv2.imdecode(np.frombuffer(picture_of(frame), np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.dtype == np.uint8
    assert shown.tolist() == [[0, 100], [255, 255]]


def test_a_deep_image_is_shown_in_eight_bits(line) -> None:
    path = line(count=1)
    file = path.parent / "images" / "p01.png"
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(file), image.astype(np.uint16) * 257)
    session = Session(path)
    header, _ = ask(session, wish(session))
    assert header["image"]["white"] == 65535
    png = session.picture(header["image"]["key"])
    assert png is not None
    assert np.array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED), image)
    assert session.picture("0" * 24) is None


def test_saving_changes_the_value_keeps_comments_and_the_old_file(line) -> None:
    path = line()
    before = "# ours\n" + path.read_text("utf-8").replace("window-tracking", "window-tracking  # by order")
    path.write_text(before, "utf-8")
    session = Session(path)
    changed = peaks(75)
    saved = session.save(wish(session, extractor=changed))
    after = path.read_text("utf-8")
    assert after == before.replace("threshold: 60", "threshold: 75")
    assert path.with_name(saved["old"]).read_text("utf-8") == before
    assert Recipe.load(path).stages["extractor"].options.threshold == 75  # type: ignore[attr-defined]
    assert ask(session, wish(session))[0]["changes"] == []
    again = session.save(wish(session, extractor=peaks()))
    assert again["old"] == "", "what this session wrote itself is not kept again"
    assert path.read_text("utf-8") == before
    third = Session(path)
    assert third.save(wish(third, extractor=changed))["old"] == "recipe.yaml.old-2"
    now = path.read_text("utf-8")
    saved = third.save(wish(third, extractor=PLAIN), "softer")
    assert (Path(saved["path"]).name, saved["old"]) == ("softer.yaml", "")
    assert path.read_text("utf-8") == now
    assert third.recipe()["name"] == "softer.yaml"
    with pytest.raises(ConfigurationError, match="there already"):
        third.save(wish(third), "recipe.yaml")
    link = path.with_name("link.yaml")
    link.symlink_to(path)
    by_link = Session(link)
    by_link.save(wish(by_link, extractor=PLAIN))
    assert link.is_symlink()
    assert "threshold" not in path.read_text("utf-8")


def test_a_file_changed_by_someone_else_is_not_overwritten(line) -> None:
    path = line()
    session = Session(path)
    path.write_text(path.read_text("utf-8") + "# mine\n", "utf-8")
    with pytest.raises(ConfigurationError, match="changed by someone else"):
        session.save(wish(session, extractor=PLAIN))
    assert path.read_text("utf-8").endswith("# mine\n")


def test_a_full_disk_leaves_the_recipe_as_it_was(line, monkeypatch: pytest.MonkeyPatch) -> None:
    path = line()
    before = path.read_bytes()
    session = Session(path)
    asked = wish(session, extractor=PLAIN)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fdopen", full)
    with pytest.raises(OutputError, match="No space left"):
        session.save(asked)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir() if ".old" in file.name] == []
    session.save(asked)
    assert path.read_bytes() != before


def test_a_recipe_without_frames_is_refused_at_once(line) -> None:
    path = line()
    for file in (path.parent / "images").iterdir():
        file.unlink()
    with pytest.raises(DataError, match="there is no image here"):
        Session(path)


def test_what_is_packed_comes_out_again(rng: np.random.Generator) -> None:
    arrays = {
        "a": rng.normal(size=(3, 5)).astype(np.float32),
        "b": rng.integers(-9, 9, 7).astype(np.int16),
        "c": np.array([True, False, True]),
        "none": np.empty((0, 3), np.float32),
    }
    header, found = unpacked(packed({"x": float("nan"), "y": [1, {"ü": float("inf")}]}, arrays))
    assert header == {"x": None, "y": [1, {"ü": None}]}
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert np.array_equal(found[name], array)
        assert found[name].ctypes.data % 4 == 0


def test_uncertainties_are_drawn_when_they_are_wished_for(line) -> None:
    path = line()
    path.write_text(path.read_text("utf-8") + "draws: 20\n", "utf-8")
    session = Session(path)
    quick, drawn = (
        ask(session, wish(session).model_copy(update={"draws": wanted}))[0] for wanted in (False, True)
    )
    assert (quick["drawn"], drawn["drawn"]) == ("", "20 draws")
    recipe = Recipe.load(path)
    source = recipe.source.make()
    trace = Pipeline(recipe).trace(source.read(source.references(recipe.source_path)[0]))
    volume = trace.products[0].volume
    told = drawn["rows"][0]["volume"]["visible_mm3"]["std"]
    assert told is None if np.isnan(volume.visible_mm3.std) else told == volume.visible_mm3.std
    assert quick["rows"][0]["volume"]["visible_mm3"]["std"] is None


def test_files_beside_the_recipes_folder_are_not_read(line, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = line()
    session = Session(path)
    away = tmp_path_factory.mktemp("away")
    for name in ("p01", "p02"):
        cv2.imwrite(str(away / f"{name}.png"), np.zeros((8, 8), np.uint8))
    asked = wish(session)
    for key, value in (("path", str(away)), ("options.dark", f"{away}/{{id}}.png")):
        header, _ = ask(session, asked.model_copy(update={"source": {**asked.source, key: value}}))
        assert "neither in the recipe's folder" in header["faults"][0]["said"], key


def broken(*_: object) -> None:
    raise IndexError("off by one")


def test_a_sources_fault_is_told_and_does_not_end_the_page(line, monkeypatch: pytest.MonkeyPatch) -> None:
    path = line()
    session, open_session = Session(path), Session(path, debug=True)
    asked = wish(session, "p02")
    monkeypatch.setattr(ImageFiles, "read", broken)
    header, _ = ask(session, asked)
    assert "IndexError: off by one" in header["faults"][0]["said"]
    with pytest.raises(IndexError):
        open_session.answer(asked)


def test_a_stages_fault_is_told_on_its_card(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WindowTracking, "code", broken)
    header, arrays = ask(session, wish(session))
    assert "IndexError: off by one" in header["absent"]["coder"]
    assert "peaks.x_px" in arrays and "stripes.x_px" not in arrays


class Options(BaseModel):
    number_px: float = Field(default=2.0, gt=0.0, le=9.0, description="a number")
    count: int = Field(default=3, ge=1, description="a count")
    either: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(default="auto")
    maybe: float | None = Field(default=None, ge=0.0, lt=1.0)
    word: Literal["one", "two"] = "one"
    single: Literal["only"] = "only"
    yes: bool = False
    text: str = "as it is"
    file: Path | None = None
    region: tuple[int, int] | None = None
    several: float | str = 1.0
    needed: float


def test_each_kind_of_option_becomes_its_kind_of_field() -> None:
    fields = {field["name"]: field for field in fields_of(Options)}
    kinds = "number integer number number choice choice switch text file yaml yaml number"
    assert [field["kind"] for field in fields.values()] == kinds.split()

    def said(name: str, *keys: str) -> list[Any]:
        return [fields[name][key] for key in keys]

    assert said("number_px", "low", "low_open", "high", "high_open") == [0.0, True, 9.0, False]
    assert said("number_px", "unit", "default", "description") == ["px", 2.0, "a number"]
    assert said("count", "low", "high") == [1.0, None]
    assert said("either", "words", "high") == [["auto"], 255.0]
    assert said("maybe", "words", "high_open") == [[None], True]
    assert said("word", "choices", "words") == [["one", "two"], []]
    assert fields["single"]["choices"] == ["only"]
    assert fields["file"]["words"] == [None]
    assert [name for name, field in fields.items() if field["required"]] == ["needed"]
    assert "text" not in {field["name"] for field in fields_of(Options, ("text",))}


def test_every_option_of_every_stage_has_a_field_that_explains_itself() -> None:
    registry = discover()
    stages = [stage for stage in registry.stages if stage.entry.kind in KINDS]
    assert {stage.entry.kind for stage in stages} == set(KINDS)
    for stage in stages:
        options = registry.load(stage).Options
        fields = fields_of(options)
        assert [field["name"] for field in fields] == list(options.model_fields), stage
        for field in fields:
            assert len(field["description"]) > 10, stage
            assert None in (field["low"], field["high"]) or field["low"] < field["high"], stage


def test_a_scan_gives_what_a_run_gives(root: Path) -> None:
    """Its lines are frames of their own: none stands for another."""
    path = root / "recipes" / "belt_scan"
    header, arrays = ask(Session(path), TuneRequest())
    (row,) = header["rows"]
    run = next(api.Recipe.load(path, sets=["draws=0"]).run())
    assert run.volume is not None
    assert row["volume"]["visible_mm3"]["value"] == run.volume.visible_mm3.value
    assert header["image"] == {}
    assert (arrays["profiles.product"] > 0).sum() > 1000


def test_a_stage_that_the_file_leaves_to_its_default_is_named(root: Path) -> None:
    stages = {kind["kind"]: kind for kind in Session(root / "recipes" / "belt_scan").recipe()["stages"]}
    assert stages["assembler"]["chosen"] is None
    assert stages["assembler"]["default"] == "belt-motion"
    assert stages["extractor"]["default"] == ""
    assert stages["weigher"]["default"] == "", "none is none"


TEXT = """\
# what this is for
roemetry: 1
product:   "eel"      # odd blanks and quotes stay
source: {path: images, turn_deg: 90}   # one line

stages:
  # first of all
  extractor:
    use: dominant-peak   # the paper's
    options:
      threshold: 15      # grey levels
      start: lowest
  # between two stages
  coder: window-tracking   # short form
  weigher:
    use: density
    options: {density_g_per_cm3: 1.1}
sinks:
- csv     # a list at the key's own indent
- report
"""
BASE = parse(TEXT, "recipe.yaml").data


def changed(**paths: Any) -> Any:
    """Give the base with values set at paths whose steps are joined by two underscores."""
    data = copy.deepcopy(BASE)
    for path, value in paths.items():
        *steps, last = path.split("__")
        node = data
        for step in steps:
            node = node[step]
        if value is ...:
            del node[last]
        else:
            node[last] = value
    return data


def lines_that_differ(text: str) -> tuple[list[str], list[str]]:
    """Give the lines of the old text that are gone, and those of the new one that are new."""
    old, new = TEXT.splitlines(), text.splitlines()
    return [line for line in old if line not in new], [line for line in new if line not in old]


def test_nothing_wanted_changes_not_a_byte() -> None:
    assert edited(TEXT, "recipe.yaml", copy.deepcopy(BASE)) == TEXT


ODD = "      # odd blanks and quotes stay"
INDENT = "# a list at the key's own indent"
EXTRACTOR = "stages__extractor__options__"
WEIGHER = "    options: {density_g_per_cm3: 1.1}"
THRESHOLD = "threshold: 15      # grey levels"
CASES = {
    "a number": (
        {EXTRACTOR + "threshold": 22.5}, f"      {THRESHOLD}", f"      {THRESHOLD.replace('15', '22.5')}"
    ),
    "a value on one line": (
        {"source__turn_deg": 0},
        "source: {path: images, turn_deg: 90}   # one line",
        "source: {path: images, turn_deg: 0}   # one line",
    ),
    "a quoted word": ({"product": "a: b"}, f'product:   "eel"{ODD}', f'product:   "a: b"{ODD}'),
    "a new option behind the others": (
        {EXTRACTOR + "region": [0, 480, 0, 640]}, "", "      region: [0, 480, 0, 640]"
    ),
    "a new option within braces": (
        {"stages__weigher__options__density_std_g_per_cm3": 0.02},
        WEIGHER,
        "    options: {density_g_per_cm3: 1.1, density_std_g_per_cm3: 0.02}",
    ),
    "an option of a stage in its short form": (
        {"stages__coder": {"use": "window-tracking", "options": {"margin_min": 0.3}}},
        "  coder: window-tracking   # short form",
        "  coder: {use: window-tracking, options: {margin_min: 0.3}}   # short form",
    ),
    "an option taken away, nothing said of it": ({EXTRACTOR + "start": ...}, "      start: lowest", ""),
    "an option taken away with what was said of it": (
        {EXTRACTOR + "threshold": ...}, f"      {THRESHOLD}", f"      # {THRESHOLD}"
    ),
    "all options taken away": (
        {"stages__extractor": {"use": "steger"}},
        f"    use: dominant-peak   # the paper's\n    options:\n      {THRESHOLD}\n      start: lowest",
        f"    use: steger   # the paper's\n    # options:\n    #   {THRESHOLD}\n    #   start: lowest",
    ),
    "the only option within braces": ({"stages__weigher__options": {}}, WEIGHER, "    options: {}"),
    "a stage taken away": ({"stages__weigher": ...}, f"  weigher:\n    use: density\n{WEIGHER}", ""),
    "a list with comments in it": (
        {"sinks": ["csv"]},
        f"sinks:\n- csv     {INDENT}\n- report",
        f"{INDENT}\nsinks: [csv]",
    ),
    "a new key at the end": ({"draws": 200}, "", "draws: 200"),
}  # fmt: skip
"""What is wanted, the lines that go, and those that come."""


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_only_the_lines_that_are_wanted_change(case: tuple[dict[str, Any], str, str]) -> None:
    paths, gone, new = case
    wanted = changed(**paths)
    text = edited(TEXT, "recipe.yaml", wanted)
    assert parse(text, "recipe.yaml").data == wanted
    assert lines_that_differ(text) == (gone.splitlines(), new.splitlines())


def test_a_new_stage_stands_in_the_order_of_the_chain() -> None:
    stages = {**BASE["stages"]}
    after = {
        "extractor": stages.pop("extractor"),
        "coder": stages.pop("coder"),
        "smoother": "local-polynomial",
    }
    text = edited(TEXT, "recipe.yaml", {**BASE, "stages": after | stages})
    lines = text.splitlines()
    assert lines[lines.index("  smoother: local-polynomial") - 1] == "  coder: window-tracking   # short form"


def test_line_ends_of_another_system_stay() -> None:
    text = TEXT.replace("\n", "\r\n")
    wanted = changed(stages__extractor__options__threshold=22)
    assert edited(text, "r", wanted) == text.replace("threshold: 15 ", "threshold: 22 ")


@pytest.mark.parametrize(
    ("text", "wanted", "new"),
    [("a: 1", {"a": 1, "b": 2}, "a: 1\nb: 2\n"), ("a: 1\n", {"a": True}, "a: true\n")],
)
def test_a_text_without_a_last_line_end_can_grow_and_truth_is_not_one(text, wanted, new) -> None:
    assert edited(text, "r", wanted) == new


def test_differences_are_told_with_both_values() -> None:
    wanted = changed(stages__extractor__options__threshold=20, draws=5, sinks=...)
    assert differences(BASE, wanted) == [
        ("stages.extractor.options.threshold", "15", "20"),
        ("draws", "", "5"),
        ("sinks", "[csv, report]", ""),
    ]


WORDS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=12)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
) | WORDS
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.from_regex(r"[a-z_]{1,6}", fullmatch=True), inner, max_size=3)
    ),
    max_leaves=6,
)


@example("NULL")
@example(["~", "no", "1e3", "a: b"])
@settings(deadline=None, max_examples=60)
@given(VALUES)
def test_a_value_on_one_line_is_read_as_what_it_was(value: Any) -> None:
    assert parse(f"a: {inline(value)}\n", "r").data == {"a": value}
    if not isinstance(value, list | dict):
        assert value_of(inline(value)) == value, "a field reads what a recipe has"


@settings(deadline=None, max_examples=60)
@given(
    st.dictionaries(st.sampled_from(["extractor", "coder", "weigher", "volume"]), VALUES, max_size=4), VALUES
)
def test_any_wanted_values_come_out_and_full_lines_of_comment_stay(stages: Any, draws: Any) -> None:
    wanted = {**BASE, "stages": {"extractor": "x", **stages}, "draws": draws}
    text = edited(TEXT, "recipe.yaml", wanted)
    assert parse(text, "recipe.yaml").data == wanted
    for comment in ("# what this is for", "# odd blanks and quotes stay", "# one line", "# first of all"):
        assert comment in text
