"""What a method of inferring hypotheses must offer; the rest of the core knows no more of it."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Event, Hypothesis, ObservationBatch

from .arrays import Floats, Slots
from .config import FusionConfig, Unit
from .trajectories.window import Window

NO_HYPOTHESIS = -1
"""Label of a trajectory that belongs to no hypothesis."""


@dataclass(frozen=True)
class Rows:
    """One instant of one source, already stored in the window.

    `slots` intp [n] distinct; `in_order` is False where it was inserted behind newer observations.
    """

    stamp_ns: int
    slots: Slots
    in_order: bool


@dataclass(frozen=True)
class Partition:
    """The current trajectories of a space and what they belong to.

    `labels` int64 [n] hypothesis id or :data:`NO_HYPOTHESIS`, `confidence` float64 [n] in 0..1, in
    the order of the slots that were asked for; `events` are those of this update only.
    """

    labels: NDArray[np.int64]
    confidence: Floats
    hypotheses: list[Hypothesis] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


class IdAllocator:
    """Hands out hypothesis ids, never the same twice within a scene."""

    def __init__(self, first: int = 1) -> None:
        self.following = first

    def next(self) -> int:
        """A fresh id.

        Raises
        ------
        OverflowError
            After 2**32 - 2 hypotheses.
        """
        if self.following >= UNDETERMINED:
            raise OverflowError("out of hypothesis ids")
        self.following += 1
        return self.following - 1


@dataclass(frozen=True)
class SpaceSpec:
    """Name, unit and dimension of a coordinate space."""

    name: str
    unit: Unit
    dim: int

    def suits(self, batch: ObservationBatch) -> bool:
        """Whether a batch agrees on unit and dimension."""
        return (batch.unit, batch.dim) == (self.unit, self.dim)


class Engine(Protocol):
    """A method, for one space. Told of every change of the window, asked once per update."""

    def observed(self, window: Window, rows: Rows) -> None:
        """One instant of one source has been stored."""

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest `counts[k]` observations of `slots[k]` are about to go."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories (slots by age, intp [n]) at the watermark."""

    def affinity(self) -> NDArray[np.float32]:
        """Affinity [n, n] of the last update's trajectories."""

    def state(self, window: Window) -> dict[str, Any]:
        """What must survive a restart, as plain values and arrays; slots as keys of the window."""

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state` over a window that has been filled again.

        An empty state: start afresh on the trajectories of the window.
        """


class EngineFactory(Protocol):
    """Builds the engine of a space."""

    def __call__(self, config: FusionConfig, spec: SpaceSpec, ids: IdAllocator) -> Engine:
        """Engine for one space."""
