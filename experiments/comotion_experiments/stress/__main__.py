"""``python -m comotion_experiments.stress``: a subset, fast, for development."""

import argparse
import json
from pathlib import Path

from rich.console import Console

from ..inputs import parse_seeds
from . import report
from .catalogue import ALL, find_families
from .experiment import METHODS, Outcome, run_experiment


def main() -> None:
    """Run families, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, epilog=f"families: {', '.join(ALL)}")
    parser.add_argument("--family", default="", help="names or beginnings of names, by commas; default: all")
    parser.add_argument("--seeds", default="0,2")
    parser.add_argument("--method", default="comotion", help=f"of {', '.join(METHODS)}, by commas")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="without the runs of ten minutes")
    parser.add_argument("--trace", action="store_true", help="NMI of every update too")
    parser.add_argument("--json", type=Path, metavar="FILE")
    chosen = parser.parse_args()
    console, notes = Console(width=180), Console(stderr=True)
    results = run_experiment(
        find_families([name for name in chosen.family.split(",") if name], quick=chosen.quick),
        parse_seeds(chosen.seeds),
        methods=chosen.method.split(","),
        jobs=chosen.jobs,
        progress=lambda what: notes.print(what, highlight=False),
    )
    for drawn in report.tables(results):
        console.print(drawn)
    for outcome in results.outcomes if chosen.trace else ():
        _print_traces(console, outcome)
    if chosen.json:
        chosen.json.write_text(json.dumps(report.as_json(results), indent=1) + "\n")


def _print_traces(console: Console, outcome: Outcome) -> None:
    for number, trace in enumerate(outcome.traces):
        console.print(
            f"{outcome.family}, {outcome.method}, seed {outcome.seed}, scene {number}: t NMI/apart K"
        )
        cells = [
            f"{t:6.2f} {nmi:.2f}/{together:.2f} {count:2d}"
            for t, nmi, together, count in zip(
                trace.seconds, trace.nmi, trace.nmi_apart, trace.hypotheses, strict=True
            )
        ]
        for begin in range(0, len(cells), 8):
            console.print("  " + " | ".join(cells[begin : begin + 8]), highlight=False)


if __name__ == "__main__":
    main()
