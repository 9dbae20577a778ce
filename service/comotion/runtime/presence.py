"""The liveliness tokens of a scene's services in; out comes whether this one may speak for the scene.

Without an election (:mod:`.election`) one service has a scene, and the others refuse:

- The token of a service is ``live/service/<name>-<claim>-<session>``, where the claim is the time at which it
  was declared, ns since the Unix epoch in 16 hex digits.
- A service that starts looks for tokens of others before it declares its own, and refuses if there are any.
  It waits as long as the token of a service that was killed or stopped may take to vanish.
- Of those that start together, the oldest claim has the scene. The others refuse before they publish.
- A service that was cut off, because it was stopped or had no router, may have a successor. It withdraws its
  token, publishes nothing until it has been connected again for a second, and is then as one that starts.
- A service that speaks and finds an older claim for longer than a second yields.
"""

import logging
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from zenoh import SampleKind
from zenoh.handlers import RingChannel

from comotion_schemas.component import Component
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, last_chunk
from comotion_schemas.transport import LEASE_MS

_SECOND_NS = 1_000_000_000
_LEASE_NS = LEASE_MS * 1_000_000
# Until the token of a service that was stopped has vanished.
_PATIENCE_S = LEASE_MS / 1000 + 1.0
_POLL_S = 0.02
# Share of a processor below which a process that was not heard of did not run: a slow update takes more.
_AT_WORK = 0.05
# Until the tokens of all others have come in; and until one that was cut off has withdrawn its own.
_SETTLE_NS = _SECOND_NS
# Tokens that come in between two looks.
_MOST_TOKENS = 256
_MAX_OTHERS = 256
_TOKEN = re.compile(r"(.+)-([0-9a-f]{16})-[0-9a-f]{16}")
_NEVER_NS = 1 << 64
_log = logging.getLogger(__name__)


class SceneTakenError(KnownError):
    """Another service has the scene."""


@dataclass(frozen=True, order=True)
class Claim:
    """A service's token: since when, ns, and its name in the key."""

    since_ns: int
    token: str

    @classmethod
    def read(cls, token: str) -> Self:
        """Parse the last chunk of the key; a token of another form makes no service yield that runs."""
        found = _TOKEN.fullmatch(token)
        return cls(int(found[2], 16) if found else _NEVER_NS, token)

    @property
    def name(self) -> str:
        """Name of the service."""
        found = _TOKEN.fullmatch(self.token)
        return found[1] if found else self.token


class Presence:
    """Claims the scene of a component that stands alone; a context manager.

    `epoch` is 0 while the service may publish and None while it must not.

    Parameters
    ----------
    component
        The open component, which has declared no token.
    """

    def __init__(self, component: Component) -> None:
        self._component = component
        self._own: Claim | None = None
        self._token: Any = None
        self._others: dict[str, Claim] = {}
        self._older_ns: int | None = None
        self._looked_ns = self._connected_ns = time.monotonic_ns()
        self._used_ns = time.process_time_ns()
        self._speaks_ns: int | None = None
        self._is_router = component.listens
        liveliness = component.session.liveliness()
        self._tokens: Any = liveliness.declare_subscriber(
            component.keys.all_live("service"), RingChannel(_MOST_TOKENS), history=True
        )

    @property
    def epoch(self) -> int | None:
        """0 while the service speaks, None while it is silent; looks at the tokens first.

        Raises
        ------
        SceneTakenError
            If it has to yield.
        """
        self.look(time.monotonic_ns())
        return None if self._speaks_ns is None or self._looked_ns < self._speaks_ns else 0

    def __enter__(self) -> Self:
        """Wait for the tokens of services that are gone to vanish, then claim the scene.

        Raises
        ------
        SceneTakenError
            If another service has it.
        """
        deadline = time.monotonic() + _PATIENCE_S
        for reply in self._component.session.liveliness().get(self._component.keys.all_live("service")):
            if reply.ok is not None:
                self._note(last_chunk(str(reply.ok.key_expr)), present=True)
        self._drain()
        while self._others and time.monotonic() < deadline and not self._component.stop.wait(_POLL_S):
            self._drain()
        if self._others and not self._component.stop.is_set():
            raise self._taken(min(self._others.values()))
        self._claim()
        self._looked_ns = self._speaks_ns = time.monotonic_ns()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._withdraw()
        self._tokens.undeclare()

    def require(self) -> None:
        """Check the claim right before the first update.

        Raises
        ------
        SceneTakenError
            If a service that has started at the same time has the older claim.
        """
        self._drain()
        for other in self._older():
            raise self._taken(other)
        # What came before the loop took its time.
        self._looked_ns = self._connected_ns = time.monotonic_ns()
        self._used_ns = time.process_time_ns()

    def look(self, monotonic_ns: int) -> None:
        """Take in the tokens of others; called at every turn of the loop.

        Raises
        ------
        SceneTakenError
            If this service has to yield.
        """
        was_ns, self._looked_ns = self._looked_ns, monotonic_ns
        if self._was_cut_off(monotonic_ns - was_ns, monotonic_ns):
            _log.warning("this service was cut off: it looks whether another one has its scene")
            self._withdraw()
            self._speaks_ns = None
        self._drain()
        if self._speaks_ns is None:
            self._speaks_ns = monotonic_ns + _SETTLE_NS
        elif self._own is None:
            self._return(monotonic_ns)
        else:
            self._defend(monotonic_ns)

    def _was_cut_off(self, gap_ns: int, monotonic_ns: int) -> bool:
        """Whether its token may have vanished meanwhile; `gap_ns` is the time since the last look."""
        before_ns, self._used_ns = self._used_ns, time.process_time_ns()
        if gap_ns > _LEASE_NS and self._used_ns - before_ns < _AT_WORK * gap_ns:
            return True
        if not self._is_connected():
            return False
        before_ns, self._connected_ns = self._connected_ns, monotonic_ns
        return monotonic_ns - before_ns > max(_LEASE_NS, gap_ns + _SECOND_NS)

    def _return(self, monotonic_ns: int) -> None:
        """Claim the scene anew, if it has been connected for long enough and nobody else has it."""
        if not self._is_connected():
            self._speaks_ns = monotonic_ns + _SETTLE_NS
        elif self._speaks_ns is not None and monotonic_ns >= self._speaks_ns:
            for other in self._others.values():
                raise self._taken(other)
            self._claim()

    def _defend(self, monotonic_ns: int) -> None:
        older = next(self._older(), None)
        if older is None:
            self._older_ns = None
        elif self._older_ns is None:
            self._older_ns = monotonic_ns
        elif monotonic_ns - self._older_ns > _SETTLE_NS:
            raise self._taken(older)

    def _older(self) -> Iterator[Claim]:
        own = self._own
        return (other for other in sorted(self._others.values()) if own is not None and other < own)

    def _drain(self) -> None:
        while (sample := self._tokens.try_recv()) is not None:
            self._note(last_chunk(str(sample.key_expr)), present=sample.kind == SampleKind.PUT)

    def _note(self, token: str, *, present: bool) -> None:
        # Its own session is in all of its tokens, those that it has withdrawn too.
        if token.endswith(self._component.session_id):
            return
        if present and len(self._others) < _MAX_OTHERS:
            self._others[token] = Claim.read(token)
        elif not present:
            self._others.pop(token, None)

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
        return self._is_router or bool(self._component.session.info.routers_zid())

    def _taken(self, other: Claim) -> SceneTakenError:
        return SceneTakenError(f"scene {self._component.scene!r} is already served by {other.name!r}")
