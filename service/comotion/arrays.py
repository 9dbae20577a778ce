"""Names for the arrays that the core passes on, and arrays that take memory where they are written to."""

import math
import mmap
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Stamps = NDArray[np.int64]
"""Nanoseconds since the Unix epoch."""
Slots = NDArray[np.intp]
"""Where trajectories are stored in a window."""
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]
Ids = NDArray[np.uint64]
"""What sources call their features."""
Labels = NDArray[np.int64]
"""A hypothesis id per trajectory, or -1."""

# Share of the largest entry that makes a singular matrix regular.
_RIDGE = 1e-12
# Distinct integers are found by a table unless it is so many times longer than they are.
_SPAN = 16
# From which size on NumPy asks for large pages.
_LARGE_BYTES = 1 << 22
# Else memory is shared with processes that are forked; systems without such flags share nothing.
_PRIVATE: dict[str, Any] = (
    {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
)


class Table:
    """Base of frozen dataclasses that are tables: each field is a column, an array of as many rows."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    @property
    def _columns(self) -> list[NDArray[Any]]:
        return [getattr(self, name) for name in type(self).__match_args__]  # type: ignore[attr-defined]

    def of(self, rows: "Bools | Ints | slice") -> Self:
        """Some of the rows."""
        return type(self)(*(column[rows] for column in self._columns))

    def joined(self, other: Self) -> Self:
        """The rows of both, one after the other."""
        return type(self)(*map(np.concatenate, zip(self._columns, other._columns, strict=True)))


def untouched_zeros(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros of which each page takes memory once something is written to it.

    Those of NumPy do not: it asks for pages of 2 MB, which the system clears whole.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < _LARGE_BYTES:
        return np.zeros(shape, dtype)
    return np.frombuffer(mmap.mmap(-1, size, **_PRIVATE), dtype).reshape(shape)


def inverses(matrices: Floats) -> Floats:
    """Inverses of positive semidefinite matrices [n, k, k]; very large where there is no extent."""
    try:
        return np.asarray(np.linalg.inv(matrices), np.float64)
    except np.linalg.LinAlgError:
        # Rounding has taken all but the largest directions, as with coordinates of 1e9 m.
        size = np.abs(matrices).max(axis=(1, 2), keepdims=True) + np.finfo(np.float64).tiny
        return np.asarray(np.linalg.inv(matrices + _RIDGE * size * np.eye(matrices.shape[1])), np.float64)


def identities(count: int) -> Floats:
    """Identity rotations, float64 [count, 3, 3]."""
    return np.broadcast_to(np.eye(3), (count, 3, 3)).copy()


def thinned(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """At most `count` of the rows [n, ...], evenly spaced."""
    return rows[:: max(-(-len(rows) // count), 1)]


def median(values: Floats) -> Any:
    """Median along the first axis, of a row or more without NaN, as that of NumPy for a fifth of the time."""
    high = len(values) // 2
    low = high - 1 + len(values) % 2
    ranked = np.partition(values, (low, high), axis=0)
    return (ranked[low] + ranked[high]) / 2


def quantiles(values: Floats, shares: tuple[float, ...]) -> list[float]:
    """Quantiles of n > 0 values by linear interpolation, as ``np.quantile`` at a tenth of its cost."""
    last = len(values) - 1
    wanted = np.array(shares) * last
    return [float(value) for value in np.interp(wanted, np.arange(last + 1), np.sort(values))]


def nanmedian(values: Floats, axis: int) -> Floats:
    """Median along an axis, NaN left out; NaN where all are, without a warning."""
    # NaN come last.
    ranked, count = np.sort(values, axis=axis), np.isfinite(values).sum(axis=axis, keepdims=True)
    middle = np.concatenate(
        [np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[axis] - 1)], axis
    )
    return np.asarray(np.take_along_axis(ranked, middle, axis=axis).mean(axis=axis))


def distinct(values: NDArray[np.signedinteger[Any]]) -> tuple[Labels, Ints]:
    """The distinct ones of integers [n], int64 ascending, and which of them each is, intp [n].

    As np.unique gives them; by a table instead of sorting where they lie close together, as ids do.
    """
    least, most = (int(values.min()), int(values.max())) if len(values) else (0, 0)
    span = most - least + 1
    if span > _SPAN * (len(values) + _SPAN):
        names, rows = np.unique(values, return_inverse=True)
        return names.astype(np.int64), rows
    present, places = np.zeros(span, np.bool_), values - least
    present[places] = True
    return present.nonzero()[0] + least, (present.cumsum() - 1)[places]


def ranks(groups: Labels, by: NDArray[Any]) -> Ints:
    """Place of each among those of its group [n], from the least `by` [n]: intp [n] from 0, ties in order."""
    order = np.lexsort((by, groups))
    begins = np.flatnonzero(np.diff(groups[order], prepend=groups[order][:1] - 1))
    places = np.empty(len(order), np.intp)
    places[order] = np.arange(len(order)) - np.repeat(begins, np.diff(begins, append=len(order)))
    return places


def last_true(flags: Bools) -> Ints:
    """Column of the last true entry of each row of bool [n, m], intp [n]; the last one if there is none."""
    return np.asarray(flags.shape[1] - 1 - np.argmax(flags[:, ::-1], axis=1), np.intp)


def find(wanted: NDArray[Any], keys: NDArray[Any]) -> Ints:
    """Where each wanted key [m] is among ascending keys [n], integers: intp [m], -1 where it is not."""
    if not len(keys):
        return np.full(len(wanted), -1, np.intp)
    at = keys.searchsorted(wanted)
    at[keys.take(at, mode="clip") != wanted] = -1
    return at
