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
from dataclasses import dataclass
from typing import Any, Literal

from comotion_schemas import Event
from comotion_schemas.hypotheses import EventKind

from ..config import HypothesesConfig, to_ns

# "Those of the last 2 s" of docs/protocol.md.
EVENT_MEMORY_NS = 2_000_000_000
_ORDER: list[EventKind] = ["born", "split", "returned", "merged", "absent", "ended"]


@dataclass
class Life:
    """A hypothesis over time.

    Attributes
    ----------
    origin
        The hypothesis that it has left, None where its members came from nowhere.
    stage
        As of the events so far.
    support_ns
        Time with enough members less time with too few, since it appeared or returned; None while it has
        no current member.
    since_ns
        Event time since when it has had no current member; None while it has any.
    """

    origin: int | None = None
    stage: Literal["unconfirmed", "present", "absent"] = "unconfirmed"
    support_ns: int | None = None
    since_ns: int | None = None


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


class Lifecycle:
    """The state machine of all hypotheses of a space.

    Parameters
    ----------
    config
        Its times and numbers.
    """

    def __init__(self, config: HypothesesConfig) -> None:
        self._config = config
        self._confirm_ns = to_ns(config.confirm)
        self._stamp_ns: int | None = None
        self._forgotten: list[int] = []
        self.lives: dict[int, Life] = {}

    def confirmed(self, hypothesis: int) -> bool:
        """Whether it has had its first event."""
        life = self.lives.get(hypothesis)
        return life is not None and life.stage != "unconfirmed"

    def present(self, hypothesis: int) -> bool:
        """Whether it is confirmed and not absent."""
        return hypothesis in self.lives and self.lives[hypothesis].stage == "present"

    def absent(self, hypothesis: int) -> bool:
        """Whether it is absent as far as the events say; it may have members again."""
        return hypothesis in self.lives and self.lives[hypothesis].stage == "absent"

    def due(self, hypothesis: int, stamp_ns: int) -> bool:
        """Whether a hypothesis is confirmed at this time, if it has enough members then."""
        life = self.lives.get(hypothesis)
        since = stamp_ns if life is None or life.support_ns is None else self._stamp_ns
        step = 0 if since is None else stamp_ns - since
        return (0 if life is None else life.support_ns or 0) + step >= self._confirm_ns

    def advance(self, stamp_ns: int, count: Count) -> list[Event]:
        """Take in an update; returns its events, beginnings first, then by kind and id."""
        step = 0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0)
        self._stamp_ns = stamp_ns
        for one in count.sizes:
            self.lives.setdefault(one, Life(origin=count.origins.get(one)))
        events = [_event(stamp_ns, "ended", one) for one in self._forgotten]
        self._forgotten = []
        merged: dict[int, list[int]] = {}
        for one in sorted(self.lives):
            life, size = self.lives[one], count.sizes.get(one, 0)
            if size:
                enough = size >= count.least
                events += self._seen(stamp_ns, one, step if enough else -max(step, 1))
            elif life.stage == "unconfirmed":
                del self.lives[one]
            elif self._lost(stamp_ns, life) and (heir := count.heirs.get(one)) != one:
                if heir is None:
                    life.stage = "absent"
                    events.append(_event(stamp_ns, "absent", one))
                elif self.confirmed(heir):
                    merged.setdefault(heir, []).append(one)
        events += [_event(stamp_ns, "merged", heir, gone) for heir, gone in merged.items()]
        for gone in merged.values():
            for one in gone:
                del self.lives[one]
        events += self._expire(stamp_ns)
        return sorted(events, key=lambda e: (_ORDER.index(e.kind), e.hypothesis))

    def forget(self, hypothesis: int) -> None:
        """Drop a hypothesis; a confirmed one ends at the next update."""
        if self.confirmed(hypothesis):
            self._forgotten.append(hypothesis)
        self.lives.pop(hypothesis, None)

    def state(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "stamp_ns": self._stamp_ns,
            "forgotten": list(self._forgotten),
            "lives": [[h, dict(vars(life))] for h, life in self.lives.items()],
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self._stamp_ns = state["stamp_ns"]
        self._forgotten = [int(one) for one in state["forgotten"]]
        self.lives = {int(h): Life(**values) for h, values in state["lives"]}

    def _seen(self, stamp_ns: int, one: int, step: int) -> list[Event]:
        life = self.lives[one]
        # The time before it appeared or returned does not count for it.
        life.support_ns = 0 if life.support_ns is None else max(life.support_ns + step, 0)
        life.since_ns = None
        if life.stage == "present" or step < 0 or life.support_ns < self._confirm_ns:
            return []
        before, life.stage = life.stage, "present"
        if before == "absent":
            return [_event(stamp_ns, "returned", one)]
        if life.origin is not None and self.confirmed(life.origin):
            return [_event(stamp_ns, "split", one, [life.origin])]
        return [_event(stamp_ns, "born", one)]

    def _lost(self, stamp_ns: int, life: Life) -> bool:
        """Whether a hypothesis has been without current members for long enough to say so."""
        life.support_ns = None
        life.since_ns = stamp_ns if life.since_ns is None else life.since_ns
        return life.stage == "present" and stamp_ns - life.since_ns >= self._confirm_ns

    def _expire(self, stamp_ns: int) -> list[Event]:
        """Drop the absent ones that are remembered no longer, the longest absent first."""
        absent = [(life.since_ns, h) for h, life in self.lives.items() if life.stage == "absent"]
        waiting = sorted((since, h) for since, h in absent if since is not None)
        oldest_ns = stamp_ns - to_ns(self._config.memory)
        surplus = max(len(waiting) - self._config.remembered, 0)
        gone = [h for k, (since, h) in enumerate(waiting) if k < surplus or since < oldest_ns]
        for one in gone:
            del self.lives[one]
        return [_event(stamp_ns, "ended", one) for one in gone]


def _event(stamp_ns: int, kind: EventKind, hypothesis: int, others: list[int] | None = None) -> Event:
    return Event(stamp_ns=stamp_ns, kind=kind, hypothesis=hypothesis, others=others or [])
