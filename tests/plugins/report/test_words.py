from __future__ import annotations

import math

import pytest

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
