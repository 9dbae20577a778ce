"""A level in, what an update leaves out at it: fewer searches, never fewer observations.

The caller measures time; the core only obeys. Every level leaves out what those below it do, in this order:

1. Joints are not judged. Those known keep their kind; position and rate follow from the poses.
2. The axes of boxes are not sought.
3. Links between spaces are not decided anew.
4. New bodies, and offsets between sources, are searched for at every fifth grouping. At the others, the
   known bodies are fitted and the trajectories assigned to them (rigid method).
5. to 8. A space is grouped at every second, fourth, eighth, 16th update only, the spaces in turn. In
   between its trajectories keep their groups; new ones belong to none until then.
"""

from typing import NamedTuple

MOST = 8
"""The highest level."""
# Groupings from one search for new bodies to the next.
_SEARCH_EVERY = 5
_WORDS = ("joints", "axes of boxes", "links", "most searches for new bodies")


class Effort(NamedTuple):
    """What an update does.

    Attributes
    ----------
    joints, boxes, links
        Whether joints are judged, axes of boxes are sought, and links are decided.
    search_every, group_every
        Groupings from one search for bodies to the next, and updates from one grouping to the next.
    """

    joints: bool = True
    boxes: bool = True
    links: bool = True
    search_every: int = 1
    group_every: int = 1

    @classmethod
    def at(cls, level: int) -> "Effort":
        """At a level, from 0, which leaves nothing out, to :data:`MOST`."""
        level = min(max(level, 0), MOST)
        search = _SEARCH_EVERY if level >= 4 else 1
        return cls(level < 1, level < 2, level < 3, search, 2 ** max(level - 4, 0))


FULL = Effort()
"""Nothing is left out."""


def describe(level: int) -> str:
    """What is left out at a level above 0, in words."""
    every = Effort.at(level).group_every
    grouped = f"; a space is grouped at one update in {every}" if every > 1 else ""
    return f"left out are {', '.join(_WORDS[:level])}{grouped}"
