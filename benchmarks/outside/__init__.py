"""Rigs that another renderer made, taken from files to grades as a user would, against their truth.

``python -m benchmarks outside [FOLDER ...] [--draws 50] [--rigs D E] [--jobs 1] [--cluster ADDRESS]
[--extractors NAMES] [--chains NAMES] [--out FOLDER]``, and
``--again outside.json [outside.json ...] --out FOLDER``, which measures nothing and writes the page of
several runs.

A folder is a rig folder (with a ``truth.json``) or a folder of rig folders; left out: the one that
``ROEMETRY_RENDERED_DATA`` names, else ``../shared/rendered``. Each rig is copied into a temporary folder, the
shipped classifier beside it, and then: ``boards.yaml`` and ``block_rig.yaml`` are calibrated, the bodies are
measured by ``with_outline.yaml``, by ``laser_outline.yaml``, by the former without any outline, and by
``recipes/herring_roe/recipe.yaml`` on the block's calibration. Where the boards' calibration is refused, the
recipes get one made from the truth, and the table says so.

What the words of the table mean:

**Crossing**: a row of the image, a stripe, and the exact column where that stripe's plane meets a
surface that is lit and seen. Scored are those whose neighbours in the row above and below lie on the
same surface (an edge pixel has truth and hardly any light) and that are 3 px from the image's left and
right border.

**Peaks**: *found* is a scored crossing with a peak within 2 px, *missed* one without; *false* is a peak
with no crossing, scored or not, within 3 px of its row. Errors are against the geometric centre: light
that scatters in tissue moves the real peak, which is counted as error. *stated/observed* is the root
mean square of the stated standard uncertainties over that of the errors.

**Labels**: of the scored crossings on a body that have a peak within 3 px, *right* are those whose peak
carries their number; *refused* those whose peak carries none; *wrong* those whose peak carries another
and has no crossing of the stripe it names nearer than all others (two stripes that share one peak are
`shared` in the JSON). Other solutions of a row (``extra_*``) can be what a peak shows, but
are not scored. *All peaks* asks the other way round, of every labelled peak, belt and edges included: *wrong*
is one within 3 px of crossings, none of which is of the stripe it names, in its row or the two above and
below; *stray* is one that is near no crossing at all; *at rims* are those whose stripe crosses within
3 px in a row beside it only: light reaches over the exact edge.

**Calibration**: heights of exact crossings of levels over the calibrated range and all the image, lifted
by the calibration, minus the level. *real/stated* is the root mean square of error over stated
uncertainty.

**Volume**: *visible* is against ``topview_volume_mm3``, *true* against ``volume_mm3`` (not used where
the mesh is not watertight); a body in several parts counts by its largest. **Grade**: right is the
body's kind (for rules that know one word for all defects, that word), and `unknown` for a body that is no
skein; `unknown` for a skein is counted apart.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import time
import traceback
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.command import add_sharing, parser_of
from benchmarks.outside.reading import RigError, read_rig, rig_folders
from benchmarks.outside.scoring import CHAINS, score_rig
from benchmarks.outside.table import tables
from roemetry.cli.options import executor_of
from roemetry.run.executors import Lost

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "ROEMETRY_RENDERED_DATA"
CLASSIFIER = ROOT / "recipes" / "herring_roe" / "classifier.json"


def main() -> None:
    """Score every rig, print the table, and write it with its numbers."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", type=Path, nargs="*", metavar="FOLDER")
    parser.add_argument("--draws", type=int, help="Monte Carlo draws; left out: linearised uncertainties")
    parser.add_argument("--rigs", nargs="+", help="only the rig folders of these names")
    add_sharing(parser)
    parser.add_argument("--extractors", nargs="*", default=["maximum-likelihood", "gaussian"])
    parser.add_argument("--chains", nargs="+", default=list(CHAINS), choices=CHAINS)
    parser.add_argument("--out", type=Path, help="folder for outside.json and outside.md")
    parser.add_argument(
        "--again", type=Path, nargs="+", help="results of earlier runs: only the page is made"
    )
    given = parser.parse_args()
    if given.again:
        told = [json.loads(path.read_text("utf-8")) for path in given.again]
        results = [_numbers(rig) for one in told for rig in one["rigs"]]
        _write(results, told[0]["draws"], given.out)
        return
    default = Path(os.environ.get(VARIABLE, ROOT.parent / "shared" / "rendered"))
    folders = rig_folders(given.folders or [default])
    if given.rigs:
        folders = [folder for folder in folders if folder.resolve().name in given.rigs]
    if not folders:
        raise SystemExit(f"no rig folder in {', '.join(map(str, given.folders or [default]))}")
    begin = time.monotonic()
    asked = (_scored, given.draws, given.extractors, given.chains)
    executor = executor_of(given.cluster, given.jobs)
    results = [
        {"rig": one.task.name, "fault": one.why} if isinstance(one, Lost) else one
        for one in executor.in_order(partial, asked, [folder.absolute() for folder in folders])
    ]
    _write(results, given.draws, given.out)
    print(f"{time.monotonic() - begin:.0f} s")


def page(results: list[dict[str, Any]], draws: int | None) -> str:
    """Write the tables as Markdown."""
    words = (__doc__ or "").partition("What the words of the table mean:")[2].strip().replace("``", "`")
    asked = "" if draws is None else f" --draws {draws}"
    parts = [
        "# Rendered rigs against their truth",
        f"Made by `python -m benchmarks outside{asked}` from the files of each rig: boards and "
        "block calibrated, bodies measured, everything held against the truth. The rigs come from "
        "renderers that share no line with the simulator the methods were developed on, or from fresh "
        "seeds; they are not part of the repository (`--help` says where they are looked for).",
        *(str(table) for table in tables(results)),
        f"## What the words mean\n\n{words}",
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _write(results: list[dict[str, Any]], draws: int | None, folder: Path | None) -> None:
    text = page(results, draws)
    print(text.partition("## What the words mean")[0])
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        content = {"draws": draws, "rigs": _plain(results)}
        (folder / "outside.json").write_text(json.dumps(content) + "\n", encoding="utf-8")
        (folder / "outside.md").write_text(text, encoding="utf-8")


def _scored(draws: int | None, extractors: list[str], chains: list[str], folder: Path) -> dict[str, Any]:
    try:
        rig = read_rig(folder)
        with tempfile.TemporaryDirectory(prefix="roemetry-outside-") as made:
            copy = Path(made) / "rig"
            shutil.copytree(
                folder, copy, ignore=shutil.ignore_patterns("truth", "results", "calibration.yaml")
            )
            for path in (copy, *copy.rglob("*")):
                path.chmod(path.stat().st_mode | 0o200)  # the originals may be read-only
            shutil.copy(CLASSIFIER, Path(made) / "classifier.json")
            return score_rig(rig, copy, draws, extractors, chains)
    except (RigError, OSError) as fault:
        return {"rig": folder.name, "fault": str(fault)}
    except Exception as error:  # a fault of the program: told with its traceback, and the other rigs go on
        traceback.print_exc()
        return {"rig": folder.name, "fault": f"the program failed: {type(error).__name__}: {error}"}


def _plain(value: Any) -> Any:
    """Give numbers that are none as null: JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _numbers(value: Any, key: str = "") -> Any:
    """Undo `_plain`: null stands for no number, but where it means that nothing was said."""
    if isinstance(value, dict):
        return {name: _numbers(one, name) for name, one in value.items()}
    if isinstance(value, list):
        return [_numbers(one) for one in value]
    return math.nan if value is None and key not in ("said", "holds") else value
