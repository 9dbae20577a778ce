"""The distance samples that some instants bring to pairs: who is where, and which pairs it concerns.

At an instant at which trajectory i was observed, i and j have one distance sample if j is held there:
observed too, or inside a segment (between two observations) that is short enough to interpolate
(3.5). When states come or go, only pairs change in which one of the two is changing.
"""

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..aligned import aligned_zeros
from ..arrays import Floats, Slots, Stamps
from ..compiled import compiled
from ..trajectories.kernels import newest_from, segment_at
from ..trajectories.window import Window

Array = NDArray[Any]

TILE = 64
"""Places that are worked on together; kernels that are kept on disk do not notice a change of it."""
MOST_INSTANTS = 64
"""Instants whose samples are worked out at once: bounds the memory that this takes."""
EARLIEST, LATEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max
KINDS = 4
WEIGHT, MASK = 3, 4
_ROWS = MASK + KINDS
# ε of (3.2), in units of v_move².
_REST = 1e-3


def velocity_weight(speed: Floats, v_move: float | None) -> Floats:
    """Weight of (3.2), w = 1 − exp(−λ(v² + ε)) with λ = −ln(1 − 0.9)/v_move²; 1 where `v_move` is None."""
    rate, rest = _exponent(v_move)
    return -np.expm1(rate * speed**2 + rest)


def _exponent(v_move: float | None) -> tuple[float, float]:
    """−λ and −λε of (3.2): what v² is multiplied by, and what is added."""
    if v_move is None:
        return 0.0, -math.inf
    return math.log(0.1) / v_move**2, math.log(0.1) * _REST


@dataclass(frozen=True)
class Changing:
    """Trajectories that take part, and of which of their states samples come or go.

    Attributes
    ----------
    slots, places
        intp [n]: slots of the window and their places among the pairs.
    after, until
        int64 [n]: the states in (after, until] are changing.
    known
        int64 [n]: states later than this do not exist yet.
    """

    slots: Slots
    places: Slots
    after: Stamps
    until: Stamps
    known: Stamps

    @classmethod
    def of(cls, slots: Slots, places: Slots) -> Self:
        """Trajectories of which nothing is changing yet."""
        return cls(slots, places, *np.full((3, len(slots)), LATEST))


@dataclass(frozen=True)
class Insertions:
    """Observations that came late, each between two others of its trajectory: what was there before.

    `slots` intp [n]; times int64 [n, 2] ns and positions float64 [n, 2, dim] of the two neighbours; the
    `speed` of the segment between them, float64 [n].
    """

    slots: Slots
    times: Stamps
    positions: Floats
    speed: Floats

    @classmethod
    def at(cls, window: Window, slots: Slots, index: Slots) -> Self:
        """Of the observations that now are at `index` (not the first nor the last of its slot)."""
        both = slots[:, None], index[:, None] + np.array([-1, 1])
        times, positions = window.times[both], window.positions[both]
        step = np.linalg.norm(positions[:, 1] - positions[:, 0], axis=1)
        return cls(slots, times, positions, step / ((times[:, 1] - times[:, 0]) * 1e-9))


class Samples:
    """Samples of T instants among B blocks of TILE places, with room for a few more instants.

    A place is of a kind at an instant: 1 if observed, plus 2 if changing; -1 if not held. With a place
    of kind k those have a sample that are held and not excluded: two that are not changing have none,
    nor two that are not observed.

    Attributes
    ----------
    count
        T.
    values
        [B, room, 8, TILE], a block and instant in one piece: x, y and z (zero beyond the space's
        dimension), the weight, and per kind of the one who the other may be: 1, or -1 where samples are
        taken out. From T on, and but for the last four where a place is not held, meaningless.
    kind
        int8 [B, room, TILE].
    some
        bool [B, room, 4]: per kind, whether a block has any who may be the other.
    """

    def __init__(self, blocks: int, dtype: np.dtype[Any], room: int = MOST_INSTANTS) -> None:
        self.count = 0
        self.values: Array = aligned_zeros((blocks, room, _ROWS, TILE), dtype)
        self.kind: Array = np.full((blocks, room, TILE), -1, np.int8)
        self.some: Array = np.zeros((blocks, room, KINDS), np.bool_)

    @property
    def blocks(self) -> int:
        """B."""
        return len(self.kind)

    @property
    def room(self) -> int:
        """For how many more instants there is room."""
        return int(self.kind.shape[1]) - self.count

    def fit(self, blocks: int) -> None:
        """Make room for so many blocks; in new ones nobody is held."""
        if blocks <= self.blocks:
            return
        wider, t, old = Samples(blocks, self.values.dtype), self.count, self.blocks
        wider.values[:old, :t], wider.some[:old, :t] = self.values[:, :t], self.some[:, :t]
        wider.kind[:old, :t] = self.kind[:, :t]
        self.values, self.kind, self.some = wider.values, wider.kind, wider.some

    def drop(self, places: Slots) -> None:
        """Take the samples of some places out."""
        block, inside = places // TILE, places % TILE
        self.kind[block, :, inside] = -1
        self.values[block, :, MASK:, inside] = 0

    def add(
        self,
        window: Window,
        who: Changing,
        stamps: Stamps,
        *,
        sign: int,
        v_move: float | None,
        late: Insertions | None = None,
    ) -> None:
        """Samples that come (`sign` 1) or go (-1) at some more instants.

        Parameters
        ----------
        window
            Where the trajectories are.
        who
            Who takes part.
        stamps
            int64 [T], ascending, for which there is room.
        sign
            1 or -1.
        v_move
            Speed of λ in (3.2).
        late
            Count with the states as they were before these observations came.
        """
        rate, rest = _exponent(v_move)
        out = self.values, self.kind, self.some
        store = window.times, window.positions, window.speed, window.start, window.stop
        those = who.slots, who.places, who.after, who.until, who.known
        _take(*store, *those, stamps, window.gap_ns, sign, rate, rest, self.count, *out)
        if late is not None:
            places = who.places[np.searchsorted(who.slots, late.slots)]
            before = late.times, late.positions, late.speed
            _put_back(*before, places, stamps, window.gap_ns, sign, rate, rest, self.count, *out)
        self.count += len(stamps)


@compiled()
def _take(
    times: Stamps,
    positions: Floats,
    speeds: Floats,
    start: Slots,
    stop: Slots,
    slots: Slots,
    places: Slots,
    after: Stamps,
    until: Stamps,
    known: Stamps,
    stamps: Stamps,
    gap_ns: int,
    sign: int,
    rate: float,
    rest: float,
    begin: int,
    values: Array,
    kind: Array,
    some: Array,
) -> None:
    """Samples at ascending instants, behind the first `begin` of those that there are."""
    count = len(stamps)
    values[:, begin : begin + count, MASK:] = 0
    kind[:, begin : begin + count] = -1
    some[:, begin : begin + count] = False
    for n in range(len(slots) if count else 0):
        s, p, first, end = slots[n], places[n], start[slots[n]], stop[slots[n]]
        while end > first and times[s, end - 1] > known[n]:
            end -= 1
        k = first - 1
        for t in range(count):
            stamp = stamps[t]
            k = newest_from(times[s], k, end, stamp)
            left, right, share = segment_at(times[s], first, end, k, stamp, gap_ns, 0)
            if left < 0:
                continue
            observed = left == right
            for c in range(positions.shape[2]):
                before = positions[s, left, c]
                values[p // TILE, begin + t, c, p % TILE] = before + share * (positions[s, right, c] - before)
            weight = _weight(speeds[s, right], rate, rest)
            changing = after[n] < stamp <= until[n]
            _hold(values, kind, some, p, begin + t, weight, observed, changing, sign)


@compiled()
def _weight(speed: float, rate: float, rest: float) -> float:
    # It is stored in single precision, of which a difference to 1 leaves enough: none is below 0.002.
    return float(1.0 - np.exp(rate * speed * speed + rest))


@compiled()
def _hold(
    values: Array,
    kind: Array,
    some: Array,
    place: int,
    t: int,
    weight: float,
    observed: bool,
    changing: bool,
    sign: int,
) -> None:
    """A place is held: with whom it has a sample, by the kind of the other."""
    block, inside = place // TILE, place % TILE
    values[block, t, WEIGHT, inside] = weight
    kind[block, t, inside] = observed + 2 * changing
    for other in range(KINDS):
        if (observed or other & 1) and (changing or other & 2):
            values[block, t, MASK + other, inside] = sign
            some[block, t, other] = True


@compiled()
def _put_back(
    times: Stamps,
    positions: Floats,
    speed: Floats,
    places: Slots,
    stamps: Stamps,
    gap_ns: int,
    sign: int,
    rate: float,
    rest: float,
    begin: int,
    values: Array,
    kind: Array,
    some: Array,
) -> None:
    """What was there before late observations came is what has changed."""
    for n in range(len(places)):
        block, inside = places[n] // TILE, places[n] % TILE
        for t in range(len(stamps)):
            if not times[n, 0] < stamps[t] <= times[n, 1]:
                continue
            kind[block, begin + t, inside] = -1
            values[block, begin + t, MASK:, inside] = 0
            newest = 1 if stamps[t] == times[n, 1] else 0
            left, right, share = segment_at(times[n], 0, 2, newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            for c in range(positions.shape[2]):
                before = positions[n, left, c]
                values[block, begin + t, c, inside] = before + share * (positions[n, right, c] - before)
            weight = _weight(speed[n], rate, rest)
            _hold(values, kind, some, places[n], begin + t, weight, left == right, True, sign)
