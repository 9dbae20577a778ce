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

from .arrays import Bools, Floats, Slots
from .config import Unit
from .trajectories.window import Window

# Views of sources are taken once in so many updates, and when one comes or leaves: a scene does not grow
# a hundred times larger within a second.
_LOOK_EVERY = 8
# Share of the positions of a source that its reach covers.
_MOST_OF_IT = 0.9
# Sources whose views count, the first to come.
_MAX_VIEWS = 16
# Scenes smaller than this, in the unit of the space, count as so large.
_MIN_EXTENT = {"m": 1.0, "px": 1000.0}


@dataclass(frozen=True)
class _View:
    """View of one session: float64 [dim] the median of its newest positions, and all of them [n, dim]."""

    centre: Floats
    positions: Floats

    def reach(self, centre: Floats) -> float:
        """Distance from a place within which most of the positions are."""
        distance = np.linalg.norm(self.positions - centre, axis=1)
        most = round(_MOST_OF_IT * (len(distance) - 1))
        return float(np.partition(distance, most)[most])


@dataclass
class ExtentCheck:
    """Follows where the trajectories of each source of a space are.

    Attributes
    ----------
    unit
        Of the space.
    most
        How many times as far as the others see a position may be; 0: any.
    refused
        By session number: how many times as far its last refused row was.
    doubts
        By session number: a sentence that its positions look as if they were in another unit.
    """

    unit: Unit
    most: float
    refused: dict[int, float] = field(default_factory=dict)
    doubts: dict[int, str] = field(default_factory=dict)
    _views: dict[int, _View] = field(default_factory=dict)
    _scenes: dict[int, tuple[Floats, float]] = field(default_factory=dict)
    _looks: int = 0

    def look(self, window: Window, current: Slots) -> None:
        """Take note of where the current trajectories are."""
        if not self.most:
            return
        owners = window.source[current]
        present = np.unique(owners).tolist()
        self._looks += 1
        if self._looks % _LOOK_EVERY and list(self._views) == present:
            return
        self._scenes.clear()
        positions = window.positions[current, window.stop[current] - 1]
        self._views = {
            number: _View(np.median(own_positions, axis=0), own_positions)
            for number in present
            for own_positions in (positions[owners == number],)
        }
        first = list(self._views.items())[:_MAX_VIEWS]
        unit_doubts = {number: other_unit(view.positions, self.unit) for number, view in first}
        self.doubts = {number: text for number, text in unit_doubts.items() if text}

    def fits(self, session: int, positions: Floats) -> Bools | None:
        """Which rows float64 [n, dim] of a session may be places of the scene, bool [n]; None: all."""
        if not self._views or not self.most:
            return None
        if session not in self._scenes:
            self._scenes[session] = self._seen_by_others(session)
        centre, reach = self._scenes[session]
        offset = positions - centre
        squares = np.einsum("nd,nd->n", offset, offset)
        farthest = float(np.sqrt(squares.max(initial=0.0)))
        if farthest <= self.most * reach:
            self.refused.pop(session, None)
            return None
        self.refused[session] = farthest / reach
        return np.asarray(squares <= (self.most * reach) ** 2)

    def _seen_by_others(self, session: int) -> tuple[Floats, float]:
        """Where the scene is and how far it reaches, as others than a session see it, if there are any."""
        numbers = [number for number in self._views if number != session][:_MAX_VIEWS]
        others = {number: self._views[number] for number in numbers}
        own_view = self._views.get(session)
        if own_view is not None and (not others or (len(others) == 1 and session < min(others))):
            others = {session: own_view}
        centre = np.asarray(np.median([view.centre for view in others.values()], axis=0), np.float64)
        reach = float(np.median([view.reach(centre) for view in others.values()]))
        return centre, max(reach, _MIN_EXTENT[self.unit])
