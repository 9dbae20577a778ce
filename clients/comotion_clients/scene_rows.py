"""What is known of a scene at one time: plain values for `comotion watch`, `view` and `status`."""

from dataclasses import dataclass, field
from typing import Literal

from comotion_schemas.colours import GREY, RGB
from comotion_schemas.naming import Names

from .joints import JointRow

SourceState = Literal["ok", "silent", "stalled", "gone"]
Overall = Literal["ok", "degraded", "stalled"]
ServiceState = Literal["absent", "silent", "ok", "degraded", "stalled"]


@dataclass(frozen=True)
class SourceRow:
    """One source: `rate` in batches/s, `age` s since its last batch, `lag` s from acquisition to arrival.

    `state`: ``silent``: no batch so far; ``stalled``: no batch for too long; ``gone``: left the scene.
    `losing`: batches were lost in the last 10 s. `tracks`: number of its tracks in the newest update.
    `clock`: s by which its clock is ahead of the service's, as the service measures it; None if unknown.
    """

    name: str
    state: SourceState
    rate: float
    age: float
    lag: float
    lost: int
    losing: bool
    tracks: int
    space: str
    clock: float | None = None


@dataclass(frozen=True)
class HypothesisRow:
    """One hypothesis: `age` s since birth, `confidence` mean of its tracks, `speed` in unit/s or None.

    `linked`: hypotheses in other spaces that are the same body. `absent`: it has no current track.
    `turning`: angular speed in rad/s; `translation` [dim] in unit and `rotation` [3] (in 2-D [1]), a
    rotation vector in rad, since birth; `extent` [dim]: lengths of its box; each None where unknown. `name`:
    as given by a person, else its id.
    """

    id: int
    space: str
    unit: str
    state: str
    size: int
    age: float
    confidence: float
    speed: float | None
    linked: list[int]
    confirmed: bool = True
    absent: bool = False
    turning: float | None = None
    translation: list[float] | None = None
    rotation: list[float] | None = None
    extent: list[float] | None = None
    name: str = ""
    colour: RGB = GREY


@dataclass(frozen=True)
class EventRow:
    """One event, `ago` s before the newest update; `names` of those of its hypotheses that have one.

    `words`: it as a sentence.
    """

    stamp_ns: int
    ago: float
    kind: str
    hypothesis: int
    others: list[int]
    names: Names = field(default_factory=dict)
    words: str = ""


@dataclass(frozen=True)
class ProblemRow:
    """What a person should change: kind, the source that has it or None, and what to do."""

    kind: str
    source: str | None
    text: str


@dataclass(frozen=True)
class ServiceRow:
    """The service: `rate` of updates, `age` s since the last one, `lag` s from its W to its publication."""

    state: ServiceState
    rate: float
    age: float
    lag: float
    lost: int
    losing: bool
    seq: int
    message: str
    counters: dict[str, int]
    rejected: dict[str, int]
    problems: list[ProblemRow] = field(default_factory=list)


@dataclass(frozen=True)
class Snapshot:
    """State of a scene at one time."""

    scene: str
    stamp_ns: int
    service: ServiceRow
    tracks: int
    undetermined: int
    sources: list[SourceRow]
    hypotheses: list[HypothesisRow]
    events: list[EventRow]
    joints: list[JointRow] = field(default_factory=list)

    @property
    def current(self) -> int:
        """Number of hypotheses with current tracks."""
        return sum(not row.absent for row in self.hypotheses)


@dataclass(frozen=True)
class ComponentRow:
    """One component: its last Status, and how its clock differs.

    `clock_s` is how far its clock is ahead of the speaking service's, or of this machine's without one;
    `clock_error_s` bounds the error; both None if unknown. `age_s` is that of its Status.
    """

    role: str
    name: str
    state: str
    host: str
    version: str
    present: bool
    age_s: float
    rate_hz: float | None
    lag_s: float | None
    lost: int
    clock_s: float | None
    clock_error_s: float | None
    replica: str
    epoch: int
    message: str


@dataclass(frozen=True)
class RouterRow:
    """One router, as it describes itself; `dials`: how many routers it is told to connect to."""

    name: str
    host: str
    zid: str
    version: str
    locators: list[str]
    sessions: int
    routers: int
    dials: int = 0

    @property
    def label(self) -> str:
        """Its name, or the beginning of its id."""
        return self.name or self.zid[:8]


@dataclass(frozen=True)
class SceneStatus:
    """What `comotion status` shows; `problems` are lines for a person."""

    scene: str
    overall: Overall
    updates_hz: float | None
    update_lag_s: float | None
    components: list[ComponentRow]
    routers: list[RouterRow]
    problems: list[str]
