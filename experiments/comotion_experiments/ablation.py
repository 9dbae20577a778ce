"""Ablation: each rule of the default method in metric spaces left out alone, and what that costs."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion.rigid.kernels.resampling import resample

from .accuracy.cases import PERIOD, recorded_cases
from .offline import run_offline
from .processes import Progress, quiet, run_all
from .stress import run_family
from .tables import Table, document, mean, number

WHOLE = "whole"
"""Stands for the method with all its rules."""
SCATTER = 0.003
"""NMI; changes below it are those of chance."""
_SHOWN = 2


@dataclass(frozen=True)
class Rule:
    """A rule, term or group of constants.

    Attributes
    ----------
    what
        What is left out, in a line.
    changes
        By "module.attribute", within ``comotion.rigid``: what stands there instead. No constants of kernels,
        which are compiled in.
    parameters
        Parameters of the group `rigid` that switch it off.
    """

    what: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def config(self) -> FusionConfig:
        """The parameters without the rule."""
        return FusionConfig.model_validate({"rigid": dict(self.parameters)})

    @contextmanager
    def left_out(self) -> Iterator[None]:
        """Leave the rule out in this process for as long as the context lasts."""
        places = []
        for path, value in self.changes.items():
            name, attribute = path.rsplit(".", 1)
            module = import_module(f"comotion.rigid.{name}")
            places.append((module, attribute, getattr(module, attribute)))
            setattr(module, attribute, value)
        try:
            yield
        finally:
            for module, attribute, value in places:
                setattr(module, attribute, value)


def _only_white(_tracks: Any, _y: Any, _w: Any, owner: Any, tolerance: Any, *_: Any) -> Any:
    return tolerance, np.tile([1.0, 0.0, 0.0], (len(owner), 1))


def _free(_middle: Any, _place: Any, _turn: Any, moving: Any, *_: Any) -> tuple[int, float]:
    return int(np.count_nonzero(moving)), 0.0


def _with_errors(observations: Any, stamps: Any, limits: Any, variance: Any, *out: Any) -> None:
    resample(observations, stamps, limits, np.full_like(variance, np.inf), *out)


RULES: dict[str, Rule] = {
    "gross": Rule("gross errors are left out", {"resampling.resample": _with_errors}),
    "contact": Rule("slack of what rests and is touched", parameters={"rigidity_contact": 0.0}),
    "past_evidence": Rule(
        "price of leaving a separate hypothesis",
        {"selection.past_evidence": lambda scene, owners, *_: np.zeros((len(scene.before), len(owners)))},
    ),
    "clear_members": Rule(
        "price of leaving for clear members",
        {"method.carried_costs": lambda scene, owners, *_: np.zeros((len(scene.before), len(owners)))},
    ),
    "stay": Rule("preference to stay", parameters={"stay": 0.0}),
    "membership": Rule("price of memberships", parameters={"membership_price": 0.0}),
    "slow_noise": Rule("slow noise", {"resampling._with_slow_noise": _only_white}),
    "looseness": Rule("deformation of bodies", parameters={"looseness": 0.0}),
    "contradiction": Rule("nats that speak against a body", {"belief._CONTRARY": 0.0}),
    "supported": Rule(
        "in large scenes, a body is worth its price by its own trajectories",
        {"method.supported": lambda _scene, owners, *_: list(range(len(owners)))},
    ),
    "uncovered": Rule("more than an outlier where a body has no pose", {"costs._UNCOVERED_SHARE": 0.5}),
    "place": Rule("spatial prior", parameters={"prior_weight": 0.0}),
    "sliding": Rule(
        "features that slide",
        {"costs.with_sliders": lambda _f, _b, body, *_: (body, np.zeros(body.shape, np.bool_))},
    ),
    "arrivals": Rule("newborn amid newborn wait", {"method.undecided": lambda _scene, labels: labels}),
    "paths": Rule("smooth paths between rests", {"rest.smooth_poses": _free}),
    "settled": Rule(
        "one pose for each rest, smooth paths", {"method.settled": lambda _frames, body, _config: body}
    ),
}
"""By name."""


@dataclass(frozen=True)
class Run:
    """One run: the rule that was left out, the scene, its seed (0 for a recording), and the mean NMI."""

    rule: str
    scene: str
    seed: int
    recorded: bool
    nmi: float


@dataclass
class Results:
    """All runs, and the seeds of families."""

    seeds: Sequence[int]
    runs: list[Run] = field(default_factory=list)

    def means(self, rule: str, *, recorded: bool) -> dict[str, float]:
        """Mean NMI of each scene, or of each recording, without a rule."""
        scores: dict[str, list[float]] = {}
        for run in self.runs:
            if (run.rule, run.recorded) == (rule, recorded):
                scores.setdefault(run.scene, []).append(run.nmi)
        return {scene: float(np.mean(values)) for scene, values in sorted(scores.items())}


def run_experiment(
    rules: Sequence[str],
    families: Sequence[str],
    seeds: Sequence[int],
    folders: Sequence[Path] = (),
    *,
    jobs: int = 2,
    progress: Progress = quiet,
) -> Results:
    """Run families and recordings with all rules, and without each of `rules`.

    Parameters
    ----------
    rules, families, seeds
        Names of :data:`RULES`, of stress families, and seeds of their scenes.
    folders
        Folders of labelled recordings.
    jobs
        Processes at once.
    progress
        Called with one line for each run that is done.
    """
    paths = [(folder, case.name) for folder in folders for case in recorded_cases(folder)]
    work = [
        *((rule, None, name, seed) for rule in [WHOLE, *rules] for name in families for seed in seeds),
        *((rule, folder, name, 0) for rule in [WHOLE, *rules] for folder, name in paths),
    ]
    return Results(seeds, list(run_all(_run, work, jobs, _said, progress)))


def _said(run: Run) -> str:
    return f"without {run.rule}, {run.scene}: NMI {run.nmi:.3f}"


def _run(name: str, folder: Path | None, scene: str, seed: int) -> Run:
    rule = RULES.get(name, Rule("nothing"))
    with rule.left_out():
        if folder is None:
            nmi = run_family(scene, seed, rule.config())["nmi_apart"]
        else:
            case = next(recorded for recorded in recorded_cases(folder) if recorded.name == scene)
            run = run_offline(case.open(0), rule.config(), period=PERIOD, duration=case.duration)
            nmi = float(np.nanmean(run.nmi))
    return Run(name, scene, seed, folder is not None, nmi)


_HEAD = """# Ablation

Made by `comotion dev reproduce ablation`. Each rule of the default method is left out alone; mean NMI
over all updates. Stress families with seeds {seeds}, and recordings.
The last column names the two scenes that change most, by more than {scatter:.3f}."""


def markdown(results: Results) -> str:
    """A table with a line for each rule."""
    drawn = Table(("left out", "families", "recordings", "changes"))
    drawn.add(*_cells(results, WHOLE, "nothing"))
    for name in dict.fromkeys(run.rule for run in results.runs if run.rule != WHOLE):
        drawn.add(*_cells(results, name, f"`{name}`: {RULES[name].what}"))
    seeds = ", ".join(map(str, results.seeds))
    return document([_HEAD.format(seeds=seeds, scatter=SCATTER), drawn])


def _cells(results: Results, rule: str, title: str) -> tuple[str, ...]:
    families, recordings = (results.means(rule, recorded=recorded) for recorded in (False, True))
    whole = results.means(WHOLE, recorded=False) | results.means(WHOLE, recorded=True)
    changes = {name: nmi - whole[name] for name, nmi in (families | recordings).items()}
    largest = sorted(changes.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
    changed = ", ".join(f"{name} {change:+.3f}" for name, change in largest if abs(change) > SCATTER)
    return title, number(mean(families.values()), 4), number(mean(recordings.values()), 4), changed or "-"
