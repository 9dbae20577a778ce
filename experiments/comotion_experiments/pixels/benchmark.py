"""Runs the pixel benchmark: data sets -> scores of the method."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from comotion.config import PixelsConfig

from ..study import Progress, quiet
from ..tables import Table, document, mean
from .methods import engine
from .sequences import Sequence, score

LENGTHS: tuple[int | None, ...] = (None, 10, 20, 30)
OURS = "comotion, K unknown"
NOISY = "the same with 0.4 px of white noise"
_NOISE_PX = 0.4
_LENGTH_TITLES = ("all frames", *(f"first {n}" for n in LENGTHS if n is not None))
TITLES = ("data set", "method", *_LENGTH_TITLES, "median", "NMI", "K exact", "ms")


def run_benchmark(data_sets: Mapping[str, list[Sequence]], progress: Progress = quiet) -> dict[str, Any]:
    """Score the engine on whole sequences and on their first frames.

    Parameters
    ----------
    data_sets
        By name, see :func:`~comotion_experiments.pixels.sequences.find_data_sets`.
    progress
        Receives what comes next.

    Returns
    -------
    `rows`: means over the sequences of a data set at one length, error and exactness in per cent;
    `error_of_halves`: mean error on every other scene of a data set, and on the rest; `single_objects`: of so
    many motions alone how many are one hypothesis.
    """
    rows: list[dict[str, Any]] = []
    halves: dict[str, tuple[float, float]] = {}
    for name, sequences in data_sets.items():
        for frames in LENGTHS:
            progress(f"{name}, {'all' if frames is None else f'first {frames}'} frames")
            parts = [s if frames is None else s.first(frames) for s in sequences]
            for title, tried in ((OURS, parts), (NOISY, [part.noisy(_NOISE_PX) for part in parts])):
                ours = [_scored(part) for part in tried]
                rows.append({"data_set": name, "method": title, "frames": frames} | _means(ours))
                if frames is None and len({s.scene for s in sequences}) > 1:
                    halves[name if title == OURS else f"{name}, {title}"] = _halves(sequences, ours)
    found: dict[str, Any] = {"rows": rows, "error_of_halves": halves, "single_objects": {}}
    if "Hopkins155" in data_sets:
        progress("single objects")
        found["single_objects"] = _singles(data_sets["Hopkins155"])
    return found


def _scored(sequence: Sequence) -> dict[str, float]:
    labels, seconds = engine(sequence, PixelsConfig())
    return score(sequence, labels) | {"ms": 1e3 * seconds}


def _means(scored: list[dict[str, float]]) -> dict[str, Any]:
    errors = [s["error"] for s in scored]
    return {
        "sequences": len(scored),
        "error": mean(errors),
        "median_error": float(np.median(errors)),
        "nmi": mean(s["nmi"] for s in scored),
        "k_exact": 100 * mean(s["exact"] for s in scored),
        "ms": float(np.median([s["ms"] for s in scored])),
    }


def _halves(sequences: list[Sequence], scored: list[dict[str, float]]) -> tuple[float, float]:
    """Mean errors on every other scene and on the rest.

    Sequences of one scene share footage and go into the same half.
    """
    scenes = sorted({s.scene for s in sequences})
    second = np.array([scenes.index(s.scene) % 2 == 1 for s in sequences])
    errors = np.array([s["error"] for s in scored])
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


def table(benchmark: dict[str, Any]) -> Table:
    """Build the table: mean error in per cent per length; the rest is of all frames."""
    drawn = Table(TITLES, words=2)
    errors = {(r["data_set"], r["method"], r["frames"]): f"{r['error']:.1f}" for r in benchmark["rows"]}
    for row in benchmark["rows"]:
        if row["frames"] is not None:
            continue
        name, method = row["data_set"], row["method"]
        ours = method == OURS
        lengths = (errors[name, method, n] for n in LENGTHS)
        rest = (f"{row['median_error']:.1f}", f"{row['nmi']:.3f}", f"{row['k_exact']:.0f} %")
        ms = f"{row['ms']:.0f}" if ours else "-"
        drawn.add(f"{name} ({row['sequences']})", method, *lengths, *rest, ms, strong=ours)
    return drawn


def lines(benchmark: dict[str, Any]) -> list[str]:
    """Format the results that are not in the table."""
    alone = benchmark["single_objects"]
    texts = [
        f"{name}: {first:.1f} % on every other scene by name, {second:.1f} % on the rest"
        for name, (first, second) in benchmark["error_of_halves"].items()
    ]
    if alone.get("of"):
        texts.append(
            f"Hopkins155, each motion alone: one hypothesis in {alone['one_hypothesis']} of {alone['of']}"
        )
    return texts


def markdown(benchmark: dict[str, Any]) -> str:
    """Format the results as Markdown."""
    return document([table(benchmark), "\n".join(f"- {line}" for line in lines(benchmark))])
