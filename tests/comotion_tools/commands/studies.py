"""``comotion dev reproduce accuracy, ablation, stress, pixels``: methods on made-up and recorded scenes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from comotion_deploy.commands.experiments import progress, write_values
from comotion_deploy.errors import UserError
from comotion_deploy.options import Json, Tool, option, setting

Pictures = Mapping[str, Callable[[Path], object]]


class Experiment(Json, Tool):
    """What all experiments have in common: a folder for their results, and how these are printed."""

    log_level = "warning"
    out: Path

    def report(
        self, name: str, text: str, values: object, *shown: object, pictures: Pictures | None = None
    ) -> None:
        """Write the page of an experiment, its values and its pictures, and show it.

        Parameters
        ----------
        name
            Name of page and values, without a suffix.
        text
            The page, in Markdown.
        values
            What the JSON file holds.
        shown
            Tables and lines for the terminal; the page itself by default.
        pictures
            What draws each picture, by its path in the folder.
        """
        drawn = pictures or {}
        page, numbers, *images = (self.out / file for file in (f"{name}.md", f"{name}.json", *drawn))
        for path in (page, *images):
            path.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(text, encoding="utf-8")
        write_values(numbers, values)
        for path, draw in zip(images, drawn.values(), strict=True):
            draw(path)
        written = ", ".join(map(str, (page, numbers, *images)))
        self.show(values, *(shown or (text,)), f"written: {written}", width=170)


def _known(asked: list[str] | None, names: list[str], what: str) -> list[str]:
    """What is asked for, or all; an error where there is no such name."""
    for one in asked or ():
        if one not in names:
            raise UserError(f"no {what} {one!r}; one of {', '.join(names)}")
    return asked or names


class Accuracy(Experiment):
    """Compare the accuracy of the default method and the thesis method on scenes and recordings."""

    epilog = """
Examples:
  comotion dev reproduce accuracy --data recordings/mocap --out docs/research
  comotion dev reproduce accuracy --quick
  comotion dev reproduce accuracy --part comparator --data recordings/mocap   # Brox and Malik's affinity
"""

    data: Path | None = option(None, "Folder of labelled .npz recordings. Default: none.", metavar="DIR")
    seeds: str | None = setting(None, "Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.")
    quick: bool = option(False, "One seed, the scenes of the thesis, as --no-robustness.")
    robustness: bool = option(True, "Halve and double every parameter too.")
    part: list[str] | None = option(
        None, "scores, comparator, motion or robustness; may be repeated. Default: all.", metavar="PART"
    )
    out: Path = option(
        Path("accuracy"), "Where accuracy.md, accuracy.json and a picture go.", metavar="DIR", file_okay=False
    )

    def run(self) -> None:
        """Run it and write the report."""
        import matplotlib  # noqa: F401 - before hours of work

        from comotion_experiments import accuracy as study
        from comotion_experiments.accuracy import report
        from comotion_experiments.inputs import parse_seeds

        robust = self.robustness and not self.quick
        most = [part for part in study.PARTS if part != "robustness" or robust]
        parts = _known(self.part, list(study.PARTS), "part") if self.part else most
        cases = study.scene_cases()
        if self.quick:
            cases = [case for case in cases if case.group == "thesis scenes"]
        else:
            cases += study.displaced_cases()
        cases += study.recorded_cases(self.data) if self.data is not None else []
        seeds = parse_seeds(self.seeds or ("0" if self.quick else "0-4"))
        with progress() as note:
            results = study.run_experiment(cases, seeds, parts, note)
        picture = "images/reliability.png"
        drawn = {picture: lambda path: report.save_reliability(path, results)} if "scores" in parts else {}
        self.report("accuracy", report.markdown(results, picture), report.as_json(results), pictures=drawn)


@dataclass(kw_only=True)
class OnFamilies:
    """Options of what runs on stress families."""

    family: list[str] | None = option(
        None, "Stress family, or how several begin; may be repeated. Default: all.", metavar="NAME"
    )
    jobs: int = option(2, "Processes at once.", min=1, max=256)


class Ablation(OnFamilies, Experiment):
    """Leave out each rule of the default method alone, on stress families and recordings."""

    epilog = """
Examples:
  comotion dev reproduce ablation --data recordings/mocap --out docs/research
  comotion dev reproduce ablation --rule stay --rule sliding --family sliding --seeds 0,2
"""

    rule: list[str] | None = option(
        None, "Rule to leave out; may be repeated. Default: each.", metavar="NAME"
    )
    seeds: str = setting("1,3", "Seeds, e.g. 1,3 or 0-4.")
    data: list[Path] | None = option(None, "Folder of labelled recordings; may be repeated.", metavar="DIR")
    out: Path = option(
        Path("ablation"), "Where ablation.md and ablation.json go.", metavar="DIR", file_okay=False
    )

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.ablation import RULES, as_json, markdown, run_experiment
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress import find_families

        rules = _known(self.rule, list(RULES), "rule")
        chosen = find_families(self.family or (), quick=not self.family)
        families = [family.name for family in chosen if not family.of_images]
        with progress() as note:
            results = run_experiment(
                rules, families, parse_seeds(self.seeds), self.data or (), jobs=self.jobs, progress=note
            )
        self.report("ablation", markdown(results), as_json(results))


class Stress(OnFamilies, Experiment):
    """How the methods get over restarts, covers, drift, rest and other trouble, on made-up scenes."""

    epilog = """
Examples:
  comotion dev reproduce stress --quick
  comotion dev reproduce stress --out docs/research
  comotion dev reproduce stress --family restart --family cover --seeds 0,2 --method comotion

A family's name also stands for all that begin with it: cover for cover_1s and cover_3s.
"""

    seeds: str | None = setting(
        None, "Seeds, e.g. 1,3 or 0-4. Default: 1,3,5,7,9, quick 1; even ones are for development."
    )
    method: list[str] | None = option(None, "comotion or thesis; may be repeated. Default: both.")
    quick: bool = option(False, "One seed, no runs of ten minutes.")
    trace: bool = option(False, "Print the NMI of every update too.")
    out: Path = option(
        Path("stress"), "Where stress.md, stress.json and a picture go.", metavar="DIR", file_okay=False
    )

    def run(self) -> None:
        """Run it and write the report."""
        import matplotlib  # noqa: F401 - before hours of work

        from comotion_experiments import stress as study
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress import report

        seeds = parse_seeds(self.seeds) if self.seeds else study.REPORTED_SEEDS[: 1 if self.quick else None]
        methods = _known(self.method, list(study.METHODS), "method")
        families = study.find_families(self.family or (), quick=self.quick)
        with progress() as note:
            results = study.run_experiment(families, seeds, methods=methods, jobs=self.jobs, progress=note)
        picture = "images/stress.png"
        text = report.markdown(results, picture)
        drawn = {picture: lambda path: report.save_picture(path, results)}
        shown = [*report.tables(results), *([report.traces(results)] if self.trace else [])]
        self.report("stress", text, report.as_json(results), *shown, pictures=drawn)


class Pixels(Experiment):
    """Score the grouping of image features on labelled recordings."""

    epilog = """
Examples:
  comotion dev reproduce pixels --data recordings --out pixels

The folder has one or more of hopkins155/, kt3dmoseg/, mtpv/ and video/ikeasmall01.npz.
"""

    data: Path = option(..., "Folder of the recordings.", env="COMOTION_DATA", metavar="DIR")
    out: Path = option(Path("pixels"), "Where pixels.md and pixels.json go.", metavar="DIR", file_okay=False)

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments import pixels as study

        with progress() as note:
            scores = study.run_benchmark(study.find_data_sets(self.data), note)
        shown = study.table(scores), *study.lines(scores)
        self.report("pixels", study.markdown(scores), scores, *shown)
