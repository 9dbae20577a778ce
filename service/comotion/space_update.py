"""The result of an update of one space: its current trajectories and their hypotheses."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event, Hypothesis, Pose

from .arrays import Bools, Slots
from .partition import BodyMotion, SpaceSpec
from .trajectories.window import Window

TRACK = np.dtype(
    [
        ("key", np.int64),
        ("session", np.intp),
        ("id", np.uint64),
        ("label", np.int64),
        ("confidence", np.float64),
        ("position", np.float64, 3),
    ]
)
"""A current trajectory: its key in the window, the number of its session and the id of its feature; its
hypothesis, negative for none, and a confidence in 0..1; its newest position in the unit of the space, in 2-D
with NaN in the third column."""
# Highest confidence of the trajectories of a source in doubt.
_MAX_CONFIDENCE = 0.5


@dataclass(frozen=True)
class SpaceUpdate:
    """Current trajectories of one space and their hypotheses, as of one update.

    Attributes
    ----------
    spec, window
        The space, and the store of its trajectories.
    slots, tracks
        intp [n], where the current trajectories are in the window, and :data:`TRACK` [n].
    hypotheses
        What is published: the hypotheses with current members, and the absent ones.
    bodies, motions
        Those with current members, in the axes of the space; and the motion of some of them, by id and in
        axes that stay the same, as far as it is known.
    events
        Those of this update only.
    frame
        Where the frame of the space is in the world; None where it does not move.
    """

    spec: SpaceSpec
    window: Window
    slots: Slots
    tracks: NDArray[Any]
    hypotheses: list[Hypothesis]
    bodies: list[Hypothesis]
    motions: Callable[[Collection[int]], dict[int, BodyMotion]]
    events: list[Event]
    frame: Pose | None = None

    def repeated(self) -> Self:
        """The same update without events, and without trajectories that are gone."""
        slots, window = self.slots, self.window
        same: Bools = window.used[slots] & (window.key[slots] == self.tracks["key"]) & ~window.ended[slots]
        return replace(self, slots=slots[same], tracks=self.tracks[same], events=[])

    def doubted(self, sessions: list[int]) -> Self:
        """The same with a confidence of a half at most in trajectories of some sessions, by number."""
        tracks = self.tracks.copy()
        rows = np.isin(tracks["session"], sessions)
        tracks["confidence"][rows] = np.minimum(tracks["confidence"][rows], _MAX_CONFIDENCE)
        return replace(self, tracks=tracks)
