"""``comotion dev reproduce accuracy, ablation, stress, pixels``: methods on made-up and recorded scenes."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..options import Tool, option, setting
from .experiments import Experiment, check, check_folder, known_parts, progress, write_report


@dataclass(kw_only=True)
class Accuracy(Tool):
    """Compare the accuracy of the default method and the thesis method on scenes and recordings."""

    epilog = """
Examples:
  comotion dev reproduce accuracy --data recordings/mocap --out docs/research
  comotion dev reproduce accuracy --quick
  comotion dev reproduce accuracy --part comparator --data recordings/mocap   # Brox and Malik's affinity
"""
    log_level = "warning"

    data: Path | None = option(None, "Folder of labelled .npz recordings. Default: none.", metavar="DIR")
    seeds: str | None = setting(None, "Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.")
    quick: bool = option(False, "One seed, the scenes of the thesis, as --no-robustness.")
    robustness: bool = option(True, "Halve and double every parameter too.")
    part: list[str] | None = option(
        None, "scores, comparator, motion or robustness; may be repeated. Default: all.", metavar="PART"
    )
    out: Path = option(Path("accuracy"), "Where accuracy.md and its picture go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments import accuracy as study
        from comotion_experiments.accuracy import report
        from comotion_experiments.inputs import parse_seeds

        check(self.out)
        robust = self.robustness and not self.quick
        most = [part for part in study.PARTS if part != "robustness" or robust]
        parts = known_parts(self.part, study.PARTS) or most
        cases = study.scene_cases()
        if self.quick:
            cases = [case for case in cases if case.group == "thesis scenes"]
        else:
            cases += study.displaced_cases()
        cases += study.recorded_cases(self.data) if self.data is not None else []
        seeds = parse_seeds(self.seeds or ("0" if self.quick else "0-4"))
        with progress() as note:
            results = study.run_experiment(study.Experiment(cases, seeds, parts), progress=note)
        self.out.mkdir(parents=True, exist_ok=True)
        if "scores" in parts:
            (self.out / "images").mkdir(exist_ok=True)
            report.save_reliability(self.out / "images" / "reliability.png", results)
        page = self.out / "accuracy.md"
        page.write_text(report.markdown(results, "images/reliability.png"))
        print(f"written: {page}")


@dataclass(kw_only=True)
class Ablation(Experiment):
    """Leave out each rule of the default method alone, on stress families and recordings."""

    epilog = """
Examples:
  comotion reproduce ablation --data recordings/mocap --out docs/research
  comotion reproduce ablation --rule stay --rule sliding --family sliding --seeds 0,2

A family's name also stands for all that begin with it.
"""

    rule: list[str] | None = option(
        None, "Rule to leave out; may be repeated. Default: each.", metavar="NAME"
    )
    family: list[str] | None = option(None, "Stress family; may be repeated. Default: all.", metavar="NAME")
    seeds: str = setting("1,3", "Seeds, e.g. 1,3 or 0-4.")
    data: list[Path] | None = option(None, "Folder of labelled recordings; may be repeated.", metavar="DIR")
    jobs: int = option(2, "Processes at once.", min=1, max=256)
    out: Path = option(Path("ablation"), "Where ablation.md and ablation.json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.ablation import report
        from comotion_experiments.ablation.experiment import run_experiment
        from comotion_experiments.ablation.rules import RULES
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress import FAMILIES, find_families

        check_folder(self.out)
        rules = known_parts(self.rule, list(RULES)) or list(RULES)
        chosen = find_families(self.family or (), quick=not self.family)
        families = [family.name for family in chosen if family.name in FAMILIES]
        seeds = parse_seeds(self.seeds)
        with progress() as note:
            results = run_experiment(rules, families, seeds, self.data or (), jobs=self.jobs, progress=note)
        text = report.markdown(results)
        values, written = write_report(self.out, "ablation", text, report.as_json(results))
        self.print_written(values, text, written)


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


@dataclass(kw_only=True)
class Pixels(Experiment):
    """Score the grouping of image features on labelled recordings, with baselines that know K."""

    epilog = """
Examples:
  comotion dev reproduce pixels --data recordings --out pixels
  comotion dev reproduce pixels --data recordings --no-baselines --json

The folder has one or more of hopkins155/, kt3dmoseg/, mtpv/ and video/ikeasmall01.npz.
"""

    data: Path = option(..., "Folder of the recordings.", env="COMOTION_DATA", metavar="DIR")
    quick: bool = option(False, "As --no-baselines --no-cross-validate.")
    out: Path = option(Path("pixels"), "Where pixels.md and pixels.json go.", metavar="DIR")
    baselines: bool = option(True, "Run the baselines too.")
    cross_validate: bool = option(True, "Cross-validate over scenes too.")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.pixels import find_data_sets, report, run_benchmark

        check_folder(self.out)
        with progress() as note:
            scores = run_benchmark(
                find_data_sets(self.data),
                baselines=self.baselines and not self.quick,
                cross_validate=self.cross_validate and not self.quick,
                progress=note,
            )
        values, written = write_report(self.out, "pixels", report.markdown(scores), scores.as_json())
        self.print_table(values, 130, report.table(scores), *report.lines(scores), written)
