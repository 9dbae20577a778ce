"""The pixel method of the core over a whole sequence, and two baselines of the stress report."""

import time

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion.config import PixelsConfig
from comotion.partition import Previous, SpaceSpec
from comotion.pixels.key_frames import KeyFrames, evenly_spaced
from comotion.pixels.method import PixelMethod
from comotion.pixels.similarity import subspace
from comotion.trajectories.window import Window

from ..brox_malik import spectral
from .sequences import Sequence

Labels = NDArray[np.int64]
_GAP_NS = 500_000_000
_KEY_FRAMES = 24


def engine(sequence: Sequence, parameters: PixelsConfig) -> tuple[Labels, float]:
    """Labels of one update of the core over a whole sequence, including ended trajectories.

    Returns
    -------
    Labels int64 [N], −1 undetermined, and the seconds that the update took.
    """
    stamps = np.round((sequence.times - sequence.times[0]) * 1e9).astype(np.int64)
    window = Window(2, int(stamps[-1]) + 1, _GAP_NS)
    core = PixelMethod(FusionConfig(pixels=parameters), SpaceSpec("camera/pixels", "px", 2))
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


def one_object(sequence: Sequence) -> Labels:
    """Baseline: all trajectories are one object."""
    return np.zeros(len(sequence.truth), np.int64)


def spectral_interaction(sequence: Sequence) -> Labels:
    """Spectral clustering of shape interaction |v_i·v_j|⁴ at rank 4K, K given."""
    frames = _key_frames(sequence)
    vectors = subspace(frames, min(4 * sequence.objects(), 2 * len(frames.positions)), 6, 60)
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=0), 1e-12)
    affinity = np.abs(vectors.T @ vectors).astype(np.float64) ** 4
    return spectral(affinity, sequence.objects(), assign_labels="cluster_qr").astype(np.int64)


def _key_frames(sequence: Sequence) -> KeyFrames:
    x = sequence.positions[evenly_spaced(len(sequence.positions), _KEY_FRAMES)]
    seen: NDArray[np.bool_] = np.isfinite(x[..., 0]) & np.isfinite(x[..., 1])
    nothing = np.zeros(x.shape[1], np.float32)
    return KeyFrames(np.where(seen[..., None], x, 0).astype(np.float32), seen, nothing)
