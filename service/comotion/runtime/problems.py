"""Words problems that the fusion and the intake have noticed, and what a person should change.

A problem is logged once when it begins and once when it ends, and is in the Status until then.
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

from comotion_schemas.messages import Problem, ProblemKind
from comotion_schemas.time_units import unix_unit

from ..event_time.troubles import ClockTrouble
from .log_limit import limited

# A problem ends when it has not been seen for so long: one that comes and goes is logged once.
_LASTS_NS = 10_000_000_000
# Problems that a Status lists at most, also in a hostile scene; and of one kind.
_MOST, _MOST_OF_A_KIND = 64, 16
_MOST_ALIKE = 8
# In the place of a source, where batches were displaced before they were read.
_NO_QUEUE = "invalid names, or too many"
# Microseconds go up by a thousandth of this.
_PACE_OF_NS = 0.1
_log = limited(__name__)

Key = tuple[str | None, ProblemKind]
TextByKey = dict[Key, str]
DEFECT = "the service failed on some data and goes on; please report the trace in its log"
"""Text where the counter of faults has grown."""


class Problems:
    """Problems over time. Times are monotonic nanoseconds, but for those in the messages."""

    def __init__(self) -> None:
        self._lasting: dict[Key, Problem] = {}
        self._seen_ns: dict[Key, int] = {}

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
            since_ns = time.time_ns() if lasting is None else lasting.since_ns
            problem = Problem(source=source, kind=kind, since_ns=since_ns, text=text[:500])
            self._lasting[source, kind], self._seen_ns[source, kind] = problem, at_ns
        for key in [key for key, seen_ns in self._seen_ns.items() if at_ns - seen_ns > _LASTS_NS]:
            del self._seen_ns[key]
            _log.info("%s is over: %s", key[1], self._lasting.pop(key).text)
        return list(self._lasting.values())


def in_words(noticed: Mapping[ProblemKind, Mapping[str, Any]]) -> TextByKey:
    """Texts of what was noticed: by kind, the evidence of each source."""
    texts: TextByKey = {}
    for kind, evidence in noticed.items():
        for name, shown in islice(evidence.items(), _MOST_ALIKE):
            texts[name or None, kind] = f"{name or _NO_QUEUE}: {_TEXTS[kind](shown)}"
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


def _reused(share: float) -> str:
    if not share:
        return "ids come back after they have ended; give every new feature an id that was never used"
    return (
        f"{100 * share:.0f} % of its features trade places from batch to batch; an id must stay with its "
        "feature, and is no index of a list"
    )


def _scale(evidence: float | str) -> str:
    if isinstance(evidence, str):
        return evidence
    return (
        f"positions {evidence:.0f} times as far out as other sources see are refused; publish metres in the "
        "frame of the others, or use a space of its own"
    )


# What a person should change, by the kind of problem, from its evidence.
_TEXTS: dict[ProblemKind, Callable[[Any], str]] = {
    "clock-zero": _clock_zero,
    "clock-ahead": lambda off: (
        f"its stamps are {off.offset_ns / 1e9:.1f} s ahead of this machine; synchronise the clocks (NTP or "
        "PTP)"
    ),
    "clock-behind": lambda off: (
        f"its stamps are {abs(off.offset_ns) / 1e9:.1f} s old when they arrive; synchronise the clocks (NTP "
        "or PTP), or send sooner; for a recording with its own stamps, start the service with --clock event"
    ),
    "ids-short-lived": lambda life: (
        f"an id lasts {life:.1f} batches in the mean, too short for motion; track features from frame to "
        "frame, and give each the same id in every batch"
    ),
    "ids-reused": _reused,
    "scale": _scale,
    "duplicate-name": lambda _: (
        "a second process publishes under this name and is refused; give it another name"
    ),
    "over-budget": lambda _: (
        "its data takes more time than its share, so that some waits or is dropped; send fewer features, "
        "instants or spaces"
    ),
    "limit": str,
    "contradicts-space": lambda text: (
        f"says {text}; publish in a space of its own, or set what is right in [spaces] of the parameters"
    ),
    "drifts": lambda _: (
        "turns, shifts or delays away from the other sources, in all that it sees; calibrate it again, see "
        "what it is mounted on, and synchronise its clock"
    ),
    "no-data": lambda name: (
        "its process is there but no batch of it was accepted; see that it publishes on "
        f"obs/{name} and what is rejected"
    ),
    "silent": lambda age_s: (
        f"no data for {max(age_s, 0.0):.0f} s though its process is there; see whether its "
        "sensor or its loop hangs"
    ),
}
