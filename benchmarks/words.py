"""The fuzzy rules of recipes/herring_roe/by_words.yaml on rendered skeins, each on a rig of its own.

``python -m benchmarks words [--first 90000] [--count 60] [--cache DIR]``

Both images of a skein are rendered (10 s and more), and kept. Its points and its outline are found in them;
nothing is taken from the truth but the calibration.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.grading.judges import GOOD
from benchmarks.grading.words import confusion, share
from benchmarks.traced.tables import NAMED
from benchmarks.volume_scenes import HERRING_ROE, exact_skein, images, measured
from roemetry import Recipe
from roemetry.errors import RoemetryError
from roemetry_tools.compare.agreement import wilson

UNKNOWN = "unknown"


def main() -> None:
    """Print what is called what."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=90000, help="seed of the first skein and rig")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-volume")
    given = parser.parse_args()
    classifier = Recipe.load(HERRING_ROE / "by_words.yaml").stages["classifier"].make()
    found: Counter[tuple[str, str]] = Counter()
    refused = 0
    for seed in range(given.first, given.first + given.count):
        one = exact_skein(seed)
        try:
            product = measured(*images(seed, given.cache), one.product.calibration, "plain")
        except RoemetryError:
            refused += 1
            continue
        found[NAMED[one.defect], classifier.classify(product).label] += 1
    print(f"{found.total()} skeins measured, {refused} refused, seeds from {given.first}\n")
    for words, part, whole in (
        ("named right", _count(found, lambda is_, said: is_ == said), found.total()),
        ("good kept", found[GOOD, GOOD], _count(found, lambda is_, _: is_ == GOOD)),
        (
            "deformed caught",
            _count(found, lambda is_, said: is_ != GOOD and said not in (GOOD, UNKNOWN)),
            _count(found, lambda is_, _: is_ != GOOD),
        ),
    ):
        ends = wilson(part, whole)
        print(f"{words}: {share(part, whole)} ({100 * ends.low:.0f} to {100 * ends.high:.0f} %)")
    print("\n" + confusion(found, [*dict.fromkeys(NAMED.values()), UNKNOWN], "is \\ called"))


def _count(found: Counter[tuple[str, str]], which: Callable[[str, str], bool]) -> int:
    return sum(n for pair, n in found.items() if which(*pair))


if __name__ == "__main__":
    main()
