"""Batches of many sources in, in any order; instants in time order and ended sessions out.

Event time is one state machine. It reads no clock: both its clocks come from the caller. `now_ns` is what
stamps are compared with. `at_ns` tells when something arrived; it must never be set. Without it, `now_ns` is
taken. The rules are those of docs/protocol.md, "Time"; the accounts are those of Status (:mod:`.stats`).

A batch comes in (`receive`):

1. Sequence numbers are followed per session. A skipped number is `lost` until it comes, a repeated batch is
   dropped.
2. What the caller refuses is rejected, and so is what finds more waiting than its source may have.

The clock is known (`advance`). Each batch that has come in since is judged, in the order of arrival:

3. One whose stamp is far from now may have to wait until it is clear whose clock is wrong (:mod:`.steps`).
4. Rejected, and moves nothing: a stamp more than 1 s ahead of now (`future`); one older than the window
   while there is no watermark yet (`past`); one source too many (`limit`).
5. A source has one session at a time. Batches of another one wait; it takes over once the first has been
   silent for three of its periods, at least 0.2 s. As long as both send, the second is rejected
   (`duplicate-name`). What a session that is over sent before the next one started is `late`.
6. newest(s) is the largest stamp of source s.
7. Rows behind the watermark by at most `allowed_lateness` are `reordered`; older ones are dropped as `late`.
   What a late batch says about ended trajectories holds.

Then the watermark moves and releases:

8. W = max(previous W, now - `max_lag`, smallest newest(s) over live sources), never beyond now. A source is
   live while now - newest(s) <= `source_timeout`. Where none is live, those that still send count, since
   their clocks are behind; without any W stands still.
9. What is stamped <= W comes out in stamp order, ties by source name and then by arrival; newer data waits.
10. Right before the first instant of a new session, :class:`SessionEnded` comes out for the one before.
    Nothing of an ended session comes out any more: what still waits is dropped as `late`.

What is forgotten:

11. A trajectory is outdated after `track_timeout` without observation, or 3 periods of its source if longer.
12. A session is forgotten when it is not its source's and has no trajectory left, and a source when it has
    been silent for `limits.expiry` (`forget_idle`). One source too many displaces the one silent for longest.
"""

from collections.abc import Collection
from typing import Any

import numpy as np

from comotion_schemas import ObservationBatch, RejectionReason

from ..config import FusionConfig, to_ns
from .directory import Sources
from .faults import Faults
from .instants import Entry, Instant, SessionEnded, count_instants, size_of, split
from .load import Load
from .release import Release
from .sources import MAX_RIVALS, PERIODS, Source
from .stats import Key, Ledger, Stats
from .steps import FUTURE_NS, Steps

__all__ = ["FUTURE_NS", "Timeline"]

# Nothing is acquired in the future: clocks that are synchronised agree better than this.
_AHEAD_NS = 250_000_000
_NO_ROWS = np.zeros(0, np.intp)


class Timeline:
    """Event time of one scene, as the rules above say.

    Parameters
    ----------
    config
        `window`, `allowed_lateness`, `max_lag`, `source_timeout`, `track_timeout` and `limits` are used.
    stats, faults
        Where batches, and errors of the service itself, are counted.

    Attributes
    ----------
    watermark_ns
        W on the time scale of the scene, nanoseconds; None until a source has set it.
    sources
        The sources.
    at_ns
        The clock of arrivals at the last :meth:`advance`.
    ledger
        The accounts.
    steps
        The time scale of the scene.
    """

    def __init__(self, config: FusionConfig, stats: Stats, faults: Faults | None = None) -> None:
        self._window_ns = to_ns(config.window)
        self._lateness_ns = to_ns(config.allowed_lateness)
        self._max_lag_ns = to_ns(config.max_lag)
        self._source_timeout_ns = to_ns(config.source_timeout)
        self._track_timeout_ns = to_ns(config.track_timeout)
        self._limits = config.limits
        self._stats = stats
        self._faults = faults or Faults(stats)
        self.sources = Sources(config)
        self._inbox: list[Entry] = []
        self._load = Load(config)
        self._release = Release(self.sources, self._settle)
        # Sessions of which a batch waits because of its clock.
        self._held: set[Key] = set()
        self.at_ns = 0
        self.watermark_ns: int | None = None
        self.ledger = Ledger(stats)
        self.steps = Steps(self._window_ns, self._source_timeout_ns)

    def receive(self, batch: ObservationBatch, refusal: RejectionReason | None = None) -> None:
        """Take a batch in; the next :meth:`advance` judges it against the clock.

        Parameters
        ----------
        batch
            Any batch.
        refusal
            Why the caller cannot use it, if so: its sequence number counts, but nothing else.
        """
        key = batch.source, batch.session
        self.ledger.arrive(key)
        repeated = self.ledger.sight(key, batch.seq) == "repeated"
        entry = Entry(batch, repeated, size_of(batch))
        if repeated and not self.steps.follow_all:
            self.ledger.settle(key, "duplicates")
        elif refusal is not None:
            self.ledger.settle(key, refusal, rejected=True)
        elif not self._load.admits(entry) or count_instants(batch) > self._limits.instants:
            self.ledger.settle(key, "limit", rejected=True)
        else:
            self._load.add(entry)
            self._inbox.append(entry)

    def advance(self, now_ns: int, at_ns: int | None = None) -> list[Instant | SessionEnded]:
        """Judge what has come in, move the watermark, and release what it has passed.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch.
        at_ns
            A clock that is never set, in ns; None: `now_ns`.

        Returns
        -------
        list[Instant | SessionEnded]
            In event-time order. Of each instant the caller says by :meth:`done` what became of it.
        """
        self.at_ns = at_ns = now_ns if at_ns is None else at_ns
        inbox, self._inbox = self._inbox, []
        for entry in inbox:
            entry.at_ns = at_ns
            try:
                self._admit(entry, now_ns)
            except Exception as error:  # a defect costs its batch, not the service
                self._faults.note("judging a batch", error, entry.batch)
                self._settle(entry, "defect", rejected=True)
        # One decision may allow another: that on a clock tells the stamps of rivals, a new session agrees.
        while self._hand_over_all(now_ns) or self._decide(now_ns):
            pass
        self._move_watermark(now_ns)
        return list(self._release.until(self.watermark_ns))

    def done(self, instant: Instant, refused: RejectionReason | None = None) -> None:
        """Settle an instant that came out: it was fused, or refused for a reason."""
        self._release.done(instant, refused)

    @property
    def sessions(self) -> dict[int, Key]:
        """(source, session) by number, of every session that is current or has trajectories."""
        return self._release.sessions

    def track_timeout_ns(self, session: int) -> int:
        """Time without observation after which a trajectory of this session number is outdated."""
        known = self.sources.get(self.sessions[session][0])
        return max(self._track_timeout_ns, PERIODS * (known.period_ns if known else 0))

    def forget_idle(self, used: Collection[int]) -> None:
        """Forget sessions that are over and silent sources, but for numbers in `used`, with trajectories."""
        self.sources.forget_silent(self.at_ns, lambda name, s: s.number in used or self._load.holds(name))
        current = {source.number for source in self.sources.values()}
        for number in self.sessions.keys() - used - current:
            del self.sessions[number]

    def _admit(self, entry: Entry, now_ns: int) -> None:
        """Let a batch that is far from now wait where its clock may be right; judge any other."""
        steps, source = self.steps, self.sources.get(entry.batch.source)
        off = steps.is_off(entry, self._reference(now_ns), self._floor())
        # The end of a recording that is played again fast is near the end of the last one.
        if not off and not (steps.follow_all and entry.key in self._held):
            if entry.repeated:
                self._settle(entry, "duplicates")
            else:
                self._judge(entry, now_ns)
            return
        agreed = source is not None and source.session == entry.batch.session and source.agreed_ns is not None
        if steps.may_wait(entry, agreed=agreed, alone=not self.sources.any_agrees(self.at_ns)):
            steps.held.append(entry)
            self._held.add(entry.key)
            if source is not None and agreed:
                source.hear(entry.at_ns)
        elif entry.repeated:
            self._settle(entry, "duplicates")
        else:
            self._judge(entry, now_ns)

    def _floor(self) -> int | None:
        """Stamp below which all is late; None before the first watermark."""
        return None if self.watermark_ns is None else self.watermark_ns - self._lateness_ns

    def _reference(self, now_ns: int) -> int:
        """The time that stamps are compared with: recordings must not go back behind the watermark."""
        if self.steps.follow_all and self.watermark_ns is not None:
            return max(now_ns, self.watermark_ns)
        return now_ns

    def _decide(self, now_ns: int) -> bool:
        """Judge the batches that wait because of their clock; whether it was clear who is wrong."""
        steps, at_ns = self.steps, self.at_ns
        decision = steps.decide(self.sources.agreed_ns(), at_ns)
        if decision == "wait":
            return False
        if decision == "follow":
            steps.follow(self._reference(now_ns))
        held, steps.held = steps.held, []
        self._held.clear()
        again: set[Key] = set()
        for entry in held:
            if decision == "judge":
                self._doubt(entry)
            elif entry.repeated or entry.key in again:
                self._play_again(entry, again)
            if entry.repeated:
                self._settle(entry, "duplicates")
            else:
                self._judge(entry, now_ns, trusted=decision == "follow")
        return True

    def _doubt(self, entry: Entry) -> None:
        """The clock of a session is wrong: others agree."""
        source = self.sources.get(entry.batch.source)
        if source is not None and source.session == entry.batch.session:
            source.agreed_ns = None

    def _play_again(self, entry: Entry, again: set[Key]) -> None:
        """A recording is played again, with the session that it had before: it is a new one."""
        batch, source = entry.batch, self.sources.get(entry.batch.source)
        if entry.key not in again:
            again.add(entry.key)
            self.ledger.sequences.forget(*entry.key)
            if source is not None and source.session == batch.session:
                source.start(batch.session, self.steps.scene_time(batch), self.at_ns)
        entry.repeated = self.ledger.sight(entry.key, batch.seq) == "repeated"

    def _judge(self, entry: Entry, now_ns: int, *, trusted: bool = False) -> None:
        """Reject a batch, drop it as late, or let its instants wait for the watermark."""
        batch, at_ns = entry.batch, self.at_ns
        source, stamp_ns = self.sources.get(batch.source), self.steps.scene_time(batch)
        if entry.offset_ns > FUTURE_NS and not trusted:
            self.steps.note(batch, entry.offset_ns, at_ns)
            self._settle(entry, "future", rejected=True)
        elif self.watermark_ns is None and stamp_ns < now_ns - self._window_ns and not trusted:
            self.steps.note(batch, stamp_ns - now_ns, at_ns)
            self._settle(entry, "past", rejected=True)
        elif source is None and not self._make_room():
            self._settle(entry, "limit", rejected=True)
        elif source is None:
            source = self.sources[batch.source] = Source(batch.session, stamp_ns, stamp_ns)
            source.observe(stamp_ns, at_ns)
            self._wait(entry, source, now_ns)
        elif batch.session == source.session:
            source.observe(stamp_ns, at_ns)
            self._wait(entry, source, now_ns)
        elif batch.session in source.past and stamp_ns <= source.started_ns:
            self._settle(entry, "late")
        else:
            self._rival(entry, source, now_ns)

    def _rival(self, entry: Entry, source: Source, now_ns: int) -> None:
        """Let a batch of another session of a source wait until it is clear which one has the name."""
        source.rivals.append(entry)
        self._hand_over(source, now_ns)
        if len(source.rivals) > MAX_RIVALS:
            self._settle(source.rivals.pop(0), "duplicate-name", rejected=True)

    def _hand_over_all(self, now_ns: int) -> bool:
        """Whether any rival waits no more."""
        contested = sorted(name for name, source in self.sources.items() if source.rivals)
        return any(self._hand_over(self.sources[name], now_ns) for name in contested)

    def _hand_over(self, source: Source, now_ns: int) -> bool:
        """Give the name to the rival that came first once the session of a source is silent."""
        waiting = len(source.rivals)
        for entry, follows in source.hand_over(self.steps.scene_time, self.at_ns, self._source_timeout_ns):
            if follows:
                self._wait(entry, source, now_ns)
            else:
                self._settle(entry, "duplicate-name", rejected=True)
        return len(source.rivals) < waiting

    def _make_room(self) -> bool:
        """Whether there is room for one more source; the one silent for longest makes it."""
        if len(self.sources) < self._limits.sources:
            return True
        name = self.sources.longest_silent(self.at_ns, self._load.holds)
        if name is None:
            return False
        self._release.end(self.sources.pop(name).number)
        return True

    def _wait(self, entry: Entry, source: Source, now_ns: int) -> None:
        """Let the instants of a batch wait for the watermark, except for those that are too late."""
        batch, watermark = entry.batch, self.watermark_ns
        floor = now_ns - self._window_ns if watermark is None else watermark - self._lateness_ns
        newest_ns, reordered = self.steps.scene_time(batch), False
        for stamp, rows in split(batch):
            stamp_ns = stamp - self.steps.shift_ns
            if stamp_ns < floor:
                entry.late = True
                continue
            in_order = watermark is None or stamp_ns >= watermark
            reordered |= not in_order
            entry.left += 1
            what = Instant(stamp_ns, batch, rows, -1, in_order, stamp_ns == newest_ns, entry)
            self._release.add(what, source.generation)
        self._stats.reordered += reordered
        if watermark is not None and batch.ended is not None and newest_ns < floor:
            what = Instant(watermark, batch, _NO_ROWS, -1, in_order=False, last=True)
            self._release.add(what, source.generation)
        self._note_clock(entry, now_ns)
        if entry.left:
            source.agreed_ns = self.at_ns
        else:
            self._settle(entry, "late")

    def _note_clock(self, entry: Entry, now_ns: int) -> None:
        """Take note of whether the clock of a source is right."""
        offset_ns = self.steps.scene_time(entry.batch) - now_ns
        if not entry.left or offset_ns > _AHEAD_NS or offset_ns < -self._source_timeout_ns:
            self.steps.note(entry.batch, offset_ns, self.at_ns)
        else:
            self.steps.clear(entry.batch.source)

    def _move_watermark(self, now_ns: int) -> None:
        timeout_ns = self._source_timeout_ns
        live = [s.newest_ns for s in self.sources.values() if s.is_live(now_ns, timeout_ns)]
        if not live and not self.steps.follow_all:
            # All clocks are behind, or the service's is ahead: the sources set the pace.
            sending = self.sources.sending(self.at_ns)
            live = [s.newest_ns for s in sending]
            now_ns = min([now_ns, *live])
        if not live:
            return
        reached = min(max(now_ns - self._max_lag_ns, min(live)), now_ns)
        # The previous watermark wins over a clock that was set back: W never decreases.
        self.watermark_ns = reached if self.watermark_ns is None else max(reached, self.watermark_ns)

    def _settle(self, entry: Entry, fate: Any, *, rejected: bool = False) -> None:
        self._load.remove(entry)
        self.ledger.settle(entry.key, fate, rejected=rejected)

    def state(self) -> dict[str, Any]:
        """Watermark, sources, sessions and accounts as plain values; what waits is not kept."""
        return {
            "watermark": self.watermark_ns,
            "shift": self.steps.shift_ns,
            "sources": self.sources.state(),
            "accounts": self.ledger.state(),
        } | self._release.state()

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`.

        Raises
        ------
        KeyError, TypeError, ValueError
            If it is none.
        """
        self.watermark_ns = state["watermark"]
        self.steps.shift_ns = int(state["shift"])
        self.sources.load(state["sources"])
        self._release.load(state)
        self.ledger.load(state["accounts"])
