"""Events of confirmed hypotheses, from their sizes at each update.

A hypothesis is unconfirmed, present or absent. Each change must last for `confirm` seconds until it counts:

    unconfirmed -> present   it has enough members             born, or split
    present -> absent        it has no current member          absent
    present -> gone          its members are another's now     merged
    absent -> present        it has enough members again       returned
    absent -> gone           too long ago, or too many         ended

What reverts earlier makes no event. An unconfirmed hypothesis without current members vanishes silently.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from comotion_schemas import Event
from comotion_schemas.hypotheses import EventKind

from ..config import HypothesesConfig, to_ns
from ..saving import NOT_KEPT
from .records import Record

# "Those of the last 2 s" of docs/protocol.md.
EVENT_MEMORY_NS = 2_000_000_000
_ORDER: list[EventKind] = ["born", "split", "returned", "merged", "absent", "ended"]


@dataclass(frozen=True)
class Count:
    """Current members at an update.

    Attributes
    ----------
    sizes
        By hypothesis that has any.
    least
        How many confirm a hypothesis.
    origins
        For hypotheses that are new: the one that most members have left, None for none.
    heirs
        For hypotheses whose last members mostly vote for another now: which one; or for itself still.
    """

    sizes: Mapping[int, int]
    least: int
    origins: Mapping[int, int | None]
    heirs: Mapping[int, int]


@dataclass
class Lifecycle:
    """The state machine of all hypotheses of a space.

    Attributes
    ----------
    config
        Its times and numbers.
    records
        What is known of each hypothesis, by id.
    """

    config: HypothesesConfig = field(metadata=NOT_KEPT)
    records: dict[int, Record] = field(default_factory=dict)
    _stamp_ns: int | None = None
    _forgotten: list[int] = field(default_factory=list)

    @property
    def _confirm_ns(self) -> int:
        return to_ns(self.config.confirm)

    def confirmed(self, hypothesis: int) -> bool:
        """Whether it has had its first event."""
        return self.stage(hypothesis) in {"present", "absent"}

    def stage(self, hypothesis: int) -> str | None:
        """As far as the events say: an absent one may have members again; None where it is unknown."""
        return self.records[hypothesis].stage if hypothesis in self.records else None

    def due(self, hypothesis: int, stamp_ns: int) -> bool:
        """Whether a hypothesis is confirmed at this time, if it has enough members then."""
        record = self.records.get(hypothesis)
        since = stamp_ns if record is None or record.support_ns is None else self._stamp_ns
        step = 0 if since is None else stamp_ns - since
        return (0 if record is None else record.support_ns or 0) + step >= self._confirm_ns

    def advance(self, stamp_ns: int, count: Count) -> list[Event]:
        """Take in an update; returns its events, beginnings first, then by kind and id."""
        step = 0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0)
        self._stamp_ns = stamp_ns
        for one in count.sizes:
            self.records.setdefault(one, Record(origin=count.origins.get(one)))
        events = [_event(stamp_ns, "ended", one) for one in self._forgotten]
        self._forgotten = []
        merged: dict[int, list[int]] = {}
        for one in sorted(self.records):
            record, size = self.records[one], count.sizes.get(one, 0)
            if size:
                enough = size >= count.least
                events += self._seen(stamp_ns, one, step if enough else -max(step, 1))
            elif record.stage == "unconfirmed":
                del self.records[one]
            elif self._lost(stamp_ns, record) and (heir := count.heirs.get(one)) != one:
                if heir is None:
                    record.stage = "absent"
                    events.append(_event(stamp_ns, "absent", one))
                elif self.confirmed(heir):
                    merged.setdefault(heir, []).append(one)
        events += [_event(stamp_ns, "merged", heir, gone) for heir, gone in merged.items()]
        for gone in merged.values():
            for one in gone:
                del self.records[one]
        events += self._expire(stamp_ns)
        return sorted(events, key=lambda e: (_ORDER.index(e.kind), e.hypothesis))

    def forget(self, hypothesis: int) -> None:
        """Drop all that is known of a hypothesis; a confirmed one ends at the next update."""
        if self.confirmed(hypothesis):
            self._forgotten.append(hypothesis)
        self.records.pop(hypothesis, None)

    def _seen(self, stamp_ns: int, one: int, step: int) -> list[Event]:
        record = self.records[one]
        # The time before it appeared or returned does not count for it.
        record.support_ns = 0 if record.support_ns is None else max(record.support_ns + step, 0)
        record.since_ns = None
        if record.stage == "present" or step < 0 or record.support_ns < self._confirm_ns:
            return []
        before, record.stage = record.stage, "present"
        if before == "absent":
            return [_event(stamp_ns, "returned", one)]
        if record.origin is not None and self.confirmed(record.origin):
            return [_event(stamp_ns, "split", one, [record.origin])]
        return [_event(stamp_ns, "born", one)]

    def _lost(self, stamp_ns: int, record: Record) -> bool:
        """Whether a hypothesis has been without current members for long enough to say so."""
        record.support_ns = None
        record.since_ns = stamp_ns if record.since_ns is None else record.since_ns
        return record.stage == "present" and stamp_ns - record.since_ns >= self._confirm_ns

    def _expire(self, stamp_ns: int) -> list[Event]:
        """Drop the absent ones that are remembered no longer, the longest absent first."""
        absent = [(record.since_ns, h) for h, record in self.records.items() if record.stage == "absent"]
        waiting = sorted((since, h) for since, h in absent if since is not None)
        oldest_ns = stamp_ns - to_ns(self.config.memory)
        surplus = max(len(waiting) - self.config.remembered, 0)
        gone = [h for k, (since, h) in enumerate(waiting) if k < surplus or since < oldest_ns]
        for one in gone:
            del self.records[one]
        return [_event(stamp_ns, "ended", one) for one in gone]


def _event(stamp_ns: int, kind: EventKind, hypothesis: int, others: list[int] | None = None) -> Event:
    return Event(stamp_ns=stamp_ns, kind=kind, hypothesis=hypothesis, others=others or [])
