"""Notices sources whose ids or unit cannot be right, for as long as their data shows it.

Three mistakes make data useless though each batch is well formed:

- `ids-short-lived`: a detector without a tracker numbers what it sees anew; nothing is seen twice.
- `ids-reused`: an id comes back after its end, or ids are places in a list, so that features trade them.
- `scale`: positions are hundreds of times farther out than those of others, or those of a lone source span
  more than metres usually do.

One source that measures in another unit, or whose numbers are wild, must not spoil what the others see: a
body fitted across 1e9 m has no millimetres left. What lies many times farther out than all that the other
sources see is refused. What they see is measured by medians over sources, so that one cannot move it; of two,
the one that came first is believed. Of many the first ones count: what a batch costs does not grow with
the number of sources. Where all agree on a unit that is hardly metres, nothing is refused: it is reported.
"""

from dataclasses import dataclass, field

import numpy as np

from comotion_schemas.doubts import other_unit, trading

from .arrays import Bools, Floats, Ids, Ints, distinct, median
from .config import Unit
from .event_time.entries import Instants
from .event_time.troubles import Troubles

Seen = tuple[int, Ids, Floats]
"""Stamp, ids and positions float64 [n, dim] of an instant."""

# Counts fade by this share with every instant, and say something after so many instants.
_FADE = 0.02
_LEAST_INSTANTS = 20
# Mean number of instants in which an id is seen, below which motion can hardly be measured.
_LEAST_LIFE = 4.0
# Rows of an instant that are looked at.
_MOST_ROWS = 512
# Times that an id came back after its end; a batch that was overtaken may bring one back.
_LEAST_RETURNS = 3
# Two instants are compared so often, or where a feature leaps, if they are not farther apart than the last.
_COMPARE_NS, _APART_NS = 250_000_000, 500_000_000
_LEAST_SHARED = 5
# Features that were where others had been, as a share of all: one exchange of many, or some of fewer.
_TRADED = 0.5
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
class _Record:
    """What one session has sent: counts that fade, the length of a leap, and the last instant."""

    instants: int = 0
    rows: float = 0.0
    fresh: float = 0.0
    returns: int = 0
    compared: float = 0.0
    jumped: float = 0.0
    compared_ns: int = -(2**62)
    leap: float = 0.0
    last: Seen | None = None


@dataclass
class SourceChecks:
    """Follows the ids of every session number in a space.

    Troubles are noted with a number that says how much: the instants that an id lasts, or the share of
    features that jump (0: ended ids come back).
    """

    troubles: Troubles
    _records: dict[int, _Record] = field(default_factory=dict)

    def look(self, instants: Instants, fresh: int, ended: int) -> None:
        """Look at instants, of which so many rows were new and so many had an id that has ended."""
        source, count = instants.batch.source, len(instants.rows)
        record = self._records.setdefault(instants.session, _Record())
        record.returns += ended > 0
        if ended and record.returns >= _LEAST_RETURNS:
            self.troubles.note("ids-reused", source, 0.0)
        if not count:
            return
        record.instants += 1
        ids, positions = instants.ids[:_MOST_ROWS], instants.positions[:_MOST_ROWS]
        record.rows = (1 - _FADE) * record.rows + len(ids)
        record.fresh = (1 - _FADE) * record.fresh + fresh / count * len(ids)
        if record.instants >= _LEAST_INSTANTS and record.fresh * _LEAST_LIFE > record.rows:
            self.troubles.note("ids-short-lived", source, record.rows / record.fresh)
        last, record.last = record.last, (instants.stamp_ns, ids, positions)
        if last is None:
            return
        due = instants.stamp_ns - record.compared_ns >= _COMPARE_NS
        if due:
            # Whether any feature moves by a quarter of what all span is a cheap look at every instant.
            record.leap = 0.25 * float(np.ptp(positions, axis=0).max())
        elif np.array_equal(ids, last[1]):
            due = np.abs(positions - last[2]).max() > record.leap
        if due and (share := _traded(record, last, record.last)):
            self.troubles.note("ids-reused", source, share)

    def keep(self, sessions: set[int]) -> None:
        """Forget all sessions but these, by number."""
        self._records = {number: record for number, record in self._records.items() if number in sessions}


def _traded(record: _Record, last: Seen, new: Seen) -> float:
    """Compare two instants; the share of features that trade places of late, 0 while it says nothing."""
    (previous_ns, previous_ids, previous_positions), (stamp_ns, ids, positions) = last, new
    _, rows, previous_rows = np.intersect1d(ids, previous_ids, return_indices=True)
    if len(rows) < _LEAST_SHARED or not 0 < stamp_ns - previous_ns <= _APART_NS:
        return 0.0
    record.compared_ns = stamp_ns
    record.compared = 0.9 * record.compared + 1
    share = trading(previous_positions[previous_rows], positions[rows])
    record.jumped = 0.9 * record.jumped + share
    return record.jumped / record.compared if share and record.jumped > _TRADED else 0.0


@dataclass
class ExtentCheck:
    """Follows where the trajectories of each source of a space are."""

    unit: Unit
    """Of the space."""
    most: float
    """How many times as far as the others see a position may be; 0: any."""
    troubles: Troubles
    """Get to know how many times as far a refused row was, or a sentence that the positions of a source look
    as if they were in another unit."""
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
        present = distinct(sessions)[0].tolist()
        self._looks += 1
        if self._looks % _LOOK_EVERY and list(self._views) == present:
            return
        self._scenes.clear()
        places = {number: positions[sessions == number] for number in present}
        self._views = {number: (median(own), own) for number, own in places.items()}
        first = {number: other_unit(places[number], self.unit) for number in present[:_MAX_VIEWS]}
        self._doubts = {number: text for number, text in first.items() if text}

    def near(self, session: int, source: str, positions: Floats) -> Bools:
        """Which rows [n, dim] of a session of a source may be places of the scene, bool [n]."""
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
        centre = np.asarray(median(np.array([middle for middle, _ in views])), np.float64)
        reach = float(median(np.array([_reach(own, centre) for _, own in views])))
        return centre, max(reach, _MIN_EXTENT[self.unit])


def _reach(positions: Floats, centre: Floats) -> float:
    """Distance from a place within which most of the positions are."""
    distance = np.linalg.norm(positions - centre, axis=1)
    most = round(_MOST_OF_IT * (len(distance) - 1))
    return float(np.partition(distance, most)[most])
