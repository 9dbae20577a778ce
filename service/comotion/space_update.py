"""Holds the result of an update of one space: its current trajectories and their hypotheses."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from comotion_schemas import Event, Hypothesis, Pose

from .arrays import Bools, Floats, Labels, Slots
from .linking.linker import SpaceView
from .trajectories.window import Ids

# Highest confidence of the trajectories of a source in doubt.
_MAX_CONFIDENCE = 0.5


@dataclass(frozen=True)
class SpaceUpdate:
    """Current trajectories of one space and their hypotheses, as of one update.

    Attributes
    ----------
    sessions, ids
        intp [n], number of the session, and uint64 [n], id of the feature, of each trajectory.
    positions
        float64 [n, 3]: newest fused positions, in the space's unit; the third column is NaN in 2-D.
    labels
        int64 [n], hypothesis id, negative for none.
    confidence
        float64 [n] in 0..1.
    hypotheses
        The hypotheses with current members, and the absent ones.
    events
        Those of this update only.
    view
        Input of the linker.
    frame
        Where the frame of the space is in the world; None where it does not move.
    """

    sessions: Slots
    ids: Ids
    positions: Floats
    labels: Labels
    confidence: Floats
    hypotheses: list[Hypothesis]
    events: list[Event]
    view: SpaceView
    frame: Pose | None = None

    def without_some(self, rows: Bools) -> Self:
        """The same update without events, and with the trajectories of `rows` only, bool [n]."""
        view = replace(self.view, current=self.view.current[rows], labels=self.view.labels[rows])
        columns: dict[str, Any] = {
            name: column[rows] for name, column in vars(self).items() if isinstance(column, np.ndarray)
        }
        return replace(self, **columns, events=[], view=view)

    def doubted(self, sessions: list[int]) -> Self:
        """The same with a confidence of a half at most in trajectories of some sessions, by number."""
        if not sessions:
            return self
        most = np.where(np.isin(self.sessions, sessions), _MAX_CONFIDENCE, 1.0)
        return replace(self, confidence=np.minimum(self.confidence, most))
