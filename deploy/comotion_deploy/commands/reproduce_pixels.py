"""``comotion dev reproduce pixels``: grouping of image features on labelled recordings."""

from dataclasses import dataclass
from pathlib import Path

from ..options import option
from .experiments import Experiment, check_folder, progress, write_report


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
