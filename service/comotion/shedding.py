"""Chooses what the next updates leave out: searches, never observations or updates.

The caller measures time; the core counts with it. Every level leaves out what those below it do, in this
order:

1. Joints are not judged. Those known keep their kind; position and rate follow from the poses.
2. The axes of boxes are not sought.
3. Links between spaces are not decided anew.
4. New bodies, and offsets between sources, are searched for at every fifth grouping. At the others, the
   known bodies are fitted and the trajectories assigned to them (rigid method).
5. to 8. Of a large space a half, a fourth, an eighth, a 16th of the trajectories are grouped, some of every
   hypothesis. The others keep their hypotheses; new ones join by place and motion (:mod:`.sampling`).
"""

from collections import deque
from dataclasses import dataclass, field
from math import ceil, log2
from statistics import median_low
from typing import NamedTuple

MOST = 8
"""The highest level."""
# Groupings from one search for new bodies to the next.
_SEARCH_EVERY = 5
_WORDS = ("joints", "axes of boxes", "links", "most searches for new bodies")
# Share of a period that an update may take: batches that arrive must be read, too.
_SHARE = 0.8
# An update that takes twice as long as it may raises the level by so much.
_STEPS_PER_DOUBLING = 2
# ns without a slow update after which the level falls.
_CALM_NS = 500_000_000
# Updates of a level whose costs are remembered: their median counts, as a single cost is no measure.
_REMEMBERED = 5
# ns after which half of what a level has cost is forgotten: it is tried again now and then.
_FORGOTTEN_NS = 10_000_000_000


class Effort(NamedTuple):
    """Work that an update does."""

    joints: bool = True
    boxes: bool = True
    links: bool = True
    """Whether joints are judged, axes of boxes are sought, and links are decided."""
    search_every: int = 1
    """Groupings from one search for bodies to the next."""
    share: float = 1.0
    """Share of the trajectories of a large space that is grouped."""

    @classmethod
    def at(cls, level: int) -> "Effort":
        """At a level, from 0, which leaves nothing out, to :data:`MOST`."""
        level = min(max(level, 0), MOST)
        search = _SEARCH_EVERY if level >= 4 else 1
        return cls(level < 1, level < 2, level < 3, search, 0.5 ** max(level - 4, 0))


FULL = Effort()
"""Nothing is left out."""


@dataclass
class Load:
    """Finds the level from what updates take.

    What a level costs in processor time is remembered; how much longer an update takes than that tells how
    busy the machine is. So all is done again as soon as the machine has time, and a level at which updates
    are slow is not tried again and again.
    """

    period_ns: int
    """Time between updates, ns."""
    level: int = 0
    """From 0, nothing is left out, to :data:`MOST`."""
    _slow_ns: int = 0
    # By level: processor time of its last updates, ns, and when the last one was.
    _costs: dict[int, deque[int]] = field(default_factory=dict)
    _last_ns: dict[int, int] = field(default_factory=dict)
    # Of the updates since the last slow one and _CALM_NS: when, and how much longer than its cost it took.
    _stretched: deque[tuple[int, float]] = field(default_factory=deque)

    def note(self, took_ns: int, spent_ns: int, at_ns: int) -> int:
        """Take note of an update at a time on a clock that is never set; returns the level from now on.

        How long it took and its processor time are in ns. One slow update is enough to raise the level. It
        falls half a second later, to where updates fit into the period as the machine is now.
        """
        most_ns = _SHARE * self.period_ns
        spent_ns = max(spent_ns, 1)
        self._costs.setdefault(self.level, deque(maxlen=_REMEMBERED)).append(spent_ns)
        self._last_ns[self.level] = at_ns
        self._stretched.append((at_ns, took_ns / spent_ns))
        while self._stretched[0][0] <= at_ns - _CALM_NS:
            self._stretched.popleft()
        if took_ns > most_ns:
            steps = ceil(_STEPS_PER_DOUBLING * log2(took_ns / most_ns))
            self.level, self._slow_ns = min(self.level + steps, MOST), at_ns
        elif self.level and at_ns - self._slow_ns >= _CALM_NS:
            busy = max(stretch for _, stretch in self._stretched)
            fitting = (level for level in range(self.level) if busy * self._expected(level, at_ns) <= most_ns)
            self.level = next(fitting, self.level)
        return self.level

    @property
    def busy(self) -> float:
        """How much longer than its processor time an update takes of late, at least 1."""
        return max(1.0, median_low([stretch for _, stretch in self._stretched] or [1.0]))

    def _expected(self, level: int, at_ns: int) -> float:
        """Probable cost of a lower level, ns: no less than that of the present one."""
        present = median_low(self._costs[self.level])
        if level not in self._costs:
            return float(present * 2 ** ((self.level - level) / _STEPS_PER_DOUBLING))
        forgotten = 0.5 ** ((at_ns - self._last_ns[level]) / _FORGOTTEN_NS)
        return max(float(median_low(self._costs[level]) * forgotten), present)


def describe(level: int) -> str:
    """What is left out at a level above 0, in words."""
    share = Effort.at(level).share
    grouped = f"; of a large space one feature in {1 / share:.0f} is grouped" if share < 1 else ""
    return f"left out are {', '.join(_WORDS[:level])}{grouped}"
