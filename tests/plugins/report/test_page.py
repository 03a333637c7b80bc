"""The page of a report: what it shows of a run, in words, and how sure each row of a stripe is."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from roemetry.errors import OutputError
from roemetry.records import Decision, Estimate, Grade, Reason, Shares, StripeMap, Trace, Volume, Weight
from roemetry_report import sink, words
from roemetry_report.overview import CLASSES, classes_of, decision_pill, row_of, trust
from roemetry_report.sink import Report, ReportOptions

NASTY = "run & <script>alert(\"1\")</script> 'x'"


class Page:
    """What a reader sees of the page: its words, the cells of the table by product; and all ids."""

    def __init__(self, text: str) -> None:
        shown = re.sub(r"<(script|style)>.*?</\1>", "", text, flags=re.S)
        self.ids = re.findall(r'\sid="([^"]+)"', text)
        self.words = _words(shown)
        self.sections = text.count('<section class="acquisition"')
        self.rows: dict[str, list[str]] = {}
        for row in re.findall(r'<tr role="row" class=.*?</tr>', shown, re.S):
            cells = [_words(cell).strip() for cell in re.findall(r"<t[hd] .*?</t[hd]>", row, re.S)]
            self.rows[cells[0]] = cells


def _words(markup: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", markup))


def written(run, **options) -> str:
    (path,) = Report(ReportOptions(**options)).write(run)
    assert path == run.folder / "report.html"
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def mixed(synthetic, tmp_path_factory):
    """One of each kind: good, deformed, two products with a nasty id, failed, empty."""
    s = synthetic
    scenes = [
        s.Scene("skein_01"),
        s.Scene("skein_02", (s.Dome(dent_mm=6.0),), label="henkei", ambiguous=((5, 180, 210),), seed=2),
        s.Scene(NASTY, (s.Dome(165, 200, 120, 90), s.Dome(480, 290, 125, 100, 12)), gaps=(), seed=3),
    ]
    rows = [row for scene in scenes for row in s.measurements_of(scene)]
    rows[1:1] = [s.failed("cut<off>.png"), s.empty("belt")]
    run = s.run_of(tmp_path_factory.mktemp("mixed"), rows, {scene.id: s.trace_of(scene) for scene in scenes})
    return rows, written(run)


def test_the_page_is_whole_needs_no_network_and_takes_names_for_text(mixed):
    _, text = mixed
    page = Page(text)
    assert text.startswith("<!DOCTYPE html>")
    assert not re.search(r"https?://|@import|url\((?!#)", text)
    assert all(address.startswith(("#", "data:")) for address in re.findall(r'(?:src|href)="([^"]*)"', text))
    assert len(page.ids) == len(set(page.ids))
    assert set(re.findall(r'href="#([^"]*)"', text) + re.findall(r"url\(#([^)]+)\)", text)) <= set(page.ids)
    assert "<script>alert" not in text
    assert NASTY in page.words
    assert text.count("<script>") == 1
    assert "&lt;wbr" not in text
    drawings = [ElementTree.fromstring(part) for part in re.findall(r"<svg.*?</svg>", text, re.S)]
    assert len(drawings) > 30
    assert all(one.get("aria-hidden") == "true" or one.get("aria-label") for one in drawings)
    sections = text.split('<section class="acquisition"')[1:]
    assert len(sections) == 5
    assert max(len(part.encode()) for part in sections) < 250_000


def test_every_measurement_has_a_row_with_its_reason(mixed):
    rows, text = mixed
    page = Page(text)
    assert {row.id for row in rows} == set(page.rows)
    assert "failed" in page.rows["cut<off>.png#0"][3]
    assert "truncated at byte 1024" in page.rows["cut<off>.png#0"][-1]
    assert "empty" in page.rows["belt#0"][3]
    assert "every stripe lies on the belt" in page.rows["belt#0"][-1]
    assert "henkei" in page.rows["skein_02#1"][2]


def test_what_holds_for_every_product_is_said_once_and_no_uncertainty_is_invented(mixed):
    (row, *_), text = mixed
    values = (row.weight.mass_g.value, row.volume.visible_mm3.value / 1000, row.height_max_mm.value)
    texts = (f"{value:.{digits}f}" for value, digits in zip(values, (1, 2, 1), strict=True))
    assert Page(text).rows["skein_01#1"][4:7] == [f"{text} not stated" for text in texts]
    above = text[: text.index("<table")]
    assert "Holds for every measured product" in above
    assert "model-error-not-stated" in above
    assert "model-error-not-stated" not in text[text.index("<table") : text.index("</table>")]


def test_stated_uncertainty_is_printed_and_sets_the_places(synthetic, tmp_path):
    scene = synthetic.Scene("a")
    (row,) = synthetic.measurements_of(scene)
    row = replace(
        row,
        volume=replace(row.volume, visible_mm3=Estimate(20123.4, 456.7)),
        weight=Weight(Estimate(22.136, 0.512)),
        height_max_mm=Estimate(17.3772, 0.0221),
    )
    cells = Page(written(synthetic.run_of(tmp_path, [row], {}))).rows["a#1"]
    weight = cells.index("22.14 ± 0.51")
    assert cells[weight + 1 : weight + 3] == ["20.12 ± 0.46", "17.377 ± 0.022"]


@pytest.mark.parametrize(
    ("possible", "main"),
    [
        (("large", "medium"), "large: too close"),
        (("medium", "small"), "medium: kept"),
        (("small",), "medium: kept"),  # a last class without limits has no reason of its own
        ((), "on the whole row"),
    ],
)
def test_the_main_reason_is_why_a_product_is_sorted_so(synthetic, possible, main):
    asked = (Reason("class-open", "large: too close to the limit"), Reason("class-proven", "medium: kept"))
    (row,) = synthetic.measurements_of(synthetic.Scene("a"))
    decision = Decision("any", "", possible, asked)
    row = replace(row, grade=None, reasons=(Reason("side", "on the whole row"),), decision=decision)
    assert row_of(row)["main"][0].text.startswith(main)


def test_two_products_share_their_pictures(mixed):
    text = mixed[1]
    section = next(part for part in text.split('<section class="acquisition"') if "2 products" in part)
    assert section.count("data:image/jpeg") == 1
    assert re.findall(r"<b>\((\w)\)</b>", section) == list("abcdefghfgh"), "no letter is left out"


def test_what_cannot_be_shown_costs_only_the_pictures(synthetic, tmp_path):
    rows = [*synthetic.measurements_of(synthetic.Scene("a")), synthetic.failed("b"), synthetic.failed("c")]
    peaks = replace(synthetic.trace_of(synthetic.Scene("c")), stripes=None, profiles=None, products=())
    traces = {"b": Trace("b", absent={"source": rows[1].reasons[0]}), "c": peaks}
    text = written(synthetic.run_of(tmp_path, rows, traces))
    page = Page(text)
    assert "a: the image is gone" in page.words
    assert "No pictures. the file is truncated" in page.words
    assert set(page.rows) == {"a#1", "b#0", "c#0"}
    assert re.findall(r"<b>\((\w)\)</b>", text) == list("aabc"), "slices of `a`; `c` ends after the peaks"
    assert re.search(r'href="#a\d-peaks"', text)


def test_uncalibrated_is_said_on_top_and_pixels_are_what_is_given(synthetic, tmp_path):
    scene = synthetic.Scene("weld", calibrated=False, turn_deg=90, colour=True)
    rows = synthetic.measurements_of(scene)
    run = synthetic.run_of(
        tmp_path, rows, {"weld": synthetic.trace_of(scene)}, provenance=synthetic.UNCALIBRATED
    )
    text = written(run)
    page = Page(text)
    assert "Uncalibrated: results are in pixels" in page.words
    assert "turned by 90°" in page.words
    assert re.findall(r"<b>\((\w)\)</b>", text) == ["a", "b", "c", "d", "e"]
    assert f"{rows[0].coding.displacement_max_px:.1f}" in page.rows["weld#1"]
    assert "Weight" not in page.words


@pytest.mark.parametrize("provenance", [{}, {"plugins": None, "resolved_recipe": None, "started": "noon"}])
def test_provenance_may_lack_anything(synthetic, tmp_path, provenance):
    rows = synthetic.measurements_of(synthetic.Scene("a"))
    page = Page(written(synthetic.run_of(tmp_path, rows, {}, provenance=provenance)))
    assert "Uncalibrated" not in page.words, "there are millimetres in the record"


def test_nothing_but_nan_is_a_page_too(synthetic, tmp_path):
    nan, why = math.nan, (Reason("not-seen", "nothing of it was seen"),)
    (row,) = synthetic.measurements_of(synthetic.Scene("a"))
    row = replace(
        row,
        height_max_mm=Estimate(nan),
        volume=Volume(
            Estimate(nan), Estimate(nan), Shares(nan, nan, nan), [0, 1], [nan, nan], [nan, nan], why
        ),
        weight=Weight(Estimate(nan), why),
        grade=Grade("unknown", features={"radius_px": nan}),
        coding=replace(row.coding, saturated_share=nan, displacement_max_px=nan, peaks=0, labelled=0),
    )
    trace = synthetic.trace_of(synthetic.Scene("a"))
    cells = Page(written(synthetic.run_of(tmp_path, [row], {"a": trace}))).rows["a#1"]
    assert cells[2:8] == ["? unknown", "● measured", "–", "–", "–", "–"]


def test_pictures_are_capped_and_the_worst_are_shown_besides(synthetic, tmp_path):
    (good,) = synthetic.measurements_of(synthetic.Scene("x"))
    rows = [replace(good, id=f"p{i}#1", acquisition=f"p{i}") for i in range(30)]
    rows[20] = synthetic.failed("p20")
    rows[25] = replace(rows[25], coding=replace(good.coding, ambiguous=3000))
    replayed = []

    def replay(name):
        replayed.append(name)
        return synthetic.trace_of(synthetic.Scene(name))

    page = Page(written(synthetic.run_of(tmp_path, rows, replay), products_max=3, worst_max=2))
    assert replayed == ["p0", "p1", "p2", "p20", "p25"]
    assert page.sections == 5
    assert len(page.rows) == 30
    assert "5 products of 30 shown with pictures" in page.words


@pytest.mark.parametrize(("many", "shown", "listed"), [(5, 0, 5), (600, 1, 500)])
def test_long_runs_get_a_table_that_opens(synthetic, tmp_path, many, shown, listed):
    rows = [synthetic.failed(f"p{i}") for i in range(many)]
    page = Page(written(synthetic.run_of(tmp_path, rows, {}), products_max=shown, worst_max=0))
    assert (page.sections, len(page.rows)) == (shown, listed)
    assert ("first 500 of 600 rows" in page.words) == (many > 500)


def test_a_long_run_tells_its_spread_its_reasons_and_an_example_of_each_kind(synthetic, tmp_path):
    (good,) = synthetic.measurements_of(synthetic.Scene("x"))
    rng = np.random.default_rng(5)
    rows = [
        replace(
            good,
            id=f"p{i}#1",
            acquisition=f"p{i}",
            height_max_mm=Estimate(float(rng.normal(20.0, 0.1)) if i != 77 else 30.0),
            grade=Grade("henkei" if i == 150 else "good"),
        )
        for i in range(200)
    ]
    rows[120] = synthetic.failed("p120")
    page = Page(written(synthetic.run_of(tmp_path, rows, {}), products_max=6, worst_max=0))
    assert "Largest height, mm: median 20.0" in page.words
    assert "robust standard deviations from the median, the farthest p77#1 (30.0)" in page.words
    for said in ("an example of grade henkei", "an example of failed", "What is said of the products"):
        assert said in page.words
    assert page.sections == 6


def test_a_page_is_cut_to_what_can_be_opened(synthetic, tmp_path, monkeypatch):
    rows = [synthetic.failed(f"p{i}") for i in range(40)]
    whole = written(synthetic.run_of(tmp_path, rows, {}), products_max=40, worst_max=0)
    monkeypatch.setattr(sink, "_PAGE_MAX", len(whole) - 5_000)
    text = written(synthetic.run_of(tmp_path, rows, {}), products_max=40, worst_max=0)
    assert len(text) <= len(whole) - 5_000
    assert 0 < Page(text).sections < 40
    assert len(Page(text).rows) == 40
    assert "--product ID" in text


def test_a_replay_that_gives_another_volume_is_told(synthetic, tmp_path):
    scene = synthetic.Scene("a")
    (row,) = synthetic.measurements_of(scene)
    other = replace(row, volume=replace(row.volume, visible_mm3=Estimate(1.0)))
    trace = {"a": synthetic.trace_of(scene)}
    said = "gives another volume now"
    assert said in written(synthetic.run_of(tmp_path, [other], trace))
    assert said not in written(synthetic.run_of(tmp_path, [row], trace))


def test_a_folder_that_is_gone_is_one_clear_error(synthetic, tmp_path):
    run = synthetic.run_of(tmp_path / "gone", [], {})
    with pytest.raises(OutputError, match=r"report\.html"):
        Report().write(run)


def stripes_of(margin: np.ndarray, product: np.ndarray, *, ambiguous=None, bridged=None) -> StripeMap:
    """Give a map whose points are where the margin is not −1."""
    there = margin != -1.0
    nothing = np.full(margin.shape, np.nan)
    seen = there if bridged is None else there & ~bridged
    return StripeMap(
        x_px=np.where(there, 10.0, np.nan),
        x_std_px=nothing,
        product=np.where(there, product, -1).astype(np.int16),
        seen=seen,
        margin=np.where(there, margin, np.nan),
        ambiguous=np.zeros(margin.shape, bool) if ambiguous is None else ambiguous,
        rest_px=nothing,
        peak_stripe=np.full(3, -2, np.int16),
    )


@pytest.fixture
def drawn():
    margin = np.full((2, 30), 1.0)
    margin[0, 10:14], margin[0, 14:20], margin[1, 5:8] = 0.35, 0.6, -1.0
    product = np.zeros((2, 30))
    product[0, 8:22] = 1
    ambiguous = np.zeros((2, 30), bool)
    ambiguous[1, 6] = True
    return trust(stripes_of(margin, product, ambiguous=ambiguous))


def cells(drawing: str) -> dict[int, tuple[str, float]]:
    """Give class and height of each row of a band, and hold it to covering no row twice."""
    found: dict[int, tuple[str, float]] = {}
    for path in ElementTree.fromstring(drawing).iter():
        if not path.tag.endswith("path"):
            continue
        for x, y, width, height in re.findall(r"M(\d+) ([\d.]+)h(\d+)v([\d.]+)", path.get("d")):
            assert float(y) * 2 + float(height) == pytest.approx(10.0)
            for row in range(int(x), int(x) + int(width)):
                assert row not in found
                found[row] = path.get("class"), float(height)
    return found


def test_each_point_has_its_class_the_product_stands_out_and_the_first_strip_is_its_worst(drawn) -> None:
    assert [strip.name for strip in drawn.strips] == ["least", "1", "2"]
    least, first, second = (cells(strip.drawing) for strip in drawn.strips)
    assert sorted(first) == list(range(30))
    assert first[9] == ("t-sure", 10.0)
    assert first[10] == ("t-poor", 10.0)
    assert first[14] == ("t-weak", 10.0)
    assert first[2] == first[25] == ("t-sure", 5.0)
    assert not {5, 7} & set(second), "what is not seen is empty"
    assert second[6] == ("t-refused", 10.0)
    assert sorted(least) == [6, *range(8, 22)]
    assert [least[row][0] for row in (6, 8, 10, 15, 21)] == [
        "t-refused",
        "t-sure",
        "t-poor",
        "t-weak",
        "t-sure",
    ]


def test_doubt_says_what_it_is_when_it_is_pointed_at(drawn) -> None:
    titles = re.findall("<title>(.*?)</title>", drawn.strips[1].drawing)
    assert titles == ["rows 10 to 13: margin from 0.35", "rows 14 to 19: margin from 0.60"]
    assert "least on a product: 0.35, stripe 1, row 10; 29 % of its points" in drawn.notes[0]
    assert drawn.notes[1] == "3 peaks of the image refused as ambiguous"


def test_classes_hold_their_own_limits() -> None:
    margin = np.array([[1.0, 0.9, 0.89, 0.7, 0.5, 0.3, 0.29, 0.0]])
    kinds = classes_of(stripes_of(margin, np.ones(margin.shape)))[0]
    names = [CLASSES[kind][0] for kind in kinds]
    assert names == ["sure", "sure", "fair", "fair", "weak", "poor", "least", "least"]


def test_what_has_no_margin_has_no_strip() -> None:
    margin = np.full((2, 5), np.nan)
    margin[1] = -1.0
    assert trust(stripes_of(margin, np.zeros(margin.shape))) is None
    margin, bridged = np.full((1, 9), 0.95), np.zeros((1, 9), bool)
    bridged[0, 4] = True
    drawing = trust(stripes_of(margin, np.ones(margin.shape), bridged=bridged)).strips[1].drawing
    assert sorted(cells(drawing)) == [0, 1, 2, 3, 5, 6, 7, 8]


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1.005, 1, "1.0"), (-2.25, 1, "−2.2"), (-0.001, 1, "0.0"), (math.nan, 1, "–")],
)
def test_plain_numbers(value, digits, text):
    assert words.plain(value, digits) == text


@pytest.mark.parametrize(
    ("estimate", "value", "std"),
    [
        (Estimate(20.6412), "20.64", "not stated"),
        (Estimate(20.6412, 0.0312), "20.641", "0.031"),
        (Estimate(2064.12, 31.2), "2\u202f064", "31"),
        (Estimate(20.64, 0.0), "20.64", "0.00"),
        (Estimate(math.nan, math.nan), "–", "not stated"),
    ],
)
def test_a_value_is_written_to_the_place_its_uncertainty_supports(estimate, value, std):
    assert (words.value(estimate), words.uncertainty(estimate)) == (value, std)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0, "0 %"),
        (1, "100 %"),
        (0.0004, "<0.1 %"),
        (0.0213, "2.1 %"),
        (0.9921, "99.2 %"),
        (0.9999, ">99.9 %"),
    ],
)
def test_shares(share, text):
    assert words.percent(share) == text


@pytest.mark.parametrize(
    ("decision", "words", "tone"),
    [
        (Decision("large", "belt 1", ("large",)), "large", "plain"),
        (Decision("undecided", "", ("large", "small")), "undecided: large or small", "warn"),
        (Decision("undecided", "", ()), "undecided: fits no class", "warn"),
    ],
)
def test_a_decision_is_said_in_words(decision: Decision, words: str, tone: str) -> None:
    pill = decision_pill(decision)
    assert (pill.words, pill.tone) == (words, tone)
