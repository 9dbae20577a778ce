"""``comotion dev reproduce regions``: dense regions of an image from labelled features."""

from dataclasses import dataclass
from pathlib import Path

from ..errors import require_dense
from ..fusion_options import Fusion
from ..options import option, setting
from .experiments import Experiment, check_folder, progress, write_report


@dataclass(kw_only=True)
class Regions(Fusion, Experiment):
    """Measure how well dense regions cover the true objects of the workcell (IoU)."""

    epilog = """
Examples:
  comotion dev reproduce regions --quick
  comotion dev reproduce regions --seeds 1,3,5 --workcell shelf --out regions
"""

    workcell: list[str] | None = option(
        None, "Workcell scene; may be repeated. Default: shelf, truck, arm.", metavar="SCENE"
    )
    seeds: str | None = setting(None, "Seeds, e.g. 1,3 or 0-4. Default: 0-4, quick 0.")
    quick: bool = option(False, "One seed, 6 s of each scene.")
    out: Path = option(Path("regions"), "Where regions.md and regions.json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        require_dense()
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.regions import experiment as study
        from comotion_experiments.regions import report

        check_folder(self.out)
        config = self.fusion_config()
        seeds = parse_seeds(self.seeds or ("0" if self.quick else "0-4"))
        duration = 6.0 if self.quick else None
        with progress() as note:
            results = study.run_experiment(
                self.workcell or study.SCENES, seeds, config, duration=duration, progress=note
            )
        text = report.markdown(results)
        values, written = write_report(self.out, "regions", text, report.as_json(results))
        self.print_written(values, text, written)
