"""``python -m benchmarks NAME``: what the documentation states, measured again."""

from __future__ import annotations

import importlib
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, before numpy is imported

BENCHMARKS = {
    "calibrate_images": "heights of pinhole-plane and block-linear from simulated images, against the truth",
    "calibrate_points": "spread of repeated calibrations of simulated points over what they state",
    "calibrate_real": "calibration from real boards with a laser line, and from a real chessboard",
    "coding": "share labelled, wrong and refused of every coder, where it breaks, its time",
    "coding_ablation": "the coder `planes` without each of its rules in turn, on two makers' scenes",
    "extract": "precision, speed and bias of extractors against the physical bound and against peers",
    "extract_real": "the same on real camera images: matches, reflections, a line across a printed board",
    "faults": "disturbed images: held, outside the stated interval, refused",
    "frame": "time from an array to a measurement, by stage",
    "fuzz": "damaged recipes, rigs, calibrations, records and images: crashes, hangs, floods",
    "geometry": "displacement and height of one stripe, and the linear model beside it",
    "spoil": "calibrations spoiled on purpose, real and rendered: refused, told, or slipped through",
    "startup": "time of `roemetry --help` over that of a two-command Typer program",
    "golden": "what every shipped recipe says, against the committed records; --write keeps it",
    "outside": "rigs of another renderer, from files to grades, against their truth",
    "patterns": "grids on rendered images, and lines, a grid and dots at equal light, against their truth",
    "dots": "dots on drawn and rendered images: centres, labels, heights, volumes, against their truth",
    "kills": "two runs in one folder, killed over and over: rows lost or doubled",
    "known_numbers": "what the shipped recipe gives on three skeins, written for `roemetry doctor`",
    "cluster": "a cluster whose scheduler and client are killed; throughput over the number of workers",
    "million": "a record of a million rows: time and memory of its table, report and questions",
    "line": "a whole line on loopback: frame to receiver, lost frames, memory; rows after kills",
    "make_rigs": "fresh rigs with truth, drawn at random and rendered by either simulator",
    "pieces": "numbers without a calibration on traced skeins and shapes: refused, and wrong",
    "products": "a recipe on simulated products against their truth: labels, volume, weight, grades",
    "real": "everything in real camera images against what is known there, with overlays",
    "rooms": "the drawing of the rooms in the architecture page, made from the imports",
    "report_picture": "the picture of README: the report's first panels on one shipped skein",
    "grade": "classifiers on unseen skeins and rigs; fits the model beside the recipe",
    "paper_experiment": "the paper's Table 1 and Figures 17 to 22 again, on six skeins and on 500",
    "paper_figures": "Figures 7 and 9 of the paper, from any image",
    "sorting": "wrong sorting near a limit under any options: at most what the guard band promises",
    "scans": "belt scans: motion, volumes, faults, formats, time, memory, on simulated rigs",
    "weight": "weight from 20 weighed samples: error, interval, width, against paper × one factor",
    "wheelset": "broken stripes of a real image without calibration: what order can number, against a hand",
    "studies": "intervals of gauge studies, and instruments accepted and refused, on simulated ones",
    "tune": "time from a moved slider of `roemetry tune` to the answer, and the picture of the page",
    "uncertainty": "linearised standard uncertainties over Monte Carlo draws, on unseen traced skeins",
    "volume": "error of every volume estimator on simulated skeins, and the page of it",
}


def main() -> int:
    """Run the benchmark that the command line names."""
    if len(sys.argv) < 2 or sys.argv[1] not in BENCHMARKS:
        print("python -m benchmarks NAME [options]")
        for name, what in BENCHMARKS.items():
            print(f"  {name:14} {what}")
        return 2
    name = sys.argv.pop(1)
    sys.argv[0] = f"python -m benchmarks {name}"
    importlib.import_module(f"benchmarks.{name}").main()
    return 0


if __name__ == "__main__":
    sys.exit(main())
