"""``comotion dev reproduce accuracy``: the default method and the thesis method compared."""

from dataclasses import dataclass
from pathlib import Path

from ..options import Tool, option, setting
from .experiments import check, known_parts, progress


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
