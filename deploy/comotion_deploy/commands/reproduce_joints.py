"""``comotion dev reproduce joints``: joints between bodies, and a camera that moves."""

from dataclasses import dataclass
from pathlib import Path

from ..options import option, setting
from .experiments import Cached, Experiment, check_folder, known_parts, progress, write_report


@dataclass(kw_only=True)
class JointsStudy(Cached, Experiment):
    """Measure joints on poses, features and recordings, their cost, and a camera in a robot's hand."""

    epilog = """
Examples:
  comotion dev reproduce joints --quick
  comotion dev reproduce joints --seeds 1,3,5 --data recordings/mocap --out joints
  comotion dev reproduce joints --part poses --part free --json
"""

    part: list[str] | None = option(
        None,
        "poses, features, sparse, free, people, cost or hand; may be repeated. Default: all.",
        metavar="PART",
    )
    seeds: str | None = setting(None, "Seeds, e.g. 1,3 or 0-4. Default: 1,3,5, quick 1.")
    quick: bool = option(False, "One seed, ten of the poses, nothing that is rendered.")
    data: Path | None = option(None, "Folder of labelled .npz recordings of people.", metavar="DIR")
    out: Path = option(Path("joints"), "Where joints.md and joints.json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.joints import experiment as study
        from comotion_experiments.joints import report

        check_folder(self.out)
        most = [part for part in study.PARTS if not (self.quick and part in ("features", "sparse", "hand"))]
        chosen = known_parts(self.part, study.PARTS) or most
        seeds = parse_seeds(self.seeds or ("1" if self.quick else "1,3,5"))
        poses = 10 if self.quick else 50
        wanted = study.Experiment(chosen, seeds, poses, self.data, self.cache_folder("joints"))
        with progress() as note:
            results = study.run_experiment(wanted, progress=note)
        text = report.markdown(results)
        values, written = write_report(self.out, "joints", text, report.as_json(results))
        self.print_written(values, text, written)
