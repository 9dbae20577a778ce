"""The pixel method of the core over a whole sequence."""

import time

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion.config import PixelsConfig
from comotion.partition import Previous, SpaceSpec
from comotion.pixels.method import PixelMethod
from comotion.trajectories.window import Window

from .sequences import Sequence

Labels = NDArray[np.int64]
_GAP_NS = 500_000_000


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
