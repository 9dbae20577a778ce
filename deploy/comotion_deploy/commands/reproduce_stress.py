"""``comotion dev reproduce stress``: streams that are not clean, and how soon the methods get over it."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..options import option, setting
from .experiments import Experiment, check, progress


@dataclass(kw_only=True)
class Stress(Experiment):
    """How the methods get over restarts, covers, drift, rest and other trouble, on made-up scenes."""

    epilog = """
Examples:
  comotion dev reproduce stress --quick
  comotion dev reproduce stress --out docs/research
  comotion dev reproduce stress --family restart --family cover --seeds 0,2 --method comotion

A family's name also stands for all that begin with it: cover for cover_1s and cover_3s.
"""

    family: list[str] | None = option(
        None, "Family of scenes; may be repeated. Default: all.", metavar="NAME"
    )
    seeds: str | None = setting(
        None, "Seeds, e.g. 1,3 or 0-4. Default: 1,3,5,7,9, quick 1; even ones are for development."
    )
    method: list[str] | None = option(None, "comotion or thesis; may be repeated. Default: both.")
    quick: bool = option(False, "One seed, no runs of ten minutes.")
    jobs: int = option(2, "Processes at once.", min=1, max=256)
    out: Path = option(Path("stress"), "Where stress.md and images/stress.png go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from rich.console import Console

        from comotion_experiments import stress as study
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress import report

        check(self.out)
        seeds = parse_seeds(self.seeds) if self.seeds else study.REPORTED_SEEDS[: 1 if self.quick else None]
        unknown = [name for name in self.method or () if name not in study.METHODS]
        if unknown:
            raise UserError(f"method {unknown[0]!r} is none of {', '.join(study.METHODS)}")
        families = study.find_families(self.family or (), quick=self.quick)
        with progress() as note:
            results = study.run_experiment(
                families, seeds, methods=self.method or study.METHODS, jobs=self.jobs, progress=note
            )
        page, picture = self.out / "stress.md", self.out / "images" / "stress.png"
        picture.parent.mkdir(parents=True, exist_ok=True)
        report.save_picture(picture, results)
        page.write_text(report.markdown(results, "images/stress.png"))
        if self.json_:
            print(json.dumps(report.as_json(results), indent=2))
            return
        console = Console(width=max(170, Console().width))
        for drawn in report.tables(results):
            console.print(drawn)
        print(f"written: {page}, {picture}")
