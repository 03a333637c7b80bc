"""A decision as the report says it."""

from __future__ import annotations

import pytest

from roemetry.records import Decision
from roemetry_report.overview import decision_pill


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
