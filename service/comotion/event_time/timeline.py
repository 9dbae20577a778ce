"""Merges batches of many sources, in any order, into one time line.

The rules are in the docstring of :mod:`comotion.event_time`.
"""

from collections.abc import Collection
from typing import Any

import numpy as np

from comotion_schemas import ObservationBatch, RejectionReason

from ..config import FusionConfig, to_ns
from ..saving import plain, restored
from .budget import Budget
from .entries import Entry, Verdict, in_time_order
from .faults import Faults
from .release import End, Load, Release, Store
from .sources import PERIODS, Source, Sources
from .stats import Fate, Key, Ledger, Stats
from .steps import FUTURE_NS, Steps
from .troubles import Troubles

# Share of `limits.processing` for storing what was read.
_STORING = 0.5
# Periods that a round makes up for: where updates are slow, batches that came meanwhile are stored as well.
_ROUNDS = 3


class Timeline:
    """Event time of one scene, as the rules say; batches, and errors of the service itself, are counted.

    `watermark_ns` is W on the time scale of the scene (`steps`), nanoseconds, None until a source has set it;
    `at_ns` the clock of arrivals at the last :meth:`advance`; `sessions` are (source, session) by number, of
    every session that is current or has trajectories.
    """

    def __init__(self, config: FusionConfig, stats: Stats) -> None:
        self._window_ns = to_ns(config.window)
        self._lateness_ns = to_ns(config.allowed_lateness)
        self._max_lag_ns = to_ns(config.max_lag)
        self._track_timeout_ns = to_ns(config.track_timeout)
        self._limits = config.limits
        self.stats = stats
        self.faults = Faults(stats)
        self.sources = Sources(to_ns(config.source_timeout))
        self._inbox: list[Entry] = []
        waiting = (round(megabytes * 1e6) for megabytes in (config.limits.waiting, config.limits.waiting_all))
        self._load = Load(config.limits.waiting_batches, *waiting)
        self.budget = Budget(_STORING * config.limits.processing, _ROUNDS * to_ns(config.period))
        self.troubles = Troubles()
        self.ledger = Ledger(stats, self.troubles)
        self._release = Release(self.sources, self._settle, self.budget, self.troubles)
        self.sessions = self._release.sessions
        self._end: End = lambda _: None
        self.at_ns = self._now_ns = 0
        self.watermark_ns: int | None = None
        self.steps = Steps(self.sources.timeout_ns, self._window_ns, self.troubles)

    def receive(self, batch: ObservationBatch, refusal: RejectionReason | None = None) -> None:
        """Take a batch in; the next :meth:`advance` judges it against the clock.

        `refusal` is why the caller cannot use it, if so: its sequence number counts, but nothing else.
        """
        key = batch.source, batch.session
        self.ledger.arrive(key)
        repeated = self.ledger.sight(key, batch.seq) == "repeated"
        entry = Entry(batch, repeated)
        stamps = batch.stamps_ns
        if repeated and not self.steps.replays:
            self.ledger.settle(key, "duplicates")
        elif refusal is not None:
            self.ledger.settle(key, refusal)
        elif not self._load.admits(batch.source, entry.size) or (
            stamps is not None and len(np.unique(stamps)) > self._limits.instants
        ):
            self.ledger.settle(key, "limit")
        else:
            self._load.add(batch.source, entry.size)
            self._inbox.append(entry)

    def advance(self, now_ns: int, at_ns: int | None, store: Store, end: End) -> None:
        """Judge what has come in, move the watermark, and release what it has passed, in event-time order.

        `now_ns` is the caller's clock, nanoseconds since the Unix epoch, and `at_ns` one that is never set
        (None: `now_ns`). `store` is called with instants, `end` with the number of a session that is over.
        """
        self._now_ns, self._end = now_ns, end
        self.at_ns = self.troubles.at_ns = at_ns = now_ns if at_ns is None else at_ns
        inbox, self._inbox = self._inbox, []
        for entry in inbox:
            entry.at_ns = at_ns
            verdict: Verdict = "defect"
            with self.faults.guard("judging a batch", entry.batch):
                verdict = self._admit(entry)
            with self.faults.guard("taking a batch in", entry.batch):
                self._take(entry, verdict)
        # One decision may allow another: one on a clock moves stamps of rivals, and a new session agrees.
        while any(self._hand_over(s) for _, s in sorted(self.sources.items()) if s.rivals) or self._decide():
            pass
        self._move_watermark()
        self._release.until(self.watermark_ns, at_ns, store, end)

    def track_timeout_ns(self, session: int) -> int:
        """Time without observation after which a trajectory of this session number is outdated."""
        source = self.sources.get(self.sessions[session][0])
        return max(self._track_timeout_ns, PERIODS * (source.period_ns if source else 0))

    def forget_idle(self, used: Collection[int]) -> None:
        """Forget ended sessions and silent sources, except those with trajectories: numbers in `used`."""
        for name, source in list(self.sources.items()):
            held = source.number in used or self._load.holds(name)
            if source.idle_ns(self.at_ns) > to_ns(self._limits.expiry) and not held:
                del self.sources[name]
        current = {source.number for source in self.sources.values()}
        for number in self.sessions.keys() - used - current:
            del self.sessions[number]

    def _take(self, entry: Entry, verdict: Verdict) -> None:
        """Let a batch wait as its verdict says, or book its fate."""
        match verdict:
            case "clock":
                self.steps.held.append(entry)
            case "name":
                source = self.sources[entry.batch.source]
                source.rivals.append(entry)
                self._hand_over(source)
            case "watermark":
                self._wait(entry)
            case fate:
                self._settle(entry, fate)

    def _settle(self, entry: Entry, fate: Fate) -> None:
        self._load.add(entry.batch.source, entry.size, -1)
        self.ledger.settle(entry.key, fate)

    def _admit(self, entry: Entry) -> Verdict:
        """Let a batch that is far from now wait where its clock may be right; judge any other."""
        steps, source = self.steps, self.sources.sender(entry.key)
        steps.catch_up(entry.batch, self._now_ns)
        last_ns = self.sources.agreed_ns()
        agreed = source is not None and source.agreed_ns is not None
        alone = last_ns is None or self.at_ns - last_ns > self.sources.timeout_ns
        if not steps.may_wait(entry, self._now_ns, self._floor(), agreed=agreed, alone=alone):
            return self._judge(entry)
        if source is not None and agreed:
            source.hear(entry.at_ns)
        return "clock"

    def _floor(self) -> int | None:
        """Stamp below which all is late; None before the first watermark."""
        return None if self.watermark_ns is None else self.watermark_ns - self._lateness_ns

    def _decide(self) -> bool:
        """Judge the batches that wait because of their clock; whether it was clear which clock is wrong."""
        steps = self.steps
        decision = steps.decide(self.sources.agreed_ns(), self.at_ns)
        if decision == "wait":
            return False
        if decision == "follow":
            steps.follow(self._now_ns)
        replayed: set[Key] = set()
        held, steps.held = steps.held, []
        for entry in held:
            source = self.sources.sender(entry.key)
            if decision == "judge":
                # The clock of its session is wrong: others agree.
                if source is not None:
                    source.agreed_ns = None
            elif entry.repeated or entry.key in replayed:
                self._play_again(entry, replayed)
            self._take(entry, self._judge(entry, trusted=decision == "follow"))
        return True

    def _play_again(self, entry: Entry, replayed: set[Key]) -> None:
        """A recording is played again, with the session that it had before: it is a new one."""
        batch, source = entry.batch, self.sources.sender(entry.key)
        if entry.key not in replayed:
            replayed.add(entry.key)
            self.ledger.sequences.forget(*entry.key)
            if source is not None:
                source.start(batch.session, self.steps.scene_time(batch), self.at_ns)
        entry.repeated = self.ledger.sight(entry.key, batch.seq) == "repeated"

    def _judge(self, entry: Entry, *, trusted: bool = False) -> Verdict:
        """Whether a batch is rejected, is late, contests a name, or may wait for the watermark."""
        batch, at_ns, now_ns = entry.batch, self.at_ns, self._now_ns
        source, stamp_ns = self.sources.get(batch.source), self.steps.scene_time(batch)
        if entry.repeated:
            return "duplicates"
        if entry.offset_ns > FUTURE_NS and not trusted:
            self.steps.note(batch, entry.offset_ns, off=True)
            return "future"
        if self.watermark_ns is None and stamp_ns < now_ns - self._window_ns and not trusted:
            self.steps.note(batch, stamp_ns - now_ns, off=True)
            return "past"
        if source is None:
            if not self._admit_source():
                return "limit"
            source = self.sources[batch.source] = Source(batch.session, stamp_ns, stamp_ns, since_ns=at_ns)
        elif batch.session != source.session:
            over = batch.session in source.past and stamp_ns <= source.started_ns
            return "late" if over else "name"
        source.observe(stamp_ns, at_ns)
        return "watermark"

    def _hand_over(self, source: Source) -> bool:
        """Let rivals take over the name of a source, or refuse them; whether any waits no more."""
        waiting, timeout_ns = len(source.rivals), self.sources.timeout_ns
        for entry, verdict in source.settled_rivals(self.at_ns, timeout_ns, self.steps.scene_time):
            if verdict == "duplicate-name":
                self.troubles.note("duplicate-name", entry.batch.source)
            self._take(entry, verdict)
        return len(source.rivals) < waiting

    def _admit_source(self) -> bool:
        """Whether one more source is admitted; where there are too many, the one silent for longest goes."""
        if len(self.sources) < self._limits.sources:
            return True
        idle = self.sources.keys() - self.sources.sending(self.at_ns)
        silent = [(self.sources[n].idle_ns(self.at_ns), n) for n in idle if not self._load.holds(n)]
        if silent and (number := self.sources.pop(max(silent)[1]).number) >= 0:
            self._end(number)
        return bool(silent)

    def _wait(self, entry: Entry) -> None:
        """Let the instants of a batch wait for the watermark, except for those that are too late."""
        source, watermark, floor = self.sources[entry.batch.source], self.watermark_ns, self._floor()
        stamps, rows = in_time_order(entry.batch)
        stamps = stamps - self.steps.shift_ns
        late = int(np.searchsorted(stamps, self._now_ns - self._window_ns if floor is None else floor))
        of_use = late < len(stamps)
        entry.late, entry.generation = late > 0, source.generation
        if of_use:
            entry.stamps, entry.rows = stamps[late:], rows[late:]
            self.stats.reordered += watermark is not None and bool(entry.stamps[0] < watermark)
            source.agreed_ns = self.at_ns
        elif watermark is not None and entry.batch.ended is not None:
            entry.stamps = np.array([watermark])
        # By the clock of its source, also where the scene has followed the clock of live data.
        shift_ns = self.steps.shift_ns if self.steps.replays else 0
        self.steps.note(entry.batch, entry.batch.stamp_ns - shift_ns - self._now_ns, off=not of_use)
        if len(entry.stamps):
            self._release.add(entry)
        else:
            self._settle(entry, "late")

    def _move_watermark(self) -> None:
        now_ns, timeout_ns = self._now_ns, self.sources.timeout_ns
        live = [s.newest_ns for s in self.sources.values() if now_ns - s.newest_ns <= timeout_ns]
        if not live and not self.steps.replays:
            # All clocks are behind, or the service's is ahead: the sources that still send set the pace.
            live = [s.newest_ns for s in self.sources.sending(self.at_ns).values()]
            now_ns = min([now_ns, *live])
        if not live:
            return
        reached = min(max(now_ns - self._max_lag_ns, min(live)), now_ns)
        # The previous watermark wins over a clock that was set back: W never decreases.
        self.watermark_ns = reached if self.watermark_ns is None else max(reached, self.watermark_ns)

    def state(self) -> dict[str, Any]:
        """Watermark, sources, sessions and accounts as plain values, without the batches that wait."""
        return {
            "watermark": self.watermark_ns,
            "shift": self.steps.shift_ns,
            "sources": plain(self.sources),
            "sessions": plain(self.sessions),
            "next_number": self._release.next_number,
            "accounts": self.ledger.state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`; raises AttributeError, KeyError, TypeError or ValueError if it is none."""
        self.watermark_ns = state["watermark"]
        self.steps.shift_ns = int(state["shift"])
        self.sources.update(restored(dict[str, Source], state["sources"]))
        self.sessions.update(restored(dict[int, Key], state["sessions"]))
        self._release.next_number = int(state["next_number"])
        self.ledger.load(state["accounts"])
