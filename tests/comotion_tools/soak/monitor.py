"""Watches a soak: accounts of batches, times without updates, ids that changed, ids that were used twice.

The truth is in the ids of the features: see :mod:`.load`. The label of a body is the hypothesis that most
of its features have. A label counts once it has lasted for a while and each body has a hypothesis of its own.

An audit compares two moments at which all sources paused and the service had time to count: what was sent in
between is what the service received or knows to be lost. Between them the same service must have run.
"""

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from comotion_clients.subscription import Subscription
from comotion_schemas import UNDETERMINED, HypothesisUpdate, Status

from ..processes import Managed
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
    fused: int
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
    reporting = [source for source in sources if "session" in source.account]
    declared = {(source.name, source.account["session"]): source.account for source in reporting}
    # A source whose session is not known has overflowed before anything of it was read.
    sessions = declared.keys() | {(name, "") for name, _ in declared}
    counted = [
        account for account in reply["accounts"] if (account["source"], account["session"]) in sessions
    ]
    sent = {key: account["sent"] + account["repeated"] for key, account in declared.items()}
    received: dict[str, int] = {}
    for account in counted:
        received[account["source"]] = (
            received.get(account["source"], 0) + account["batches"] + (account["lost"] or 0)
        )
    total = reply["total"]
    settled = sum(total[fate] for fate in _FATES) + sum(total["rejected"].values())
    return Moment(
        service=service,
        sent=sent,
        received=sum(account["batches"] for account in counted),
        fused=sum(account["fused"] for account in counted),
        lost=sum(account["lost"] or 0 for account in counted),
        waiting=sum(account["waiting"] for account in counted),
        unsettled=total["batches"] - settled,
        unheard=sum(max(count - received.get(name, 0), 0) for (name, _), count in sent.items()),
    )


def audit(start: Moment, end: Moment) -> Audit | None:
    """Compare two moments; None if another service ran in between."""
    if start.service != end.service:
        return None
    sent = sum(count - start.sent.get(key, 0) for key, count in end.sent.items())
    seen = end.received - start.received + end.lost - start.lost
    return Audit(sent, sent - seen, end.unsettled, start.sent.keys() == end.sent.keys())


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
        # From the stamp of the last batch in an update to its receipt.
        self.ages_ms: list[float] = []
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
        """Forget gaps, ages and missed updates of the time in which the system was starting."""
        self.findings.gaps.clear()
        self.ages_ms.clear()
        self._expected, self._counted = 0.0, 0

    @property
    def last_batch_ms(self) -> list[float]:
        """Ages of the last batches in updates at receipt: median, 99th percentile and largest, ms."""
        return [round(float(age), 1) for age in np.percentile(self.ages_ms or [np.nan], (50, 99, 100))]

    @property
    def is_sorted_out(self) -> bool:
        """Whether every body of the last update has a hypothesis of its own."""
        if self.last is None:
            return False
        labels = _labels(self.last)
        spaces = Counter(space for space, _ in labels)
        apart = len(set(labels.values())) == len(labels)
        return apart and all(spaces[kind.space] == BODIES for kind in KINDS.values())

    def _on_update(self, update: HypothesisUpdate, arrived_s: float) -> None:
        findings, period_s = self.findings, update.period_ns * 1e-9
        at_s = arrived_s - self._started_s
        if self.arrived_s:
            seconds = arrived_s - self.arrived_s[-1]
            self._expected += seconds / period_s
            if seconds > LATE_PERIODS * period_s:
                findings.gaps.append(Gap(round(at_s, 2), round(seconds, 3)))
        self.arrived_s.append(arrived_s)
        self.ages_ms.append(1e3 * (arrived_s + time.time() - time.monotonic()) - update.stamp_ns * 1e-6)
        self.last = update
        findings.updates += 1
        findings.missed = max(0, round(self._expected) - self._counted)
        self._counted += 1
        if update.session not in findings.sessions:
            findings.sessions.append(update.session)
        self._check_ids(update)
        self._check_bodies(update, at_s)

    def _check_ids(self, update: HypothesisUpdate) -> None:
        births = {hypothesis.id: hypothesis.born_ns for hypothesis in update.hypotheses}
        moved = {
            identity: born_ns - self._births.get(identity, born_ns) for identity, born_ns in births.items()
        }
        listed = [number for number in births if number in self._births]
        # When the scene follows the clocks of its sources, all births move with its time, by the same.
        followed = len(listed) > 1 and len({moved[number] for number in listed}) == 1
        self.findings.reused += [number for number in births if moved[number] and not followed]
        self._births |= births
        self.findings.latest_id = max(self.findings.latest_id, *births, 0)

    def _check_bodies(self, update: HypothesisUpdate, at_s: float) -> None:
        labels = _labels(update)
        if len(set(labels.values())) < len(labels):
            self._pending.clear()  # bodies are together: nobody knows whose id it is
            return
        for body, label in labels.items():
            pending, since_s = self._pending.get(body, (label, at_s))
            self._pending[body] = (label, since_s if pending == label else at_s)
            if at_s - self._pending[body][1] < _SETTLED_S:
                continue
            last = self.labels.get(body)
            if last is not None and last != label:
                self.findings.changes.append((round(at_s, 1), f"{body[0]} {body[1]}", last, label))
            self.labels[body] = label


def _labels(update: HypothesisUpdate) -> dict[Body, int]:
    """Hypothesis of each body that its features agree on."""
    counts_of: dict[Body, Counter[int]] = {}
    for source, name in enumerate(ref.name for ref in update.sources):
        if name in KINDS:
            rows = update.track_source == source
            bodies, labels = update.track_id[rows] // ID_STEP, update.track_hypothesis[rows]
            for body in range(BODIES):
                counts = counts_of.setdefault((KINDS[name].space, body), Counter())
                counts.update(labels[bodies == body].tolist())
    most = {body: counts.most_common(1)[0] for body, counts in counts_of.items() if counts}
    agreed = {body: label for body, (label, n) in most.items() if n >= _AGREE * counts_of[body].total()}
    return {body: label for body, label in agreed.items() if label != UNDETERMINED}
