"""Runs the parts of the report on joints and on a camera that moves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..fusion.setup import Setup
from ..processes import Progress, quiet
from .cost import Cost, measure
from .eye_in_hand import HandResult, run_seed
from .features import LIVE, Found, joints_from_features
from .free_bodies import SCENES, longest_false_joint
from .people import Person, run_person
from .poses import CASES, PoseCase, run_case

PARTS = ("poses", "features", "sparse", "free", "people", "cost", "hand")
WORKCELL = ("shelf", "arm")


@dataclass(frozen=True)
class Experiment:
    """What to run; `pose_seeds` is the number of seeds of joints on poses alone."""

    parts: Sequence[str]
    seeds: Sequence[int]
    pose_seeds: int = 50
    data: Path | None = None
    cache: Path | None = None


@dataclass
class Results:
    """Results of the parts that were run, in the order of seeds."""

    experiment: Experiment
    poses: list[PoseCase] = field(default_factory=list)
    features: list[tuple[str, list[Found]]] = field(default_factory=list)
    sparse: list[tuple[str, list[Found]]] = field(default_factory=list)
    free: dict[str, list[float]] = field(default_factory=dict)
    people: list[Person] = field(default_factory=list)
    cost: list[Cost] = field(default_factory=list)
    hand: list[HandResult] = field(default_factory=list)


def run_experiment(experiment: Experiment, progress: Progress = quiet) -> Results:
    """Run the parts; `progress` is called with the name of the next run."""
    results = Results(experiment)
    for part in experiment.parts:
        _RUNS[part](results, progress)
    return results


def _poses(results: Results, progress: Progress) -> None:
    for kind, moved in CASES:
        progress(f"poses: {kind} {moved:g}")
        results.poses.append(run_case(kind, moved, range(results.experiment.pose_seeds)))


def _features(results: Results, progress: Progress) -> None:
    results.features += _seen(results.experiment, LIVE, progress)


def _sparse(results: Results, progress: Progress) -> None:
    results.sparse += _seen(results.experiment, Setup(), progress)


def _seen(experiment: Experiment, how: Setup, progress: Progress) -> list[tuple[str, list[Found]]]:
    """Joints of all seeds of each scene."""
    rows: list[tuple[str, list[Found]]] = []
    for scene in WORKCELL:
        found: list[Found] = []
        for seed in experiment.seeds:
            progress(f"{how.features} features: {scene}, seed {seed}")
            found += joints_from_features(scene, seed, experiment.cache, how)
        rows.append((scene, found))
    return rows


def _free(results: Results, progress: Progress) -> None:
    for scene in SCENES:
        progress(f"free bodies: {scene}")
        results.free[scene] = [longest_false_joint(scene, seed) for seed in results.experiment.seeds]


def _people(results: Results, progress: Progress) -> None:
    if results.experiment.data is None:
        return
    for path in sorted(results.experiment.data.glob("*.npz")):
        progress(f"people: {path.stem}")
        results.people.append(run_person(path))


def _cost(results: Results, progress: Progress) -> None:
    for seed in results.experiment.seeds:
        progress(f"cost: seed {seed}")
        results.cost.append(measure(seed))


def _hand(results: Results, progress: Progress) -> None:
    for seed in results.experiment.seeds:
        progress(f"eye in hand: seed {seed}")
        results.hand.append(run_seed(seed, results.experiment.cache))


_RUNS: dict[str, Callable[[Results, Progress], None]] = {
    "poses": _poses,
    "features": _features,
    "sparse": _sparse,
    "free": _free,
    "people": _people,
    "cost": _cost,
    "hand": _hand,
}
