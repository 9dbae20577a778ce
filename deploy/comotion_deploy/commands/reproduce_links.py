"""``comotion dev reproduce links``: the gain of linking a camera without depth to bodies in 3-D."""

from dataclasses import dataclass
from pathlib import Path

from ..fusion_options import Fusion
from ..options import option, setting
from .experiments import Cached, Experiment, check_folder, progress, write_report


@dataclass(kw_only=True)
class Links(Cached, Fusion, Experiment):
    """Measure the gain of linking hypotheses of a camera without depth to bodies of a depth camera."""

    epilog = """
Examples:
  comotion dev reproduce links --quick
  comotion dev reproduce links --seeds 2-6 --out links
  comotion dev reproduce links --workcell shelf --turned 2 --json
"""

    workcell: list[str] | None = option(
        None, "Workcell scene; may be repeated. Default: six of them.", metavar="SCENE"
    )
    seeds: str | None = setting(None, "Seeds, e.g. 2-4 or 2,5. Default: 2-4, quick 2.")
    quick: bool = option(False, "Small images, short runs, one seed.")
    period: float = option(1 / 3, "s between updates.", min=0.05, max=10)
    turned: float = option(0.0, "Error of the calibration.", metavar="DEGREES", min=-180, max=180)
    out: Path = option(Path("links"), "Where links.md, links.json and links.jpg go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments import links as study
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.links import report

        check_folder(self.out)
        scenes = self.workcell or study.SCENES
        seeds = parse_seeds(self.seeds or ("2" if self.quick else "2-4"))
        config = self.fusion_config()
        setup, cache = study.QUICK if self.quick else None, self.cache_folder("links")
        with progress() as note:
            results = study.run_experiment(
                scenes,
                seeds,
                config,
                setup=setup,
                cache=cache,
                period=self.period,
                turned=self.turned,
                progress=note,
            )
        values, written = write_report(self.out, "links", report.markdown(results), report.as_json(results))
        study.save_picture(self.out / "links.jpg", scenes[0], seeds[0], config, setup=setup, cache=cache)
        self.print_table(values, 170, report.table(results), written)
