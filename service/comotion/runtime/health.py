"""Composes what the service reports in its Status."""

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from comotion_schemas.component import StatusFields
from comotion_schemas.messages import ProblemKind, RejectionReason
from comotion_schemas.text import counted, counter_words

from ..event_time.sources import SourceHealth
from ..event_time.stats import Stats
from . import problems
from .intake import Intake
from .problems import Problems

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
        intake: Intake,
        sources: list[SourceHealth],
        stats: Stats,
        notes: list[str],
        noticed: Mapping[ProblemKind, Mapping[str, Any]] | None = None,
    ) -> StatusFields:
        """Assemble the fields of the Status, at a time on the monotonic clock.

        The arguments give what the intake has received, which sources are present and what it has refused
        last, the health of every source that has sent data, the counters, further troubles in words
        (`notes`), and the problems that the core has noticed: by kind, the evidence of each source.
        """
        present, counters, rejected = intake.present, stats.counters(), dict(stats.rejected)
        self._samples.append(_Sample(monotonic_ns, dict(intake.received), counters, rejected))
        while self._samples[0].at_ns < monotonic_ns - _RECENT_NS:
            self._samples.popleft()
        oldest = self._samples[0]
        sources = [s for s in sources if s.name in present or s.age_ns < _FORGET_NS]
        texts = problems.in_words({**(noticed or {}), **problems.silence(present, sources, monotonic_ns)})
        if stats.faults > oldest.counters["faults"]:
            texts[None, "defect"] = problems.DEFECT
        lasting = self._problems.update(texts, monotonic_ns)
        live = [s.name for s in sources if s.sending]
        silent = sorted(present.keys() - live)
        trouble = [*notes, *self._recent(counters, rejected, intake.rejection)]
        if silent:
            ages = {s.name: f" ({s.age_ns / 1e9:.1f} s)" for s in sources}
            trouble.append("no data from " + ", ".join(name + ages.get(name, "") for name in silent[:10]))
        # The texts are in `problems`; silent sources are listed already.
        trouble += [
            f"{problem.kind} of {problem.source}" if problem.source else problem.kind
            for problem in lasting
            if problem.kind not in ("silent", "no-data")
        ]
        dead = not live and stats.fused + stats.partly_late > 0
        if dead:
            trouble.insert(0, "no source sends any more")
        stalled = dead or (silent and not live)
        return StatusFields(
            state="stalled" if stalled else "degraded" if trouble else "ok",
            rates=self._rates(monotonic_ns),
            ages={s.name: s.age_ns / 1e9 for s in sources},
            counters=counters,
            rejected=rejected,
            problems=lasting,
            message="; ".join(trouble) or (counted(len(live), "live source") if live else "no live source"),
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
        rejection: str,
    ) -> list[str]:
        oldest = self._samples[0]
        grown = {name: counters[name] - oldest.counters[name] for name in _TROUBLE}
        refused = sum(rejected.values()) - sum(oldest.rejected.values())
        words = [counter_words(name, count) for name, count in grown.items() if count > 0]
        words += [f"{refused} rejected"] if refused else []
        if not words:
            return []
        last = f", the last on {rejection}" if refused and rejection else ""
        return [f"in the last {_RECENT_NS // 1_000_000_000} s {', '.join(words)}{last}"]


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
