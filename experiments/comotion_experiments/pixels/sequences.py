"""Labelled sequences of image trajectories, parts of them, and their scores."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comotion_clients.metrics import isolate, misclassification, nmi
from comotion_schemas.errors import KnownError
from comotion_sources.recordings.npz import read_npz

HOPKINS = "Hopkins155"
DATA_SETS = {
    HOPKINS: "hopkins155/*.npz",
    "KT3DMoSeg": "kt3dmoseg/*.npz",
    "MTPV": "mtpv/*.npz",
    "ikeasmall01": "video/ikeasmall01.npz",
}


@dataclass(frozen=True)
class Sequence:
    """Trajectories of one recording."""

    name: str  # of the file, less the suffix
    positions: NDArray[np.float64]  # [F, N, 2], px; NaN where unobserved
    times: NDArray[np.float64]  # [F], s
    truth: NDArray[np.int64]  # [N]; object from 1 on, less than 1 where not scored
    group: str  # its data set
    seeded: bool = False

    @property
    def scene(self) -> str:
        """Common name of the sequences of the same footage: Hopkins' ``_g12`` are subsets."""
        return re.sub(r"_g\d+$", "", self.name)

    def first(self, frames: int) -> "Sequence":
        """Return the first frames, with the trajectories observed in them."""
        short = replace(self, positions=self.positions[:frames], times=self.times[:frames])
        seen: NDArray[np.bool_] = np.isfinite(short.positions[..., 0])
        return short.of(np.asarray(seen.any(axis=0)))

    def of(self, tracks: NDArray[np.bool_]) -> "Sequence":
        """Select trajectories by a mask bool [N]."""
        return replace(self, positions=self.positions[:, tracks], truth=self.truth[tracks])

    def noisy(self, sigma: float) -> "Sequence":
        """Add white noise of `sigma` px; the same at each call."""
        rng = np.random.default_rng(sum(map(ord, self.name)))
        return replace(self, positions=self.positions + rng.normal(0, sigma, self.positions.shape))


def score(sequence: Sequence, labels: NDArray[np.int64]) -> dict[str, float]:
    """Score labels [N], -1 undetermined, of the trajectories with a true object.

    Returns
    -------
    `error`: misclassified ones in per cent; `nmi`; `exact`: 1 where the number of objects is right, else 0.
    """
    scored = sequence.truth > 0
    alone, truth = isolate(labels[scored], -1), sequence.truth[scored]
    exact = len(np.unique(labels[scored & (labels >= 0)])) == len(np.unique(truth))
    return {"error": 100 * misclassification(alone, truth), "nmi": nmi(alone, truth), "exact": float(exact)}


def find_sequences(folder: Path) -> list[Sequence]:
    """Find the sequences of all data sets in a folder.

    Raises
    ------
    ValueError
        If there is none, or a file is not a labelled recording of image positions.
    """
    sequences = [_read(path, name) for name, glob in DATA_SETS.items() for path in sorted(folder.glob(glob))]
    if not sequences:
        raise KnownError(f"{folder}: holds none of {', '.join(DATA_SETS.values())}")
    return sequences


def _read(path: Path, group: str) -> Sequence:
    recording = read_npz(path)
    if recording.dim != 2 or recording.labels is None:
        raise KnownError(f"{path}: not a labelled recording of image positions")
    truth = recording.labels.astype(np.int64)
    return Sequence(path.stem, recording.positions, recording.times, truth, group)
