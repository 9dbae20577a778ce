"""``comotion dev reproduce accuracy, ablation, stress, pixels``: methods on made-up and recorded scenes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from comotion_deploy.commands.experiments import progress, write_values
from comotion_deploy.errors import UserError
from comotion_deploy.options import Json, Tool, option, setting


class Experiment(Json, Tool):
    """What all experiments have in common: a folder for their results, and how these are printed."""

    log_level = "warning"
    out: Path = option(Path(), "Where its page and its values (.json) go.", metavar="DIR", file_okay=False)

    def report(self, name: str, text: str, values: object) -> None:
        """Write the page of an experiment, in Markdown, and its values, as JSON, and show it."""
        page, numbers = (self.out / f"{name}.{suffix}" for suffix in ("md", "json"))
        self.out.mkdir(parents=True, exist_ok=True)
        page.write_text(text, encoding="utf-8")
        write_values(numbers, values)
        self.show(values, text, f"written: {page}, {numbers}", width=170)


class Study(Experiment):
    """Options of what runs in processes of its own."""

    jobs: int = option(2, "Processes at once.", min=1, max=256)

    def rows(self, run: Callable[..., Any], *how: Any) -> list[dict[str, Any]]:
        """Run every case under every setting and seed, and say on standard error how far it is."""
        from comotion_experiments.study import run_study

        with progress() as note:
            return run_study(run, *how, jobs=self.jobs, progress=note)


def _chosen(names: list[str] | None, every: Sequence[str], what: str) -> Sequence[str]:
    """The names that are given, or all; an error where there is no such name."""
    for name in names or ():
        if name not in every:
            raise UserError(f"no {what} {name!r}; one of {', '.join(every)}")
    return names or every


class Accuracy(Study):
    """Compare the accuracy of the default method and the thesis method on scenes and recordings."""

    epilog = """
Examples:
  comotion dev reproduce accuracy --data recordings/mocap --out docs/research
  comotion dev reproduce accuracy --quick
"""
    out = Path("accuracy")

    data: Path | None = option(None, "Folder of labelled .npz recordings. Default: none.", metavar="DIR")
    seeds: str | None = setting(None, "Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.")
    quick: bool = option(False, "One seed, the scenes of the thesis.")
    part: list[str] | None = option(None, "scores or motion; may be repeated. Default: both.", metavar="PART")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments import accuracy
        from comotion_experiments.inputs import parse_seeds

        parts = _chosen(self.part, accuracy.PARTS, "part")
        chosen = accuracy.scene_cases() + ([] if self.quick else accuracy.displaced_cases())
        chosen = [case for case in chosen if not self.quick or case.group == accuracy.THESIS_SCENES]
        chosen += accuracy.recorded_cases(self.data) if self.data is not None else []
        seeds = parse_seeds(self.seeds or ("0" if self.quick else "0-4"))
        results: dict[str, Any] = {"seeds": seeds}
        if "scores" in parts:
            results["rows"] = self.rows(accuracy.run_method, chosen, accuracy.METHODS, seeds)
        if "motion" in parts:
            with progress() as note:
                note("pose and twist")
                results["motion"] = accuracy.motion_errors(seeds)
        self.report("accuracy", accuracy.markdown(results), results)


class OnFamilies(Study):
    """Options of what runs on stress families."""

    family: list[str] | None = option(
        None, "Stress family, or how several begin; may be repeated. Default: all.", metavar="NAME"
    )


class Ablation(OnFamilies):
    """Leave out each rule of the default method alone, on stress families and recordings."""

    epilog = """
Examples:
  comotion dev reproduce ablation --data recordings/mocap --out docs/research
  comotion dev reproduce ablation --rule place --rule sliding --family sliding --seeds 0,2
  comotion dev reproduce ablation --rule looseness=0.5 --rule looseness=2   # a parameter
"""
    out = Path("ablation")

    rule: list[str] | None = option(
        None, "Rule to leave out, or PARAMETER=VALUE; may be repeated. Default: each rule.", metavar="NAME"
    )
    seeds: str = setting("1,3", "Seeds, e.g. 1,3 or 0-4.")
    data: list[Path] | None = option(None, "Folder of labelled recordings; may be repeated.", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.ablation import RULES, WHOLE, markdown, rule_of, run_without
        from comotion_experiments.accuracy import recorded_cases
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress.study import find_families

        rules = self.rule or list(RULES)
        for rule in rules:
            rule_of(rule)
        cases: list[Any] = [*find_families(self.family or ())]
        seeds, recorded = parse_seeds(self.seeds), map(recorded_cases, self.data or ())
        cases += [case for of_folder in recorded for case in of_folder]
        rows = self.rows(run_without, cases, [WHOLE, *rules], seeds)
        self.report("ablation", markdown(rows), {"rows": rows})


class Stress(OnFamilies):
    """How the methods get over restarts, covers, drift, rest and other trouble, on made-up scenes."""

    epilog = """
Examples:
  comotion dev reproduce stress --quick
  comotion dev reproduce stress --out docs/research
  comotion dev reproduce stress --family restart --family cover --seeds 0,2 --method comotion

A family's name also stands for all that begin with it: cover for cover_1s and cover_3s.
"""
    out = Path("stress")

    seeds: str | None = setting(
        None, "Seeds, e.g. 1,3 or 0-4. Default: 1,3,5,7,9, quick 1; even ones are for development."
    )
    method: list[str] | None = option(None, "comotion or thesis; may be repeated. Default: both.")
    quick: bool = option(False, "One seed.")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.stress import study as stress

        seeds = parse_seeds(self.seeds) if self.seeds else stress.REPORTED_SEEDS[: 1 if self.quick else None]
        methods = _chosen(self.method, stress.METHODS, "method")
        families = stress.find_families(self.family or ())
        rows = self.rows(stress.run_method, families, methods, seeds)
        self.report("stress", stress.markdown(rows), {"rows": rows})


class Pixels(Study):
    """Score the grouping of image features on labelled recordings."""

    epilog = """
Examples:
  comotion dev reproduce pixels --data recordings --out pixels

The folder has one or more of hopkins155/, kt3dmoseg/, mtpv/ and video/ikeasmall01.npz.
"""
    out = Path("pixels")

    data: Path = option(..., "Folder of the recordings.", env="COMOTION_DATA", metavar="DIR")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.pixels.benchmark import SETTINGS, markdown, run_sequence
        from comotion_experiments.pixels.sequences import find_sequences

        rows = self.rows(run_sequence, find_sequences(self.data), SETTINGS, [0])
        self.report("pixels", markdown(rows), {"rows": rows})


class Carried(Study):
    """Score the grouping of image features on made-up scenes before a camera in the hand."""

    epilog = """
Examples:
  comotion dev reproduce carried --seeds 10-13
  comotion dev reproduce carried --kind hand --seeds 10
"""
    out = Path("carried")

    kind: list[str] | None = option(None, "How the camera is carried; may be repeated. Default: all.")
    seeds: str = option("10-13", "Seeds; those below 10 are for development.")

    def run(self) -> None:
        """Run it and write the report."""
        from comotion_experiments.inputs import parse_seeds
        from comotion_experiments.pixels.carried import KINDS, markdown, run_kind

        names = _chosen(self.kind, [kind.name for kind in KINDS], "kind")
        kinds, seeds = [kind for kind in KINDS if kind.name in names], parse_seeds(self.seeds)
        rows = self.rows(run_kind, kinds, ["comotion"], seeds)
        self.report("carried", markdown(rows), {"rows": rows})
