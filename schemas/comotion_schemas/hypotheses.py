"""The message of the service: HypothesisUpdate (``comotion.HypothesisUpdate/1``)."""

import math
from dataclasses import field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from .types import (
    MESSAGE_CONFIG,
    UNDETERMINED,
    UNIT_NORM_TOLERANCE,
    Column,
    Count,
    Finite,
    IdColumn,
    Int64,
    Name,
    Record,
    Rowwise,
    SessionId,
    SpaceName,
    UInt32,
    reject,
)

HypothesisState = Literal["static", "moving", "undetermined"]
EventKind = Literal["born", "split", "merged", "ended", "absent", "returned", "joined", "released"]
_SHOWN = 6  # hypotheses that a short representation names
OF_BODIES: frozenset[EventKind] = frozenset({"born", "split", "merged", "ended", "absent", "returned"})
"""Events of bodies; the others are of their joints, which begin and end as they are sure or not."""


def _unit(vector: list[float]) -> list[float]:
    if abs(math.hypot(*vector) - 1) > UNIT_NORM_TOLERANCE:
        raise reject("range", "it is not of unit length")
    return vector


NotNegative = Annotated[Finite, Field(ge=0)]
Vector = Annotated[list[Finite], Field(min_length=2, max_length=3)]
Axis = Annotated[Vector, AfterValidator(_unit)]
Quaternion = Annotated[list[Finite], Field(min_length=4, max_length=4), AfterValidator(_unit)]
AngularVector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
HypothesisId = Annotated[UInt32, Field(lt=UNDETERMINED)]
JointKind = Literal["fixed", "prismatic", "revolute", "free", "undetermined"]


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class SourceRef:
    """A source of the update's tracks: its name and the session its ids belong to."""

    name: Name
    session: SessionId


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Pose(Record):
    """A rigid motion, x' = R·x + translation.

    Of a hypothesis since its birth, x(stamp) = R·x(born) + translation in the axes of its space; of a
    frame that moves, x(world) = R·x(frame) + translation. `rotation` is a quaternion (x, y, z, w) in 3-D
    and an angle in rad in 2-D.
    """

    translation: Vector
    rotation: Quaternion | Finite

    _spatial = "translation", "rotation"


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Twist(Record):
    """Velocity of the centroid (unit/s) and angular velocity: 3-vector in rad/s, in 2-D a number."""

    linear: Vector
    angular: AngularVector | Finite

    _spatial = "linear", "angular"


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Box(Record):
    """Extent in the axes of the space: half lengths along its own axes, which `rotation` turns.

    `rotation` is a quaternion (x, y, z, w) in 3-D and an angle in rad in 2-D.
    """

    center: Vector
    half: Annotated[list[NotNegative], Field(min_length=2, max_length=3)]
    rotation: Quaternion | Finite

    _spatial = "center", "half", "rotation"


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Hypothesis(Record):
    """A set of features that move as one rigid body.

    `size` counts its tracks in this update, `centroid` is their mean position [dim], `noise` the
    one-sigma residual in the space's unit, `linked` ids in other spaces that are the same body.
    An unconfirmed one may vanish without an event. One that is `absent` has no current track and is
    remembered: its centroid and twist are the last ones.
    """

    id: HypothesisId
    space: SpaceName
    size: Count
    born_ns: Int64
    state: HypothesisState
    centroid: Vector
    pose: Pose | None = None
    twist: Twist | None = None
    noise: NotNegative | None = None
    linked: list[HypothesisId] | None = None
    confirmed: bool = True
    absent: bool | None = None
    box: Box | None = None

    _spatial = "centroid", "pose", "twist", "box"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.absent and self.size:
            raise reject("range", "an absent hypothesis has tracks")


# Least and most `others` of an event.
_OTHERS: dict[EventKind, tuple[int, float]] = {"split": (1, 1)}
_OTHERS |= dict.fromkeys(("born", "ended", "absent", "returned"), (0, 0))
_OTHERS |= dict.fromkeys(("merged", "joined", "released"), (1, math.inf))


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Event:
    """A change of the set of confirmed hypotheses.

    ``born``: new, from nothing. ``split``: `hypothesis` is the new one, `others` the one it left.
    ``merged``: `hypothesis` survives, `others` are gone. ``absent``: no current member left, but
    remembered. ``returned``: it was absent and has members again. ``ended``: gone for good.
    ``joined``, ``released``: a joint with `others` begins, ends.
    """

    stamp_ns: Int64
    kind: EventKind
    hypothesis: HypothesisId
    others: list[HypothesisId]

    def __post_init__(self) -> None:
        least, most = _OTHERS[self.kind]
        if not least <= len(self.others) <= most:
            raise reject("length", f"{self.kind} with {len(self.others)} others")


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Joint(Record):
    """How one hypothesis can move against another of the same space.

    `axis` [dim] has unit length; it and `point` [dim], a point on it, are in the axes of the space at
    the stamp of the update. `position`, its `rate`, and the range seen (`lower`, `upper`) are in rad
    for a revolute joint and in the unit of the space for a prismatic one; they grow when the child moves
    along or turns about `axis` against the parent, and `position` is 0 where the pair was first seen.
    In 2-D a revolute joint has no axis: it turns from x to y. `confidence` in 0..1 is the probability
    of the kind. `sigma_axis` is in rad, `sigma_point` in the unit of the space, across the axis.
    """

    parent: HypothesisId
    child: HypothesisId
    space: SpaceName
    kind: JointKind
    confidence: Annotated[Finite, Field(ge=0, le=1)]
    axis: Axis | None = None
    point: Vector | None = None
    position: Finite | None = None
    rate: Finite | None = None
    lower: Finite | None = None
    upper: Finite | None = None
    sigma_axis: NotNegative | None = None
    sigma_point: NotNegative | None = None
    sigma_position: NotNegative | None = None
    sigma_rate: NotNegative | None = None

    _spatial = "axis", "point"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.parent == self.child:
            raise reject("range", "a joint connects a hypothesis to itself")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise reject("range", "lower exceeds upper")


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class HypothesisUpdate(Rowwise):
    """Every current trajectory and its hypothesis, whole in itself.

    Attributes
    ----------
    stamp_ns, published_ns, period_ns
        The watermark this update is fused up to, the clock at publication, the fixed period.
    live
        False while no source is live; `stamp_ns` stands still then.
    epoch
        Fencing number of the service that publishes, 0 without a standby.
    sources
        (name, session) pairs; `track_source` indexes them.
    track_source, track_id
        uint16 [N] and uint64 [N]: which trajectory a row is.
    track_hypothesis
        uint32 [N], hypothesis id or :data:`UNDETERMINED`.
    track_confidence
        float32 [N] in 0..1.
    track_position
        float32 [N, 3], newest fused state, NaN in the third column in 2-D.
    hypotheses, events
        The hypotheses with their motion; the changes of the last 2 s.
    joints
        Between listed hypotheses of one space; each pair at most once.
    frames
        For a space whose frame moves: where it is in the world, which is the frame at the first update
        that has one.
    """

    schema: Literal["comotion.HypothesisUpdate/1"] = "comotion.HypothesisUpdate/1"
    scene: Name
    session: SessionId
    seq: Count
    stamp_ns: Int64
    published_ns: Int64
    period_ns: Annotated[Int64, Field(gt=0)]
    live: bool = True
    epoch: Count = 0
    sources: list[SourceRef]
    track_source: Annotated[NDArray[np.uint16], Column("<u2")]
    track_id: IdColumn
    track_hypothesis: Annotated[NDArray[np.uint32], Column("<u4")]
    track_confidence: Annotated[NDArray[np.float32], Column("<f4", least=0, most=1)]
    track_position: Annotated[NDArray[np.float32], Column("<f4", 3, finite=False)]
    hypotheses: list[Hypothesis]
    events: list[Event]
    joints: list[Joint] = field(default_factory=list)
    frames: dict[SpaceName, Pose] = field(default_factory=dict)
    _of = "track_id"

    def __repr__(self) -> str:
        texts = [f"{h.id} {h.state} ({h.size})" for h in self.hypotheses]
        listed = [*texts[:_SHOWN], *(["..."] if len(texts) > _SHOWN else [])]
        count = f"{len(self.track_id)} tracks, hypotheses"
        return f"HypothesisUpdate({self.stamp_ns / 1e9:.3f} s, {count}: {', '.join(listed) or 'none'})"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_tracks()
        if len({(source.name, source.session) for source in self.sources}) != len(self.sources):
            raise reject("duplicate-id", "a source is listed twice")
        ids = [h.id for h in self.hypotheses]
        if len(set(ids)) != len(ids):
            raise reject("duplicate-id", "a hypothesis is listed twice")
        # UNDETERMINED is the largest number of 32 bits, so searchsorted never exceeds the list.
        listed = np.array([*sorted(ids), UNDETERMINED], np.uint32)
        if (listed[np.searchsorted(listed, self.track_hypothesis)] != self.track_hypothesis).any():
            raise reject("range", "a track names a hypothesis that is not listed")
        self._check_joints()

    def hypotheses_of(self, source: str, session: str) -> dict[int, int]:
        """Hypothesis, or :data:`UNDETERMINED`, of each current track of a source, by feature id."""
        numbers = [k for k, ref in enumerate(self.sources) if (ref.name, ref.session) == (source, session)]
        rows = np.isin(self.track_source, numbers)
        return dict(zip(self.track_id[rows].tolist(), self.track_hypothesis[rows].tolist(), strict=True))

    def _check_joints(self) -> None:
        if not self.joints:
            return
        spaces = {h.id: (h.space, len(h.centroid)) for h in self.hypotheses}
        for joint in self.joints:
            parent, child = spaces.get(joint.parent), spaces.get(joint.child)
            if parent is None or child is None:
                raise reject("range", "a joint names a hypothesis that is not listed")
            if not parent[0] == child[0] == joint.space:
                raise reject("space-mismatch", "a joint connects hypotheses of different spaces")
            if {len(v) for v in (joint.axis, joint.point) if v is not None} - {parent[1]}:
                raise reject("length", f"a joint does not go with {parent[1]} dimensions")
        if len({frozenset((j.parent, j.child)) for j in self.joints}) != len(self.joints):
            raise reject("duplicate-id", "a pair of hypotheses has two joints")

    def _check_tracks(self) -> None:
        if not len(self.track_id):
            return
        if int(self.track_source.max()) >= len(self.sources):
            raise reject("range", "track_source points beyond sources")
        if not np.isfinite(self.track_position[:, :2]).all() or np.isinf(self.track_position[:, 2]).any():
            raise reject("non-finite", "track_position must be finite")
        order = np.lexsort((self.track_id, self.track_source))
        source, track = self.track_source[order], self.track_id[order]
        if ((source[1:] == source[:-1]) & (track[1:] == track[:-1])).any():
            raise reject("duplicate-id", "a track is listed twice")
