"""Messages of sources and components: all messages of the protocol except HypothesisUpdate.

A message is a frozen pydantic dataclass: header fields are plain values, columns are read-only NumPy
arrays. Construction validates the message completely; the receiver checks what depends on the key or the
clock.
"""

from dataclasses import field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Discriminator, Field, StringConstraints, Tag
from pydantic.dataclasses import dataclass

from .types import (
    MESSAGE_CONFIG,
    UNIT_NORM_TOLERANCE,
    Column,
    Count,
    DistinctIds,
    F8Column,
    Finite,
    IdColumn,
    Int64,
    Name,
    Rowwise,
    SessionId,
    ShortText,
    SpaceName,
    Unit,
    has_duplicates,
    increasing,
    reject,
    symmetric,
)

# Share of the largest eigenvalue of a matrix in single precision that may be missing from the least.
_ROUNDING = 1e-5


_Sigma = Annotated[
    Annotated[Finite, Field(gt=0), Tag("number")]
    | Annotated[NDArray[np.float32], Column("<f4", above=0), Tag("column")],
    Discriminator(lambda value: "number" if isinstance(value, int | float | np.number) else "column"),
]
"""One number for all rows, or one for each."""


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class ObservationBatch(Rowwise):
    """Observations of one source: newest states of its features (``comotion.ObservationBatch/1``).

    Attributes
    ----------
    source, session, seq
        Publisher, its run and its message number. A trajectory is (source, session, id).
    space, unit, dim
        Coordinate space of the states, ``m`` or ``px``, 2 or 3.
    stamp_ns
        Acquisition time of the newest instant, nanoseconds since the Unix epoch.
    ids
        uint64 [N], feature ids; never reused within a session.
    positions
        float32 [N, dim], in `unit`, finite.
    stamps_ns
        int64 [N] or None: acquisition time per row.
    sigma
        One-sigma isotropic noise in `unit`: a number, float32 [N], or None when unknown.
    covariance
        float32 [N, 6] (xx, xy, xz, yy, yz, zz), in 2-D [N, 3] (xx, xy, yy), or None: covariance of the white
        noise of a position in the axes of the space, m², positive semidefinite. Metric spaces only; it counts
        before sigma.
    quaternions
        float32 [N, 4] (x, y, z, w) or None; a row of NaN is a point. 3-D only.
    ended
        uint64 [M] or None: ids the source has lost for good.
    moving
        Whether the frame of the space is carried, as that of a camera in the hand; None: no.

    Raises
    ------
    pydantic.ValidationError
        With a rejection reason of the protocol as error type.
    """

    schema: Literal["comotion.ObservationBatch/1"] = "comotion.ObservationBatch/1"
    source: Name
    session: SessionId
    seq: Count
    space: SpaceName
    unit: Unit
    dim: Annotated[int, Field(strict=True, ge=2, le=3)]
    stamp_ns: Int64
    ids: IdColumn
    positions: Annotated[NDArray[np.float32], Column("<f4", "dim")]
    stamps_ns: Annotated[NDArray[np.int64], Column("<i8")] | None = None
    sigma: _Sigma | None = None
    covariance: Annotated[NDArray[np.float32], Column("<f4", "dim (dim + 1) / 2")] | None = None
    quaternions: Annotated[NDArray[np.float32], Column("<f4", 4, finite=False)] | None = None
    ended: DistinctIds | None = None
    moving: Annotated[bool, Field(strict=True)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_stamps()
        self._check_covariance()
        self._check_quaternions()

    def _check_stamps(self) -> None:
        if self.stamps_ns is None:
            if has_duplicates(self.ids):
                raise reject("duplicate-id", "an id occurs twice in one instant")
            return
        if not len(self.ids):
            return
        if int(self.stamps_ns.max()) != self.stamp_ns:
            raise reject("range", "the largest of stamps_ns must equal stamp_ns")
        if increasing(self.ids):
            return
        order = np.argsort(self.ids, kind="stable")
        ids, stamps = self.ids[order], self.stamps_ns[order]
        same = ids[1:] == ids[:-1]
        # No differences: they may exceed int64.
        if (same & (stamps[1:] < stamps[:-1])).any():
            raise reject("range", "stamps_ns must not decrease within an id")
        if (same & (stamps[1:] == stamps[:-1])).any():
            raise reject("duplicate-id", "an id occurs twice in one instant")

    def _check_covariance(self) -> None:
        if self.covariance is None:
            return
        if self.unit != "m":
            raise reject("schema", "a covariance needs a metric space")
        least, *_, most = np.linalg.eigvalsh(symmetric(self.covariance.astype(np.float64))).T
        if (least < -_ROUNDING * most).any():
            raise reject("range", "a covariance is not positive semidefinite")

    def _check_quaternions(self) -> None:
        if self.quaternions is None:
            return
        if self.dim != 3:
            raise reject("schema", "quaternions need dim 3")
        poses = self.quaternions[~np.isnan(self.quaternions).all(axis=1)].astype(np.float64)
        if not np.isfinite(poses).all():
            raise reject("non-finite", "a quaternion is partly NaN or infinite")
        if (np.abs(np.linalg.norm(poses, axis=1) - 1.0) > UNIT_NORM_TOLERANCE).any():
            raise reject("range", "a quaternion is not of unit norm")


_FeatureNumber = Annotated[str, StringConstraints(strict=True, pattern=r"^(0|[1-9][0-9]{0,19})\z")]
_ObjectNumber = Annotated[str, StringConstraints(strict=True, pattern=r"^(0|-?[1-9][0-9]{0,9})\z")]


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class TruthBatch(Rowwise):
    """Which object each feature belongs to (``comotion.TruthBatch/1``).

    `ids` uint64 [N]; `objects` int32 [N], -1 for ambiguous (never scored); `names` maps object
    numbers in decimal to readable names. Batches add up; the last value of an id holds.
    """

    schema: Literal["comotion.TruthBatch/1"] = "comotion.TruthBatch/1"
    source: Name
    session: SessionId
    ids: DistinctIds
    objects: Annotated[NDArray[np.int32], Column("<i4", least=-1)]
    names: dict[_ObjectNumber, ShortText]


def _distinct(names: list[str]) -> list[str]:
    if len(set(names)) != len(names):
        raise reject("duplicate-id", "a joint is named twice")
    return names


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class JointStates(Rowwise):
    """Joint positions of a robot (``comotion.JointStates/1``): float64 [J], rad or m."""

    schema: Literal["comotion.JointStates/1"] = "comotion.JointStates/1"
    source: Name
    session: SessionId
    seq: Count
    stamp_ns: Int64
    names: Annotated[list[ShortText], AfterValidator(_distinct)]
    positions: F8Column
    velocities: F8Column | None = None

    _of = "names"


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class Preview(Rowwise):
    """A camera image with its features (``comotion.Preview/1``): ids uint64 [N], pixels float32 [N, 2]."""

    schema: Literal["comotion.Preview/1"] = "comotion.Preview/1"
    source: Name
    session: SessionId
    stamp_ns: Int64
    encoding: Literal["jpeg"]
    image: Annotated[bytes, Field(strict=True)]
    ids: DistinctIds
    pixels: Annotated[NDArray[np.float32], Column("<f4", 2)]


StatusState = Literal["ok", "degraded", "stalled"]
Role = Literal["source", "service", "recorder", "viewer"]
RejectionReason = Literal[
    "malformed",
    "schema",
    "unknown-field",
    "length",
    "non-finite",
    "duplicate-id",
    "source-mismatch",
    "space-mismatch",
    "too-large",
    "future",
    "past",
    "range",
    "limit",
    "duplicate-name",
    "over-budget",
    "defect",
]
ProblemKind = Literal[
    "clock-ahead",
    "clock-behind",
    "clock-zero",
    "ids-reused",
    "ids-short-lived",
    "scale",
    "no-data",
    "silent",
    "duplicate-name",
    "over-budget",
    "contradicts-space",
    "drifts",
    "limit",
    "defect",
]


@dataclass(frozen=True, kw_only=True, config=MESSAGE_CONFIG)
class Problem:
    """Something that a person should change, as long as it lasts.

    Attributes
    ----------
    kind
        What it is; docs/troubleshooting.md says what each kind means.
    since_ns
        When it was noticed, nanoseconds since the Unix epoch.
    text
        What is wrong and what to do, one line.
    source
        The source that has it, or None.
    """

    kind: ProblemKind
    since_ns: Int64
    text: ShortText
    source: Name | None = None


@dataclass(frozen=True, kw_only=True, eq=False, config=MESSAGE_CONFIG)
class Status:
    """Health of one component, once a second (``comotion.Status/1``).

    Counters only grow, but for `lost` and `waiting`. `problems` are those that last.
    `version` of comotion and `host` name where it runs; empty when unknown. A service also says its
    `replica` ("active" or "standby"; empty without standbys) and `epoch`, and in `clock_offsets` how far
    the clock of each source is ahead of its own, in s. A source whose features have names, as the links of a
    robot, says them in `feature_names`, by their ids in decimal.
    """

    schema: Literal["comotion.Status/1"] = "comotion.Status/1"
    component: Name
    role: Role
    session: SessionId
    stamp_ns: Int64
    state: StatusState
    rates: dict[ShortText, Finite]
    ages: dict[ShortText, Finite]
    counters: dict[ShortText, Count]
    rejected: dict[RejectionReason, Count]
    message: ShortText
    version: ShortText = ""
    host: ShortText = ""
    replica: Literal["", "active", "standby"] = ""
    epoch: Count = 0
    clock_offsets: dict[ShortText, Finite] = field(default_factory=dict)
    feature_names: dict[_FeatureNumber, ShortText] | None = None
    problems: list[Problem] = field(default_factory=list)
