"""Runs the pixel benchmark: data sets -> scores of the method and of baselines."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from comotion.config import PixelsConfig
from comotion_clients.metrics import isolate, misclassification, nmi

from ..processes import Progress, quiet
from .methods import (
    divisive_brox_malik,
    engine,
    one_object,
    spectral_brox_malik,
    spectral_distance,
    spectral_interaction,
)
from .sequences import Sequence

LENGTHS: tuple[int | None, ...] = (None, 10, 20, 30)
BASELINES = {
    "one object": one_object,
    "spectral, distance variance, K given": spectral_distance,
    "spectral, shape interaction, K given": spectral_interaction,
    "spectral, Brox and Malik, K given": spectral_brox_malik,
    "divisive k-means, Brox and Malik": divisive_brox_malik,
}
OURS = "comotion, K unknown"
# What cross-validation chooses from: the defaults, and what matters most one step down and up.
_STEPS: dict[str, tuple[Any, ...]] = {
    "noise_factor": (22.0, 45.0),
    "supercluster_similarity": (0.06, 0.11),
    "merge_similarity": (0.0055, 0.01),
    "boundary_least": (0.35, 0.75),
    "epipolar_weight": (0.8, 1.4),
}
SETTINGS = (
    PixelsConfig(),
    *(PixelsConfig(**{name: value}) for name, values in _STEPS.items() for value in values),
)
_FOLDS = 5


@dataclass(frozen=True)
class Row:
    """Means over the sequences of a data set at one length; error and exactness in per cent."""

    data_set: str
    method: str
    frames: int | None
    sequences: int
    error: float
    median_error: float
    nmi: float
    k_exact: float
    ms: float


@dataclass
class Benchmark:
    """Results of the benchmark."""

    rows: list[Row] = field(default_factory=list)
    cross_validated: dict[str, float] = field(default_factory=dict)
    singles: tuple[int, int] = (0, 0)

    def as_json(self) -> dict[str, Any]:
        """Convert to plain values."""
        good, count = self.singles
        return {
            "rows": [asdict(row) for row in self.rows],
            "cross_validated_error": self.cross_validated,
            "single_objects": {"one_hypothesis": good, "of": count},
        }


@dataclass(frozen=True)
class _Scored:
    error: float
    nmi: float
    exact: bool
    seconds: float


def run_benchmark(
    data_sets: Mapping[str, list[Sequence]],
    *,
    baselines: bool = True,
    cross_validate: bool = True,
    progress: Progress = quiet,
) -> Benchmark:
    """Score the engine and the baselines on whole sequences and on their first frames.

    Parameters
    ----------
    data_sets
        By name, see :func:`~comotion_experiments.pixels.sequences.find_data_sets`.
    baselines, cross_validate
        Whether to do these too.
    progress
        Receives what comes next.
    """
    found = Benchmark()
    for name, sequences in data_sets.items():
        for frames in LENGTHS:
            progress(f"{name}, {'all' if frames is None else f'first {frames}'} frames")
            parts = [s if frames is None else s.first(frames) for s in sequences]
            found.rows.append(_row(name, OURS, frames, _ours(parts, PixelsConfig())))
            for title, method in BASELINES.items() if baselines else ():
                scored = [_score(part, method(part), 0.0) for part in parts]
                found.rows.append(_row(name, title, frames, scored))
        if cross_validate and len({s.scene for s in sequences}) >= _FOLDS:
            progress(f"{name}, cross-validation")
            found.cross_validated[name] = _cross_validate(sequences)
    if "Hopkins155" in data_sets:
        progress("single objects")
        found.singles = _singles(data_sets["Hopkins155"])
    return found


def _ours(sequences: Iterable[Sequence], parameters: PixelsConfig) -> list[_Scored]:
    return [_score(sequence, *engine(sequence, parameters)) for sequence in sequences]


def _score(sequence: Sequence, labels: np.ndarray[Any, np.dtype[np.int64]], seconds: float) -> _Scored:
    known = sequence.truth > 0
    mine, truth = isolate(labels[known], -1), sequence.truth[known]
    exact = len(np.unique(labels[known & (labels >= 0)])) == len(np.unique(truth))
    return _Scored(100 * misclassification(mine, truth), nmi(mine, truth), exact, seconds)


def _row(name: str, method: str, frames: int | None, scored: list[_Scored]) -> Row:
    errors = [s.error for s in scored]
    return Row(
        data_set=name,
        method=method,
        frames=frames,
        sequences=len(scored),
        error=float(np.mean(errors)),
        median_error=float(np.median(errors)),
        nmi=float(np.mean([s.nmi for s in scored])),
        k_exact=100 * float(np.mean([s.exact for s in scored])),
        ms=1e3 * float(np.median([s.seconds for s in scored])),
    )


def _cross_validate(sequences: list[Sequence]) -> float:
    """Cross-validated mean error: the setting is chosen on other scenes.

    Sequences of one scene share footage and go into the same fold.
    """
    scenes = sorted({s.scene for s in sequences})
    fold = np.array([scenes.index(s.scene) % _FOLDS for s in sequences])
    errors = np.array([[s.error for s in _ours(sequences, setting)] for setting in SETTINGS])
    held_out = [errors[errors[:, fold != k].mean(axis=1).argmin(), fold == k] for k in range(_FOLDS)]
    return float(np.concatenate(held_out).mean())


def _singles(sequences: list[Sequence]) -> tuple[int, int]:
    """Count the motions that are one hypothesis when they are alone, and all motions."""
    good = count = 0
    for sequence in sequences:
        if sequence.scene != sequence.name:
            continue
        for motion in np.unique(sequence.truth[sequence.truth > 0]).tolist():
            labels, _ = engine(sequence.of(sequence.truth == motion), PixelsConfig())
            good += len(np.unique(labels)) == 1
            count += 1
    return good, count
