"""``comotion dev reproduce fusion, links, regions, joints``: what cameras and robots see of the workcell."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..fusion_options import Fusion
from ..options import option, setting
from .experiments import Cached, Experiment, OnWorkcell, check, check_folder, known_parts, progress


@dataclass(kw_only=True)
class FusionStudy(OnWorkcell, Cached, Fusion, Experiment):
    """Measure the gain of fusing cameras and robot joints, with camera A open and covered."""

    epilog = """
Examples:
  comotion dev reproduce fusion --quick
  comotion dev reproduce fusion --seeds 0-4 --out fusion
  comotion dev reproduce fusion --workcell shelf --method thesis --set thesis.sigma_switch=0.04 --json
"""
    seeds: str | None = setting(None, "Seeds, e.g. 0-4 or 0,3. Default: 0-4, quick 0-1.")
    quick: bool = option(False, "Small images, short runs, two scenes, two seeds.")
    period: float = option(1 / 3, "s between updates.", min=0.05, max=10)
    out: Path = option(Path("fusion"), "Where fusion.md, .png and .json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.fusion import QUICK, SCENES, Setup, report, run_experiment
        from comotion_experiments.inputs import parse_seeds

        check(self.out)
        scenes = self.workcell or (SCENES[:2] if self.quick else SCENES)
        seeds = parse_seeds(self.seeds or ("0-1" if self.quick else "0-4"))
        setup, cache = QUICK if self.quick else Setup(), self.cache_folder("fusion")
        with progress() as note:
            results = run_experiment(
                scenes,
                seeds,
                self.fusion_config(),
                setup=setup,
                cache=cache,
                period=self.period,
                progress=note,
            )
        text, shown = report.markdown(results, "fusion.png"), (report.table(results), *report.lines(results))
        drawn = {"fusion.png": lambda path: report.save_picture(path, results)}
        self.report("fusion", text, report.as_json(results), *shown, pictures=drawn)


@dataclass(kw_only=True)
class Links(OnWorkcell, Cached, Fusion, Experiment):
    """Measure the gain of linking hypotheses of a camera without depth to bodies of a depth camera."""

    epilog = """
Examples:
  comotion dev reproduce links --quick
  comotion dev reproduce links --seeds 2-6 --out links
  comotion dev reproduce links --workcell shelf --turned 2 --json
"""

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
        how: dict[str, Any] = {"setup": setup, "cache": cache}
        with progress() as note:
            results = study.run_experiment(
                scenes, seeds, config, **how, period=self.period, turned=self.turned, progress=note
            )
        of = scenes[0], seeds[0], config
        drawn = {"links.jpg": lambda path: study.save_picture(path, *of, **how)}
        text, values = report.markdown(results), report.as_json(results)
        self.report("links", text, values, report.table(results), pictures=drawn)


@dataclass(kw_only=True)
class Regions(OnWorkcell, Fusion, Experiment):
    """Measure how well dense regions cover the true objects of the workcell (IoU)."""

    epilog = """
Examples:
  comotion dev reproduce regions --quick
  comotion dev reproduce regions --seeds 1,3,5 --workcell shelf --out regions
"""

    seeds: str | None = setting(None, "Seeds, e.g. 1,3 or 0-4. Default: 0-4, quick 0.")
    quick: bool = option(False, "One seed, 6 s of each scene.")
    out: Path = option(Path("regions"), "Where regions.md and regions.json go.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
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
        self.report("regions", report.markdown(results), report.as_json(results))


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
        self.report("joints", report.markdown(results), report.as_json(results))
