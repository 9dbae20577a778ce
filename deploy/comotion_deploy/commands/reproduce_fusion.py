"""``comotion dev reproduce fusion``: the gain of fusing cameras and robot joints."""

from dataclasses import dataclass
from pathlib import Path

from ..fusion_options import Fusion
from ..options import option, setting
from .experiments import Cached, Experiment, check, write_report


@dataclass(kw_only=True)
class FusionStudy(Cached, Fusion, Experiment):
    """Measure the gain of fusing cameras and robot joints, with camera A open and covered."""

    epilog = """
Examples:
  comotion dev reproduce fusion --quick
  comotion dev reproduce fusion --seeds 0-4 --out fusion
  comotion dev reproduce fusion --workcell shelf --method thesis --set thesis.sigma_switch=0.04 --json
"""
    log_level = "info"

    workcell: list[str] | None = option(
        None, "Workcell scene; may be repeated. Default: the four.", metavar="SCENE"
    )
    seeds: str | None = setting(None, "Seeds, e.g. 0-4 or 0,3. Default: 0-4, quick 0-1.")
    quick: bool = option(False, "Small images, short runs, two scenes, two seeds.")
    period: float = option(1 / 3, "s between updates.", min=0.05, max=10)
    out: Path = option(Path("fusion"), "Where fusion.md, .png and .json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.fusion import QUICK, SCENES, Setup, report, run_experiment
        from comotion_experiments.inputs import parse_seeds

        check(self.out)
        results = run_experiment(
            self.workcell or (SCENES[:2] if self.quick else SCENES),
            parse_seeds(self.seeds or ("0-1" if self.quick else "0-4")),
            self.fusion_config(),
            setup=QUICK if self.quick else Setup(),
            cache=self.cache_folder("fusion"),
            period=self.period,
        )
        self.out.mkdir(parents=True, exist_ok=True)
        picture = self.out / "fusion.png"
        report.save_picture(picture, results)
        text = report.markdown(results, "fusion.png")
        values, written = write_report(self.out, "fusion", text, report.as_json(results))
        self.print_table(values, 110, report.table(results), *report.lines(results), f"{written}, {picture}")
