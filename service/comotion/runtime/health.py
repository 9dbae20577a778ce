"""Composes what the service reports in its Status."""

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from comotion_schemas.component import StatusFields
from comotion_schemas.messages import RejectionReason, StatusState

from ..event_time.sources import SourceHealth
from ..event_time.stats import Stats
from . import problems
from .intake import Rejection
from .problems import Found, Problems

# Rates are means over this time, so that a source with one batch a second has one.
_RATE_SPAN_NS = 2_000_000_000
# How long something that went wrong keeps the state at degraded: some five Statuses show it.
_RECENT_NS = 5_000_000_000
# A source that has left is listed this long.
_FORGET_NS = 60_000_000_000
# A loop without an update for this long hangs: even a slow update takes well under a second.
_HANGING_NS = 3_000_000_000
# Counters whose growth means that something is wrong.
_TROUBLE = ("lost", "late", "partly_late", "overflow", "overruns", "faults")


class Arrivals(NamedTuple):
    """What the intake has seen.

    Attributes
    ----------
    received
        Valid batches so far, by source.
    present
        Names of the sources whose process is there, and since when in monotonic ns.
    rejection
        The newest payload that was refused, if any.
    """

    received: Mapping[str, int]
    present: Mapping[str, int]
    rejection: Rejection | None


@dataclass(frozen=True)
class _Sample:
    at_ns: int
    received: dict[str, int]
    counters: dict[str, int]
    rejected: dict[RejectionReason, int]


@dataclass
class Health:
    """Turns counters into rates, recent trouble and a state. Times are monotonic nanoseconds."""

    _samples: deque[_Sample] = field(default_factory=deque)
    _problems: Problems = field(default_factory=Problems)

    def report(
        self,
        monotonic_ns: int,
        *,
        arrivals: Arrivals,
        sources: list[SourceHealth],
        stats: Stats,
        notes: list[str],
        found: Found | None = None,
    ) -> StatusFields:
        """Assemble the fields of the Status.

        Parameters
        ----------
        monotonic_ns
            Now, on the monotonic clock.
        arrivals
            What the intake has seen.
        sources
            Health of every source that has sent data.
        stats
            Counters of the fusion.
        notes
            Further troubles, in words.
        found
            Problems that the core has noticed.
        """
        present, counters, rejected = arrivals.present, stats.counters(), dict(stats.rejected)
        self._samples.append(_Sample(monotonic_ns, dict(arrivals.received), counters, rejected))
        self._drop_samples(monotonic_ns - _RECENT_NS)
        sources = [s for s in sources if s.name in present or s.age_ns < _FORGET_NS]
        silent = _silent(present, sources)
        lasting = self._problems.update(
            self._found(monotonic_ns, arrivals, sources, stats, found), monotonic_ns
        )
        trouble = [*notes, *self._recent(counters, rejected, arrivals.rejection), *_describe(silent)]
        # The texts are in `problems`.
        named = [f"{one.kind} of {one.source}" if one.source else one.kind for one in lasting]
        trouble += [one for one in named if not one.startswith(("silent", "no-data"))]
        live = [s.name for s in sources if s.sending]
        dead = not live and stats.fused + stats.partly_late > 0
        if dead:
            trouble.insert(0, "no source sends any more")
        return StatusFields(
            state="stalled" if dead else _state(live, silent, trouble),
            rates=self._rates(monotonic_ns),
            ages={s.name: s.age_ns / 1e9 for s in sources},
            counters=counters,
            rejected=rejected,
            problems=lasting,
            message="; ".join(trouble) or (f"{len(live)} live sources" if live else "no live source"),
        )

    def _found(
        self,
        monotonic_ns: int,
        arrivals: Arrivals,
        sources: list[SourceHealth],
        stats: Stats,
        found: Found | None,
    ) -> Found:
        """All problems there are now."""
        before = self._samples[0]
        return {
            **(found or {}),
            **problems.silence(arrivals.present, sources, monotonic_ns),
            **problems.bounds(stats, before.counters, before.rejected.get("limit", 0)),
            **problems.defects(stats, before.counters),
        }

    def _drop_samples(self, before_ns: int) -> None:
        while self._samples[0].at_ns < before_ns:
            self._samples.popleft()

    def _rates(self, monotonic_ns: int) -> dict[str, float]:
        """Batches per second of every source over the last seconds."""
        newest = self._samples[-1]
        oldest = next(s for s in self._samples if s.at_ns >= monotonic_ns - _RATE_SPAN_NS)
        seconds = (newest.at_ns - oldest.at_ns) / 1e9
        if not seconds:
            return dict.fromkeys(newest.received, 0.0)
        return {
            name: (count - oldest.received.get(name, 0)) / seconds for name, count in newest.received.items()
        }

    def _recent(
        self,
        counters: Mapping[str, int],
        rejected: Mapping[RejectionReason, int],
        rejection: Rejection | None,
    ) -> list[str]:
        before = self._samples[0]
        grown = {name: counters[name] - before.counters[name] for name in _TROUBLE}
        refused = sum(rejected.values()) - sum(before.rejected.values())
        trouble = [f"{count} {name.replace('_', ' ')}" for name, count in grown.items() if count > 0]
        if refused:
            why = f", last on obs/{rejection.source}: {rejection.error}" if rejection else ""
            trouble.append(f"{refused} rejected{why}")
        return trouble


def _silent(present: Mapping[str, int], sources: list[SourceHealth]) -> dict[str, float | None]:
    """Sources whose process is there but whose data is not, with the age in s of their last data."""
    ages = {s.name: s.age_ns / 1e9 for s in sources}
    live = {s.name for s in sources if s.sending}
    return {name: ages.get(name) for name in sorted(present.keys() - live)}


def _describe(silent: Mapping[str, float | None]) -> list[str]:
    if not silent:
        return []
    named = [name if age is None else f"{name} ({age:.1f} s)" for name, age in list(silent.items())[:10]]
    return ["no data from " + ", ".join(named)]


def _state(live: list[str], silent: Mapping[str, float | None], trouble: list[str]) -> StatusState:
    if silent and not live:
        return "stalled"
    return "degraded" if trouble else "ok"


class Watchdog:
    """Passes the loop's report on to the thread that sends the Status, and notices when the loop hangs."""

    def __init__(self) -> None:
        self._fields = StatusFields(message="preparing")
        self._alive_ns: int | None = None

    def report(self, fields: StatusFields) -> None:
        """Replace the fields of the Status."""
        self._fields = fields

    def alive(self, monotonic_ns: int) -> None:
        """Note that the loop has published an update."""
        self._alive_ns = monotonic_ns

    def status(self) -> StatusFields:
        """Return the last report, or ``stalled`` when the loop hangs."""
        fields, alive_ns = self._fields, self._alive_ns
        silence = 0 if alive_ns is None else time.monotonic_ns() - alive_ns
        if silence <= _HANGING_NS:
            return fields
        return replace(fields, state="stalled", message=f"no update for {silence / 1e9:.1f} s", hangs=True)
