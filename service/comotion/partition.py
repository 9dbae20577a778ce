"""Defines the input and the output of a method: the types that methods and the rest of the core share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Pose, Twist
from comotion_schemas.hypotheses import HypothesisState

from .arrays import Bools, Floats, Ints, Labels, Slots, Stamps
from .config import Unit
from .saving import NOT_KEPT
from .trajectories.window import Window

NO_HYPOTHESIS = -1
"""Label of a trajectory that belongs to no hypothesis."""


@dataclass(frozen=True)
class SpaceSpec:
    """Name, unit and dimension of a coordinate space."""

    name: str
    unit: Unit
    dim: int


@dataclass(frozen=True)
class Previous:
    """Labels of the last update."""

    labels: Labels
    """int64 [capacity]: hypothesis of each slot, or :data:`NO_HYPOTHESIS`."""
    ids: Labels
    """int64 [K]: hypothesis of each group of the last partition, :data:`NO_HYPOTHESIS` for one without
    members."""


@dataclass
class PoseReference:
    """Reference of the pose of a hypothesis to its birth: rows seen since, and where they were at birth."""

    born_ns: int
    """Event time of the birth."""
    rows: Stamps
    """int64 [m], stable names of rows."""
    points: Floats
    """float64 [m, 3], their positions in the axes of the space at birth."""
    R: Floats
    t: Floats
    stamp_ns: int
    """float64 [3, 3] and [3], the last pose since birth, and its time."""
    axes: tuple[Floats, Floats, Floats] | None = field(default=None, metadata=NOT_KEPT)
    """Template float64 [n, 3] of the body that it followed last, and R and t that take its coordinates to the
    axes at birth; None: not known."""

    @classmethod
    def new(cls, stamp_ns: int) -> Self:
        """Build the reference of a hypothesis that is born now."""
        return cls(stamp_ns, np.zeros(0, np.int64), np.zeros((0, 3)), np.eye(3), np.zeros(3), stamp_ns)


@dataclass(frozen=True)
class Group:
    """One group of a partition, as far as its method can tell."""

    state: HypothesisState = "undetermined"
    """Whether it moves."""
    static: bool = False
    """Whether it is the method's static body, of which there is at most one."""
    twist: Twist | None = None
    """Velocities at the watermark, None where unknown."""
    noise: float | None = None
    """One-sigma residual of the members, in the space's unit, None where unknown."""
    pose_since: Callable[[PoseReference], Pose | None] | None = None
    """Gives the pose since birth and brings the reference up to date; None where the method knows no
    poses."""


@dataclass(frozen=True)
class Partition:
    """Trajectories of a space in groups 0 to K - 1."""

    slots: Slots
    """intp [N]: the current trajectories, and ended or outdated ones that the method has grouped too."""
    groups: Ints
    """intp [N]: group of each, or :data:`NO_HYPOTHESIS`."""
    deciding: Bools
    """bool [N]: members that decide which hypothesis a group continues."""
    confidence: Floats
    """float64 [n] in 0..1, of the current trajectories in their own order."""
    position: Floats
    """float64 [n, dim]: newest positions of the current trajectories, as the method sees them."""
    described: list[Group] = field(default_factory=list)
    """The groups, K or more."""


@dataclass(frozen=True)
class BodyMotion:
    """Motion of one hypothesis over F frames, x = R b + t in the axes of the space.

    Its axes are those of the space at its birth: they stay the same from update to update.
    """

    stamps: Stamps
    """int64 [F], ns, ascending."""
    R: Floats
    t: Floats
    posed: Bools
    """float64 [F, 3, 3], float64 [F, 3], bool [F] (whether the frame has a pose)."""
    turn_covariance: Floats
    place_variance: Floats
    """float64 [F, 3, 3], of a small turn in the axes of the body, rad²; float64 [F], of a coordinate of the
    centroid."""
    centre: Floats
    radius: float
    """float64 [3], centroid of what it was fitted to, in its axes; root mean square distance from it."""
    static: bool
    """Whether it is the body at rest."""

    def at_rest(self) -> "BodyMotion":
        """The same body at rest where it is now."""
        count = len(self.stamps)
        return replace(
            self,
            R=np.broadcast_to(self.R[-1], (count, 3, 3)),
            t=np.broadcast_to(self.t[-1], (count, 3)),
            posed=np.ones(count, np.bool_),
            turn_covariance=np.zeros((count, 3, 3)),
            place_variance=np.zeros(count),
        )


class Method(ABC):
    """A method, for one space. It is called before observations leave the window, and once per update."""

    by_thesis = False
    """Whether all members alike decide which hypothesis a group continues, by label propagation; else those
    of long standing do, in the best assignment, and trajectories that jump are cut there."""
    searching = True
    """Whether new groups are sought; else the known ones may be followed where that is cheaper."""

    @property
    def delays_ns(self) -> Mapping[int, int]:
        """Time that it adds to the stamps of sources that are late, ns by session number."""
        return {}

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:  # noqa: B027
        """The oldest `counts[k]` observations of `slots[k]` are about to go."""

    def forgetting(self, window: Window, slots: Slots) -> None:  # noqa: B027
        """Slots are about to be freed. Their keys are never used again."""

    @abstractmethod
    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories (slots by age, intp [n]) at the watermark."""

    @abstractmethod
    def affinity(self) -> NDArray[np.float32]:
        """Affinity [n, n] of the last update's current trajectories."""

    def motions(
        self,
        ids: Labels,  # noqa: ARG002
        references: Mapping[int, PoseReference],  # noqa: ARG002
        wanted: Collection[int],  # noqa: ARG002
    ) -> dict[int, BodyMotion]:
        """Motion of the wanted hypotheses over the window, by id, as far as it is known.

        `ids` int64 [K] are the hypotheses of the last partition's groups.
        """
        return {}

    def state(self) -> dict[str, Any]:
        """What must survive a restart beside the window, as plain values and arrays."""
        return {}

    def load(self, state: dict[str, Any], window: Window) -> None:  # noqa: B027
        """Take up :meth:`state` over a window that has been filled again.

        An empty state: start afresh on the trajectories of the window.
        """
