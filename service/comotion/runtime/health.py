"""What the service says of itself in its Status."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from comotion_schemas.component import StatusFields
from comotion_schemas.messages import RejectionReason, StatusState

from ..event_time.health import SourceHealth
from ..event_time.stats import Stats
from .intake import Rejection

_RATE_SPAN_NS = 2_000_000_000
_RECENT_NS = 5_000_000_000
_FORGET_NS = 60_000_000_000
# Counters whose growth means that something is wrong.
_TROUBLE = ("lost", "late", "overruns")


@dataclass(frozen=True)
class _Sample:
    at_ns: int
    received: dict[str, int]
    counters: dict[str, int]
    rejected: dict[RejectionReason, int]


@dataclass
class Health:
    """Turns counters into rates, recent trouble and a verdict. Times are monotonic nanoseconds."""

    _samples: deque[_Sample] = field(default_factory=deque)

    def report(
        self,
        monotonic_ns: int,
        *,
        received: Mapping[str, int],
        present: set[str],
        sources: list[SourceHealth],
        stats: Stats,
        rejection: Rejection | None,
        notes: list[str],
    ) -> StatusFields:
        """Assemble the Status; `notes` are further troubles in words."""
        counters, rejected = stats.counters(), dict(stats.rejected)
        self._samples.append(_Sample(monotonic_ns, dict(received), counters, rejected))
        while self._samples[0].at_ns < monotonic_ns - _RECENT_NS:
            self._samples.popleft()
        sources = [s for s in sources if s.name in present or s.age_ns < _FORGET_NS]
        silent = _silent(present, sources)
        trouble = [*notes, *self._recent(counters, rejected, rejection), *_describe(silent)]
        live = [s.name for s in sources if s.live]
        return StatusFields(
            state=_verdict(live, silent, trouble),
            rates=self._rates(monotonic_ns),
            ages={s.name: s.age_ns / 1e9 for s in sources},
            counters=counters,
            rejected=rejected,
            message="; ".join(trouble) or (f"{len(live)} live sources" if live else "no live source"),
        )

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
        trouble = [f"{count} {name}" for name, count in grown.items() if count]
        if refused:
            why = f", last on obs/{rejection.source}: {rejection.error}" if rejection else ""
            trouble.append(f"{refused} rejected{why}")
        return trouble


def _silent(present: set[str], sources: list[SourceHealth]) -> dict[str, float | None]:
    """Sources whose process is there but whose data is not, with the age of what they last sent."""
    ages = {s.name: s.age_ns / 1e9 for s in sources}
    live = {s.name for s in sources if s.live}
    return {name: ages.get(name) for name in sorted(present - live)}


def _describe(silent: Mapping[str, float | None]) -> list[str]:
    if not silent:
        return []
    named = [name if age is None else f"{name} ({age:.1f} s)" for name, age in list(silent.items())[:10]]
    return ["no data from " + ", ".join(named)]


def _verdict(live: list[str], silent: Mapping[str, float | None], trouble: list[str]) -> StatusState:
    if silent and not live:
        return "stalled"
    return "degraded" if trouble else "ok"
