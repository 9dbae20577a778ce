"""Decides by liveliness tokens whether this service may publish for its scene.

Without an election (:mod:`.standby`) one service has a scene, and the others refuse:

- The token of a service is ``live/service/<name>-<claim>-<session>``, where the claim is the time at which it
  was declared, ns since the Unix epoch in 16 hex digits.
- A service speaks while its updates come, one newer than the other. A token alone makes no service yield.
- A service that starts looks for tokens of others before it declares its own, and refuses if one of them
  speaks. It waits as long as the token of a service that was killed or stopped may take to vanish.
- Of those that start together, the oldest claim has the scene. The others refuse before they publish: they
  wait some seconds for the first update of an older claim of the last minutes.
- A service that was cut off, because it was stopped or had no router, may have a successor. It withdraws its
  token, publishes nothing until it has been connected again for a second, and is then as one that starts.
- A service that finds that an older claim speaks for longer than a second yields.
"""

import logging
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple, Self

from zenoh import Locality, Sample, SampleKind
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, HypothesisUpdate, decode_as
from comotion_schemas.component import Component
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import TOKEN, TOKEN_NAME_CHARACTERS, publisher_of
from comotion_schemas.transport import LEASE_MS

_SECOND_NS = 1_000_000_000
_LEASE_NS = LEASE_MS * 1_000_000
# Until the token of a service that was stopped has vanished.
_PATIENCE_S = LEASE_MS / 1000 + 1.0
_POLL_S = 0.02
# Share of a processor below which a process was stopped and not busy: a slow update takes more.
_AT_WORK = 0.05
# Until the tokens of all others have come in; and until one that was cut off has withdrawn its own.
_SETTLE_NS = _SECOND_NS
# A service that has just claimed the scene has so long until its first update; it may be compiling.
_STARTING_NS = 300 * _SECOND_NS
_START_S = 10.0
# Silence after which a service speaks no more: so many of its periods, at least so long.
_SILENT_PERIODS, _SILENT_NS = 3, _SECOND_NS
# Tokens, and updates of others, that are held between two readings; and others that are remembered.
_MOST_TOKENS = _MAX_OTHERS = 256
_MOST_UPDATES = 4
_NEVER_NS = 1 << 64
_log = logging.getLogger(__name__)


class SceneTakenError(KnownError):
    """Another service has the scene."""


@dataclass(frozen=True, order=True)
class Claim:
    """A service's token: since when, ns, the last chunk of its key, and the name and session in it."""

    since_ns: int
    token: str
    name: str
    session: str

    @classmethod
    def read(cls, token: str) -> Self:
        """Parse the last chunk of the key; a token of another form makes no service yield that runs."""
        match = TOKEN.fullmatch(token)
        if match is None:
            return cls(_NEVER_NS, token, token, "")
        return cls(int(match[2], 16), token, match[1], match[3])


class _Activity(NamedTuple):
    """Number of the last update of another service, until when it counts, and whether one came before it."""

    seq: int
    until_ns: int
    is_newer: bool


class Presence:
    """Claims the scene of a component that stands alone and has declared no token; a context manager.

    `epoch` is 0 while the service may publish and None while it must not.
    """

    def __init__(self, component: Component) -> None:
        self._component = component
        self._own: Claim | None = None
        self._token: Any = None
        self._others: dict[str, Claim] = {}
        self._activities: dict[str, _Activity] = {}
        self._older_ns: int | None = None
        self._looked_ns = self._connected_ns = time.monotonic_ns()
        self._processor_ns = time.process_time_ns()
        self._speaks_ns: int | None = None
        liveliness = component.session.liveliness()
        self._tokens: Any = liveliness.declare_subscriber(
            component.keys.all_live("service"), RingChannel(_MOST_TOKENS), history=True
        )
        self._updates = component.session.declare_subscriber(
            component.keys.hypotheses, RingChannel(_MOST_UPDATES), allowed_origin=Locality.REMOTE
        )

    @property
    def epoch(self) -> int | None:
        """0 while the service speaks, None while it is silent; looks at the tokens first, and may yield."""
        self.look(time.monotonic_ns())
        return None if self._speaks_ns is None or self._looked_ns < self._speaks_ns else 0

    def __enter__(self) -> Self:
        """Wait for the tokens of services that are gone to vanish, then claim the scene.

        Raises SceneTakenError if another service has it.
        """
        for reply in self._component.session.liveliness().get(self._component.keys.all_live("service")):
            if reply.ok is not None:
                self._note(publisher_of(str(reply.ok.key_expr)), present=True)
        self._wait_while(self._others.values, _PATIENCE_S)
        self._claim()
        self._looked_ns = self._speaks_ns = time.monotonic_ns()
        return self

    def __exit__(self, *exception: object) -> None:
        self._withdraw()

    def require(self) -> None:
        """Check the claim right before the first update.

        Raises SceneTakenError if a service that has started at the same time has the older claim.
        """
        self._wait_while(
            lambda: [c for c in self._older() if abs(time.time_ns() - c.since_ns) < _STARTING_NS], _START_S
        )
        self._refuse_beside(self._older())
        # The steps before the loop have taken some time.
        self._looked_ns = self._connected_ns = time.monotonic_ns()
        self._processor_ns = time.process_time_ns()

    def _wait_while(self, others: Callable[[], Collection[Claim]], seconds: float) -> None:
        """Wait until no others are there, for some time at most; refuse if one of them speaks."""
        deadline = time.monotonic() + seconds
        self._drain()
        while others() and time.monotonic() < deadline and not self._component.stop.wait(_POLL_S):
            self._drain()
            self._refuse_beside(others())

    def look(self, monotonic_ns: int) -> None:
        """Take in the tokens of others, at every turn of the loop; raises SceneTakenError where it yields."""
        last_look_ns, self._looked_ns = self._looked_ns, monotonic_ns
        if self._was_cut_off(monotonic_ns - last_look_ns, monotonic_ns):
            _log.warning("this service was cut off: it looks whether another one has its scene")
            self._withdraw()
            self._speaks_ns = None
        self._drain()
        if self._speaks_ns is None:
            self._speaks_ns = monotonic_ns + _SETTLE_NS
        elif self._own is None:
            self._return(monotonic_ns)
        elif (older := next(filter(self._speaks, self._older()), None)) is None:
            self._older_ns = None
        elif self._older_ns is None:
            self._older_ns = monotonic_ns
        elif monotonic_ns - self._older_ns > _SETTLE_NS:
            raise self._taken(older)

    def _was_cut_off(self, gap_ns: int, monotonic_ns: int) -> bool:
        """Whether its token may have vanished meanwhile; `gap_ns` is the time since the last look."""
        last_ns, self._processor_ns = self._processor_ns, time.process_time_ns()
        if gap_ns > _LEASE_NS and self._processor_ns - last_ns < _AT_WORK * gap_ns:
            return True
        if not self._is_connected():
            return False
        last_ns, self._connected_ns = self._connected_ns, monotonic_ns
        return monotonic_ns - last_ns > max(_LEASE_NS, gap_ns + _SECOND_NS)

    def _return(self, monotonic_ns: int) -> None:
        """Claim the scene anew, if it has been connected for long enough and no other service has it."""
        if not self._is_connected():
            self._speaks_ns = monotonic_ns + _SETTLE_NS
        elif self._speaks_ns is not None and monotonic_ns >= self._speaks_ns:
            self._refuse_beside(self._others.values())
            _log.info("no other service speaks for the scene: this one goes on")
            self._claim()

    def _older(self) -> Iterator[Claim]:
        own = self._own
        return (other for other in sorted(self._others.values()) if own is not None and other < own)

    def _speaks(self, other: Claim) -> bool:
        """Whether updates come of another service, one newer than the other."""
        activity = self._activities.get(other.session)
        return activity is not None and activity.is_newer and time.monotonic_ns() < activity.until_ns

    def _refuse_beside(self, others: Iterable[Claim]) -> None:
        for other in others:
            if self._speaks(other):
                raise self._taken(other)

    def _drain(self) -> None:
        for sample in islice(iter(self._tokens.try_recv, None), _MOST_TOKENS):
            self._note(publisher_of(str(sample.key_expr)), present=sample.kind == SampleKind.PUT)
        for update in islice(iter(self._updates.try_recv, None), _MOST_UPDATES):
            if self._others:
                self._hear(update)

    def _hear(self, sample: Sample) -> None:
        """Take note of an update of a service that has a token."""
        try:
            update = decode_as(HypothesisUpdate, sample.payload.to_bytes())
        except DecodeError:
            return
        sessions = {other.session for other in self._others.values()}
        sender = update.session if update.session in sessions else ""
        previous, lasts_ns = self._activities.get(sender), max(_SILENT_NS, _SILENT_PERIODS * update.period_ns)
        is_newer = previous is not None and update.seq > previous.seq
        self._activities[sender] = _Activity(update.seq, time.monotonic_ns() + lasts_ns, is_newer)

    def _note(self, token: str, *, present: bool) -> None:
        # Its own session is in all of its tokens, those that it has withdrawn too.
        if token.endswith(self._component.session_id):
            return
        if present and len(self._others) < _MAX_OTHERS:
            self._others[token] = Claim.read(token)
        elif not present:
            self._others.pop(token, None)
            self._activities.pop(Claim.read(token).session, None)

    def _claim(self) -> None:
        component = self._component
        name = f"{component.name[:TOKEN_NAME_CHARACTERS]}-{time.time_ns():016x}-{component.session_id}"
        self._own = Claim.read(name)
        self._token = component.session.liveliness().declare_token(component.keys.live("service", name))

    def _withdraw(self) -> None:
        if self._token is not None:
            self._token.undeclare()
        self._token = self._own = None

    def _is_connected(self) -> bool:
        return self._component.listens or bool(self._component.session.info.routers_zid())

    def _taken(self, other: Claim) -> SceneTakenError:
        return SceneTakenError(f"scene {self._component.scene!r} is already served by {other.name!r}")
