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
from itertools import chain

from comotion_schemas import Event
from comotion_schemas.hypotheses import EventKind

from ..config import HypothesesConfig, to_ns
from ..partition import PoseReference
from ..saving import NOT_KEPT
from .records import Record

# "Those of the last 2 s" of docs/protocol.md.
EVENT_MEMORY_NS = 2_000_000_000
# Hypotheses without current members that are remembered in a space.
_REMEMBERED = 32
_ORDER: list[EventKind] = ["born", "split", "returned", "merged", "absent", "ended"]
# Kind, hypothesis and others of an event.
_Change = tuple[EventKind, int, list[int]]


@dataclass
class Lifecycle:
    """The state machine of all hypotheses of a space."""

    config: HypothesesConfig = field(metadata=NOT_KEPT)
    """Its times and numbers."""
    records: dict[int, Record] = field(default_factory=dict)
    """What is known of each hypothesis, by id."""
    _stamp_ns: int | None = None
    _forgotten: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._confirm_ns = to_ns(self.config.confirm)

    def confirmed(self, hypothesis: int) -> bool:
        """Whether it has had its first event."""
        return hypothesis in self.records and self.records[hypothesis].stage != "unconfirmed"

    def due(self, hypothesis: int, stamp_ns: int) -> bool:
        """Whether a hypothesis is confirmed at this time, if it has enough members then."""
        record = self.records.get(hypothesis)
        if record is None or record.support_ns is None or self._stamp_ns is None:
            return self._confirm_ns <= 0
        return record.support_ns + stamp_ns - self._stamp_ns >= self._confirm_ns

    def advance(
        self,
        stamp_ns: int,
        sizes: Mapping[int, int],
        least: int,
        origins: Mapping[int, int | None],
        heirs: Mapping[int, int | None],
    ) -> list[Event]:
        """Take in an update; returns its events, beginnings first, then by kind and id.

        `sizes` are the current members of each hypothesis that has any, of which `least` confirm it.
        `origins` of new ones are those that most members have left, None for none; `heirs` those that most of
        the last members of one vote for now, which may be itself still.
        """
        step = 0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0)
        self._stamp_ns = stamp_ns
        for number in sorted(sizes.keys() - self.records.keys()):
            self.records[number] = Record(PoseReference.new(stamp_ns), origins.get(number))
        changes: list[_Change] = [("ended", number, []) for number in self._forgotten]
        self._forgotten = []
        merged: dict[int, list[int]] = {}
        for number, record in sorted(self.records.items()):
            if number in sizes:
                enough = sizes[number] >= least
                changes += self._seen(number, record, step if enough else -max(step, 1))
            elif record.stage == "unconfirmed":
                del self.records[number]
            elif self._lost(stamp_ns, record) and (heir := heirs.get(number)) != number:
                if heir is None:
                    record.stage = "absent"
                    changes.append(("absent", number, []))
                elif self.confirmed(heir):
                    merged.setdefault(heir, []).append(number)
        changes += [("merged", heir, gone) for heir, gone in merged.items()]
        # The absent ones that are remembered no longer, the longest absent first.
        absent = ((r.since_ns, number) for number, r in self.records.items() if r.stage == "absent")
        waiting = sorted((since, number) for since, number in absent if since is not None)
        oldest_ns = stamp_ns - to_ns(self.config.memory)
        surplus = len(waiting) - _REMEMBERED
        expired = [number for k, (since, number) in enumerate(waiting) if k < surplus or since < oldest_ns]
        for number in chain(expired, *merged.values()):
            del self.records[number]
        changes += [("ended", number, []) for number in expired]
        changes.sort(key=lambda change: (_ORDER.index(change[0]), change[1]))
        return [
            Event(stamp_ns=stamp_ns, kind=k, hypothesis=number, others=others)
            for k, number, others in changes
        ]

    def _seen(self, number: int, record: Record, step: int) -> list[_Change]:
        # The time before it appeared or returned does not count for it.
        record.support_ns = 0 if record.support_ns is None else max(record.support_ns + step, 0)
        record.since_ns = None
        if record.stage == "present" or step < 0 or record.support_ns < self._confirm_ns:
            return []
        last, record.stage = record.stage, "present"
        if last == "absent":
            return [("returned", number, [])]
        if record.origin is not None and self.confirmed(record.origin):
            return [("split", number, [record.origin])]
        return [("born", number, [])]

    def _lost(self, stamp_ns: int, record: Record) -> bool:
        """Whether a hypothesis has been without current members for long enough to say so."""
        record.support_ns = None
        record.since_ns = stamp_ns if record.since_ns is None else record.since_ns
        return record.stage == "present" and stamp_ns - record.since_ns >= self._confirm_ns
