"""Chooses what the next updates leave out: searches, never observations or updates.

The caller measures time; the core counts with it. Every level leaves out what those below it do, in this
order:

1. Joints are not judged. Those known keep their kind; position and rate follow from the poses.
2. The axes of boxes are not sought.
3. Links between spaces are not decided anew.
4. New bodies, and offsets between sources, are searched for at every fifth grouping. At the others, the
   known bodies are fitted and the trajectories assigned to them (rigid method).
5. to 8. Of a large space a half, a fourth, an eighth, a 16th of the trajectories are grouped, some of every
   hypothesis. The others keep their hypotheses; new ones join by place and motion (:mod:`.last_grouping`).
"""

from dataclasses import dataclass
from math import ceil, log2
from typing import NamedTuple

MOST = 8
"""The highest level."""
# Groupings from one search for new bodies to the next.
_SEARCH_EVERY = 5
_WORDS = ("joints", "axes of boxes", "links", "most searches for new bodies")
# Share of a period that an update may take: what arrives must be read, too.
_SHARE = 0.8
# An update that takes twice as long as it may raises the level by so much; and it falls as fast.
_STEPS_PER_DOUBLING = 2
# ns without a slow update after which the level falls, and the longest such time: it doubles each time that
# the level has to rise again soon.
_CALM_NS, _LONGEST_CALM_NS = 500_000_000, 16_000_000_000


class Effort(NamedTuple):
    """What an update does.

    Attributes
    ----------
    joints, boxes, links
        Whether joints are judged, axes of boxes are sought, and links are decided.
    search_every
        Groupings from one search for bodies to the next.
    share
        Share of the trajectories of a large space that is grouped.
    """

    joints: bool = True
    boxes: bool = True
    links: bool = True
    search_every: int = 1
    share: float = 1.0

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

    Attributes
    ----------
    period_ns
        Time between updates, ns.
    level
        From 0, nothing is left out, to :data:`MOST`.
    """

    period_ns: int
    level: int = 0
    _calm_ns: int = _CALM_NS
    _slow_ns: int = 0
    _fell_ns: int | None = None

    def note(self, took_ns: int, at_ns: int) -> int:
        """Take note of what an update took, at a time on a clock that is never set.

        Returns the level from now on. One slow update is enough to raise it. It falls as soon as the lower
        level fits into the period as far as the last update tells.
        """
        # In steps of the level: how far an update is from what it may take.
        distance = _STEPS_PER_DOUBLING * log2(max(took_ns, 1) / (_SHARE * self.period_ns))
        if distance > 0:
            if self._fell_ns is not None:
                early = at_ns - self._fell_ns <= 2 * self._calm_ns
                self._calm_ns = min(2 * self._calm_ns, _LONGEST_CALM_NS) if early else _CALM_NS
            self.level, self._slow_ns, self._fell_ns = min(self.level + ceil(distance), MOST), at_ns, None
        elif self.level and at_ns - self._slow_ns >= self._calm_ns and distance <= -1:
            self.level, self._fell_ns = max(self.level - int(-distance), 0), at_ns
        return self.level


def describe(level: int) -> str:
    """What is left out at a level above 0, in words."""
    share = Effort.at(level).share
    grouped = f"; of a large space one feature in {1 / share:.0f} is grouped" if share < 1 else ""
    return f"left out are {', '.join(_WORDS[:level])}{grouped}"
