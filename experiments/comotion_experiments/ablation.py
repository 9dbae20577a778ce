"""Ablation: each rule of the default method in metric spaces left out alone, and what that costs."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from comotion import FusionConfig
from comotion.rigid.kernels.resampling import resample

from .accuracy.cases import recorded_cases, run_case
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
    """A rule, term or group of constants, in words, and what stands in its place."""

    what: str
    # By "module.attribute", within ``comotion.rigid``. No constants of kernels, which are compiled in.
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the group `rigid`

    @contextmanager
    def left_out(self) -> Iterator[FusionConfig]:
        """Leave the rule out in this process for as long as the context lasts; yields the parameters."""
        with ExitStack() as stack:
            for path, value in self.changes.items():
                stack.enter_context(patch(f"comotion.rigid.{path}", value))
            yield FusionConfig.model_validate({"rigid": dict(self.parameters)})


def _only_white(_tracks: Any, _y: Any, _w: Any, owner: Any, tolerance: Any, *_: Any) -> Any:
    return tolerance, np.tile([1.0, 0.0, 0.0], (len(owner), 1))


def _no_costs(scene: Any, fitted: Any, *_: Any) -> Any:
    return np.zeros((len(scene.hypotheses), len(fitted)))


def _with_errors(observations: Any, stamps: Any, limits: Any, variance: Any, *out: Any) -> None:
    resample(observations, stamps, limits, np.full_like(variance, np.inf), *out)


RULES: dict[str, Rule] = {
    "gross": Rule("gross errors are left out", {"resampling.resample": _with_errors}),
    "contact": Rule("slack of what rests and is touched", parameters={"rigidity_contact": 0.0}),
    "past_evidence": Rule("price of leaving a separate hypothesis", {"selection.past_evidence": _no_costs}),
    "clear_members": Rule("price of leaving for clear members", {"method.carried_costs": _no_costs}),
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
        {"fits.with_sliders": lambda _f, _b, body, *_: (body, np.zeros(body.shape, np.bool_))},
    ),
    "arrivals": Rule("newborn amid newborn wait", {"method.undecided": lambda _scene, labels: labels}),
    "settled": Rule("one pose for each rest", {"fits.settled": lambda _frames, body, _config: body}),
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


def run_experiment(
    rules: Sequence[str],
    families: Sequence[str],
    seeds: Sequence[int],
    folders: Sequence[Path] = (),
    *,
    jobs: int = 2,
    progress: Progress = quiet,
) -> list[Run]:
    """Run families and recordings with all rules, and without each of `rules`.

    `folders` are those of labelled recordings, `jobs` processes at once; `progress` is called with one line
    for each run that is done.
    """
    paths = [(folder, case.name) for folder in folders for case in recorded_cases(folder)]
    work = [
        *((rule, None, name, seed) for rule in [WHOLE, *rules] for name in families for seed in seeds),
        *((rule, folder, name, 0) for rule in [WHOLE, *rules] for folder, name in paths),
    ]
    return list(run_all(_run, work, jobs, _said, progress))


def _said(run: Run) -> str:
    return f"without {run.rule}, {run.scene}: NMI {run.nmi:.3f}"


def _run(name: str, folder: Path | None, scene: str, seed: int) -> Run:
    with RULES.get(name, Rule("nothing")).left_out() as config:
        if folder is None:
            return Run(name, scene, seed, False, run_family(scene, seed, config)["nmi_apart"])
        case = next(recorded for recorded in recorded_cases(folder) if recorded.name == scene)
        return Run(name, scene, seed, True, run_case(case, config, 0)["nmi"])


_HEAD = """# Ablation

Made by `comotion dev reproduce ablation`. Each rule of the default method is left out alone; mean NMI
over all updates. Stress families with seeds {seeds}, and recordings.
The last column names the two scenes that change most, by more than {scatter:.3f}."""


def as_json(runs: Sequence[Run]) -> dict[str, Any]:
    """Values for JSON: all runs, and the seeds of families."""
    return {"seeds": _seeds(runs), "runs": runs}


def _seeds(runs: Sequence[Run]) -> list[int]:
    return sorted({run.seed for run in runs if not run.recorded})


def markdown(runs: Sequence[Run]) -> str:
    """A table with a line for each rule."""
    drawn = Table(("left out", "families", "recordings", "changes"))
    whole = _means(runs, WHOLE)
    for name in dict.fromkeys([WHOLE, *(run.rule for run in runs)]):
        found = _means(runs, name)
        changes = {key: nmi - whole[key] for key, nmi in found.items()}
        largest = sorted(changes.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
        changed = ", ".join(f"{key[1]} {change:+.3f}" for key, change in largest if abs(change) > SCATTER)
        of_kinds = (mean(nmi for key, nmi in found.items() if key[0] == kind) for kind in (False, True))
        title = "nothing" if name == WHOLE else f"`{name}`: {RULES[name].what}"
        drawn.add(title, *(number(nmi, 4) for nmi in of_kinds), changed or "-")
    return document([_HEAD.format(seeds=", ".join(map(str, _seeds(runs))), scatter=SCATTER), drawn])


def _means(runs: Sequence[Run], rule: str) -> dict[tuple[bool, str], float]:
    """Mean NMI without a rule, by whether it is a recording, and the name of the scene."""
    scores: dict[tuple[bool, str], list[float]] = {}
    for run in runs:
        if run.rule == rule:
            scores.setdefault((run.recorded, run.scene), []).append(run.nmi)
    return {key: mean(values) for key, values in sorted(scores.items())}
