"""``comotion dev reproduce ablation``: what each rule of the default method is worth."""

from dataclasses import dataclass
from pathlib import Path

from ..options import option, setting
from .experiments import Experiment, check_folder, known_parts, progress, write_report


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
