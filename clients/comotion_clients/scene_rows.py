"""What is known of a scene at one time: plain values for `comotion watch`, `view` and `status`, and problems.

What a person should look at is listed with causes first. Pure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from comotion_schemas import Problem
from comotion_schemas.colours import GREY, RGB
from comotion_schemas.naming import Names

from .bodies import JointRow

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
    problems: list[Problem] = field(default_factory=list)


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
    """One router, as it describes itself; `dials`: how many routers it is configured to connect to."""

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


USUAL_RATE_HZ = 30.0
"""Stands for the rate of a scene whose sources are unknown."""
_MOST_NAMES = 4


def find_problems(rows: list[ComponentRow], routers: Sequence[RouterRow] = ()) -> list[str]:
    """Return what a person should look at, one line each.

    Links, clocks and versions come first: what else is wrong is often their effect.
    """
    problems = _router_problems(routers) + _clock_problems(rows)
    problems += _versions_differ("versions", [(row.version, row.name) for row in rows])
    problems += _versions_differ("versions of Zenoh", [(row.version, row.label) for row in routers])
    services = [row for row in rows if row.role == "service"]
    speaking = [row for row in services if row.replica != "standby"]
    if not services:
        problems.append("no service: 'comotion serve' starts one")
    elif not speaking:
        problems.append("all services are standbys: none speaks for the scene")
    elif len(speaking) > 1:
        problems.append(f"several services speak: {', '.join(row.name for row in speaking)}")
    if len(services) == 1 and services[0].replica == "active":
        problems.append(f"service {services[0].name} has no standby")
    for row in rows:
        if row.state != "ok":
            why = f": {row.message}" if row.message else ""
            problems.append(f"{row.role} {row.name} is {row.state}{why}")
    return problems


def overall(rows: list[ComponentRow], problems: list[str]) -> Overall:
    """State of a scene: stalled without a service that speaks, degraded with a problem."""
    speaking = [row for row in rows if row.role == "service" and row.replica != "standby"]
    if not speaking or all(row.state in {"stalled", "silent"} for row in speaking):
        return "stalled"
    return "degraded" if problems else "ok"


def _router_problems(routers: Sequence[RouterRow]) -> list[str]:
    problems = []
    for row in routers:
        if row.routers < row.dials:
            problems.append(
                f"router {row.label} reaches {row.routers} of the {row.dials} routers that it is told to "
                "connect to: what is beyond is not seen here"
            )
        elif not row.routers and len(routers) > 1:
            problems.append(f"router {row.label} reaches no other router")
    return problems


def _versions_differ(subject: str, components: list[tuple[str, str]]) -> list[str]:
    """Say who has which version, where there are several, of (version, name) each."""
    names_by_version: dict[str, list[str]] = {}
    for version, name in components:
        if version:
            names_by_version.setdefault(version, []).append(name)
    if len(names_by_version) < 2:
        return []
    words = []
    for version, names in sorted(names_by_version.items()):
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        words.append(f"{version} ({', '.join(sorted(names)[:_MOST_NAMES])}{more})")
    return [f"{subject} differ: {', '.join(words)}"]


def _clock_problems(rows: list[ComponentRow]) -> list[str]:
    """Clocks that differ by more than half a frame of a source, beyond the error of the measurement."""
    rates = [row.rate_hz for row in rows if row.role == "source" and row.rate_hz]
    fastest = max(rates, default=USUAL_RATE_HZ)
    problems = []
    for row in rows:
        if row.clock_s is None or row.clock_error_s is None or row.role in {"viewer", "recorder"}:
            continue
        limit = 0.5 / (row.rate_hz if row.role == "source" and row.rate_hz else fastest)
        if abs(row.clock_s) - row.clock_error_s > limit:
            way = "ahead of" if row.clock_s > 0 else "behind"
            host = f" ({row.host})" if row.host else ""
            problems.append(
                f"the clock of {row.role} {row.name}{host} is {1e3 * abs(row.clock_s):.0f} ms {way} "
                f"the service's, more than half a frame ({1e3 * limit:.0f} ms)"
            )
    return problems
