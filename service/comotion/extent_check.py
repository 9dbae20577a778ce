"""Refuses rows that are far outside of what the sources of a space see.

One source that measures in another unit, or whose numbers are wild, must not spoil what the others see: a
body fitted across 1e9 m has no millimetres left. What lies many times farther out than all that the other
sources see is refused. What they see is measured by medians over sources, so that one cannot move it; of two,
the one that came first is believed. Of many the first ones count: what a batch costs does not grow with
the number of sources. Where all agree on a unit that is hardly metres, nothing is refused: it is reported.
"""

from dataclasses import dataclass, field

import numpy as np

from comotion_schemas.doubts import other_unit

from .arrays import Bools, Floats, Ints
from .config import Unit
from .event_time.troubles import Troubles

# Views of sources are taken once in so many updates, and when one comes or leaves: a scene does not grow
# a hundred times larger within a second.
_LOOK_EVERY = 8
# Share of the positions of a source that its reach covers.
_MOST_OF_IT = 0.9
# Sources whose views count, the first to come.
_MAX_VIEWS = 16
# Scenes smaller than this, in the unit of the space, count as so large.
_MIN_EXTENT = {"m": 1.0, "px": 1000.0}


@dataclass
class ExtentCheck:
    """Follows where the trajectories of each source of a space are.

    Attributes
    ----------
    unit
        Of the space.
    most
        How many times as far as the others see a position may be; 0: any.
    troubles
        Get to know how many times as far a refused row was, or a sentence that the positions of a source look
        as if they were in another unit.
    """

    unit: Unit
    most: float
    troubles: Troubles
    # By session number: a doubt about its unit, the newest positions of its trajectories with their median,
    # and where the scene is, and how far it reaches, as others see it.
    _doubts: dict[int, str] = field(default_factory=dict)
    _views: dict[int, tuple[Floats, Floats]] = field(default_factory=dict)
    _scenes: dict[int, tuple[Floats, float]] = field(default_factory=dict)
    _looks: int = 0

    def look(self, sessions: Ints, positions: Floats) -> None:
        """Take note of where the current trajectories are: session numbers [n] and places [n, dim]."""
        if not self.most:
            return
        present = np.unique(sessions).tolist()
        self._looks += 1
        if self._looks % _LOOK_EVERY and list(self._views) == present:
            return
        self._scenes.clear()
        places = {number: positions[sessions == number] for number in present}
        self._views = {number: (np.median(own, axis=0), own) for number, own in places.items()}
        first = {number: other_unit(places[number], self.unit) for number in present[:_MAX_VIEWS]}
        self._doubts = {number: text for number, text in first.items() if text}

    def near(self, session: int, source: str, positions: Floats) -> Bools:
        """Which rows float64 [n, dim] of a session of a source may be places of the scene, bool [n]."""
        near = np.ones(len(positions), np.bool_)
        trouble: float | str | None = self._doubts.get(session)
        if self._views and self.most and len(positions):
            if session not in self._scenes:
                self._scenes[session] = self._seen_by_others(session)
            centre, reach = self._scenes[session]
            offset = positions - centre
            squares = np.einsum("nd,nd->n", offset, offset)
            near = squares <= (self.most * reach) ** 2
            if not near.all():
                trouble = float(np.sqrt(squares.max())) / reach
        if trouble:
            self.troubles.note("scale", source, trouble)
        return near

    def _seen_by_others(self, session: int) -> tuple[Floats, float]:
        """Where the scene is and how far it reaches, as others than a session see it, if there are any."""
        numbers = [number for number in self._views if number != session][:_MAX_VIEWS]
        if session in self._views and (not numbers or (len(numbers) == 1 and session < numbers[0])):
            numbers = [session]
        views = [self._views[number] for number in numbers]
        centre = np.asarray(np.median([middle for middle, _ in views], axis=0), np.float64)
        reach = float(np.median([_reach(own, centre) for _, own in views]))
        return centre, max(reach, _MIN_EXTENT[self.unit])


def _reach(positions: Floats, centre: Floats) -> float:
    """Distance from a place within which most of the positions are."""
    distance = np.linalg.norm(positions - centre, axis=1)
    most = round(_MOST_OF_IT * (len(distance) - 1))
    return float(np.partition(distance, most)[most])
