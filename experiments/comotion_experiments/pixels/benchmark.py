"""Runs the pixel benchmark: data sets -> scores of the method."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion.config import PixelsConfig
from comotion_clients.metrics import isolate, misclassification, nmi

from ..processes import Progress, quiet
from ..tables import Table, document
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
    """Results of the benchmark.

    Attributes
    ----------
    rows
        Of every data set, method and length.
    error_of_halves
        Mean error on every other scene of a data set, and on the rest.
    single_objects
        Of so many motions alone how many are one hypothesis: `one_hypothesis`, `of`.
    """

    rows: list[Row] = field(default_factory=list)
    error_of_halves: dict[str, tuple[float, float]] = field(default_factory=dict)
    single_objects: dict[str, int] = field(default_factory=dict)


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
                    found.error_of_halves[name if title == OURS else f"{name}, {title}"] = _halves(
                        sequences, ours
                    )
    if "Hopkins155" in data_sets:
        progress("single objects")
        found.single_objects = _singles(data_sets["Hopkins155"])
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


def _singles(sequences: list[Sequence]) -> dict[str, int]:
    """Count the motions that are one hypothesis when they are alone, and all motions."""
    alone = []
    for sequence in sequences:
        if sequence.scene == sequence.name:
            for motion in np.unique(sequence.truth[sequence.truth > 0]).tolist():
                labels, _ = engine(sequence.of(sequence.truth == motion), PixelsConfig())
                alone.append(len(np.unique(labels)) == 1)
    return {"one_hypothesis": sum(alone), "of": len(alone)}


_LENGTH_TITLES = ("all frames", *(f"first {n}" for n in LENGTHS if n is not None))
TITLES = ("data set", "method", *_LENGTH_TITLES, "median", "NMI", "K exact", "ms")


def table(benchmark: Benchmark) -> Table:
    """Build the table: mean error in per cent per length; the rest is of all frames."""
    by_method: dict[tuple[str, str], dict[int | None, Row]] = {}
    for row in benchmark.rows:
        by_method.setdefault((row.data_set, row.method), {})[row.frames] = row
    drawn = Table(TITLES, words=2)
    for (name, method), lengths in by_method.items():
        drawn.add(
            f"{name} ({lengths[None].sequences})",
            method,
            *(f"{lengths[n].error:.1f}" for n in LENGTHS),
            f"{lengths[None].median_error:.1f}",
            f"{lengths[None].nmi:.3f}",
            f"{lengths[None].k_exact:.0f} %",
            f"{lengths[None].ms:.0f}" if method == OURS else "-",
            strong=method == OURS,
        )
    return drawn


def lines(benchmark: Benchmark) -> list[str]:
    """Format the results that are not in the table."""
    alone = benchmark.single_objects
    texts = [
        f"{name}: {first:.1f} % on every other scene by name, {second:.1f} % on the rest"
        for name, (first, second) in benchmark.error_of_halves.items()
    ]
    if alone.get("of"):
        texts.append(
            f"Hopkins155, each motion alone: one hypothesis in {alone['one_hypothesis']} of {alone['of']}"
        )
    return texts


def markdown(benchmark: Benchmark) -> str:
    """Format the results as Markdown."""
    return document([table(benchmark), "\n".join(f"- {line}" for line in lines(benchmark))])
