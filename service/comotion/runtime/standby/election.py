"""Which of several services speaks for a scene: an etcd lease elects, its revision is the epoch.

The rules:

- The service that creates the key ``comotion/v1/leader/<scene>`` speaks. The key holds its name and session,
  and is bound to a lease that its owner renews.
- The revision that created the key is the epoch of its owner. Revisions only grow, so a later owner has a
  higher epoch. Clients drop updates of a lower one, and a service that hears a higher one falls silent.
- A standby that sees the owner's liveliness token vanish ends the owner's lease and creates the key anew.
  Without a token to watch (the host is gone with its router) the lease ends by itself.
- Where a network splits, each side sees the tokens of the other vanish. So a service that has the scene, or
  has just lost it, ends no lease; nor does a standby that etcd did not answer at that time.
- While etcd does not answer, no service is elected: the active service goes on, a standby stays silent.

A standby gives its hypotheses the ids of what the active service publishes.
"""

import logging
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Self

from zenoh import Sample, SampleKind
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, HypothesisUpdate, decode_as
from comotion_schemas.component import Component
from comotion_schemas.keys import publisher_of
from comotion_schemas.sequence import Epochs
from comotion_schemas.transport import declare_subscriber

from .etcd import Entry, Etcd, EtcdUnavailableError

if TYPE_CHECKING:  # agents of a fleet need no fusion
    from ...fusion import Fusion
    from ..intake import Intake

# s; the shortest that etcd grants at its default election timeout.
DEFAULT_LEASE_S = 2
# Updates and tokens between two turns of the loop; the newest are kept.
_MOST_UPDATES = 64
# s; a router answers within milliseconds.
_TOKEN_TIMEOUT_S = 0.5
# Without an update for so long, the service queries the router for the token of the active service.
_QUIET_NS, _QUIET_PERIODS = 300_000_000, 3
# Zenoh takes a link for dead after 2 s; over one that works a source of 1 Hz is heard meanwhile.
_SILENT_NS = 1_500_000_000
_log = logging.getLogger(__name__)


class Election:
    """Takes part in the election of a scene, in a thread, while it is open.

    The thread alone uses the client of etcd; name, unique in its scene, and session are those of this
    service. A silent owner loses the key after `lease` seconds, at least 2.
    """

    def __init__(
        self, etcd: Etcd, scene: str, name: str, session: str, *, lease: int = DEFAULT_LEASE_S
    ) -> None:
        self.epoch: int | None = None
        self.leader: str | None = None
        self.error: str | None = None
        self._etcd = etcd
        self._key = f"comotion/v1/leader/{scene}"
        self._name, self._value = name, f"{name} {session}".encode()
        self._ttl = lease
        self._lease: int | None = None
        self._suspects: deque[str] = deque()
        self._spoke_s = -float("inf")
        self._fenced = False
        self._wake = threading.Event()
        self._stop = False
        self._thread = threading.Thread(target=self._run, name="election", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop = True
        self._wake.set()
        self._thread.join()

    def suspect(self, name: str) -> None:
        """Say that a service has gone: if it is the owner and this one a standby, its lease is ended."""
        if self.epoch is None and time.monotonic() - self._spoke_s > self._ttl:
            self._suspects.append(name)
            self._wake.set()

    def fence(self, epoch: int) -> None:
        """Say that an epoch has been heard: below it this service must not speak."""
        if self.epoch is not None and epoch > self.epoch:
            self._fenced = True
            self._wake.set()
            self._set(None)

    def _run(self) -> None:
        while not self._stop:
            try:
                self._step()
            except EtcdUnavailableError as error:
                if self.error is None:
                    doing = "standby stays silent" if self.epoch is None else "service goes on"
                    _log.warning("%s; nobody is elected meanwhile; this %s", error, doing)
                self.error = str(error)
            else:
                if self.error is not None:
                    _log.info("etcd answers again")
                self.error = None
            # Twice within a lease, should one answer be late; a standby learns of an ended lease as soon.
            self._wake.wait(self._ttl / 4)
            self._wake.clear()
        self._resign()

    def _step(self) -> None:
        etcd = self._etcd
        suspects = {self._suspects.popleft() for _ in range(len(self._suspects))} - {self._name}
        if self._fenced:
            self._resign()
            self._fenced = False
        if self._lease is not None and not etcd.renew(self._lease):
            self._lease = None
        owner = etcd.read(self._key)
        if owner is not None and _name(owner) in suspects:
            etcd.revoke(owner.lease)
            owner = etcd.read(self._key)
        if owner is not None:
            self.leader = _name(owner)
            is_own = owner.value == self._value and owner.lease == self._lease
            self._set(owner.created if is_own else None)
            return
        if self._lease is None:
            self._lease = etcd.grant(self._ttl)
        epoch = etcd.create(self._key, self._value, self._lease)
        if epoch is not None:
            self.leader = self._name
        self._set(epoch)

    def _resign(self) -> None:
        """Give the key back, so that a standby need not wait for the end of the lease."""
        self._set(None)
        lease, self._lease = self._lease, None
        if lease is not None:
            try:
                self._etcd.revoke(lease)
            except EtcdUnavailableError as error:
                _log.warning("could not give back the scene: %s", error)

    def _set(self, epoch: int | None) -> None:
        if epoch is None and self.epoch is not None:
            self._spoke_s = time.monotonic()
        self.epoch = epoch


class Follower:
    """Takes over the ids of the active service, and notices when it is gone.

    The fusion follows the ids of the active service; the intake knows whether observations arrive.
    """

    def __init__(self, component: Component, election: Election, fusion: "Fusion", intake: "Intake") -> None:
        self._component, self._election, self._fusion, self._intake = component, election, fusion, intake
        self._epochs = Epochs()
        self._queried_ns, self._period_ns = time.monotonic_ns(), 0
        keys, session = component.keys, component.session
        self._updates = declare_subscriber(session, keys.hypotheses, "hypotheses", RingChannel(_MOST_UPDATES))
        self._tokens = session.liveliness().declare_subscriber(
            keys.all_live("service"), RingChannel(_MOST_UPDATES)
        )

    def look(self) -> None:
        """Take in the updates that others have published, and which of them have gone."""
        newest = None
        for sample in iter(self._updates.try_recv, None):
            newest = self._accept(sample) or newest
        now_ns = time.monotonic_ns()
        if newest is not None:
            self._queried_ns, self._period_ns = now_ns, newest.period_ns
            if self._election.epoch is None:
                self._fusion.follow(newest)
        for token in iter(self._tokens.try_recv, None):
            if token.kind == SampleKind.DELETE:
                self._check(publisher_of(str(token.key_expr)))
        # Zenoh 1.10 does not report the end of every token.
        if now_ns - self._queried_ns > max(_QUIET_NS, _QUIET_PERIODS * self._period_ns):
            self._queried_ns = now_ns
            if self._election.leader is not None:
                self._check(self._election.leader)

    def _accept(self, sample: Sample) -> HypothesisUpdate | None:
        try:
            update = decode_as(HypothesisUpdate, sample.payload.to_bytes())
        except DecodeError as error:
            _log.debug("an update of another service is not valid: %s", error)
            return None
        now_s = time.monotonic()
        if update.session == self._component.session_id or not self._epochs.allows(update.epoch, now_s):
            return None
        self._epochs.follow(update.epoch, now_s)
        self._election.fence(update.epoch)
        return update

    def _check(self, name: str) -> None:
        """Report a service that is gone; the active service reports none, and none reports itself."""
        if self._election.epoch is None and name != self._component.name and self._is_gone(name):
            self._election.suspect(name)

    def _is_gone(self, name: str) -> bool:
        """Whether a token is gone for the router too: in a session that loses its router all seem gone.

        A replica that hears no source may be cut off itself, with its router, and takes no service for gone.
        """
        session = self._component.session
        silent_ns = time.monotonic_ns() - self._intake.heard_ns()
        if silent_ns > _SILENT_NS or not session.info.routers_zid():
            return False
        key = self._component.keys.live("service", name)
        alive = any(reply.ok is not None for reply in session.liveliness().get(key, timeout=_TOKEN_TIMEOUT_S))
        return not alive and bool(session.info.routers_zid())


def _name(owner: Entry) -> str:
    return owner.value.decode(errors="replace").partition(" ")[0]
