"""Merges batches of many sources, in any order, into one time line.

The rules, and the table of stages, are in :mod:`comotion.event_time`.
"""

from collections.abc import Collection
from typing import Any

import numpy as np

from comotion_schemas import ObservationBatch, RejectionReason

from ..config import FusionConfig, to_ns
from ..saving import plain, restored
from . import TABLE, Event, Stage
from .budget import Budget
from .clocks import FUTURE_NS, LiveClock, ReplayClock
from .entries import Entry, in_time_order
from .faults import Faults
from .release import End, Load, Release, Store
from .sources import MAX_SOURCES, PERIODS, Source, Sources
from .stats import Key, Ledger, Stats
from .troubles import Troubles

# Share of the time for storing what was read.
_STORING = 0.25
# Periods that a round makes up for: where updates are slow, batches that came meanwhile are stored as well.
_ROUNDS = 3
# ns; the shortest silence after which another session gets the name: more than the jitter of a fast source.
_HANDOVER_NS = 200_000_000
# Different row stamps in one batch; batches of a source that wait for the watermark, of rivals for its name.
_MAX_INSTANTS, _MAX_BATCHES, _MAX_RIVALS = 1024, 4096, 256
# Bytes of batches that wait, of one source, and of all; beyond the latter each source has its share.
_MAX_BYTES = 64_000_000, 256_000_000


class Timeline:
    """Event time of one scene, as the rules say; batches, and errors of the service itself, are counted.

    `watermark_ns` is W on the time scale of the scene (`clock`), nanoseconds, None until a source has set it;
    `at_ns` the clock of arrivals at the last :meth:`advance`; `sessions` are (source, session) by number, of
    every session that is current or has trajectories.
    """

    def __init__(self, config: FusionConfig, stats: Stats) -> None:
        self._config = config
        self.stats = stats
        self.faults = Faults(stats)
        self.sources = Sources(to_ns(config.source_timeout))
        self._inbox: list[Entry] = []
        self._load = Load(_MAX_BATCHES, *_MAX_BYTES)
        self.budget = Budget(_STORING, _ROUNDS * to_ns(config.period))
        self.troubles = Troubles()
        self.ledger = Ledger(stats, self.troubles)
        self._release = Release(self.sources, self._move, self.budget, self.troubles)
        self.sessions = self._release.sessions
        self._end: End = lambda _: None
        self.at_ns = self._now_ns = 0
        self.watermark_ns: int | None = None
        # Stamp below which all is late.
        self._floor_ns: int | None = None
        self.clock = LiveClock(self.sources, to_ns(config.window), self.troubles)

    def replay(self) -> None:
        """Take the stamps of the sources for those of recordings, from the start on."""
        self.clock = ReplayClock(**vars(self.clock))

    def receive(self, batch: ObservationBatch, refusal: RejectionReason | None = None) -> None:
        """Take a batch in; the next :meth:`advance` judges it against the clock.

        `refusal` is why the caller cannot use it, if so: its sequence number counts, but nothing else.
        """
        entry, stamps = Entry(batch), batch.stamps_ns
        within = self._load.admits(batch.source, entry.size)
        self._load.add(batch.source, entry.size)
        self.ledger.book(entry.key, {"batches": 1, "waiting": 1})
        entry.repeated = self.ledger.sight(entry.key, batch.seq) == "repeated"
        if self.clock.is_copy(entry):
            self._move(entry, "repeated")
        elif refusal is not None:
            self._move(entry, refusal)
        elif not within or (stamps is not None and len(np.unique(stamps)) > _MAX_INSTANTS):
            self._move(entry, "limit")
        else:
            self._inbox.append(entry)

    def advance(self, now_ns: int, at_ns: int | None, store: Store, end: End) -> None:
        """Judge what has come in, move the watermark, and release what it has passed, in event-time order.

        `now_ns` is the caller's clock, nanoseconds since the Unix epoch, and `at_ns` one that is never set
        (None: `now_ns`). `store` is called with instants, `end` with the number of a session that is over.
        """
        self._now_ns, self._end = now_ns, end
        self.at_ns = self.troubles.at_ns = at_ns = now_ns if at_ns is None else at_ns
        if self.watermark_ns is not None:
            self._floor_ns = self.watermark_ns - to_ns(self._config.allowed_lateness)
        inbox, self._inbox = self._inbox, []
        for entry in inbox:
            entry.at_ns = at_ns
            event: Event = "defect"
            with self.faults.guard("judging a batch", entry.batch):
                event = "far" if self.clock.may_wait(entry, now_ns, self._floor_ns) else self._judge(entry)
            self._move(entry, event)
        # One decision may allow another: one on a clock moves stamps of rivals, and a new session agrees.
        while any(self._hand_over(s) for _, s in sorted(self.sources.items()) if s.rivals) or self._decide():
            pass
        self._move_watermark()
        if self.watermark_ns is not None:
            self._release.until(self.watermark_ns, at_ns, store, end)

    def track_timeout_ns(self, session: int) -> int:
        """Time without observation after which a trajectory of this session number is outdated."""
        source = self.sources.get(self.sessions[session][0])
        return max(to_ns(self._config.track_timeout), PERIODS * (source.period_ns if source else 0))

    def forget_idle(self, used: Collection[int]) -> None:
        """Forget ended sessions and silent sources, except those with trajectories: numbers in `used`."""
        for name, source in list(self.sources.items()):
            held = source.number in used or self._load.holds(name)
            if source.idle_ns(self.at_ns) > to_ns(self._config.limits.expiry) and not held:
                del self.sources[name]
        current = {source.number for source in self.sources.values()}
        for number in self.sessions.keys() - used - current:
            del self.sessions[number]

    def _move(self, entry: Entry, event: Event) -> None:
        """Move a batch to the stage that follows, and do what that one asks for."""
        with self.faults.guard("moving a batch on", entry.batch) as failed:
            entry.stage = TABLE[entry.stage, event]
            match entry.stage:
                case Stage.CLOCK:
                    self.clock.held.append(entry)
                    source = self.sources.sender(entry.key)
                    if source is not None and source.agreed_ns is not None:
                        source.hear(entry.at_ns)
                case Stage.NAME:
                    source = self.sources[entry.batch.source]
                    source.rivals.append(entry)
                    self._hand_over(source)
                case Stage.WATERMARK:
                    self._wait(entry)
                case end:
                    self._load.add(entry.batch.source, entry.size, -1)
                    account = event if end is Stage.REJECTED else end.value
                    self.ledger.book(entry.key, {"waiting": -1, account: 1})
        if failed and (entry.stage, "defect") in TABLE:
            self._move(entry, "defect")

    def _decide(self) -> bool:
        """Judge the batches that wait because of their clock; whether it was clear which clock is wrong."""
        decision = self.clock.decide(self._now_ns, self.at_ns)
        if decision == "wait":
            return False
        held, self.clock.held, replayed = self.clock.held, [], set[Key]()
        for entry in held:
            source = self.sources.sender(entry.key)
            if decision == "judge":
                # The clock of its session is wrong: others agree.
                if source is not None:
                    source.agreed_ns = None
            elif entry.repeated or entry.key in replayed:
                # A recording is played again, with the session that it had before: it is a new one.
                if entry.key not in replayed:
                    replayed.add(entry.key)
                    self.ledger.sequences.forget(*entry.key)
                    if source is not None:
                        source.start(entry.batch.session, self.clock.scene_time(entry.batch), self.at_ns)
                entry.repeated = self.ledger.sight(entry.key, entry.batch.seq) == "repeated"
            self._move(entry, self._judge(entry, trusted=decision == "follow"))
        return True

    def _judge(self, entry: Entry, *, trusted: bool = False) -> Event:
        """Whether a batch is rejected, is late, contests a name, or may wait for the watermark."""
        batch, now_ns = entry.batch, self._now_ns
        source, stamp_ns = self.sources.get(batch.source), self.clock.scene_time(batch)
        if entry.repeated:
            return "repeated"
        if entry.offset_ns > FUTURE_NS and not trusted:
            self.clock.note(batch, entry.offset_ns, off=True)
            return "future"
        if self.watermark_ns is None and stamp_ns < now_ns - self.clock.window_ns and not trusted:
            self.clock.note(batch, stamp_ns - now_ns, off=True)
            return "past"
        if source is None:
            if not self._admit_source():
                return "limit"
            self.sources[batch.source] = Source(batch.session, stamp_ns, stamp_ns, since_ns=self.at_ns)
        elif batch.session != source.session:
            over = batch.session in source.past and stamp_ns <= source.started_ns
            return "late" if over else "rival"
        return "own"

    def _hand_over(self, source: Source) -> bool:
        """Give the name to the first rival once its source is silent, or reject it; whether any was."""
        waiting = len(source.rivals)
        while source.rivals:
            first = source.rivals[0]
            limit_ns = min(max(_HANDOVER_NS, source.silence_ns), self.sources.timeout_ns)
            stamp_ns = self.clock.scene_time(first.batch)
            # Batches that are looked at together have no times of arrival of their own.
            if (max(source.idle_ns(self.at_ns), 0) or stamp_ns - source.newest_ns) >= limit_ns:
                admitted = [entry for entry in source.rivals if entry.key == first.key]
                source.rivals = [entry for entry in source.rivals if entry.key != first.key]
                source.start(first.batch.session, stamp_ns, self.at_ns)
                for entry in admitted:
                    self._move(entry, "own")
            elif self.at_ns - first.at_ns >= limit_ns or len(source.rivals) > _MAX_RIVALS:
                self.troubles.note("duplicate-name", first.batch.source)
                self._move(source.rivals.pop(0), "duplicate-name")
            else:
                break
        return len(source.rivals) < waiting

    def _admit_source(self) -> bool:
        """Whether one more source is admitted; where there are too many, the one silent for longest goes."""
        if len(self.sources) < MAX_SOURCES:
            return True
        idle = self.sources.keys() - self.sources.sending(self.at_ns)
        silent = [(self.sources[n].idle_ns(self.at_ns), n) for n in idle if not self._load.holds(n)]
        if silent and (number := self.sources.pop(max(silent)[1]).number) >= 0:
            self._end(number)
        return bool(silent)

    def _wait(self, entry: Entry) -> None:
        """Let the instants of a batch wait for the watermark, except for those that are too late."""
        source, watermark, floor = self.sources[entry.batch.source], self.watermark_ns, self._floor_ns
        source.observe(self.clock.scene_time(entry.batch), self.at_ns)
        stamps, rows = in_time_order(entry.batch)
        stamps = stamps - self.clock.shift_ns
        late = int(np.searchsorted(stamps, self._now_ns - self.clock.window_ns if floor is None else floor))
        of_use = late < len(stamps)
        entry.late, entry.generation = late > 0, source.generation
        if of_use:
            entry.stamps, entry.rows = stamps[late:], rows[late:]
            self.stats.reordered += watermark is not None and bool(entry.stamps[0] < watermark)
            source.agreed_ns = self.at_ns
        elif watermark is not None and entry.batch.ended is not None:
            entry.stamps = np.array([watermark])
        self.clock.note(entry.batch, self.clock.offset_ns(entry.batch, self._now_ns), off=not of_use)
        if len(entry.stamps):
            self._release.add(entry)
        else:
            self._move(entry, "late")

    def _move_watermark(self) -> None:
        now_ns, timeout_ns = self._now_ns, self.sources.timeout_ns
        live = [s.newest_ns for s in self.sources.values() if now_ns - s.newest_ns <= timeout_ns]
        lowest_ns = now_ns - to_ns(self._config.max_lag)
        reached = min(max(lowest_ns, min(live)), now_ns) if live else self.clock.pace_ns(self.at_ns)
        # The previous watermark wins over a clock that was set back: W never decreases.
        if reached is not None and (self.watermark_ns is None or reached > self.watermark_ns):
            self.watermark_ns = reached

    def state(self) -> dict[str, Any]:
        """Watermark, sources, sessions and accounts as plain values, without the batches that wait."""
        return {
            "watermark": self.watermark_ns,
            "shift": self.clock.shift_ns,
            "sources": plain(self.sources),
            "sessions": plain(self.sessions),
            "next_number": self._release.next_number,
            "accounts": self.ledger.state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`; raises AttributeError, KeyError, TypeError or ValueError if it is none."""
        self.watermark_ns = state["watermark"]
        self.clock.shift_ns = int(state["shift"])
        self.sources.update(restored(dict[str, Source], state["sources"]))
        self.sessions.update(restored(dict[int, Key], state["sessions"]))
        self._release.next_number = int(state["next_number"])
        self.ledger.load(state["accounts"])
