"""The result of an update of one space: its current trajectories, their hypotheses, and how sure they are.

A body explains what its members do when its residual is small against the size of the scene. Ids that change
hands, random numbers and the like are grouped too, with residuals of a fifth of the scene and more; among
them some small group fits by chance. So the confidence in a trajectory falls with the residual of its own
hypothesis, and with the share of the trajectories of its source that are explained.

The residual that counts is without the bias of the fit: two or three features that wander each by itself are
followed by the poses of a body of their own, and leave little. And it is that of a second: what wanders has
not come far before. What the others leave of a member that takes no part in the fit is more still, and would
doubt soft bodies of few markers that are right.

The residual is below .02 of the size of the scene for bodies of metal and below .1 for markers on people (the
recordings of docs/research/unseen.md); with ids that roll by one it is .3 to 1.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event, Hypothesis, Pose

from .arrays import Bools, Floats, Slots, distinct, median
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
# Residual, as a share of the size of the scene, that halves the confidence.
_HALF = 0.15
# s; where less was observed, the residual is taken to grow until then as that of a random walk does.
_KNOWN_AFTER = 1.0


@dataclass(frozen=True)
class SpaceUpdate:
    """Current trajectories of one space and their hypotheses, as of one update."""

    spec: SpaceSpec
    window: Window
    """The space, and the store of its trajectories."""
    slots: Slots
    tracks: NDArray[Any]
    """intp [n], where the current trajectories are in the window, and :data:`TRACK` [n]."""
    hypotheses: list[Hypothesis]
    """What is published: the hypotheses with current members, and the absent ones."""
    bodies: list[Hypothesis]
    motions: Callable[[Collection[int]], dict[int, BodyMotion]]
    """Those with current members, in the axes of the space; and the motion of some of them, by id and in axes
    that stay the same, as far as it is known."""
    events: list[Event]
    """Those of this update only."""
    frame: Pose | None = None
    """Where the frame of the space is in the world; None where it does not move."""

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


def explained(tracks: NDArray[Any], hypotheses: Sequence[Hypothesis], observed_s: Floats) -> Floats:
    """Factors of the confidence of tracks :data:`TRACK` [n], float64 [n] in 0..1; 1 where no noise is known.

    `hypotheses` are those of the space, with their noise where it is known; `observed_s` float64 [n] is for
    how many s each track was observed in the window.
    """
    labels, share = tracks["label"], np.zeros(len(tracks))
    for body in hypotheses:
        if body.noise:
            members = labels == body.id
            share[members] = _unbiased(body, observed_s[members])
    if not share.any():
        return np.ones(len(tracks))
    positions = tracks["position"][:, : len(hypotheses[0].centroid)]
    away = positions - median(positions)
    # Per axis, as the noise is.
    size = np.sqrt(np.square(away).mean(axis=1))
    share /= max(float(median(size)), 1e-12)
    own = 1 / (1 + (share / _HALF) ** 4)
    _, numbers = distinct(tracks["session"])
    return np.asarray(own * (np.bincount(numbers, own) / np.bincount(numbers))[numbers], np.float64)


def _unbiased(body: Hypothesis, observed_s: Floats) -> float:
    """One-sigma of a coordinate that a body leaves of its members after :data:`_KNOWN_AFTER`.

    `observed_s` float64 [m], s for which they were observed.
    """
    squared, dim, members = (body.noise or 0.0) ** 2, len(body.centroid), max(body.size, 2)
    if body.state != "static":
        # Of the coordinates of its members, a pose takes so many degrees of freedom.
        freedom = 3 if dim == 2 else 6 - (members == 2)
        squared /= 1 - freedom / (members * dim)
    life = float(median(observed_s)) if len(observed_s) else _KNOWN_AFTER
    return math.sqrt(squared / min(max(life / _KNOWN_AFTER, 0.01), 1.0))
