"""Runs the pixel benchmark: the method on whole sequences, on their first frames, and with noise."""

import time
from collections.abc import Sequence as Rows

import numpy as np
from numpy.typing import NDArray

from comotion.partition import Previous
from comotion.pixels.method import PixelMethod
from comotion.trajectories.window import Window

from ..study import Row, values
from ..tables import Table, document, mean
from .sequences import HOPKINS, Sequence, score

_LENGTHS = (None, 10, 20, 30)
_NOISE_PX = 0.4
_METHODS = {"comotion, K unknown": 0.0, f"the same with {_NOISE_PX:g} px of white noise": _NOISE_PX}
_ALONE = "each motion alone"
_RUNS = {f"{method}, {n}": (n, noise) for method, noise in _METHODS.items() for n in _LENGTHS}
_GAP_NS = 500_000_000


SETTINGS = (*_RUNS, _ALONE)


def run_sequence(sequence: Sequence, setting: str, _: int) -> Row:
    """Score a sequence under one of :data:`SETTINGS`.

    Returns
    -------
    Figures of :func:`~.sequences.score`, `ms` and `scene`; of Hopkins155 besides how many motions `alone` are
    one hypothesis, of how many, `of`.
    """
    if setting == _ALONE:
        return _motions_alone(sequence)
    frames, noise = _RUNS[setting]
    part = sequence if frames is None else sequence.first(frames)
    part = part.noisy(noise) if noise else part
    labels, seconds = engine(part)
    return score(part, labels) | {"ms": 1e3 * seconds, "scene": sequence.scene}


def _motions_alone(sequence: Sequence) -> Row:
    """Count the motions of a whole sequence that are one hypothesis when they are alone, and all motions."""
    if sequence.group != HOPKINS or sequence.scene != sequence.name:
        return {}
    motions = np.unique(sequence.truth[sequence.truth > 0]).tolist()
    labels = (engine(sequence.of(sequence.truth == motion))[0] for motion in motions)
    return {"alone": sum(len(np.unique(hypotheses)) == 1 for hypotheses in labels), "of": len(motions)}


def engine(sequence: Sequence) -> tuple[NDArray[np.int64], float]:
    """Labels of one update of the core over a whole sequence, including ended trajectories.

    Returns
    -------
    Labels int64 [N], −1 undetermined, and the seconds that the update took.
    """
    stamps = np.round((sequence.times - sequence.times[0]) * 1e9).astype(np.int64)
    window = Window(2, int(stamps[-1]) + 1, _GAP_NS)
    core = PixelMethod()
    slots = window.open(sequence.positions.shape[1], 0)
    for stamp, x in zip(stamps.tolist(), sequence.positions, strict=True):
        seen = np.flatnonzero(np.isfinite(x).all(axis=1))
        if len(seen):
            window.insert(slots[seen], stamp, x[seen], np.full(len(seen), np.nan), None)
    begin = time.perf_counter()
    nothing = Previous(np.full(window.capacity, -1), np.zeros(0, np.int64))
    partition = core.partition(window, slots, int(stamps[-1]), nothing)
    group_of = np.full(window.capacity, -1)
    group_of[partition.slots] = partition.groups
    return group_of[slots], time.perf_counter() - begin


def markdown(rows: Rows[Row]) -> str:
    """A table of mean errors in per cent by length, the rest of all frames; and lines on parts of sets."""
    titles = ("all frames", *(f"first {n}" for n in _LENGTHS if n), "median", "NMI", "K exact", "ms")
    table, lines = Table(("data set", "method", *titles), words=2), list[str]()
    for name in dict.fromkeys(row["group"] for row in rows):
        for method, noise in _METHODS.items():
            whole, *parts = ({"group": name, "setting": f"{method}, {n}"} for n in _LENGTHS)
            errors = [f"{mean(values(rows, 'error', **part)):.1f}" for part in (whole, *parts)]
            median, ms = (np.median(values(rows, figure, **whole)) for figure in ("error", "ms"))
            nmi, exact = (mean(values(rows, figure, **whole)) for figure in ("nmi", "exact"))
            rest = (f"{median:.1f}", f"{nmi:.3f}", f"{100 * exact:.0f} %", "-" if noise else f"{ms:.0f}")
            scenes = values(rows, "scene", **whole)
            table.add(f"{name} ({len(scenes)})", method, *errors, *rest)
            title = f"{name}, {method}" if noise else name
            lines += _halves(title, scenes, values(rows, "error", **whole))
    alone, motions = sum(values(rows, "alone")), sum(values(rows, "of"))
    lines += [f"{HOPKINS}, each motion alone: one hypothesis in {alone} of {motions}"] if motions else []
    return document([table, "\n".join(f"- {line}" for line in lines)])


def _halves(title: str, scenes: Rows[str], errors: Rows[float]) -> list[str]:
    """Mean errors on every other scene and on the rest; sequences of one scene share footage."""
    numbers = {scene: k for k, scene in enumerate(sorted(set(scenes)))}
    if len(numbers) < 2:
        return []
    pairs = list(zip(scenes, errors, strict=True))
    first, second = (mean(error for scene, error in pairs if numbers[scene] % 2 == k) for k in (0, 1))
    return [f"{title}: {first:.1f} % on every other scene by name, {second:.1f} % on the rest"]
