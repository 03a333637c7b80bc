from __future__ import annotations

import math

import pytest

from roemetry.html.plots import when
from roemetry.records import Decision, Estimate
from roemetry_report import words
from roemetry_report.overview import decision_pill


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
        (0.5, "50 %"),
        (0.9921, "99.2 %"),
        (0.9999, ">99.9 %"),
    ],
)
def test_shares(share, text):
    assert words.percent(share) == text


def test_times():
    assert when("2025-11-21T05:50:03+00:00") == "21 November 2025, 05:50 UTC"
    assert when("noon") == "noon"
    assert when(None) == ""


def test_a_long_name_breaks_at_its_joints_and_stays_escaped():
    assert words.breakable("line_2/roe-01.png#1") == "line_<wbr>2/<wbr>roe-<wbr>01.<wbr>png<wbr>#1"
    assert words.breakable("a<b>&'#1") == "a&lt;b&gt;&amp;&#39;<wbr>#1"


def test_a_long_sentence_is_cut_at_its_first_clause():
    assert words.clause("short; and sweet") == "short; and sweet"
    long = "1 of 57 arcs is concave, none with a radius between 4 and 80 px; " + "the sharpest of them " * 5
    assert words.clause(long) == "1 of 57 arcs is concave, none with a radius between 4 and 80 px …"
    assert len(words.clause("word " * 60)) < 110


def test_a_feature_carries_its_unit():
    assert words.feature("radius_min_px", 45.371) == ("radius min (px)", "45.37")
    assert words.feature("arcs", 12.0) == ("arcs", "12")


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
