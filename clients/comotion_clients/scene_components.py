"""The components of a scene, of their tokens, Statuses and messages. Pure.

The base of what `comotion watch`, `view` and `status` know of a scene. The caller passes the time: `now` and
`arrived` are seconds of one clock.
"""

from collections import deque
from dataclasses import dataclass, field

from comotion_schemas import HypothesisUpdate, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, token_name
from comotion_schemas.sequence import SequenceCounter
from comotion_schemas.text import shown

RATE_SPAN_S = 3.0
"""A rate is the mean over this time."""
RATE_MIN_SPAN_S = 0.5
"""Without arrivals over this time the rate is unknown: the first messages may come in a burst."""
STALL_S = 1.0
"""A stream is stalled after this time or :data:`STALL_PERIODS` periods, whichever is longer."""
STALL_PERIODS = 3
LOSS_SHOWN_S = 10.0
"""How long a loss is highlighted."""
MOST_CHARACTERS, MOST_TEXT = 80, 500
"""Bounds on what texts of one component or router may take of a screen: of a cell, and of a line."""
MOST = 4096
"""Components and routers that are remembered; a scene has hundreds at most."""


@dataclass
class Stream:
    """Arrivals of one publisher: rate, age and number of lost messages."""

    lost: int = 0
    lost_at: float = float("-inf")
    arrivals: deque[float] = field(default_factory=deque)

    def arrive(self, lost: int, now: float) -> None:
        """Take note of a message with which `lost` more are missing than before, or -1 for one less."""
        self.lost += lost
        if lost > 0:
            self.lost_at = now
        self.arrivals.append(now)
        while now - self.arrivals[0] > RATE_SPAN_S and len(self.arrivals) > 2:
            self.arrivals.popleft()

    def age(self, now: float) -> float:
        """Seconds since the last arrival."""
        return max(now - self.arrivals[-1], 0.0) if self.arrivals else float("inf")

    def period(self) -> float:
        """Mean seconds between the recent arrivals; 0 until there are two."""
        if len(self.arrivals) < 2:
            return 0.0
        return (self.arrivals[-1] - self.arrivals[0]) / (len(self.arrivals) - 1)

    def stalled(self, now: float) -> bool:
        """Whether the last arrival is too long ago for the period of the stream."""
        return self.age(now) > max(STALL_S, STALL_PERIODS * self.period())

    def rate(self, now: float) -> float:
        """Messages per second; 0 while stalled or unknown."""
        known = len(self.arrivals) > 1 and self.arrivals[-1] - self.arrivals[0] >= RATE_MIN_SPAN_S
        return 1.0 / self.period() if known and not self.stalled(now) else 0.0

    def losing(self, now: float) -> bool:
        """Whether a message was lost in the last 10 s."""
        return now - self.lost_at < LOSS_SHOWN_S


@dataclass
class ComponentRecord:
    """What is known of one component.

    `tokens`: roles of its tokens, of which it holds one while `present`; `gone_at`: when it left;
    `stream`, `space`, `lag`: of the batches of a source.
    """

    status: Status | None = None
    arrived: float = float("-inf")
    tokens: set[str] = field(default_factory=set)
    present: bool = False
    gone_at: float | None = None
    clock: ClockBounds = field(default_factory=ClockBounds)
    stream: Stream = field(default_factory=Stream)
    space: str = ""
    lag: float = float("nan")

    @property
    def role(self) -> str:
        """The role of its token; what its Status says counts only without one, or among several."""
        said = "" if self.status is None else self.status.role
        return said if not self.tokens or said in self.tokens else min(self.tokens)


class ComponentsModel:
    """Accumulates what is heard of a scene.

    Parameters
    ----------
    scene
        Name of the scene.
    """

    def __init__(self, scene: str) -> None:
        self.scene = scene
        self._components: dict[str, ComponentRecord] = {}
        self._sequences = SequenceCounter()
        self._updates = Stream()
        self._update: HypothesisUpdate | None = None

    @property
    def update(self) -> HypothesisUpdate | None:
        """The newest update."""
        return self._update

    def on_status(self, status: Status, arrived: float = 0.0) -> None:
        """Add a Status; one from a publisher's cache is older than its arrival tells."""
        record = self._record(status.component)
        record.status, record.arrived = status, arrived
        record.clock.on_stamp(status.stamp_ns / 1e9 - arrived)

    def on_presence(self, role: str, token: str, *, alive: bool, now: float = 0.0) -> None:
        """Add a change of a liveliness token; `token` is its last chunk."""
        name = self._full_name(token_name(token)) if role == "service" else token
        if alive:
            record = self._record(name)
            record.tokens.add(role)
            record.present, record.gone_at = True, None
        elif name in self._components:
            self._components[name].present, self._components[name].gone_at = False, now

    def add_update(self, update: HypothesisUpdate, arrived: float) -> None:
        """Add an update."""
        self._updates.arrive(self._sequences.sight("", update.session, update.seq).lost, arrived)
        self._update = update

    @property
    def service(self) -> Status | None:
        """Status of the service that speaks: of the highest epoch, and the newest."""
        services = [
            record for record in self._components.values() if record.status and record.role == "service"
        ]
        # Where services have tokens, who has none is no service.
        holding = [record for record in services if record.tokens] or services
        speaking = [
            record.status for record in holding if record.status and record.status.replica != "standby"
        ]
        return max(speaking, key=lambda status: (status.epoch, status.stamp_ns), default=None)

    def _record(self, name: str) -> ComponentRecord:
        """What is known of a component; one too many is not remembered."""
        if len(self._components) >= MOST and name not in self._components:
            return ComponentRecord()
        return self._components.setdefault(name, ComponentRecord())

    def _full_name(self, short: str) -> str:
        known = (name for name, record in self._components.items() if record.role == "service")
        return next((name for name in known if name[:TOKEN_NAME_CHARACTERS] == short), short)


def in_cell(value: object) -> str:
    """Text of a component for a cell of a table."""
    return shown(str(value), MOST_CHARACTERS)


def in_line(text: str) -> str:
    """Text of a component for a line."""
    return shown(text, MOST_TEXT)
