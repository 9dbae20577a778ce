"""Composes what the service reports in its Status, and notices when its loop hangs.

Problems that the fusion and the intake have noticed are put into words, with what a person should change. A
problem is logged once when it begins and once when it ends, and is in the Status until then.
"""

import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from comotion_schemas.component import StatusFields
from comotion_schemas.messages import Problem, ProblemKind
from comotion_schemas.text import counted, counter_words
from comotion_schemas.time_units import unix_unit

from ..event_time.timeline import Timeline
from ..event_time.troubles import ClockTrouble
from .clocks import SourceClocks
from .intake import Intake
from .log_limit import limited
from .standby.election import Election

# Rates are means over this time, so that a source with one batch a second has one.
_RATE_SPAN_NS = 2_000_000_000
# How long something that went wrong keeps the state at degraded: some five Statuses show it.
_RECENT_NS = 5_000_000_000
# A process that has just started may take so long to its first batch.
_START_NS = 3_000_000_000
# A loop without an update for this long hangs: even a slow update takes well under a second.
_HANGING_NS = 3_000_000_000
# Counters whose growth means that something is wrong.
_TROUBLE = ("lost", "late", "partly_late", "overflow", "overruns", "faults", "rejected")
# A problem ends when it has not been seen for so long: one that comes and goes is logged once.
_LASTS_NS = 10_000_000_000
# Problems that a Status lists at most, also in a hostile scene; and of one kind.
_MOST, _MOST_OF_A_KIND = 64, 16
_MOST_ALIKE = 8
# Microseconds go up by a thousandth of this.
_PACE_OF_NS = 0.1
_log = limited(__name__)

Key = tuple[str | None, ProblemKind]
TextByKey = dict[Key, str]


@dataclass(frozen=True)
class _Sample:
    at_ns: int
    received: dict[str, int]
    counters: dict[str, int]


class Health:
    """Turns counters into rates, recent trouble and a state, for the thread that sends the Status.

    Times are monotonic nanoseconds, if nothing else is said; `alive_ns` is that of the last update.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._problems = Problems()
        self._fields = StatusFields(message="preparing")
        self.alive_ns: int | None = None

    def status(self, election: Election | None = None) -> StatusFields:
        """Return the last report, or ``stalled`` when the loop hangs."""
        fields, alive_ns = self._fields, self.alive_ns
        if election is not None:
            epoch = election.epoch
            fields = replace(fields, replica="standby" if epoch is None else "active", epoch=epoch or 0)
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
        sums = counters | {"rejected": sum(rejected.values())}
        self._samples.append(_Sample(at_ns, intake.received(), sums))
        while self._samples[0].at_ns < at_ns - _RECENT_NS:
            self._samples.popleft()
        ages = {name: (now_ns - source.newest_ns) / 1e9 for name, source in sorted(sources.items())}
        live = sources.sending(at_ns)
        silent = sorted(present.keys() - live.keys())
        lasting = self._problems.update(self._texts(at_ns, timeline, present, ages, silent), at_ns)
        trouble = [*notes, *self._recent(intake.rejection), *_in_short(silent, ages, lasting)]
        dead = not live and stats.fused + stats.partly_late > 0
        if dead:
            trouble.insert(0, "no source sends any more")
        stalled = dead or (silent and not live)
        # The intake knows sources that have long left, too.
        rates = {n: rate for n, rate in self._rates(at_ns).items() if rate or n in ages or n in present}
        self._fields = StatusFields(
            state="stalled" if stalled else "degraded" if trouble else "ok",
            rates=rates,
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
    ) -> TextByKey:
        """What a person should change: the core, the counters, and sources without data say so."""
        no_data = [name for name in silent if name not in ages and at_ns - present[name] > _START_NS]
        noticed: dict[ProblemKind, Mapping[str, Any]] = {
            **timeline.troubles.lately(),
            "no-data": {name: name for name in no_data},
            "silent": {name: max(ages[name], 0.0) for name in silent if name in ages},
        }
        texts = in_words(noticed)
        if self._samples[-1].counters["faults"] > self._samples[0].counters["faults"]:
            text = "the service failed on some data and goes on; please report the trace in its log"
            texts[None, "defect"] = text
        return texts

    def _rates(self, monotonic_ns: int) -> dict[str, float]:
        """Batches per second of every source over the last seconds."""
        newest = self._samples[-1]
        oldest = next(s for s in self._samples if s.at_ns >= monotonic_ns - _RATE_SPAN_NS)
        seconds = max(newest.at_ns - oldest.at_ns, 1) / 1e9
        return {
            name: (count - oldest.received.get(name, 0)) / seconds for name, count in newest.received.items()
        }

    def _recent(self, rejection: str) -> list[str]:
        oldest, newest = self._samples[0], self._samples[-1]
        grown = {name: newest.counters[name] - oldest.counters[name] for name in _TROUBLE}
        words = [counter_words(name, count) for name, count in grown.items() if count > 0]
        if not words:
            return []
        last = f", the last on {rejection}" if grown["rejected"] and rejection else ""
        return [f"in the last {_RECENT_NS // 1_000_000_000} s {', '.join(words)}{last}"]


def _in_short(silent: list[str], ages: Mapping[str, float], lasting: list[Problem]) -> list[str]:
    """Name the sources without data, and the problems: their texts are in the Status itself."""
    shown = [f"{name} ({ages[name]:.1f} s)" if name in ages else name for name in silent[:10]]
    others = [problem for problem in lasting if problem.kind not in ("silent", "no-data")]
    return ([f"no data from {', '.join(shown)}"] if shown else []) + [
        f"{problem.kind} of {problem.source}" if problem.source else problem.kind for problem in others
    ]


class Problems:
    """Problems over time. Times are monotonic nanoseconds, but for those in the messages."""

    def __init__(self) -> None:
        # With the time at which each was seen last.
        self._lasting: dict[Key, tuple[Problem, int]] = {}

    def update(self, texts: TextByKey, at_ns: int) -> list[Problem]:
        """Follow the problems; returns those that last, the oldest first."""
        of_kind = Counter(kind for _, kind in self._lasting)
        for (source, kind), text in texts.items():
            lasting = self._lasting.get((source, kind))
            if lasting is None:
                if len(self._lasting) >= _MOST or of_kind[kind] >= _MOST_OF_A_KIND:
                    continue
                of_kind[kind] += 1
                _log.warning("%s: %s", kind, text)
            since_ns = time.time_ns() if lasting is None else lasting[0].since_ns
            problem = Problem(source=source, kind=kind, since_ns=since_ns, text=text[:500])
            self._lasting[source, kind] = problem, at_ns
        for key, (problem, seen_ns) in list(self._lasting.items()):
            if at_ns - seen_ns > _LASTS_NS:
                del self._lasting[key]
                _log.info("%s is over: %s", key[1], problem.text)
        return [problem for problem, _ in self._lasting.values()]


def in_words(noticed: Mapping[ProblemKind, Mapping[str, Any]]) -> TextByKey:
    """Texts of what was noticed: by kind, the evidence of each source."""
    texts: TextByKey = {}
    for kind, evidence in noticed.items():
        for name, shown in islice(evidence.items(), _MOST_ALIKE):
            # Without a name where batches were displaced before they were read.
            texts[name or None, kind] = f"{name or 'invalid names, or too many'}: {_in_words(kind, shown)}"
        # Of many sources, the first ones and how many more: a storm of tokens is one line.
        if len(evidence) > _MOST_ALIKE:
            texts[None, kind] = f"{len(evidence) - _MOST_ALIKE} more sources have this problem"
    return texts


def _clock_zero(trouble: ClockTrouble) -> str:
    unit = unix_unit(trouble.stamp_ns)
    # Stamps that go up as time does are nanoseconds, whatever they look like.
    if unit is not None and trouble.pace < _PACE_OF_NS:
        return f"its stamps are Unix times in {unit}; send nanoseconds"
    return "its stamps count from a start, not from 1970; add the Unix time of that start, in nanoseconds"


# What a person should change, by the kind of problem: a text that its evidence is put into.
_TEXTS: dict[ProblemKind, str] = {
    "clock-ahead": "its stamps are {0.off_s:.1f} s ahead of this machine; synchronise the clocks (NTP or "
    "PTP)",
    "clock-behind": "its stamps are {0.off_s:.1f} s old when they arrive; synchronise the clocks (NTP or PTP)"
    ", or send sooner; for a recording with its own stamps, start the service with --clock event",
    "ids-short-lived": "an id lasts {:.1f} batches in the mean, too short for motion; track features from "
    "frame to frame, and give each the same id in every batch",
    "ids-reused": "{:.0f} % of its features trade places from batch to batch; an id must stay with its "
    "feature, and is no index of a list",
    "scale": "positions {:.0f} times as far out as other sources see are refused; publish metres in the "
    "frame of the others, or use a space of its own",
    "duplicate-name": "a second process publishes under this name and is refused; give it another name",
    "over-budget": "its data takes more time than its share, so that some waits or is dropped; send fewer "
    "features, instants or spaces",
    "limit": "{}",
    "contradicts-space": "says {}; publish in a space of its own, or set what is right in [spaces] of the "
    "parameters",
    "drifts": "turns, shifts or delays away from the other sources, in all that it sees; calibrate it again, "
    "see what it is mounted on, and synchronise its clock",
    "no-data": "its process is there but no batch of it was accepted; see that it publishes on obs/{} and "
    "what is rejected",
    "silent": "no data for {:.0f} s though its process is there; see whether its sensor or its loop hangs",
}


def _in_words(kind: ProblemKind, evidence: Any) -> str:
    """What a person should change about one source; some evidence is a text already."""
    if kind == "clock-zero":
        return _clock_zero(evidence)
    if kind == "ids-reused" and not evidence:
        return "ids come back after they have ended; give every new feature an id that was never used"
    if kind == "scale" and isinstance(evidence, str):
        return evidence
    return _TEXTS[kind].format(100 * evidence if kind == "ids-reused" else evidence)
