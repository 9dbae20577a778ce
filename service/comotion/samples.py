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

from .compiled import compiled
from .states import Insertions
from .window import Bools, Floats, Slots, Stamps, Window

Array = NDArray[Any]

TILE = 64
"""Places that are worked on together; kernels that are kept on disk do not notice a change of it."""
EARLIEST, LATEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max
_KINDS = 4
# ε of (3.2), in units of v_move².
_REST = 1e-3


def velocity_weight(speed: Floats, v_move: float | None) -> Floats:
    """Weight of (3.2), w = 1 − exp(−λ(v² + ε)) with λ = −ln(1 − 0.9)/v_move²; 1 where `v_move` is None."""
    if v_move is None:
        return np.ones_like(speed)
    return -np.expm1(math.log(0.1) * ((speed / v_move) ** 2 + _REST))


@dataclass(frozen=True)
class Samples:
    """Samples of T instants among P places.

    A place is of a kind at an instant: 1 if observed, plus 2 if changing; -1 if not held. With a place
    of kind k those have a sample that are held and not excluded: two that are not changing have none,
    nor two that are not observed.

    Attributes
    ----------
    position, weight
        [T, 3, P] (zero beyond the space's dimension) and [T, P].
    kind
        int8 [T, P].
    mask
        [T, 4, P]: per kind of the one, who the other may be: 1, or -1 where samples are taken out.
    some
        bool [T, 4, P / TILE]: whether a block of places has any such.
    """

    position: NDArray[np.floating[Any]]
    weight: NDArray[np.floating[Any]]
    kind: NDArray[np.int8]
    mask: NDArray[np.floating[Any]]
    some: Bools

    @property
    def places(self) -> int:
        """P."""
        return int(self.kind.shape[1])

    def __len__(self) -> int:
        return len(self.kind)

    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """All attributes, for kernels."""
        return self.position, self.weight, self.kind, self.mask, self.some

    @classmethod
    def none(cls, places: int, dtype: np.dtype[Any]) -> Self:
        """No samples at all."""
        return cls(
            np.zeros((0, 3, places), dtype),
            np.zeros((0, places), dtype),
            np.zeros((0, places), np.int8),
            np.zeros((0, _KINDS, places), dtype),
            np.zeros((0, _KINDS, places // TILE), np.bool_),
        )

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """All of one after the other; of equal P."""
        return cls(*(np.concatenate(columns) for columns in zip(*(p.arrays() for p in parts), strict=True)))

    def drop(self, places: Slots) -> None:
        """Take the samples of some places out."""
        self.kind[:, places] = -1
        self.mask[:, :, places] = 0

    def widened(self, places: int) -> Self:
        """The same with room for more places."""
        extra = places - self.places
        if not extra:
            return self
        return type(self)(
            np.pad(self.position, ((0, 0), (0, 0), (0, extra))),
            np.pad(self.weight, ((0, 0), (0, extra))),
            np.pad(self.kind, ((0, 0), (0, extra)), constant_values=-1),
            np.pad(self.mask, ((0, 0), (0, 0), (0, extra))),
            np.pad(self.some, ((0, 0), (0, 0), (0, extra // TILE))),
        )


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
        n = len(slots)
        return cls(slots, places, np.full(n, LATEST), np.full(n, LATEST), np.full(n, LATEST))


def sample(
    window: Window,
    who: Changing,
    stamps: Stamps,
    *,
    sign: int,
    v_move: float | None,
    places: int,
    dtype: np.dtype[Any],
    late: Insertions | None = None,
) -> Samples:
    """Samples that come (`sign` 1) or go (-1) at some instants.

    Parameters
    ----------
    window
        Where the trajectories are.
    who
        Who takes part.
    stamps
        int64 [T], ascending.
    sign
        1 or -1.
    v_move
        Speed of λ in (3.2).
    places
        P, a multiple of TILE.
    dtype
        Of the arrays.
    late
        Count with the states as they were before these observations came.
    """
    position = np.zeros((len(stamps), 3, places), dtype)
    speed = np.zeros((len(stamps), places))
    flags = np.zeros((3, len(stamps), places), np.bool_)
    held, observed, changing = flags
    store = window.times, window.positions, window.speed, window.start, window.stop, window.gap_ns
    where = who.slots, who.places, who.after, who.until, who.known
    _locate(*store, *where, stamps, position, speed, held, observed, changing)
    if late is not None:
        places_late = who.places[np.searchsorted(who.slots, late.slots)]
        late.undo((position, speed, held, observed), places_late, stamps, window.gap_ns)
        changing[:, places_late] |= (late.t_left < stamps[:, None]) & (stamps[:, None] <= late.t_right)
    weight = velocity_weight(speed, v_move)
    kind = np.empty((len(stamps), places), np.int8)
    mask = np.empty((len(stamps), _KINDS, places), dtype)
    some = np.zeros((len(stamps), _KINDS, places // TILE), np.bool_)
    _classify(held, observed, changing, sign, kind, mask, some)
    return Samples(position, weight.astype(dtype), kind, mask, some)


@compiled()
def _locate(
    times: Stamps,
    positions: Floats,
    speeds: Floats,
    start: Slots,
    stop: Slots,
    gap_ns: int,
    slots: Slots,
    places: Slots,
    after: Stamps,
    until: Stamps,
    known: Stamps,
    stamps: Stamps,
    position: Array,
    speed: Floats,
    held: Bools,
    observed: Bools,
    changing: Bools,
) -> None:
    """States of trajectories at ascending instants, linear between observations."""
    for n in range(len(slots)):
        s, p, first, end = slots[n], places[n], start[slots[n]], stop[slots[n]]
        while end > first and times[s, end - 1] > known[n]:
            end -= 1
        k = first - 1
        if len(stamps):
            k += np.searchsorted(times[s, first:end], stamps[0], side="right")
        for t in range(len(stamps)):
            stamp = stamps[t]
            while k + 1 < end and times[s, k + 1] <= stamp:
                k += 1
            if k < first:
                continue
            exact = times[s, k] == stamp
            if not exact and (k + 1 >= end or times[s, k + 1] - times[s, k] > gap_ns):
                continue
            held[t, p] = True
            observed[t, p] = exact
            changing[t, p] = after[n] < stamp <= until[n]
            speed[t, p] = speeds[s, k if exact else k + 1]
            # Erratum: the thesis prints t_i,k+1 - t_j,k for the denominator; it is t_j,k+1 - t_j,k.
            share = 0.0 if exact else (stamp - times[s, k]) / (times[s, k + 1] - times[s, k])
            for c in range(positions.shape[2]):
                left = positions[s, k, c]
                position[t, c, p] = left if exact else left + share * (positions[s, k + 1, c] - left)


@compiled()
def _classify(
    held: Bools, observed: Bools, changing: Bools, sign: int, kind: Array, mask: Array, some: Array
) -> None:
    for t in range(held.shape[0]):
        for p in range(held.shape[1]):
            h, o, c = held[t, p], observed[t, p], changing[t, p]
            kind[t, p] = o + 2 * c if h else -1
            mask[t, 0, p] = sign * (h and o and c)
            mask[t, 1, p] = sign * (h and c)
            mask[t, 2, p] = sign * (h and o)
            mask[t, 3, p] = sign * h
            for k in range(4):
                some[t, k, p // TILE] |= mask[t, k, p] != 0
