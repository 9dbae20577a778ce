"""Runs the pixel benchmark: data sets -> scores of the method."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion.config import PixelsConfig
from comotion_clients.metrics import isolate, misclassification, nmi

from ..processes import Progress, quiet
from .methods import engine
from .sequences import Sequence

LENGTHS: tuple[int | None, ...] = (None, 10, 20, 30)
OURS = "comotion, K unknown"
NOISY = "the same with 0.4 px of white noise"
_NOISE_PX = 0.4


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
    halves: dict[str, tuple[float, float]] = field(default_factory=dict)
    singles: tuple[int, int] = (0, 0)

    def as_json(self) -> dict[str, Any]:
        """Convert to plain values."""
        good, count = self.singles
        return {
            "rows": [asdict(row) for row in self.rows],
            "error_of_halves": self.halves,
            "single_objects": {"one_hypothesis": good, "of": count},
        }


@dataclass(frozen=True)
class Scored:
    """One sequence: misclassified features in per cent, NMI, whether K is right, and seconds."""

    error: float
    nmi: float
    exact: bool
    seconds: float


def run_benchmark(data_sets: Mapping[str, list[Sequence]], progress: Progress = quiet) -> Benchmark:
    """Score the engine on whole sequences and on their first frames.

    Parameters
    ----------
    data_sets
        By name, see :func:`~comotion_experiments.pixels.sequences.find_data_sets`.
    progress
        Receives what comes next.
    """
    found = Benchmark()
    for name, sequences in data_sets.items():
        for frames in LENGTHS:
            progress(f"{name}, {'all' if frames is None else f'first {frames}'} frames")
            parts = [s if frames is None else s.first(frames) for s in sequences]
            for title, tried in ((OURS, parts), (NOISY, [part.noisy(_NOISE_PX) for part in parts])):
                ours = [score(part, *engine(part, PixelsConfig())) for part in tried]
                found.rows.append(_row(name, title, frames, ours))
                if frames is None and len({s.scene for s in sequences}) > 1:
                    found.halves[name if title == OURS else f"{name}, {title}"] = _halves(sequences, ours)
    if "Hopkins155" in data_sets:
        progress("single objects")
        found.singles = _singles(data_sets["Hopkins155"])
    return found


def score(sequence: Sequence, labels: NDArray[np.int64], seconds: float = 0.0) -> Scored:
    """Score labels [N], -1 undetermined, of the trajectories with a true object."""
    known = sequence.truth > 0
    mine, truth = isolate(labels[known], -1), sequence.truth[known]
    exact = len(np.unique(labels[known & (labels >= 0)])) == len(np.unique(truth))
    return Scored(100 * misclassification(mine, truth), nmi(mine, truth), exact, seconds)


def _row(name: str, method: str, frames: int | None, scored: list[Scored]) -> Row:
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


def _halves(sequences: list[Sequence], scored: list[Scored]) -> tuple[float, float]:
    """Mean errors on every other scene and on the rest.

    Sequences of one scene share footage and go into the same half.
    """
    scenes = sorted({s.scene for s in sequences})
    second = np.array([scenes.index(s.scene) % 2 == 1 for s in sequences])
    errors = np.array([s.error for s in scored])
    return float(errors[~second].mean()), float(errors[second].mean())


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
