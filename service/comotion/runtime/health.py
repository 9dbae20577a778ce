"""Composes what the service reports in its Status, and notices when its loop hangs."""

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from comotion_schemas.component import StatusFields
from comotion_schemas.messages import Problem, ProblemKind, RejectionReason
from comotion_schemas.text import counted, counter_words

from ..event_time.timeline import Timeline
from . import problems
from .clocks import SourceClocks
from .intake import Intake
from .problems import Problems

# Rates are means over this time, so that a source with one batch a second has one.
_RATE_SPAN_NS = 2_000_000_000
# How long something that went wrong keeps the state at degraded: some five Statuses show it.
_RECENT_NS = 5_000_000_000
# s; a source that has left is listed this long.
_FORGET_S = 60.0
# A process that has just started may take so long to its first batch.
_START_NS = 3_000_000_000
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


class Health:
    """Turns counters into rates, recent trouble and a state, for the thread that sends the Status.

    Times are monotonic nanoseconds, if nothing else is said.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._problems = Problems()
        self._fields = StatusFields(message="preparing")
        self._alive_ns: int | None = None

    def alive(self, at_ns: int) -> None:
        """Note that the loop has published an update."""
        self._alive_ns = at_ns

    def status(self) -> StatusFields:
        """Return the last report, or ``stalled`` when the loop hangs."""
        fields, alive_ns = self._fields, self._alive_ns
        silence = 0 if alive_ns is None else time.monotonic_ns() - alive_ns
        if silence <= _HANGING_NS:
            return fields
        return replace(fields, state="stalled", message=f"no update for {silence / 1e9:.1f} s", hangs=True)

    def report(
        self,
        at_ns: int,
        now_ns: int,
        timeline: Timeline,
        intake: Intake,
        clocks: SourceClocks,
        notes: list[str],
    ) -> None:
        """Assemble the fields of the Status; `now_ns` is what stamps are compared with.

        The core has counted and noticed problems, the intake has refused, and knows which sources are there;
        `notes` are further troubles in words.
        """
        present, stats, sources = intake.tokens.present, timeline.ledger.total, timeline.sources
        own = {"clock_steps": clocks.steps, "refused_statuses": intake.statuses.refused}
        counters, rejected = stats.counters() | own, dict(stats.rejected)
        self._samples.append(_Sample(at_ns, intake.received(), counters, rejected))
        while self._samples[0].at_ns < at_ns - _RECENT_NS:
            self._samples.popleft()
        ages = {name: (now_ns - source.newest_ns) / 1e9 for name, source in sorted(sources.items())}
        ages = {name: age for name, age in ages.items() if name in present or age < _FORGET_S}
        live = sources.sending(at_ns).keys() & ages
        silent = sorted(present.keys() - live)
        lasting = self._problems.update(self._texts(at_ns, timeline, present, ages, silent), at_ns)
        trouble = [*notes, *self._recent(intake.rejection), *_in_short(silent, ages, lasting)]
        dead = not live and stats.fused + stats.partly_late > 0
        if dead:
            trouble.insert(0, "no source sends any more")
        stalled = dead or (silent and not live)
        self._fields = StatusFields(
            state="stalled" if stalled else "degraded" if trouble else "ok",
            rates=self._rates(at_ns),
            ages=ages,
            counters=counters,
            rejected=rejected,
            clock_offsets=clocks.offsets(),
            problems=lasting,
            message="; ".join(trouble) or (counted(len(live), "live source") if live else "no live source"),
        )

    def _texts(
        self,
        at_ns: int,
        timeline: Timeline,
        present: Mapping[str, int],
        ages: Mapping[str, float],
        silent: list[str],
    ) -> problems.TextByKey:
        """What a person should change: the core, the counters, and sources without data say so."""
        no_data = [name for name in silent if name not in ages and at_ns - present[name] > _START_NS]
        noticed: dict[ProblemKind, Mapping[str, Any]] = {
            **timeline.troubles.lately(),
            "no-data": {name: name for name in no_data},
            "silent": {name: ages[name] for name in silent if name in ages},
        }
        texts = problems.in_words(noticed)
        if self._samples[-1].counters["faults"] > self._samples[0].counters["faults"]:
            texts[None, "defect"] = problems.DEFECT
        return texts

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

    def _recent(self, rejection: str) -> list[str]:
        """What has gone wrong lately, in words."""
        oldest, newest = self._samples[0], self._samples[-1]
        grown = {name: newest.counters[name] - oldest.counters[name] for name in _TROUBLE}
        refused = sum(newest.rejected.values()) - sum(oldest.rejected.values())
        words = [counter_words(name, count) for name, count in grown.items() if count > 0]
        words += [f"{refused} rejected"] if refused else []
        if not words:
            return []
        last = f", the last on {rejection}" if refused and rejection else ""
        return [f"in the last {_RECENT_NS // 1_000_000_000} s {', '.join(words)}{last}"]


def _in_short(silent: list[str], ages: Mapping[str, float], lasting: list[Problem]) -> list[str]:
    """Name the sources without data, and the problems: their texts are in the Status itself."""
    shown = [f"{name} ({ages[name]:.1f} s)" if name in ages else name for name in silent[:10]]
    return [
        *([f"no data from {', '.join(shown)}"] if shown else []),
        *(
            f"{problem.kind} of {problem.source}" if problem.source else problem.kind
            for problem in lasting
            if problem.kind not in ("silent", "no-data")
        ),
    ]
