"""Watches a soak: accounts of batches, times without updates, ids that changed, ids that were used twice.

The truth is in the ids of the features: see :mod:`.load`. The label of a body is the hypothesis that most
of its features have. A label counts once it has lasted for a while and each body has a hypothesis of its own.

An audit compares two moments at which all sources paused and the service had time to count: what was sent in
between is what the service received or knows to be lost. Between them the same service must have run.
"""

import time
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from comotion_clients.subscription import Subscription
from comotion_schemas import UNDETERMINED, HypothesisUpdate, Status

from ..processes import Managed
from ..system import System
from .load import BODIES, ID_STEP, KINDS

_FATES = ("fused", "partly_late", "late", "duplicates", "overflow", "waiting")


@dataclass(frozen=True)
class Moment:
    """A moment at which all sources paused."""

    service: str  # its session
    # Sequence numbers used, by source and session, and batches sent again.
    sent: dict[tuple[str, str], int]
    # Batches of these sources that the service counts. What others send, hostile ones too, is none of it.
    received: int
    lost: int
    waiting: int
    # Of anybody: received and in no fate.
    unsettled: int
    # Sent, and unknown to the service yet: after its start, until it hears of each source.
    unheard: int = 0


@dataclass(frozen=True)
class Audit:
    """Two moments compared: batches sent in between, those lost on purpose and sent again too."""

    sent: int
    missing: int  # neither received nor known to be lost; negative: counted twice
    unsettled: int  # received, but in no fate
    # Whether no source ended in between: what a killed process has handed over last, nobody knows.
    is_exact: bool


def moment(service: str, reply: Mapping[str, Any], sources: Iterable[Managed]) -> Moment:
    """Take down a moment: what a service says, by its session, and the sources of what they have sent."""
    reported = ((one.name, one.account) for one in sources if "session" in one.account)
    declared = {(name, account["session"]): account for name, account in reported}
    # A source whose session is not known has overflowed before anything of it was read.
    known = declared.keys() | {(name, "") for name, _ in declared}
    mine = [one for one in reply["accounts"] if (one["source"], one["session"]) in known]
    sent = {key: account["sent"] + account["repeated"] for key, account in declared.items()}
    heard: dict[str, int] = {}
    for one in mine:
        heard[one["source"]] = heard.get(one["source"], 0) + one["batches"] + (one["lost"] or 0)
    total = reply["total"]
    settled = sum(total[fate] for fate in _FATES) + sum(total["rejected"].values())
    return Moment(
        service=service,
        sent=sent,
        received=sum(one["batches"] for one in mine),
        lost=sum(one["lost"] or 0 for one in mine),
        waiting=sum(one["waiting"] for one in mine),
        unsettled=total["batches"] - settled,
        unheard=sum(max(count - heard.get(name, 0), 0) for (name, _), count in sent.items()),
    )


def audit(before: Moment, after: Moment) -> Audit | None:
    """Compare two moments; None if another service ran in between."""
    if before.service != after.service:
        return None
    sent = sum(count - before.sent.get(key, 0) for key, count in after.sent.items())
    seen = after.received - before.received + after.lost - before.lost
    return Audit(sent, sent - seen, after.unsettled, before.sent.keys() == after.sent.keys())


LATE_PERIODS = 3
# A body has a label when so many of its features agree, for so many seconds.
_AGREE = 0.8
_SETTLED_S = 2.0

Body = tuple[str, int]


@dataclass(frozen=True)
class Gap:
    """A time without updates: when it ended (s from the start), and how long it was, in s."""

    at_s: float
    seconds: float


@dataclass
class Findings:
    """What has been seen."""

    updates: int = 0
    sessions: list[str] = field(default_factory=list)
    # Updates that were due and did not come, and times without any of more than three periods.
    missed: int = 0
    gaps: list[Gap] = field(default_factory=list)
    # Bodies that changed their hypothesis: when (s), which, from and to.
    changes: list[tuple[float, str, int, int]] = field(default_factory=list)
    # Ids that came twice, with another birth.
    reused: list[int] = field(default_factory=list)
    latest_id: int = 0


class Monitor:
    """Follows a scene through two subscriptions."""

    def __init__(
        self, updates: Subscription[HypothesisUpdate], statuses: Subscription[Status], started_s: float
    ) -> None:
        self._updates = updates
        self._statuses = statuses
        self._started_s = started_s
        self.arrived_s: list[float] = []
        # Updates that were due since the count began, and those that came.
        self._expected, self._counted = 0.0, 0
        self._births: dict[int, int] = {}
        self._pending: dict[Body, tuple[int, float]] = {}
        self.labels: dict[Body, int] = {}
        self.findings = Findings()
        self.status: Status | None = None
        self.last: HypothesisUpdate | None = None

    def poll(self) -> None:
        """Take in what has arrived."""
        for arrived, update in self._updates.drain():
            self._on_update(update, arrived)
        for _, status in self._statuses.drain():
            if status.role == "service":
                self.status = status

    def begin(self) -> None:
        """Forget gaps and missed updates of the time in which the system was starting."""
        self.findings.gaps.clear()
        self._expected, self._counted = 0.0, 0

    @property
    def is_sorted_out(self) -> bool:
        """Whether every body of the last update has a hypothesis of its own."""
        if self.last is None:
            return False
        found = _labels(self.last)
        spaces = Counter(space for space, _ in found)
        apart = len(set(found.values())) == len(found)
        return apart and all(spaces[kind.space] == BODIES for kind in KINDS.values())

    def _on_update(self, update: HypothesisUpdate, arrived_s: float) -> None:
        found, period_s = self.findings, update.period_ns * 1e-9
        at_s = arrived_s - self._started_s
        if self.arrived_s:
            seconds = arrived_s - self.arrived_s[-1]
            self._expected += seconds / period_s
            if seconds > LATE_PERIODS * period_s:
                found.gaps.append(Gap(round(at_s, 2), round(seconds, 3)))
        self.arrived_s.append(arrived_s)
        self.last = update
        found.updates += 1
        found.missed = max(0, round(self._expected) - self._counted)
        self._counted += 1
        if update.session not in found.sessions:
            found.sessions.append(update.session)
        self._check_ids(update)
        self._check_bodies(update, at_s)

    def _check_ids(self, update: HypothesisUpdate) -> None:
        births = {one.id: one.born_ns for one in update.hypotheses}
        moved = {one: born_ns - self._births.get(one, born_ns) for one, born_ns in births.items()}
        known = [one for one in births if one in self._births]
        # When the scene follows the clocks of its sources, all births move with its time, by the same.
        followed = len(known) > 1 and len({moved[one] for one in known}) == 1
        self.findings.reused += [one for one in births if moved[one] and not followed]
        self._births |= births
        self.findings.latest_id = max(self.findings.latest_id, *births, 0)

    def _check_bodies(self, update: HypothesisUpdate, at_s: float) -> None:
        found = _labels(update)
        if len(set(found.values())) < len(found):
            self._pending.clear()  # bodies are together: nobody knows whose id it is
            return
        for body, label in found.items():
            before, since_s = self._pending.get(body, (label, at_s))
            self._pending[body] = (label, since_s if before == label else at_s)
            if at_s - self._pending[body][1] < _SETTLED_S:
                continue
            known = self.labels.get(body)
            if known is not None and known != label:
                self.findings.changes.append((round(at_s, 1), f"{body[0]} {body[1]}", known, label))
            self.labels[body] = label


class Watched(System):
    """A system that a monitor watches from its start on; `started_s` is on the monotonic clock."""

    def _begin(self) -> None:
        self.started_s = time.monotonic()
        updates, statuses = self.subscribe(HypothesisUpdate), self.subscribe(Status)
        self.monitor = Monitor(updates, statuses, self.started_s)

    def turn(self) -> None:
        """Wait for a moment, and take in what has arrived."""
        super().turn()
        self.monitor.poll()


def votes(update: HypothesisUpdate, sources: Collection[str] = KINDS) -> dict[Body, Counter[int]]:
    """For each body the labels of its features, of these sources, and how many have each."""
    found: dict[Body, Counter[int]] = {}
    for source, name in enumerate(one.name for one in update.sources):
        if name not in sources:
            continue
        mine = update.track_source == source
        bodies = update.track_id[mine] // ID_STEP
        labels = update.track_hypothesis[mine]
        for body in range(BODIES):
            counts = found.setdefault((KINDS[name].space, body), Counter())
            counts.update(labels[bodies == body].tolist())
    return found


def _labels(update: HypothesisUpdate) -> dict[Body, int]:
    """Hypothesis of each body that its features agree on."""
    most = (
        (body, *one, counts.total())
        for body, counts in votes(update).items()
        for one in counts.most_common(1)
    )
    return {body: label for body, label, n, of in most if label != UNDETERMINED and n >= _AGREE * of}
